"""How each mistake changes a recording: functions from a sound recording to a wrong one, or to None."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.recording import Recording
from datasets.samples.columns import AXES, POINT, QUATERNION, joint_columns
from robot_model import load_robot
from robot_model.system import bind
from workbench.core.model import Model
from workbench.fitting.plausibility.hypotheses.corrections import axis_columns, observed_columns


def changed(recording, **columns) -> Recording:
    """The recording with other values in some columns."""
    return replace(recording, columns={**recording.columns, **columns})


def inner(recording, k) -> str:
    """The k-th joint column that turns, moves and is neither the first nor the last; 0 the first of these."""
    names = [n for n in joint_columns(recording.columns)[1:-1] if n.endswith("_deg")]
    moving = [n for n in names if np.ptp(recording.columns[n]) > 5]
    return moving[k % len(moving)]


def scaled(factor, *ks):
    def make(recording):
        names = {inner(recording, k) for k in ks}
        return changed(recording, **{n: factor * recording.columns[n] for n in names})

    return make


def points(factor, names=POINT):
    return lambda recording: changed(recording, **{n: factor * recording.columns[n] for n in names})


def swapped(recording):
    a, b = inner(recording, 2), inner(recording, 3)
    return changed(recording, **{a: recording.columns[b], b: recording.columns[a]})


def reordered(step):
    def make(recording):
        names = joint_columns(recording.columns)
        sources = names[::-1] if step == 0 else names[step:] + names[:step]
        return changed(recording, **{n: recording.columns[s] for n, s in zip(names, sources)})

    return make


def offset(recording):
    name = inner(recording, 1)
    return changed(recording, **{name: recording.columns[name] - 90})


def stuck(share):
    def make(recording):
        name = inner(recording, 3)
        column = recording.columns[name].copy()
        first = int((1 - share) * recording.n)
        column[first:] = column[first]
        return changed(recording, **{name: column})

    return make


def rounded(step):
    def make(recording):
        names = [n for n in joint_columns(recording.columns) if n.endswith("_deg")]
        return changed(
            recording, **{n: np.round(recording.columns[n] / step) * step for n in names}
        )

    return make


def left_handed(recording):
    flipped = {"y_mm": -recording.columns["y_mm"]}
    if recording.measures == "external-pose":
        flipped |= {n: -recording.columns[n] for n in ("qx", "qz")}
    if recording.measures == "partial-pose":
        name = axis_columns(recording)[1]
        flipped |= {name: -recording.columns[name]}
    return changed(recording, **flipped)


def one_axis(recording):
    return changed(recording, z_mm=-recording.columns["z_mm"])


def axes_swapped(recording):
    return changed(recording, x_mm=recording.columns["y_mm"], y_mm=recording.columns["x_mm"])


def xyzw(recording):
    return changed(
        recording, **{n: recording.columns[s] for n, s in zip(QUATERNION, ("qx", "qy", "qz", "qw"))}
    )


def conjugate(recording):
    return changed(recording, **{n: -recording.columns[n] for n in QUATERNION[1:]})


def inverse(recording):
    turns = Rotation.from_quat(np.stack([recording.columns[f"q{c}"] for c in "xyzw"], -1)).inv()
    points = -turns.apply(recording.points)
    return changed(
        recording,
        **dict(zip(POINT, points.T)),
        **{f"q{c}": v for c, v in zip("xyzw", turns.as_quat().T)},
    )


def late(recording):
    names = observed_columns(recording)
    rolled = changed(recording, **{n: np.roll(recording.columns[n], 1) for n in names})
    return rolled.select(np.arange(1, recording.n))


def backwards(recording):
    return changed(
        recording, **{n: recording.columns[n][::-1] for n in observed_columns(recording)}
    )


def shuffled(recording):
    order = np.random.default_rng(3).permutation(recording.n)
    return changed(
        recording, **{n: recording.columns[n][order] for n in observed_columns(recording)}
    )


def row_missing(recording):
    """From three quarters on, each row holds the next row's measurement."""
    start = 3 * recording.n // 4
    source = np.arange(recording.n)
    source[start:-1] += 1
    moved = changed(
        recording, **{n: recording.columns[n][source] for n in observed_columns(recording)}
    )
    return moved.select(np.arange(recording.n - 1))


def blunders(share):
    def make(recording):
        rng = np.random.default_rng(4)
        rows = rng.choice(recording.n, max(2, int(share * recording.n)), replace=False)
        points = recording.points.copy()
        points[rows] += rng.normal(size=(len(rows), 3)) * 17
        return changed(recording, **dict(zip(POINT, points.T)))

    return make


def labels_swapped(recording):
    return replace(recording, balls=exchanged(recording.balls))


def exchanged(balls):
    a, b = sorted(balls)[:2]
    return {**balls, a: balls[b], b: balls[a]}


def few_labels(recording):
    name = "ball" if recording.measures == "ball-centre" else "reflector"
    if name not in recording.columns or len(np.unique(recording.columns[name])) < 2:
        return None
    labels = recording.columns[name].copy()
    numbers = np.unique(labels)
    rows = np.flatnonzero(labels == numbers[0])[[1, 4, 7]]
    labels[rows] = numbers[1]
    return changed(recording, **{name: labels})


def artefact(factor):
    def make(recording):
        return replace(
            recording,
            balls={k: (*(factor * np.array(b[:3])), b[3]) for k, b in recording.balls.items()},
        )

    return make


def artefact_mirrored(recording):
    return replace(
        recording, balls={k: (b[0], -b[1], b[2], b[3]) for k, b in recording.balls.items()}
    )


