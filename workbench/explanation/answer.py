"""The whole diagnosis: from a recording to findings that are located, named, tested and described."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.samples.group_names import numbered_as
from robot_model.effects.unknown_masses import GravityCompliance
from robot_model.measurements.ball_scan import KIND as BALL_SCAN
from workbench.core.errors import InputError
from workbench.core.model import NOISE
from workbench.diagnosis.levels import DATA_FAULT_LEVEL, UNMODELLED_LEVEL
from workbench.diagnosis.linear.estimates import Options, with_variation
from workbench.diagnosis.linear.problem import Bench, Finding, Found
from workbench.diagnosis.noise.serial_correlation import SerialCorrelation
from workbench.diagnosis.robot.bench import RobotBench, bench_of
from workbench.diagnosis.robot.derived import DEFLECTION
from workbench.diagnosis.search.findings import with_equivalent_places
from workbench.diagnosis.search.select import find, found_terms
from workbench.diagnosis.validation import proof
from workbench.diagnosis.validation.correlated_noise import with_correlated_noise
from workbench.diagnosis.validation.fold_searches import FoldSearches
from workbench.diagnosis.validation.folds import LEAST_FOLDS, schemes, tested_samples
from workbench.diagnosis.validation.stability import is_large
from workbench.explanation.comparison import reference as references
from workbench.explanation.comparison.differences import with_differences
from workbench.explanation.final_model import FinalModel, residuals_of, stated_sigma, unwhitened
from workbench.explanation.fixed_points import fixed_points
from workbench.explanation.minimal_detectable_bias import minimal_detectable_biases
from workbench.explanation.noise import replicates, stated_noise
from workbench.explanation.noise.angular_noise import with_angular_noise
from workbench.explanation.noise.correlated_noise import correlated_noise
from workbench.explanation.noise.heavy_tails import heavy_tails
from workbench.explanation.noise.hidden_harmonics import hidden_harmonics
from workbench.explanation.noise.noise_terms import noise_terms
from workbench.explanation.numbered_samples import with_sentences
from workbench.explanation.planning.experiment import (
    CORRELATED,
    Experiment,
    missing_of,
    next_experiment,
)
from workbench.explanation.reporter import Reporter, ReportProgress, with_numbered_samples
from workbench.explanation.result import (
    UNEXPLAINED,
    Diagnosis,
    Term,
    verdict_of,
)
from workbench.explanation.sensor_errors import (
    ball_centres,
    errors_by_kind,
    image_terms,
    image_warnings,
    laser_line,
    with_random_errors,
    without_jitter,
)
from workbench.explanation.sentences import statements
from workbench.explanation.sentences.plausible_values import implausible_values
from workbench.explanation.turntable import with_turntable
from workbench.explanation.unexplained import (
    contains_structure,
    contains_unexplained_structure,
    is_structure_located,
    next_to_data_findings,
    unknown_terms,
)
from workbench.files.provenance import provenance
from workbench.fitting.verdicts.diagnosis_verdict import NOISE_LEVELS
from workbench.machine.progress import duration, elapsed

IMAGES = ("board-images", "scan-images")
NO_MASSES = (
    "The robot file of {robot!r} states no masses: deflection under gravity is found only as the product of "
    "compliance and first moment. For a stiffness in N m/rad record known loads (payload_kg), or write mass_kg "
    "and com_mm of every joint."
)
_LONG_S = 1.0  # a search beyond which processes are worth their start


def diagnose(
    recording,
    *,
    baseline: str = "geometry",
    simulation: Path | None = None,
    solution: Path | None = None,
    progress: ReportProgress = lambda text: None,
    first: ReportProgress = lambda text: None,
    provisional: Callable[[dict], None] = lambda result: None,
    jobs: int = 1,
    trust_data: bool = False,
) -> Diagnosis:
    """Find the physical effects that the baseline model of a recording lacks.

    baseline: "geometry" or "joint-compliance". simulation, solution: a scene or an earlier calibration to compare
    with, whose effects then belong to the baseline. progress: called with what is done; first: with what the first
    search found, long before it is validated; provisional: with the same as keys. jobs: processes for the searches
    inside folds, where one search takes long enough. trust_data: diagnose also a recording that cannot be right.
    Raises InputError.
    """
    report = Reporter(progress, first, provisional)
    if recording.measures in IMAGES:
        return _of_sensor(recording, simulation or solution, report)
    reference = references.reference_of(simulation, solution, recording.robot)
    if reference is not None:
        recording = numbered_as(recording, reference.group_names)
    report("the baseline")
    bench = bench_of(recording, baseline, trust_data)
    shares = None
    # a scan of a ball is one sample for the reference, too
    compared = bench.recording if bench.recording.measures == BALL_SCAN else recording
    if reference is not None:
        bench, shares = _bench_of_reference(bench, reference, compared)
        baseline = reference.name
    diagnosis = _diagnose_bench(recording, bench, baseline, shares, report, jobs)
    diagnosis = replace(diagnosis, given=bench.baseline)
    if reference is None:
        return diagnosis
    return with_differences(diagnosis, reference, compared)


def _of_sensor(recording, reference, report: "Reporter") -> Diagnosis:
    from workbench.diagnosis.scanner import sensor

    if reference is not None:
        raise InputError(
            f"recording '{recording.name}': --simulation and --solution expect a recording of an arm, found images; "
            "leave the option out."
        )
    bench = sensor.bench_of(recording, report)
    diagnosis = _diagnose_bench(recording, bench, "camera, mirror and poses", None, report)
    return with_turntable(diagnosis, recording, report)


def _bench_of_reference(bench: RobotBench, reference: references.Reference, recording):
    """The bench whose baseline holds the reference's effects, and the three shares of the difference."""
    model, values = references.bound(reference, recording)
    effects = (
        *(e for e in bench.baseline if not _contains(e, reference.effects)),
        *reference.effects,
    )
    chain = replace(
        model.chain, state=replace(model.chain.state, covariates=bench.chain.state.covariates)
    )
    wider = RobotBench(chain, bench.pose, effects, bench.recording, bench.warnings)
    wider.roots_of_points = bench.roots_of_points
    pose = bench.pose
    index = chain.state.index

    def noise_of(residual, degrees):
        return replicates.noise(pose, index, residual, stated_sigma(bench.recording), degrees)[0]

    shares = references.shares(model, values, noise_of, reference.name)
    return wider, shares


