"""A calibrated arm as a scene: the corrected simulation of a recording, which `workbench simulate` runs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.measurements.ball_scan import file_kind
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.core.parameters import Parameters
from workbench.core.vocabulary import Covariate
from workbench.files.scene import Scene
from workbench.files.solution_file import robot_keys
from workbench.jobs.robot.simulate import truth_from

KINDS = ("external-point", "external-pose", "ball-centre")
SCENE, ROBOT = "scene.toml", "scene.robot.toml"
_TRIAL_SAMPLES = 8


@dataclass(frozen=True)
class CorrectedScene:
    """`keys` of the scene file and `robot` those of its robot's file, None for a builtin robot; `why` there is none."""

    keys: Mapping | None
    robot: Mapping | None = None
    why: str = ""


def corrected_scene(calibration, title: str = "") -> CorrectedScene:
    """The scene that repeats a recording with the calibrated arm.

    calibration: a `workbench.jobs.robot.calibrate.Calibration`. The scene has its base, tool, geometry and effects, the
    noise of its residual, and poses and covariates at random over the recorded ranges.
    """
    recording, chain = calibration.recording, calibration.model.chain
    if recording.measures not in KINDS:
        kind = file_kind(recording.measures)
        why = f"a scene can have measures {', '.join(KINDS)}, the recording has {kind}"
        return CorrectedScene(None, None, why)
    values = calibration.solution.parameters
    robot = robot_keys(recording)
    keys = {
        "robot": robot["builtin"] if "builtin" in robot else ROBOT,
        "measures": recording.measures,
        "title": title or f"{recording.title or recording.name}: corrected model",
        "samples": int(recording.n),
        "seed": 0,
        "sigma_mm": float(np.median(calibration.model.sigma(values)[:3])),
        "share_of_limits": share_of_limits(chain),
        "base": pose_keys(values, "base"),
        **target_keys(recording, values, chain),
        **covariate_keys(recording),
        "geometry": _geometry(values),
        "effect": [effect_keys(e, values, chain) for e in calibration.model.effects],
    }
    return CorrectedScene(keys, None if "builtin" in robot else robot)


def write_scene(scene: CorrectedScene, folder: Path) -> str:
    """Write scene.toml, and its robot's file, into a folder; "" or why that is not possible.

    A few samples are simulated first: a scene that cannot run is not written.
    """
    import tomli_w

    if scene.keys is None:
        return scene.why
    path = Path(folder) / SCENE
    if scene.robot is not None:
        (path.parent / ROBOT).write_text(tomli_w.dumps(dict(scene.robot)), encoding="utf-8")
    try:
        truth_from(Scene(**(dict(scene.keys) | {"samples": _TRIAL_SAMPLES})), path)
    except InputError as problem:
        (path.parent / ROBOT).unlink(missing_ok=True)
        # the run folder has another name in the end
        message = str(problem).replace(f"scene {path}, ", "")
        return (
            f"a trial of {_TRIAL_SAMPLES} simulated samples failed ({message}); simulate with a scene of your own, "
            "whose targets the arm reaches"
        )
    path.write_text(tomli_w.dumps(dict(scene.keys)), encoding="utf-8")
    return ""


def effect_keys(effect, values: Parameters, chain) -> dict:
    """An [[effect]] table of a scene: name, place, options and the values of its parameters."""
    name = next(key for key, kind in CATALOGUE.items() if kind is type(effect))
    by_name = _values_by_name([p.key for p in effect.parameters(chain)], values)
    return {"effect": name, "where": effect.where, **effect.options, "values": by_name}


def _values_by_name(keys: list[str], values: Parameters) -> dict:
    """Values of an effect by the last part of their key, by the whole key where parts are alike."""
    ends = [key.split(".", 2)[-1] for key in keys]
    return {end if ends.count(end) == 1 else key: values[key] for end, key in zip(ends, keys)}


def pose_keys(values: Parameters, where: str) -> dict:
    """Translation and roll, pitch, yaw of the pose parameters at a place; {} where there are none."""
    from scipy.spatial.transform import Rotation

    if f"{where}.x" not in values.index:
        return {}
    shift = [values[f"{where}.{name}"] for name in "xyz"]
    turn = [values[f"{where}.{name}"] for name in ("rx", "ry", "rz")]
    rpy = Rotation.from_rotvec(turn).as_euler("xyz", degrees=True)
    return {"xyz_mm": [float(x) for x in shift], "rpy_deg": rpy.tolist()}


def _reflector(values: Parameters, number) -> list[float]:
    return [values[f"tool.reflector{number}_{axis}"] for axis in "xyz"]


def target_keys(recording, values: Parameters, chain) -> dict:
    """Reflectors on the flange, or tool and balls."""
    if recording.measures == "external-point":
        return {"reflectors": [_reflector(values, k) for k in chain.measurement.ids]}
    if recording.measures == "external-pose":
        return {"tool": pose_keys(values, "tool")}
    balls = [list(map(float, recording.balls[k])) for k in recording.balls]
    return {"tool": pose_keys(values, "sensor"), "balls": balls}


def share_of_limits(chain) -> float:
    """Share of the joint limits that the recording uses: the median, clipped to the range of a scene."""
    limits = chain.robot.limits
    span = np.ptp(limits, axis=1)
    readings = least_squares(chain.robot.mixing, chain.variables)
    used = np.ptp(readings, axis=1) / np.where(np.isfinite(span) & (span > 0), span, 2 * np.pi)
    return float(np.clip(np.median(used), 0.05, 1.0))


def covariate_keys(recording) -> dict:
    """The covariates that a scene can hold, over the ranges in which they were recorded."""
    columns, covariates = recording.columns, {}
    for name in ("payload_kg", "temperature_c"):
        if name in columns:
            covariates[name] = [float(columns[name].min()), float(columns[name].max())]
    if any(Covariate.of(name).is_signed for name in columns):
        covariates["approach"] = True
    speeds = [np.abs(columns[c]).max() for c in columns if Covariate.of(c).kind == "qdot"]
    return covariates | ({"speeds_deg_s": float(max(speeds))} if speeds else {})


def _geometry(values: Parameters) -> dict[str, float]:
    """The arm's own parameters that differ from nominal, rad and mm, by key."""
    return {
        p.key: float(value)
        for p, value in zip(values.table, values.values)
        if p.key.startswith("joint-") and p.key.count(".") == 1 and value != p.null
    }
