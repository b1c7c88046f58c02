"""The main job: from a recording to a calibrated robot, stage by stage, with held-out errors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.measurements.ball_scan import FILE_KIND
from robot_model.robot import Robot
from robot_model.system import (
    RobotChain,
    bind,
    geometry_free,
    held_by_convention,
)
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.least_squares.identifiability import (
    Identifiability,
    identifiability,
)
from workbench.core.least_squares.solver import normal_matrix, pose_scores
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.solution import Solution, Stage
from workbench.files.provenance import provenance
from workbench.files.results import StageResult, calibration_json, joint_stiffness, parameter_rows
from workbench.files.solution_file import name_of
from workbench.files.term_sizes import term_sizes
from workbench.fitting.ball_scans import checked_scans
from workbench.fitting.calibration_plans.missing_masses import (
    missing_mass_warnings,
    wrong_mass_warnings,
)
from workbench.fitting.calibration_plans.parallel_axes import parallelism_warnings
from workbench.fitting.calibration_plans.plans import plan_of_recording, read_plan
from workbench.fitting.checked_samples import CheckedSamples, check_samples, rows_to_fit
from workbench.fitting.cross_validation import (
    HeldOut,
    Split,
    blocks,
    carrying_samples,
    cross_validate,
    error_summary,
    in_rotation,
    in_space,
    predict_test,
    repeat_summary,
    samples_of_some_poses,
)
from workbench.fitting.frame_gauge import undetermined_offset_words, with_offset_priors
from workbench.fitting.linear_folds import cross_validate_linearised
from workbench.fitting.scan_weights import weighed
from workbench.fitting.verdicts.fit_quality import noise_report
from workbench.fitting.verdicts.noise_report import NoiseReport
from workbench.fitting.verdicts.residual_structure import in_root
from workbench.jobs.robot.moved_tests import refitted_errors
from workbench.jobs.robot.stages import (
    LARGE_SAMPLES,
    Chosen,
    Step,
    first_step,
    refit,
    run_stages,
    with_errors_of_result,
)
from workbench.machine.progress import paced

# times the robust spread: a blunder (a lost beam, a wrong ball), not what a model has yet to explain
_OUTLIER = 15.0
_MEDIAN_CHI3 = 1.538  # of the length of a vector whose three components have sigma 1
_ROUNDS = 2
_LEAST_POSES = 4
_CHOSEN_ON = 4000  # samples by which stages are chosen, about: of more, some poses decide the same


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
    suspicions: tuple[str, ...] = ()
    far_geometry: str = ""

    @cached_property
    def noise(self) -> NoiseReport:
        """The residual of the fit compared with the stated noise, replicates and its own structure."""
        return noise_report(self)

    @cached_property
    def stiffness(self) -> list[dict]:
        """A row a joint that deflects, as of `robot_model.stiffness.StiffnessRow`."""
        return joint_stiffness(self)

    @cached_property
    def terms(self) -> list[dict]:
        """Size of each retained term of transmission, compliance and other effects, as of `term_sizes`."""
        return term_sizes(self.model, self.solution.parameters, name_of)

    def as_json(self) -> dict:
        """The object of the JSON contract."""
        return calibration_json(self)


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
    Points on balls enter as scans, one sample for each ball of each pose, see `workbench.fitting.ball_scans`.
    fit_samples, test_samples: sample numbers; what is not named for testing is fitted, and without test samples
    the held-out error is that of `folds` blocks of consecutive poses. progress: called with one line a step.
    trust_data: calibrate also where the plausibility check says that the data cannot be right.
    Raises InputError for a recording that this cannot calibrate.
    """
    checked = recording
    if not isinstance(recording, CheckedSamples):
        checked = check_samples(recording, trust_data, fit_samples, test_samples, True)
    if checked.recording.measures == FILE_KIND:
        checked, (fit_samples, test_samples) = checked_scans(checked, fit_samples, test_samples)
        checked = _weighed_for_plan(checked, plan)
    moving, robot = checked.recording, checked.robot
    split = everyone = _split(checked, fit_samples, test_samples, folds)
    chain = bind(robot, moving, start_on=split.fit)
    stages = _stages(plan, Model(chain).part(split.fit).chain)
    choice_samples = samples_of_some_poses(moving.poses, split.fit, _CHOSEN_ON)
    chosen = _chosen(Model(chain), split, choice_samples, stages, progress)
    for _ in range(_ROUNDS):
        clean = _without_blunders(chosen.step, split, everyone)
        if np.array_equal(clean.fit, split.fit):
            break
        progress(f"{int((everyone.fit & ~clean.fit).sum())} samples far off are left out and named")
        is_same = np.array_equal(clean.fit & choice_samples, split.fit & choice_samples)
        split = clean
        if is_same:
            chosen = _on_all(chosen, split, stages, progress)
        else:
            chosen = _chosen(Model(chain), split, choice_samples, stages, progress)
    _check_degrees_of_freedom(moving.name, chosen)
    calibration = _calibration(checked, chosen, split, progress)
    warnings = (
        *parallelism_warnings(stages, robot),
        *missing_mass_warnings(stages, chain.state),
        *wrong_mass_warnings(calibration.solution.parameters, robot),
    )
    return replace(calibration, warnings=(*calibration.warnings, *warnings))


