"""All plausibility checks of one recording, in order."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import (
    FAILURES,
    Fit,
    fit_recording,
    row_mismatch,
)
from workbench.fitting.plausibility.good_fit import good_scale
from workbench.fitting.plausibility.joint_columns.coupled_drives import coupled_drives
from workbench.fitting.plausibility.joint_columns.random_errors import random_errors
from workbench.fitting.plausibility.joint_columns.rounding import (
    explains,
    joint_rounding,
    point_rounding,
)
from workbench.fitting.plausibility.joint_columns.small_mistakes import small_mistakes
from workbench.fitting.plausibility.misfit import (
    doubtful_columns,
    explained_suspicions,
    misfit_suspicions,
)
from workbench.fitting.plausibility.robot_files.far_geometry import (
    CAUSE,
    MAX_DEVIATION,
    OTHER_ROBOT,
    far_geometry,
)
from workbench.fitting.plausibility.robot_files.gravity_direction import (
    find_gravity,
    gravity_suspicion,
)
from workbench.fitting.plausibility.robot_files.stated_dimensions import dimension_suspicion
from workbench.fitting.plausibility.rows.change_points import (
    find_change_point,
    find_new_setup,
    time_order,
)
from workbench.fitting.plausibility.rows.outliers import (
    Outliers,
    find_outliers,
    named_samples,
    outlier_reason,
)
from workbench.fitting.plausibility.rows.row_groups import Reason, largest_group
from workbench.fitting.plausibility.rows.row_shifts import row_shift_suspicions
from workbench.fitting.plausibility.sampling import even_rows
from workbench.fitting.plausibility.stated_values import stated_value_suspicions
from workbench.fitting.plausibility.suspicion import POINT_ROUNDING, Suspicion
from workbench.fitting.plausibility.wording import change_point_sentence, listed

_ROWS, _MANY_STEPS = 240, 60
_FAR_FROM_GOOD = 3.0
"""Times a good fit: an error above it is no deflection, whatever the direction of gravity."""
_SIGMA_RATIO = 4.0
_LEAST_DEGREES = 30
_OF_GEOMETRY = (CAUSE, OTHER_ROBOT)
_COMPUTED_MM = (
    1e-9  # no instrument resolves less: smaller residuals are rounding errors of computed values
)
_LEAST_POSES = 4
_EFFECT = 3.0
_FAR_OF_LARGE_ERRORS = 5.0
"""Times the median mismatch, about 8 standard deviations, where errors of the arm make most of the mismatch."""
_MAJORITY, _NEARLY_ALL = 0.6, 0.9
_NOT_PROVEN = (
    "unexplained",
    "rows-shuffled",
    "sorted-column",
    "stuck-encoder",
    "copied-column",
    "constant-coordinate",
    "coordinate-values",
)
"""Causes of suspicions of a misfit that no fit confirms."""


def check_plausibility(robot, recording) -> tuple[Suspicion, ...]:
    """Possible mistakes of a recording, the most serious first; empty where nothing looks wrong.

    robot: the nominal arm. recording: its moving rows, one a sample (`robot_model.measurements.samples_of`).
    A recording that fits is checked in well under a second; the search for a mistake takes several seconds.
    """
    found = [*stated_value_suspicions(robot, recording)]
    if len(np.unique(recording.poses)) < _LEAST_POSES:
        return tuple(found)
    try:
        fit = fit_recording(robot, recording.select(even_rows(recording, _ROWS)))
        if np.isfinite(fit.scale):
            found += _gravity_or_fit(robot, recording, fit, good_scale(robot, recording))
            found += _of_drives(robot, recording, fit)
            if all(suspicion.cause == "unexplained" for suspicion in found):
                found = _suspicions_of(random_errors, robot, recording, fit) or found
    except (np.linalg.LinAlgError, InputError):
        pass  # too little data for any fit: the calibration says which parameters are undetermined
    if any(suspicion.cause == "rounding" for suspicion in found):  # larger than the stated noise
        found = [suspicion for suspicion in found if suspicion.cause != POINT_ROUNDING]
    return tuple(sorted(found, key=lambda suspicion: not suspicion.certain))


def _gravity_or_fit(robot, recording, fit: Fit, scale_of_good_fit) -> list[Suspicion]:
    """Suspicions from a fit; only the direction of gravity where another one explains a bad fit."""
    try:
        gravity = find_gravity(robot, recording, fit)
    except FAILURES:
        gravity = None
    if gravity is None or gravity.held_out_mm > _FAR_FROM_GOOD * scale_of_good_fit:
        return _fit_suspicions(robot, recording, fit, scale_of_good_fit)
    others = []
    if fit.core < scale_of_good_fit or gravity.held_out_mm > scale_of_good_fit:
        others = _fit_suspicions(robot, recording, fit, scale_of_good_fit)
    if any(suspicion.certain for suspicion in others):
        return others  # deflections that are estimated from wrong data say nothing
    return [gravity_suspicion(robot, gravity), *others]


def _of_drives(robot, recording, fit: Fit) -> list[Suspicion]:
    """Suspicions about the couplings of the robot file that the recording decides."""
    if fit.core > good_scale(robot, recording):
        return []
    return _suspicions_of(coupled_drives, robot, recording, fit)


def _suspicions_of(judge, robot, recording, fit: Fit) -> list[Suspicion]:
    """Suspicions of one check about a fit; none where the check is not applicable."""
    try:
        found = judge(robot, recording, fit)
    except FAILURES:
        return []
    return [] if found is None else [found]


def _fit_suspicions(robot, recording, fit: Fit, scale_of_good_fit) -> list[Suspicion]:
    if fit.core > scale_of_good_fit:
        fit = _converged(robot, recording, fit)
    if fit.core > scale_of_good_fit:
        return list(_badly_fitting(robot, recording, fit, scale_of_good_fit)) or small_mistakes(
            robot, recording, fit
        )
    if np.abs(fit.deviations).max(initial=0.0) > MAX_DEVIATION:
        # the data fit, but only with a geometry that no arm has: another explanation may need none of it
        found = explained_suspicions(robot, recording, fit, scale_of_good_fit)
        if found:
            return found
    found = list(_well_fitting(robot, recording, fit, scale_of_good_fit))
    mistakes = [] if found else small_mistakes(robot, recording, fit)
    if mistakes or any(suspicion.cause in _OF_GEOMETRY for suspicion in found):
        return mistakes or found  # a missing coupling or another robot changes lengths, too
    return [*found, *_suspicions_of(dimension_suspicion, robot, recording, fit)]


def _converged(robot, recording, fit: Fit) -> Fit:
    """The fit after many more steps: before data are called wrong, the reference has to be at its minimum."""
    chosen = recording.select(even_rows(recording, _ROWS))
    return fit_recording(robot, chosen, fit.parameters.values, steps=_MANY_STEPS)


def _well_fitting(robot, recording, fit: Fit, scale_of_good_fit) -> Iterator[Suspicion]:
    """Structure in the residuals of a recording most of whose rows fit."""
    named = f"samples.csv of recording '{recording.name}'"
    # unmodelled effects of a sound arm reach a few times the usual scale at single poses
    outliers = find_outliers(robot, recording, fit, floor=_EFFECT * scale_of_good_fit)
    reason = None if outliers is None else outlier_reason(robot, recording, fit, outliers)
    change = find_change_point(robot, recording, fit)
    if reason is not None and reason.is_specific:
        yield _outlying(recording, outliers, reason, named)
    elif change is not None:
        yield from _moved_or_explained(robot, recording, fit, scale_of_good_fit, change)
    elif reason is not None:
        # where all rows of one target are off, the order of rows or the labels may be wrong instead
        if reason.cause == "wrong-target":
            found = explained_suspicions(robot, recording, fit, scale_of_good_fit)
        else:
            found = []
        yield from found or [_outlying(recording, outliers, reason, named)]
    yield from _rounded(robot, recording, fit, named)
    yield from _sigma_too_large(recording, fit)
    if (distant := far_geometry(robot, recording, fit)) is not None:
        yield distant.suspicion(recording)
        yield from doubtful_columns(recording, fit, scale_of_good_fit)


def _badly_fitting(robot, recording, fit: Fit, scale_of_good_fit) -> Iterator[Suspicion]:
    """The mistake that explains a recording that does not fit, or a warning that nothing does."""
    named = f"samples.csv of recording '{recording.name}'"
    nearly_all = _majority_fit(robot, recording, scale_of_good_fit, _NEARLY_ALL)
    if nearly_all is not None:
        yield from _well_fitting(robot, recording, nearly_all, scale_of_good_fit)
        return
    change = find_change_point(robot, recording, fit)
    if change is None or change.scale > scale_of_good_fit:
        change = find_new_setup(robot, recording, scale_of_good_fit)
    if change is not None:
        yield from _moved_or_explained(robot, recording, fit, scale_of_good_fit, change)
        return
    rounded = list(_rounded(robot, recording, fit, named))
    if rounded:
        yield from rounded
        return
    majority = _majority_fit(robot, recording, scale_of_good_fit, _MAJORITY)
    if majority is not None:
        yield from _well_fitting(robot, recording, majority, scale_of_good_fit)
        return
    shifted = row_shift_suspicions(robot, recording, scale_of_good_fit)
    if shifted:
        yield from shifted
        return
    unexplained = list(misfit_suspicions(robot, recording, fit, scale_of_good_fit))
    if all(suspicion.cause in _NOT_PROVEN for suspicion in unexplained):
        of_groups = _suspicions_of(_of_groups, robot, recording, fit)
        if of_groups:
            yield from of_groups
            return
    yield from unexplained
    if all(suspicion.cause == "unexplained" for suspicion in unexplained):
        yield from _isolated_rows(robot, recording, fit, named)


def _of_groups(robot, recording, fit: Fit) -> Suspicion | None:
    """What the rows have in common that do not agree with the largest group of rows that one model fits."""
    named = f"samples.csv of recording '{recording.name}'"
    scale_of_good_fit = good_scale(robot, recording)
    group = largest_group(robot, recording, fit, time_order(recording), scale_of_good_fit)
    if group is None:
        return None
    known_rows = np.flatnonzero(np.isfinite(group.mismatch))
    known = recording.select(known_rows)
    mismatch = group.mismatch[np.isfinite(group.mismatch)]
    agree = mismatch < group.limit
    median = float(np.median(mismatch[agree]))
    outliers = Outliers(np.flatnonzero(~agree), mismatch, median)
    reason = outlier_reason(robot, known, group.fit, outliers)
    if not reason.is_specific and reason.cause != "moved":
        return None
    suspicion = _outlying(known, outliers, reason, named)
    return replace(suspicion, rows=tuple(known_rows[outliers.rows].tolist()))


def _isolated_rows(robot, recording, fit: Fit, named: str) -> Iterator[Suspicion]:
    """Rows that a gap separates from the others, where an inaccurate arm puts all rows off."""
    isolated = find_outliers(robot, recording, fit, floor=np.inf, factor=_FAR_OF_LARGE_ERRORS)
    if isolated is not None:
        reason = Reason(isolated.likely_cause, "blunders", False)
        yield _outlying(recording, isolated, reason, named)


def _of_part(robot, recording, change, scale_of_good_fit) -> Suspicion | None:
    """A mistake that the rows on one side of a change point have in common; a fit of the other side shows it."""
    named = f"samples.csv of recording '{recording.name}'"
    order = time_order(recording)
    split = int(np.flatnonzero(recording.sample_ids[order] == change.after)[0])
    for known, other in ((order[:split], order[split:]), (order[split:], order[:split])):
        try:
            sound = recording.select(np.sort(known))
            fit = fit_recording(robot, sound.select(even_rows(sound, _ROWS)))
            mismatch = row_mismatch(robot, recording, fit)
        except FAILURES:
            continue
        rows = np.sort(other[mismatch[other] > _EFFECT * scale_of_good_fit])
        if fit.core > scale_of_good_fit or not len(rows):
            continue
        outliers = Outliers(rows, mismatch, float(np.median(mismatch[known])))
        reason = outlier_reason(robot, recording, fit, outliers)
        if reason.is_specific:
            return _outlying(recording, outliers, reason, named)
    return None


def _moved_or_explained(robot, recording, fit, scale_of_good_fit, change) -> list[Suspicion]:
    """A change point, unless a correction of the rows on one side, or of all rows, explains the data better still."""
    of_part = _of_part(robot, recording, change, scale_of_good_fit)
    if of_part is not None:
        return [of_part]
    found = explained_suspicions(robot, recording, fit, min(scale_of_good_fit, change.scale / 2))
    sentence = change_point_sentence(f"samples.csv of recording '{recording.name}'", change)
    return found or [Suspicion(sentence, False, "moved", instant=(change.before, change.after))]


def _majority_fit(robot, recording, scale_of_good_fit, share: float) -> Fit | None:
    """A fit of half of the rows that more than a share of all agree with: the others had led the robust fit astray."""
    order = time_order(recording)
    for rows in np.array_split(order, 2):
        try:
            fit = fit_recording(
                robot, recording.select(rows[even_rows(recording.select(rows), _ROWS)])
            )
            mismatch = row_mismatch(robot, recording, fit)
        except (np.linalg.LinAlgError, InputError, ValueError):
            continue
        plausible = np.abs(fit.deviations).max(initial=0.0) < MAX_DEVIATION
        if (
            plausible
            and np.isfinite(fit.scale)
            and (mismatch < 3 * scale_of_good_fit).mean() > share
        ):
            return fit
    return None


def _outlying(recording, outliers, reason, named) -> Suspicion:
    rows = outliers.rows
    distances = outliers.mismatch[outliers.rows]
    sizes = dict.fromkeys(f"{distance:.3g}" for distance in (distances.min(), distances.max()))
    size = f"{' to '.join(sizes)} mm"
    are = "are" if len(rows) > 1 else "is"
    samples = named_samples(recording, rows, outliers.mismatch)
    sentence = (
        f"{named}: {len(rows)} of {recording.n} rows {are} off by {size}, where the median is "
        f"{outliers.median:.2g} mm ({samples}); {reason.sentence}; correct or remove "
        f"{'these rows' if len(rows) > 1 else 'this row'}."
    )
    return Suspicion(sentence, False, reason.cause, rows=tuple(outliers.rows.tolist()))


def _rounded(robot, recording, fit, named):
    columns, step, predicted = joint_rounding(robot, recording, fit)
    if columns and explains(predicted, fit.scale):
        yield Suspicion(
            f"{named}: all readings of column{'s' * (len(columns) > 1)} {listed(columns)} are multiples of {step:g}; "
            f"rounding to such a step explains position errors of {predicted:.2g} mm RMS, and {fit.scale:.2g} mm are "
            "found; export the readings with all digits.",
            False,
            "rounding",
        )
    columns, size, predicted = point_rounding(recording)
    if columns and explains(predicted, fit.scale):
        yield Suspicion(
            f"{named}: all values of column{'s' * (len(columns) > 1)} {listed(columns)} are multiples of {size}; "
            f"rounding to such a step explains position errors of {predicted:.2g} mm RMS, and {fit.scale:.2g} mm are "
            "found; export the measurements with all digits.",
            False,
            POINT_ROUNDING,
        )


def _sigma_too_large(recording, fit):
    if recording.sigma is None or fit.degrees < _LEAST_DEGREES or not fit.scale > 0:
        return
    if fit.scale < _COMPUTED_MM:
        return  # nothing is measured yet: the recording is a plan
    stated = float(np.median(recording.sigma)) * np.sqrt(3)
    if stated > _SIGMA_RATIO * fit.scale:
        yield Suspicion(
            f"recording '{recording.name}', sigma_mm: the stated {np.median(recording.sigma):.3g} mm a coordinate is "
            f"{stated / fit.scale:.3g} times the scatter of the residuals ({fit.scale / np.sqrt(3):.2g} mm); all "
            "uncertainties would be too large by this factor; correct it, or leave it out if it is unknown.",
            False,
            "sigma",
        )
