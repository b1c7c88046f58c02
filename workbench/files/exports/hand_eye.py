"""A calibrated hand-eye transform for ROS: a static transform as YAML, and a launch file that publishes it.

The parent frame is the flange for a sensor in the arm's hand, and the base for one next to the arm; the child frame is
the sensor. Translation in m and rotation as a quaternion are those of geometry_msgs/TransformStamped: they take
coordinates in the child frame to the parent frame.
"""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_toml

FORMAT = "hand-eye/1"
PARENTS = {"T_flange_sensor": "flange", "T_base_sensor": "base"}
CHILD = "sensor"
_FRAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./-]*")
_ROTATION = 1e-6
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class CalibratedHandEye:
    """`matrix` (4, 4) mm takes sensor coordinates to those of `parent` ("flange" or "base"); `suspicion` says in part
    of a sentence why it should not be used, "" where nothing speaks against it."""

    matrix: np.ndarray
    parent: str
    suspicion: str = ""


@dataclass(frozen=True)
class StaticTransform:
    """T_parent_child (4, 4) mm between two frames of ROS."""

    matrix: np.ndarray
    parent: str
    child: str = CHILD

    def __post_init__(self):
        for option, name in (("--parent-frame", self.parent), ("--child-frame", self.child)):
            if not _FRAME.fullmatch(name):
                raise InputError(
                    f"{option} {name!r}: expected a frame of ROS (letters, digits, _ . / -, no slash in front), found "
                    "another name; correct it"
                )
        if self.parent == self.child:
            raise InputError(
                f"--child-frame {self.child}: expected another frame than the parent, found the same; correct one"
            )


def read_hand_eye(path: Path) -> CalibratedHandEye:
    """The transform of a hand-eye.toml. Raises InputError with the file, the key and what to do."""
    try:
        keys = read_toml(path)
    except (OSError, ContentError) as problem:
        raise InputError(
            f"{path}: expected a hand-eye.toml, found that it cannot be read ({problem}); name the file that "
            "`workbench handeye` wrote"
        ) from None
    _check_format(keys, path)
    matrix = _matrix_of(keys, path)
    return CalibratedHandEye(matrix, PARENTS[keys["transform"]], _suspicion(keys, path))


def _check_format(keys, path: Path) -> None:
    if keys.get("format") != FORMAT or keys.get("transform") not in PARENTS:
        raise InputError(
            f"{path}, keys format and transform: expected '{FORMAT}' and one of {', '.join(PARENTS)}, found others; "
            "name the file that `workbench handeye` wrote"
        )


def _matrix_of(keys, path) -> np.ndarray:
    try:
        matrix = np.array(keys["matrix"], float).reshape(4, 4)
    except (KeyError, TypeError, ValueError):
        matrix = np.full((4, 4), np.nan)
    rotation = matrix[:3, :3]
    is_rotation = (
        np.abs(rotation @ rotation.T - np.eye(3)).max() < _ROTATION and np.linalg.det(rotation) > 0
    )
    if not np.isfinite(matrix).all() or not is_rotation:
        raise InputError(
            f"{path}, key matrix: expected a rotation and a translation (4 rows of 4 numbers), found something else; "
            "run `workbench handeye` again"
        )
    return matrix


def _suspicion(keys, path) -> str:
    lists = {key: keys.get(key, []) for key in ("suspicions", "std_mm", "std_deg", "undetermined")}
    for key, value in lists.items():
        if not isinstance(value, list):
            raise InputError(
                f"{path}, key {key}: expected a list, found {value!r:.40}; run `workbench handeye` again"
            )
    if lists["suspicions"]:
        return f"its recording is in doubt ({lists['suspicions'][0]})"
    spread = [*lists["std_mm"], *lists["std_deg"]]
    if not all(isinstance(value, int | float) and np.isfinite(value) for value in spread):
        why = (lists["undetermined"] or ["its standard deviation is not finite"])[0]
        return f"part of the transform is not determined ({why})"
    return "" if keys.get("converged", True) else "the solve did not converge"


def checked_hand_eye(found: CalibratedHandEye, path, force: bool) -> CalibratedHandEye:
    """The transform, where it may be used; InputError where it may not and nobody forces it."""
    if force or not found.suspicion:
        return found
    raise InputError(
        f"{path}: expected a hand-eye transform that can be relied on, found that {found.suspicion}; record more poses "
        "and calibrate again, or add --force"
    )


def transform_yaml(hand_eye_transform: StaticTransform) -> str:
    """YAML with the keys of geometry_msgs/TransformStamped."""
    import yaml

    translation, quaternion = _values(hand_eye_transform)
    keys = {
        "header": {"frame_id": hand_eye_transform.parent},
        "child_frame_id": hand_eye_transform.child,
        "transform": {"translation": translation, "rotation": quaternion},
    }
    return yaml.safe_dump(keys, sort_keys=False)


def launch_yaml(hand_eye_transform: StaticTransform) -> str:
    """A launch file of ROS 2 that publishes the transform with tf2_ros."""
    import yaml

    translation, quaternion = _values(hand_eye_transform)
    options = [(f"--{axis}", repr(value)) for axis, value in translation.items()]
    options += [(f"--q{axis}", repr(value)) for axis, value in quaternion.items()]
    options += [
        ("--frame-id", hand_eye_transform.parent),
        ("--child-frame-id", hand_eye_transform.child),
    ]
    node = {
        "pkg": "tf2_ros",
        "exec": "static_transform_publisher",
        "args": " ".join(f"{name} {value}" for name, value in options),
    }
    return yaml.safe_dump({"launch": [{"node": node}]}, sort_keys=False, width=1000)


def _values(hand_eye_transform: StaticTransform) -> tuple[dict[str, float], dict[str, float]]:
    """Translation in m and quaternion, by axis."""
    quaternion = Rotation.from_matrix(hand_eye_transform.matrix[:3, :3]).as_quat()
    translation = dict(zip(_AXES, (hand_eye_transform.matrix[:3, 3] / 1000).tolist()))
    return translation, dict(zip((*_AXES, "w"), quaternion.tolist()))


def read_transform_yaml(text: str) -> StaticTransform:
    """The transform of what `transform_yaml` wrote."""
    import yaml

    keys = yaml.safe_load(text)
    values = keys["transform"]
    return _transform_of(
        values["translation"],
        values["rotation"],
        keys["header"]["frame_id"],
        keys["child_frame_id"],
    )


def _node_options(launch) -> dict[str, str]:
    """Option -> value on the command line of the node of a launch file."""
    words = shlex.split(launch["launch"][0]["node"]["args"])
    return dict(zip(words[::2], words[1::2]))


def read_launch_yaml(text: str) -> StaticTransform:
    """The transform of what `launch_yaml` wrote."""
    import yaml

    options = _node_options(yaml.safe_load(text))
    translation = {axis: float(options[f"--{axis}"]) for axis in _AXES}
    quaternion = {axis: float(options[f"--q{axis}"]) for axis in (*_AXES, "w")}
    return _transform_of(
        translation, quaternion, options["--frame-id"], options["--child-frame-id"]
    )


def _transform_of(translation, quaternion, parent, child) -> StaticTransform:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat([quaternion[axis] for axis in (*_AXES, "w")]).as_matrix()
    matrix[:3, 3] = [1000 * translation[axis] for axis in _AXES]
    return StaticTransform(matrix, parent, child)
