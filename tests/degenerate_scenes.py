"""Recordings that determine little: small regions, constant joints, repeated poses, odd scales, odd arms.

`draw(seed)` makes one case. The joint readings are solved for, so that touches, beams, planes, lines and lengths
agree with the arm; the measured columns are exact values plus noise. Every recording passes the checks of the
public reader, or these raise InputError.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.formats.table import Table
from datasets.recording import Recording
from datasets.samples.checks import Context, check_samples
from datasets.samples.plausible import check_plausible
from robot_model import load_robot
from robot_model.chain import forward
from robot_model.measurements.closure import flange_matrices
from scenes import ABB, SLIDING
from workbench.core.errors import InputError

KINDS = (
    "ball-centre",
    "external-point",
    "external-pose",
    "partial-pose",
    "touch-point",
    "laser-spot",
    "distance",
    "plane-touch",
    "ball-surface",
)


def _arm(name, *rows):
    return {"name": name, "convention": "distal", "gravity": [0.0, 0.0, -1.0], "joint": list(rows)}


def _row(theta=0.0, d=0.0, a=0.0, alpha=0.0, **more):
    return {"theta_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha, **more}


ARMS = {
    "abb": ABB,
    "sliding": SLIDING,
    "two joints": _arm("two joints", _row(d=300.0, a=50.0, alpha=-90.0), _row(a=400.0)),
    "planar": _arm("planar", *(_row(a=200.0, hayati=k < 2) for k in range(3))),
    "no length": _arm("no length", *(_row(alpha=90.0 * (-1) ** k) for k in range(6))),
    "one axis": _arm("one axis", _row(), _row(), _row()),
    "nine joints": _arm(
        "nine joints",
        *(
            _row(
                d=100.0 + 20 * k, a=30.0, alpha=90.0 * (-1) ** k, mass_kg=3.0, com_mm=[-2.0, 7, -21]
            )
            for k in range(9)
        ),
    ),
    "three slides": _arm(
        "three slides",
        _row(alpha=-90.0, kind="prismatic"),
        _row(theta=90.0, alpha=90.0, kind="prismatic"),
        _row(kind="prismatic"),
    ),
}

BALLS = {1: (0.0, 0.0, 0.0, 15.0), 2: (120.0, 5.0, -3.0, 15.0), 4: (10.0, 150.0, 4.0, 15.0)}
REGIONS_DEG = (0.01, 0.1, 1.0, 5.0, 90.0)
SCALES = (1.0, 1.0, 1.0, 1.0, 1e-6, 1e-3, 1e3, 1e9)
SIGMAS = (0.02, 0.02, 0.02, 0.02, None, 0.0, 1e-12, 1e6)
"""mm; 0 is refused by the reader."""
COUNTS = (2, 4, 5, 6, 12, 30)


_POINTS = 6
"""Points of a ball's surface that are seen from one pose."""


@dataclass(frozen=True)
class Case:
    """What one degenerate recording is made of."""

    kind: str
    arm: str = "abb"
    region_deg: float = 90.0
    held: tuple[int, ...] = ()
    """Joints (from 0) that stand still."""
    count: int = 24
    copies: int = 1
    """How often each pose comes again."""
    identical: bool = False
    """Copies of a pose have the same measured values, to the last digit."""
    path: str = ""
    """"line" or "plane": where the measured point moves along one."""
    constant: bool = False
    """Every measured value is that of the first row."""
    scale: float = 1.0
    sigma_mm: float | None = 0.02
    targets: int = 3
    on_axis: bool = False
    """The only reflector, tip or sensor is at the flange's origin."""
    noise: float = 1.0
    columns: tuple[str, ...] = ()
    seed: int = field(default=0, repr=True)


def draw(seed: int) -> Case:
    """A case in which one or several things go wrong together."""
    rng = np.random.default_rng(seed)

    def seldom(value, otherwise, chance=0.2):
        return value if rng.random() < chance else otherwise

    arm = str(rng.choice(list(ARMS))) if rng.random() < 0.5 else "abb"
    joints = load_robot(ARMS[arm]).joints
    held = seldom(
        tuple(rng.permutation(joints)[: rng.choice([1, 1, joints - 1, joints])].tolist()), (), 0.4
    )
    copies = int(seldom(rng.choice([2, 5]), 1))
    return Case(
        kind=KINDS[seed % len(KINDS)],
        arm=arm,
        region_deg=float(rng.choice(REGIONS_DEG)),
        held=held,
        count=seldom(int(rng.choice(COUNTS)), 24, 0.3),
        copies=copies,
        identical=bool(rng.random() < 0.5),
        path=str(seldom(rng.choice(["line", "plane"]), "")),
        constant=seldom(True, False, 0.05),
        scale=float(rng.choice(SCALES)),
        sigma_mm=SIGMAS[rng.integers(len(SIGMAS))],
        targets=int(rng.choice([1, 3])),
        on_axis=bool(rng.random() < 0.15),
        noise=float(rng.choice([0.0, 1.0, 50.0])),
        columns=tuple(
            c
            for c in ("time_s", "payload_kg", "temperature_c", "approach", "repeat")
            if rng.random() < 0.3
        ),
        seed=seed,
    )


