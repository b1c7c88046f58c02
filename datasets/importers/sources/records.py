"""Tables of nested records: JSON, JSON lines and YAML, as scripts, ROS and hand-eye tools write them.

| content | columns |
|---|---|
| a list of records | their keys; those of an object inside get its name in front, as in "robot translation x" |
| lists of records below other keys | the same, with these keys in front where several lists stand next to one another |
| objects or lists of numbers under numbered names (`pose1`, ...) | a row for each number (`numbered_records`) |
| a list of one object inside a record | as that object: the one marker of an image |
| arrays by name, or a list of lists of numbers | those of the arrays (`arrays`) |
| `secs` next to `nsecs` (stamps of ROS) | the seconds |
| `name` next to `position` (sensor_msgs/JointState), `joint_names` next to rows of values | the names |
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from datasets.importers.source import RawTable
from datasets.importers.sources.arrays import tables_of_arrays
from datasets.importers.sources.numbered_records import numbered_records

_NAMES = ("name", "names", "joint_names", "joints")
_POSITIONS = ("position", "positions", "joint_values", "values", "q", "joint_positions")
_ONLY_IN_ROS = ("name", "position")  # JointState states rad
_STAMPS = (("secs", "nsecs"), ("sec", "nanosec"))
_FEWEST = 3


def read_record_tables(path: Path, content) -> list[RawTable]:
    """Tables of the value of a JSON or YAML file. Raises InputError where no array has one row per sample."""
    arrays: dict[str, np.ndarray] = {}
    texts: dict[str, np.ndarray] = {}
    lists = list(record_lists(content, "", path.stem))
    for prefix, records in lists:
        front = f"{prefix} " if prefix and len(lists) > 1 else ""
        rows = [flattened(row) for row in records]
        names = dict.fromkeys(name for row in rows for name in row)
        for name in names:
            values = _with_gaps([row.get(name) for row in rows])
            _add(front + name, values, arrays, texts)
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


def _with_gaps(values: list) -> list:
    """Values of the records with nan in the place of lists of numbers that single records lack."""
    lists = [value for value in values if isinstance(value, list) and value]
    missing = [value is None or value == [] for value in values]
    if not lists or not any(missing):
        return values
    array = _number_array(lists[0])
    if array is None:
        return values
    gap = np.full(array.shape, np.nan).tolist()
    return [gap if is_missing else value for value, is_missing in zip(values, missing)]


def record_lists(content, prefix: str, stem: str = "pose") -> Iterator[tuple[str, list[Mapping]]]:
    """(keys above it, records) of each list of records; a record may also be a list of objects, numbered from 1.

    stem: name of lists of numbers whose keys are numbers only.
    """
    if isinstance(content, Mapping):
        rows = numbered_records(content, prefix or stem)
        if rows is not None and len(rows) > _longest_list(content.values()):
            yield prefix, rows
            return
        for name, value in content.items():
            yield from record_lists(value, f"{prefix} {name}".strip(), stem)
    elif isinstance(content, list) and len(content) >= _FEWEST:
        if all(isinstance(row, Mapping) for row in content):
            yield prefix, content
        elif all(_is_list_of_objects(row) for row in content):
            yield prefix, [{str(k): item for k, item in enumerate(row, 1)} for row in content]


def _longest_list(values: Iterable) -> int:
    """Length of the longest list of records, next to which numbered objects are a table of something else."""
    lists = [
        records
        for value in values
        if isinstance(value, list)
        for _, records in record_lists(value, "")
    ]
    return max(map(len, lists), default=0)


def _is_list_of_objects(row) -> bool:
    return isinstance(row, list) and bool(row) and all(isinstance(item, Mapping) for item in row)


def flattened(content: Mapping, prefix: str = "") -> dict:
    """Values by name; those of an object inside get its name in front: {"tracker": {"x": 1}} as "tracker x"."""
    made = {}
    for name, value in _by_joint_names(content).items():
        seconds = _seconds(value)
        if seconds is not None:
            made[f"{prefix}{name} [s]"] = seconds
            continue
        if isinstance(value, list) and len(value) == 1 and isinstance(value[0], Mapping):
            value = value[0]
        if isinstance(value, Mapping):
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
    """Numbers of a nested list, nan for null; None where it holds anything else.

    Python reads the digits of a time stamp such as 20260131_181824 as one number; they are text.
    """
    if any(isinstance(cell, str) and "_" in cell for cell in value):
        return None
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        return None
