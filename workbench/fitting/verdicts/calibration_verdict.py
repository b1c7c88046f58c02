"""The verdict of the commands that calibrate a robot: held-out errors against noise and tolerances."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from robot_model.measurements.ball_scan import FILE_KIND
from workbench.fitting.plausibility.hypotheses.corrections import listed
from workbench.fitting.verdicts.noise_report import DIAGNOSE, TOO_FEW, NoiseReport, is_above
from workbench.fitting.verdicts.residual_structure import ORDER
from workbench.fitting.verdicts.verdict import (
    STATED,
    Noise,
    Residual,
    Tolerance,
    Verdict,
    combine,
    is_far_above,
    judge,
)

_ORIENTED = ("external-pose", "partial-pose")
POSITION, ORIENTATION = "held-out RMS position error", "held-out RMS orientation error"
_PLACES = {"base": "the instrument or the base", "tool": "the reflector, sensor or tool"}
_LEAST_SHARE = 1 - 1 / 1.1**2  # of a mean square, without which its root falls by a tenth
_MOVED = 0.5  # share of the test error that remains once the part that moved is estimated on the test samples


@dataclass(frozen=True)
class _Quantity:
    """One judged quantity: held-out value, its noise, and the fit, raw (`fit`) and per degree of freedom (`corrected`).

    All in `unit`; `fit` and `corrected` nan where unknown. `is_above`: whether the fit exceeds the noise, None where
    no noise is known. `degrees` of freedom of the held-out mean square. `refitted`: errors of named test samples with
    the base, or the tool, estimated on them; None where the held-out error is of folds.
    """

    name: str
    unit: str
    held_out: float
    noise: Noise | None
    fit: float
    corrected: float
    is_above: bool | None
    degrees: float
    refitted: Mapping[str, float] | None = None


WITHIN_SCANS = "scatter of the points within the scans"
ONE_NUMBER = {
    "ball-surface": "distances of the measured points from the ball",
    "plane-touch": "distances of the tip from the plane",
    "distance": "errors of the lengths",
}


def remark_on_kind(measures: str) -> str:
    """What the errors of a recording are whose samples are one number each; "" for all other kinds."""
    if measures not in ONE_NUMBER:
        return ""
    meaning = f"These errors are {ONE_NUMBER[measures]}: one number for each sample."
    if measures == FILE_KIND:
        meaning = (
            "A sample is a scan: the points of one ball in one pose. Its error is the RMS distance of these points "
            "from the ball, without the noise of single points."
        )
    return f"{meaning} The 3-D error of the arm may be larger."


def with_doubts(verdict: Verdict, suspicions: Sequence[str], trust_data: bool = False) -> Verdict:
    """The verdict on a recording in which a mistake is suspected, which the warnings of the calibration state.

    It fails, unless the user states by trust_data that the data are right.
    """
    if not suspicions:
        return verdict
    sentence = (
        "But the recording is in doubt: read the warning first. `workbench compensate` refuses this calibration "
        "until its cause is corrected."
    )
    doubtful = with_remark(verdict, sentence)
    return doubtful if trust_data else replace(doubtful, passed=False)


def units_of(measures: str) -> tuple[str, ...]:
    """Units of the tolerances that a calibration of this kind of recording can judge; the first is the default."""
    return ("mm", "deg") if measures in _ORIENTED else ("mm",)


def calibration_verdict(
    held_out: Mapping, report: NoiseReport, tolerances: Sequence[Tolerance] = ()
) -> Verdict:
    """The verdict on the held-out errors of a calibration.

    held_out: the block of the JSON contract (`rms_mm`, and `rotation_rms_deg` where poses are measured). It fails where
    a tolerance is exceeded, and where the report of the noise raises an alarm.
    """
    verdicts = [_held_out_verdict(_position(held_out, report), tolerances, report.advice)]
    if "rotation_rms_deg" in held_out or any(tolerance.unit == "deg" for tolerance in tolerances):
        verdicts.append(
            _held_out_verdict(_orientation(held_out, report), tolerances, report.advice)
        )
    verdict = with_remark(combine(verdicts), carrying_samples(held_out))
    verdict = with_remark(verdict, _structure_of_unknown_noise(report))
    return _failed(verdict) if report.alarms else verdict


def _structure_of_unknown_noise(report: NoiseReport) -> str:
    """That a relevant part of a residual whose noise is not known is no noise; "" elsewhere."""
    structure = report.findings.structure
    if report.known_rms or structure is None or not structure.found:
        return ""
    if structure.share < _LEAST_SHARE:
        return ""
    moved = ""
    if ORDER in structure.depends_on:
        moved = ", as of an instrument, a target, a load or a base that changed"
    return (
        f"At least {100 * structure.share:.0f} % of the mean square that the fit leaves is no noise: it depends on "
        f"{listed(structure.depends_on)}{moved}; {DIAGNOSE}."
    )


def carrying_samples(held_out: Mapping) -> str:
    """A sentence where few samples make half of the held-out mean square error; "" elsewhere."""
    numbers = held_out.get("carried_by", ())
    if not numbers:
        return ""
    noun, verb = ("sample", "makes") if len(numbers) == 1 else ("samples", "make")
    return (
        f"{len(numbers)} of {held_out['samples']} samples ({noun} {listed(numbers)}) {verb} half of its "
        f"mean square: without {'it' if len(numbers) == 1 else 'them'} the others determine the model worse there. The "
        f"median error is {held_out['median_mm']:.3g} mm."
    )


def with_remark(verdict: Verdict, sentence: str) -> Verdict:
    """The verdict with one more sentence, which changes nothing else; sentence: "" for none."""
    if not sentence:
        return verdict
    capital = sentence[0].upper() + sentence[1:]
    return replace(verdict, sentence=f"{verdict.sentence} {capital}")


def with_sensor(verdict: Verdict, sensor: Mapping | None) -> Verdict:
    """Not passed where ball centres come from a sensor whose own result is refused; sensor: its part of the JSON."""
    if sensor is None or sensor["verdict"]["pass"] is not False:
        return verdict
    sentence = (
        f"{verdict.sentence} Do not use this result: the ball centres that it rests on are refused."
    )
    return replace(verdict, passed=False, sentence=sentence)


def _failed(verdict: Verdict) -> Verdict:
    """The same as a failure: parameters that are not to be trusted meet no tolerance."""
    sentence = f"{verdict.sentence} Do not use this result: its parameters are not to be trusted."
    return replace(verdict, passed=False, sentence=sentence)


def _position(held_out: Mapping, report: NoiseReport) -> _Quantity:
    found = report.findings
    return _Quantity(
        POSITION,
        "mm",
        held_out["rms_mm"],
        _noise(report),
        found.rms,
        math.sqrt(found.components) * found.residual_rms,
        report.is_above if report.known_rms else report.is_above_scatter,
        found.components * found.samples,
        held_out.get("refitted_mm"),
    )


def _orientation(held_out: Mapping, report: NoiseReport) -> _Quantity:
    stated, found = report.findings.rotation, report.findings
    known = stated is not None
    return _Quantity(
        ORIENTATION,
        "deg",
        held_out.get("rotation_rms_deg", math.nan),
        Noise(stated.stated_rms_deg, STATED) if known else None,
        stated.fit_rms_deg if known else math.nan,
        stated.stated_rms_deg * stated.test.factor if known else math.nan,
        is_above(stated.test) if known else None,
        found.components * found.samples,
    )


def _held_out_verdict(quantity: _Quantity, tolerances: Sequence[Tolerance], advice: str) -> Verdict:
    """The verdict on a held-out error: the fit's own test says nothing about poses that the fit did not see."""
    overfitted = _too_few_poses(quantity)
    residual = Residual(
        quantity.held_out,
        quantity.unit,
        quantity.name,
        is_significant=_is_above(quantity, overfitted),
    )
    verdict = judge(residual, quantity.noise, tolerances, overfitted or advice)
    if quantity.noise is None and overfitted:
        return replace(verdict, sentence=f"{verdict.sentence[:-1]}; {overfitted}.")
    return verdict


