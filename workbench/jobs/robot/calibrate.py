"""The main job: from a recording to a calibrated robot, stage by stage, with held-out errors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.robot import Robot
from robot_model.system import (
    RobotChain,
    bind,
    geometry_free,
    held_by_convention,
    redundant_geometry,
)
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.least_squares.identifiability import (
    Identifiability,
    identifiability,
    independent,
)
from workbench.core.least_squares.single_parameters import SingleParameters
from workbench.core.least_squares.solver import Fit, normal_matrix, pose_scores, solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.solution import Solution, Stage
from workbench.files.provenance import provenance
from workbench.files.results import StageResult, calibration_json, joint_stiffness, parameter_rows
from workbench.fitting.checked_samples import CheckedSamples, check_samples, rows_to_fit
from workbench.fitting.cross_validation import (
    HeldOut,
    Split,
    blocks,
    cross_validate,
    error_summary,
    in_rotation,
    in_space,
    predict_test,
    repeat_summary,
)
from workbench.fitting.gauge import non_negligible_lengths, resized, size_of
from workbench.fitting.linear_folds import cross_validate_linearised
from workbench.fitting.missing_masses import missing_mass_warnings
from workbench.fitting.nonnegative import solve_nonnegative
from workbench.fitting.parallel_axes import parallelism_warnings
from workbench.fitting.plans import default_plan, frames_of, held, read_plan, stage_mask
from workbench.fitting.shrinkage import settled
from workbench.fitting.stage_tests import is_retained
from workbench.fitting.trial_fits import fit_with_noise, solve_independent
from workbench.fitting.verdicts.fit_quality import noise_report
from workbench.fitting.verdicts.noise_report import NoiseReport
from workbench.fitting.verdicts.residual_structure import in_root
from workbench.machine.progress import counted, paced

# times the robust spread: a blunder (a lost beam, a wrong ball), not what a model has yet to explain
_OUTLIER = 15.0
_MEDIAN_CHI3 = 1.538  # of the length of a vector whose three components have sigma 1
_ROUNDS = 2
_LEAST_POSES = 4
_FOLD_STEPS = 8  # of a fold that one linearisation does not reach, where stages are compared
_MANY = 1000  # samples from which one linearisation serves all folds by which stages are compared


@dataclass(frozen=True)
class Calibration:
    """A calibrated robot and how good it is.

    `recording`: the moving rows that entered, n samples. Residuals (3, n) mm are predicted minus
    measured in the frame of the measurement, nan where a row was never held out; `fold` (n,) -1
    there; `fitted` (n,) True for the samples of the fit, None where these are all. `points` and
    `residual_in_root` (3, n) mm are in the robot's root frame. `nominal` has base and tool fitted at the
    nominal geometry. Error figures are 3-D distances and, where poses are measured, rotation angles.
    `rotation`: "fit", "held_out", "nominal" -> residual (k, n) of the orientation, rad: k = 3 components
    of the rotation vector from measured to predicted, 2 where one axis is measured, else 0.
    """

    recording: object
    robot: Robot
    model: Model
    solution: Solution
    stages: tuple[StageResult, ...]
    parameters: tuple[dict, ...]
    fit: dict
    held_out: dict
    nominal: dict
    fit_residual: np.ndarray
    held_out_residual: np.ndarray
    nominal_residual: np.ndarray
    fold: np.ndarray
    points: np.ndarray
    residual_in_root: np.ndarray
    suspects: tuple[int, ...]
    warnings: tuple[str, ...]
    provenance: dict
    rotation: Mapping[str, np.ndarray] = field(default_factory=dict)
    fitted: np.ndarray | None = None
    doubts: tuple[str, ...] = ()
    far_geometry: str = ""

    @cached_property
    def noise(self) -> NoiseReport:
        """The residual of the fit compared with the stated noise, replicates and its own structure."""
        return noise_report(self)

    @cached_property
    def stiffness(self) -> list[dict]:
        """A row a joint that deflects, as of `robot_model.effects.stiffness.StiffnessRow`."""
        return joint_stiffness(self)

    def as_json(self) -> dict:
        """The object of the JSON contract."""
        return calibration_json(self)


@dataclass(frozen=True)
class _Step:
    """Where a plan stands: the model so far, its fit on the fit samples, and its held-out error."""

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


def calibrate(
    recording,
    plan: Path | Sequence[Stage] | Callable[[RobotChain], Sequence[Stage]] | None = None,
    fit_samples: Sequence[int] | None = None,
    test_samples: Sequence[int] | None = None,
    folds: int = 10,
    progress: Callable[[str], None] = lambda text: None,
    trust_data: bool = False,
) -> Calibration:
    """Calibrate the robot of a recording.

    recording: a Recording, or its CheckedSamples where several plans are fitted to one recording.
    plan: stages, a TOML file of them, a function that makes them for the chain, or None for the default plan.
    fit_samples, test_samples: sample numbers; what is not named for testing is fitted, and without test samples
    the held-out error is that of `folds` blocks of consecutive poses. progress: called with one line a step.
    trust_data: calibrate also where the plausibility check says that the data cannot be right.
    Raises InputError for a recording that this cannot calibrate.
    """
    checked = recording
    if not isinstance(recording, CheckedSamples):
        checked = check_samples(recording, trust_data, fit_samples, test_samples)
    moving, robot = checked.recording, checked.robot
    split = everyone = _split(moving, fit_samples, test_samples, folds)
    chain = bind(robot, moving, start_on=split.fit)
    stages = _stages(plan, Model(chain).part(split.fit).chain)
    progress("base and tool at the nominal geometry")
    nominal = _first(Model(chain), split, stages)
    step, results = _run(nominal, stages, split, progress)
    for _ in range(_ROUNDS):
        clean = _without_blunders(step, split, everyone)
        if np.array_equal(clean.fit, split.fit):
            break
        progress(
            f"{int((everyone.fit & ~clean.fit).sum())} samples far off are left out and named; once more"
        )
        split = clean
        nominal = _first(Model(chain), split, stages)
        step, results = _run(nominal, stages, split, progress)
    made = _calibration(checked, nominal, step, results, split, progress)
    doubts = *parallelism_warnings(stages, robot), *missing_mass_warnings(stages, chain.state)
    return replace(made, warnings=(*made.warnings, *doubts))


def _stages(plan, chain) -> tuple[Stage, ...]:
    if plan is None:
        return default_plan(chain)
    if callable(plan):
        return tuple(plan(chain))
    return read_plan(Path(plan)) if isinstance(plan, str | Path) else tuple(plan)


def _split(recording, fit_samples, test_samples, folds) -> Split:
    everyone = np.ones(recording.n, bool)
    test = np.isin(recording.sample_ids, test_samples) if test_samples is not None else ~everyone
    fit = rows_to_fit(recording, fit_samples, test_samples)
    if not test.any() and not fit.all():
        test = ~fit
    poses = len(np.unique(recording.poses[fit]))
    if poses < _LEAST_POSES:
        raise InputError(
            f"recording '{recording.name}': {fit.sum()} moving samples at {poses} distinct poses are left to fit; "
            f"expected at least {_LEAST_POSES} poses; measure more"
        )
    fold = np.full(recording.n, -1)
    fold[fit] = blocks(recording.poses[fit], folds)
    return Split(fit, fold, test)


def _without_blunders(step: _Step, split: Split, everyone: Split) -> Split:
    """The split without fit samples that are far off what the whole model leaves elsewhere.

    Far off in position or in orientation. They say something about the recording and nothing about
    the robot: a lost beam, a wrong ball.
    Judged only after all stages, so that physics not yet in the model is not taken for blunders;
    more than a twentieth of the samples is no blunder any more, and stays.
    """
    residual = step.model.residual(step.parameters)
    off = np.zeros(len(everyone.fit), bool)
    for part in (residual[:3], in_rotation(residual)):
        size = np.sqrt((part**2).sum(0))
        off |= size > _OUTLIER * np.median(size[split.fit]) / _MEDIAN_CHI3
    off &= everyone.fit
    if off.sum() > everyone.fit.sum() / 20:
        return split
    return Split(everyone.fit & ~off, np.where(off, -1, everyone.fold), everyone.test)


def _first(model: Model, split: Split, stages: Sequence[Stage]) -> _Step:
    start = held(model.parameters, stages)
    free = start.only(start.mask & start.matching(*frames_of(start)))
    fit = solve(model.part(split.fit), free)
    return _Step(
        model,
        fit.parameters,
        fit,
        _held_out(model, fit, split, "linear", 50),
        {},
        len(fit.normal),
        len(fit.normal),
    )


def _run(nominal: _Step, stages, split, progress):
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


def _prune(nominal: _Step, step: _Step, rows, split, progress):
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
        without = _try(replace(step, model=fewer), merged, split)
        if without.held_out.is_materially_worse_than(step.held_out):
            continue
        if not is_retained(without, step, tests, split.fit):
            change = f"with it added back, held-out {step.held_out.change_from(without.held_out)}"
            sentence = (
                f"{result.sentence}; no longer earned after the later stages ({change}): left out"
            )
            rows[k] = stage, replace(result, earned=False, sentence=sentence)
            progress(rows[k][1].sentence)
            step = without
    return step, tuple(result for _, result in rows)


def _without_effects(model: Model, stages: Sequence[Stage], left_out: Stage) -> Model:
    """A model of the effects of some stages, in their order, without those of one of them; bases are kept."""
    kept, first = [], 0
    for stage in stages:
        end = first + len(stage.effects)
        kept += [] if stage is left_out else model.effects[first:end]
        first = end
    return replace(model, effects=tuple(kept))


def _merged(stages, nominal: _Step) -> Stage:
    """One stage that frees all that some stages do, in a model that has their effects."""
    every = tuple(row for stage in stages for row in stage.effects)
    model = nominal.model.with_effects(*make_effects(CATALOGUE, every))
    mask = np.zeros(len(model.parameters), bool)
    for stage in stages:
        effects = make_effects(CATALOGUE, stage.effects)
        mask |= stage_mask(model.parameters, stage, effects, model.chain)
    free = tuple(key for key, wanted in zip(model.parameters.keys, mask) if wanted)
    first, last = stages[0], stages[-1]
    canonical = first.canonical and last.canonical
    return replace(last, name="result", effects=(), free=free, canonical=canonical)


def _try(step: _Step, stage: Stage, split: Split) -> _Step:
    """The model with the stage's effects, solved on the fit samples and tested on the others.

    Solves with all that the stage frees, and all that earlier ones left out, until the noise is that of their residual:
    only then can it be said which parameters these data determine, and the last solve has only those.
    """
    effects = make_effects(CATALOGUE, stage.effects)
    model = step.model.with_effects(*effects)
    start = model.parameters.take_over(step.parameters)
    left_out_before = np.isin(start.keys, list(step.tied)) & stage.canonical
    own = stage_mask(start, stage, effects, model.chain)
    wanted = start.only(start.mask | left_out_before | own)
    size = size_of(model.chain, wanted) if stage.canonical else None
    asked, wanted = int(wanted.mask.sum()), wanted if size is None else wanted.fix(size)
    trial, part, chain = fit_with_noise(model, split.fit, step.fit, wanted, stage)
    model, free, tied = model.with_chain(chain), trial.parameters, {}
    if stage.canonical:
        free, tied = _canonical(part, trial, wanted)
    fit = solve_independent(part, trial, free, stage)
    if stage.canonical:
        fit = settled(part, fit, stage.loss, stage.steps)
    if size is not None:
        fit = solve(part, resized(fit.parameters, size), stage.loss, stage.steps)
        tied = tied | {size: non_negligible_lengths(wanted, size)}
    fit, at_zero = solve_nonnegative(part, fit, stage.loss, stage.steps, tied)
    known = identifiability(fit.normal, fit.parameters, fit.sigma_scale)
    held_out = _held_out(model, fit, split, stage.loss, stage.steps, stage.canonical)
    return _Step(
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
    )


def _canonical(model, trial: Fit, wanted: Parameters):
    """Free only what earlier parameters do not already make, judged at the trial's solution.

    Starts from the trial's values; parameters that are not freed return to their earlier values. The terms of a
    series stay: their common prior decides what the data determine.
    """
    shrunk = model.shrunk
    others = trial.parameters.only(trial.parameters.mask & ~shrunk)
    chosen = others.mask[trial.parameters.mask]
    is_known = trial.gradient is not None
    normal = trial.normal[np.ix_(chosen, chosen)] if is_known else normal_matrix(model, others)
    redundant = redundant_geometry(model.chain.robot)
    free, tied = independent(normal, others, redundant=redundant)
    free = free.only(free.mask | (shrunk & trial.parameters.mask))
    return replace(free, values=np.where(free.mask, trial.parameters.values, wanted.values)), tied


def _held_out(model, fit, split, loss, steps, settle=False) -> HeldOut:
    """Judged on folds of the fit samples alone: test samples have no part in choosing stages.

    Of few samples each fold is a fit of its own: it differs much from that of all samples, and takes little time.
    """
    if loss != "linear" or (split.judged >= 0).sum() < _MANY:
        return cross_validate(model, fit.parameters, split.judged, loss, steps, settle)
    steps = min(steps, _FOLD_STEPS)
    return cross_validate_linearised(model, fit.parameters, split.judged, steps, settle)


def _final_held_out(step: _Step, split: Split, progress, what: str) -> HeldOut:
    """The error on the named test samples, else that over the folds of all fitted samples.

    Test samples judge the model that is saved, without another fit. what: of the model, for the line of progress.
    """
    model, start, loss = step.model, step.fit.parameters, step.loss
    if split.test.any():
        progress(f"error of {what} on the test samples")
        return predict_test(model, step.parameters, split.test, split.fit, loss)
    progress(f"cross-validation of {what}")
    folds = paced(progress, f"cross-validation of {what}, fold")
    return cross_validate(model, start, split.fold, loss, settle=step.settle, tick=folds)


def _stage_result(stage, before: _Step, after: _Step, earned) -> StageResult:
    change = f"held-out {after.held_out.change_from(before.held_out)}"
    falls = after.held_out.falls_from(before.held_out)
    verdict = f", lower in {(falls > 0).sum()} of {len(falls)} folds" + (
        "" if earned else ": not retained by cross-validation"
    )
    errors = error_summary(after.fit.residual)
    rotation = after.held_out.rotation_rms
    return StageResult(
        stage.name,
        stage.why,
        after.free,
        after.rank,
        errors["rms_mm"],
        after.held_out.rms,
        earned,
        f"{stage.name}: {change}{verdict}",
        after.fit.outcome,
        after.fit.history,
        errors.get("rotation_rms_deg"),
        None if rotation is None else float(np.rad2deg(rotation)),
    )


def _calibration(
    checked: CheckedSamples, nominal: _Step, step: _Step, stages, split, progress
) -> Calibration:
    recording, robot = checked.recording, checked.robot
    held_out = _final_held_out(step, split, progress, "the result")
    before = _final_held_out(nominal, split, progress, "the nominal geometry")
    progress("uncertainty of the parameters")
    parameters = step.parameters.update(held_out.located)
    scores = pose_scores(step.model.part(split.fit), step.fit, recording.poses[split.fit])
    known = _all_known(step, parameters, split)
    shrunk = frozenset(np.array(parameters.keys)[step.model.shrunk & parameters.mask].tolist())
    source = provenance(recording)
    solution = Solution(parameters, step.fit, known, source, scores, shrunk, step.at_zero)
    residuals = {
        "fit": step.model.residual(parameters),
        "held_out": held_out.residual,
        "nominal": nominal.model.residual(nominal.parameters),
    }
    position = {name: in_space(residual) for name, residual in residuals.items()}
    rotation = {name: in_rotation(residual) for name, residual in residuals.items()}
    shown = np.where(np.isfinite(held_out.position), held_out.position, position["fit"])
    points, arrows = in_root(step.model, parameters, shown)
    return Calibration(
        recording,
        robot,
        step.model,
        solution,
        stages,
        tuple(parameter_rows(solution)),
        error_summary(step.fit.residual) | repeat_summary(recording, position["fit"]),
        _held_out_summary(held_out),
        error_summary(before.residual),
        position["fit"],
        position["held_out"],
        position["nominal"],
        held_out.fold,
        points,
        arrows,
        tuple(int(i) for i in recording.sample_ids[~split.fit & ~split.test]),
        checked.warnings,
        dict(solution.provenance),
        rotation,
        split.fit,
        checked.doubts,
        checked.far_geometry,
    )


def _all_known(step: _Step, parameters: Parameters, split: Split) -> Identifiability:
    """What the data determine of all that any stage freed, also of what was then held, and what Hayati's rows hold."""
    asked = parameters.mask | np.isin(parameters.keys, list(step.tied))
    everything = parameters.only(
        asked & ~step.model.shrunk
    )  # the terms of a series have no sentence of their own
    robot = step.model.chain.robot
    if set(geometry_free(robot)) <= {
        key for key, free in zip(everything.keys, everything.mask) if free
    }:
        everything = everything.free(*held_by_convention(robot))
    return identifiability(normal_matrix(step.model.part(split.fit), everything), everything)


def _held_out_summary(held_out: HeldOut) -> dict:
    """Errors, folds and samples; what had to be located on the tested rows costs one number each."""
    folds = len(np.unique(held_out.fold[held_out.fold >= 0]))
    counts = {"folds": folds, "samples": int((held_out.fold >= 0).sum())}
    return (
        error_summary(held_out.residual)
        | counts
        | {"located_on_test_rows": sorted(held_out.located)}
    )


def save(calibration: Calibration, folder: Path) -> None:
    """Write parameters.toml, residuals.csv and calibration.json into `folder`."""
    from workbench.files.results import save_calibration

    save_calibration(calibration, Path(folder))


__all__ = ["Calibration", "Stage", "StageResult", "calibrate", "save"]
