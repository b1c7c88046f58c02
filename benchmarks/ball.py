"""A ball of 100,000 points against RANSAC as an expert uses it: time and error in one row.

Run `python benchmarks/ball.py`. Both sides get the same points and no start; neither knows the radius. The peer
makes 20 tries with four points each, of which a tenth of outliers spoils about a third, and refines the sphere on
the points near it by three linear least-squares steps. It gives no uncertainty; ours gives a covariance.
"""

import os
import sys
from pathlib import Path

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def main() -> int:
    """Print the table; 1 where the two sides of a row give different answers, else 0."""
    os.environ.update(dict.fromkeys(THREADS, "1"))  # read by numpy when it is first imported, below
    root = str(Path(__file__).resolve().parents[1])
    if root not in sys.path:
        sys.path.insert(0, root)
    from benchmarks import table
    from workbench.core.memory import keep_freed_memory

    keep_freed_memory()  # as the command line does
    return table.show(comparisons())


def comparisons():
    """The rows' functions."""
    return [ball_many]


POINTS, RADIUS, NOISE, OUTLIERS, SETS = 100_000, 12.7, 0.02, 0.1, 4
LEAST_RATIO, LARGEST_ERROR = 1, 1.1
TRIES, REFINEMENTS = 20, 3


def ball_many():
    """A cap of 60 deg half angle with a tenth of outliers; the errors are of the centre, RMS over some sets."""
    import numpy as np

    from benchmarks.table import Disagreement, Row, fastest
    from sensors.ball.fit import fit_ball

    clouds = [_cloud(np.random.default_rng(seed)) for seed in range(SETS)]
    ours = np.array([fit_ball(points).centre - centre for points, centre in clouds])
    theirs = [refined_ransac(points) - centre for points, centre in clouds]
    errors = [float(np.sqrt((np.square(error)).sum(1).mean())) for error in (ours, theirs)]
    if not errors[0] <= LARGEST_ERROR * errors[1]:
        raise Disagreement(
            f"our error {1e3 * errors[0]:.2g} um, expected at most {LARGEST_ERROR} times {1e3 * errors[1]:.2g} um"
        )
    points = clouds[0][0]
    times = (
        fastest(3, lambda: fit_ball(points)),
        fastest(3, lambda: refined_ransac(points)),
    )
    limit = centre_limit(points)
    note = (
        f"3-D error of the centre {1e3 * errors[0]:.2g} um with covariance, RANSAC's {1e3 * errors[1]:.2g} um without, "
        f"{SETS} sets; Cramer-Rao bound {1e3 * limit:.2g} um"
    )
    return Row(
        f"ball, {POINTS:,} points, {OUTLIERS:.0%} outliers, RANSAC", *times, LEAST_RATIO, note
    )


def refined_ransac(points):
    """Centre (3,) of a sphere through points (3, n): the best of 20 spheres through four points, then refined."""
    import numpy as np

    random, inside = np.random.default_rng(0), None
    for _ in range(TRIES):
        centre, radius = algebraic_sphere(points[:, random.integers(points.shape[1], size=4)])
        near = np.abs(np.linalg.norm(points - centre[:, None], axis=0) - radius) < 3 * NOISE
        if inside is None or near.sum() > inside.sum():
            inside = near
    for _ in range(REFINEMENTS):
        centre, radius = algebraic_sphere(points[:, inside])
        inside = np.abs(np.linalg.norm(points - centre[:, None], axis=0) - radius) < 3 * NOISE
    return centre


def algebraic_sphere(points):
    """Centre and radius of the sphere with the least algebraic residual: |p|^2 = 2 c p + (r^2 - |c|^2)."""
    import numpy as np

    rows = np.column_stack([2 * points.T, np.ones(points.shape[1])])
    found = np.linalg.lstsq(rows, (points**2).sum(0), rcond=None)[0]
    return found[:3], float(np.sqrt(max(found[3] + found[:3] @ found[:3], 0.0)))


def centre_limit(points):
    """Cramer-Rao bound of the 3-D error of the centre (mm): normal noise of the points on the ball, radius unknown."""
    import numpy as np

    right = points[:, int(OUTLIERS * POINTS) :]
    directions = right - refined_ransac(points)[:, None]
    directions = directions / np.linalg.norm(directions, axis=0)
    rows = np.vstack([directions, np.ones(directions.shape[1])])
    covariance = NOISE**2 * np.linalg.inv(rows @ rows.T)
    return float(np.sqrt(np.trace(covariance[:3, :3])))


def _cloud(random):
    """Points (3, n) mm and the centre (3,): noise of the surface, and outliers in a box around."""
    import numpy as np

    centre = random.uniform(-20, 20, 3)
    height, turn = random.uniform(0.5, 1, POINTS), random.uniform(0, 2 * np.pi, POINTS)
    across = np.sqrt(1 - height**2)
    points = RADIUS * np.stack([across * np.cos(turn), across * np.sin(turn), -height])
    points += random.normal(0, NOISE, points.shape)
    wrong = int(OUTLIERS * POINTS)
    points[:, :wrong] = random.uniform(-1, 1, (3, wrong)) * RADIUS - [[0], [0], [RADIUS]]
    return points + centre[:, None], centre


if __name__ == "__main__":
    sys.exit(main())