def _contains(effect, others) -> bool:
    return any((e.effect, e.where) == (effect.effect, effect.where) for e in others)


def _diagnose_bench(
    recording, bench: Bench, baseline: str, shares, report: Reporter, jobs: int = 1
) -> Diagnosis:
    """Find, prove, say what cannot be seen and what to measure next."""
    bench, found, (terms, refused, proved) = _found_and_proved(bench, report, jobs)
    last, correlation = _final_model(bench, found, terms)
    found = last.found
    proved = last.with_noise(proved)
    terms = _with_noise(last, terms, refused)
    terms = (*terms, *image_terms(bench, terms, found.before))
    proved, terms = _with_stated_noise(last, proved, terms, refused)
    last.found = next_to_data_findings(bench, last.found, terms, refused, proved)
    verdict = _verdict(last, terms, refused, proved)
    if verdict == UNEXPLAINED:
        terms = (*terms, *_unknowns(last, terms, refused))
    report("what these data could have shown")
    detectable = _detectable_biases(bench, found)
    report("the next experiment")
    by_kind, balls = _for_sensor(bench, recording, proved, terms, ~found.outliers)
    diagnosis = Diagnosis(
        recording=recording.name,
        title=recording.title or recording.name,
        measures=recording.measures,
        samples=found.before.n,
        baseline=baseline,
        unit=bench.unit,
        verdict=verdict,
        terms=terms,
        refused=refused,
        located=found.located,
        remainder=found.remainder,
        proof=replace(proved, lack=last.lack()),
        detectable=detectable,
        experiment=_experiment(bench, last, terms, refused, correlation),
        found=found,
        views=last.views(),
        shares=shares,
        outliers=last.outliers(),
        not_recorded=missing_of(terms),
        warnings=_warnings(last, recording, terms, correlation),
        provenance=dict(provenance(recording)),
        fixed=fixed_points(recording, bench, terms),
        by_kind=by_kind,
        balls=balls,
        correlation=correlation,
        laser_line=laser_line(bench),
    )
    return with_sentences(diagnosis, last)


