"""A recording made from arrays in memory, without files."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from datasets.formats.table import Table, number_groups
from datasets.samples.checks import Context, check_samples
from datasets.samples.columns import GROUPS, TEXT, misspelt
from workbench.core.errors import InputError
from workbench.core.robot_files.builtin_names import builtin_keys, check_builtin_name
from workbench.core.robot_files.robot_description import description_keys, is_description
from workbench.core.text.structured_text import ContentError, read_toml

_CALLED = "Recording.from_arrays"


def from_arrays(
    kind: type,
    robot: str | Mapping,
    joints_deg,
    points_mm,
    sigma_mm: float | None = None,
    quaternions=None,
    **columns,
):
    """A recording of points or poses that an external instrument measured.

    kind: `datasets.recording.Recording`, which this makes. robot: name of a built-in robot, path of
    a robot.toml, URDF or MJCF file, or the keys of a robot.toml.
    joints_deg: (n, J) joint readings, deg (mm for a prismatic joint). points_mm: (n, 3) measured
    points in the frame of the instrument. quaternions: (n, 4) w x y z of the target, where poses
    are measured. sigma_mm: 1 sigma of a coordinate. columns: further columns of samples.csv, such
    as `reflector` (numbers or names), `payload_kg`, `temperature_c` or `time_s`, each (n,).
    Raises InputError where shapes do not agree, a robot file cannot be read, or a value cannot be a
    measurement (nan, a quaternion that is not of length 1); the sentence names row (from 0) and column.
    """
    joints, points = _numbers("joints_deg", joints_deg), _numbers("points_mm", points_mm)
    keys = _robot_keys(robot)
    n = len(points)
    if joints.ndim != 2 or len(joints) != n or points.shape != (n, 3):
        raise InputError(
            "Recording.from_arrays: expected joints_deg (n, J) and points_mm (n, 3), found "
            f"{joints.shape} and {points.shape}; transpose or select rows"
        )
    if n == 0:
        raise InputError(
            f"{_CALLED}, points_mm: expected at least one row, found none; check the selection of the rows"
        )
    described = builtin_keys(keys)
    made = {"sample": np.arange(1.0, n + 1)}
    made |= dict(zip(_joint_names(described, joints.shape[1]), joints.T))
    made |= {name: points[:, i] for i, name in enumerate(("x_mm", "y_mm", "z_mm"))}
    if quaternions is not None:
        rotations = _numbers("quaternions", quaternions)
        if rotations.shape != (n, 4):
            raise InputError(
                f"Recording.from_arrays: expected quaternions of shape ({n}, 4) with w first, found shape "
                f"{rotations.shape}; transpose or complete them"
            )
        made |= {name: rotations[:, i] for i, name in enumerate(("qw", "qx", "qy", "qz"))}
    for name, values in columns.items():
        if name in made and name != "sample":
            raise InputError(
                f"{_CALLED}, {name}: expected a further column, found one of joints_deg, points_mm or quaternions; "
                "leave it out"
            )
        if (right := misspelt(name)) is not None:
            raise InputError(
                f"{_CALLED}, {name}: expected the name of a column, found one that nearly is {right}; write {right}, "
                "or another name"
            )
        made[name] = _column(name, values, n)
    measures = "external-point" if quaternions is None else "external-pose"
    _check_sigma(sigma_mm)
    table = number_groups(Table(_CALLED, made, np.arange(n)), GROUPS)
    check_samples(table, Context(measures, described, sigma_mm=sigma_mm))
    return kind(
        measures,
        dict(table.columns),
        keys,
        sigma_mm=sigma_mm,
        name="arrays",
        group_names=dict(table.names),
    )


def _joint_names(keys: Mapping, count: int) -> list[str]:
    """Column names of joint readings: `_mm` where the robot file says that a joint is prismatic."""
    joints = keys.get("joint", keys.get("joints", ()))
    slides = [isinstance(joint, Mapping) and joint.get("kind") == "prismatic" for joint in joints]
    slides += [False] * (count - len(slides))  # a wrong number is refused with the other checks
    return [f"q{k}_{'mm' if slides[k - 1] else 'deg'}" for k in range(1, count + 1)]


def _column(name: str, values, n: int) -> np.ndarray:
    """(n,) float64; text where a column may hold it. Raises InputError for another length or other values."""
    may_be_text = name in (*TEXT, *GROUPS)
    cells = _texts(name, values) if may_be_text else _numbers(name, values)
    if cells.shape not in ((), (n,)):
        raise InputError(
            f"{_CALLED}, {name}: expected one number or {n} of them, one for each row, found an array "
            f"{cells.shape}; select rows"
        )
    return np.broadcast_to(cells, (n,))


def _texts(name: str, values) -> np.ndarray:
    """An array of text where a value is text, else of float64. Raises InputError for text next to other values."""
    cells = _array(name, values)
    if cells.dtype.kind == "U" or not any(isinstance(cell, str) for cell in cells.flat):
        return cells if cells.dtype.kind == "U" else _numbers(name, values)
    other = next((cell for cell in cells.flat if not isinstance(cell, str)), None)
    if not all(isinstance(cell, str) for cell in cells.flat):
        raise _wrong_values(name, "names, or numbers", f"both ({other!r})", "name every row")
    return cells.astype(str)


def _numbers(name: str, values) -> np.ndarray:
    """An array of float64; masked values are nan. Raises InputError for values that are no real numbers."""
    if isinstance(values, np.ma.MaskedArray):
        values = np.where(np.ma.getmaskarray(values), np.nan, values.data)
    cells = _array(name, values)
    remedy = "convert them to real numbers"
    if cells.dtype.kind == "c":
        raise _wrong_values(name, "real numbers", "complex ones", remedy)
    texts = (
        [cell for cell in cells.flat if isinstance(cell, str | bytes)] if _is_text(cells) else []
    )
    if texts:
        raise _wrong_values(name, "numbers", f"text ({str(texts[0])!r})", remedy)
    try:
        return cells.astype(float)
    except (TypeError, ValueError):
        raise _wrong_values(name, "numbers", "other objects", remedy) from None


def _is_text(cells: np.ndarray) -> bool:
    return cells.dtype.kind in "USO"


def _array(name: str, values) -> np.ndarray:
    """The values as an array. Raises InputError for rows of different lengths."""
    try:
        return np.asarray(values)
    except ValueError:
        raise _wrong_values(
            name, "rows of one length", "rows of different lengths", "complete them"
        ) from None


def _wrong_values(name: str, expected: str, found: str, remedy: str) -> InputError:
    return InputError(f"{_CALLED}, {name}: expected {expected}, found {found}; {remedy}")


def _check_sigma(sigma_mm) -> None:
    """Raise InputError for a standard deviation that is no number above zero."""
    if np.ndim(sigma_mm):
        raise _wrong_values(
            "sigma_mm",
            "one number above zero, or None",
            f"an array of shape {np.shape(sigma_mm)}",
            "state the sigma of each row as sigma_x_mm, sigma_y_mm and sigma_z_mm",
        )
    is_number = isinstance(sigma_mm, int | float | np.number) and np.isreal(sigma_mm)
    if sigma_mm is not None and not (is_number and 0 < sigma_mm < np.inf):
        raise _wrong_values(
            "sigma_mm", "a number above zero, or None", repr(sigma_mm), "state 1 sigma in mm"
        )


def _robot_keys(robot: str | Mapping) -> Mapping:
    """Value of `Recording.robot` for a built-in name, a file or keys. Raises InputError."""
    if isinstance(robot, Mapping):
        if "builtin" in robot:
            check_builtin_name(robot["builtin"], f"{_CALLED}, robot")
        return robot
    if not isinstance(robot, str | Path):
        raise InputError(
            f"{_CALLED}, robot: expected the name of a built-in robot, a file or the keys of a robot.toml, found "
            f"{robot!r}; name the robot whose joints were read"
        )
    path = Path(robot)
    if is_description(path):
        return description_keys(path)
    if path.suffix.lower() != ".toml":
        check_builtin_name(str(robot), f"{_CALLED}, robot")
        return {"builtin": str(robot)}
    try:
        return read_toml(path)
    except OSError as error:
        raise InputError(
            f"robot {path}: expected a robot file (TOML) that can be read, found none ({error.strerror}); correct the "
            "path"
        ) from error
    except ContentError as error:
        raise InputError(
            f"robot {path}: expected a robot file (TOML), found {error}; correct it"
        ) from error
