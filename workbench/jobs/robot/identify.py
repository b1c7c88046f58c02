"""Identifiability of the parameters by a recording: `workbench identifiability`."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.robot import Robot
from robot_model.system import RobotChain, bind, geometry_free, held_by_convention
from workbench.core.effect import make_effects
from workbench.core.least_squares.identifiability import identifiability as look
from workbench.core.least_squares.solver import normal_matrix
from workbench.core.model import Model
from workbench.fitting.calibration_plans.plans import (
    default_plan,
    frames_of,
    read_plan,
    stage_mask,
    with_known_values,
)
from workbench.fitting.checked_samples import check_samples
from workbench.jobs.robot.random_poses import at_random_poses
from workbench.machine.progress import counted

_NOMINAL_SIGMA_MM = 0.05


@dataclass(frozen=True)
class _Arm:
    """The chain at the recorded poses and, with the same reflectors and loads, at random ones.

    scale: ratio of the residuals to the sigmas that the recording states, or the sigma taken, mm.
    """

    robot: Robot
    recorded: RobotChain
    anywhere: RobotChain
    scale: float


def identifiability(
    recording,
    plan: Path | None = None,
    trust_data: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> dict:
    """Rank, null space in words and observability indices of the geometry and of each stage.

    Judged at the nominal geometry with effects at a third of their typical size; a recording
    without sigma is taken to have 0.05 mm. plan: a plan file or its name; each of its stages is then
    judged with all before it. Keys as the command prints them. trust_data: judge also a recording that cannot be
    right. progress: called with one line a stage. Raises InputError.
    """
    checked = check_samples(recording, trust_data)
    moving, robot = checked.recording, checked.robot
    chain = bind(robot, moving)
    anywhere = bind(robot, at_random_poses(moving, robot), start=chain.start)
    scale = _NOMINAL_SIGMA_MM if recording.sigma is None else 1.0
    arm = _Arm(robot, chain, anywhere, scale)
    stages: list[dict] = []
    if plan is None:
        rows = default_plan(chain)
        begin = counted(progress, len(rows))
        for stage in rows:
            begin(f"stage {stage.name}")
            stages.append(_stage(arm, stage))
    else:
        rows = read_plan(plan)
        begin = counted(progress, len(rows))
        for k, stage in enumerate(rows, 1):
            begin(f"stage {stage.name}")
            stages.append(_stage_of_plan(arm, rows[:k], rows))
    return {
        "measures": recording.measures,
        "samples": moving.n,
        "poses": len(np.unique(moving.poses)),
        "sigma_assumed_mm": scale if recording.sigma is None else None,
        "stages": stages,
        "warnings": list(checked.warnings),
    }


def _stage(arm: _Arm, stage) -> dict:
    effects = make_effects(CATALOGUE, stage.effects)
    model = Model(arm.recorded, effects)
    parameters = model.parameters.free(*frames_of(model.parameters), *geometry_free(arm.robot))
    effect_parameters = [p.key for effect in effects for p in effect.parameters(arm.recorded)]
    if effect_parameters:
        parameters = parameters.free(*effect_parameters)
    return _stage_answer(stage, arm, effects, parameters.nudged(), held_by_convention(arm.robot))


def _stage_of_plan(arm: _Arm, upto, plan) -> dict:
    """The last of the stages `upto` with all before it, and with what the whole plan holds."""
    rows = [row for stage in upto for row in stage.effects]
    effects = make_effects(CATALOGUE, rows)
    start = with_known_values(Model(arm.recorded, effects).parameters, plan)
    mask = start.matching(*frames_of(start))
    for stage in upto:
        mask |= stage_mask(start, stage, make_effects(CATALOGUE, stage.effects), arm.recorded)
    parameters = start.only(mask & start.mask).nudged()
    return _stage_answer(upto[-1], arm, effects, parameters, ())


def _stage_answer(stage, arm: _Arm, effects, parameters, held_rows) -> dict:
    """held_rows: keys of the Hayati rows, held by convention, that the sentences speak of too."""
    model = Model(arm.recorded, effects)
    known = look(normal_matrix(model, parameters), parameters, arm.scale)
    everything = parameters.free(*held_rows) if held_rows else parameters
    anywhere = look(normal_matrix(Model(arm.anywhere, effects), everything), everything, arm.scale)
    # directions in which no measurement changes at random poses come first, and apart from the others
    overall = replace(
        look(normal_matrix(model, everything), everything, arm.scale), exact=anywhere.exact
    )
    sentences = overall.sentences()
    return {
        "name": stage.name,
        "free": len(known.keys),
        "identifiable": known.rank,
        "undetermined": sentences,
        "undetermined_in_any_poses": sentences[: len(anywhere.exact)],
        "parameters": _predicted(known),
        **known.observability(arm.recorded.sigma.shape[1]),
    }


def _predicted(known) -> list[dict]:
    """Predicted standard deviation of each free parameter in its own unit; `typical`: its typical size."""
    std = np.sqrt(np.maximum(np.diag(known.covariance), 0.0))
    rows = zip(known.keys, known.units, known.typical, std, known.determined)
    return [
        {
            "key": key,
            "unit": unit,
            "typical": float(size),
            "std": float(conditional_std),
            "identifiable": bool(alone),
        }
        for key, unit, size, conditional_std, alone in rows
    ]
