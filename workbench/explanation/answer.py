"""The whole diagnosis: from a recording to findings that are located, named, tested and described."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from workbench.core.common_effects import NoiseLaw
from workbench.core.errors import InputError
from workbench.diagnosis.levels import DATA_FAULT_LEVEL, RANDOM_EFFECT_LEVEL, UNMODELLED_LEVEL
from workbench.diagnosis.linear.estimates import Options, with_variation
from workbench.diagnosis.linear.problem import Alternative, Bench, Finding, Found
from workbench.diagnosis.noise.random_effects import find_random_effect, unrecorded
from workbench.diagnosis.noise.serial_correlation import SerialCorrelation
from workbench.diagnosis.robot.bench import RobotBench, bench_of
from workbench.diagnosis.robot.derived import DEFLECTION
from workbench.diagnosis.search.findings import with_equivalent_places
from workbench.diagnosis.search.select import find, found_terms
from workbench.diagnosis.validation import proof
from workbench.diagnosis.validation.correlated_noise import with_correlated_noise
from workbench.diagnosis.validation.folds import LEAST_FOLDS, schemes, tested_samples
from workbench.explanation import reference as references
from workbench.explanation import statements, words
from workbench.explanation.differences import with_differences
from workbench.explanation.final_model import FinalModel, residuals_of, stated_sigma, unwhitened
from workbench.explanation.fixed_points import fixed_points
from workbench.explanation.minimal_detectable_bias import minimal_detectable_biases
from workbench.explanation.noise import replicates, stated_noise
from workbench.explanation.noise.angular_noise import with_angular_noise
from workbench.explanation.noise.correlated_noise import correlated_noise
from workbench.explanation.planning.experiment import missing_of, next_experiment
from workbench.explanation.plausible_values import implausible_values
from workbench.explanation.result import (
    UNEXPLAINED,
    Diagnosis,
    Term,
    has_unexplained_structure,
    verdict_of,
    with_statements,
)
from workbench.explanation.sensor_errors import (
    ball_centres,
    errors_by_kind,
    image_terms,
    image_warnings,
    with_jitter,
    without_jitter,
)
from workbench.explanation.turntable import with_turntable
from workbench.files.provenance import provenance
from workbench.machine.progress import duration, elapsed

IMAGES = ("board-images", "scan-images")
NO_MASSES = (
    "The file of the robot {robot} states no masses: deflection under gravity is found only as the product of "
    "compliance and first moment. For a stiffness in N m/rad write mass_kg and com_mm of every joint."
)
_UNEVEN = NoiseLaw.effect
_PLACED = 0.01  # family-wise p-value from which on a place is said to hold what is left
_GAINED = 2.0  # t of the fall of the held-out error by a refused term from which on it counts as evidence of structure
_LONG_S = 1.0  # a search beyond which processes are worth their start
Say = Callable[[str], None]


def diagnose(
    recording,
    *,
    baseline: str = "geometry",
    simulation: Path | None = None,
    solution: Path | None = None,
    scanner: Path | None = None,
    progress: Say = lambda text: None,
    first: Say = lambda text: None,
    jobs: int = 1,
    trust_data: bool = False,
) -> Diagnosis:
    """What physics the baseline of a recording leaves out.

    baseline: "geometry" or "joint-compliance". simulation, solution: a scene or an earlier calibration to compare
    with, whose effects then belong to the baseline. scanner: a calibrated one, for a recording of scans. progress:
    called with what is done; first: with what the first search found, long before it is validated. jobs: processes
    for the searches inside folds, where one search takes long enough. trust_data: diagnose also a recording that
    cannot be right.
    Raises InputError.
    """
    say = _Reporter(progress, first)
    if recording.measures in IMAGES:
        return _of_sensor(recording, simulation or solution, say)
    reference = references.reference_of(simulation, solution, recording.robot)
    say("the baseline")
    bench = bench_of(recording, baseline, trust_data)
    shares = None
    if reference is not None:
        bench, shares = _against(bench, reference, recording)
        baseline = reference.name
    made = _whole(recording, bench, baseline, shares, say, jobs)
    made = replace(made, given=bench.baseline)
    return made if reference is None else with_differences(made, reference, recording)


def _of_sensor(recording, reference, say: "_Reporter") -> Diagnosis:
    from workbench.diagnosis.scanner import sensor

    if reference is not None:
        raise InputError(
            f"recording '{recording.name}': --simulation and --solution expect a recording of an arm, found images; "
            "leave the option out."
        )
    bench = sensor.bench_of(recording, say)
    made = _whole(recording, bench, "camera, mirror and poses", None, say)
    return with_turntable(made, recording, say)


def _against(bench: RobotBench, reference: references.Reference, recording):
    """The bench whose baseline holds the reference's effects, and the three shares of the difference."""
    model, values = references.bound(reference, recording)
    effects = (*(e for e in bench.baseline if not _held(e, reference.effects)), *reference.effects)
    chain = replace(
        model.chain, state=replace(model.chain.state, covariates=bench.chain.state.covariates)
    )
    wider = RobotBench(chain, bench.pose, effects, bench.recording, bench.warnings)
    pose, index = bench.pose, chain.state.index

    def noise_of(residual, degrees):
        return replicates.noise(pose, index, residual, stated_sigma(bench.recording), degrees)[0]

    return wider, references.shares(model, values, noise_of, reference.name)


