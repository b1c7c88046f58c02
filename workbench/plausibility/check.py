"""All plausibility checks of one recording, in order."""

from collections.abc import Iterator

import numpy as np

from workbench.core.errors import InputError
from workbench.plausibility.change_points import find_change_point, find_new_setup
from workbench.plausibility.fitting import Fit, fit_recording, reach_of
from workbench.plausibility.misfit import misfit_suspicions
from workbench.plausibility.outliers import find_outliers, named_samples, outlier_sentence
from workbench.plausibility.rounding import explains, joint_rounding
from workbench.plausibility.sampling import even_rows
from workbench.plausibility.stated_values import stated_value_suspicions
from workbench.plausibility.suspicion import Suspicion
from workbench.plausibility.wording import change_point_sentence, deviation_sentence, listed

_ROWS = 240
_GOOD_MM, _GOOD_REACH = 0.5, 0.001
_DEVIATION = 6.0
_SIGMA_RATIO = 4.0
_LEAST_DEGREES = 30
_EFFECT = 3.0


def check_plausibility(robot, recording) -> tuple[Suspicion, ...]:
    """Possible mistakes of a recording, the most serious first; empty where nothing looks wrong.

    robot: the nominal arm. recording: its moving rows, one a sample (`robot_model.measurements.samples_of`).
    A recording that fits is checked in well under a second; the search for a mistake takes several seconds.
    """
    found = [*stated_value_suspicions(robot, recording)]
    try:
        fit = fit_recording(robot, recording.select(even_rows(recording, _ROWS)))
    except (np.linalg.LinAlgError, InputError):
        return tuple(found)
    if np.isfinite(fit.scale):
        good = good_scale(robot, recording)
        judge = _well_fitting if fit.core <= good else _badly_fitting
        found += judge(robot, recording, fit, good)
    return tuple(sorted(found, key=lambda suspicion: not suspicion.certain))


def good_scale(robot, recording) -> float:
    """mm of misfit that noise and the unmodelled effects of a sound arm leave at most.

    Compliance, transmission errors and drift leave less than 0.1 % of the reach on all real arms that are known here.
    """
    return max(_GOOD_MM, _GOOD_REACH * reach_of(robot, recording))


def _well_fitting(robot, recording, fit: Fit, good) -> Iterator[Suspicion]:
    """Structure in the residuals of a recording most of whose rows fit."""
    named = f"samples.csv of recording '{recording.name}'"
    change = find_change_point(robot, recording, fit)
    if change is not None:
        yield Suspicion(change_point_sentence(named, change), False, "moved")
    else:
        yield from _outlying(robot, recording, fit, named, good)
    yield from _rounded(robot, recording, fit, named)
    yield from _sigma_too_large(recording, fit)
    if (sentence := deviation_sentence(recording, fit, _DEVIATION)) is not None:
        yield Suspicion(sentence, False, "geometry")


def _badly_fitting(robot, recording, fit: Fit, good) -> Iterator[Suspicion]:
    """The mistake that explains a recording that does not fit, or a warning that nothing does."""
    named = f"samples.csv of recording '{recording.name}'"
    change = find_change_point(robot, recording, fit)
    if change is None or change.scale > good:
        change = find_new_setup(robot, recording, good)
    if change is not None:
        yield Suspicion(change_point_sentence(named, change), False, "moved")
        return
    rounded = list(_rounded(robot, recording, fit, named))
    yield from rounded or misfit_suspicions(robot, recording, fit, good)


def _outlying(robot, recording, fit, named, good):
    # unmodelled effects of a sound arm reach a few times the usual scale at single poses
    outliers = find_outliers(robot, recording, fit, floor=_EFFECT * good)
    if outliers is None:
        return
    why, cause = outlier_sentence(robot, recording, fit, outliers)
    off = outliers.mismatch[outliers.rows]
    yield Suspicion(
        f"{named}: {len(outliers.rows)} of {recording.n} rows are off by {off.min():.3g} to {off.max():.3g} mm, where "
        f"the median is {outliers.median:.2g} mm ({named_samples(recording, outliers.rows)}); {why}; "
        "correct or remove these rows.", False, cause,
    )  # fmt: skip


def _rounded(robot, recording, fit, named):
    columns, step, predicted = joint_rounding(robot, recording, fit)
    if columns and explains(predicted, fit.scale):
        yield Suspicion(
            f"{named}: all readings of column{'s' * (len(columns) > 1)} {listed(columns)} are multiples of {step:g}; "
            f"rounding to such a step explains position errors of {predicted:.2g} mm RMS, and {fit.scale:.2g} mm are "
            "found; export the readings with all digits.", False, "rounding",
        )  # fmt: skip


def _sigma_too_large(recording, fit):
    if recording.sigma is None or fit.degrees < _LEAST_DEGREES:
        return
    stated = float(np.median(recording.sigma)) * np.sqrt(3)
    if stated > _SIGMA_RATIO * fit.scale:
        yield Suspicion(
            f"recording '{recording.name}', sigma_mm: the stated {np.median(recording.sigma):.3g} mm a coordinate is "
            f"{stated / fit.scale:.3g} times the scatter of the residuals ({fit.scale / np.sqrt(3):.2g} mm); all "
            "uncertainties would be too large by this factor; correct it, or leave it out if it is unknown.",
            False, "sigma",
        )  # fmt: skip
