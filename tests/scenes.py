"""Small synthetic recordings: exact points from plain matrix products, or from a model under given parameters."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.recording import Recording
from plain_frames import frames_of, place
from robot_model import load_robot
from robot_model.effects import CATALOGUE
from robot_model.system import bind
from workbench.core.effect import make_effects
from workbench.core.model import Model

ABB = {"builtin": "abb_irb120"}  # has masses and two parallel axes


def _joint(theta, d, a, alpha, mass=0.0, **more):
    """A row of robot.toml whose body weighs something off its axis."""
    return {
        "theta_deg": float(theta),
        "d_mm": float(d),
        "a_mm": float(a),
        "alpha_deg": float(alpha),
        "mass_kg": float(mass),
        "com_mm": [13.0 - a / 2, 7.0, -21.0],
        **more,
    }


_LOAD = {"mass_kg": 1.5, "com_mm": [10.0, -20.0, 60.0]}
CRAIG = {
    "name": "six joints, Craig's frames",
    "convention": "craig",
    "gravity": [0.1, -0.2, -1.0],
    "payload": _LOAD,
    "joint": [
        _joint(0, 350, 0, 0, 9),
        _joint(-90, 20, 40, -90, 7, sign=-1),
        _joint(10, 0, 300, 1.5, 5, beta_deg=0.7),
        _joint(0, 310, 30, -90, 3),
        _joint(0, 0, 0, 90, 2),
        _joint(0, 80, 0, -90, 1),
    ],
}
SLIDING = {
    "name": "a shoulder, two slides and a wrist",
    "convention": "distal",
    "payload": _LOAD,
    "joint": [
        _joint(0, 400, 50, -90, 9),
        _joint(0, 100, 20, 90, 6, kind="prismatic"),
        _joint(30, 50, 250, 2, 5, beta_deg=1.2),
        _joint(90, 120, 10, -80, 4, kind="prismatic"),
        _joint(0, 300, 0, 90, 2),
        _joint(0, 70, 15, 5, 1),
    ],
}
SLIDING_CRAIG = SLIDING | {"name": "the same, Craig's frames", "convention": "craig"}
ARMS = {
    "abb": ABB,
    "fanuc": {"builtin": "fanuc_lr_mate_200id"},
    "craig": CRAIG,
    "sliding": SLIDING,
    "sliding-craig": SLIDING_CRAIG,
}

KINDS = ("ball-centre", "external-point", "external-pose", "partial-pose")
BALLS = {
    1: (0.0, 0.0, 0.0, 15.0),
    2: (120.0, 5.0, -3.0, 15.0),
    4: (10.0, 150.0, 4.0, 15.0),
    7: (60.0, 70.0, 90.0, 15.0),
}
REFLECTORS = {1: (30.0, -40.0, 100.0), 2: (-60.0, 10.0, 80.0), 5: (15.0, 75.0, 60.0)}


@dataclass(frozen=True)
class Scene:
    """A recording and what it was made with: T_world_root, and T_flange_sensor or T_flange_target."""

    recording: Recording
    robot: object
    base: np.ndarray
    tool: np.ndarray


def random_pose(rng, reach, angle=None):
    """(4, 4) pose within `reach` mm; `angle`: its rotation angle in rad, anything where not given."""
    turn = Rotation.random(random_state=int(rng.integers(2**31)))
    if angle is not None:
        turn = Rotation.from_rotvec(angle * turn.as_quat()[:3] / np.linalg.norm(turn.as_quat()[:3]))
    return place(turn, rng.uniform(-reach, reach, 3))


def scene(
    measures, n=60, seed=0, arm=ABB, angle=None, sigma=0.02, balls=BALLS, reflectors=REFLECTORS
) -> Scene:
    """A recording of n exact samples of the nominal arm with all covariates, at random base and tool."""
    rng = np.random.default_rng(seed)
    robot = load_robot(arm)
    base, tool = random_pose(rng, 1500, angle), random_pose(rng, 150, angle)
    readings = _readings(rng, robot, n)
    flanges = base @ frames_of(robot, readings)[-1]
    columns = _joint_columns(robot, readings) | _covariates(rng, robot, n)
    columns |= _observed(measures, rng, flanges, tool, balls, reflectors)
    shown = balls if measures == "ball-centre" else {}
    return Scene(
        Recording(measures, columns, arm, sigma_mm=sigma, balls=shown, name="scene"),
        robot,
        base,
        tool,
    )


def _readings(rng, robot, n):
    turn, slide = rng.uniform(-1.7, 1.7, (2, n, robot.joints))
    return np.where(robot.prismatic, 100 + 60 * slide, turn)


def _joint_columns(robot, readings):
    return {
        f"q{k + 1}_{'mm' if slides else 'deg'}": q if slides else np.rad2deg(q)
        for k, (slides, q) in enumerate(zip(robot.prismatic, readings.T))
    }


def _covariates(rng, robot, n):
    columns = {
        "sample": np.arange(1.0, n + 1),
        "time_s": 10.0 * np.arange(n),
        "payload_kg": rng.uniform(0.5, 3, n),
        "temperature_c": rng.uniform(18, 30, n),
        "range_mm": rng.uniform(200, 300, n),
    }
    columns |= {
        f"accel_foot_{axis}_m_s2": np.random.default_rng(7).uniform(-0.01, 0.01, (3, n))[i]
        for i, axis in enumerate("xyz")
    }
    for k in range(1, robot.joints + 1):
        unit = "mm_s" if robot.prismatic[k - 1] else "deg_s"
        columns |= {
            f"approach{k}": rng.choice([-1.0, 1.0], n),
            f"qdot{k}_{unit}": rng.uniform(-20, 20, n),
        }
    return columns


def _observed(measures, rng, flanges, tool, balls, reflectors):
    n = len(flanges)
    targets = flanges @ tool
    if measures == "partial-pose":
        return _xyz(targets[:, :3, 3]) | {
            f"o{c}": row for c, row in zip("xyz", targets[:, :3, 1].T)
        }
    if measures == "external-pose":
        turns = Rotation.from_matrix(targets[:, :3, :3]).as_quat()
        return _xyz(targets[:, :3, 3]) | {f"q{c}": row for c, row in zip("xyzw", turns.T)}
    seen = balls if measures == "ball-centre" else reflectors
    which = np.resize(list(seen), n).astype(float)
    places = np.array([[*seen[int(k)][:3], 1.0] for k in which])
    if measures == "ball-centre":
        return _xyz(np.einsum("nij,nj->ni", np.linalg.inv(flanges @ tool), places)) | {
            "ball": which
        }
    return _xyz(np.einsum("nij,nj->ni", flanges, places)) | {"reflector": which}


def _xyz(points):
    return {f"{axis}_mm": row for axis, row in zip("xyz", points.T)}


def model_of(made: Scene, *effects) -> Model:
    """The scene's chain with (name, where, options) effects."""
    return Model(bind(made.robot, made.recording), make_effects(CATALOGUE, effects))


