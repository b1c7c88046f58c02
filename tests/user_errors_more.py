"""Further mistakes for the table of user errors; the checks were not developed on them.

Together with `user_errors.MISTAKES` they make more than 75 mutations. `FRESH` are recordings of arms, tools, units
and seeds on which no check was developed either.
"""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

import user_error_changes as changes
from datasets.samples.columns import POINT, QUATERNION, joint_columns
from user_error_scenes import _BALLS, _scene
from user_errors import MISTAKES, Mistake


def all_joints(factor):
    def make(recording):
        names = [n for n in joint_columns(recording.columns) if n.endswith("_deg")]
        return changes.changed(recording, **{n: factor * recording.columns[n] for n in names})

    return make


def first_two_swapped(recording):
    a, b = joint_columns(recording.columns)[:2]
    return changes.changed(recording, **{a: recording.columns[b], b: recording.columns[a]})


def offset_by(degrees, k):
    def make(recording):
        name = changes.inner(recording, k)
        return changes.changed(recording, **{name: recording.columns[name] + degrees})

    return make


def first_stuck(recording):
    name = changes.inner(recording, 0)
    column = np.full(recording.n, recording.columns[name][0])
    return changes.changed(recording, **{name: column})


def rounded_points(step):
    def make(recording):
        rounded = {n: np.round(recording.columns[n] / step) * step for n in POINT}
        return changes.changed(recording, **rounded)

    return make


def axes(a, b):
    names = {n: f"{n}_mm" for n in "xyz"}

    def make(recording):
        swapped = {
            names[a]: recording.columns[names[b]],
            names[b]: recording.columns[names[a]],
        }
        return changes.changed(recording, **swapped)

    return make


def shifted(rows):
    def make(recording):
        names = changes.observed_columns(recording)
        rolled = changes.changed(
            recording, **{n: np.roll(recording.columns[n], rows) for n in names}
        )
        kept = np.arange(max(rows, 0), recording.n + min(rows, 0))
        return rolled.select(kept)

    return make


def large_blunders(share, size_mm):
    def make(recording):
        rng = np.random.default_rng(8)
        rows = rng.choice(recording.n, max(2, int(share * recording.n)), replace=False)
        points = recording.points.copy()
        points[rows] += rng.normal(size=(len(rows), 3)) * size_mm
        return changes.changed(recording, **dict(zip(POINT, points.T)))

    return make


