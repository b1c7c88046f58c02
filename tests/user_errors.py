"""Mistakes that users make in recordings, as small functions, and the recordings that they are made in.

A `Mistake` changes a sound recording; `causes` are the terms of `Suspicion.cause` that name it rightly. Where the
mistake is absorbed by parameters that are estimated anyway, `absorbed` says by which: nothing can detect it then.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import datasets
from datasets.columns import POINT, QUATERNION, joint_columns
from datasets.recording import Recording
from robot_model import load_robot
from robot_model.measurements import samples_of
from robot_model.system import bind
from workbench.core.model import Model
from workbench.plausibility.corrections import axis_columns, observed_columns
from workbench.scene import Scene
from workbench.simulate import truth_from

POINT_KINDS = ("external-point", "external-pose", "partial-pose", "ball-centre")
EXTERNAL = ("external-point", "external-pose", "partial-pose")
_NOISE_MM, _NOISE_DEG = 0.02, 0.01


@dataclass(frozen=True)
class Mistake:
    """`make(recording)` returns the recording with the mistake, or None where it does not apply to it."""

    name: str
    causes: tuple[str, ...]
    make: Callable[[Recording], Recording | None]
    kinds: tuple[str, ...] = POINT_KINDS
    absorbed: Callable[[Recording], str] = lambda recording: ""


def changed(recording, **columns) -> Recording:
    """The recording with other values in some columns."""
    return replace(recording, columns={**recording.columns, **columns})


# --- recordings ------------------------------------------------------------------------------------------------------


_COMPLIANT = [
    {"effect": "joint-compliance", "where": f"joint-{k}", "values": {"compliance": 4e-6}} for k in (2, 3)
]
_BALLS = [[0, 0, 0, 15], [120, 5, -3, 15], [10, 150, 4, 15], [60, 70, 60, 15]]


def _scene(robot, measures, seed, **more) -> Recording:
    scene = Scene.model_validate(
        {
            "robot": robot, "measures": measures, "seed": seed, "samples": 120, "sigma_mm": _NOISE_MM,
            "base": {"xyz_mm": [1400, -300, 250], "rpy_deg": [3, -5, 40]},
            "tool": {"xyz_mm": [35, -20, 110], "rpy_deg": [12, 25, -50]},
            "errors": {"length_mm": 0.5, "angle_deg": 0.08}, "payload_kg": [0.2, 2.5],
            "temperature_c": [20, 27], "effect": _COMPLIANT, **more,
        }
    )  # fmt: skip
    truth = truth_from(scene, Path("scene.toml"))
    residual, sigma = truth.model.residual(truth.parameters), truth.model.sigma(truth.parameters)
    noisy = residual + truth.rng.normal(size=residual.shape) * sigma
    made = replace(truth.shown, columns=truth.shown.columns | truth.model.chain.measurement.columns(noisy))
    return replace(made, name=f"{robot} {measures}")


def _point():
    reflectors = [[40, 10, 90], [-60, 30, 70], [5, -80, 120]]
    return _scene("kuka_kr6_r900", "external-point", 11, reflectors=reflectors)


def _pose():
    return _scene("ur10e", "external-pose", 12)


def _partial():
    made = _scene("staubli_tx90l", "external-pose", 13)
    turns = Rotation.from_quat(np.stack([made.columns[f"q{c}"] for c in "xyzw"], -1)).as_matrix()
    columns = {k: v for k, v in made.columns.items() if k not in QUATERNION}
    axis = dict(zip(("nx", "ny", "nz"), turns[:, :, 0].T))
    return replace(made, measures="partial-pose", columns=columns | axis, name="staubli_tx90l partial-pose")


def _balls():
    base = {"xyz_mm": [-420, 80, -60], "rpy_deg": [2, -3, 25]}
    tool = {"xyz_mm": [20, -15, 90], "rpy_deg": [5, -8, 30]}
    return _scene("abb_irb120", "ball-centre", 14, balls=_BALLS, base=base, tool=tool, cap_deg=50.0)


def _elastic():
    return samples_of(datasets.read("elastic-arm"))


def ur10_recording(folder: Path, n: int = 300) -> Recording:
    """The first `n` usable poses of the T-Mac recording of a UR10, as `external-pose`."""
    rows = (folder / "measurements_grid.csv").read_text(encoding="utf-8").splitlines()[1:]
    table = np.array([[float(c.replace(",", ".")) if c else np.nan for c in row.split(";")] for row in rows[: 2 * n]])
    table = table[np.isfinite(table).all(1)]
    points, turns = table[:, 14:17], Rotation.from_euler("XYZ", table[:, 17:20], degrees=True)
    near = np.linalg.norm(points - np.median(points, axis=0), axis=1) < 4000
    quaternions = turns.as_quat()
    columns = {"sample": np.arange(1.0, len(table) + 1)}
    columns |= {f"q{k + 1}_deg": np.rad2deg(table[:, 7 + k]) for k in range(6)}
    columns |= dict(zip(POINT, points.T)) | dict(zip(("qx", "qy", "qz", "qw"), quaternions.T))
    columns |= {"temperature_c": table[:, 13]}
    made = Recording("external-pose", columns, {"builtin": "ur10"}, sigma_mm=0.05, name="ur10_ipa_tmac_A")
    return made.select(np.flatnonzero(near)[:n])


SIMULATED = {
    "elastic-arm": _elastic,
    "external-point": _point,
    "external-pose": _pose,
    "partial-pose": _partial,
    "ball-centre": _balls,
}
REAL = {
    "irb120_faro": lambda folder: samples_of(datasets.read("irb120_faro")).select(np.arange(600)),
    "motoman_leica_ctu": lambda folder: samples_of(datasets.read("motoman_leica_ctu:left")),
    "ur10_ipa_tmac_A": ur10_recording,
}


@cache
def simulated(name: str) -> Recording:
    """One of the recordings that need no file of others."""
    return SIMULATED[name]()


# --- mistakes --------------------------------------------------------------------------------------------------------


def _inner(recording, k) -> str:
    """The k-th joint column that turns, moves and is neither the first nor the last; 0 the first of these."""
    names = [n for n in joint_columns(recording.columns)[1:-1] if n.endswith("_deg")]
    moving = [n for n in names if np.ptp(recording.columns[n]) > 5]
    return moving[k % len(moving)]


def _scaled(factor, *ks):
    def make(recording):
        names = {_inner(recording, k) for k in ks}
        return changed(recording, **{n: factor * recording.columns[n] for n in names})

    return make


def _points(factor, names=POINT):
    return lambda recording: changed(recording, **{n: factor * recording.columns[n] for n in names})


def _swapped(recording):
    a, b = _inner(recording, 2), _inner(recording, 3)
    return changed(recording, **{a: recording.columns[b], b: recording.columns[a]})


def _reordered(step):
    def make(recording):
        names = joint_columns(recording.columns)
        sources = names[::-1] if step == 0 else names[step:] + names[:step]
        return changed(recording, **{n: recording.columns[s] for n, s in zip(names, sources)})

    return make


def _offset(recording):
    name = _inner(recording, 1)
    return changed(recording, **{name: recording.columns[name] - 90})


def _stuck(share):
    def make(recording):
        name = _inner(recording, 3)
        column = recording.columns[name].copy()
        first = int((1 - share) * recording.n)
        column[first:] = column[first]
        return changed(recording, **{name: column})

    return make


def _rounded(step):
    def make(recording):
        names = [n for n in joint_columns(recording.columns) if n.endswith("_deg")]
        return changed(recording, **{n: np.round(recording.columns[n] / step) * step for n in names})

    return make


def _left_handed(recording):
    flipped = {"y_mm": -recording.columns["y_mm"]}
    if recording.measures == "external-pose":
        flipped |= {n: -recording.columns[n] for n in ("qx", "qz")}
    if recording.measures == "partial-pose":
        name = axis_columns(recording)[1]
        flipped |= {name: -recording.columns[name]}
    return changed(recording, **flipped)


def _one_axis(recording):
    return changed(recording, z_mm=-recording.columns["z_mm"])


def _axes_swapped(recording):
    return changed(recording, x_mm=recording.columns["y_mm"], y_mm=recording.columns["x_mm"])


def _xyzw(recording):
    return changed(recording, **{n: recording.columns[s] for n, s in zip(QUATERNION, ("qx", "qy", "qz", "qw"))})


def _conjugate(recording):
    return changed(recording, **{n: -recording.columns[n] for n in QUATERNION[1:]})


def _inverse(recording):
    turns = Rotation.from_quat(np.stack([recording.columns[f"q{c}"] for c in "xyzw"], -1)).inv()
    points = -turns.apply(recording.points)
    return changed(recording, **dict(zip(POINT, points.T)), **{f"q{c}": v for c, v in zip("xyzw", turns.as_quat().T)})


def _late(recording):
    names = observed_columns(recording)
    rolled = changed(recording, **{n: np.roll(recording.columns[n], 1) for n in names})
    return rolled.select(np.arange(1, recording.n))


def _backwards(recording):
    return changed(recording, **{n: recording.columns[n][::-1] for n in observed_columns(recording)})


def _shuffled(recording):
    order = np.random.default_rng(3).permutation(recording.n)
    return changed(recording, **{n: recording.columns[n][order] for n in observed_columns(recording)})


def _row_missing(recording):
    """From three quarters on, each row holds the next row's measurement."""
    start = 3 * recording.n // 4
    source = np.arange(recording.n)
    source[start:-1] += 1
    moved = changed(recording, **{n: recording.columns[n][source] for n in observed_columns(recording)})
    return moved.select(np.arange(recording.n - 1))