def observed(model: Model, truth, rng=None, noise=1.0) -> Model:
    """The model bound to what it predicts at `truth`, with noise of `noise` sigmas where `rng` is given."""
    measured = model.chain.measurement.measured + model.residual(truth)[:3]
    if rng is not None:
        measured = measured + noise * model.chain.sigma[:3] * rng.standard_normal(measured.shape)
    measurement = replace(model.chain.measurement, measured=measured)
    state = replace(model.chain.state, measured=measured)
    return replace(
        model, chain=replace(model.chain, measurement=measurement, state=state), _bases={}
    )


def differences(function, values, steps):
    """(P, ...) central differences of `function` at `values` (P,)."""
    out = []
    for k, step in enumerate(np.broadcast_to(steps, values.shape)):
        up, down = values.copy(), values.copy()
        up[k], down[k] = values[k] + step, values[k] - step
        out.append((function(up) - function(down)) / (2 * step))
    return np.array(out)


def assert_rows(found, expected, relative=1e-5):
    """Rows (P, ...) agree to `relative` of the largest entry of each row."""
    assert found.shape == expected.shape
    size = np.abs(expected).reshape(len(expected), -1).max(1)
    gap = np.abs(found - expected).reshape(len(expected), -1).max(1)
    assert (gap <= relative * size + 1e-9).all(), f"relative gaps {gap / np.maximum(size, 1e-300)}"