def recording(case: Case) -> Recording:
    """The recording of a case. Raises InputError where the reader refuses such columns."""
    rng = np.random.default_rng([case.seed, 1])
    keys = _scaled_arm(ARMS[case.arm], case.scale)
    robot = load_robot(keys)
    tool = np.zeros(3) if case.on_axis else case.scale * rng.uniform(-60, 60, 3)
    readings, groups = _poses(case, robot, tool, rng)
    columns = _joint_columns(robot, readings) | groups | _covariates(case, rng, len(readings))
    columns |= _measured(case, robot, readings, tool, groups, rng)
    n = len(readings)
    columns = {"sample": np.arange(1.0, n + 1)} | {
        k: np.asarray(v, float) for k, v in columns.items()
    }
    if case.constant:
        columns = {
            k: v if k.startswith(("q1_", "sample")) or k in groups else np.full(n, v[0])
            for k, v in columns.items()
        }
    balls = (
        {k: tuple(case.scale * np.array(v)) for k, v in _balls(case).items()}
        if "ball" in case.kind
        else {}
    )
    return _read(case, columns, keys, balls)


def _read(case, columns, keys, balls) -> Recording:
    """The recording as the reader makes it: after its checks of the columns."""
    if case.sigma_mm is not None and not case.sigma_mm > 0:
        raise InputError("recording.toml, key sigma_mm: expected a number above 0; correct it")
    table = Table("samples.csv", columns, np.arange(2, len(columns["sample"]) + 2))
    context = Context(case.kind, keys, balls, case.sigma_mm, small_range=True)
    check_samples(table, context)
    check_plausible(table, context)
    return Recording(
        case.kind, columns, keys, sigma_mm=case.sigma_mm, balls=balls, name=f"case {case.seed}"
    )


def _scaled_arm(keys, scale):
    """The same robot with all lengths times `scale`."""
    if "joint" not in keys or scale == 1:
        return keys
    lengths = ("d_mm", "a_mm")
    rows = [row | {name: scale * row[name] for name in lengths} for row in keys["joint"]]
    return keys | {"joint": rows}


def _balls(case):
    return dict(list(BALLS.items())[: case.targets])


