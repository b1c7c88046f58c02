"""Records that stand under numbered names, as scripts write them: {"pose1": [...], "pose2": [...], ...}.

Names that differ in their number are the rows of one list. Lists of equal length under such names may also be the
columns of a table, {"q1": [...], ..., "q6": [...]}: they are rows where there are more of them than each has numbers,
as there are more poses than components of a pose, and more samples than joints.
"""

import re
from collections.abc import Mapping

import numpy as np

NUMBER = "number"
"""Column with the number of each record."""
_FEWEST = 3
_NAME = re.compile(r"(.{0,80}?)[ _.\-]?(\d{1,9})")
_POSES = ((3, 4), (4, 4))


def numbered_records(content: Mapping, stem: str) -> list[dict] | None:
    """A record for each number, in their order; None where the names of the content are not numbered so.

    stem: name of the values whose names are numbers only. Records that lack a name have None there.
    """
    by_stem: dict[str, dict[int, object]] = {}
    others = []
    for name, value in content.items():
        match = _NAME.fullmatch(str(name))
        if match:
            by_stem.setdefault(match[1] or stem, {})[int(match[2])] = value
        elif isinstance(value, Mapping):
            others.append(value.keys())
    rows = {name: values for name, values in by_stem.items() if _are_rows(list(values.values()))}
    if not rows or any(_has_keys(values, others) for values in rows.values()):
        return None
    numbers = sorted({number for values in rows.values() for number in values})
    return [{NUMBER: number, **_record(rows, number)} for number in numbers]


def _has_keys(values: Mapping[int, object], others: list) -> bool:
    """Whether an object without a number belongs to the same list, such as the flange after joint1, joint2, ..."""
    first = next(iter(values.values()))
    return isinstance(first, Mapping) and first.keys() in others


def _record(rows: Mapping[str, Mapping[int, object]], number: int) -> dict:
    """The values of one number; those of objects by their own names where only one name is numbered."""
    values = {name: by_number.get(number) for name, by_number in rows.items()}
    only = next(iter(values.values()))
    return dict(only) if len(values) == 1 and isinstance(only, Mapping) else values


def _are_rows(values: list) -> bool:
    """Whether values of numbered names are the rows of a list: alike, and no columns of a table."""
    if len(values) < _FEWEST:
        return False
    if all(isinstance(value, Mapping) for value in values):
        sizes = [_sizes(value) for value in values]
        return bool(sizes[0]) and all(size == sizes[0] for size in sizes)
    shapes = {_shape(value) for value in values}
    shape = shapes.pop()
    if shapes or shape is None:
        return False
    return shape in _POSES or (len(shape) == 1 and 1 < shape[0] < len(values))


def _sizes(record: Mapping) -> dict[str, tuple[int, ...] | None]:
    """Names of a record with the shapes of their numbers; {} where all are lists of one length, as of samples."""
    sizes = {str(name): _shape(value) for name, value in record.items()}
    lengths = [size[0] for size in sizes.values() if size]
    is_columns = len(lengths) > 1 and len(lengths) == len(sizes) and len(set(lengths)) == 1
    return {} if is_columns else sizes


def _shape(value) -> tuple[int, ...] | None:
    """Shape of numbers or of nested lists of numbers; None for anything else."""
    try:
        array = np.array(value)
    except ValueError:
        return None
    return array.shape if array.dtype.kind in "fiu" else None
