"""Tables of nested records: JSON, JSON lines and YAML, as scripts, ROS and hand-eye tools write them.

| content | columns |
|---|---|
| a list of records | their keys; those of an object inside get its name in front, as in "robot translation x" |
| lists of records below other keys | the same, with these keys in front where several lists stand next to one another |
| arrays by name, or a list of lists of numbers | those of the arrays (`arrays`) |
| `secs` next to `nsecs` (stamps of ROS) | the seconds |
| `name` next to `position` (sensor_msgs/JointState), `joint_names` next to rows of values | the names |
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from datasets.importers.source import RawTable
from datasets.importers.sources.arrays import tables_of_arrays

_NAMES = ("name", "names", "joint_names", "joints")
_POSITIONS = ("position", "positions", "joint_values", "values", "q", "joint_positions")
_ONLY_IN_ROS = ("name", "position")  # JointState states rad
_STAMPS = (("secs", "nsecs"), ("sec", "nanosec"))
_FEWEST = 3


def read_record_tables(path: Path, content) -> list[RawTable]:
    """Tables of the value of a JSON or YAML file. Raises InputError where no array has one row per sample."""
    arrays: dict[str, np.ndarray] = {}
    texts: dict[str, np.ndarray] = {}
    lists = list(record_lists(content, ""))
    for prefix, records in lists:
        front = f"{prefix} " if prefix and len(lists) > 1 else ""
        rows = [flattened(row) for row in records]
        names = dict.fromkeys(name for row in rows for name in row)
        for name in names:
            _add(front + name, [row.get(name) for row in rows], arrays, texts)
    if not lists:
        content = content if isinstance(content, Mapping) else {path.stem: content}
        for name, value in flattened(content).items():
            _add(name, value, arrays, texts)
    tables = tables_of_arrays(path, arrays)
    for table in tables:
        same = {name: cells for name, cells in texts.items() if len(cells) == table.n}
        table.columns.update(same)
    return tables


def _add(name: str, value, arrays: dict[str, np.ndarray], texts: dict[str, np.ndarray]) -> None:
    """Keep a list of numbers as an array, and one of words as text; other values are left out."""
    if not isinstance(value, list):
        return
    array = _number_array(value)
    if array is not None:
        arrays[name] = array
    elif all(isinstance(cell, str | int | float) for cell in value):
        texts[name] = np.array([str(cell) for cell in value])


def record_lists(content, prefix: str) -> Iterator[tuple[str, list[Mapping]]]:
    """(keys above it, records) of each list of records; a record may also be a list of objects, numbered from 1."""
    if isinstance(content, Mapping):
        for name, value in content.items():
            yield from record_lists(value, f"{prefix} {name}".strip())
    elif isinstance(content, list) and len(content) >= _FEWEST:
        if all(isinstance(row, Mapping) for row in content):
            yield prefix, content
        elif all(_is_list_of_objects(row) for row in content):
            yield prefix, [{str(k): item for k, item in enumerate(row, 1)} for row in content]


def _is_list_of_objects(row) -> bool:
    return isinstance(row, list) and bool(row) and all(isinstance(item, Mapping) for item in row)


def flattened(content: Mapping, prefix: str = "") -> dict:
    """Values by name; those of an object inside get its name in front: {"tracker": {"x": 1}} as "tracker x"."""
    made = {}
    for name, value in _by_joint_names(content).items():
        seconds = _seconds(value)
        if seconds is not None:
            made[f"{prefix}{name} [s]"] = seconds
        elif isinstance(value, Mapping):
            made |= flattened(value, f"{prefix}{name} ")
        else:
            made[f"{prefix}{name}"] = value
    return made


def _seconds(value) -> float | None:
    """The seconds of a time stamp of ROS, {secs, nsecs} or {sec, nanosec}; None for another value."""
    for seconds_key, nanoseconds_key in _STAMPS:
        if isinstance(value, Mapping) and set(value) == {seconds_key, nanoseconds_key}:
            return value[seconds_key] + 1e-9 * value[nanoseconds_key]
    return None


def _by_joint_names(content: Mapping) -> Mapping:
    """The positions of an object with names and positions of joints by these names; other objects as they are."""
    named = [key for key in _NAMES if _is_list_of(content.get(key), str)]
    if len(named) != 1:
        return content
    names = content[named[0]]
    positions = [key for key in _POSITIONS if _width(content.get(key)) == len(names)]
    if len(positions) != 1 or len(set(names)) < len(names):
        return content
    unit = " [rad]" if (named[0], positions[0]) == _ONLY_IN_ROS else ""
    values = np.array(content[positions[0]], float)
    others = {
        key: value
        for key, value in content.items()
        if key not in (named[0], positions[0]) and not isinstance(value, list)
    }
    return others | {f"{name}{unit}": cells.tolist() for name, cells in zip(names, values.T)}


def _is_list_of(value, kind: type) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, kind) for item in value)


def _width(value) -> int:
    """Number of columns of a list of numbers, or of a list of such lists; 0 for anything else."""
    array = _number_array(value) if isinstance(value, list) else None
    return 0 if array is None or array.ndim not in (1, 2) else array.shape[-1]


def _number_array(value: list) -> np.ndarray | None:
    """Numbers of a nested list, nan for null; None where it holds anything else."""
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        return None
