"""Light planes of mirror steps that no board saw, from the mirror that fits all others."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sensors.light.mirror import nearest_branch, on_one_branch
from sensors.scanner.calibration import ScannerCalibration
from sensors.scanner.model import Scanner

_MAX_EXTENSION = 0.5  # of the calibrated sweep, up to which it is extended at each end
_LINEAR = 1e-6  # rad, by which angles may differ from a law that is linear in the commanded angle or the step


def with_unseen_steps(
    calibration: ScannerCalibration, commanded: Mapping[int, float | None]
) -> tuple[Scanner, tuple[int, ...]]:
    """The scanner with planes of further steps, and the steps that were added.

    commanded: commanded mirror angle (rad) by step, None where it is not known; steps that have a plane are ignored.
    Without a mirror in the scanner nothing is added. The covariance of the new planes is that of the mirror, so that
    planes beyond the calibrated sweep are less certain; those farther than half of it beyond are not added.
    """
    scanner = calibration.scanner
    new = {step: angle for step, angle in commanded.items() if step not in set(scanner.steps)}
    if scanner.mirror is None or not new:
        return scanner, ()
    angles = _angles(calibration, new)
    low = float(scanner.angles.min())
    high = float(scanner.angles.max())
    reach = _MAX_EXTENSION * (high - low)
    in_range = {
        step: angle for step, angle in angles.items() if low - reach <= angle <= high + reach
    }
    if not in_range:
        return scanner, ()
    all_angles = np.append(scanner.angles, list(in_range.values()))
    planes = scanner.mirror.planes(all_angles)
    board_stripes = replace(calibration.made.board_stripes, angles=all_angles, planes=planes)
    plane_covariances = replace(calibration.made, board_stripes=board_stripes).best_frame(
        calibration.volume
    )
    extended = replace(
        scanner,
        steps=np.append(scanner.steps, list(in_range)),
        planes=planes,
        angles=all_angles,
        covariance=plane_covariances.planes,
        frame=plane_covariances.frame,
        rays=plane_covariances.rays,
    )
    return extended, tuple(in_range)


def _angles(calibration: ScannerCalibration, new: Mapping[int, float | None]) -> dict[int, float]:
    """Mirror angle (rad) of each new step, by the law of those that have a plane."""
    scanner = calibration.scanner
    known = calibration.commanded
    if known is not None and all(angle is not None for angle in new.values()):
        branch = on_one_branch(scanner.planes, known)
        law = _law(branch, scanner.angles)
        if law is None:
            return {}
        if not np.array_equal(branch, known):
            new = {step: nearest_branch(angle, branch.mean()) for step, angle in new.items()}
        return {step: float(np.polyval(law, angle)) for step, angle in new.items()}
    law = _law(scanner.steps.astype(float), scanner.angles)
    return {step: float(np.polyval(law, step)) for step in new if law is not None}


def _law(given: np.ndarray, angles: np.ndarray) -> np.ndarray | None:
    """Slope and offset of angles that are linear in what was given, None where they are not."""
    if len(given) < 2 or np.ptp(given) == 0:
        return None
    law = np.polyfit(given, angles, 1)
    return law if np.abs(np.polyval(law, given) - angles).max() < _LINEAR else None
