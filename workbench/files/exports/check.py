"""Every export is read back before it is kept: a file that means something else is never written."""

import tempfile
import tomllib
from pathlib import Path

import numpy as np

from robot_model import load_robot
from robot_model.chain import forward
from robot_model.measurements.closure import flange_matrices
from sensors.camera.model import Camera, camera_from_keys
from workbench.core.errors import InputError
from workbench.core.rigid import transform
from workbench.files.exports.camera import read_camera_text
from workbench.files.exports.hand_eye import StaticTransform, read_launch_yaml, read_transform_yaml
from workbench.files.exports.mdh import calibrated_geometry, read_mdh
from workbench.files.solution_file import CalibratedArm

_SAME_MM, _SAME = 1e-6, 1e-9


class _Differs(RuntimeError):
    """A fault of the export, not of the user."""


def check_mdh(arm: CalibratedArm, text: str) -> None:
    """RuntimeError where the table does not give the calibrated geometry back."""
    if np.abs(read_mdh(text, arm.robot) - calibrated_geometry(arm)).max() > _SAME:
        raise _Differs("the MDH table read back is another geometry")


def check_urdf(arm: CalibratedArm, text: str) -> None:
    """RuntimeError where the URDF's flange does not stand where the calibrated one does."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        again = load_robot(path)
    readings = np.random.default_rng(0).uniform(-1, 1, (16, again.joints)) * np.where(
        arm.robot.prismatic, 100, 1
    )
    # joints that are coupled stand in the URDF as angles of their own
    coupled = np.count_nonzero(arm.robot.mixing) > arm.robot.joints
    variables = readings if coupled else readings @ arm.robot.mixing.T
    wanted = _flanges(arm.robot, variables, calibrated_geometry(arm))
    if np.abs(_flanges(again, readings @ again.mixing.T) - wanted).max() > _SAME_MM:
        raise _Differs("the URDF read back puts the flange elsewhere")


def _flanges(robot, variables, geometry=None):
    frames = forward(robot, variables.T, geometry)
    return transform(flange_matrices(frames), frames.end_origin.T)


def check_camera(camera: Camera, text: str, name: str) -> None:
    """RuntimeError where the file does not give the camera back."""
    again = read_camera_text(text, name)
    size = len(camera.values)
    if again.size != camera.size or np.abs(again.values[:size] - camera.values).max() > _SAME:
        raise _Differs(f"the {name} file read back is another camera")


def check_static_transform(made: StaticTransform, transform: str, launch: str) -> None:
    """RuntimeError where one of the two files of a hand-eye transform does not give it back."""
    for name, again in (
        ("transform", read_transform_yaml(transform)),
        ("launch", read_launch_yaml(launch)),
    ):
        is_same = (again.parent, again.child) == (made.parent, made.child)
        if not is_same or np.abs(again.matrix - made.matrix).max() > _SAME_MM:
            raise _Differs(f"the {name} file read back is another transform")


def read_calibrated_camera(path: Path) -> Camera:
    """The camera of a camera.toml or scanner.toml; InputError where it holds none."""
    try:
        keys = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as problem:
        raise InputError(
            f"{path}: expected a camera.toml or scanner.toml, found that it cannot be read ({problem}); "
            "name the file that `workbench camera` or `workbench scanner` wrote"
        ) from None
    table = keys.get("camera", keys)
    return camera_from_keys(table if isinstance(table, dict) else {}, f"{path}, [camera]")
