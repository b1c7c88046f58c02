"""Every export is read back before it is kept: a file that means something else is never written."""

import re
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from robot_model import load_robot
from robot_model.chain import forward
from robot_model.measurements.closure import flange_matrices
from robot_model.state import reading_names, sliding
from robot_model.tool_points import calibrated_points
from sensors.camera.model import Camera, camera_from_keys
from workbench.core.errors import InputError
from workbench.core.rigid import transform
from workbench.core.text.structured_text import ContentError, read_toml
from workbench.files.exports.camera import read_camera_text
from workbench.files.exports.hand_eye import StaticTransform, read_launch_yaml, read_transform_yaml
from workbench.files.exports.mdh import calibrated_geometry, read_mdh
from workbench.files.exports.programs import Program, read_program
from workbench.files.exports.urdf import is_coupled, joint_signs
from workbench.files.solution_file import CalibratedArm

_SAME_MM, _SAME = 1e-6, 1e-9
_PROGRAM_MM = 3e-3  # the decimals of a robot program
_FANUC_MM = 0.05  # three decimals of six joints in deg, at 2 m
# functions of the Python module that answer nan for a target that they refuse
_MAY_BE_NAN = ("corrected_readings", "errors_left")


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
        reread = load_robot(path)
    readings = np.random.default_rng(0).uniform(-1, 1, (16, reread.joints)) * np.where(
        arm.robot.prismatic, 100, 1
    )
    # joints that are coupled stand in the URDF as angles of their own
    if is_coupled(arm.robot):
        variables = readings
    else:
        variables = readings @ arm.robot.mixing.T
    expected_poses = _flanges(arm.robot, variables, calibrated_geometry(arm))
    flanges = _flanges(reread, readings @ reread.mixing.T)
    if np.abs(flanges - expected_poses).max() > _SAME_MM:
        raise _Differs("the URDF read back puts the flange elsewhere")
    _check_limits(arm, reread)


def _check_limits(arm: CalibratedArm, reread) -> None:
    """RuntimeError where a recorded reading within the robot's limits exceeds the limits of the URDF read back.

    Only ranges of the readings are known, so that all their corners are checked.
    """
    ranges = arm.fitted_range or {}
    slides = sliding(arm.robot)
    names = [f"q{k}_{'mm' if s else 'deg'}" for k, s in enumerate(slides, 1)]
    if not set(names) <= set(ranges):
        return
    units = np.where(slides, 1.0, np.pi / 180)
    ends = np.array([ranges[name] for name in names]) * units[:, None]
    limits = arm.robot.limits
    allowed = np.where(np.isnan(limits), ends, limits)
    low, high = np.clip(ends, allowed[:, :1], allowed[:, 1:]).T
    forms = arm.robot.mixing * joint_signs(arm.robot)[:, None]
    lowest = np.maximum(forms, 0) @ low + np.minimum(forms, 0) @ high
    highest = np.maximum(forms, 0) @ high + np.minimum(forms, 0) @ low
    is_outside = (lowest < reread.limits[:, 0] - _SAME) | (highest > reread.limits[:, 1] + _SAME)
    if is_outside.any():
        raise _Differs(f"recorded readings exceed the limits of joint {is_outside.argmax() + 1}")


def check_python(arm: CalibratedArm, text: str) -> None:
    """RuntimeError where the module, executed, puts the flange elsewhere than the calibrated arm.

    Every public function is called with its defaults, covariates only where a term depends on one.
    """
    from workbench.files.exports.python.module import arm_data, covariates_used, observed_effects
    from workbench.files.exports.python.runtime import CorrectedArm

    module: dict = {"__name__": "exported_arm"}
    exec(compile(text, "exported_arm.py", "exec"), module)
    reference_arm = CorrectedArm(arm_data(arm), arm.acting_effects, observed_effects(arm))
    readings = _checked_readings(arm)
    ranges = arm.fitted_range or {}
    used = covariates_used(arm)
    if not set(used) <= set(ranges):
        return  # an older version did not write in which range its covariates are
    covariates = {name: sum(ranges[name]) / 2 for name in used}
    given = {"covariates": covariates} if covariates else {}
    expected_poses = reference_arm.flange_poses(readings, covariates)
    if np.abs(module["flange_poses"](readings, **given) - expected_poses).max() > _SAME_MM:
        raise _Differs("the Python module executed puts the flange elsewhere")
    point = {} if calibrated_points(arm.values) else {"tool_point": np.zeros(3)}
    answers = {
        "nominal_poses": module["nominal_poses"](readings),
        "measured_points": module["measured_points"](readings, **point, **given),
        "servo_targets": module["servo_targets"](readings, **given),
        "corrected_readings": module["corrected_readings"](readings, **given)[0],
    }
    corrected = answers["corrected_readings"]
    answers["errors_left"] = module["errors_left"](corrected, readings, **given)[0]
    for name, answer in answers.items():
        if len(answer) != len(readings) or name not in _MAY_BE_NAN and np.isnan(answer).any():
            raise _Differs(f"{name} of the Python module executed gives no numbers")


def _checked_readings(arm: CalibratedArm) -> np.ndarray:
    """(8, R) deg, mm: readings within the recorded ranges, where they are known."""
    return readings_in_ranges(arm, arm.fitted_range or {}, 8)


