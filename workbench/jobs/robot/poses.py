"""Which poses to measure: reachable, visible, without self-collision, and most informative."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from datasets.samples.columns import joint_columns
from robot_model.effects import CATALOGUE
from robot_model.measurements import end_recordings, measurement_of, samples_of
from robot_model.postures.clearance import self_clearance
from robot_model.system import bind, geometry_free, held_by_convention
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.least_squares.design import Design, choose
from workbench.core.least_squares.identifiability import identifiability, independent
from workbench.core.least_squares.linear_algebra import covariance_of
from workbench.core.least_squares.solver import normal_matrix
from workbench.core.model import Model
from workbench.core.text.csv_text import csv_text
from workbench.files.images.visibility import EVERYTHING, Sight, unseen
from workbench.fitting.calibration_plans.plans import default_plan, frames_of
from workbench.fitting.checked_samples import check_samples
from workbench.machine.progress import staged

CRITERIA = ("D", "O1", "O2", "O3", "O4", "O5", "task")
_NOMINAL_SIGMA_MM = 0.05
# knows a parameter to a hundred typical sizes: what a calibration's own covariance has where nothing is known
_FAINT = 1e-4
LINK_RADIUS_MM = 50.0


@dataclass(frozen=True)
class Chosen:
    """`samples` numbers of the rows at the chosen poses; `design` how good they are; `undetermined` what stays open.

    `candidates` poses to choose from, `left_out` (reason -> how many) of those that were no candidates. A pose
    that is taken several times has its samples as often. `rotation`: predicted orientation error at the tasks,
    deg RMS, of the chosen poses and of all candidates; empty where the tasks measure no orientation.
    """

    recording: object
    samples: tuple[int, ...]
    design: Design
    criterion: str
    undetermined: tuple[str, ...]
    candidates: int
    left_out: dict[str, int]
    parameters: int
    rotation: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def predicted(self) -> dict | None:
        """Error at the tasks, mm RMS, of the set and, median, of random ones; None for other criteria.

        `bound_mm`: no set of as many of the candidates is predicted below it; `share_of_twice_beaten` of the random
        sets of twice the size, None where there are not that many candidates.
        """
        found = self.design
        if found.bound is None:
            return None
        doubled = found.twice if len(found.twice) else None
        squares = {
            "chosen_mm": found.value,
            "random_mm": np.median(found.random),
            "random_twice_mm": None if doubled is None else np.median(doubled),
            "all_mm": found.everything,
            "bound_mm": max(found.bound, 0.0),
        }
        errors = {
            key: None if square is None else float(np.sqrt(square))
            for key, square in squares.items()
        }
        if doubled is None:
            share = None
        else:
            share = float((doubled > found.value).mean())
        return errors | {"share_of_twice_beaten": share} | dict(self.rotation)

    def as_json(self) -> dict:
        """The answer of `workbench poses`."""
        return {
            "command": "poses",
            "recording": self.recording.name,
            "criterion": self.criterion,
            "poses": len(self.design.chosen),
            "candidates": self.candidates,
            "left_out": self.left_out,
            "parameters": self.parameters,
            "value": self.design.value,
            "random_median": float(np.median(self.design.random)),
            "gain_over_random": self.design.gain,
            "predicted": self.predicted(),
            "samples": list(self.samples),
            "undetermined": list(self.undetermined),
            "warnings": list(self.warnings),
        }


def choose_poses(
    recording,
    n: int,
    criterion: str = "D",
    tasks=None,
    effects: bool | Sequence[tuple[str, str, dict]] = False,
    link_radius_mm: float = LINK_RADIUS_MM,
    seed: int = 0,
    sight: Sight = EVERYTHING,
    repeats: int = 1,
    trust_data: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> Chosen:
    """The n of a recording's poses from which the geometry (and, with `effects`, all stages) is best determined.

    effects: True for those of the default plan, or (name, where, options) rows of a plan.

    recording: candidates, measured or simulated. tasks: for criterion "task" a recording of the same
    robot and kind, whose predicted error is to be small. link_radius_mm: half the thickness of the
    arm's links, for the check of self-collision; 0 leaves the check out. sight: what the
    sensor on the arm can see. repeats: how often one pose may be measured.
    The predicted error at the tasks is that of the calibration's own covariance: with the priors of its parameters
    and the stated noise (0.05 mm a coordinate where none is). The criterion is of the positions; where poses are
    measured, the predicted error of the orientation is reported with it.
    trust_data: choose also from a recording that cannot be right. progress: called with one line a step.
    Raises InputError where there are too few candidates or the criterion is not known.
    """
    _check_criterion(criterion, tasks)
    checked = check_samples(recording, trust_data)
    moving, robot = checked.recording, checked.robot
    good, left_out = _usable(robot, moving, link_radius_mm, sight.checked(recording.measures))
    moving = moving.select(good)
    poses = np.unique(moving.poses, return_inverse=True)[1]
    count = poses.max(initial=-1) + 1
    if count < 2:
        raise InputError(
            f"{recording.name}: expected at least 2 poses that can be used, found {count} "
            f"({_describe_exclusions(left_out)}); bring other candidates, or ask for less of the sensor and the arm"
        )
    _check_counts(n, count, repeats, recording.name, left_out)
    model, free, everything = _model(robot, moving, effects)
    if not free.mask.any():
        raise InputError(
            f"{recording.name}: expected candidate poses that determine at least one parameter of the "
            "arm, found none that changes a measurement by more than its sigma; bring poses that differ "
            "more, or check sigma_mm"
        )
    rows = _by_pose(_whitened(model, free), poses)
    wanted = None if tasks is None else _task_rows(robot, model, tasks, free)
    known = None if tasks is None else _known(free)
    positions = None if wanted is None else wanted[:, :3]
    options = {"known": known, "repeats": repeats, "bounded": True, "progress": staged(progress)}
    design = choose(rows, n, criterion, positions, seed, **options)
    if wanted is None:
        rotation = {}
    else:
        rotation = _rotation_errors(rows, wanted[:, 3:], known, design.chosen)
    counts = np.bincount(design.chosen, minlength=count)[poses]
    picked = _in_rounds(counts)
    everything = everything.free(*held_by_convention(robot))
    identified = identifiability(normal_matrix(model.at(picked), everything), everything)
    samples = tuple(int(i) for end in end_recordings(moving) for i in end.sample_ids[picked])
    return Chosen(
        recording,
        samples,
        design,
        criterion,
        tuple(identified.sentences()),
        int(count),
        left_out,
        int(free.mask.sum()),
        rotation,
        checked.warnings,
    )


def _check_criterion(criterion: str, tasks) -> None:
    """InputError where the criterion is not known, or does not go with `tasks`."""
    if criterion not in CRITERIA:
        raise InputError(
            f"--criterion {criterion}: expected one of {', '.join(CRITERIA)}, found none of them; "
            "correct it"
        )
    if (criterion == "task") != (tasks is not None):
        raise InputError(
            f"--criterion {criterion}: expected --tasks RECORDING with the criterion task and with no "
            f"other, found {'none' if tasks is None else 'one'}; correct the call"
        )


def _check_counts(n: int, count: int, repeats: int, name: str, left_out) -> None:
    """InputError where n poses cannot be chosen from `count` usable ones."""
    if repeats < 1:
        raise InputError(
            f"--repeats {repeats}: expected how often one pose may be measured, at least 1; correct it"
        )
    if not 2 <= n <= count:
        raise InputError(
            f"--count {n}: expected 2 to {count}, the poses of {name} that can be used "
            f"(excluded: {_describe_exclusions(left_out)}), found {n}; ask for fewer or bring more candidates"
        )


def _known(free) -> np.ndarray:
    """(F, F) prior information on the free parameters, in typical sizes."""
    return np.diag(free.precision[free.mask] * free.typical[free.mask] ** 2 + _FAINT)


def _in_rounds(counts) -> np.ndarray:
    """Rows (k,) as often as counted (n,): all once, then again those that come twice, and so on."""
    return np.concatenate(
        [np.flatnonzero(counts > done) for done in range(max(counts.max(initial=1), 1))]
    )


def _describe_exclusions(left_out) -> str:
    return ", ".join(f"{count} {why}" for why, count in left_out.items() if count) or "none"


def _model(robot, recording, effects):
    """The model of the candidates, what they determine of it, and all that is free."""
    if recording.sigma is None:
        recording = replace(recording, sigma_mm=_NOMINAL_SIGMA_MM)
    chain = bind(robot, recording)
    rows = effects or ()
    if effects is True:
        rows = [row for stage in default_plan(chain) for row in stage.effects]
    model = Model(chain, make_effects(CATALOGUE, rows))
    everything = model.parameters.free(*frames_of(model.parameters), *geometry_free(robot))
    effect_parameters = [p.key for effect in model.effects for p in effect.parameters(chain)]
    everything = everything.free(*effect_parameters) if effect_parameters else everything
    return model, independent(normal_matrix(model, everything), everything)[0], everything


def _whitened(model, free) -> np.ndarray:
    """(n, m, F) rows, whitened and in typical sizes."""
    rows = model.linearise(free)[1] / model.sigma(free) * free.typical[free.mask][:, None, None]
    return rows.transpose(2, 1, 0)


def _by_pose(rows, poses) -> np.ndarray:
    """(N, m', F): rows of one pose side by side, zeros where a pose has fewer samples than another."""
    order = np.argsort(poses, kind="stable")
    counts = np.bincount(poses)
    place = np.arange(len(poses)) - np.repeat(np.cumsum(counts) - counts, counts)
    rows_of_pose = np.zeros((len(counts), counts.max(), *rows.shape[1:]))
    rows_of_pose[poses[order], place] = rows[order]
    return rows_of_pose.reshape(len(counts), -1, rows.shape[2])


def _task_rows(robot, model, tasks, free):
    """(T, m, F) rows of the tasks, mm and rad, with the candidates' base and tool; InputError where these differ."""
    tasks = samples_of(tasks)
    task_parameters = measurement_of(tasks).parameters()
    placed = [
        p.key for p in model.chain.parameters.table if not p.key.startswith(("base.", "joint-"))
    ]
    if [p.key for p in task_parameters] != placed or tasks.joints.shape[1] != robot.mixing.shape[1]:
        raise InputError(
            f"--tasks {tasks.name}: expected poses of the candidates' robot, tool and targets, measured "
            "as they are, found others; make them as the candidates were made"
        )
    chain = bind(robot, replace(tasks, sigma_mm=1.0), start=model.chain.start)
    seen = Model(chain, model.effects)
    rows = seen.linearise(seen.parameters.take_over(free).only(free.mask))[1]
    return (rows * free.typical[free.mask][:, None, None]).transpose(2, 1, 0)


def _rotation_errors(rows, tasks, known, chosen) -> dict[str, float]:
    """Predicted RMS rotation error (deg) at tasks (T, k, F) with the chosen poses and with all; {} for k = 0.

    rows (N, m, F) of the candidates, whitened; known (F, F) normal matrix of the priors.
    """
    if not tasks.shape[1]:
        return {}
    return {
        "chosen_deg": _rotation_error(rows[chosen], tasks, known),
        "all_deg": _rotation_error(rows, tasks, known),
    }


def _rotation_error(rows, tasks, known) -> float:
    flat = rows.reshape(-1, rows.shape[2])
    covariance = covariance_of(flat.T @ flat, np.diag(known))
    variance = np.einsum("tkf,fg,tkg->t", tasks, covariance, tasks)
    return float(np.rad2deg(np.sqrt(variance.mean())))


def _usable(robot, recording, link_radius, sight):
    """(n,) which rows can be measured, and the number of the others by their first reason."""
    remaining = {}
    taken = np.zeros(recording.n, bool)
    for end in end_recordings(recording):
        variables = robot.mixing @ end.joints.T
        reasons = {"beyond a joint's limit": _exceeds_limits(robot, end.joints)}
        if link_radius > 0:
            reasons["in which the arm collides with itself"] = (
                self_clearance(robot, variables, link_radius) < 2 * link_radius
            )
        else:
            reasons["in which the arm collides with itself"] = np.zeros(recording.n, bool)
        for why, rows in (reasons | unseen(robot, recording, link_radius, sight)).items():
            remaining[why] = remaining.get(why, 0) + int((rows & ~taken).sum())
            taken |= rows
    return ~taken, remaining


def _exceeds_limits(robot, joints):
    """(n,) True where a reading (n, R) passes a limit that the robot states."""
    low, high = robot.limits.T
    return (
        (joints < np.where(np.isnan(low), -np.inf, low - 1e-9))
        | (joints > np.where(np.isnan(high), np.inf, high + 1e-9))
    ).any(1)


def write_poses(chosen: Chosen, folder: Path) -> Path:
    """`poses.csv` in an existing folder: the chosen rows with joint readings and, where there is one, the ball."""
    from workbench.files.runs import replace_file

    sample, times = np.unique(np.array(chosen.samples), return_counts=True)
    sample_ids = chosen.recording.sample_ids
    place = np.searchsorted(sample, sample_ids).clip(max=len(sample) - 1)
    counts = np.where(sample[place] == sample_ids, times[place], 0)
    rows = _in_rounds(counts)
    joints = joint_columns(chosen.recording.columns)
    named = [
        k for k in ("sample", "ball", "reflector", "point", "pair") if k in chosen.recording.columns
    ]
    columns = {k: chosen.recording.columns[k][rows] for k in (*named, *joints)}
    lines = [[f"{value:.10g}" for value in row] for row in zip(*columns.values())]
    path = Path(folder) / "poses.csv"
    replace_file(path, csv_text(columns, lines))
    return path
