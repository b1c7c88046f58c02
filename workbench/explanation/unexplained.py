"""Structure of the residual that no retained term explains: tests for it, and the term `unknown` that states it."""

from dataclasses import replace

from robot_model.effects.friction import ReadingLattice
from sensors.effects.recorded import BoardPointErrors
from workbench.diagnosis.levels import (
    CRITICAL_T,
    NOTABLE_SHARE,
    RANDOM_EFFECT_LEVEL,
    UNMODELLED_LEVEL,
)
from workbench.diagnosis.linear.hypotheses import family_wise, located, ranked_hypotheses
from workbench.diagnosis.linear.problem import Alternative, Finding, Found
from workbench.diagnosis.noise.random_effect_findings import unrecorded
from workbench.diagnosis.noise.random_effects import known_rounding, whitened_by
from workbench.diagnosis.validation.folds import tested_samples
from workbench.explanation.result import Term, has_unexplained_structure
from workbench.explanation.sentences import statements

OF_DATA = ("outliers", ReadingLattice.effect)
_PLACED = 0.01  # family-wise p-value from which on a place is said to hold what is left
_GAINED = 2.0  # t of the fall of the held-out error by a refused term from which on it counts as evidence of structure


def next_to_data_findings(bench, found: Found, terms, refused, proved) -> Found:
    """Findings with the structure next to outliers and rounded readings, where these are all that was retained.

    They take nothing off the errors of the other samples. Where all effects that the search found were refused, their
    structure is left there, although the remainder of the search, which contains them, is noise. Unchanged where no
    place holds this structure, see `is_structure_located`.
    """
    retains_these_alone = bool(terms) and all(t.finding.effect in OF_DATA for t in terms)
    is_significant = found.p_first < UNMODELLED_LEVEL
    if bench.chain is None or not (retains_these_alone and is_significant and refused):
        return found
    tested = tested_samples(bench)
    samples = ~found.outliers if tested is None else tested & ~found.outliers
    problem = bench.problem((), samples).conditional_on()
    rounding = known_rounding(problem, UNMODELLED_LEVEL)
    if rounding is not None:
        problem = whitened_by(problem, rounding)
    table = ranked_hypotheses(problem)
    p = family_wise(table)
    places = located(problem, table)
    fresh = replace(found, p_first=p, p_remainder=p, located=places, remainder=places)
    return fresh if is_structure_located(bench, fresh, refused, proved) else found


def contains_unexplained_structure(bench, found: Found, terms, proved, is_above: bool) -> bool:
    """Whether structure is left that the terms do not explain.

    Findings on the noise alone, as image jitter or a wrong statement, take nothing off the error, so that what is left
    cannot be compared with what they explain: structure next to them counts at the level at which it counts where
    nothing was found.
    """
    placed = is_remainder_located(bench, found, terms)
    if not any(term.finding.effects for term in terms):
        return placed and found.p_remainder < UNMODELLED_LEVEL
    return placed and has_unexplained_structure(proved, found.p_remainder, is_above)


def is_remainder_located(bench, found: Found, terms=()) -> bool:
    """Whether some place of a sensor holds a significant share of the remainder; see `is_structure_located`.

    The share has to be notable, as where nothing was found: of thousands of points a thousandth is significant. Next to
    findings on the noise, as image jitter, the residual holds all of that noise, so that any share counts. Displaced
    lines of a board are none of these: their corners are left out.
    """
    if bench.chain is not None:
        return True
    is_noise = [
        not term.finding.effects and term.finding.effect != BoardPointErrors.effect
        for term in terms
    ]
    smallest_share = NOTABLE_SHARE if terms and not any(is_noise) else 0.0
    return any(
        place.p_value < _PLACED and place.share > smallest_share for place in found.remainder
    )


