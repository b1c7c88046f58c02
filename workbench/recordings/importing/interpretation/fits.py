"""How well a robot fits a recording under each of several readings of its columns (units, rotation convention).

All readings are fitted with base and tool alone; the best ones with plausible geometry errors too, by the robust fit
of the plausibility check. Two readings are compared by the log posterior of that fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datasets.importers.mapping.model import Group
from datasets.recording import Recording
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility.check import good_scale
from workbench.fitting.plausibility.fitting import fit_recording, hopeless_mm, nominal_scales
from workbench.fitting.plausibility.sampling import even_rows

_ROWS = 100
_USUAL = 6
_WINDOW = 20.0
_DECISIVE_LOG = 20.0
_DECISIVE_RATIO = 1.25
_MANY_STEPS = 40
_LEAST_SCALE = 0.005  # mm: differences below are rounding


@dataclass(frozen=True)
class CandidateFit:
    """The fit of one reading: RMS of the best 90 % of rows, `scale` mm of both together, and how improbable it is."""

    title: str
    rms_mm: float
    rms_deg: float
    scale: float
    improbability: float
    is_good: bool

    @property
    def words(self) -> str:
        """In words: "intrinsic XYZ in degrees: 0.77 mm, 0.10 deg"."""
        turn = "" if np.isnan(self.rms_deg) else f", {self.rms_deg:.2g} deg"
        return f"{self.title}: {self.rms_mm:.3g} mm{turn}"

    def as_json(self) -> dict:
        """The entry under `conventions` of the answer."""
        degrees = None if np.isnan(self.rms_deg) else self.rms_deg
        return {"name": self.title, "rms_mm": self.rms_mm, "rms_deg": degrees}

    def clearly_beats(self, other: "CandidateFit") -> bool:
        """Whether the data decide against another reading: it is far less probable, and fits visibly worse."""
        mine = max(self.scale, _LEAST_SCALE)
        its = max(other.scale, _LEAST_SCALE)
        is_worse = its > _DECISIVE_RATIO * mine
        return is_worse and other.improbability - self.improbability > _DECISIVE_LOG


def compare_readings(
    robot: Robot,
    readings: Sequence[tuple[str, Recording]],
    refined: int = 8,
    is_good_only: bool = False,
) -> list[tuple[int, CandidateFit]]:
    """Index and fit of the readings worth comparing, the most probable first.

    readings: title and recording of each, all of the same rows, the usual ones first. Readings whose misfit with
    the nominal geometry is `_WINDOW` times the least one are left out. is_good_only: as are those that no plausible
    geometry errors make fit. Empty where no reading can be fitted.
    """
    thinned = [(title, reading.select(even_rows(reading, _ROWS))) for title, reading in readings]
    quick = nominal_scales([(robot, reading) for _, reading in thinned])
    order = [k for k in np.argsort(quick, kind="stable") if np.isfinite(quick[k])]
    if not order:
        return []
    usual = [k for k in range(min(_USUAL, refined)) if k in order[refined:]]
    limit = _WINDOW * max(quick[order[0]], 1.0)
    if is_good_only:
        limit = min(limit, max(hopeless_mm(robot, thinned[k][1]) for k in order))
    retained = [k for k in (*order[:refined], *usual) if quick[k] <= limit]
    fitted = []
    for k in retained:
        fit = _refined(robot, *thinned[k])
        if fit is not None:
            fitted.append((int(k), fit))
    return sorted(fitted, key=lambda item: item[1].improbability)


def is_only_good(fits: Sequence[tuple[int, CandidateFit]]) -> bool:
    """Whether the first of the fits, the most probable first, is good and clearly beats all others."""
    return (
        bool(fits) and fits[0][1].is_good and all(fits[0][1].clearly_beats(f) for _, f in fits[1:])
    )


def order_error(file: str, group: Group, fit: CandidateFit, line: str) -> InputError:
    """The error for rotation columns whose values stand in the order of `group`; line: of a mapping that says so."""
    order = ", ".join(f"'{name}'" for name in group.columns)
    return InputError(
        f"{file}, columns {', '.join(sorted(group.columns))}: expected values in the order that the names of the "
        f"columns state, found none that fits in that order, but {fit.words} in the order {order}; correct the "
        f"headers, or add {line} to a mapping file and name it with --map."
    )


def _refined(robot: Robot, title: str, reading: Recording) -> CandidateFit | None:
    try:
        fit = fit_recording(robot, reading)
        good = good_scale(robot, reading)
        if good < fit.core < 20 * good:
            fit = fit_recording(robot, reading, fit.parameters.values, steps=_MANY_STEPS)
    except (np.linalg.LinAlgError, InputError):
        return None
    if not np.isfinite(fit.scale):
        return None
    return CandidateFit(
        title,
        fit.position_mm,
        fit.rotation_deg,
        fit.scale,
        fit.improbability,
        bool(fit.core <= good),
    )