def _poses(case, robot, tool, rng):
    """Readings (n, R) and the columns that group them."""
    poses = max(case.count // case.copies, 2)
    if case.kind == "distance":
        poses = 2 * poses
    middle = np.where(robot.prismatic, 100.0 * case.scale, rng.uniform(0.2, 0.9, robot.joints))
    spread = np.deg2rad(case.region_deg) * np.where(robot.prismatic, 100.0 * case.scale, 1.0)
    readings = middle + spread * rng.uniform(-0.5, 0.5, (poses, robot.joints))
    readings[:, list(case.held)] = middle[list(case.held)]
    readings, groups = _driven(case, robot, readings, tool, rng)
    again = np.repeat(
        np.arange(poses), _POINTS * case.copies if case.kind == "ball-surface" else case.copies
    )
    if case.kind == "distance":
        again = np.concatenate(
            [np.tile(pair, case.copies) for pair in np.arange(poses).reshape(-1, 2)]
        )
        groups["pair"] = np.arange(len(again)) // 2
    groups = {
        name: values if len(values) == len(again) else values[again]
        for name, values in groups.items()
    }
    return readings[again], groups


def _driven(case, robot, readings, tool, rng):
    """Readings at which the tip is on its point, plane, line or beam, as far as the moving joints allow."""
    n, groups = len(readings), {}
    points, turns = _tips(robot, readings, tool)
    index = np.arange(n) % case.targets
    normals = np.zeros((n, 3, 0))
    if case.kind in ("touch-point", "laser-spot"):
        groups["point"] = index + 1
        normals = np.tile(np.eye(3), (n, 1, 1))
    if case.kind == "laser-spot":
        groups["sphere"] = np.ones(n)
    if case.kind == "plane-touch" or case.path == "plane":
        groups |= {"plane": index + 1} if case.kind == "plane-touch" else {}
        normals = Rotation.random(case.targets, random_state=case.seed).as_matrix()[index][:, :, :1]
    if case.path == "line":
        normals = np.tile(np.linalg.qr(rng.standard_normal((3, 3)))[0][:, :2], (n, 1, 1))
    goal = points[index]
    free = [k for k in range(robot.joints) if k not in case.held]
    return _solved(robot, readings, tool, goal, normals, free, case.kind == "laser-spot"), groups


def _solved(robot, readings, tool, goal, normals, free, beam):
    """A few damped Gauss-Newton steps of the free joints towards (goal - tip) . normals = 0."""
    unit = np.where(robot.prismatic, 1.0, 1e-6)
    for _ in range(8 if normals.shape[2] else 0):
        tips, turns = _tips(robot, readings, tool)
        rows = []
        for k in free:
            moved = readings.copy()
            moved[:, k] += unit[k]
            rows.append((_tips(robot, moved, tool)[0] - tips) / unit[k])
        if not rows:
            break
        across = normals * 1.0
        if beam:  # along its beam a flange may stand anywhere
            across = (
                across
                - turns[:, :, 2, None] * np.einsum("ni,nik->nk", turns[:, :, 2], across)[:, None]
            )
        jacobian = np.einsum("kni,nia->nak", np.array(rows), across)
        miss = np.einsum("ni,nia->na", goal - tips, across)
        step = np.einsum("nka,na->nk", np.linalg.pinv(jacobian, rcond=1e-3), miss)
        readings = readings.copy()
        readings[:, free] += np.clip(step, -0.2 * 1e5 * unit[free], 0.2 * 1e5 * unit[free])
    return readings


def _tips(robot, readings, tool):
    """Tool points (n, 3) mm and flange rotations (n, 3, 3) in the root frame."""
    frames = forward(robot, robot.mixing @ readings.T)
    return frames.point(tool).T, flange_matrices(frames)


def _joint_columns(robot, readings):
    return {
        f"q{k + 1}_{'mm' if slides else 'deg'}": q if slides else np.rad2deg(q)
        for k, (slides, q) in enumerate(zip(robot.prismatic, readings.T))
    }


def _covariates(case, rng, n):
    made = {}
    for name in case.columns:
        if name == "approach":
            made |= {"approach1": rng.choice([-1.0, 1.0], n), "approach2": np.ones(n)}
        elif name == "repeat":
            made["repeat"] = np.arange(n) // max(case.copies, 1)
        else:
            made[name] = rng.uniform(1, 3, n) if rng.random() < 0.5 else np.ones(n)
    return made


def _measured(case, robot, readings, tool, groups, rng):
    """What the instrument shows, with noise."""
    n = len(readings)
    sigma = case.noise * min(case.sigma_mm or 0.02 * case.scale, 0.1 * case.scale)
    error = sigma * rng.standard_normal((n, 3))
    if case.identical and case.copies > 1:
        error = error[np.unique(readings, axis=0, return_inverse=True)[1].ravel()]
    tips, turns = _tips(robot, readings, tool)
    place = Rotation.random(random_state=case.seed)
    seen = place.apply(tips) + case.scale * rng.uniform(-1500, 1500, 3) + error
    if case.kind == "distance":
        length = np.linalg.norm(seen[1::2] - seen[::2], axis=1)
        return {"length_mm": np.repeat(np.maximum(length, 1e-9 * case.scale), 2)}
    if case.kind in ("touch-point", "laser-spot", "plane-touch"):
        return {}
    target = place * Rotation.from_matrix(turns) * Rotation.from_rotvec([0.1, 0.2, -0.3])
    if case.kind == "external-pose":
        return _xyz(seen) | dict(zip(("qx", "qy", "qz", "qw"), target.as_quat().T))
    if case.kind == "partial-pose":
        return _xyz(seen) | dict(zip(("ox", "oy", "oz"), target.as_matrix()[:, :, 1].T))
    if case.kind == "external-point":
        which = np.arange(n) % case.targets
        offsets = case.scale * np.array([(0, 0, 0), (40.0, 10, 0), (0, -30.0, 20)])[which]
        return _xyz(seen + place.apply(np.einsum("nij,nj->ni", turns, offsets))) | {
            "reflector": which + 1.0
        }
    return _balls_seen(case, tips, turns, place, error)


def _balls_seen(case, tips, turns, place, error):
    """Centres of balls, or points on them, in the sensor's frame; the balls are before the first pose."""
    shift = tips[0] + turns[0] @ [0.0, 0.0, 300.0 * case.scale]
    seen_at_once = _POINTS if case.kind == "ball-surface" else 1
    numbers = np.array(list(_balls(case)))[np.arange(len(tips)) // seen_at_once % case.targets]
    balls = case.scale * np.array([BALLS[k] for k in numbers])
    centres = place.apply(balls[:, :3]) + shift
    seen = np.einsum("nji,nj->ni", turns, centres - tips) + error
    if case.kind == "ball-centre":
        return _xyz(seen) | {"ball": numbers}
    rng = np.random.default_rng(case.seed)
    rays = rng.standard_normal((len(tips), 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return _xyz(seen + rays * balls[:, 3:]) | {"ball": numbers}


def _xyz(points):
    return {f"{axis}_mm": row for axis, row in zip("xyz", points.T)}
