"""Groups of rows with a mistake in common: readings in another unit, lost minus signs, another tool or station."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from datasets.importers.units import ANGLES
from datasets.samples.columns import POINT, joint_columns
from workbench.fitting.plausibility.fitting import (
    FAILURES,
    POSITION,
    Fit,
    base_patterns,
    fit_recording,
    model_at,
    row_mismatch,
    tool_patterns,
)

MIN_SHARE = 0.7
"""Share of the rows of a group that have to fit under the common mistake."""
_LEAST_ROWS = 8
_EQUAL_RATIO = 2.0
"""Base and tool that leave mismatches within this factor explain a displacement about equally well."""
_STEPS = 30
_REMAINING = 0.1
"""Share of a displacement that a common motion of the rows leaves at most."""
_UNITS = ("rad", "gon")


@dataclass(frozen=True)
class Reason:
    """Why rows are outliers: a part of a sentence, the cause in one term, and whether the rows prove it."""

    sentence: str
    cause: str
    is_specific: bool = True


def readings_in_other_unit(robot, recording, fit: Fit, rows, tolerance: float) -> Reason | None:
    """The rows fit if their joint readings are in another unit of angle: exports with different units were joined.

    rows: numbers of the outlying rows. tolerance: mismatch in mm below which a row fits.
    """
    names = [name for name in joint_columns(recording.columns) if name.endswith("_deg")]
    for unit in _UNITS:
        scaled = {name: ANGLES[unit] * recording.columns[name] for name in names}
        if _share_fitting(robot, recording, scaled, fit, rows, tolerance) > MIN_SHARE:
            return Reason(
                f"their joint readings fit in the unit {unit} instead of deg, so that units are mixed",
                "joint-unit",
            )
    return None


def lost_signs(robot, recording, fit: Fit, rows, tolerance: float) -> Reason | None:
    """The rows fit with the opposite sign in one column: minus signs were lost, or added."""
    points = [name for name in POINT if name in recording.columns]
    for name in (*joint_columns(recording.columns), *points):
        reversed_column = {name: -recording.columns[name]}
        if _share_fitting(robot, recording, reversed_column, fit, rows, tolerance) > MIN_SHARE:
            signs = np.sign(recording.columns[name])
            one_sign = (signs >= 0).all() or (signs <= 0).all()
            lost = "; the column has no value of the other sign at all" if one_sign else ""
            cause = "axis-sign" if name in points else "joint-sign"
            return Reason(
                f"they fit with the opposite sign in column {name}: signs were lost or added{lost}",
                cause,
            )
    return None


def interchanged_columns(robot, recording, fit: Fit, rows, tolerance: float) -> Reason | None:
    """The rows fit with two columns interchanged: exports with different orders of columns were joined."""
    points = [name for name in POINT if name in recording.columns]
    joints = joint_columns(recording.columns)
    for a, b in (*combinations(points, 2), *combinations(joints, 2)):
        exchanged = {a: recording.columns[b], b: recording.columns[a]}
        if _share_fitting(robot, recording, exchanged, fit, rows, tolerance) > MIN_SHARE:
            return Reason(
                f"they fit if columns {a} and {b} are interchanged: the order of columns is mixed",
                "axis-order" if a in points else "joint-order",
            )
    return None


def _share_fitting(robot, recording, columns, fit: Fit, rows, tolerance: float) -> float:
    """Share of the rows that fit with other values in some columns."""
    if len(rows) < 2:
        return 0.0
    changed = replace(recording, columns={**recording.columns, **columns})
    return float((row_mismatch(robot, changed, fit)[rows] < tolerance).mean())


def another_frame(robot, recording, fit: Fit, rows, tolerance: float) -> Reason | None:
    """The rows, or those of one half of the time, fit with another base or another tool: not proven to be a mistake.

    A second station of the instrument and a second tool displace rows rigidly, in the frame of the base or of the
    flange; gross errors do not.
    """
    mismatch = _mismatch_where_known(robot, recording, fit)
    for part in (rows, *np.array_split(rows, 2)):
        if len(part) < _LEAST_ROWS:
            continue
        limit = max(tolerance, _REMAINING * float(np.median(mismatch[part])))
        refitted = {
            place: _refitted(robot, recording.select(part), fit, place) for place in _PLACES
        }
        smallest = min(float(np.median(mismatches)) for mismatches in refitted.values())
        places = [
            place
            for place, mismatches in refitted.items()
            if (mismatches < limit).mean() > MIN_SHARE
            and np.median(mismatches) <= _EQUAL_RATIO * smallest
        ]
        if places:
            ids = recording.sample_ids[part]
            if len(part) == len(rows):
                subject = "they"
            else:
                subject = f"samples {ids[0]} to {ids[-1]} of them"
            found = ", or with ".join(_PLACES[place] for place in places)
            return Reason(
                f"{subject} fit with {found}; calibrate these rows separately", "moved", False
            )
    return None


def _mismatch_where_known(robot, recording, fit: Fit) -> np.ndarray:
    """(n,) mm: mismatch of the rows of the reflectors that a fit has; inf for others."""
    mismatch = np.full(recording.n, np.inf)
    known = np.arange(recording.n)
    if recording.measures == "external-point":
        keys = set(fit.parameters.keys)
        known = np.flatnonzero(
            [f"tool.reflector{number}_x" in keys for number in recording.reflector]
        )
    mismatch[known] = row_mismatch(robot, recording.select(known), fit)
    return mismatch


_PLACES = {
    "tool": "another point on the flange, as of another tool or target",
    "base": "another pose of the instrument or of the robot's base",
}


def _refitted(robot, part, fit: Fit, place: str) -> np.ndarray:
    """(n,) mismatch in mm of some rows with their own base or tool, all else as in the fit; inf where it fails."""
    patterns = base_patterns(part) if place == "base" else tool_patterns(part)
    if not patterns:
        return np.full(part.n, np.inf)
    try:
        own_parameters = fit_recording(robot, part).parameters
        common = dict(zip(fit.parameters.keys, fit.parameters.values))
        kept = [
            common.get(key, value) for key, value in zip(own_parameters.keys, own_parameters.values)
        ]
        values = np.where(own_parameters.matching(*patterns), own_parameters.values, kept)
        refitted = fit_recording(robot, part, values, free=patterns, steps=_STEPS)
        return row_mismatch(robot, part, refitted)
    except FAILURES:
        return np.full(part.n, np.inf)


@dataclass(frozen=True)
class Group:
    """A fit, the mismatch (n,) mm of all rows, inf for targets that it does not know, and the limit below which a
    row agrees."""

    fit: Fit
    mismatch: np.ndarray
    limit: float

    @property
    def rows(self) -> np.ndarray:
        """Numbers of the rows that agree."""
        return np.flatnonzero(self.mismatch < self.limit)


_LEAST_SHARE, _LEAST_DEGREES = 0.25, 24
_WINDOWS = 8
_WITH_TOOL = ("external-point", "external-pose", "partial-pose")
_AGREE = 3.0
"""Times the scale of a good fit: rows with a smaller mismatch agree."""


def largest_group(robot, recording, recorded: Fit, order: np.ndarray, good: float) -> Group | None:
    """The largest group of rows that one model fits, where no model fits most rows; None where it is small.

    A group begins as neighbouring rows, or as rows whose residuals are alike in the frame of the flange.
    recorded: fit of all rows. order: row numbers in order of time. good: scale in mm of a good fit.
    """
    starts = (*_windows(order), *_by_tool(robot, recording, recorded))
    groups = (_grown(robot, recording, rows, good) for rows in starts)
    found = [group for group in groups if group is not None]
    return max(found, key=lambda group: len(group.rows), default=None)


def _windows(order) -> Iterator[np.ndarray]:
    """Windows of neighbouring rows, of two lengths."""
    for count in (_WINDOWS // 2, _WINDOWS):
        yield from np.array_split(order, count)


def _by_tool(robot, recording, recorded: Fit) -> Iterator[np.ndarray]:
    """The rows on either side of the mean displacement of the tool, along its principal direction."""
    try:
        model, parameters = model_at(robot, recording, recorded.parameters.values)
    except FAILURES:
        return
    keys = [key for key in tool_patterns(recording) if key[-2] in "._"]
    if not keys or len(keys) % 3 or recording.measures not in _WITH_TOOL:
        return
    residual, rows = model.linearise(parameters.only(parameters.matching(*keys)))
    axes = rows[:, :POSITION].reshape(-1, 3, POSITION, recording.n).sum(0)
    displacements = np.einsum("abn,bn->na", axes, residual[:POSITION])
    displacements -= displacements.mean(0)
    axial = displacements @ np.linalg.svd(displacements, full_matrices=False)[2][0]
    yield np.flatnonzero(axial > 0)
    yield np.flatnonzero(axial <= 0)


def _grown(robot, recording, rows, good: float) -> Group | None:
    """The group of the rows that agree with a fit of some rows, fitted again; None where it is too small."""
    try:
        for _ in range(2):
            fit = fit_recording(robot, recording.select(np.sort(rows)))
            if not fit.core < good or fit.degrees < _LEAST_DEGREES / 2:
                return None
            mismatch = _mismatch_where_known(robot, recording, fit)
            rows = np.flatnonzero(mismatch < _AGREE * good)
    except FAILURES:
        return None
    is_large = len(rows) >= _LEAST_SHARE * recording.n and fit.degrees >= _LEAST_DEGREES
    if is_large:
        return Group(fit, mismatch, _AGREE * good)
    return None
