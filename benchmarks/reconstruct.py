"""Speed of reconstruction against cv2.undistortPoints and numpy, in one run on one core; and of its exactness.

Run `python benchmarks/reconstruct.py`; status 1 where the answers differ.
Needs only the workbench.
"""

import argparse
import os
import sys
from functools import partial
from pathlib import Path

THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)
POINTS, STEPS = 1_000_000, 120
REPEATS = (15, 9)
EXACT = 1e-9
SAME = 1e-6
"""px of a round trip; mm that OpenCV's five rounds of iteration may be off by for a lens as mild as this."""


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 where the two sides of a row give different answers, else 0."""
    parser = argparse.ArgumentParser(
        prog="benchmarks/reconstruct.py", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "--only", default="", metavar="WORD", help="only the rows whose name holds WORD"
    )
    options = parser.parse_args(arguments)
    os.environ.update(dict.fromkeys(THREADS, "1"))  # read by numpy when it is first imported, below
    root = str(Path(__file__).resolve().parents[1])
    if root not in sys.path:
        sys.path.insert(0, root)
    from benchmarks import table
    from workbench.core.memory import keep_freed_memory

    keep_freed_memory()  # as the command line does
    return table.show([row for row in comparisons() if options.only in row.__name__])


def comparisons() -> list:
    """Functions that return a Row, in the order of the table."""
    return [scan_of_many_planes, scan_of_one_plane, undistortion, undistortion_until_exact]


def scanner(steps: int):
    """A scanner like Ye's: 1280 x 1024 px, fx 3421, light planes from 69 mm off it to points 115 to 135 mm away."""
    import numpy as np

    from sensors.camera.model import Camera
    from sensors.scanner.model import Scanner

    camera = Camera.of([3421, 3419, 645, 507, -0.11, 0.23, 4e-4, -3e-4, 0.05], (1280, 1024))
    turns = np.deg2rad(np.linspace(19, 39, steps) if steps > 1 else [29.0])
    planes = np.stack([np.cos(turns), 0 * turns, -np.sin(turns), 69 * np.cos(turns)])
    return Scanner(camera, np.arange(steps), planes)


def scan(steps: int):
    """Pixels (2, n) over the image and steps (n,)."""
    import numpy as np

    rng = np.random.default_rng(0)
    return rng.uniform(0, [[1279], [1023]], (2, POINTS)), rng.integers(0, steps, POINTS)


def scan_of_many_planes():
    """A whole scan: each point has the plane of its own step."""
    return _scan("120 planes", STEPS, 4)


def scan_of_one_plane():
    """For information: a profiler, whose points all lie in one plane."""
    return _scan("1 plane", 1, None)


def _scan(what, steps, required):
    import cv2
    import numpy as np

    from benchmarks.table import Row, agree, compare

    cv2.setNumThreads(1)
    made, (pixels, labels) = scanner(steps), scan(steps)
    ours = partial(made.reconstruct, pixels, labels)
    peer = partial(_peer, made, np.ascontiguousarray(pixels.T)[:, None], labels)
    points, theirs = ours(), peer()
    note = agree("points in mm", float(np.nanmax(abs(points - theirs))), SAME)
    back = float(np.nanmax(abs(made.camera.project(points) - pixels)))
    note += "; ours " + agree("pixels after a round trip", back, EXACT)
    return Row(
        f"undistort + intersect, {POINTS:,} points, {what}",
        *compare(ours, peer, REPEATS),
        required,
        note,
    )


def _peer(made, pixels, labels):
    """What one would write with OpenCV and numpy."""
    import cv2
    import numpy as np

    x, y = cv2.undistortPoints(pixels, made.camera.matrix, np.array(made.camera.distortion))[:, 0].T
    plane = made.planes[:, labels] if made.planes.shape[1] > 1 else made.planes
    depth = -plane[3] / (plane[0] * x + plane[1] * y + plane[2])
    return np.stack([x * depth, y * depth, depth])


def undistortion():
    """For information: the lens alone, OpenCV with its five rounds."""
    return _undistortion("cv2 as it is", None)


def undistortion_until_exact():
    """For information: OpenCV iterating until it is as exact."""
    return _undistortion("cv2 until 1e-12", (3, 50, 1e-12))


def _undistortion(what, criteria):
    import cv2
    import numpy as np

    from benchmarks.table import Row, agree, compare

    cv2.setNumThreads(1)
    made, (pixels, _) = scanner(1), scan(1)
    source, lens = np.ascontiguousarray(pixels.T)[:, None], np.array(made.camera.distortion)
    rounds, more = (
        (cv2.undistortPoints, ())
        if criteria is None
        else (cv2.undistortPointsIter, (None, None, criteria))
    )
    peer = partial(rounds, source, made.camera.matrix, lens, *more)
    ours = partial(made.camera.normalised, pixels)
    note = agree("normalised points", float(abs(ours() - peer()[:, 0].T).max()), SAME)
    return Row(f"undistort, {POINTS:,} points, {what}", *compare(ours, peer, REPEATS), None, note)


if __name__ == "__main__":
    sys.exit(main())