def _chosen(model: Model, split: Split, choice_samples: np.ndarray, stages, progress) -> Chosen:
    """The plan's model on the samples of a split; its stages are chosen on the `choice_samples` (n,) bool."""
    progress("base and tool at the nominal geometry")
    part = split.only(choice_samples)
    chosen = run_stages(first_step(model, part, stages), stages, part, progress)
    is_part = (split.fit & ~choice_samples).any()
    return _on_all(chosen, split, stages, progress) if is_part else chosen


def _on_all(chosen: Chosen, split: Split, stages, progress) -> Chosen:
    """The chosen model fitted to all samples of a split."""
    progress("the chosen stages on all samples")
    nominal = first_step(chosen.nominal.model, split, stages)
    step = refit(chosen.step, nominal, chosen.retained, split)
    return replace(chosen, nominal=nominal, step=step)


def _stages(plan, chain) -> tuple[Stage, ...]:
    if plan is None:
        return plan_of_recording(chain)
    if callable(plan):
        return tuple(plan(chain))
    if isinstance(plan, str | Path):
        return read_plan(Path(plan))
    return tuple(plan)


def _weighed_for_plan(checked: CheckedSamples, plan) -> CheckedSamples:
    """Scans with the weights next to the geometry and all effects of a given plan, which would blur them."""
    effects = []
    if plan is not None:
        stages = _stages(plan, bind(checked.robot, checked.recording))
        effects = [effect for stage in stages for effect in make_effects(CATALOGUE, stage.effects)]
    return replace(checked, recording=weighed(checked.robot, checked.recording, effects))


def _split(checked: CheckedSamples, fit_samples, test_samples, folds) -> Split:
    recording = checked.recording
    everyone = np.ones(recording.n, bool)
    if test_samples is not None:
        test = np.isin(recording.sample_ids, test_samples)
    else:
        test = ~everyone
    fit = rows_to_fit(recording, fit_samples, test_samples)
    if not test.any() and not fit.all():
        test = ~fit
    fit &= ~np.isin(recording.sample_ids, checked.left_out)
    _check_pose_count(recording, fit)
    fold = np.full(recording.n, -1)
    fold[fit] = blocks(recording.poses[fit], folds)
    return Split(fit, fold, test)


def _check_pose_count(recording, fit: np.ndarray) -> None:
    poses = len(np.unique(recording.poses[fit]))
    if poses < _LEAST_POSES:
        raise InputError(
            f"recording '{recording.name}': {fit.sum()} moving samples at {poses} distinct poses are left to fit; "
            f"expected at least {_LEAST_POSES} poses; measure more"
        )


def _without_blunders(step: Step, split: Split, everyone: Split) -> Split:
    """The split without fit samples that are far off what the whole model leaves elsewhere.

    Far off in position or in orientation. They say something about the recording and nothing about
    the robot: a lost beam, a wrong ball.
    Judged only after all stages, so that physics not yet in the model is not taken for blunders;
    more than a twentieth of the samples is no blunder any more, and stays.
    """
    residual = step.model.residual(step.parameters)
    is_far_off = _is_far_off(residual[:3], split.fit) | _is_far_off(
        in_rotation(residual), split.fit
    )
    is_blunder = is_far_off & everyone.fit
    if is_blunder.sum() > everyone.fit.sum() / 20:
        return split
    return Split(everyone.fit & ~is_blunder, np.where(is_blunder, -1, everyone.fold), everyone.test)