def _held(effect, others) -> bool:
    return any((e.effect, e.where) == (effect.effect, effect.where) for e in others)


@dataclass(frozen=True)
class _Reporter:
    """Called with what is done; `first`: called with what the first search found."""

    progress: Say
    first: Say

    def __call__(self, text: str) -> None:
        self.progress(text)


def _whole(
    recording, bench: Bench, baseline: str, shares, say: _Reporter, jobs: int = 1
) -> Diagnosis:
    """Find, prove, say what cannot be seen and what to measure next."""
    bench, found, jobs = _searched(bench, say, jobs)
    unit, noise = bench.unit, FinalModel(bench, found, bench.unit).noise
    terms, refused, proved = _proved(bench, found, noise, say, jobs)
    last, correlation = _final_model(bench, found, terms)
    found, proved = last.found, last.with_variance_factors(proved)
    terms = _with_noise(last, terms, refused)
    terms = (*terms, *image_terms(bench, terms, found.before))
    proved, terms = _with_stated_noise(last, proved, terms, refused)
    verdict = _verdict(last, terms, refused, proved)
    if verdict == UNEXPLAINED:
        bare = last.after if terms else found.before
        more = _somewhere(found, terms, refused, bare)
        terms = (*terms, *(_with_equivalent_places(bench, term) for term in more))
    say("what these data could have shown")
    visible = _visible(bench, found)
    say("the next experiment")
    certain = [e for t in terms if t.is_certain for e in t.finding.effects]
    known = bench.problem(certain, tested_samples(bench))
    experiment = next_experiment(bench, terms, known, found.p_first, refused)
    made = Diagnosis(
        recording.name,
        recording.title or recording.name,
        recording.measures,
        found.before.n,
        baseline,
        unit,
        verdict,
        terms,
        refused,
        found.located,
        found.remainder,
        replace(proved, lack=last.lack()),
        visible,
        experiment,
        found,
        last.views(),
        shares,
        last.outliers(),
        missing_of(terms),
        _warnings(bench, recording, terms, correlation),
        dict(provenance(recording)),
        fixed_points(recording, bench, terms),
        *_for_sensor(bench, recording, proved, terms, ~found.outliers),
        correlation=correlation,
    )
    point = words.TIPS.get(recording.measures, "the measured point")
    said = [statements.statement(term, point, unit) for term in (*terms, *refused)]
    said = [statements.with_sample_numbers(one, found.before.order, last.ids) for one in said]
    return with_statements(made, said)


def _final_model(bench, found: Found, terms) -> tuple[FinalModel, SerialCorrelation | None]:
    """The final model, what is left judged under the correlation of its noise, and this correlation."""
    last = FinalModel(bench, found, bench.unit, terms)
    effects = [e for term in terms for e in term.finding.effects]
    fresh, correlation = with_correlated_noise(bench, found, effects, last.after)
    return FinalModel(bench, fresh, bench.unit, terms), correlation