def _blunders(share):
    def make(recording):
        rng = np.random.default_rng(4)
        rows = rng.choice(recording.n, max(2, int(share * recording.n)), replace=False)
        points = recording.points.copy()
        points[rows] += rng.normal(size=(len(rows), 3)) * 17
        return changed(recording, **dict(zip(POINT, points.T)))

    return make


def _labels_swapped(recording):
    return replace(recording, balls=_exchanged(recording.balls))


def _exchanged(balls):
    a, b = sorted(balls)[:2]
    return {**balls, a: balls[b], b: balls[a]}


def _few_labels(recording):
    name = "ball" if recording.measures == "ball-centre" else "reflector"
    if name not in recording.columns or len(np.unique(recording.columns[name])) < 2:
        return None
    labels = recording.columns[name].copy()
    numbers = np.unique(labels)
    rows = np.flatnonzero(labels == numbers[0])[[1, 4, 7]]
    labels[rows] = numbers[1]
    return changed(recording, **{name: labels})


def _artefact(factor):
    def make(recording):
        return replace(recording, balls={k: (*(factor * np.array(b[:3])), b[3]) for k, b in recording.balls.items()})

    return make


def _artefact_mirrored(recording):
    return replace(recording, balls={k: (b[0], -b[1], b[2], b[3]) for k, b in recording.balls.items()})


