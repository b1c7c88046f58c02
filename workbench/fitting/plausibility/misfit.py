"""A recording that does not fit: which correction explains it, or what to look at where none does."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from datasets.samples.columns import joint_columns
from robot_model.system import geometry_free
from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import (
    EXPLAINED,
    Fit,
    base_and_tool,
    fit_recording,
    model_at,
    reach_of,
    scatter_of_points,
)
from workbench.fitting.plausibility.hypotheses.corrections import observed_columns
from workbench.fitting.plausibility.joint_columns.columns_at_rest import (
    constant_columns,
    constant_coordinates,
    equal_columns,
    longest_run,
    sorted_column,
)
from workbench.fitting.plausibility.joint_columns.coupled_readings import coupled_readings
from workbench.fitting.plausibility.joint_columns.reading_scales import scaled_readings
from workbench.fitting.plausibility.joint_columns.single_coordinate import (
    wrong_coordinate_suspicion,
)
from workbench.fitting.plausibility.sampling import even_rows
from workbench.fitting.plausibility.search import CLOSE, Explanation, search_further, search_singles
from workbench.fitting.plausibility.suspicion import Suspicion
from workbench.fitting.plausibility.wording import (
    correction_sentence,
    deviation_sentence,
    fit_words,
    listed,
)

_FALLS = 3.0
"""Factor by which a correction has to lower the misfit."""
_FALLS_FAR = 6.0
"""The same where the corrected data do not fit well either."""
_EVIDENCE = 30.0
"""Difference of the negative log posteriors: odds of 10^13."""
_LEAST_DEGREES = 12
_PLAUSIBLE = 5.0
_MISFIT_FACTOR = 3.0
"""Times a good fit: below it, unmodelled effects are as likely as a mistake."""
_ROWS = 200
_PERMUTATIONS = 3
_MOST_RELEASED, _RELEASE_STEPS = 2, 40


def misfit_suspicions(
    robot, recording, recorded: Fit, scale_of_good_fit: float
) -> Iterator[Suspicion]:
    """The best explanation of a misfit, or warnings on what else could be wrong.

    recorded: fit of the data as they are. scale_of_good_fit: mm.
    """
    search = search_singles(robot, recording)
    explanations = (*search.explanations, *_scaled(robot, recording))
    found = _accepted(explanations, recorded, scale_of_good_fit)
    if not found:
        coupled = coupled_readings(robot, recording, is_far=True)
        found = _accepted(coupled, recorded, scale_of_good_fit)
    if not found:
        wrong_geometry = _wrong_geometry(robot, recording, recorded, scale_of_good_fit)
        if wrong_geometry is not None:
            yield wrong_geometry
            yield from doubtful_columns(recording, recorded, scale_of_good_fit)
            return
        search = search_further(robot, recording, search, scale_of_good_fit)
        found = _accepted(search.explanations, recorded, scale_of_good_fit)
    if found:
        yield _explained(robot, recording, recorded, found, scale_of_good_fit)
    else:
        coarse = [e for e in search.explanations if _is_far_better(e, recording, recorded)]
        if coarse:
            yield _explained(robot, recording, recorded, _plainest(coarse), scale_of_good_fit)
            return
        yield from _unexplained(robot, recording, recorded, scale_of_good_fit)


def _accepted(explanations, recorded: Fit, scale_of_good_fit) -> list[Explanation]:
    """Explanations that fit well with plausible geometry where the recorded data do not, the plainest first."""
    plausible = [e for e in explanations if _is_accepted(e, recorded, scale_of_good_fit)]
    return _plainest(plausible) if plausible else []


def _plainest(explanations) -> list[Explanation]:
    """Those that fit about as well as the best one, the plainest first."""
    best = min(e.fit.scale for e in explanations)
    close = [e for e in explanations if e.fit.scale <= max(CLOSE * best, best + 0.05)]
    return sorted(close, key=lambda e: (e.correction.mistake_count, rank(e), e.fit.scale))


def _is_far_better(explanation, recording, recorded: Fit) -> bool:
    """Whether a correction explains the points of an arm with large errors, which the recorded data do not.

    The misfit then stays above that of a good fit, but far below the scatter of the points (the data as recorded: not),
    and falls by a large factor.
    """
    scatter = scatter_of_points(recording)
    scale = explanation.correction.comparable(explanation.fit.scale)
    gain = recorded.improbability - explanation.fit.improbability
    return (
        scale <= EXPLAINED * scatter < recorded.scale
        and _FALLS_FAR * scale < recorded.scale
        and _worst(explanation.fit) <= _PLAUSIBLE
        and gain > _EVIDENCE
    )


_FEW_SIGNS = 2
_COMMON = ("joint-sign", "joint-unit", "length-unit", "joint-order", "quaternion-order")


def rank(explanation) -> int:
    """Common mistakes before rare ones, where both explain the data equally well.

    Many joints of the opposite sign are rare: a left-handed frame does the same to most arms.
    """
    cause, touched = explanation.correction.cause, explanation.correction.touches
    if cause == "joint-sign" and len(touched) > _FEW_SIGNS:
        return len(_COMMON) + 1
    if cause in _COMMON:
        return _COMMON.index(cause)
    return len(_COMMON)


def _is_accepted(explanation, recorded, scale_of_good_fit):
    """Whether a correction leaves a good fit with plausible geometry, and the data as recorded do not.

    The worse the corrected fit, the more the correction has to lower the misfit.
    """
    fit = explanation.fit
    if _worst(fit) > _PLAUSIBLE:
        return False
    falls = _FALLS * max(1.0, fit.scale / scale_of_good_fit) ** 2
    gain = recorded.improbability - fit.improbability
    scale = explanation.correction.comparable(fit.scale)
    needless = scale <= scale_of_good_fit and _worst(recorded) > _PLAUSIBLE and gain > _EVIDENCE
    return needless or falls * scale < recorded.scale


def _worst(fit):
    """Largest deviation of a geometry parameter in prior standard deviations."""
    return np.abs(fit.deviations).max(initial=0.0)


def explained_suspicions(
    robot, recording, recorded: Fit, scale_of_good_fit: float
) -> list[Suspicion]:
    """The best single correction that explains the data better than the recorded data do, or nothing."""
    explanations = search_singles(robot, recording).explanations
    found = _accepted((*explanations, *_scaled(robot, recording)), recorded, scale_of_good_fit)
    if found:
        return [_explained(robot, recording, recorded, found, scale_of_good_fit)]
    return []


def _scaled(robot, recording) -> list[Explanation]:
    """The columns of readings that are in a wrong scale."""
    return [
        Explanation(reading.correction, reading.fit)
        for reading in scaled_readings(robot, recording)
    ]


def _explained(robot, recording, recorded, found, scale_of_good_fit) -> Suspicion:
    best = found[0]
    others = [
        e.correction
        for e in found[1:]
        if e.correction.mistake_count == best.correction.mistake_count
    ]
    recorded = _best_recorded(robot, recording, recorded, best)
    degrees = min(recorded.degrees, best.fit.degrees)
    gain = recorded.improbability - best.fit.improbability
    certain = (
        gain > _EVIDENCE
        and degrees >= _LEAST_DEGREES
        and _is_accepted(best, recorded, scale_of_good_fit)
    )
    sentence = correction_sentence(recording, recorded, best, others)
    alternatives = tuple(dict.fromkeys(other.cause for other in others[:1]))
    cause = best.correction.cause
    return Suspicion(sentence, certain, cause, alternatives, is_explanation=True)


def _best_recorded(robot, recording, recorded: Fit, explanation) -> Fit:
    """The best fit of the data as recorded, also from base and tool of the explanation, and with wide geometry.

    Advice to change data must not rest on a fit that stopped in a local minimum.
    """
    chosen = recording.select(even_rows(recording, _ROWS))
    fits = [recorded]
    values = explanation.fit.parameters.values
    if len(values) == len(recorded.parameters):
        starts = [values]
    else:
        starts = []
    for start in starts:
        try:
            base_and_tool_fit = fit_recording(
                robot, chosen, start, free=base_and_tool(chosen), steps=20
            )
            fits.append(fit_recording(robot, chosen, base_and_tool_fit.parameters.values, steps=20))
        except (np.linalg.LinAlgError, InputError):
            continue
    return min(fits, key=lambda fit: fit.improbability / max(fit.degrees, 1))


def _wrong_geometry(robot, recording, recorded, scale_of_good_fit) -> Suspicion | None:
    """One or two numbers of the robot file that are far off: freeing them makes the recording fit.

    Forward selection: the number whose release lowers the misfit most, then a second one in addition to it.
    """
    chosen = recording.select(even_rows(recording, _ROWS))
    keys = [key for key in geometry_free(robot) if ".alpha" not in key and ".beta" not in key]
    released = ()
    nominal = model_at(robot, chosen)[1].values
    for _ in range(_MOST_RELEASED):
        fits = {
            key: _released(robot, chosen, recorded, (*released, key), nominal)
            for key in keys
            if key not in released
        }
        best = min(fits, key=lambda key: fits[key].scale)
        released = (*released, best)
        if fits[best].scale <= scale_of_good_fit and _FALLS * fits[best].scale < recorded.scale:
            fit = fit_recording(
                robot, chosen, fits[best].parameters.values, steps=0
            )  # deviations from all priors
            sentence = deviation_sentence(recording, fit, _PLAUSIBLE)
            return None if sentence is None else Suspicion(sentence, False, "geometry")
    return None


def _released(robot, recording, recorded, keys, nominal) -> Fit:
    """The fit without a prior on `keys`; the recorded fit where that cannot be computed.

    nominal: values (P,) with base and tool fitted at the nominal geometry, the start of all of them. First with all
    other geometry held: together they would creep along a narrow valley.
    """
    free = base_and_tool(recording)
    try:
        first = fit_recording(
            robot, recording, nominal, free=free, widen=keys, steps=_RELEASE_STEPS
        )
        return fit_recording(robot, recording, first.parameters.values, widen=keys)
    except (np.linalg.LinAlgError, InputError):
        return recorded


def _in_no_order(robot, recording, recorded) -> bool:
    """Whether the measurements fit the joint readings no better than in random order (permutation test)."""
    names = observed_columns(recording)
    rows = even_rows(recording, _ROWS)
    rng = np.random.default_rng(0)
    scales = []
    for _ in range(_PERMUTATIONS):
        order = rng.permutation(recording.n)
        columns = {c: v[order] if c in names else v for c, v in recording.columns.items()}
        permuted = replace(recording, columns=columns).select(rows)
        try:
            scales.append(fit_recording(robot, permuted).scale)
        except (np.linalg.LinAlgError, InputError):
            return False
    return bool(names) and recorded.scale > 0.8 * float(np.median(scales))


def _named(recording) -> str:
    return f"samples.csv of recording '{recording.name}'"


def _fits(recorded, scale_of_good_fit, reach_mm: float = 0.0) -> str:
    if reach_mm > 0:
        share = f" ({100 * recorded.scale / reach_mm:.2g} % of the arm's reach)"
    else:
        share = ""
    return (
        f"base, tool and plausible geometry errors fit the measurements to {fit_words(recorded)} only{share}, where "
        f"at most about {scale_of_good_fit:.2g} mm are expected"
    )


def doubtful_columns(recording, recorded, scale_of_good_fit) -> Iterator[Suspicion]:
    """A warning for each joint column that does not move as the others do."""
    for part, cause in _columns_to_doubt(recording):
        yield Suspicion(
            f"{_named(recording)}, {part}; {_fits(recorded, scale_of_good_fit)}.", False, cause
        )


def _unexplained(robot, recording, recorded, scale_of_good_fit) -> Iterator[Suspicion]:
    named = _named(recording)
    fits = _fits(recorded, scale_of_good_fit, reach_of(robot, recording))
    if recorded.scale > _MISFIT_FACTOR * scale_of_good_fit:
        sentences = list(doubtful_columns(recording, recorded, scale_of_good_fit))
    else:
        sentences = []
    yield from sentences
    one_coordinate = None
    if not sentences:
        one_coordinate = wrong_coordinate_suspicion(robot, recording, scale_of_good_fit)
    if one_coordinate is not None:
        yield one_coordinate
        return
    if _in_no_order(robot, recording, recorded):
        yield Suspicion(
            f"{named}: {fits}; the measurements fit no better than in random order, so that rows of measurements and "
            "of joint readings do not belong together, the robot file describes another arm, or several columns are "
            "wrong at once; check how the two were joined, the robot file, and units, signs and order of the columns.",
            False,
            "rows-shuffled",
        )
    elif not sentences and recorded.scale > _MISFIT_FACTOR * scale_of_good_fit:
        yield from _unknown_cause(named, fits)


def _unknown_cause(named, fits) -> Iterator[Suspicion]:
    yield Suspicion(
        f"{named}: {fits}, and no single mistake that is searched for explains it; "
        "check that the robot file describes this arm with its zero offsets, the units and signs of the columns, and "
        "that each row holds joints and measurement of one moment.",
        False,
        "unexplained",
    )


def _columns_to_doubt(recording) -> Iterator[tuple[str, str]]:
    constant = constant_columns(recording)
    if constant:
        verb = "is" if len(constant) == 1 else "are"
        yield (
            f"column{'s' * (len(constant) > 1)} {listed(constant)}: {verb} constant while other joints move, as of "
            "a stuck encoder; check the export of this joint",
            "stuck-encoder",
        )
    for name in constant_coordinates(recording):
        yield (
            f"column {name}: is constant while the other coordinates change; one value was copied into all rows",
            "constant-coordinate",
        )
    for a, b in equal_columns(recording):
        yield (
            f"columns {a} and {b}: hold the same values; one was copied over the other",
            "copied-column",
        )
    name = sorted_column(recording)
    if name is not None:
        sorted_part = (
            "this column" if name in joint_columns(recording.columns) else "the measurement"
        )
        yield (
            f"column {name}: its values ascend or descend, as if {sorted_part} was sorted by {name} without the other "
            "columns, so that the rows do not belong together; restore the order of the rows",
            "sorted-column",
        )
    run = longest_run(recording)
    if run is not None:
        name, first, last = run
        ids = recording.sample_ids
        yield (
            f"column {name}: stays at {recording.columns[name][first]:.5g} from sample {ids[first]} to {ids[last]} "
            "while the other joints move, as of a stuck encoder",
            "stuck-encoder",
        )