def _visible(bench: Bench, found: Found) -> tuple:
    """The smallest sizes that these data, as far as they are tested, would have shown."""
    problem = found.before
    if not problem.candidates:  # a large recording keeps no table of all its samples
        problem = bench.problem((), tested_samples(bench))
    return tuple(
        minimal_detectable_biases(
            problem, unwhitened(problem), lambda one: bench.units(one.effects)
        )
    )


def _verdict(last: "FinalModel", terms, refused, proved) -> str:
    """The word of the contract for what was proved; last: residuals of the final model."""
    bench, found = last.bench, last.found
    left = _has_unexplained_structure(bench, found, terms, proved, _is_above_noise(last, terms))
    return verdict_of(terms, found.p_first, left, is_placed=_is_placed(bench, found, refused))


def _is_above_noise(last: "FinalModel", terms) -> bool:
    """Whether the residual of the final model is significantly above the noise.

    That of replicates where there are enough of them, else the stated one, unless a finding says that it is wrong.
    """
    compared = last.stated_noise()
    if compared is None:
        lack = last.lack()
        return lack is not None and lack["after"]["p_value"] < DATA_FAULT_LEVEL
    if any(term.finding.effect == stated_noise.EFFECT for term in terms):
        return compared.lack_of_fit() < DATA_FAULT_LEVEL
    return compared.is_exceeded()


def _for_sensor(bench, recording, proved, terms, inliers):
    """Errors by kind of measurement, and ball centres before and after, of a sensor; nothing of a robot."""
    if recording.measures not in IMAGES:
        return (), None
    return errors_by_kind(bench, proved, inliers), ball_centres(bench, recording, terms)


def _has_unexplained_structure(bench, found: Found, terms, proved, is_above: bool) -> bool:
    """Whether structure is left that the terms do not explain.

    Findings on the noise alone, as image jitter or a wrong statement, take nothing off the error, so that what is left
    cannot be compared with what they explain: structure next to them counts at the level at which it counts where
    nothing was found.
    """
    placed = _is_remainder_placed(bench, found)
    if not any(term.finding.effects for term in terms):
        return placed and found.p_remainder < UNMODELLED_LEVEL
    return placed and has_unexplained_structure(proved, found.p_remainder, is_above)


def _is_remainder_placed(bench, found: Found) -> bool:
    """Whether some place of a sensor holds a significant share of what the findings leave; see `_is_placed`."""
    if bench.chain is not None:
        return True
    return any(one.p_value < _PLACED and one.share > 0 for one in found.remainder)


def _is_placed(bench, found: Found, refused) -> bool:
    """Whether some place holds a significant share of the residual, or what was refused is significant.

    A sensor has a smooth function at every place of its chain. Where none of them is significant, a small p-value of
    the best of many candidates is chance: nothing is there to be explained.
    """
    if bench.chain is not None:
        return True
    places = any(one.p_value < _PLACED and one.share > 0 for one in found.located)
    gained = [term for term in refused if (term.t_fall or 0.0) > _GAINED]
    return places or any(term.finding.p_value < _PLACED for term in gained)


def _with_stated_noise(last: "FinalModel", proved, terms, refused):
    """Proof and terms with a wrong noise statement, where there is one; the proof then uses the noise that was found.

    Where replicates confirm the stated noise and the residual is larger all the same, something differs from pose to
    pose that no candidate and no smooth function makes. A significant term that was refused is structure that the
    residual of the final model still contains.
    """
    compared = last.stated_noise()
    if compared is None:
        return proved, terms
    is_significant = any(term.finding.p_value <= UNMODELLED_LEVEL for term in refused)
    structure_left = is_significant or _contains_structure(last.found, terms)
    wrong = stated_noise.compare(compared, structure_left)
    if wrong is not None:
        noise = float(
            np.sqrt(len(compared.white)) * stated_sigma(last.bench.recording) * wrong.factor
        )
        proved = replace(
            proved, noise=noise, noise_from=f"{wrong.source}; the stated noise is wrong"
        )
        term = Term(stated_noise.finding_of(wrong), stated_noise.parameters_of(wrong))
        return proved, (*terms, term)
    p = compared.lack_of_fit()
    if not terms and p < UNMODELLED_LEVEL:
        unknown = Finding("unknown", "samples", statements.BY_POSE, (), p, 1.0 - p, 0.0, 0.0)
        return proved, (Term(unknown),)
    return proved, terms