def _is_far_off(residual: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """(n,) bool: residuals (3, n) of a size that normal ones, with the scale of the fitted samples, do not reach."""
    size = np.sqrt((residual**2).sum(0))
    return size > _OUTLIER * np.median(size[fitted]) / _MEDIAN_CHI3


def _check_degrees_of_freedom(name: str, chosen: Chosen) -> None:
    """InputError where the result meets measurements of unknown noise exactly, whatever the arm does.

    The noise would then be zero, and so would be the errors of left-out poses, which follow the start of their fit.
    """
    fit = chosen.step.fit
    chain = chosen.step.model.chain
    if not chain.sigma_unknown or fit.degrees > 1:
        return
    coordinates = fit.residual.size
    asked = chosen.results[0].free if chosen.results else 0
    min_coordinates = max(2 * asked, 2 * coordinates) // len(fit.residual)
    raise InputError(
        f"recording '{name}': expected more measured coordinates than combinations of parameters, found "
        f"{coordinates} coordinates for {chosen.step.rank} combinations: the fit is exact whatever the arm does, so "
        f"that neither noise nor error can be stated; measure about {min_coordinates} poses, state sigma_mm, or "
        "estimate the nominal arm's base and tool alone (--plan base-and-tool)"
    )


def _final_held_out(step: Step, split: Split, progress, label: str) -> HeldOut:
    """The error on the named test samples, else that over the folds of all fitted samples.

    Test samples judge the model that is saved, without another fit. The folds by which its last stage was judged are
    not fitted again. label: of the model, for the line of progress.
    """
    model, start, loss = step.model, step.fit.parameters, step.loss
    if split.test.any():
        progress(f"error of {label} on the test samples")
        return predict_test(model, step.parameters, split.test, split.fit, loss)
    if np.array_equal(step.held_out.fold, split.fold):
        return step.held_out
    progress(f"cross-validation of {label}")
    if loss == "linear" and (split.fold >= 0).sum() >= LARGE_SAMPLES:
        return cross_validate_linearised(model, start, split.fold, settle=step.settle)
    folds = paced(progress, f"cross-validation of {label}, fold")
    return cross_validate(model, start, split.fold, loss, settle=step.settle, tick=folds)


def _calibration(checked: CheckedSamples, chosen: Chosen, split: Split, progress) -> Calibration:
    recording, robot = checked.recording, checked.robot
    nominal, step = chosen.nominal, chosen.step
    held_out = _final_held_out(step, split, progress, "the result")
    before = _final_held_out(nominal, split, progress, "the nominal geometry")
    results = chosen.results
    if not split.test.any():  # test samples are not those by which the stages were judged
        results = with_errors_of_result(results, step, held_out)
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
    moved_tests = _moved_tests(step.model, parameters, split, recording)
    remaining_doubts = checked.warnings_about(step.model)
    open_offsets = filter(None, [undetermined_offset_words(parameters, step.fixed_offsets)])
    return Calibration(
        recording,
        robot,
        step.model,
        solution,
        results,
        tuple(parameter_rows(solution)),
        error_summary(step.fit.residual) | repeat_summary(recording, position["fit"]),
        _held_out_summary(held_out, recording.sample_ids) | moved_tests,
        error_summary(before.residual),
        position["fit"],
        position["held_out"],
        position["nominal"],
        held_out.fold,
        points,
        arrows,
        tuple(int(i) for i in recording.sample_ids[~split.fit & ~split.test]),
        (*checked.recording.warnings, *remaining_doubts, *open_offsets),
        dict(solution.provenance),
        rotation,
        split.fit,
        remaining_doubts,
        checked.far_geometry,
    )


def _moved_tests(model: Model, parameters: Parameters, split: Split, recording) -> dict:
    """The key `refitted_mm` where test samples are named; {} otherwise."""
    if not split.test.any():
        return {}
    return {"refitted_mm": refitted_errors(model, parameters, split.test, recording)}


def _all_known(step: Step, parameters: Parameters, split: Split) -> Identifiability:
    """What the data determine of all that any stage freed, also of what was then held, and what Hayati's rows hold."""
    is_asked = parameters.mask | np.isin(parameters.keys, [*step.tied, *step.fixed_offsets])
    all_known_parameters = with_offset_priors(parameters, step.fixed_offsets).only(
        is_asked & ~step.model.shrunk
    )  # the terms of a series have no sentence of their own
    robot = step.model.chain.robot
    if set(geometry_free(robot)) <= {
        key for key, free in zip(all_known_parameters.keys, all_known_parameters.mask) if free
    }:
        all_known_parameters = all_known_parameters.free(*held_by_convention(robot))
    return identifiability(
        normal_matrix(step.model.part(split.fit), all_known_parameters), all_known_parameters
    )


def _held_out_summary(held_out: HeldOut, numbers: np.ndarray) -> dict:
    """Errors, folds and samples, and those of the sample numbers (n,) that make half of the mean square.

    What had to be located on the tested rows costs one number each.
    """
    folds = len(np.unique(held_out.fold[held_out.fold >= 0]))
    counts = {"folds": folds, "samples": int((held_out.fold >= 0).sum())}
    median = np.nanmedian(np.sqrt(held_out.squares)) if counts["samples"] else np.nan
    carried_by = numbers[carrying_samples(held_out.position)]
    counts |= {"median_mm": float(median), "carried_by": [int(k) for k in carried_by]}
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
