"""The verdict on a hand-eye calibration: its held-out errors against the corner noise and against tolerances."""

import math
from collections.abc import Sequence

from sensors.hand_eye.result import HandEye
from workbench.fitting.verdicts.verdict import Noise, Residual, Tolerance, Verdict, combine, judge

UNITS = ("mm", "deg", "px")
PROFILE_UNITS = ("mm",)
FROM_IMAGES = "from each image alone, without the robot"
_SAME = "for the same reason"
FROM_PROFILES = "from each profile alone, without the robot"


def handeye_verdict(run, tolerances: Sequence[Tolerance] = ()) -> Verdict:
    """Verdict on a `HandEyeRun`: scatter of the board in mm and deg and reprojection in px, or distance from the ball.

    The poses are those that the solve did not see. Without a board pose that is known well enough for held-out
    errors, those of the fit are judged.
    """
    made = run.made
    if made.radius is not None:
        return _profiles(made, tolerances)
    errors, label = _held_out(made)
    degrees = max(6 * len(made.poses) - 12, 1)
    rows = (
        ("centre_mm", "mm", "scatter of the estimated board position", _advice(made)),
        ("turn_deg", "deg", "scatter of the estimated board orientation", _SAME),
        ("rms_px", "px", "reprojection error", _SAME),
    )
    noise = _noise(run)
    parts = [
        judge(
            Residual(errors[key], unit, f"{label} RMS {name}", degrees),
            None if unit not in noise else Noise(noise[unit], FROM_IMAGES),
            tolerances,
            advice,
        )
        for key, unit, name, advice in rows
    ]
    return combine(parts)


def _noise(run) -> dict[str, float]:
    """By unit, what the corner noise makes of each error; without a review only that of the corners is known."""
    if run.review is None:
        return {"px": math.sqrt(2) * run.made.noise}
    noise = run.review.noise
    return {"mm": noise.middle_mm, "deg": noise.rotation_deg, "px": math.sqrt(2) * noise.sigma_px}


def _held_out(made: HandEye):
    if math.isfinite(made.held_out["rms_px"]):
        return made.held_out, "held-out"
    return made.fit, "fitted"


def _advice(made: HandEye) -> str:
    place, turn = made.robot_sigma.get("position_mm"), made.robot_sigma.get("rotation_deg")
    return (
        f"the flange poses are off by about {place:.2g} mm and {turn:.2g} deg (1 sigma, estimated); an arm that is "
        "calibrated, warm and repeats its approach reduces it"
    )


def _profiles(made: HandEye, tolerances) -> Verdict:
    value = made.held_out["rms_mm"]
    label = "held-out" if math.isfinite(value) else "fitted"
    value = value if math.isfinite(value) else made.fit["rms_mm"]
    residual = Residual(value, "mm", f"{label} RMS distance of the points from the ball")
    advice = "the flange poses, the radius of the ball or the profiler's scale are off by more than the noise"
    return judge(residual, Noise(made.noise, FROM_PROFILES), tolerances, advice)


def handeye_warnings(run) -> list[str]:
    """What a user must read before the result is used: suspected mistakes, images left out, what is undetermined."""
    made = run.made
    left_out = [
        f"image {name}: {row.why.partition(': ')[2] or row.why}"
        for name, row in zip(run.names, made.poses)
        if row.outlier
    ]
    return [*made.suspicions, *left_out]
