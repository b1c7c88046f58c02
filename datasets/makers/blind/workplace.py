"""Draws a world: arm, deviations from the data sheet, configurations, measurements, noise."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from datasets.makers.blind import covariates, data_sheets, measuring_poses, statics
from datasets.makers.blind.world import World
from datasets.makers.mujoco_arm import arm_from_robot, pose

_MM, _RAD = 0.5, np.deg2rad(0.25)
"""How far the arm's lengths and angles are off its manual, either way."""


@dataclass(frozen=True)
class Requirements:
    """Requirements of a case on its world.

    measures: "ball-centre", "external-point", or "" for either. need: kinds of covariates that must
    vary. elastic: all joints are compliant, also in the baseline. split: property that defines the `part` of the
    samples: "", "workspace", "payload", "temperature". samples: (fewest, most). gears: gear
    ratios must be stated.
    """

    measures: str = ""
    need: frozenset = frozenset()
    elastic: bool = False
    split: str = ""
    samples: tuple[int, int] = (100, 1000)
    gears: bool = False


def draw(rng: np.random.Generator, requirements: Requirements) -> World:
    """A world that meets the requirements. Raises ValueError if the drawn arm cannot work there; draw again."""
    robot = _robot(rng, requirements)
    nominal = arm_from_robot(robot)
    measures = requirements.measures or rng.choice(["ball-centre", "external-point"])
    n = int(np.exp(rng.uniform(*np.log(requirements.samples))))
    hand = _hand(rng) if measures == "ball-centre" else np.eye(4)
    balls, reflectors = _balls(rng), _reflectors(rng)
    joint_range = measuring_poses.limits(robot, nominal.mixing)
    if measures == "ball-centre":
        angles, index, plate = measuring_poses.views(
            rng, nominal.geometry, joint_range, balls, hand, n
        )
        station, targets = np.linalg.inv(_nudged(rng, plate, 5.0, 1.0)), balls
    else:
        count = len(reflectors)
        angles = np.repeat(
            measuring_poses.in_sight(rng, nominal.geometry, joint_range, -(-n // count)),
            count,
            axis=0,
        )
        index, station, targets = (
            np.tile(np.arange(count), len(angles) // count),
            _instrument(rng),
            reflectors,
        )
    drawn = _World(robot, nominal, str(measures), angles, index, targets, station, hand)
    return _recorded(rng, requirements, drawn)


@dataclass(frozen=True)
class _World:
    robot: Mapping
    nominal: object
    measures: str
    angles: np.ndarray
    index: np.ndarray
    targets: np.ndarray
    station: np.ndarray
    hand: np.ndarray


def _recorded(rng, requirements, drawn: _World) -> World:
    """The world with readings as the controller shows them, an arm as built and covariates."""
    readings = np.round(np.rad2deg(drawn.angles @ np.linalg.inv(drawn.nominal.mixing).T), 4)
    order, part = _parted(rng, drawn, requirements.split)
    readings, index = readings[order], drawn.index[order]
    count = len(drawn.targets) if drawn.measures == "external-point" else 1
    single_columns = covariates.draw(
        rng, readings[::count], requirements.need, part[::count], requirements.split
    )
    columns = {name: np.repeat(column, count) for name, column in single_columns.items()}
    arm = _built(rng, drawn.nominal)
    if requirements.elastic:
        payload = columns.get("payload_kg", np.zeros(len(readings)))
        arm = _with_compliant_joints(rng, arm, np.deg2rad(readings) @ arm.mixing.T, payload)
    sigma = float(np.round(np.exp(rng.uniform(*np.log([0.005, 0.05]))), 4))
    return World(
        drawn.robot,
        drawn.measures,
        arm,
        np.deg2rad(readings),
        index,
        drawn.targets,
        drawn.station,
        _nudged(rng, drawn.hand, 0.5, 0.2),
        columns,
        sigma,
        requirements.elastic,
        part,
    )


def _with_compliant_joints(rng, arm, angles, payload):
    """The arm with joints that deflect by 0.1 to 0.6 mrad under their largest torque here."""
    greatest = np.abs(statics.torques(arm, angles, payload)[0]).max(axis=0)
    return replace(
        arm, joint_compliance=rng.uniform(1e-4, 6e-4, arm.joints) / np.maximum(greatest, 5.0)
    )


def _robot(rng, requirements) -> dict:
    robot = data_sheets.robot(str(rng.choice(data_sheets.names())), rng)
    if requirements.gears and "gear_ratio" not in robot["joint"][0]:
        rows = [row | {"gear_ratio": int(rng.integers(50, 161))} for row in robot["joint"]]
        robot = robot | {"joint": rows}
    return robot


def _parted(rng, drawn, split) -> tuple[np.ndarray, np.ndarray]:
    """Order of the rows, and (n,) which of them are the part: a fifth, the outermost or the last."""
    count = len(drawn.targets) if drawn.measures == "external-point" else 1
    n = len(drawn.angles) // count
    order, last = np.arange(n), np.zeros(n, bool)
    if split:
        last[-n // 5 :] = True
    if split == "workspace":
        joint = rng.integers(1, 3)
        order = np.argsort(drawn.angles[::count, joint] * rng.choice([-1, 1]), kind="stable")
    rows = (order[:, None] * count + np.arange(count)).ravel()
    return rows, np.repeat(last, count)


def _built(rng, nominal):
    """The arm as built: each number of each row off by a little, beta where axes should be parallel."""
    deviation = rng.uniform(-1, 1, nominal.geometry.shape) * [_RAD, _MM, _MM, _RAD, _RAD]
    deviation[:, 4] *= np.abs(np.sin(nominal.geometry[:, 3])) < 1e-6
    deviation[-1, 4] = 0.0
    return replace(nominal, geometry=nominal.geometry + deviation)


def _balls(rng) -> np.ndarray:
    """(B, 3) mm: four to six balls, as a plate of 300 to 500 mm carries them."""
    count, side = int(rng.integers(4, 7)), rng.uniform(150, 250)
    corner = 2 * np.pi * (np.arange(count) + rng.uniform(-0.2, 0.2, count)) / count
    flat = side * np.column_stack([np.cos(corner), np.sin(corner)])
    return np.round(np.column_stack([flat, rng.uniform(20, 120, count)]), 3)


def _reflectors(rng) -> np.ndarray:
    """(R, 3) mm: one to three reflectors on the tool, well off the last axis."""
    count = int(rng.choice([1, 1, 2, 3]))
    azimuth = 2 * np.pi * (np.arange(count) / count + rng.random())
    radius = rng.uniform(50, 130, count)
    return np.round(
        np.column_stack(
            [radius * np.cos(azimuth), radius * np.sin(azimuth), rng.uniform(20, 160, count)]
        ),
        3,
    )


def _hand(rng) -> np.ndarray:
    """(4, 4) sensor in the flange: at its side, looking ahead and a little inwards."""
    return pose(
        rng.uniform([-60, -60, 40], [60, 60, 140]),
        (rng.uniform(-180, 180), *rng.uniform(-30, 30, 2)),
    )


def _instrument(rng) -> np.ndarray:
    """(4, 4) base in the frame of a tracker some metres away."""
    return pose(
        rng.uniform([-3000, -3000, -900], [3000, 3000, 300]),
        (rng.uniform(-180, 180), *rng.uniform(-2, 2, 2)),
    )


def _nudged(rng, nominal: np.ndarray, mm: float, deg: float) -> np.ndarray:
    return nominal @ pose(rng.uniform(-mm, mm, 3), rng.uniform(-deg, deg, 3))