def readings_in_ranges(arm: CalibratedArm, ranges: Mapping, count: int) -> np.ndarray:
    """(count, R) deg, mm: readings drawn from `ranges` by column; of +-50 deg or mm where a range is not known."""
    names = reading_names(arm.robot)
    low, high = np.array([ranges.get(name, (-50.0, 50.0)) for name in names]).T
    return np.random.default_rng(0).uniform(low, high, (count, len(names)))


def check_patched_urdf(arm: CalibratedArm, content: bytes, spec: dict, exact: bool) -> None:
    """RuntimeError where the patched URDF's flange moves otherwise than the calibrated one.

    exact: whether its flange must be that of the calibration; else a constant transform may lie between.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_bytes(content)
        reread = load_robot({**spec, "urdf": str(path)})
    readings = np.random.default_rng(0).uniform(-1, 1, (16, reread.mixing.shape[1]))
    found = _flanges(reread, readings @ reread.mixing.T)
    expected_poses = _flanges(arm.robot, readings @ arm.robot.mixing.T, calibrated_geometry(arm))
    if not exact:
        found, expected_poses = (part @ np.linalg.inv(part[0]) for part in (found, expected_poses))
        found, expected_poses = (
            np.trace(part, axis1=1, axis2=2) for part in (found, expected_poses)
        )
    if np.abs(found - expected_poses).max() > _SAME_MM:
        raise _Differs("the patched URDF read back puts the flange elsewhere")


def check_program(program: Program, text: str, language: str) -> None:
    """RuntimeError where the text does not hold the readings of the program."""
    readings = program.readings
    reread = read_program(text, language, program.slides)
    if reread.shape != readings.shape or np.abs(reread - readings).max(initial=0) > _SAME:
        raise _Differs(f"the {language} program read back has other targets")


def check_patched_program(
    arm: CalibratedArm,
    path: Path,
    content: bytes,
    readings: np.ndarray,
    mapping: Path | None = None,
) -> None:
    """RuntimeError where the patched program differs in more than numbers, or sends the flange elsewhere.

    path: the program before; readings (n, 6) rad; mapping: file that states tool and frame of the program. Five
    decimals of the text are 0.3 um at 2 m.
    """
    from workbench.files.targets import read_programme

    numbers = rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
    if re.sub(numbers, b"", content) != re.sub(numbers, b"", path.read_bytes()):
        raise _Differs("the patched program differs in more than numbers")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        for half in path.parent.glob(f"{path.stem}.*"):  # the other half of a KUKA program
            if half.suffix.lower() in (".src", ".dat") and half != path:
                shutil.copyfile(half, copy.with_name(half.name))
        copy.write_bytes(content)
        reread = read_programme(copy, arm.robot, mapping)
    mixing = arm.robot.mixing
    expected_poses = _flanges(arm.robot, readings @ mixing.T)
    found = reread.poses
    if found is None:
        found = _flanges(arm.robot, reread.readings @ mixing.T)
    allowed = _FANUC_MM if path.suffix.lower() == ".ls" else _PROGRAM_MM
    if (
        found.shape != expected_poses.shape
        or np.abs(found - expected_poses).max(initial=0) > allowed
    ):
        raise _Differs("the patched program read back sends the flange elsewhere")


def check_ur_kinematics(arm: CalibratedArm, text: str) -> None:
    """RuntimeError where the file does not give the places of the joints back."""
    from workbench.files.exports.ur_kinematics import joint_places, read_ur_kinematics

    for reread, place in zip(read_ur_kinematics(text), joint_places(arm)):
        if np.abs(reread - place).max() > _SAME_MM:
            raise _Differs("the kinematics file read back is another arm")


def _flanges(robot, variables, geometry=None):
    frames = forward(robot, variables.T, geometry)
    return transform(flange_matrices(frames), frames.end_origin.T)


def check_camera(camera: Camera, text: str, name: str) -> None:
    """RuntimeError where the file does not give the camera back."""
    reread = read_camera_text(text, name)
    size = len(camera.values)
    if reread.size != camera.size or np.abs(reread.values[:size] - camera.values).max() > _SAME:
        raise _Differs(f"the {name} file read back is another camera")


def check_static_transform(
    hand_eye_transform: StaticTransform, transform: str, launch: str
) -> None:
    """RuntimeError where one of the two files of a hand-eye transform does not give it back."""
    for name, reread in (
        ("transform", read_transform_yaml(transform)),
        ("launch", read_launch_yaml(launch)),
    ):
        if not _is_same_transform(reread, hand_eye_transform):
            raise _Differs(f"the {name} file read back is another transform")


def _is_same_transform(transform: StaticTransform, other: StaticTransform) -> bool:
    has_same_frames = (transform.parent, transform.child) == (other.parent, other.child)
    return has_same_frames and np.abs(transform.matrix - other.matrix).max() <= _SAME_MM


def read_calibrated_camera(path: Path) -> Camera:
    """The camera of a camera.toml or scanner.toml; InputError where it holds none."""
    try:
        keys = read_toml(path)
    except (OSError, ContentError) as problem:
        raise InputError(
            f"{path}: expected a camera.toml or scanner.toml, found that it cannot be read ({problem}); "
            "name the file that `workbench camera` or `workbench scanner` wrote"
        ) from None
    table = keys.get("camera", keys)
    return camera_from_keys(table if isinstance(table, dict) else {}, f"{path}, [camera]")