def _unknowns(last: FinalModel, terms, refused) -> tuple[Term, ...]:
    """The term `unknown` of structure that nothing explains, with the places that are equivalent to its own."""
    problem = last.after if terms else last.found.before
    unknowns = unknown_terms(last.found, terms, refused, problem)
    return tuple(_with_equivalent_places(last.bench, term) for term in unknowns)


def _experiment(bench: Bench, last: FinalModel, terms, refused, correlation):
    """Plan the recording that separates what is still in doubt."""
    is_named = any(term.finding.effects for term in terms)
    if correlation is not None and not is_named and last.is_noise_unknown:
        return Experiment(CORRELATED)
    certain = [e for t in terms if t.is_certain for e in t.finding.effects]
    known = bench.problem(certain, tested_samples(bench))
    return next_experiment(bench, terms, known, last.found.p_first, refused)


def _final_model(bench, found: Found, terms) -> tuple[FinalModel, SerialCorrelation | None]:
    """The final model, what is left judged under the correlation of its noise, and this correlation.

    What is left above the noise that is stated or that replicates show is no noise, however it is correlated. Where
    neither says how large the noise is, structure is not judged to be noise because it is correlated.
    """
    last = FinalModel(bench, found, bench.unit, terms)
    if _is_above_noise(last, terms):
        return last, None
    effects = [e for term in terms for e in term.finding.effects]
    fresh, correlation = with_correlated_noise(bench, found, effects, last.after)
    if last.is_noise_unknown:
        return last, correlation
    return FinalModel(bench, fresh, bench.unit, terms), correlation


def _detectable_biases(bench: Bench, found: Found) -> tuple:
    """The smallest sizes that these data, as far as they are tested, would have shown."""
    problem = found.before
    if not problem.candidates:  # a large recording keeps no table of all its samples
        problem = bench.problem((), tested_samples(bench))
    return tuple(
        minimal_detectable_biases(
            problem, unwhitened(problem), lambda candidate: bench.units(candidate.effects)
        )
    )


def _verdict(last: "FinalModel", terms, refused, proved) -> str:
    """The word of the contract for what was proved; last: residuals of the final model."""
    bench = last.bench
    found = last.found
    has_structure = contains_unexplained_structure(
        bench, found, terms, proved, _is_above_noise(last, terms)
    )
    is_placed = is_structure_located(bench, found, refused, proved)
    return verdict_of(terms, found.p_first, has_structure, is_placed)


def _is_above_noise(last: "FinalModel", terms) -> bool:
    """Whether the residual of the final model is significantly above the noise.

    That of replicates where there are enough of them, else the stated one, unless a finding says that it is wrong.
    """
    compared = last.stated_noise()
    if compared is None:
        lack = last.lack()
        return lack is not None and lack["after"]["p_value"] < DATA_FAULT_LEVEL
    if any(term.finding.effect in NOISE_LEVELS for term in terms):
        return compared.lack_of_fit() < DATA_FAULT_LEVEL
    return compared.is_exceeded()


def _for_sensor(bench, recording, proved, terms, inliers):
    """Errors by kind of measurement, and ball centres before and after, of a sensor; nothing of a robot."""
    if recording.measures not in IMAGES:
        return (), None
    return errors_by_kind(bench, proved, inliers), ball_centres(bench, recording, terms)


