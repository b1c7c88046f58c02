"""Ball centres and hand-eye transforms of six kinds of scanner, on simulated measurements with seeds of their own.

Run `python benchmarks/scanner_kinds.py [SEEDS [FIRST]]`, FIRST being the first seed. One row a kind: RMS error of ball
centres over the Cramer-Rao bound (known radius), mean squared error in stated standard deviations (z2, expected 1),
mean error of a free radius with its standard error, and the RMS error of the hand-eye transform in stated standard
deviations. Exit status 1 where a row is outside its limits by more than chance (two standard errors). The simulation is
that of the tests: exact geometry, no images, noise along the scan line.
"""

import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
DRAWS = 20
LIMITS = {"ratio": 1.3, "z2": (0.7, 1.3), "radius_um": 1.0, "hand_eye": 2.0}
FIRST_SEED = 52_000
SWEPT, MOVED, OWN = (
    ("mirror", "galvanometer"),
    ("fixed plane", "turntable"),
    ("profiler", "3d-camera"),
)


@dataclass
class Errors:
    """Squared errors of centres over bound and over stated covariance, radius errors (um), hand-eye errors (sigma)."""

    bound: list = field(default_factory=list)
    stated: list = field(default_factory=list)
    radius: list = field(default_factory=list)
    hand_eye: list = field(default_factory=list)

    def row(self, kind: str) -> tuple[str, bool]:
        """The line of a kind, and whether it is within all limits."""
        import numpy as np

        ratio, z2 = float(np.sqrt(np.mean(self.bound))), float(np.mean(self.stated))
        bias, error = np.mean(self.radius), np.std(self.radius, ddof=1) / np.sqrt(len(self.radius))
        away = float(np.sqrt(np.mean(self.hand_eye))) if self.hand_eye else float("nan")
        low, high = LIMITS["z2"]
        chance = 2 * float(np.sqrt(2 / (3 * len(self.stated))))
        is_biased = abs(bias) - 2 * error > LIMITS["radius_um"]
        is_within = ratio <= LIMITS["ratio"] and low - chance <= z2 <= high + chance
        is_within &= not is_biased and not away > LIMITS["hand_eye"]
        text = f"{kind:13} {ratio:6.2f} {z2:6.2f}   {bias:+6.2f} ± {error:4.2f} um {away:9.2f}"
        return f"{text}   {'' if is_within else 'OUTSIDE'}", bool(is_within)


def main() -> int:
    """Print the table; 1 where a row is outside its limits."""
    os.environ.update(dict.fromkeys(THREADS, "1"))  # read by numpy when it is first imported, below
    root = Path(__file__).resolve().parents[1]
    sys.path[:0] = [str(root), str(root / "tests")]
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 8
    first = int(sys.argv[2]) if len(sys.argv) > 2 else FIRST_SEED
    print("kind           ratio     z2       radius error     hand-eye")
    within = True
    for kind in (*SWEPT, *MOVED, *OWN):
        text, is_within = measured(kind, range(first, first + count)).row(kind)
        within &= is_within
        print(text, flush=True)
    return 0 if within else 1


def measured(kind: str, seeds: range) -> Errors:
    """Errors of a kind over seeds."""
    errors = Errors()
    for seed in seeds:
        if kind in OWN:
            _own_calibration(kind, seed, errors)
        else:
            _stripes(kind, seed, errors)
            _board_images(seed, errors)
    return errors


def _stripes(kind, seed, errors: Errors) -> None:
    """Balls from stripes, with known and with free radius."""
    import numpy as np

    from scanner_kinds import SIGMA_PX, bound

    rng = np.random.default_rng(seed)
    truth, make_cloud = _swept(kind, rng) if kind in SWEPT else _moved(kind, rng)
    count = truth.pixels.shape[1]
    least = bound(make_cloud(np.zeros(count)), truth)
    for _ in range(DRAWS):
        cloud = make_cloud(SIGMA_PX * rng.normal(size=count))
        _add(errors, _fitted(cloud, truth.radius, SIGMA_PX), truth.centre, least)
        free = _fitted(cloud, None, SIGMA_PX)
        errors.radius.append(1e3 * (free.radius - truth.radius))


def _fitted(cloud, radius, sigma_px):
    import numpy as np

    from sensors.ball.fit import fit_ball

    length = np.linalg.norm(cloud.error, axis=0)
    noise = {"sigma": sigma_px * length, "direction": cloud.error / length}
    return fit_ball(cloud.points, radius=radius, view=cloud.view, **noise, **cloud.shared_errors())


def _add(errors: Errors, fit, centre, least) -> None:
    import numpy as np

    away = fit.centre - centre
    errors.bound.append(away @ np.linalg.solve(least, away) / 3)
    errors.stated.append(away @ np.linalg.solve(fit.covariance[:3, :3], away) / 3)


def _swept(kind, rng):
    import numpy as np

    from scanner_kinds import CAMERA, SIGMA_PX, Truth, stripes_on_ball
    from sensors.scanner.cloud import Cloud
    from sensors.scanner.model import Scanner
    from test_cramer_rao import swept_planes

    planes = swept_planes(rng, kind)
    scanner = Scanner(CAMERA, np.arange(planes.shape[1]), planes, sigma_px=SIGMA_PX)
    centre, radius = np.array([0.0, 0.0, 127.0]) + rng.uniform(-2, 2, 3), rng.uniform(6.0, 8.0)
    pixels, steps = stripes_on_ball(planes.T, [centre] * planes.shape[1], radius)

    def make_cloud(noise):
        moved = pixels + np.stack([noise, 0 * noise])
        return Cloud(scanner, scanner.reconstruct(moved, steps), moved, steps, np.zeros_like(steps))

    return Truth(pixels, steps, centre, radius), make_cloud


def _moved(kind, rng):
    from scanner_kinds import cloud_of, seen_stripes
    from test_cramer_rao import fixed_plane, turntable

    motion, centre, radius = (turntable if kind == "turntable" else fixed_plane)(rng)
    truth = seen_stripes(motion, centre, radius)
    return truth, lambda noise: cloud_of(truth, motion, noise)


def _board_images(seed, errors: Errors) -> None:
    """Hand-eye of a camera: the same for all kinds that calibrate on boards."""
    import numpy as np

    from hand_eye_scenes import CAMERA, board, images, off
    from sensors.hand_eye.images import hand_eye_from_views

    views, flange = images(seed)
    found = hand_eye_from_views(views, board(), CAMERA, flange)
    away = off(found.sensor)
    errors.hand_eye.append(away @ np.linalg.solve(found.covariance, away) / 6)


def _own_calibration(kind, seed, errors: Errors) -> None:
    """A profiler or a 3-D camera: joined points of one ball, and the hand-eye from the same recording."""
    import numpy as np

    from hand_eye_scenes import off
    from scanner_kinds import joined_ball
    from workbench.jobs.sensor import hand_eye
    from workbench.recordings.templates.scanner_kinds import HAND_EYE

    with TemporaryDirectory() as folder:
        joined = joined_ball(kind, Path(folder) / "r", seed)
        recording = joined.recording
        _add(errors, joined.fit, joined.truth, joined.least)
        errors.radius.append(1e3 * (joined.free.radius - float(recording.balls[1][3])))
        found = hand_eye.calibrate(recording, None, None, lambda text: None).made
        away = off(found.sensor, HAND_EYE)
        errors.hand_eye.append(away @ np.linalg.solve(found.covariance, away) / 6)


if __name__ == "__main__":
    sys.exit(main())