def last_third_in_inches(recording):
    factor = np.where(np.arange(recording.n) >= 2 * recording.n // 3, 1 / 25.4, 1.0)
    return changes.changed(recording, **{n: factor * recording.columns[n] for n in POINT})


def robot_lengths(factor):
    def make(recording):
        if not changes.is_plain(recording):
            return None
        keys = changes.robot_keys(recording)
        for joint in keys["joint"]:
            joint["d_mm"] *= factor
            joint["a_mm"] *= factor
        return replace(recording, robot=keys)

    return make


def robot_twist(recording):
    """The first twist of 90 degrees gets the opposite sign."""
    if not changes.is_plain(recording):
        return None
    keys = changes.robot_keys(recording)
    turned = [joint for joint in keys["joint"][1:-1] if abs(abs(joint["alpha_deg"]) - 90) < 1]
    if not turned:
        return None
    turned[0]["alpha_deg"] *= -1
    return replace(recording, robot=keys)


_SIGN, _UNIT, _LENGTH = ("joint-sign",), ("joint-unit",), ("length-unit",)
_ARM = ("robot-file", "geometry", "convention")

MORE = (
    Mistake("two wrist joints of the opposite sign", _SIGN, changes.scaled(-1, 2, 3)),
    Mistake("all joints of the opposite sign", _SIGN, all_joints(-1)),
    Mistake("all joints in radians", _UNIT, all_joints(np.pi / 180)),
    Mistake("all joints in gon", _UNIT, all_joints(1 / 0.9)),
    Mistake("one joint in arc minutes", _UNIT, changes.scaled(60, 2)),
    Mistake("three joints in gon", _UNIT, changes.scaled(1 / 0.9, 0, 1, 2)),
    Mistake("first two joint columns swapped", ("joint-order",), first_two_swapped),
    Mistake("joint columns moved on by two places", ("joint-order",), changes.reordered(2)),
    Mistake("one joint offset by 180 degrees", ("joint-offset", "geometry"), offset_by(180, 2)),
    Mistake("one joint offset by 10 degrees", ("joint-offset", "geometry"), offset_by(10, 1)),
    Mistake("the second encoder stuck", ("stuck-encoder",), first_stuck),
    Mistake("readings rounded to half degrees", ("rounding",), changes.rounded(0.5)),
    Mistake("positions rounded to 10 mm", ("rounding", "point-rounding"), rounded_points(10.0)),
    Mistake("positions in m", _LENGTH, changes.points(0.001)),
    Mistake("positions in feet", _LENGTH, changes.points(1 / 304.8)),
    Mistake("y in cm", _LENGTH, changes.points(0.1, ("y_mm",))),
    Mistake("x of the opposite sign", ("axis-sign", "left-handed"), changes.points(-1, ("x_mm",))),
    Mistake("y and z swapped", ("axis-order", "left-handed"), axes("y", "z")),
    Mistake("measurements two rows late", ("rows-shifted",), shifted(2)),
    Mistake("measurements one row early", ("rows-shifted",), shifted(-1)),
    Mistake("20 % blunders", ("blunders",), changes.blunders(0.2)),
    Mistake("5 % blunders of 300 mm", ("blunders",), large_blunders(0.05, 300.0)),
    Mistake("last third in inches", ("length-unit", "moved"), last_third_in_inches),
    Mistake("base moved by 12 mm", ("moved",), changes.moved("base", 12.0, 1.0)),
    Mistake("artefact.csv in m", ("artefact-unit",), changes.artefact(0.001), ("ball-centre",)),
    Mistake(
        "robot file in m", (*_ARM, "length-unit"), robot_lengths(0.001), refusal="looks like metres"
    ),
    Mistake("a twist of the robot file of the opposite sign", _ARM, robot_twist),
    Mistake("sigma 200 times too small", ("sigma",), changes.sigma(1 / 200)),
    Mistake(
        "temperature in kelvin",
        ("temperature",),
        changes.covariate("temperature_c", lambda v: v + 273.15),
    ),
    Mistake(
        "a joint in radians and 5 % blunders",
        ("joint-unit", "blunders"),
        changes.two(changes.scaled(np.pi / 180, 1), changes.blunders(0.05)),
    ),
    Mistake(
        "a stuck encoder and z in m",
        ("stuck-encoder", "length-unit"),
        changes.two(changes.stuck(1.0), changes.points(0.001, ("z_mm",))),
    ),
)
EVERY = (*MISTAKES, *MORE)
"""More than 75 mutations."""


def _fresh_point(seed):
    return _scene(
        "fanuc_lr_mate_200id",
        "external-point",
        seed,
        reflectors=[[55, -15, 70], [-40, -45, 95], [20, 85, 60]],
        base={"xyz_mm": [-1900, 800, -350], "rpy_deg": [-4, 2, -130]},
    )


def _fresh_pose(seed):
    return _scene(
        "motoman_ma1400",
        "external-pose",
        seed,
        base={"xyz_mm": [2600, 1500, 600], "rpy_deg": [1, 6, 75]},
        tool={"xyz_mm": [-60, 45, 180], "rpy_deg": [-30, 5, 20]},
        sigma_mm=0.05,
    )


def _fresh_partial(seed):
    made = _scene("staubli_tx60", "external-pose", seed, samples=150)
    turns = Rotation.from_quat(np.stack([made.columns[f"q{c}"] for c in "xyzw"], -1)).as_matrix()
    columns = {k: v for k, v in made.columns.items() if k not in QUATERNION}
    axis = dict(zip(("nx", "ny", "nz"), turns[:, :, 0].T))
    return replace(made, measures="partial-pose", columns=columns | axis)


def _fresh_balls(seed):
    base = {"xyz_mm": [-300, -200, 40], "rpy_deg": [-5, 4, -60]}
    tool = {"xyz_mm": [-25, 30, 120], "rpy_deg": [-10, 15, 80]}
    more = {"balls": _BALLS, "base": base, "tool": tool, "cap_deg": 50.0}
    return _scene("mitsubishi_rv_2fb", "ball-centre", seed, **more)


def _fresh_large(seed):
    return _scene("ur10", "external-pose", seed, samples=200, sigma_mm=0.1)


FRESH = {
    "fanuc external-point": _fresh_point,
    "motoman external-pose": _fresh_pose,
    "staubli partial-pose": _fresh_partial,
    "mitsubishi ball-centre": _fresh_balls,
    "ur10 external-pose": _fresh_large,
}


@cache
def fresh(name: str, seed: int = 71):
    """One of the recordings with another random arm error, noise and poses for every seed."""
    return FRESH[name](seed)
