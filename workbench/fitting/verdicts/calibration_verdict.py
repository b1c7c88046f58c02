"""The verdict of the commands that calibrate a robot: held-out errors against noise and tolerances."""

import math
from collections.abc import Mapping, Sequence

from workbench.fitting.verdicts.noise_report import NoiseReport, is_above
from workbench.fitting.verdicts.verdict import (
    REPLICATES,
    STATED,
    Noise,
    Residual,
    Tolerance,
    Verdict,
    combine,
    judge,
)

_ORIENTED = ("external-pose", "partial-pose")
POSITION, ORIENTATION = "held-out RMS position error", "held-out RMS orientation error"


def units_of(measures: str) -> tuple[str, ...]:
    """Units of the tolerances that a calibration of this kind of recording can judge; the first is the default."""
    return ("mm", "deg") if measures in _ORIENTED else ("mm",)


def calibration_verdict(
    held_out: Mapping, report: NoiseReport, tolerances: Sequence[Tolerance] = ()
) -> Verdict:
    """The verdict on the held-out errors of a calibration.

    held_out: the block of the JSON contract (`rms_mm`, and `rotation_rms_deg` where poses are measured).
    """
    position = Residual(held_out["rms_mm"], "mm", POSITION, is_significant=report.is_above)
    verdicts = [judge(position, _noise(report), tolerances, report.advice)]
    turned = held_out.get("rotation_rms_deg")
    if turned is not None or any(one.unit == "deg" for one in tolerances):
        stated = report.findings.rotation
        far = None if stated is None else is_above(stated.test)
        noise = None if stated is None else Noise(stated.stated_rms_deg, STATED)
        value = math.nan if turned is None else turned
        orientation = Residual(value, "deg", ORIENTATION, is_significant=far)
        verdicts.append(judge(orientation, noise, tolerances, report.advice))
    return combine(verdicts)


def _noise(report: NoiseReport) -> Noise | None:
    """Noise of the distance, sqrt(components) times sigma: as stated, else from replicates, else not known."""
    found = report.findings
    components = found.components
    if found.stated is not None:
        return Noise(math.sqrt(components) * found.stated, STATED)
    if found.replicates is not None:
        return Noise(math.sqrt(components) * found.replicates.sigma, REPLICATES)
    return None
