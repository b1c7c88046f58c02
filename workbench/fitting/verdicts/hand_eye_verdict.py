"""The verdict on a hand-eye calibration: its held-out errors against the corner noise and against tolerances."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robot_model.postures.task_priority import LEVER_MM
from sensors.hand_eye.checks.review import UNEXPLAINED
from sensors.hand_eye.result import HandEye
from workbench.fitting.verdicts.sensor_verdict import blurred_images, repeated_warnings
from workbench.fitting.verdicts.verdict import (
    Noise,
    Residual,
    Tolerance,
    Verdict,
    combine,
    is_far_above,
    judge,
)

_UNITS = ("mm", "deg", "px")
_UNITS_OF_KIND = {
    "ball-surface": ("mm",),
    "ball-centre": ("mm",),
    "external-point": ("mm",),
    "target-pose": ("mm", "deg"),
}
FROM_IMAGES = "from each image alone, without the robot"
FROM_PROFILES = "from each profile alone, without the robot"
# Images with tilted boards give the focal length to 0.5 % or better. At 5 % the distance of the board is as uncertain,
# and any scatter of the board may come from the camera.
_WEAK_FOCAL = 0.05
# Redundancy of P poses is 6 P - 12: below 8 poses the estimated errors of flange poses are uncertain by over 12 %.
_FEW_POSES = 8
_RADIUS_SIGMAS, _RADIUS_SHARE = 4.0, 0.005
# share of the position error below which a rotation error, at a lever of 200 mm, adds less than 0.1 % to its variance
_NEGLIGIBLE = 0.03
_REDUCE = "To reduce it, calibrate the arm, warm it up, and approach all poses from the same side."
_TURN = "turn the flange about a second axis, by 20 deg or more"
_TILT = "tilt the board against the camera by 20 to 45 deg"


def units_of(measures: str) -> tuple[str, ...]:
    """Units in which a kind of recording has errors that a tolerance can limit."""
    return _UNITS_OF_KIND.get(measures, _UNITS)


def handeye_verdict(run, tolerances: Sequence[Tolerance] = ()) -> Verdict:
    """Verdict on a `HandEyeRun`: scatter of the board in mm and deg and reprojection in px, or distance from the ball.

    The poses are those that the solve did not see. Without a board pose that is known well enough for held-out
    errors, those of the fit are judged.
    """
    hand_eye, causes = run.made, undetermined_causes(run)
    if hand_eye.radius is None:
        verdict = _boards(run, tolerances)
    elif run.is_of_external_points:
        verdict = _profiles(hand_eye, tolerances, "the measured points")
    else:
        verdict = _profiles(hand_eye, tolerances)
    suspected = [*suspicions(run), *_refused_camera(run)]
    if (
        suspected or not causes
    ):  # a mistake that is named is the likely reason why anything is undetermined
        return _with_suspicion(verdict, suspected)
    sentence = f"Not determined: {'; '.join(causes)}. {_undetermined_remedy(run)}."
    return replace(verdict, passed=False, sentence=sentence, parts=())


def _with_suspicion(verdict: Verdict, found: Sequence[str]) -> Verdict:
    """Not passed where a mistake in the data is suspected: the residual says nothing of its effect on the transform."""
    if not found:
        return verdict
    sentence = f"Do not use this result before this is checked: {found[0]}"
    return replace(verdict, passed=False, sentence=sentence)


def undetermined_causes(run) -> tuple[str, ...]:
    """Why the hand-eye transform or the camera is not determined; empty where both are.

    The estimated errors of the flange poses then have no meaning: the same residuals follow from another camera or
    another transform.
    """
    hand_eye, causes = run.made, []
    if not np.isfinite(hand_eye.covariance).all():
        causes += list(hand_eye.undetermined[:1]) or [
            "the transform has directions without an effect"
        ]
    focal = weak_focal(run.calibration)
    if focal is not None:
        causes.append(
            f"the images determine the focal length to {100 * focal:.2g} % only, because the board is nearly parallel "
            "to itself in all images or too few images show all of it"
        )
    return tuple(causes)


def weak_focal(calibration) -> float | None:
    """Relative standard deviation of the focal length where it is too large for a hand-eye calibration, else None.

    calibration: a `CameraCalibration` of the same images, None where the camera was given.
    """
    if calibration is None:
        return None
    share = math.sqrt(calibration.covariance[0, 0]) / calibration.camera.fx
    return None if share <= _WEAK_FOCAL else share


def is_refused_by(review, calibration) -> bool:
    """Whether the review of the data proves a mistake; a misfit without a cause proves none under a weak camera."""
    first = next((finding for finding in review.findings if finding.certain), None)
    if first is None:
        return False
    return first.cause != UNEXPLAINED or weak_focal(calibration) is None


def _undetermined_remedy(run) -> str:
    if run.board is None:
        return f"Measure more poses and {_TURN}"
    return f"Take more images: {_TURN}, {_TILT}, and keep all of the board in the image"


def _boards(run, tolerances) -> Verdict:
    hand_eye = run.made
    errors, label = _held_out(hand_eye)
    degrees = max(6 * len(hand_eye.poses) - 12, 1)
    rows = (
        ("centre_mm", "mm", "scatter of the estimated board position"),
        ("turn_deg", "deg", "scatter of the estimated board orientation"),
        ("rms_px", "px", "reprojection error"),
    )
    if run.is_of_target_poses:
        rows = (
            ("origin_mm", "mm", "scatter of the estimated target position"),
            ("turn_deg", "deg", "scatter of the estimated target orientation"),
        )
    noise = _noise(run)
    verdicts, is_above = [], False
    for key, unit, name in rows:
        residual = Residual(errors[key], unit, f"{label} RMS {name}", degrees)
        known = None if unit not in noise else Noise(noise[unit], FROM_IMAGES)
        part = judge(residual, known, tolerances)
        if _is_above(part, degrees):
            is_above = True
            part = replace(part, sentence=_above_noise(part))
        verdicts.append(part)
    combined = combine(verdicts)
    return (
        replace(combined, sentence=f"{combined.sentence} {_advice(hand_eye)}")
        if is_above
        else combined
    )


def _is_above(part: Verdict, degrees: int) -> bool:
    return part.residual_over_noise is not None and is_far_above(part.residual_over_noise, degrees)


def _above_noise(part: Verdict) -> str:
    """The error, and what the images alone would leave: a comparison of two sources, not a fault."""
    conclusion = part.sentence.partition("; ")[0]
    return f"{conclusion}; the images alone leave {part.noise:.3g} {part.unit}."


def _noise(run) -> dict[str, float]:
    """By unit, what the corner noise makes of each error; without a review only that of the corners is known."""
    if run.is_of_target_poses:
        return {}
    if run.review is None:
        return {"px": math.sqrt(2) * run.made.noise}
    noise = run.review.noise
    return {"mm": noise.middle_mm, "deg": noise.rotation_deg, "px": math.sqrt(2) * noise.sigma_px}


def _held_out(hand_eye: HandEye):
    if math.isfinite(hand_eye.held_out["turn_deg"]):
        return hand_eye.held_out, "held-out"
    return hand_eye.fit, "fitted"


def _advice(hand_eye: HandEye) -> str:
    if hand_eye.dependence is not None:
        return "The rest does not come from the flange poses alone: a warning names another cause."
    is_misfit = hand_eye.misfit is not None and hand_eye.misfit.significant
    them = "it and for the errors that images share" if is_misfit else "it"
    return (
        f"The rest comes from the flange poses, whose {flange_error_words(hand_eye.robot_sigma)}; "
        f"the stated uncertainty of the transform accounts for {them}. {_REDUCE}"
    )


def flange_error_words(robot_sigma) -> str:
    """The estimated RMS errors of the flange poses at the flange's origin, in words.

    Position and rotation are estimated jointly. Where neither is distinguishable from zero although the board scatters,
    the poses do not separate them.
    """
    place, rotation = flange_errors(robot_sigma)
    if not (place or rotation):
        at_board = math.sqrt(3) * robot_sigma["position_mm"]
        return (
            f"position and rotation errors are not separable in these poses; together they displace the board by "
            f"{at_board:.2g} mm RMS"
        )
    std = math.sqrt(3) * robot_sigma.get("flange_position_std_mm", 0.0)
    position = f"{place:.2g} ± {std:.2g} mm" if std else f"{place:.2g} mm"
    position += " (3-D position of the flange's origin)"
    if not place:
        limit = math.sqrt(2) * std  # two standard deviations of the variance
        position = f"no position error that is distinguishable from zero (less than {limit:.2g} mm)"
    return f"estimated RMS errors are {position} and {rotation_error_words(place, rotation)}"


def rotation_error_words(place: float, rotation: float) -> str:
    """The RMS rotation error (deg) of flange poses whose position error is `place` (mm), in words.

    A variance that is estimated at its lower bound says no more than that rotations explain nothing beyond positions.
    """
    if not is_rotation_seen(place, rotation):
        return "no rotation error that is distinguishable from zero"
    return f"{rotation:.2g} deg (angle of the rotation)"


def is_rotation_seen(place: float, rotation: float) -> bool:
    """Whether a rotation error (deg) displaces a point 200 mm away by more than 3 % of `place` (mm)."""
    return LEVER_MM * math.radians(rotation) > _NEGLIGIBLE * place


def flange_errors(robot_sigma) -> tuple[float, float | None]:
    """RMS error of the flange poses: 3-D distance (mm) and angle of the rotation (deg), None where it is not estimated.

    robot_sigma: 1 sigma of one coordinate (`position_mm`) and of the rotation about one axis (`rotation_deg`); of a
    board those at the flange's origin (`flange_position_mm`, `flange_rotation_deg`), 0 where not distinguishable from
    zero.
    """
    place = robot_sigma.get("flange_position_mm", robot_sigma["position_mm"])
    rotation = robot_sigma.get("flange_rotation_deg", robot_sigma.get("rotation_deg"))
    return math.sqrt(3) * place, None if rotation is None else math.sqrt(3) * rotation


def _profiles(
    hand_eye: HandEye, tolerances, measured_points: str = "the points from the ball"
) -> Verdict:
    """Verdict on distances in mm; measured_points: the points whose distances they are."""
    value = hand_eye.held_out["rms_mm"]
    label = "held-out" if math.isfinite(value) else "fitted"
    value = value if math.isfinite(value) else hand_eye.fit["rms_mm"]
    residual = Residual(value, "mm", f"{label} RMS distance of {measured_points}")
    verdict = judge(residual, Noise(hand_eye.noise, FROM_PROFILES), tolerances)
    if not _is_above(verdict, len(hand_eye.poses)):
        return verdict
    conclusion = verdict.sentence.partition("; ")[0]
    return replace(
        verdict,
        sentence=f"{conclusion}; the profiles alone leave {hand_eye.noise:.3g} mm. {_excess_cause(hand_eye)}",
    )


def _excess_cause(hand_eye: HandEye) -> str:
    """Cause to which the model attributes the distances beyond the noise of the profiles, and what to do."""
    place, _ = flange_errors(hand_eye.robot_sigma)
    radius = hand_eye.robot_sigma.get("radius_mm", 0.0)
    if radius > place:
        return (
            f"The rest is mostly an error of the radius of the circles (1 sigma {radius:.2g} mm; flange poses "
            f"{place:.2g} mm RMS): check the radius of the ball, the scale of the profiler and its outliers."
        )
    return (
        f"The rest comes from the flange poses, whose estimated RMS error is {place:.2g} mm (3-D position); the stated "
        f"uncertainty of the transform accounts for it. {_REDUCE}"
    )


def handeye_warnings(run) -> list[str]:
    """Warnings about a hand-eye result: suspected mistakes, unidentifiable parameters, blurred or rejected images."""
    hand_eye, causes = run.made, undetermined_causes(run)
    left_out = [
        f"{name if run.board is None else f'image {name}'}: {row.why}"
        for name, row in zip(run.names, hand_eye.poses)
        if row.outlier
    ]
    open_ones = [f"undetermined: {'; '.join(causes)}; {_lower(_undetermined_remedy(run))}"]
    return [
        *suspicions(run),
        *repeated_warnings(run.camera_trust, "camera"),
        *(open_ones if causes else []),
        *([] if causes or hand_eye.dependence is None else [_dependence(hand_eye)]),
        *_misfit(run),
        *_few_poses(run),
        *blurred_images(run.views),
        *left_out,
    ]


def _dependence(hand_eye: HandEye) -> str:
    sentence = hand_eye.dependence.sentence
    return f"{sentence[0].upper()}{sentence[1:]}"


def _refused_camera(run) -> list[str]:
    """Warnings of a camera from a file whose calibration was refused; none of one that can be used."""
    trust = run.camera_trust
    return [] if trust is None or trust.usable else repeated_warnings(trust, "camera")


def _misfit(run) -> list[str]:
    """Errors that images share and that limit the result.

    Where the transform is undetermined, its residuals say nothing of them.
    """
    misfit = run.made.misfit
    if undetermined_causes(run):
        return []
    return [] if misfit is None or not misfit.is_relevant else [misfit.sentence]


def suspicions(run) -> tuple[str, ...]:
    """Suspected mistakes; a misfit without a known cause is none where camera or hand-eye is undetermined."""
    if not undetermined_causes(run):
        return tuple(run.made.suspicions) or _wrong_radius(run)
    findings = run.review.findings if run.review is not None else ()
    unexplained = [finding.sentence for finding in findings if finding.cause == UNEXPLAINED]
    return tuple(suspicion for suspicion in run.made.suspicions if suspicion not in unexplained)


def _wrong_radius(run) -> tuple[str, ...]:
    """A sentence where profiles show a ball whose radius differs from the certified one by 4 sigma and 0.5 %."""
    if run.free is None:
        return ()
    radius, certified = run.free.radius, run.made.radius
    std = run.free.std.get("target.radius") or math.inf
    if abs(radius - certified) < max(_RADIUS_SIGMAS * std, _RADIUS_SHARE * certified):
        return ()
    return (
        f"the profiles show a ball of radius {radius:.4g} mm (standard deviation {std:.2g} mm), and the certified "
        f"radius is {certified:g} mm: the error displaces sensor and ball; correct the radius in artefact.csv, or the "
        "scale of the profiler",
    )


def undetermined(run) -> list[str]:
    """Unidentifiable parameters of transform, board and camera, the causes first."""
    causes = undetermined_causes(run)
    return [*causes, *(cause for cause in run.made.undetermined if cause not in causes)]


def robot_sigma(run) -> dict[str, float | None]:
    """Estimated 1 sigma of the flange poses; None where camera or hand-eye is undetermined."""
    known = not undetermined_causes(run)
    return {key: value if known else None for key, value in run.made.robot_sigma.items()}


def _few_poses(run) -> list[str]:
    used = sum(not row.outlier for row in run.made.poses)
    has_target = run.board is not None or run.is_of_target_poses
    if not has_target or used >= _FEW_POSES:
        return []
    return [
        f"only {used} poses: {6 * used} robot coordinates stand against 12 unknowns of camera and target, so that a "
        f"faulty pose is hard to recognise and the uncertainties are rough; take at least {_FEW_POSES} poses, better 15"
    ]


def _lower(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:]