def is_structure_located(bench, found: Found, refused, proved) -> bool:
    """Whether some place holds a significant share of the residual, or what was refused is significant.

    A sensor has a smooth function at every place of its chain. Where none of them is significant, a small p-value of
    the best of many candidates is chance: nothing is there to be explained. A negligible share of the residual, or of
    the held-out error by a refused term, needs no explanation: of thousands of points, a thousandth of a pixel is
    significant.

    An arm in few poses has few degrees of freedom, and its noise is only nearly equal in all coordinates. The p-value
    of a law that neither a smooth function nor the held-out errors of what the folds found (`Proof.t`) support counts
    from `RANDOM_EFFECT_LEVEL` on, that of tests whose null hypothesis is only nearly right.
    """
    places = any(place.p_value < _PLACED and place.share > NOTABLE_SHARE for place in found.located)
    if bench.chain is not None:
        return places or proved.t > CRITICAL_T or found.p_first < RANDOM_EFFECT_LEVEL
    gained = [
        term
        for term in refused
        if (term.t_fall or 0.0) > _GAINED and _explained_share(term, proved) > NOTABLE_SHARE
    ]
    return places or any(term.finding.p_value < _PLACED for term in gained)


def _explained_share(term: Term, proved) -> float:
    """Share of the held-out mean square of the baseline by which it falls with this term alone."""
    if not term.gain or not proved.before:
        return 0.0
    return 1 - (1 - min(term.gain / proved.before, 1.0)) ** 2


def contains_structure(found: Found, terms) -> bool:
    """Whether the residual is more than noise: it is significant, or a term is a smooth function without a law.

    Such a function only approximates what it stands for, so that its error remains in the residual.
    """
    unnamed = any(term.finding.effect == "unknown" for term in terms)
    return unnamed or found.p_remainder <= UNMODELLED_LEVEL


def unknown_terms(found: Found, terms, refused, problem) -> tuple[Term, ...]:
    """Terms `unknown` for structure that no finding predicts on held-out samples, with its place and covariates.

    problem: linearised without the unknown structure. The term lists as alternatives the effects of covariates that
    were not recorded. If no smooth function is significant at any place, the structure is that of the first rejected
    term.
    """
    if any(term.finding.effect == "unknown" for term in terms):
        return ()
    places = [
        place
        for place in (found.remainder if terms else found.located)
        if place.depends_on and place.p_value < _PLACED and place.share > 0
    ]
    if not places:
        return (Term(_of_refused(found, refused, bool(terms)), remainder=bool(terms)),)
    most_probable = places[0]
    label = "a smooth function of " + " and ".join(most_probable.depends_on)
    unknown = Finding(
        "unknown",
        most_probable.where,
        label,
        (),
        most_probable.p_value,
        0.0,
        most_probable.size,
        0.0,
        most_probable.depends_on,
        (*_refused_at_place(refused, most_probable), *unrecorded(problem, most_probable)),
    )
    return (Term(unknown, share=most_probable.share, remainder=bool(terms)),)


def _refused_at_place(refused, place) -> tuple[Alternative, ...]:
    """Named effects of the first search at a place that cross-validation refused, the most probable first."""
    named = [term.finding for term in refused if term.finding.effects]
    refused_here = [
        finding for finding in named if finding.where == place.where and finding.p_value < _PLACED
    ]
    return tuple(
        Alternative(
            finding.effect,
            finding.where,
            finding.label,
            finding.probability,
            1.0,
            statements.UNCONFIRMED,
        )
        for finding in sorted(refused_here, key=lambda finding: -finding.probability)
    )


def _of_refused(found: Found, refused, remainder: bool) -> Finding:
    """The unknown of structure that no smooth function locates: at the place of the strongest refused term."""
    p = found.p_remainder if remainder else found.p_first
    likely = _likely(refused)
    where = likely[0].where if likely else "samples"
    return Finding("unknown", where, statements.NOT_LOCATED, (), p, 0.0, 0.0, 0.0, (), likely)


def _likely(refused) -> tuple[Alternative, ...]:
    """Most probable cause of an unknown: the strongest significant term that was refused; () where none is."""
    named = [term.finding for term in refused if term.finding.p_value < _PLACED]
    if not named:
        return ()
    finding = max(named, key=lambda finding: finding.gain)
    description = (finding.effect, finding.where, finding.label, finding.probability, 1.0)
    return (Alternative(*description, statements.UNCONFIRMED),)


__all__ = [
    "contains_structure",
    "contains_unexplained_structure",
    "is_remainder_located",
    "is_structure_located",
    "next_to_data_findings",
    "unknown_terms",
]
