"""The kinematic calibration of a Universal Robots arm for `ur_description`, and read back.

The file `default_kinematics.yaml` of that package has the origin of every joint in the frame of the joint before:
`shoulder` is on the first axis, `wrist_3` on the last one. What lies between the last axis and the flange is not in it.
"""

import hashlib

import numpy as np
from scipy.spatial.transform import Rotation

from robot_model.chain import ALPHA, BETA, THETA, A, D
from robot_model.robot import wrong
from workbench.files.exports.mdh import calibrated_geometry
from workbench.files.exports.urdf import placed
from workbench.files.solution_file import CalibratedArm

SEGMENTS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
_TWISTS = np.pi / 2 * np.array([1, 0, 0, 1, -1])
_MAX_DEVIATION = 0.1


def ur_kinematics_yaml(arm: CalibratedArm) -> str:
    """YAML text of `ur_description`'s kinematics parameters. Raises InputError for an arm of another build."""
    import yaml

    _check_build(arm)
    rows = {name: _row(origin) for name, origin in zip(SEGMENTS, joint_places(arm))}
    digest = hashlib.sha256(repr(rows).encode()).hexdigest()[:16]
    return yaml.safe_dump({"kinematics": {**rows, "hash": f"calib_{digest}"}}, sort_keys=False)


def joint_places(arm: CalibratedArm) -> list[np.ndarray]:
    """J transforms (4, 4) mm: the link frame of each joint at zero in that of the joint before.

    The screw Rz(theta) Tz(d) of a row belongs to the link's own frame; length and twists to the next origin.
    """
    places, remainder = [], arm.robot.base
    for theta, d, a, alpha, beta in calibrated_geometry(arm)[:, [THETA, D, A, ALPHA, BETA]]:
        places.append(remainder @ placed("z", theta, (0, 0, d)))
        remainder = placed("x", 0.0, (a, 0, 0)) @ placed("xy", [alpha, beta])
    return places


def _is_ur(robot) -> bool:
    """Whether convention, number of joints and twists are those of an arm of Universal Robots."""
    return (
        robot.convention == "distal"
        and robot.joints == len(SEGMENTS)
        and np.allclose(robot.geometry[:5, ALPHA], _TWISTS, atol=_MAX_DEVIATION)
        and np.array_equal(robot.mixing, np.eye(len(SEGMENTS)))
    )


def _check_build(arm: CalibratedArm) -> None:
    robot = arm.robot
    if not _is_ur(robot):
        raise wrong(
            "--to ros",
            "an arm of Universal Robots: six joints in the standard Denavit-Hartenberg convention with twists 90, 0, "
            "0, 90 and -90 deg",
            robot.name,
            "export it with --to urdf",
        )


def _row(origin: np.ndarray) -> dict[str, float]:
    numbers = [*(origin[:3, 3] / 1000), *Rotation.from_matrix(origin[:3, :3]).as_euler("xyz")]
    return dict(zip(_KEYS, map(float, numbers)))


def read_ur_kinematics(text: str) -> list[np.ndarray]:
    """Six transforms (4, 4) mm of what `ur_kinematics_yaml` wrote."""
    import yaml

    rows = yaml.safe_load(text)["kinematics"]
    places = []
    for name in SEGMENTS:
        places.append(_place_of(rows[name]))
    return places


def _place_of(row) -> np.ndarray:
    """(4, 4) mm of the numbers of one joint, m and rad."""
    angles = [row[key] for key in _KEYS[3:]]
    place = np.eye(4)
    place[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    place[:3, 3] = [1000 * row[key] for key in _KEYS[:3]]
    return place
