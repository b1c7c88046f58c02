"""Stages of a plan: each is fitted, tested on held-out samples, and retained where cross-validation says so."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.system import redundant_geometry
from workbench.core.effect import make_effects
from workbench.core.least_squares.identifiability import identifiability, independent
from workbench.core.least_squares.single_parameters import SingleParameters
from workbench.core.least_squares.solver import Fit, normal_matrix, solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.solution import Stage
from workbench.files.results import StageResult
from workbench.fitting.calibration_plans.plans import frames_of, stage_mask, with_known_values
from workbench.fitting.calibration_plans.stage_tests import is_retained
from workbench.fitting.cross_validation import HeldOut, Split, cross_validate, error_summary
from workbench.fitting.frame_gauge import ROOT, undetermined_offsets, undetermined_root
from workbench.fitting.gauge import non_negligible_lengths, resized, size_of
from workbench.fitting.linear_folds import cross_validate_linearised
from workbench.fitting.nonnegative import solve_nonnegative
from workbench.fitting.priors.shrinkage import settled
from workbench.fitting.priors.trial_fits import fit_with_noise, solve_independent
from workbench.machine.progress import counted

_FOLD_STEPS = 8  # of a fold that one linearisation does not reach, where stages are compared
LARGE_SAMPLES = (
    1000  # samples from which one linearisation serves all folds by which stages are compared
)


@dataclass(frozen=True)
class Step:
    """Where a plan stands: the model so far, its fit on the fit samples, and its held-out error.

    `fixed_offsets`: keys of the tool's translations that are held, since the data do not determine them.
    """

    model: Model
    parameters: Parameters
    fit: Fit
    held_out: HeldOut
    tied: dict
    free: int
    rank: int
    loss: str = "linear"
    settle: bool = False
    at_zero: frozenset[str] = frozenset()
    fixed_offsets: tuple[str, ...] = ()


@dataclass(frozen=True)
class Chosen:
    """The model of a plan: its nominal and its last step, the results of all stages, and the stages retained."""

    nominal: Step
    step: Step
    results: tuple[StageResult, ...]
    retained: tuple[Stage, ...]


def first_step(model: Model, split: Split, stages: Sequence[Stage]) -> Step:
    """Base and tool at the nominal geometry; stages: of the plan, which may hold parameters."""
    start = with_known_values(model.parameters, stages)
    free = start.only(start.mask & start.matching(*frames_of(start)))
    fit = solve(model.part(split.fit), free)
    return Step(
        model,
        fit.parameters,
        fit,
        _held_out(model, fit, split, "linear", 50),
        {},
        len(fit.normal),
        len(fit.normal),
    )


def run_stages(nominal: Step, stages, split, progress) -> Chosen:
    """All stages in order, then once more without each: a stage stays only if cross-validation retains it."""
    step, results, tried = nominal, [], []
    tests = sum(stage.earn for stage in stages)
    begin = counted(progress, len(stages))
    for planned in stages:
        begin(f"stage {planned.name}: {planned.why}")
        stage = planned.chosen_for(step.model.part(split.fit), step.parameters)
        if planned.choose is not None and not stage.effects:
            continue
        tried.append(stage)
        after = _try(step, stage, split)
        earned = not stage.earn or is_retained(step, after, tests, split.fit)
        results.append(_stage_result(stage, step, after, earned))
        progress(results[-1].sentence)
        step = after if earned else step
    return _prune(nominal, step, list(zip(tried, results)), split, progress)


def refit(step: Step, nominal: Step, retained: Sequence[Stage], split: Split) -> Step:
    """The model of a step that was chosen on some samples, fitted to all of a split; without a held-out error.

    nominal: the first step on all samples; retained: the stages that are in the model.
    """
    residual = step.model.part(split.fit).residual(step.parameters)
    degrees_used = step.fit.residual.size - step.fit.degrees
    weights = np.ones(residual.shape[1])
    degrees = residual.size - degrees_used
    before = replace(step.fit, residual=residual, weights=weights, degrees=degrees, gradient=None)
    fold = np.full(len(split.fold), -1)
    untested = replace(split, fold=fold)
    return _try(replace(step, fit=before), _merged(retained, nominal), untested)


def _prune(nominal: Step, step: Step, rows, split, progress) -> Chosen:
    """Remove stages that cross-validation no longer retains once a later stage explains the same.

    None is removed whose absence makes the held-out error materially larger: a single block of poses that only this
    stage predicts well is no significant gain, but the model without it fails there.
    """
    tests = sum(stage.earn for stage, _ in rows)
    begin = counted(progress, max(1, sum(s.earn and r.earned for s, r in rows[:-1])))
    for k, (stage, result) in enumerate(rows):
        others = [s for i, (s, r) in enumerate(rows) if r.earned and i != k]
        if not (
            stage.earn
            and result.earned
            and any(s is later for s in others for later, _ in rows[k + 1 :])
        ):
            continue
        begin(f"the result without {stage.name}")
        fewer = _without_effects(step.model, [s for s, r in rows if r.earned], stage)
        merged = _merged(others, nominal)
        reduced = _try(replace(step, model=fewer), merged, split)
        if reduced.held_out.is_materially_worse_than(step.held_out):
            continue
        if not is_retained(reduced, step, tests, split.fit):
            change = f"with it added back, held-out {step.held_out.change_from(reduced.held_out)}"
            sentence = f"{result.sentence}; without a significant gain after the later stages ({change}): left out"
            rows[k] = stage, replace(result, earned=False, sentence=sentence)
            progress(rows[k][1].sentence)
            step = reduced
    retained = tuple(stage for stage, result in rows if result.earned)
    return Chosen(nominal, step, tuple(result for _, result in rows), retained)


def _without_effects(model: Model, stages: Sequence[Stage], left_out: Stage) -> Model:
    """A model of the effects of some stages, in their order, without those of one of them; bases are kept."""
    stages_without, first = [], 0
    for stage in stages:
        end = first + len(stage.effects)
        stages_without += [] if stage is left_out else model.effects[first:end]
        first = end
    return replace(model, effects=tuple(stages_without))


def _merged(stages, nominal: Step) -> Stage:
    """One stage that frees all that some stages do, in a model that has their effects."""
    effect_rows = tuple(row for stage in stages for row in stage.effects)
    model = nominal.model.with_effects(*make_effects(CATALOGUE, effect_rows))
    mask = np.zeros(len(model.parameters), bool)
    for stage in stages:
        effects = make_effects(CATALOGUE, stage.effects)
        mask |= stage_mask(model.parameters, stage, effects, model.chain)
    free = tuple(key for key, wanted in zip(model.parameters.keys, mask) if wanted)
    first = stages[0]
    last = stages[-1]
    canonical = first.canonical and last.canonical
    return replace(last, name="result", effects=(), free=free, canonical=canonical)


def _try(step: Step, stage: Stage, split: Split) -> Step:
    """The model with the stage's effects, solved on the fit samples and tested on the others.

    Solves with all that the stage frees, and all that earlier ones left out, until the noise is that of their residual:
    only then can it be said which parameters these data determine, and the last solve has only those.
    """
    effects = make_effects(CATALOGUE, stage.effects)
    model = step.model.with_effects(*effects)
    start = model.parameters.take_over(step.parameters)
    left_out_before = np.isin(start.keys, list(step.tied)) & stage.canonical
    free_of_stage = stage_mask(start, stage, effects, model.chain)
    wanted = start.only(start.mask | left_out_before | free_of_stage)
    size = size_of(model.chain, wanted) if stage.canonical else None
    asked = int(wanted.mask.sum())
    wanted = wanted if size is None else wanted.fix(size)
    trial, part, chain = fit_with_noise(model, split.fit, step.fit, wanted, stage)
    fixed = undetermined_offsets(part, trial) if stage.canonical else []
    if fixed:
        wanted = wanted.fix(*fixed)
        trial, part, chain = fit_with_noise(model, split.fit, step.fit, wanted, stage)
    model = model.with_chain(chain)
    fit = trial
    tied = {}
    if stage.canonical:
        root = undetermined_root(part, trial)
        free, tied = _canonical(part, trial, wanted, root)
        fit = solve_independent(part, trial, free, stage, root)
        is_free = dict(zip(fit.parameters.keys, fit.parameters.mask))
        tied = {key: partners for key, partners in tied.items() if not is_free[key]}
        fit = settled(part, fit, stage.loss, stage.steps)
    if size is not None:
        fit = solve(part, resized(fit.parameters, size), stage.loss, stage.steps)
        tied = tied | {size: non_negligible_lengths(wanted, size)}
    fit, at_zero = solve_nonnegative(part, fit, stage.loss, stage.steps, tied)
    known = identifiability(fit.normal, fit.parameters, fit.sigma_scale)
    held_out = _held_out(model, fit, split, stage.loss, stage.steps, stage.canonical)
    return Step(
        model,
        fit.parameters,
        fit,
        held_out,
        tied if stage.canonical else step.tied,
        asked,
        SingleParameters.of(known, fit.parameters).combinations,
        stage.loss,
        stage.canonical,
        at_zero,
        _still_held((*step.fixed_offsets, *fixed), fit.parameters),
    )


def _still_held(keys: Sequence[str], parameters: Parameters) -> tuple[str, ...]:
    """The keys, each once, without those of parameters that are free."""
    return tuple(k for k in dict.fromkeys(keys) if not parameters.mask[parameters.index[k]])


def _canonical(model, trial: Fit, wanted: Parameters, root: Sequence[str]):
    """Free only what earlier parameters do not already make, judged at the trial's solution.

    Starts from the trial's values; parameters that are not freed return to their earlier values. The terms of a
    series stay: their common prior decides what the data determine. root: keys that place the root frame, to be held.
    """
    shrunk = model.shrunk
    mask = trial.parameters.mask
    others = trial.parameters.only(mask & ~shrunk)
    chosen = others.mask[mask]
    is_known = trial.gradient is not None
    if is_known:
        normal = trial.normal[np.ix_(chosen, chosen)]
    else:
        normal = normal_matrix(model, others)
    redundant = redundant_geometry(model.chain.robot)
    free, tied = independent(normal, others, redundant=redundant)
    tied = {key: [ROOT[key]] for key in root} | tied
    free = free.only((free.mask & ~np.isin(free.keys, root)) | (shrunk & mask))
    values = np.where(free.mask, trial.parameters.values, wanted.values)
    return replace(free, values=values), tied


def _held_out(model, fit, split, loss, steps, settle=False) -> HeldOut:
    """Judged on folds of the fit samples alone: test samples have no part in choosing stages.

    Of few samples each fold is a fit of its own: it differs much from that of all samples, and takes little time.
    """
    if loss != "linear" or (split.fold >= 0).sum() < LARGE_SAMPLES:
        return cross_validate(model, fit.parameters, split.fold, loss, steps, settle)
    steps = min(steps, _FOLD_STEPS)
    return cross_validate_linearised(model, fit.parameters, split.fold, steps, settle)


def with_errors_of_result(results, step: Step, held_out: HeldOut) -> tuple[StageResult, ...]:
    """The results of stages; the row of the last retained one has the size and the errors of the final model.

    The final model differs from that at this stage where an earlier stage was left out after it, or samples far off.
    step: with the final model; held_out: its errors.
    """
    last = max((k for k, row in enumerate(results) if row.earned), default=None)
    if last is None:
        return tuple(results)
    numbers = _numbers(step, held_out)
    return (*results[:last], replace(results[last], **numbers), *results[last + 1 :])


def _numbers(step: Step, held_out: HeldOut) -> dict:
    """Size and errors of the model of a step, as `StageResult` names them."""
    errors = error_summary(step.fit.residual)
    rotation = held_out.rotation_rms
    return {
        "free": step.free,
        "identifiable": step.rank,
        "rms_mm": errors["rms_mm"],
        "held_out_rms_mm": held_out.rms,
        "rotation_rms_deg": errors.get("rotation_rms_deg"),
        "held_out_rotation_rms_deg": None if rotation is None else float(np.rad2deg(rotation)),
    }


def _stage_result(stage, before: Step, after: Step, earned) -> StageResult:
    change = f"held-out {after.held_out.change_from(before.held_out)}"
    falls = after.held_out.falls_from(before.held_out)
    verdict = f", lower in {(falls > 0).sum()} of {len(falls)} folds" + (
        "" if earned else ": not retained by cross-validation"
    )
    return StageResult(
        name=stage.name,
        why=stage.why,
        earned=earned,
        sentence=f"{stage.name}: {change}{verdict}",
        outcome=after.fit.outcome,
        history=after.fit.history,
        **_numbers(after, after.held_out),
    )