def _moved(place, size_mm, size_deg):
    """Base or tool moves at 60 % of the rows, by the model of the recording itself."""

    def make(recording):
        model = Model(bind(load_robot(recording.robot), recording))
        values = model.parameters.values.copy()
        rng = np.random.default_rng(5)
        slots = np.arange(6) if place == "base" else np.arange(6 + 5 * model.chain.robot.joints, len(values))
        shift = size_mm * _unit(rng)
        values[slots[:3]] += shift
        if len(slots) == 6:
            before = Rotation.from_rotvec(values[slots[3:]])
            values[slots[3:]] = (Rotation.from_rotvec(np.deg2rad(size_deg) * _unit(rng)) * before).as_rotvec()
        elif place == "tool":
            values[slots] += np.tile(shift, len(slots) // 3) * (np.arange(len(slots)) > 2)
        moved, still = model.parameters.unpack(model.parameters.pack()), model.parameters
        change = model.residual(replace(moved, values=values)) - model.residual(still)
        change[:, : int(0.6 * recording.n)] = 0
        return changed(recording, **model.chain.measurement.columns(change))

    return make


def _unit(rng):
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def _robot_keys(recording) -> dict:
    """The robot as keys of a robot.toml, which a mistake can be made in."""
    robot = load_robot(recording.robot)
    rows = []
    for k in range(robot.joints):
        theta, d, a, alpha, beta = robot.geometry[k]
        rows.append({
            "theta_deg": float(np.rad2deg(theta)), "d_mm": float(d), "a_mm": float(a),
            "alpha_deg": float(np.rad2deg(alpha)), "beta_deg": float(np.rad2deg(beta)),
            "sign": int(robot.mixing[k, k]), "hayati": bool(robot.hayati[k]),
        })  # fmt: skip
    return {"name": robot.name, "convention": robot.convention, "joint": rows}


def _is_plain(recording) -> bool:
    robot = load_robot(recording.robot)
    return np.array_equal(np.abs(robot.mixing), np.eye(robot.joints)) and not robot.prismatic.any() and np.array_equal(
        robot.base, np.eye(4)
    )


def _other_robot(recording):
    robot = load_robot(recording.robot)
    if robot.joints != 6:
        return None
    if robot.name.startswith("small six-axis"):
        return None  # its lengths are those of a library arm, but its name is not
    wrong = "staubli_tx60" if "IRB" in robot.name else "abb_irb120"
    return replace(recording, robot={"builtin": wrong})


def _convention(recording):
    return replace(recording, robot=_robot_keys(recording) | {"convention": "craig"}) if _is_plain(recording) else None


def _link(recording):
    if not _is_plain(recording):
        return None
    keys = _robot_keys(recording)
    longest = max(range(1, len(keys["joint"]) - 1), key=lambda k: abs(keys["joint"][k]["a_mm"]))
    keys["joint"][longest]["a_mm"] *= 1.25
    return replace(recording, robot=keys)


def _sigma(factor):
    def make(recording):
        if recording.sigma is None:
            return None
        columns = {k: v for k, v in recording.columns.items() if k != "sigma_mm"}
        return replace(recording, sigma_mm=float(np.median(recording.sigma)) * factor, columns=columns)

    return make


def _covariate(name, change):
    def make(recording):
        return changed(recording, **{name: change(recording.columns[name])}) if name in recording.columns else None

    return make


def _few(recording):
    poses = np.unique(recording.poses)
    chosen = poses[np.linspace(0, len(poses) - 1, 6).astype(int)]
    return recording.select(np.isin(recording.poses, chosen))


def _two(first, second):
    return lambda recording: second(first(recording))


_SIGN, _UNIT, _LENGTH = ("joint-sign",), ("joint-unit",), ("length-unit",)
_MOVED, _SHUFFLED = ("moved",), ("rows-shuffled",)
_COMPLIANCE = "absorbed by the joint compliances, which become smaller by the same factor; predicted positions are right"

MISTAKES = (
    Mistake("one joint of the opposite sign", _SIGN, _scaled(-1, 1)),
    Mistake("three joints of the opposite sign", _SIGN, _scaled(-1, 0, 1, 3)),
    Mistake("one joint in radians", _UNIT, _scaled(np.pi / 180, 2)),
    Mistake("two joints in radians", _UNIT, _scaled(np.pi / 180, 2, 3)),
    Mistake("one joint in gon", _UNIT, _scaled(1 / 0.9, 1)),
    Mistake("one joint in turns", _UNIT, _scaled(1 / 360, 1)),
    Mistake("two joint columns swapped", ("joint-order",), _swapped),
    Mistake("joint columns in reverse order", ("joint-order",), _reordered(0)),
    Mistake("joint columns moved on by one place", ("joint-order",), _reordered(1)),
    Mistake("one joint offset by 90 degrees", ("joint-offset", "geometry"), _offset),
    Mistake("one encoder stuck", ("stuck-encoder",), _stuck(1.0)),
    Mistake("one encoder stuck from the middle on", ("stuck-encoder",), _stuck(0.5)),
    Mistake("readings rounded to whole degrees", ("rounding",), _rounded(1.0)),
    Mistake("readings rounded to tenths of a degree", ("rounding",), _rounded(0.1)),
    Mistake("positions in inches", _LENGTH, _points(1 / 25.4)),
    Mistake("positions in cm", _LENGTH, _points(0.1)),
    Mistake("z in m", _LENGTH, _points(0.001, ("z_mm",))),
    Mistake("x in inches", _LENGTH, _points(1 / 25.4, ("x_mm",))),
    Mistake("left-handed frame", ("left-handed",), _left_handed),
    Mistake("z of the opposite sign", ("axis-sign", "left-handed"), _one_axis),
    Mistake("x and y swapped", ("axis-order", "left-handed"), _axes_swapped),
    Mistake("quaternion as x, y, z, w", ("quaternion-order",), _xyzw, ("external-pose",)),
    Mistake("rotation matrix transposed", ("inverse-rotation",), _conjugate, ("external-pose",)),
    Mistake("inverse pose", ("inverse-pose",), _inverse, ("external-pose",)),
    Mistake("measurements one row late", ("rows-shifted",), _late),
    Mistake("measurements in reverse order", ("rows-reversed",), _backwards),
    Mistake("measurements shuffled", _SHUFFLED, _shuffled),
    Mistake("a row missing at three quarters", ("rows-shifted",), _row_missing),
    Mistake("2 % blunders", ("blunders",), _blunders(0.02)),
    Mistake("10 % blunders", ("blunders",), _blunders(0.1)),
    Mistake("two balls swapped", ("ball-labels",), _labels_swapped, ("ball-centre",)),
    Mistake("a few wrong labels", ("ball-labels", "reflector-labels"), _few_labels, ("ball-centre", "external-point")),
    Mistake("artefact.csv in inches", ("artefact-unit",), _artefact(1 / 25.4), ("ball-centre",)),
    Mistake("artefact.csv left-handed", ("artefact-left-handed", "wrong-target"), _artefact_mirrored, ("ball-centre",)),
    Mistake("base, instrument or artefact moved midway", _MOVED, _moved("base", 4.0, 0.3)),
    Mistake("instrument set up anew midway", _MOVED, _moved("base", 700.0, 50.0), EXTERNAL),
    Mistake("target or sensor slipped midway", _MOVED, _moved("tool", 3.0, 0.4)),
    Mistake("file of another robot", ("robot-file",), _other_robot),
    Mistake("craig instead of distal", ("convention",), _convention),
    Mistake("one link length off by a quarter", ("geometry", "robot-file"), _link),
    Mistake("sigma 1000 times too large", ("sigma",), _sigma(1000)),
    Mistake("sigma in m", ("sigma",), _sigma(0.001)),
    Mistake("payload in g", ("payload",), _covariate("payload_kg", lambda v: 1000 * v)),
    Mistake("payload negative", ("payload",), _covariate("payload_kg", lambda v: -v)),
    Mistake("payload in pounds", ("payload",), _covariate("payload_kg", lambda v: v / 0.4536),
            absorbed=lambda recording: _COMPLIANCE),
    Mistake("temperature in Fahrenheit", ("temperature",), _covariate("temperature_c", lambda v: 1.8 * v + 32)),
    Mistake("time in ms", ("time",), _covariate("time_s", lambda v: 1000 * v)),
    Mistake("too few poses", ("few-poses",), _few),
    Mistake("a sign and x in inches", ("joint-sign", "length-unit"), _two(_scaled(-1, 2), _points(1 / 25.4, ("x_mm",)))),
    Mistake("a sign and two columns swapped", ("joint-sign", "joint-order"), _two(_swapped, _scaled(-1, 0))),
)
"""Every mistake of the table."""
