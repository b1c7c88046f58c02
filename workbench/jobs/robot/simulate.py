"""From a scene to a recording: the model that calibrates, run forwards with noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.makers.poses import scanning
from datasets.recording import Recording
from robot_model import load_robot
from robot_model.effects import CATALOGUE
from robot_model.files.robot_file import read_robot_keys
from robot_model.poses import pose_values
from robot_model.robot import Robot
from robot_model.state import sliding
from robot_model.system import bind
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.robot_files.robot_description import description_keys, is_description
from workbench.core.terms import switched_off, term_names
from workbench.files.scene import Pose, Scene, read_scene
from workbench.fitting.calibration_plans.missing_masses import check_loads


def simulate(path: Path, without: Sequence[str] = ()) -> Recording:
    """The recording that the scene file `path` describes; raises InputError for a scene that cannot be.

    without: names of effects to switch off, `<place>.<effect>`, with shell wildcards.
    """
    truth = truth_from(_without_effects_named(read_scene(path), without, path), path)
    residual = truth.model.residual(truth.parameters)
    sigma = truth.model.sigma(truth.parameters)
    noisy = residual + truth.rng.normal(size=residual.shape) * sigma
    columns = truth.shown.columns | truth.model.chain.measurement.columns(noisy)
    stated = truth.model.chain.stated_sigma
    if len(stated) > 3:  # poses: the noise of the orientation is stated, too
        columns["sigma_deg"] = np.rad2deg(stated[3])
    return replace(truth.shown, columns=columns)


def _without_effects_named(scene: Scene, patterns: Sequence[str], path: Path) -> Scene:
    if not patterns:
        return scene
    names = [
        term_names(getattr(CATALOGUE.get(c.effect), "effect", c.effect), c.where, c.effect)
        for c in scene.effect
    ]
    disabled = switched_off(names, patterns, f"scene {path}")
    retained = [cause for cause, is_off in zip(scene.effect, disabled) if not is_off]
    return scene.model_copy(update={"effect": retained})


@dataclass(frozen=True)
class Truth:
    """Truth of a simulated recording: `shown` without noise and effects, the true model, its parameters, and
    random numbers that go on from there."""

    shown: Recording
    model: Model
    parameters: Parameters
    rng: np.random.Generator


def truth_of(path: Path) -> Truth:
    """Everything of a scene file but the noise; raises InputError for a scene that cannot be."""
    return truth_from(read_scene(path), path)


def truth_from(scene: Scene, path: Path) -> Truth:
    """As `truth_of`, of a scene that is read already; `path` is what messages call it, and its folder is that of
    the robot file."""
    keys = _robot_keys(scene, Path(path))
    robot = load_robot(keys, f"scene {path}, key robot")
    keys |= (
        {"gravity": robot.gravity.tolist()} if "gravity" in keys else {}
    )  # which recordings hold at length 1
    rng = np.random.default_rng(scene.seed)
    joints, target = _poses(scene, robot, rng, path)
    blank = _blank(scene, robot, keys, joints, target, rng)
    shown, start, geometry = _without_effects(scene, robot, blank, rng)
    try:
        model, parameters = _truth(scene, bind(robot, shown, start), geometry)
        model.residual(parameters)
        check_loads(model, parameters)
    except InputError as problem:
        raise InputError(f"scene {path}, key effect: {problem}") from None
    return Truth(shown, model, parameters, rng)


def _robot_keys(scene: Scene, path: Path) -> dict:
    """Robot keys of the recording: those of the robot file itself, so that the recording is self-contained."""
    file = path.parent / scene.robot
    if is_description(file):
        return description_keys(file)
    if file.suffix.lower() != ".toml":
        return {"builtin": scene.robot}
    keys = read_robot_keys(file)
    if isinstance(keys.get("urdf"), str):
        return keys | {"urdf": str(file.parent / keys["urdf"])}
    return keys


def _without_effects(scene, robot, blank, rng):
    """Recording of an arm without effects of the true geometry; the chain's true start and that geometry.

    Effects of the sensor's field read where in it a point is seen, so that must be known first; a
    sensor's recording also says at what range.
    """
    seen = np.unique(blank.reflector) - 1
    if scene.measures == "external-point":
        at_flange = np.ravel(np.array(scene.reflectors)[seen])
    else:
        at_flange = _pose(scene.tool)
    start = np.concatenate([_pose(scene.base), at_flange])
    model = Model(bind(robot, blank, start))
    geometry = _geometry_errors(scene, model.parameters, rng)
    unknown = sorted(set(scene.geometry) - set(geometry))
    if unknown:
        raise InputError(
            f"scene '{scene.title}', key geometry: expected parameters of the arm such as {next(iter(geometry))}, "
            f"found {unknown[0]}; correct it"
        )
    geometry |= scene.geometry
    residual = model.residual(model.parameters.update(geometry))
    columns = dict(blank.columns) | model.chain.measurement.columns(residual)
    shown = replace(blank, columns=columns)
    if scene.measures == "ball-centre":
        shown = replace(
            shown, columns=shown.columns | {"range_mm": np.linalg.norm(shown.points, axis=1)}
        )
    return shown, start, geometry


def _truth(scene, chain, geometry):
    """The model of the scene with its true parameters."""
    rows = [(cause.effect, cause.where, dict(cause.model_extra or {})) for cause in scene.effect]
    model = Model(chain, make_effects(CATALOGUE, rows))
    _check_columns(model)
    parameters = model.parameters.update(_true_values(scene, model))
    return model, parameters.update(geometry)


def _check_columns(model) -> None:
    """InputError where an effect needs a column that the scene did not ask for."""
    covariates = model.chain.state.covariates
    for effect in model.effects:
        for name in effect.needs:
            stem = name.rstrip("0123456789").split("_")[0].rstrip("0123456789")
            if name not in covariates and stem in _MAKERS:
                raise InputError(
                    f"{effect.title} needs column '{name}', found none; add {_MAKERS[stem]} to the scene"
                )


_MAKERS = {
    "qdot": "speeds_deg_s = 20.0",
    "approach": "approach = true",
    "payload": "payload_kg = [0.0, 2.0]",
    "temperature": "temperature_c = [20.0, 30.0]",
}
"""What a scene says to get columns whose names begin so."""


def _true_values(scene, model) -> dict[str, float]:
    values = {}
    for cause, effect in zip(scene.effect, model.effects):
        full = [p.key for p in effect.parameters(model.chain)]
        ends = [key.split(".", 2)[-1] for key in full]
        keys = {key: key for key in full} | {
            end: key for end, key in zip(ends, full) if ends.count(end) == 1
        }
        for name, value in cause.values.items():
            if name not in keys:
                known = [end if end in keys else key for end, key in zip(ends, full)]
                raise InputError(
                    f"effect '{cause.effect}' at {cause.where}, key values: expected its parameters "
                    f"{', '.join(known)}, found {name}; rename it"
                )
            values[keys[name]] = value
    return values


def _geometry_errors(scene, parameters, rng) -> dict[str, float]:
    sizes = {"mm": scene.errors.length_mm, "rad": np.deg2rad(scene.errors.angle_deg)}
    rows = [p for p in parameters.table if p.key.startswith("joint-") and p.key.count(".") == 1]
    return {p.key: p.null + rng.normal() * sizes[p.unit] for p in rows}


def _pose(pose: Pose) -> np.ndarray:
    matrix = _matrix(pose)
    return pose_values(matrix[:3, :3], matrix[:3, 3])


def _limits(robot: Robot, share: float) -> np.ndarray:
    """(R, 2) reachable readings: a share of the limits about their middle; +-180 deg, or +-300 mm, if unknown."""
    unknown = np.where(sliding(robot), 300.0, np.pi)[:, None] * [-1, 1]
    limits = np.where(np.isfinite(robot.limits), robot.limits, unknown)
    middle = limits.mean(1)
    half = np.ptp(limits, axis=1) / 2
    return np.stack([middle - share * half, middle + share * half], 1)


def _poses(scene: Scene, robot: Robot, rng, path) -> tuple[np.ndarray, np.ndarray]:
    """Joint readings (n, R) in rad or mm, and the number (n,) of the ball or reflector seen."""
    limits = _limits(robot, scene.share_of_limits)
    if scene.measures != "ball-centre":
        joints = rng.uniform(*limits.T, size=(scene.samples, len(limits)))
        target = np.arange(scene.samples) % len(scene.reflectors) + 1
        return joints, target
    if not scene.balls:
        raise InputError(
            f"scene {path}, key balls: a ball-centre scene needs at least one [x, y, z, radius], found none"
        )
    if (
        robot.convention != "distal"
        or robot.prismatic.any()
        or robot.mixing.shape != (robot.joints,) * 2
    ):
        raise InputError(
            f"scene {path}, key robot: a ball-centre scene needs an arm in the standard convention whose joints all "
            f"turn and have a reading, found '{robot.name}'; choose another arm or measures"
        )
    try:
        return _looking_at_balls(scene, robot, limits, rng)
    except ValueError as problem:
        raise InputError(
            f"scene {path}, key balls: expected balls that the sensor can look at from above, found that {problem}; "
            f"move base or balls, or raise share_of_limits"
        ) from None


def _looking_at_balls(scene, robot, limits, rng):
    """Readings from which the sensor sees a ball, spread over the balls; ValueError where there are too few."""
    placed = np.linalg.inv(_matrix(scene.base) @ robot.base)
    balls = np.array(scene.balls)[:, :3] @ placed[:3, :3].T + placed[:3, 3]
    # the search is for joint angles within a box; where joints are coupled it also finds forbidden readings
    coupled = np.count_nonzero(robot.mixing) > robot.joints
    middle = robot.mixing @ limits.mean(1)
    half = np.abs(robot.mixing) @ np.ptp(limits, axis=1) / 2
    box = np.stack([middle - half, middle + half], 1)
    angles, ball = scanning(
        rng,
        robot.geometry,
        box,
        balls,
        robot.flange @ _matrix(scene.tool),
        scene.samples * (1 + coupled),
        middle,
        tilt=np.deg2rad(scene.cap_deg),
        stand_off=scene.stand_off_mm,
        half_field=_half_field(scene),
    )
    joints = np.linalg.solve(robot.mixing, angles.T).T
    allowed = np.flatnonzero(
        ((joints >= limits[:, 0]) & (joints <= limits[:, 1])).all(1) | (not coupled)
    )
    if len(allowed) < scene.samples:
        raise ValueError(f"only {len(allowed)} of the {scene.samples} wanted views can be reached")
    chosen = allowed[: scene.samples]
    return joints[chosen], ball[chosen] + 1


def _half_field(scene) -> float:
    """mm: half the side of a square that lies in the field at its nearest."""
    if scene.field_deg is None:
        return 15.0
    return scene.stand_off_mm[0] * float(np.tan(np.deg2rad(scene.field_deg))) / 2**0.5


def _matrix(pose: Pose) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("xyz", pose.rpy_deg, degrees=True).as_matrix()
    out[:3, 3] = pose.xyz_mm
    return out


def _blank(scene, robot, keys, joints, target, rng) -> Recording:
    """The recording without its measurements, with covariates as the scene asks for."""
    n = len(joints)
    columns = {"sample": np.arange(n, dtype=float)}
    for k, (row, slides) in enumerate(zip(joints.T, sliding(robot)), 1):
        if slides:
            columns[f"q{k}_mm" if slides else f"q{k}_deg"] = row
        else:
            columns[f"q{k}_mm" if slides else f"q{k}_deg"] = np.rad2deg(row)
    columns["ball" if scene.measures == "ball-centre" else "reflector"] = target.astype(float)
    columns["time_s"] = np.arange(n) * scene.seconds_per_sample
    columns |= _covariates(scene, robot, n, rng)
    columns |= dict.fromkeys(("x_mm", "y_mm", "z_mm"), np.zeros(n))
    if scene.measures == "external-pose":
        columns |= dict.fromkeys(("qx", "qy", "qz"), np.zeros(n)) | {"qw": np.ones(n)}
    balls = {i: tuple(ball) for i, ball in enumerate(scene.balls, 1)}
    return Recording(scene.measures, columns, keys, scene.title, scene.sigma_mm, balls=balls)


def _covariates(scene, robot, n, rng) -> dict[str, np.ndarray]:
    """The columns that the scene asks for in addition to joints and time, in file units."""
    columns, slides = {}, sliding(robot)
    if scene.payload_kg is not None:
        columns["payload_kg"] = rng.uniform(*scene.payload_kg, n)
    if scene.approach:
        columns |= {f"approach{k}": rng.choice([-1.0, 1.0], n) for k in range(1, len(slides) + 1)}
    if scene.speeds_deg_s is not None:
        top = scene.speeds_deg_s
        columns |= {
            f"qdot{k}_{'mm' if s else 'deg'}_s": rng.uniform(-top, top, n)
            for k, s in enumerate(slides, 1)
        }
    if scene.temperature_c is not None:
        first, last = scene.temperature_c
        columns["temperature_c"] = (
            first + (last - first) * (1 - np.cos(np.linspace(0, np.pi, n))) / 2
        )
    return columns
