"""Two sets of poses in tables whose headers do not say so: which columns are positions and rotations, of which set.

A set is 6 numbers (position and three angles, in either order), 7 (position and quaternion), or 12 or 16 (a matrix).
The two sets stand in one table, side by side, or in two tables with the same rows.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.errors import InputError
from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.mapping.proposal import propose
from datasets.importers.source import RawTable
from datasets.importers.sources.arrays import pose_columns as array_columns
from workbench.recordings.importing.target_poses.readings import angle_misfit

_COMPONENT = re.compile(r"(.*?)[ _.\-]*(?:r[123][123]|[tr]?[xyz]|q?[xyzw]|\d+|\[\d+\])$", re.I)
_PART = re.compile(
    r"(?:^|[ _]+)(?:r|t|p|q|rot|rotation|rmat|rvec|tvec|trans|translation|pos|position|orientation|orn|quat|quaternion|"
    r"euler|rpy|vec|vector|mm|cm|m|rad|deg)(?=[ _]|$)",
    re.I,
)
"""Words of a header that say which part of a pose it is, or its unit, and not whose pose."""
_FLANGE_WORDS = re.compile(
    r"gripper|flange|hand(?!eye)|robot|tcp|effector|\bee|arm|rpe|bmh|wpe|base", re.I
)
_TARGET_WORDS = re.compile(
    r"target|board|marker|tag|cam|object|chess|pattern|cpo|optical|sensor|aruco|charuco|tracking|eye",
    re.I,
)
_NUMBERED = re.compile(r"column \d+")
"""Names of the columns of a file without headers."""
_ROTATION_FIRST = (3, 4, 5, 6, 7, 8, 9, 10, 11)
_OF_MATRIX = ((3, 7, 11), (0, 1, 2, 4, 5, 6, 8, 9, 10))
_AFTER_MATRIX = ((9, 10, 11), (0, 1, 2, 3, 4, 5, 6, 7, 8))
_BY_COLUMNS = ((12, 13, 14), (0, 4, 8, 1, 5, 9, 2, 6, 10))
"""Places of position and rotation, row by row, in 16 numbers of a 4 x 4 matrix that is written column by column."""
_UNIT_LENGTH = 0.02
_ORTHOGONAL = 0.02
_WIDTHS = (6, 7, 12, 16)
_FEWEST = 4
_FEWEST_JOINTS = 5
_MOST_MISFIT = 0.03
"""Difference of the angles by which two sets rotate, as a share of these (`angle_misfit`), above which two sets without
names are no poses of one rigid body: joint readings next to a pose have 0.06 and more, poses 1 deg off 0.007."""


@dataclass(frozen=True)
class PoseSet:
    """Columns of one set of poses in a table; `words`: what its headers and its file are called. `stated`: groups of
    position and rotation where the headers name them."""

    table: RawTable
    columns: tuple[str, ...]
    words: str
    stated: tuple[Group, Group] | None = None


def has_joints(table: RawTable) -> bool:
    """Whether headers name the joints of an arm: more of them than a pose with a quaternion has components."""
    return sum(read_header(name).kind == "joint" for name in table.columns) >= _FEWEST_JOINTS


def two_pose_sets(tables: Sequence[RawTable], mapping: Mapping) -> tuple[RawTable, Mapping] | None:
    """One table of both sets and its mapping, with flange poses and target poses; None for any other tables.

    mapping: the user's, which may name the columns of the joined table.
    """
    if not 0 < len(tables) <= 2 or mapping.joints is not None:
        return None
    if any(has_joints(table) for table in tables):
        return None
    tables = [_with_whole_matrices(part) for table in _halves(tables) for part in table]
    pose_sets = [pose_set for table in tables for pose_set in _sets_of(table, len(tables))]
    if (
        len(pose_sets) != 2
        or pose_sets[0].table.n != pose_sets[1].table.n
        or pose_sets[0].table.n < 2
    ):
        return None
    if pose_sets[0].table.n < _FEWEST and _is_target(pose_sets[0]) == _is_target(pose_sets[1]):
        return None  # with names, the error says that the poses are too few
    if _is_target(pose_sets[0]) > _is_target(pose_sets[1]):
        pose_sets = pose_sets[::-1]
    joined, pose_sets = join_sets(pose_sets)
    if mapping.flange_point is not None:
        if _names(mapping) <= set(joined.columns):
            return (joined, mapping)
        return None
    chosen = _best_layouts(joined, pose_sets)
    if chosen is None:
        return None
    flange, target = chosen
    is_named = mapping.measures == "target-pose" or _is_target(pose_sets[0]) != _is_target(
        pose_sets[1]
    )
    if not is_named and angle_misfit(joined, flange[1], target[1]) > _MOST_MISFIT:
        return None
    proposed = Mapping(
        measures="target-pose",
        flange_point=flange[0],
        flange_rotation=flange[1],
        point=target[0],
        rotation=target[1],
    )
    return joined, mapping.merged(proposed)


def _halves(tables: Sequence[RawTable]) -> list[tuple[RawTable, ...]]:
    """The two halves of a single table without headers that other lines divide; other tables as they are."""
    table = tables[0]
    half, remainder = divmod(table.n, 2)
    gaps = np.flatnonzero(np.diff(table.lines) > 1)
    is_divided = not remainder and half >= _FEWEST and half - 1 in gaps
    is_plain = all(_NUMBERED.fullmatch(name) for name in table.columns)
    if len(tables) > 1 or not is_divided or not is_plain:
        return [(table_of_half,) for table_of_half in tables]
    halves = (np.arange(half), np.arange(half, table.n))
    names = [f"{table.stem} ({place}){Path(table.file).suffix}" for place in (1, 2)]
    half_tables = tuple(replace(table.take(rows), file=name) for rows, name in zip(halves, names))
    complete_halves = [_with_whole_matrices(part) for part in half_tables]
    if all(_sets_of(table_of_half, 2) for table_of_half in complete_halves):
        return [half_tables]
    return [(table,)]


def _with_whole_matrices(table: RawTable) -> RawTable:
    """A table of 4 x 4 matrices with four rows each as one with a row for each matrix; other tables as they are."""
    cells = [cells for cells in table.columns.values() if cells.dtype.kind == "f"]
    if len(cells) != 4 or len(table.columns) != 4 or table.n % 4:
        return table
    matrices = np.stack(cells, axis=1).reshape(-1, 4, 4)
    if not (matrices[:, 3] == [0, 0, 0, 1]).all():
        return table
    columns = array_columns(table.stem, matrices)
    return replace(table, columns=columns, lines=table.lines[::4])


def _names(mapping: Mapping) -> set[str]:
    groups = (mapping.flange_point, mapping.flange_rotation, mapping.point, mapping.rotation)
    return {name for group in groups if group is not None for name in group.columns}


def _is_target(pose_set: PoseSet) -> int:
    """Positive for words of a target or camera, negative for those of a robot."""
    return len(_TARGET_WORDS.findall(pose_set.words)) - len(_FLANGE_WORDS.findall(pose_set.words))


def _sets_of(table: RawTable, tables: int) -> list[PoseSet]:
    """The sets of poses of a table, by its headers, by the names of arrays, or by the order of its columns."""
    numeric = [name for name, cells in table.columns.items() if cells.dtype.kind == "f"]
    named = _named_set(table) if tables == 2 else []
    if named:
        return named
    groups: dict[str, list[str]] = {}
    for name in numeric:
        match = _COMPONENT.match(name)
        base = _PART.sub("", match[1] if match else name).strip(" _")
        groups.setdefault(base, []).append(name)
    by_name = [(base, names) for base, names in groups.items() if len(names) in _WIDTHS]
    wanted = 2 // tables
    if len(by_name) == wanted and all(base not in ("", "column", "pose") for base, _ in by_name):
        return [PoseSet(table, tuple(names), f"{base} {table.stem}") for base, names in by_name]
    return _by_order(table, numeric, wanted)


def _named_set(table: RawTable) -> list[PoseSet]:
    """The set whose position and rotation the headers name; raises nothing where they do not."""
    try:
        found = propose(table, has_images=True).mapping
    except InputError:
        return []
    if found.joints is not None or None in (found.flange_point, found.flange_rotation):
        return []
    groups = (found.flange_point, found.flange_rotation)
    columns = (*groups[0].columns, *groups[1].columns)
    return [PoseSet(table, columns, f"{' '.join(columns)} {table.stem}", groups)]


def _by_order(table: RawTable, numeric: Sequence[str], wanted: int) -> list[PoseSet]:
    """Sets of equally many columns, after a column that numbers the rows where there is one.

    None where all columns together are one matrix.
    """
    if wanted > 1 and len(numeric) == _WIDTHS[-2] and any(pose_layouts(table, numeric)):
        return []
    for start in (0, 1):
        width, remainder = divmod(len(numeric) - start, wanted)
        is_counted = not start or counts_rows(table.columns[numeric[0]])
        if remainder or width not in _WIDTHS or not is_counted:
            continue
        column_groups = []
        for k in range(wanted):
            column_groups.append(tuple(numeric[start + k * width : start + (k + 1) * width]))
        pose_sets = [PoseSet(table, part, f"{part[0]} {table.stem}") for part in column_groups]
        if all(any(pose_layouts(pose_set.table, pose_set.columns)) for pose_set in pose_sets):
            return pose_sets
    return []


def counts_rows(cells: np.ndarray) -> bool:
    """Whether cells are whole numbers that grow from row to row."""
    return bool((cells == np.round(cells)).all() and (np.diff(cells) > 0).all())


def pose_layouts(table: RawTable, columns: Sequence[str]) -> Iterator[tuple[Group, Group]]:
    """Groups of position and rotation that the columns of one set may be."""
    cells = np.stack([table.columns[name] for name in columns], axis=1)
    if not np.isfinite(cells).all():
        return
    for position, rotation in _orders(cells):
        yield tuple(Group(tuple(columns[k] for k in places)) for places in (position, rotation))


def _orders(cells: np.ndarray) -> Iterator[tuple[Sequence[int], Sequence[int]]]:
    width = cells.shape[1]
    if width == 6:
        yield (0, 1, 2), (3, 4, 5)
        yield (3, 4, 5), (0, 1, 2)
    if width == 7:
        for position, rotation in (((0, 1, 2), (3, 4, 5, 6)), ((4, 5, 6), (0, 1, 2, 3))):
            lengths = np.linalg.norm(cells[:, rotation], axis=1)
            if np.abs(lengths - 1).max() < _UNIT_LENGTH:
                yield position, rotation
    if width == 16 and (cells[:, [3, 7, 11, 15]] == [0, 0, 0, 1]).all():
        if _is_rotation(cells[:, _BY_COLUMNS[1]].reshape(-1, 3, 3)):
            yield _BY_COLUMNS
    elif width in (12, 16):
        for position, rotation in (_OF_MATRIX, _AFTER_MATRIX, ((0, 1, 2), _ROTATION_FIRST)):
            matrices = cells[:, rotation].reshape(-1, 3, 3)
            if _is_rotation(matrices):
                yield position, rotation


def _is_rotation(matrices: np.ndarray) -> bool:
    product = matrices @ matrices.transpose(0, 2, 1)
    return bool(np.abs(product - np.eye(3)).max() < _ORTHOGONAL)


def join_sets(pose_sets: Sequence[PoseSet]) -> tuple[RawTable, list[PoseSet]]:
    """Both sets in one table; columns whose names clash get the name of their file in front."""
    first = pose_sets[0].table
    second = pose_sets[1].table
    if first is second:
        return first, list(pose_sets)
    columns, units, conventions, renamed = {}, {}, {}, []
    clash = set(first.columns) & set(second.columns)
    for pose_set, other in ((pose_sets[0], second), (pose_sets[1], first)):
        if pose_set.table.stem != other.stem:
            stem = pose_set.table.stem
        else:
            stem = pose_set.table.file
        names = {
            name: f"{stem}: {name}" if name in clash else name for name in pose_set.table.columns
        }
        columns |= {names[name]: cells for name, cells in pose_set.table.columns.items()}
        units |= {names[name]: unit for name, unit in pose_set.table.units.items()}
        conventions |= {names[name]: word for name, word in pose_set.table.conventions.items()}
        stated = None
        if pose_set.stated is not None:
            stated = tuple(
                replace(group, columns=tuple(names[name] for name in group.columns))
                for group in pose_set.stated
            )
        taken = tuple(names[name] for name in pose_set.columns)
        renamed.append(replace(pose_set, columns=taken, stated=stated))
    file = f"{first.file} and {second.file}"
    table = replace(first, file=file, columns=columns, units=units, conventions=conventions)
    return table, [replace(pose_set, table=table) for pose_set in renamed]


def _best_layouts(table: RawTable, pose_sets: Sequence[PoseSet]):
    """Position and rotation of both sets under which flange and target rotate by the same angles."""
    options = [
        [pose_set.stated]
        if pose_set.stated is not None
        else list(pose_layouts(table, pose_set.columns))
        for pose_set in pose_sets
    ]
    pairs = [(flange, target) for flange in options[0] for target in options[1]]
    if len(pairs) < 2:
        return pairs[0] if pairs else None
    return min(pairs, key=lambda pair: angle_misfit(table, pair[0][1], pair[1][1]))
