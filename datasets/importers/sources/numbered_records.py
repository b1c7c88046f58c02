"""Records that stand under numbered names, as scripts write them: {"pose1": [...], "pose2": [...], ...}.

Names that differ in their number are the rows of one list. Lists of equal length under such names may also be the
columns of a table, {"q1": [...], ..., "q6": [...]}: they are rows where there are more of them than each has numbers,
as there are more poses than components of a pose, and more samples than joints, and where no three lists without a
number, as x, y, z, are as long as each of them. A list without a number that has an entry for each row belongs to the
rows.
"""

import re
from collections.abc import Iterable, Mapping

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
    repeated, others = set(), {}
    for name, value in content.items():
        match = _NAME.fullmatch(str(name))
        if not match:
            others[str(name)] = value
            continue
        values, number = by_stem.setdefault(match[1] or stem, {}), int(match[2])
        if number in values:  # as of pose1 and pose_1, which are two lists
            repeated.add(match[1] or stem)
        values[number] = value
    rows = {
        name: values
        for name, values in by_stem.items()
        if name not in repeated and _are_rows(list(values.values()))
    }
    if not rows or any(_has_sibling(values, others.values()) for values in rows.values()):
        return None
    numbers = list(dict.fromkeys(number for values in rows.values() for number in values))
    lists = {
        name: dict(zip(numbers, value))
        for name, value in others.items()
        if isinstance(value, list) and len(value) == len(numbers)
    }
    return [
        {NUMBER: number, **_record(rows, number)}
        | {name: values[number] for name, values in lists.items()}
        for number in sorted(numbers)
    ]


def _has_sibling(values: Mapping[int, object], others: Iterable) -> bool:
    """Whether a value without a number belongs to the same list, or is a column like them.

    Such as the flange after joint1, joint2, ..., an object with the same keys; or x, y, z after q1, q2, ..., lists of
    the same length. One such list may be a pose by itself, as that of the tool.
    """
    first = next(iter(values.values()))
    if isinstance(first, Mapping):
        return any(isinstance(other, Mapping) and other.keys() == first.keys() for other in others)
    shape = _shape(first)
    return len(shape) == 1 and sum(_shape(other) == shape for other in others) >= _FEWEST


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
        return _are_records([_sizes(value) for value in values])
    shapes = {_shape(value) for value in values}
    shape = shapes.pop()
    if shapes or shape is None:
        return False
    return shape in _POSES or (len(shape) == 1 and 1 < shape[0] < len(values))


def _are_records(sizes: list[dict]) -> bool:
    """Whether names and shapes of objects are alike; fewer than half may lack a name, as of a marker not seen."""
    common: dict[str, tuple[int, ...] | None] = {}
    for size in sizes:
        for name, shape in size.items():
            if common.setdefault(name, shape) is None:
                common[name] = shape
            if shape not in (None, common[name]):
                return False
    complete = sum(size.keys() == common.keys() for size in sizes)
    return all(sizes) and 2 * complete > len(sizes)


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