def _contains_structure(found: Found, terms) -> bool:
    """Whether the residual is more than noise: it is significant, or a term is a smooth function without a law.

    Such a function only approximates what it stands for, so that its error remains in the residual.
    """
    unnamed = any(term.finding.effect == "unknown" for term in terms)
    return unnamed or found.p_remainder <= UNMODELLED_LEVEL


def _warnings(bench, recording, terms=(), correlation=None) -> tuple[str, ...]:
    """What is in doubt about this recording, and what its answer cannot contain."""
    on_data, chain = bench.warnings or recording.warnings, bench.chain
    if correlation is not None:
        on_data = (*on_data, correlated_noise(correlation))
    if chain is None:
        return (*on_data, *image_warnings(bench, terms))
    if chain.robot.mass.any() or chain.state.payload.any():
        return on_data
    return (*on_data, NO_MASSES.format(robot=chain.robot.name))


def _searched(bench: Bench, say: _Reporter, jobs: int) -> tuple[Bench, Found, int]:
    """The bench, with jitter where images have some, what the first search finds on it, and the processes for its
    repetitions: several only where it takes long."""
    start, progress = time.perf_counter(), elapsed(say, LEAST_FOLDS)
    bench, found = with_jitter(bench, lambda one: find(one, progress=progress))
    say.first(statements.preliminary(found))
    spent = time.perf_counter() - start
    jobs = jobs if spent > _LONG_S else 1
    if found.findings:
        blocks = sum(len(scheme.folds) for scheme in schemes(bench.pose, found.before))
        left = duration(spent * blocks / max(jobs, 1))
        say(f"the whole search is repeated without each of {blocks} blocks, about {left} left")
    return bench, found, jobs


def _proved(bench, found: Found, noise, say, jobs):
    """Terms that stay, terms refused, and the proof; both kinds with parameters and size."""
    proved, kept, refused = proof.prove(bench, found, found_terms, noise, say, jobs)
    effects = [e for term in kept for e in term.finding.effects]
    rows = bench.parameters(effects, options=_estimated_options(kept))
    stay = tuple(_with_numbers(bench, term, effects, rows) for term in kept)
    gone = tuple(
        _with_numbers(bench, term, (*effects, *term.finding.effects), None) for term in refused
    )
    return stay, gone, proved


def _estimated_options(terms: Sequence[Term]) -> Options:
    """The effects of terms with an option that is a real number, and this option."""
    findings = [term.finding for term in terms if term.finding.option is not None]
    return {found.effects[0]: found.option for found in findings}


def _with_numbers(bench, term: Term, effects, rows) -> Term:
    """The term with its parameters and the RMS displacement that it makes, of a deflection its variation."""
    if rows is None:
        rows = bench.parameters(list(effects), options=_estimated_options([term]))
    own = {(e.effect, e.where) for e in term.finding.effects}
    mine = [r for r in rows if (r["effect"], r["where"]) in own and _of(r, term, bench)]
    mine = with_variation(mine, term.finding.variation)
    varying = [row["size_mm"] for row in mine if row["name"] == DEFLECTION]
    size = varying[0] if len(varying) == 1 else _size(bench, effects, term)
    alarms = (*term.finding.alarms, *implausible_values(mine, size))
    return replace(term, parameters=mine, size=size, finding=replace(term.finding, alarms=alarms))


def _of(row, term: Term, bench) -> bool:
    chain = bench.chain
    key = row.get("first_parameter", row["key"])
    if chain is None or (row.get("derived") and "first_parameter" not in row):
        return True
    return key in {p.key for e in term.finding.effects for p in e.parameters(chain)}


def _size(bench, effects, term: Term) -> float | None:
    """RMS displacement of the measured point (mm, px) that the term makes by itself, to first order."""
    problem = without_jitter(bench).problem(list(effects), hypotheses=False)
    own = [i for i, e in enumerate(effects) if any(e is mine for mine in term.finding.effects)]
    if not own or not problem.added:
        return None
    moved = sum(problem.added[i] @ problem.values[i] for i in own) * unwhitened(problem)
    return float(np.sqrt((moved**2).sum() / problem.n))