def last_rows(recording):
    """(n,) bool: the last 40 % of the rows."""
    return np.arange(recording.n) >= int(0.6 * recording.n)


def moved(place, size_mm, size_deg, rows=last_rows):
    """Base or tool is elsewhere in some rows, by the model of the recording itself."""

    def make(recording):
        model = Model(bind(load_robot(recording.robot), recording))
        values = model.parameters.values.copy()
        rng = np.random.default_rng(5)
        indices = (
            np.arange(6)
            if place == "base"
            else np.arange(6 + 5 * model.chain.robot.joints, len(values))
        )
        shift = size_mm * unit(rng)
        values[indices[:3]] += shift
        if len(indices) == 6:
            before = Rotation.from_rotvec(values[indices[3:]])
            values[indices[3:]] = (
                Rotation.from_rotvec(np.deg2rad(size_deg) * unit(rng)) * before
            ).as_rotvec()
        elif place == "tool":
            values[indices] += np.tile(shift, len(indices) // 3) * (np.arange(len(indices)) > 2)
        moved, still = model.parameters.unpack(model.parameters.pack()), model.parameters
        change = model.residual(replace(moved, values=values)) - model.residual(still)
        change[:, ~rows(recording)] = 0
        return changed(recording, **model.chain.measurement.columns(change))

    return make


def set_up_again(size_mm, size_deg):
    """The instrument is set up elsewhere at 60 % of the rows: what it measures moves rigidly, also far."""

    def make(recording):
        elsewhere = stationed(recording, 5, size_mm, size_deg)
        return mixed(recording, elsewhere, last_rows(recording))

    return make


def stationed(recording, seed, size_mm, size_deg):
    """What the instrument measures from another station."""
    rng = np.random.default_rng(seed)
    shift = size_mm * unit(rng)
    turn = Rotation.from_rotvec(np.deg2rad(size_deg) * unit(rng))
    columns = dict(zip(POINT, (turn.apply(recording.points) + shift).T))
    if set(QUATERNION) <= set(recording.columns):
        names = ("qx", "qy", "qz", "qw")
        before = np.stack([recording.columns[name] for name in names], -1)
        columns |= dict(zip(names, (turn * Rotation.from_quat(before)).as_quat().T))
    for names in AXES:
        if set(names) <= set(recording.columns):
            before = np.stack([recording.columns[name] for name in names], -1)
            columns |= dict(zip(names, turn.apply(before).T))
    return changed(recording, **columns)


def mixed(first, second, rows) -> Recording:
    """The first recording, with the columns of the second in some rows (n,) bool."""
    columns = {n: np.where(rows, second.columns[n], first.columns[n]) for n in first.columns}
    return changed(first, **columns)


def calculated(recording) -> Recording:
    """Measurements that the nominal model calculates, without noise."""
    model = Model(bind(load_robot(recording.robot), recording))
    residual = model.residual(model.parameters)
    return changed(recording, **model.chain.measurement.columns(residual))


def unit(rng):
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def robot_keys(recording) -> dict:
    """The robot as keys of a robot.toml, which a mistake can be made in."""
    robot = load_robot(recording.robot)
    rows = []
    for k in range(robot.joints):
        theta, d, a, alpha, beta = robot.geometry[k]
        rows.append(
            {
                "theta_deg": float(np.rad2deg(theta)),
                "d_mm": float(d),
                "a_mm": float(a),
                "alpha_deg": float(np.rad2deg(alpha)),
                "beta_deg": float(np.rad2deg(beta)),
                "sign": int(robot.mixing[k, k]),
                "hayati": bool(robot.hayati[k]),
            }
        )
    return {"name": robot.name, "convention": robot.convention, "joint": rows}


def is_plain(recording) -> bool:
    robot = load_robot(recording.robot)
    return (
        np.array_equal(np.abs(robot.mixing), np.eye(robot.joints))
        and not robot.prismatic.any()
        and np.array_equal(robot.base, np.eye(4))
    )


def other_robot(recording):
    robot = load_robot(recording.robot)
    if robot.joints != 6:
        return None
    if robot.name.startswith("small six-axis"):
        return None  # its lengths are those of a library arm, but its name is not
    wrong = "staubli_tx60" if "IRB" in robot.name else "abb_irb120"
    return replace(recording, robot={"builtin": wrong})


def convention(recording):
    return (
        replace(recording, robot=robot_keys(recording) | {"convention": "craig"})
        if is_plain(recording)
        else None
    )


def link(recording):
    if not is_plain(recording):
        return None
    keys = robot_keys(recording)
    longest = max(range(1, len(keys["joint"]) - 1), key=lambda k: abs(keys["joint"][k]["a_mm"]))
    keys["joint"][longest]["a_mm"] *= 1.25
    return replace(recording, robot=keys)


def sigma(factor):
    def make(recording):
        if recording.sigma is None:
            return None
        columns = {k: v for k, v in recording.columns.items() if k != "sigma_mm"}
        return replace(
            recording, sigma_mm=float(np.median(recording.sigma)) * factor, columns=columns
        )

    return make


def covariate(name, change):
    def make(recording):
        return (
            changed(recording, **{name: change(recording.columns[name])})
            if name in recording.columns
            else None
        )

    return make


def few(recording):
    poses = np.unique(recording.poses)
    chosen = poses[np.linspace(0, len(poses) - 1, 6).astype(int)]
    return recording.select(np.isin(recording.poses, chosen))


def two(first, second):
    return lambda recording: second(first(recording))
