"""Proof of what a search found: errors on samples that no step of it saw, and permutation controls.

First the whole: the search is repeated inside each fold, and what it finds there must predict the other samples
better than the baseline does. Then each term, by leaving it out with all others in place; the weakest goes first, and
the others are judged again without it. Last, each term's part in what the folds found by themselves, where a confounded
effect that is chosen in another fold stands for the term.

Each step uses only the splits that can judge the terms (`judging`): a law of time is judged by blocks of the
workspace, a curve by splits that leave no range of its angle out. The terms that stay reduce the held-out error there.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from workbench.diagnosis.linear.problem import Bench, Finding, Found
from workbench.diagnosis.validation.controls import controls
from workbench.diagnosis.validation.correlated_noise import reject_explained_by_correlated_noise
from workbench.diagnosis.validation.fold_searches import FoldSearches
from workbench.diagnosis.validation.folds import (
    MAX_TESTED_SAMPLES,
    Scheme,
    schemes,
    tested_samples,
    thinned,
)
from workbench.diagnosis.validation.held_out import (
    Errors,
    critical_t,
    paired_t,
    rms,
    rms_pair,
    sigma_of,
    significance,
)
from workbench.diagnosis.validation.judging import (
    ConditionalGains,
    SchemeErrors,
    is_supported,
    refused_term,
    reported_scheme,
    require_compliances,
)
from workbench.diagnosis.validation.stability import (
    Nested,
    effect_indices,
    effects_of,
    schemes_judging_all,
    searched_schemes,
    stable_terms,
)
from workbench.diagnosis.validation.step_places import with_step_places
from workbench.diagnosis.validation.terms import Proof, Term
from workbench.machine.progress import counted, duration

_CLEAR = (
    2.0  # times the critical t: a term that no other one's absence is likely to make insignificant
)
_SINGLE = 1.5  # effective number of poses below which one shows nearly all of an effect
Find = Callable[[Bench, np.ndarray], list[Finding]]
Progress = Callable[[str], None]


def prove(
    bench: Bench,
    found: Found,
    find: Find,
    noise: tuple[float, str],
    progress: Progress = lambda text: None,
    searches: FoldSearches | None = None,
):
    """(Proof, terms that stay, terms refused) of what was found on all samples.

    find: the search for terms, made inside each fold as find(bench, samples). noise: RMS distance that the
    instrument leaves (mm, px), and how it is known. A term stays where its held-out gain conditional on the others is
    real, where it is real, too, in what the folds found by themselves, and where it passes its controls. searches:
    those of `fold_searches(find)`, some of which may have begun; None: they are made in this process.
    """
    inliers = ~found.outliers
    searches = searches or fold_searches(find)
    errors = Errors(bench)
    terms, refused = _retained_terms(bench, list(found.findings), tested_samples(bench), progress)
    terms = with_step_places(bench, terms)
    searched = partial(_nested_search, bench, found, errors, progress=progress)
    nested = searched(searches, terms) if terms else searched(None, ())
    progress("what each term adds to the predictions of the folds")
    terms, lost = stable_terms(bench, terms, nested, inliers)
    if terms and searches.executor is not None:  # nearly always all of them pass their controls
        errors.begin(
            effects_of([term.finding for term in terms]),
            [result.scheme.fold for result in nested],
            searches.executor.submit,
        )
    terms, uncontrolled = _controlled(bench, terms, progress)
    terms, orphans = require_compliances(bench, terms)
    terms, chance = reject_explained_by_correlated_noise(bench, terms)
    gone = [*refused, *lost, *uncontrolled, *orphans, *chance]
    progress("held-out errors with the terms that stay")
    terms, worse, rows = _supported(errors, terms, gone, nested, inliers)
    effects = effects_of([term.finding for term in terms])
    fixed = [
        errors(effects, result.scheme.fold) if effects else result.baseline_errors
        for result in nested
    ]
    proof = _with_angles(_proof(bench, rows, fixed, noise, inliers), errors, inliers)
    return proof, tuple(terms), (*gone, *worse)


def _with_angles(proof: Proof, errors: Errors, inliers: np.ndarray) -> Proof:
    """The proof with the rotation angles that belong to its errors, where orientation is measured."""
    angles = np.stack([errors.angles_of(errors_of_model) for errors_of_model in proof.errors])
    if not np.isfinite(angles).any():
        return proof
    return replace(
        proof, angles=angles, angles_rms=(rms(angles[0], inliers), rms(angles[1], inliers))
    )


def _supported(errors: Errors, terms: list[Term], gone: list[Term], results: list[Nested], inliers):
    """Terms that together reduce the held-out error, terms that do not, and the errors by scheme.

    Judged by what the folds found by themselves; where that fails, by that without what was refused. As long as the
    error does not fall, the term with the least support goes.
    """
    tested_schemes = [result.scheme for result in results]
    sigma = sigma_of(errors.bench)
    predicted = [result.errors for result in results]
    is_reduced = False
    refused: list[Term] = []
    while terms:
        judging = schemes_judging_all(errors.bench, terms, tested_schemes)
        predicted = _with_same_terms(errors, results, predicted, terms)
        rows = _scheme_errors(results, predicted, judging, inliers, sigma)
        if is_supported(rows):
            return terms, refused, rows
        if not is_reduced and gone:
            predicted = _without_refused(errors, results, gone)
            is_reduced = True
            continue
        weakest = min(terms, key=lambda term: term.t_nested)
        refused.append(refused_term(weakest, rows, errors.bench.unit))
        remaining = [term for term in terms if term is not weakest]
        terms, orphans = require_compliances(errors.bench, remaining)
        refused += orphans
        predicted = _without_refused(errors, results, [*gone, *refused])
    plain = [result.baseline_errors for result in results]
    return [], refused, _scheme_errors(results, plain, tested_schemes, inliers, sigma)


def _with_same_terms(
    errors: Errors, results: list[Nested], predicted: list[np.ndarray], terms: Sequence[Term]
) -> list[np.ndarray]:
    """The predictions (n,) by scheme; where its folds did not search, with some terms, fitted without each fold."""
    effects = effects_of([term.finding for term in terms])
    return [
        after if result.is_searched else errors(effects, result.scheme.fold)
        for result, after in zip(results, predicted)
    ]


def _without_refused(
    errors: Errors, results: list[Nested], refused: Sequence[Term]
) -> list[np.ndarray]:
    """Errors (n,) by scheme of what the folds found by themselves, except what is one of the refused terms."""
    gone = {(term.finding.effect, term.finding.where) for term in refused}
    out = []
    for result in results:
        effects_of_folds = {}
        for k, findings in result.found.items():
            effects_of_folds[k] = effects_of(
                [f for f in findings if (f.effect, f.where) not in gone]
            )
        out.append(errors.predicted(result.scheme.fold, effects_of_folds))
    return out


def _scheme_errors(results: list[Nested], predicted, judging, inliers, sigma) -> list[SchemeErrors]:
    """Errors by scheme; those of several kinds of samples (corners, stripes) are weighted by their noise `sigma`."""
    rows = []
    for result, after in zip(results, predicted):
        figures = rms_pair(result.baseline_errors, after, inliers, sigma)
        rows.append(
            SchemeErrors(
                result.scheme,
                result.baseline_errors,
                after,
                *figures,
                result.scheme in judging,
                result.is_searched,
            )
        )
    return rows


def fold_searches(find: Find, jobs: int = 1) -> FoldSearches:
    """The searches of folds, each with a held-out test of what it finds, in up to so many processes."""
    return FoldSearches(partial(retained_in_fold, find=find), jobs)


def _nested_search(
    bench,
    found: Found,
    errors: Errors,
    searches: FoldSearches | None,
    terms: Sequence[Term],
    progress: Progress,
) -> list[Nested]:
    """The search repeated inside every fold of the schemes that repeat it; None: there is nothing to be proved."""
    tested_schemes = schemes(bench.pose, found.before)
    if searches is None:
        plain = [errors((), scheme.fold) for scheme in tested_schemes]
        return [
            Nested(scheme, plain_errors, plain_errors, {}, 0.0)
            for scheme, plain_errors in zip(tested_schemes, plain)
        ]
    compared = errors if bench.chain is not None else Errors(bench, independent=True)
    searched = searched_schemes(bench, terms, tested_schemes)
    results = []
    all_folds = [scheme.fold for scheme in tested_schemes]
    found_in_folds = _search_nested(bench, searches, searched, progress, compared, all_folds)
    by_scheme = dict(zip(searched, found_in_folds))
    for scheme in tested_schemes:
        if scheme not in by_scheme:
            plain = errors((), scheme.fold)
            results.append(Nested(scheme, plain, plain, {}, 0.0, is_searched=False))
            continue
        nested = by_scheme[scheme]
        fold = scheme.fold
        chosen = {k: effects_of(terms) for k, terms in nested.items()}
        before = compared((), fold)
        after = compared.predicted(fold, chosen)
        t = _t_of(compared, before, after, ~found.outliers)
        plain = errors((), fold)
        predicted = errors.predicted(fold, chosen)
        results.append(Nested(scheme, plain, predicted, nested, t))
    return results


def _t_of(errors: Errors, before: np.ndarray, after: np.ndarray, inliers: np.ndarray) -> float:
    """t of the gain from errors `before` to `after` (n,), which `errors` made."""
    bench = errors.bench
    if bench.sigma is not None:
        return paired_t(bench.pose, before, after, inliers, bench.sigma)
    components = [errors.components_of(errors_of_model) for errors_of_model in (before, after)]
    return significance(bench.pose, *components, inliers)


def _proof(bench, rows: Sequence[SchemeErrors], fixed, noise, inliers) -> Proof:
    """The figures of the scheme that judges; where nothing is claimed, the baseline predicts."""
    shown = reported_scheme(rows)
    index = next(i for i, row in enumerate(rows) if row is shown)
    t = paired_t(bench.pose, shown.before, shown.after, inliers, sigma_of(bench))
    return Proof(
        before=shown.rms_before,
        after=shown.rms_after,
        fixed=rms(fixed[index], inliers, sigma_of(bench)),
        t=t,
        folds=len(shown.scheme.folds),
        noise=noise[0],
        noise_from=noise[1],
        errors=np.stack([shown.before, shown.after]),
        fold=shown.scheme.fold,
        schemes=tuple(_scheme_row(bench, row, inliers, same) for row, same in zip(rows, fixed)),
        scheme=shown.scheme.name,
    )


def _scheme_row(bench, row: SchemeErrors, inliers, fixed) -> dict:
    return {
        "folds_by": row.scheme.name,
        "folds": len(row.scheme.folds),
        "before": row.rms_before,
        "after": row.rms_after,
        "after_same_terms": rms(fixed, inliers, sigma_of(bench)),
        "t": paired_t(bench.pose, row.before, row.after, inliers, sigma_of(bench)),
        "judges": row.is_judging,
        "nested": row.is_nested,
    }


def _search_nested(
    bench,
    searches: FoldSearches,
    tested_schemes: list[Scheme],
    progress: Progress,
    errors: Errors,
    all_folds: Sequence[np.ndarray] = (),
) -> list[dict[int, list[Finding]]]:
    """Terms that the search finds on the other folds and a held-out test on those alone retains, fold by fold.

    errors: made of each fold while the searches of the next ones still run; during the last one, which leaves a core
    idle, those of the baseline in `all_folds`, each (n,) int.
    """
    found: list[dict[int, list[Finding]]] = [{} for _ in tested_schemes]
    work = [(i, s, k) for i, s in enumerate(tested_schemes) for k in s.folds]
    start = time.perf_counter()
    results = searches.results(bench, samples_of_folds(tested_schemes))
    for done, ((i, s, k), terms) in enumerate(zip(work, results), 1):
        found[i][k] = terms
        errors.prepare(effects_of(terms), s.fold == k)
        seconds = time.perf_counter() - start
        seconds_left = seconds / done * (len(work) - done)
        progress(
            f"{s.name}: the whole search was made without block {k + 1} of {len(s.folds)}; "
            f"about {duration(seconds_left)} left"
        )
        for fold in all_folds if done == len(work) - 1 else ():
            errors((), fold)
    return found


def samples_of_folds(tested_schemes: Sequence[Scheme]) -> list[np.ndarray]:
    """(n,) bool: the samples of each fold of each scheme, all but one block."""
    return [scheme.fold != k for scheme in tested_schemes for k in scheme.folds]


def retained_in_fold(bench: Bench, samples: np.ndarray, find: Find) -> list[Finding]:
    """Terms that search and held-out test retain on `samples` (n,) bool; no other samples are used.

    Fewer of them where the bench can do with fewer; a bench that is `whole` sees in a fold what it saw outside.
    """
    searched = tested = samples
    if not bench.needs_all_samples:
        searched = thinned(bench.pose, samples)
        tested = thinned(bench.pose, samples, MAX_TESTED_SAMPLES)
    retained, refused = _retained_terms(bench, find(bench, searched), tested)
    return [term.finding for term in (*retained, *filter(_shown_once, refused))]


def _shown_once(term: Term) -> bool:
    """Whether a refused term has a gain that a single board pose or ball shows, whose spread no t can estimate.

    A ball that was scanned twice is in the samples of a fold once. What it shows is then tested by the fold itself,
    which predicts the other scan.
    """
    showing = term.showing_poses
    return showing is not None and showing < _SINGLE and term.gain > 0


def _retained_terms(
    bench, findings: list[Finding], samples, progress: Progress = lambda text: None
) -> tuple[list[Term], list[Term]]:
    """Terms with a real held-out gain conditional on one another, and the removed ones, in the problem solved with all.

    To first order about that solution, by samples left out of the linearised fit.
    """
    if not findings:
        return [], []
    progress(f"held-out gain of {len(findings)} terms, each conditional on the others")
    problem = bench.problem(effects_of(findings), samples, hypotheses=False)
    numbers = dict(zip(map(id, findings), effect_indices(findings)))
    trial = ConditionalGains(bench, problem, samples)
    min_t = critical_t(bench.sigma)

    def with_gains(terms: Sequence[Term], present_terms: Sequence[Term]) -> list[Term]:
        present = [i for term in present_terms for i in numbers[id(term.finding)]]
        step = counted(progress, len(terms))
        out = []
        for term in terms:
            step(f"held-out gain of {term.title}")
            out.append(trial.with_gains(term, numbers[id(term.finding)], present))
        return out

    return _without_insignificant(with_gains, [Term(f) for f in findings], min_t)


Judge = Callable[[Sequence[Term], Sequence[Term]], list[Term]]


def _without_insignificant(
    with_gains: Judge, terms: Sequence[Term], min_t: float
) -> tuple[list[Term], list[Term]]:
    """Terms whose gain conditional on one another has a t above `min_t`, and the others; the weakest goes first.

    with_gains(some, present): some of the terms `present`, each with its gain conditional on all the others. Once a
    term is removed, the terms that are not clearly significant are tested again, then the others.
    """
    remaining = with_gains(terms, terms)
    refused = []
    outdated: set[int] = set()
    while remaining:
        worst = min(remaining, key=lambda term: (term.gain > 0, term.t))
        if worst.t > min_t and worst.gain > 0:
            if not outdated:
                break
            chosen = outdated
        else:
            refused.append(replace(worst, kept=False, reason=_insignificant(worst.t, min_t)))
            remaining.remove(worst)
            outdated = {id(term.finding) for term in remaining}
            clear = {id(t.finding) for t in remaining if t.t > _CLEAR * min_t and t.gain > 0}
            chosen = outdated - clear
        retested = [term for term in remaining if id(term.finding) in chosen]
        new = dict(zip(map(id, retested), with_gains(retested, remaining)))
        remaining = [new.get(id(term), term) for term in remaining]
        outdated = outdated - chosen
    return remaining, refused


def _insignificant(t: float, min_t: float) -> str:
    if t < 0:
        return f"next to the other terms it does not reduce the held-out error (t = {t:.1f}, required is {min_t:g})"
    return f"its held-out gain next to the other terms is not significant (t = {t:.1f}, required is {min_t:g})"


def _controlled(bench, terms: list[Term], progress) -> tuple[list[Term], list[Term]]:
    """The terms with their controls, and those that failed them."""
    passed, failed = [], []
    step = counted(progress, len(terms))
    solved = effects_of([term.finding for term in terms])
    for term in terms:
        step(f"controls of {term.title}")
        tested = term.finding.effects
        others = [effect for effect in solved if not any(effect is left_out for left_out in tested)]
        controlled = replace(term, controls=controls(bench, others, tested, solved=solved))
        broken = [control.kind for control in controlled.controls if control.passed is False]
        if broken:
            reason = f"it has a gain without its cause, too (control: {' and '.join(broken)})"
            failed.append(replace(controlled, kept=False, reason=reason))
        else:
            passed.append(controlled)
    return passed, failed