def _with_stated_noise(last: "FinalModel", proved, terms, refused):
    """Proof and terms with a wrong noise statement, where there is one; the proof then uses the noise that was found.

    Where replicates confirm the stated noise and the residual is larger all the same, something differs from pose to
    pose that no candidate and no smooth function makes. A significant term that was refused is structure that the
    residual of the final model still contains. Without structure, heavy-tailed noise has the RMS of the residual.
    Where the residuals of neighbouring poses are alike, larger or heavy-tailed noise does not explain them.
    """
    compared = last.stated_noise()
    if compared is None:
        return proved, terms
    is_significant = any(term.finding.p_value <= UNMODELLED_LEVEL for term in refused)
    structure_left = is_significant or contains_structure(last.found, terms)
    wrong = stated_noise.compare(compared, structure_left)
    others = [term for term in terms if term.finding.where == NOISE]
    heavy = None if structure_left or others else heavy_tails(compared)
    is_larger = (
        wrong is not None and wrong.source == stated_noise.FROM_RESIDUALS and wrong.factor > 1
    )
    structure = last.local_structure() if is_larger or heavy is not None else None
    if structure is not None:
        return proved, (*terms, Term(structure, remainder=bool(terms)))
    found, why = None, "the stated noise is wrong"
    if heavy is not None:
        found, why = compared.from_residuals(), "the noise is heavy-tailed"
        terms = (*terms, heavy)
    if wrong is not None:
        found = wrong
        harmonics = hidden_harmonics(wrong, terms, compared.degrees, last.bench.chain)
        finding = stated_noise.finding_of(wrong, harmonics)
        terms = (*terms, Term(finding, stated_noise.parameters_of(wrong)))
    if found is not None:
        noise = np.sqrt(len(compared.white)) * stated_sigma(last.bench.recording) * found.factor
        return replace(proved, noise=float(noise), noise_from=f"{found.source}; {why}"), terms
    p = compared.lack_of_fit()
    if not terms and p < UNMODELLED_LEVEL:
        unknown = Finding("unknown", "samples", statements.BY_POSE, (), p, 1.0 - p, 0.0, 0.0)
        return proved, (Term(unknown),)
    return proved, terms


def _warnings(last: FinalModel, recording, terms=(), correlation=None) -> tuple[str, ...]:
    """List what is in doubt about this recording, and what its answer cannot contain."""
    bench = last.bench
    on_data = bench.warnings or recording.warnings
    chain = bench.chain
    if correlation is not None:
        on_data = (*on_data, correlated_noise(correlation, last.is_noise_unknown))
    if chain is None:
        return (*on_data, *image_warnings(bench, terms))
    if chain.robot.mass.any() or chain.state.payload.any():
        return on_data
    return (*on_data, NO_MASSES.format(robot=chain.robot.name))


def _found_and_proved(bench: Bench, report: Reporter, jobs: int):
    """The bench as of `_searched`, what the search finds on it, and what is proved of that, as of `_proved`."""
    with proof.fold_searches(found_terms, jobs) as searches:
        bench, found = _searched(bench, report, searches)
        noise = FinalModel(bench, found, bench.unit).noise
        return bench, found, _proved(bench, found, noise, report, searches)


def _searched(bench: Bench, report: Reporter, searches: FoldSearches) -> tuple[Bench, Found]:
    """The bench, with jitter where images have some, and what the first search finds on it.

    searches: those of its repetitions, with processes where the search takes long: then from the first finding on.
    """
    start, is_found = time.perf_counter(), False
    step = with_numbered_samples(elapsed(report, LEAST_FOLDS), bench)

    def announce(terms):
        nonlocal is_found
        is_found = True
        report.first(statements.first_terms(terms))
        report.provisional(statements.provisional_keys(statements.first_terms(terms), terms))

    def progress(line):
        step(line)
        is_last = bench.chain is not None and bench.roots_of_points is None
        if is_found and is_last and time.perf_counter() - start > _LONG_S:
            _start_folds(bench, searches)

    bench, found = with_random_errors(
        bench, lambda sampled: find(sampled, progress=progress, first=announce)
    )
    searches.use_all_cores()
    report.first(statements.preliminary(found))
    report.provisional(statements.provisional_keys(statements.preliminary(found), found.findings))
    used_seconds = time.perf_counter() - start
    searches.jobs = searches.jobs if used_seconds > _LONG_S else 1
    if found.findings:
        counts = [len(scheme.folds) for scheme in schemes(bench.pose, found.before)]
        blocks = max(counts) if is_large(found.findings, bench) else sum(counts)
        remaining_time = duration(used_seconds * blocks / searches.jobs)
        report(
            f"the whole search is repeated without each of {blocks} blocks, about {remaining_time} left"
        )
    return bench, found


