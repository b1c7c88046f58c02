"""Fit of a robot to a recording under each interpretation of its columns (units, rotation convention).

All readings are fitted with base and tool alone; the best ones with plausible geometry errors too, by the robust fit
of the plausibility check. Two readings are compared by the log posterior of that fit. Points that an instrument
measured are as wide as the motion of the arm: their misfit counts in relation to their scatter, because a unit that
makes the points small makes their misfit small too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datasets.importers.mapping.model import Group
from datasets.recording import Recording
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import (
    EXPLAINED,
    fit_recording,
    flange_scatter,
    nominal_scales,
    reach_of,
    scatter_of_points,
    unexplainable_misfit_mm,
)
from workbench.fitting.plausibility.good_fit import good_scale
from workbench.fitting.plausibility.sampling import even_rows

_ROWS = 100
_USUAL = 6
_WINDOW = 20.0
_DECISIVE_LOG = 20.0
_DECISIVE_RATIO = 1.25
_MANY_STEPS = 40
_MOST_OF_REACH = 1.5
_LEAST_SCALE = 0.005  # mm: differences below are rounding
AS_WIDE_AS_THE_ARM = ("external-point", "external-pose", "partial-pose")
"""Kinds of measurement whose points scatter as far as the arm moves."""


@dataclass(frozen=True)
class CandidateFit:
    """The fit of one reading: RMS of the best 90 % of rows, `scale` mm of both together, and how improbable it is.

    `scatter_mm`: of the measured points under this reading; nan where the points are not as wide as the arm's motion.
    """

    title: str
    rms_mm: float
    rms_deg: float
    scale: float
    improbability: float
    is_good: bool
    scatter_mm: float = np.nan

    @property
    def explains(self) -> bool:
        """Whether the misfit is far below the scatter of the points, whatever the accuracy of the arm."""
        return bool(self.share <= EXPLAINED)

    @property
    def share(self) -> float:
        """Misfit as a share of the scatter of the points; nan where these are not as wide as the arm's motion."""
        return self.scale / self.scatter_mm

    @property
    def share_words(self) -> str:
        """ ", 12 % of the scatter of the points, where ..."; "" without a scatter."""
        if np.isnan(self.scatter_mm):
            return ""
        limit = f"at most {100 * EXPLAINED:g} % are accepted"
        return f", {100 * self.share:.2g} % of the scatter of the points, where {limit}"

    @property
    def words(self) -> str:
        """In words: "intrinsic XYZ in degrees: 0.77 mm, 0.10 deg"."""
        turn = "" if np.isnan(self.rms_deg) else f", {self.rms_deg:.2g} deg"
        return f"{self.title}: {self.rms_mm:.3g} mm{turn}"

    def as_json(self) -> dict:
        """The entry under `conventions` of the answer."""
        degrees = None if np.isnan(self.rms_deg) else self.rms_deg
        return {"name": self.title, "rms_mm": self.rms_mm, "rms_deg": degrees}

    @property
    def relative_misfit(self) -> float:
        """Misfit in relation to the scatter of the points; in mm where they are not as wide as the arm's motion."""
        return max(self.scale, _LEAST_SCALE) / _unit_of_misfit(self.scatter_mm)

    def clearly_beats(self, other: "CandidateFit") -> bool:
        """Whether the data decide against another reading: it is far less probable, and fits visibly worse."""
        is_worse = other.relative_misfit > _DECISIVE_RATIO * self.relative_misfit
        return is_worse and other.improbability - self.improbability > _DECISIVE_LOG


def compare_readings(
    robot: Robot,
    readings: Sequence[tuple[str, Recording]],
    refined: int = 8,
    is_good_only: bool = False,
) -> list[tuple[int, CandidateFit]]:
    """Index and fit of the readings worth comparing, the most probable first.

    readings: title and recording of each, all of the same rows, the usual ones first. Readings whose misfit with
    the nominal geometry, in relation to the scatter of the points, is `_WINDOW` times the least one are left out, as
    are those with points far beyond the reach of the arm where others have none. is_good_only: as are those that no
    plausible geometry errors make fit. Empty where no reading can be fitted.
    """
    thinned = [(title, reading.select(even_rows(reading, _ROWS))) for title, reading in readings]
    units = np.array([_unit_of_misfit(_scatter(robot, reading)) for _, reading in thinned])
    quick = np.array(nominal_scales([(robot, reading) for _, reading in thinned])) / units
    is_beyond_reach = np.array([_is_beyond_reach(robot, reading) for _, reading in thinned], bool)
    if np.isfinite(quick[~is_beyond_reach]).any():
        quick[is_beyond_reach] = np.inf
    order = [k for k in np.argsort(quick, kind="stable") if np.isfinite(quick[k])]
    if not order:
        return []
    usual = [k for k in range(min(_USUAL, refined)) if k in order[refined:]]
    limit = _WINDOW * max(quick[order[0]], 1.0 / units[order[0]])
    retained = [k for k in (*order[:refined], *usual) if quick[k] <= limit]
    if is_good_only:
        retained = [
            k
            for k in retained
            if quick[k] * units[k] <= unexplainable_misfit_mm(robot, thinned[k][1])
        ]
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
    scatter = _scatter(robot, reading)
    # the noise counts in units of the points, whose prior knows no unit
    improbability = fit.improbability - fit.degrees * np.log(_unit_of_misfit(scatter))
    is_good = fit.core <= good and not fit.core > EXPLAINED * scatter
    return CandidateFit(
        title, fit.position_mm, fit.rotation_deg, fit.scale, improbability, bool(is_good), scatter
    )


def _scatter(robot: Robot, recording: Recording) -> float:
    """mm of the measured points; nan where they are not as wide as the arm's motion.

    Of touches, which measure no coordinates, that of the flange: readings that hardly move the arm fit any of them.
    """
    if recording.measures == "touch-point":
        return max(flange_scatter(robot, recording), 1e-9)
    if recording.measures not in AS_WIDE_AS_THE_ARM:
        return np.nan
    return scatter_of_points(recording)


def _is_beyond_reach(robot: Robot, recording: Recording) -> bool:
    """Whether the points scatter so far that the target is farther from the flange than the arm is long.

    If few joints move, such points fit as well as others: they are then places of a very long tool.
    """
    scatter = _scatter(robot, recording)
    return bool(scatter > _MOST_OF_REACH * reach_of(robot, recording))


def _unit_of_misfit(scatter_mm: float) -> float:
    """The length that a misfit counts in relation to: the scatter, 1 mm where there is none."""
    return 1.0 if np.isnan(scatter_mm) else scatter_mm