def _is_above(quantity: _Quantity, overfitted: str) -> bool | None:
    """Whether the held-out error exceeds the noise; None where no noise is known."""
    if quantity.noise is None or quantity.is_above is None:
        return None
    return quantity.is_above or bool(overfitted)


def _too_few_poses(quantity: _Quantity) -> str:
    """Sentence on a held-out error that is significantly above both the noise and the fit error; else ''."""
    noise = quantity.noise.value if quantity.noise else 0.0
    expected = max(quantity.corrected, noise)
    if not expected > 0 or not math.isfinite(quantity.held_out):
        return ""
    ratio = quantity.held_out / expected
    if ratio < TOO_FEW or not is_far_above(ratio, quantity.degrees):
        return ""
    errors = (
        f"fit {quantity.fit:.2g} {quantity.unit}, held out {quantity.held_out:.2g} {quantity.unit}"
    )
    if quantity.refitted is None:
        return (
            f"too few poses for this model: {errors}; measure more poses, spread over the range of "
            "every joint"
        )
    return _unlike_tests(quantity, errors)


def _unlike_tests(quantity: _Quantity, errors: str) -> str:
    """Why named test samples fit worse than the fitted ones: something moved, or they were measured differently."""
    moved = [
        f"{_PLACES[name]} ({error:.2g} mm with it estimated on them)"
        for name, error in quantity.refitted.items()
        if error < _MOVED * quantity.held_out
    ]
    if moved:
        return (
            f"between the fitted and the test samples {' or '.join(moved)} has moved: {errors}; "
            "give a remounted reflector another number in the column reflector and fit both parts together; after a "
            "moved instrument, fit each part alone"
        )
    return (
        f"the test samples do not agree with the fitted ones: {errors}; there are too few poses, or the test samples "
        "were measured with another load, in other ranges of the joints, or on a changed arm"
    )


def _noise(report: NoiseReport) -> Noise | None:
    """Noise of the distance: as stated, else from replicates, else from the scatter within scans, else not known."""
    if report.known_rms is not None:
        return Noise(*report.known_rms)
    within_scans = report.findings.within_scans
    return Noise(within_scans, WITHIN_SCANS) if within_scans else None