def _start_folds(bench: Bench, searches: FoldSearches) -> None:
    """Start the searches without a block on the cores that the search of all samples leaves idle."""
    if searches.has_begun:
        return
    tested_schemes = schemes(bench.pose, bench.problem((), hypotheses=False))
    searches.start(bench, proof.samples_of_folds(tested_schemes))


def _proved(bench, found: Found, noise, report, searches: FoldSearches):
    """Terms that stay, terms refused, and the proof; both kinds with parameters and size."""
    proved, retained, refused = proof.prove(bench, found, found_terms, noise, report, searches)
    effects = [e for term in retained for e in term.finding.effects]
    rows = bench.parameters(effects, options=_estimated_options(retained))
    stay = tuple(_with_numbers(bench, term, effects, rows) for term in retained)
    refused_terms = tuple(
        _with_numbers(bench, term, (*effects, *term.finding.effects), None) for term in refused
    )
    return stay, refused_terms, proved


def _estimated_options(terms: Sequence[Term]) -> Options:
    """The effects of terms with an option that is a real number, and this option."""
    findings = [term.finding for term in terms if term.finding.option is not None]
    return {found.effects[0]: found.option for found in findings}


def _with_numbers(bench, term: Term, effects, rows) -> Term:
    """The term with its parameters and the RMS displacement that it makes, of a deflection its variation."""
    if rows is None:
        rows = bench.parameters(list(effects), options=_estimated_options([term]))
    effects_of_term = {(e.effect, e.where) for e in term.finding.effects}
    term_rows = [
        r
        for r in rows
        if (r["effect"], r["where"]) in effects_of_term and _belongs_to_term(r, term, bench)
    ]
    term_rows = with_variation(term_rows, term.finding.variation)
    varying = [row["size_mm"] for row in term_rows if row["name"] == DEFLECTION]
    if len(varying) == 1:
        size = varying[0]
    else:
        size = _size(bench, effects, term)
    compliances = _compliances(bench, term)
    alarms = (*term.finding.alarms, *implausible_values(term_rows, size, compliances))
    return replace(
        term, parameters=term_rows, size=size, finding=replace(term.finding, alarms=alarms)
    )


def _compliances(bench, term: Term) -> set[str]:
    """Keys of the compliances of a term. Without stated masses there are only products with first moments."""
    laws = [e for e in term.finding.effects if e.elastic and e.effect != GravityCompliance.effect]
    return {p.key for e in laws for p in e.parameters(bench.chain)[: e.nonnegative]}


def _belongs_to_term(row, term: Term, bench) -> bool:
    chain = bench.chain
    key = row.get("first_parameter", row["key"])
    if chain is None or (row.get("derived") and "first_parameter" not in row):
        return True
    return key in {p.key for e in term.finding.effects for p in e.parameters(chain)}


def _size(bench, effects, term: Term) -> float | None:
    """RMS displacement of the measured point (mm, px) that the term makes by itself, to first order."""
    problem = without_jitter(bench).problem(list(effects), hypotheses=False)
    parameter_places = [
        i for i, e in enumerate(effects) if any(e is effect for effect in term.finding.effects)
    ]
    if not parameter_places or not problem.added:
        return None
    moved = sum(problem.added[i] @ problem.values[i] for i in parameter_places)
    return float(np.sqrt(((moved * unwhitened(problem)) ** 2).sum() / problem.n))


def _with_noise(last: FinalModel, terms, refused) -> tuple[Term, ...]:
    """The terms with findings on the data; the direction of noise only where no structure is left."""
    found, after = last.found, last.after
    terms = (*terms, *noise_terms(found, terms, refused, after))
    if refused or last.has_rounding or contains_structure(found, terms):
        return terms
    return with_angular_noise(terms, last.bench, residuals_of(after), ~found.outliers)


def _with_equivalent_places(bench, term: Term) -> Term:
    if bench.chain is None:
        return term
    finding = with_equivalent_places(term.finding, bench.chain.robot.joints)
    return replace(term, finding=finding)
