"""Identifiability of the parameters by a recording: `workbench identifiability`."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.system import bind, geometry_free, held_by_convention
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
from workbench.machine.progress import counted

_NOMINAL_SIGMA_MM = 0.05


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
    scale = _NOMINAL_SIGMA_MM if recording.sigma is None else 1.0
    stages: list[dict] = []
    if plan is None:
        rows = default_plan(chain)
        begin = counted(progress, len(rows))
        for stage in rows:
            begin(f"stage {stage.name}")
            stages.append(_stage(chain, robot, stage, scale))
    else:
        rows = read_plan(plan)
        begin = counted(progress, len(rows))
        for k, stage in enumerate(rows, 1):
            begin(f"stage {stage.name}")
            stages.append(_stage_of_plan(chain, rows[:k], rows, scale))
    return {
        "measures": recording.measures,
        "samples": moving.n,
        "poses": len(np.unique(moving.poses)),
        "sigma_assumed_mm": scale if recording.sigma is None else None,
        "stages": stages,
        "warnings": list(checked.warnings),
    }


def _stage(chain, robot, stage, scale) -> dict:
    model = Model(chain, make_effects(CATALOGUE, stage.effects))
    parameters = model.parameters.free(*frames_of(model.parameters), *geometry_free(robot))
    effect_parameters = [p.key for effect in model.effects for p in effect.parameters(chain)]
    return _stage_answer(
        stage,
        model,
        (parameters.free(*effect_parameters) if effect_parameters else parameters).nudged(),
        scale,
        robot,
    )


def _stage_of_plan(chain, upto, plan, scale) -> dict:
    """The last of the stages `upto` with all before it, and with what the whole plan holds."""
    rows = [row for stage in upto for row in stage.effects]
    effects = make_effects(CATALOGUE, rows)
    model = Model(chain, effects)
    start = with_known_values(model.parameters, plan)
    mask = start.matching(*frames_of(start))
    for stage in upto:
        mask |= stage_mask(start, stage, make_effects(CATALOGUE, stage.effects), chain)
    parameters = start.only(mask & start.mask).nudged()
    return _stage_answer(upto[-1], model, parameters, scale)


def _stage_answer(stage, model, parameters, scale, robot=None) -> dict:
    """robot: whose Hayati rows are asked about too, in words."""
    known = overall = look(normal_matrix(model, parameters), parameters, scale)
    if robot is not None and (held_rows := held_by_convention(robot)):
        everything = parameters.free(*held_rows)
        overall = look(normal_matrix(model, everything), everything, scale)
    return {
        "name": stage.name,
        "free": len(known.keys),
        "identifiable": known.rank,
        "undetermined": overall.sentences(),
        "parameters": _predicted(known),
        **known.observability(model.chain.sigma.shape[1]),
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
