"""Plans: which stages a calibration goes through; the default one, and plans read from TOML."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.robot import Robot
from robot_model.system import RobotChain, geometry_free
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.least_squares.solver import LOSSES
from workbench.core.parameters import Parameters
from workbench.core.solution import Stage
from workbench.core.text.structured_text import ContentError, read_toml
from workbench.fitting.calibration_plans.joint_curves import choose_joint_curves

FEW_POSES = 40
"""Poses up to which folds do not choose among the stages of the default plan, as of `plan_of_recording`."""
FRAMES = ("base.*", "tool.*", "sensor.*", "artefact.*")
PLAN_FILES = Path(__file__).parent / "plan_files"
CURVES, DRIFT = "joint curves", "drift"
STAGES = {
    "coupling": "gears of the wrist, or a ball screw, move one joint with another",
    "transmission": "gears and encoders have errors of one and two cycles per revolution, and backlash",
    "compliance": "joints deflect under the weight of links and load, whose centres of mass are uncertain",
    "bending": "bearings of joints tilt, and with them links bend, under the moment across them",
    CURVES: "gears and encoders have errors of many cycles per revolution, or of none",
    DRIFT: "base or instrument drifts during the recording",
}
"""The stages of the default plan after the geometry, and why each is there; `Effect.stage` names one of them."""
JOINT_STAGES = ("transmission", "compliance", "bending")
ARM = "transmission and compliance"
_ARM_WHY = "gears and encoders have errors, and joints and bearings deflect; few poses do not choose among these"
"""The stage of all errors of `JOINT_STAGES`."""


def default_plan(chain: RobotChain) -> tuple[Stage, ...]:
    """Geometry and the stages of `STAGES`, as far as this recording can show them."""
    planned = (joint_curves() if name == CURVES else _stage_of(name, chain) for name in STAGES)
    return geometry(chain.robot), *(stage for stage in planned if stage.effects or stage.choose)


def plan_of_recording(chain: RobotChain) -> tuple[Stage, ...]:
    """The default plan; with at most `FEW_POSES` poses, one stage has all its errors of joints and bearings.

    Folds of few poses cannot choose among gears, joints and bearings. The choice follows the errors of single poses,
    and the error of folds that made it is too small (Varma & Simon, BMC Bioinformatics 7 (2006) 91). Estimated
    together, the scale of the prior of each family shrinks what the poses do not show, and there is one test. Error
    curves, whose terms are chosen one by one, and a drift, which has few poses at any time, need more poses.
    """
    stages = default_plan(chain)
    poses = np.unique(chain.variables.round(4), axis=1).shape[1]
    if poses > FEW_POSES:
        return stages
    kept = [stage for stage in stages if stage.name not in (*JOINT_STAGES, CURVES, DRIFT)]
    rows = tuple(row for stage in stages if stage.name in JOINT_STAGES for row in stage.effects)
    if not rows:
        return tuple(kept)
    after = next(k for k, stage in enumerate(stages) if stage.name in JOINT_STAGES)
    return (*kept[:after], Stage(ARM, _ARM_WHY, rows), *kept[after:])


def frames_of(parameters) -> tuple[str, ...]:
    """Those of `FRAMES` that a model has: base, and tool or hand-eye, and points that nobody measured."""
    return tuple(p for p in FRAMES if any(key.startswith(p[:-1]) for key in parameters.keys))


def with_known_values(parameters: Parameters, stages: Sequence[Stage]) -> Parameters:
    """The parameters with what a plan takes as known set and fixed, all others free; InputError for no such key."""
    parameters = parameters.only(np.ones(len(parameters), bool))
    for pattern, value in (pair for stage in stages for pair in stage.hold):
        chosen = parameters.matching(pattern)
        parameters = replace(parameters, values=np.where(chosen, value, parameters.values)).fix(
            pattern
        )
    return parameters


def stage_mask(parameters: Parameters, stage: Stage, effects, chain) -> np.ndarray:
    """(P,) True for what a stage frees: its patterns, or with "*" all that its effects bring."""
    if stage.free != ("*",):
        present = [p for p in stage.free if p not in FRAMES or p in frames_of(parameters)]
        try:
            return parameters.matching(*present)
        except InputError as problem:
            raise InputError(
                f"stage '{stage.name}' of the plan, key free: {problem}; correct the pattern"
            ) from None
    effect_keys = [p.key for effect in effects for p in effect.parameters(chain)]
    return np.isin(parameters.keys, effect_keys)


def geometry(robot: Robot) -> Stage:
    """Base, tool and all link parameters; kept whatever it does, since the rest stands on it."""
    why = "lengths, twists and zero offsets of this arm are not those of the data sheet"
    return Stage("geometry", why, free=(*FRAMES, *geometry_free(robot)), earn=False)


def base_and_tool() -> Stage:
    """Base and tool alone, for an arm whose nominal geometry predicts as well as an estimated one."""
    return read_plan(Path("base-and-tool"))[0]


def joint_curves() -> Stage:
    """The error curves of joints that the fit before supports; none where it supports none."""
    return Stage(CURVES, STAGES[CURVES], choose=choose_joint_curves)


def _stage_of(name: str, chain: RobotChain) -> Stage:
    """The stage of the default plan with the terms that the effects of the catalogue plan for it."""
    rows = [
        (key, where, options)
        for key, kind in CATALOGUE.items()
        if kind.stage == name
        for where, options in kind.planned(chain)
    ]
    return Stage(name, STAGES[name], tuple(rows))


def plan_names() -> list[str]:
    """Plans that come with the workbench."""
    return sorted(path.stem for path in PLAN_FILES.glob("*.toml"))


def plan_location(plan: str | Path) -> str:
    """A plan so that it can be read from any folder: a known name as it is, else the whole path of its file."""
    if str(plan) in plan_names():
        return str(plan)
    return str(Path(plan).resolve())


def read_plan(path: Path) -> tuple[Stage, ...]:
    """Stages of a TOML file, or of a plan that comes with the workbench, by its name.

    `[[stage]]` with `name`, `why`, and optionally `effects` (list of tables with `effect`, `where`
    and the effect's options), `free` (shell patterns of keys), `loss`, `canonical`, `earn`, `steps`,
    `hold` (table of shell pattern = value: known beforehand, and never free in this plan).
    Raises InputError for a file that is no such plan.
    """
    if str(path) in plan_names():
        path = PLAN_FILES / f"{path}.toml"
    else:
        path = Path(path)
    path = path / "plan.toml" if path.is_dir() else path  # a run folder of `workbench diagnose`
    try:
        rows = read_toml(path).get("stage", [])
    except (OSError, ContentError) as problem:
        raise InputError(
            f"plan {path} cannot be read ({problem}); write it as TOML with [[stage]] tables, or name one "
            f"of {', '.join(plan_names())}"
        ) from None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(
            f"plan {path}, key stage: expected [[stage]] tables, found {rows!r}; write double brackets"
        )
    if not rows:
        raise InputError(f"plan {path}: no [[stage]] found; write at least one with name and why")
    return tuple(_stage(path, number, dict(row)) for number, row in enumerate(rows, 1))


_KEYS = {
    "name": str,
    "why": str,
    "effects": list,
    "free": list,
    "loss": str,
    "canonical": bool,
    "earn": bool,
    "steps": int,
    "hold": dict,
}


_JSON_TYPES = {str: "string", list: "array", bool: "boolean", int: "integer", dict: "object"}


def plan_schema() -> dict:
    """JSON Schema of a plan file, from the keys that its reader takes."""
    stage = {
        "type": "object",
        "properties": {key: {"type": _JSON_TYPES[kind]} for key, kind in _KEYS.items()},
        "required": ["name", "why"],
        "additionalProperties": False,
    }
    stage["properties"]["loss"] = {"enum": list(LOSSES)}
    stage["properties"]["steps"] = {"type": "integer", "minimum": 1}
    stage["properties"]["hold"] = {"type": "object", "additionalProperties": {"type": "number"}}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "plan of a calibration",
        "type": "object",
        "properties": {"stage": {"type": "array", "items": stage, "minItems": 1}},
        "required": ["stage"],
    }


def _stage(path, number, row) -> Stage:
    where = f"plan {path}, stage {number}"
    for key, value in row.items():
        if key not in _KEYS:
            raise InputError(
                f"{where}: key '{key}' is not known; expected {', '.join(_KEYS)}; remove or rename it"
            )
        if not isinstance(value, _KEYS[key]) or (key == "steps" and (value is True or value < 1)):
            raise InputError(
                f"{where}, key {key}: expected {_KEYS[key].__name__}, found {value!r}; correct it"
            )
    if "name" not in row or "why" not in row:
        raise InputError(
            f"{where}: keys name and why are expected, found {', '.join(row)}; add what is missing"
        )
    if row.get("loss", "linear") not in LOSSES:
        raise InputError(
            f"{where}, key loss: expected one of {', '.join(LOSSES)}, found '{row['loss']}'; choose one of them"
        )
    row["hold"] = tuple(row.get("hold", {}).items())
    if not all(type(value) in (int, float) for _, value in row["hold"]):
        raise InputError(
            f"{where}, key hold: expected numbers, found {dict(row['hold'])}; write pattern = number"
        )
    row["effects"] = tuple(_effect(where, e) for e in row.get("effects", []))
    row["free"] = tuple(row.get("free", ("*",)))
    if not all(isinstance(pattern, str) for pattern in row["free"]):
        raise InputError(
            f"{where}, key free: expected patterns of keys, found {list(row['free'])}; quote each"
        )
    return Stage(**row)


def _effect(where, row):
    if not isinstance(row, dict):
        raise InputError(
            f"{where}, key effects: expected tables with effect and where, found {row!r}; correct it"
        )
    row = dict(row)
    if "effect" not in row or "where" not in row:
        raise InputError(
            f"{where}, key effects: each needs effect and where, found {row}; add what is missing"
        )
    effect = row.pop("effect"), row.pop("where"), row
    try:
        make_effects(CATALOGUE, [effect])
    except InputError as problem:
        raise InputError(f"{where}, key effects: {problem}") from None
    return effect