def _with_noise(last: FinalModel, terms, refused) -> tuple[Term, ...]:
    """The terms with findings on the data; the direction of noise only where no structure is left."""
    found, after = last.found, last.after
    terms = (*terms, *_of_noise(found, terms, refused, after))
    if refused or last.has_rounding or _contains_structure(found, terms):
        return terms
    return with_angular_noise(terms, last.bench, residuals_of(after), ~found.outliers)


def _of_noise(found: Found, terms, refused, problem) -> tuple[Term, ...]:
    """Findings on the noise, which have no mean to be held out: their p-value is valid over the whole search.

    If a term of the mean was rejected, only outliers and a persisting random effect are kept.
    """
    kept = found.noise_findings
    if refused and kept:
        moves = find_random_effect(problem, RANDOM_EFFECT_LEVEL)
        still = moves.site.where if moves else None
        kept = [f for f in kept if f.effect == "outliers" or f.where == still]
    if (
        not terms
        and found.p_first <= UNMODELLED_LEVEL
        and {f.effect for f in kept} <= {_UNEVEN, "outliers"}
    ):
        # a mean that nothing explains makes the noise heteroscedastic, too
        kept = [f for f in kept if f.effect != _UNEVEN]
    return tuple(Term(finding, size=_spread_size(finding, problem)) for finding in kept)


def _spread_size(finding: Finding, problem) -> float | None:
    """RMS displacement (mm, px) of what a place does by chance, from its size in sigmas; None of all other noise."""
    if not finding.size:
        return None
    return float(finding.size * np.sqrt((unwhitened(problem) ** 2).sum() / problem.n))


def _somewhere(found: Found, terms, refused, problem) -> tuple[Term, ...]:
    """What is there or left though nothing that was found carries to samples that were not fitted: where, on what.

    problem: without what it is said of. Next to it, effects of covariates not recorded that could
    cause it. If no smooth function is significant at any place, the structure is that of the first rejected term.
    """
    if any(term.finding.effect == "unknown" for term in terms):
        return ()
    places = [
        one
        for one in (found.remainder if terms else found.located)
        if one.depends_on and one.p_value < _PLACED and one.share > 0
    ]
    if not places:
        return (Term(_of_refused(found, refused, bool(terms)), remainder=bool(terms)),)
    at = places[0]
    label = "a smooth function of " + " and ".join(at.depends_on)
    unknown = Finding(
        "unknown",
        at.where,
        label,
        (),
        at.p_value,
        0.0,
        at.size,
        0.0,
        at.depends_on,
        (*_refused_there(refused, at), *unrecorded(problem, at)),
    )
    return (Term(unknown, share=at.share, remainder=bool(terms)),)


def _with_equivalent_places(bench, term: Term) -> Term:
    if bench.chain is None:
        return term
    finding = with_equivalent_places(term.finding, bench.chain.robot.joints)
    return replace(term, finding=finding)


def _refused_there(refused, at) -> tuple[Alternative, ...]:
    """Named effects of the first search at a place that cross-validation refused, the most probable first."""
    named = [term.finding for term in refused if term.finding.effects]
    there = [one for one in named if one.where == at.where and one.p_value < _PLACED]
    return tuple(
        Alternative(one.effect, one.where, one.label, one.probability, 1.0, statements.UNCONFIRMED)
        for one in sorted(there, key=lambda one: -one.probability)
    )


def _of_refused(found: Found, refused, remainder: bool) -> Finding:
    """The unknown of structure that no smooth function locates: at the place of the strongest refused term."""
    p = found.p_remainder if remainder else found.p_first
    likely = _likely(refused)
    where = likely[0].where if likely else "samples"
    return Finding("unknown", where, statements.NOT_LOCATED, (), p, 0.0, 0.0, 0.0, (), likely)


def _likely(refused) -> tuple[Alternative, ...]:
    """What an unknown most likely is: the strongest of the significant terms that were refused; () where none is."""
    named = [term.finding for term in refused if term.finding.p_value < _PLACED]
    if not named:
        return ()
    one = max(named, key=lambda one: one.gain)
    about = (one.effect, one.where, one.label, one.probability, 1.0)
    return (Alternative(*about, statements.UNCONFIRMED),)
