"""Verdicts on cameras, scanners and scans: residuals against the noise of the images and against tolerances.

A result whose residual is far above the noise and large in itself is not trustworthy, and is said to be so whether or
not a tolerance was given: the images then show something else than the model says (another board, a line beside the
board, images of two cameras).
"""

import math
from collections.abc import Sequence

import numpy as np

from workbench.fitting.verdicts.verdict import (
    Noise,
    Residual,
    Tolerance,
    Verdict,
    combine,
    judge,
    no_verdict,
)

CAMERA_UNITS = ("px",)
SCANNER_UNITS = ("mm", "px")
SCAN_UNITS = ("mm",)
_CORNERS = "of each corner in its image"
_CENTRES = "of each stripe centre in its image"
_POINTS = "of the points, from stripe centres and light planes"
# What is both so many times the noise and so many px off, or such a share of the image's width in a small image, is no
# noise and no imperfect lens.
_POOR, _POOR_PX, _POOR_SHARE = 5.0, 1.0, 5e-4
_MOST_WRONG = 0.5
_MODEL = "the model leaves out a part of what the images show"
_POOR_WORDS = "DO NOT USE THIS RESULT, it is not trustworthy"


def camera_verdict(calibration, tolerances: Sequence[Tolerance] = ()) -> Verdict:
    """Verdict on a `CameraCalibration`: RMS reprojection error, of images left out where there are enough."""
    value, name = calibration.rms_px, "RMS reprojection error"
    if calibration.held_out is not None:
        value, name = calibration.held_out.rms_px, f"held-out {name}"
    noise = math.sqrt(2) * _rms(np.concatenate([view.sigma for view in calibration.views]))
    degrees = max(
        2 * int(calibration.view.size)
        - 6 * len(calibration.poses)
        - len(calibration.camera.values),
        1,
    )
    return judge(Residual(value, "px", name, degrees), Noise(noise, _CORNERS), tolerances, _MODEL)


def camera_warnings(calibration) -> list[str]:
    """Why a camera is not trustworthy, if it is not."""
    verdict = camera_verdict(calibration)
    if not _is_poor(verdict, math.sqrt(2) * _least_px(calibration)):
        return []
    return [
        f"{_POOR_WORDS}: corners miss their predicted places by {verdict.residual:.3g} px, "
        f"{verdict.residual_over_noise:.3g} times their noise; check kind, columns and rows under [board], that all "
        "images are of one camera with fixed focus, and that the board is flat"
    ]


def scanner_verdict(calibration, tolerances: Sequence[Tolerance] = ()) -> Verdict:
    """Verdict on a `ScannerCalibration`: stripe points from their light plane, in mm and in px along the scan line."""
    good = ~calibration.wrong
    sheets, left = calibration.stripes, calibration.left_out
    sigma = np.broadcast_to(sheets.sigma, (1, sheets.n))[0][good]
    pixels, millimetres = calibration.sigma_stripe_px, _rms(calibration.residual_mm[good])
    label = "RMS distance of stripe points from their light plane"
    if left is not None and math.isfinite(left.rms_mm):
        pixels, millimetres, label = left.rms_px, left.rms_mm, f"held-out {label}"
    degrees = max(int(good.sum()) - 3 * len(calibration.scanner.steps), 1)
    return combine(
        [
            judge(
                Residual(millimetres, "mm", label, degrees),
                Noise(_rms(sigma * sheets.gain[good]), _CENTRES),
                tolerances,
                _MODEL,
            ),
            judge(
                Residual(pixels, "px", label, degrees),
                Noise(_rms(sigma), _CENTRES),
                tolerances,
                _MODEL,
            ),
        ]
    )


def scanner_warnings(calibration) -> list[str]:
    """Why a scanner is not trustworthy, if it is not."""
    said = camera_warnings(calibration.start)
    pixels = next(part for part in scanner_verdict(calibration).parts if part.unit == "px")
    if _is_poor(pixels, _least_px(calibration)):
        said.append(
            f"{_POOR_WORDS}: the laser line lies {pixels.residual:.3g} px from its light plane, "
            f"{pixels.residual_over_noise:.3g} times the noise of its centres; see that the line runs across the "
            "board's surface and not on its margin or behind it, and that board and laser images of a board pose "
            "belong together"
        )
    wrong = float(calibration.wrong.mean())
    if wrong > _MOST_WRONG:
        said.append(
            f"{_POOR_WORDS}: {100 * wrong:.0f} % of the points of the laser line were left out as wrong; take the "
            "images with less light, without reflections, and with the line on the board"
        )
    return said


def scan_verdict(made, tolerances: Sequence[Tolerance] = ()) -> Verdict:
    """Verdict on `Scans`: points of all balls from their balls, mm. One pass over the scans, whose sums are kept."""
    squares, expected, count = _ball_sums(made)
    if not count:
        return no_verdict("No ball was fitted, so no residual can be judged.")
    residual = Residual(
        math.sqrt(squares / count), "mm", "RMS distance of ball points from their balls", count
    )
    advice = "the calibration of the scanner, the certified radius or the ball's form is off by more than the noise"
    return judge(residual, Noise(math.sqrt(expected / count), _POINTS), tolerances, advice)


def scan_warnings(made) -> list[str]:
    """Why scans are not trustworthy, if they are not."""
    verdict = scan_verdict(made)
    ratio = verdict.residual_over_noise
    if ratio is None or ratio <= _POOR:
        return []
    return [
        f"{_POOR_WORDS}: points lie {verdict.residual:.3g} mm from their balls, {ratio:.3g} times the noise; see that "
        "the scanner file belongs to these images, and check the radii in artefact.csv"
    ]


def _ball_sums(made):
    """Sums over the points of all fitted balls: squared distances, squares that the noise makes, and their number."""
    if "ball_sums" not in made.told:
        squares = expected = count = 0.0
        for fit in (ball.fit for one in made.scans for ball in one.balls):
            if fit and fit.sigma_scale > 0 and math.isfinite(fit.rms):
                number = float(fit.inliers.sum())
                squares += number * fit.rms**2
                expected += number * (fit.rms / fit.sigma_scale) ** 2
                count += number
        made.told["ball_sums"] = squares, expected, count
    return made.told["ball_sums"]


def _least_px(calibration) -> float:
    """px of a coordinate."""
    return min(_POOR_PX, _POOR_SHARE * calibration.camera.size[0])


def _is_poor(verdict: Verdict, least: float) -> bool:
    ratio = verdict.residual_over_noise
    return ratio is not None and ratio > _POOR and verdict.residual > least


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
