"""Sets of columns that belong together: joint readings, points, rotations; found from the headers of a table."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.importers.mapping.columns.column_units import ColumnUnits, joined_units
from datasets.importers.mapping.columns.headers import (
    ACTUAL_WORDS,
    DEVIATION_WORDS,
    FLANGE_WORDS,
    MEASURED_WORDS,
    Header,
    read_header,
)
from datasets.importers.mapping.columns.spherical import find_triple
from datasets.importers.mapping.columns.stems import columns_by_stem
from datasets.importers.source import RawTable

_PARTIAL = ("angles", "vector", "point", "axis", "joints")
"""Kinds of sets that three or four columns of a quaternion may look like by their headers."""
_MATRIX_NAMES = tuple(f"{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
_MATRIX_FROM_0 = tuple(f"{row}{column}" for row in (0, 1, 2) for column in (0, 1, 2))
_TRANSFORMS = ((_MATRIX_NAMES, ("14", "24", "34")), (_MATRIX_FROM_0, ("03", "13", "23")))
"""Names of the rotation and of the last column of homogeneous transforms."""
_FEWEST_WITH_GAP = 4  # axes of an arm of which one number is left out
_NOA = ("nx", "ox", "ax", "ny", "oy", "ay", "nz", "oz", "az")
_NUMBERED_AXIS = re.compile(r"([a-z]{0,8}?)([xyz])([a-z]{0,2}\d{1,2})")
SLURBT = ("s", "l", "u", "r", "b", "t")
WORD_SETS = {
    "rpy": ("roll", "pitch", "yaw"),
    "rpy german": ("rollen", "nicken", "gieren"),
    "greek": ("alpha", "beta", "gamma"),
    "phi": ("phi", "theta", "psi"),
    "omega": ("omega", "phi", "kappa"),
    "abc": ("a", "b", "c"),
    "wpr": ("w", "p", "r"),
    "oat": ("o", "a", "t"),
}
AXES_OF_SET = {
    "turn": "XYZ",
    "rpy": "XYZ",
    "rpy german": "XYZ",
    "abc": "ZYX",
    "wpr": "XYZ",
    "omega": "XYZ",
}
"""Set of three angles -> the axis that each angle most likely belongs to."""


@dataclass(frozen=True)
class ColumnSet:
    """Columns of one quantity in their order: `kind` joints, point, angles, quaternion, vector, matrix or axis."""

    kind: str
    names: tuple[str, ...]
    words: frozenset[str]
    unit: ColumnUnits
    labels: str
    is_nominal: bool = False

    @property
    def is_flange(self) -> bool:
        """Whether words say that it belongs to the robot's flange or tool."""
        return bool(self.words & FLANGE_WORDS)

    @property
    def is_measured(self) -> bool:
        """Whether words say that an instrument measured it."""
        return bool(self.words & MEASURED_WORDS)

    @property
    def is_actual(self) -> bool:
        """Whether words say that it is the actual value and not the commanded one."""
        return bool(self.words & ACTUAL_WORDS)


def headers_of(table: RawTable) -> dict[str, Header]:
    """The parts of every header of a table."""
    return {name: read_header(name, table.units.get(name)) for name in table.columns}


def find_sets(table: RawTable) -> list[ColumnSet]:
    """All complete sets of a table, in the order in which their first columns stand."""
    headers = [h for h in headers_of(table).values() if not h.is_deviation]
    by_words: dict[tuple[str, ...], list[Header]] = {}
    for header in headers:
        by_words.setdefault(_object_of(header), []).append(header)
    # "axis A" to "axis F" are a longer series than the three angles A, B and C
    longer = {h.words[:-1] for h in headers if not h.kind and h.words[1:] and h.words[-1] == "d"}
    found: list[ColumnSet] = []
    for words, same in by_words.items():
        made = _sets_of(same, table)
        found += [
            column_set for column_set in made if column_set.labels != "abc" or words not in longer
        ]
    if not any(column_set.kind == "point" and not column_set.is_flange for column_set in found):
        found += _spherical(table) or _numbered_points(headers)
    found = _with_quaternions_by_length(found, table)
    order = {name: k for k, name in enumerate(table.columns)}
    return sorted(found, key=lambda column_set: order[column_set.names[0]])


def _with_quaternions_by_length(found: list[ColumnSet], table: RawTable) -> list[ColumnSet]:
    """The sets, with quaternions whose headers do not name their components, as in rot_a, rot_b, rot_c, rot_d.

    Four columns whose headers differ in one letter or number are a quaternion where they have length 1 in every row.
    Three of them are no set by themselves.
    """
    headers = headers_of(table)
    by_stem = columns_by_stem(n for n, cells in table.columns.items() if cells.dtype.kind == "f")
    for names in by_stem.values():
        own_headers = {name: headers[name] for name in names}
        words = [{*header.words, header.core} for header in own_headers.values()]
        common = frozenset(set.intersection(*words))
        taken = [column_set for column_set in found if set(column_set.names) & set(names)]
        is_free = all(
            column_set.kind in _PARTIAL and set(column_set.names) <= set(names)
            for column_set in taken
        )
        is_change = len(names) == 4 and is_free and not common & DEVIATION_WORDS
        if is_change and _has_length_1(own_headers, table) and _varies(names, table):
            found = [column_set for column_set in found if column_set not in taken]
            found.append(
                replace(_set("quaternion", list(own_headers.values()), "numbered"), words=common)
            )
    return found


def _spherical(table: RawTable) -> list[ColumnSet]:
    """A point as range, azimuth and vertical angle; `labels` is its convention."""
    triple = find_triple(headers_of(table))
    if triple is None:
        return []
    headers, convention = triple
    names = tuple(header.name for header in headers)
    words = frozenset(word for header in headers for word in header.words) & MEASURED_WORDS
    return [ColumnSet("point", names, words, headers[0].unit, convention)]


def _numbered_points(headers: Sequence[Header]) -> list[ColumnSet]:
    """Points whose number stands behind the axis, as in x1, y1, z1, x2, y2, z2, or xa1, ya1, za1."""
    by_number: dict[tuple[str, str], dict[str, Header]] = {}
    for header in headers:
        match = None if header.kind else _NUMBERED_AXIS.fullmatch(header.core)
        if match:
            by_number.setdefault((match[1], match[3]), {}).setdefault(match[2], header)
    complete = [axes for axes in by_number.values() if len(axes) == len("xyz")]
    return [
        replace(_set("point", [axes[c] for c in "xyz"]), words=frozenset()) for axes in complete
    ]


def _object_of(header: Header) -> tuple[str, ...]:
    """Common words of the columns of one object: those in front, and the name of a numbered array."""
    return (*header.words, header.core[:-1]) if header.kind == "numbered" else header.words


def _sets_of(headers: Sequence[Header], table: RawTable) -> list[ColumnSet]:
    """Sets among headers with the same words in front."""
    kinds: dict[str, dict[str, Header]] = {}
    for header in headers:
        kinds.setdefault(header.kind, {}).setdefault(header.label, header)
    kinds["xyz"] = _axes_of_one_name(headers) or kinds.get("xyz", {})
    _give_scalar_part(kinds, table)
    words = kinds.get("word", {}) | {core: h for h in headers if (core := h.core) in SLURBT}
    column_sets = [*_numbered(kinds, table), *_points(kinds), *_rotations(kinds)]
    for name, wanted in WORD_SETS.items():
        is_taken = _is_slurbt(words) and set(wanted) & set(SLURBT)
        if all(word in words for word in wanted) and not is_taken:
            column_sets.append(_set("angles", [words[word] for word in wanted], name))
    if _is_slurbt(words):
        column_sets.append(_set("joints", [words[word] for word in SLURBT], "slurbt"))
    return column_sets


def _axes_of_one_name(headers: Sequence[Header]) -> dict[str, Header]:
    """The first x, y and z with one name: PX, PY and PZ next to the column X_Value of LabVIEW, which is a time."""
    by_stem: dict[str, dict[str, Header]] = {}
    for header in headers:
        if header.kind == "xyz":
            by_stem.setdefault(header.core[:-1], {}).setdefault(header.label, header)
    return next((axes for axes in by_stem.values() if len(axes) == len("xyz")), {})


def _give_scalar_part(kinds: dict[str, dict[str, Header]], table: RawTable) -> None:
    """Count q0 next to qx, qy and qz as the scalar part of the quaternion, not as the reading of a joint."""
    components, numbered = kinds.get("turn", {}), kinds.get("qindex", {})
    scalar = numbered.get("0")
    if scalar is None or "w" in components or not all(axis in components for axis in "xyz"):
        return
    if _has_length_1({"0": scalar, **{axis: components[axis] for axis in "xyz"}}, table):
        components["w"] = numbered.pop("0")


def _is_slurbt(words: Mapping) -> bool:
    return all(word in words for word in SLURBT)


def _set(kind: str, headers: list[Header], labels: str = "") -> ColumnSet:
    return ColumnSet(
        kind,
        tuple(header.name for header in headers),
        frozenset(headers[0].words),
        joined_units([header.unit for header in headers]),
        labels,
        any(header.is_nominal for header in headers),
    )


def _points(kinds: Mapping[str, Mapping[str, Header]]) -> list[ColumnSet]:
    xyz = kinds.get("xyz", {})
    if all(axis in xyz for axis in "xyz"):
        return [_set("point", [xyz[axis] for axis in "xyz"])]
    matrix = kinds.get("matrix", {})
    for rotation, last_column in _TRANSFORMS:
        if rotation != _matrix_names(matrix):
            continue
        if all(name in matrix for name in (*rotation, *last_column)):
            return [_set("point", [matrix[name] for name in last_column])]
    return []


def _matrix_names(matrix: Mapping[str, Header]) -> tuple[str, ...]:
    """Names of the elements of a rotation, counted from 0 if an element (0, 0) is there, and otherwise from 1."""
    return _MATRIX_FROM_0 if "00" in matrix else _MATRIX_NAMES


def _rotations(kinds: Mapping[str, Mapping[str, Header]]) -> list[ColumnSet]:
    """Quaternions, angles about axes, rotation vectors, matrices and axes of one object."""
    column_sets = []
    components = kinds.get("turn", {})
    if all(axis in components for axis in "wxyz"):
        column_sets.append(_set("quaternion", [components[axis] for axis in "wxyz"], "wxyz"))
    elif all(axis in components for axis in "xyz"):
        column_sets.append(_set("angles", [components[axis] for axis in "xyz"], "turn"))
    quaternion_parts = kinds.get("qpart", {})
    if all(name in quaternion_parts for name in "rijk"):
        column_sets.append(_set("quaternion", [quaternion_parts[name] for name in "rijk"], "wxyz"))
    vector = kinds.get("rotvec", {})
    for labels in ("xyz", "123"):
        if all(axis in vector for axis in labels):
            column_sets.append(_set("vector", [vector[axis] for axis in labels], labels))
    euler = kinds.get("euler", {})
    if all(number in euler for number in "0123"):
        column_sets.append(_set("quaternion", [euler[number] for number in "0123"], "numbered"))
    elif all(number in euler for number in "123") and "4" not in euler:
        # E1 to E6 are the external axes of KUKA
        column_sets.append(_set("angles", [euler[number] for number in "123"], "euler"))
    matrix = kinds.get("matrix", {})
    names = _matrix_names(matrix)
    if all(name in matrix for name in names):
        column_sets.append(_set("matrix", [matrix[name] for name in names]))
    axis = kinds.get("axis", {})
    if all(name in axis for name in _NOA):
        column_sets.append(_set("matrix", [axis[name] for name in _NOA], "noa"))
    else:
        for letter in "no":
            if all(letter + c in axis for c in "xyz"):
                column_sets.append(_set("axis", [axis[letter + c] for c in "xyz"], letter))
    return column_sets


def _numbered(kinds: Mapping[str, Mapping[str, Header]], table: RawTable) -> list[ColumnSet]:
    """Joint readings, quaternions q0 ... q3 and poses pose_0 ... pose_5."""
    column_sets = []
    joints = dict(kinds.get("joint", {}))
    quaternion = kinds.get("qindex", {})
    if len(quaternion) == 4 and _has_length_1(quaternion, table):
        ordered = [quaternion[number] for number in sorted(quaternion)]
        column_sets.append(_set("quaternion", ordered, "numbered"))
    else:
        joints = dict(quaternion) | joints
    numbers = sorted(int(number) for number in joints)
    if _is_series(numbers):
        by_number = {int(label): header for label, header in joints.items()}
        ordered = [by_number[number] for number in numbers]
        is_point = len(numbers) == 3 and ordered[0].core.startswith("pos")
        column_sets.append(_set("point" if is_point else "joints", ordered))
    triple = kinds.get("numbered", {})
    if sorted(triple) in (["0", "1", "2"], ["1", "2", "3"]):
        column_sets.append(_set("point", [triple[number] for number in sorted(triple)]))
    return column_sets + _poses(kinds.get("posecomponent", {}), table)


def _is_series(numbers: Sequence[int]) -> bool:
    """Whether numbers of axes count from 0 or 1, with one left out at most: A1 A2 A3 A4 A6 of a palletiser."""
    count = len(numbers)
    if count < 2 or numbers[0] not in (0, 1):
        return False
    left_out = numbers[-1] - numbers[0] + 1 - count
    return left_out == 0 or (left_out == 1 and count >= _FEWEST_WITH_GAP)


def _has_length_1(columns: Mapping[str, Header], table: RawTable) -> bool:
    cells = [table.columns[header.name] for header in columns.values()]
    if any(cell.dtype.kind != "f" for cell in cells):
        return False
    lengths = np.sqrt(np.sum(np.square(cells), axis=0))
    if not np.isfinite(lengths).any():
        return False
    return bool(np.nanmax(np.abs(lengths - 1)) < 0.02)


def _varies(names: Iterable[str], table: RawTable) -> bool:
    """Whether columns change: four constants of length 1 are no measured rotation."""
    return any(np.nanmax(table.columns[n]) > np.nanmin(table.columns[n]) for n in names)


def _poses(components: Mapping[str, Header], table: RawTable) -> list[ColumnSet]:
    """A point and a rotation of poses with six or seven numbered components (RTDE, arrays of MATLAB)."""
    numbers = sorted(int(number) for number in components)
    if len(numbers) not in (6, 7) or numbers != list(range(numbers[0], numbers[0] + len(numbers))):
        return []
    ordered = [components[str(number)] for number in numbers]
    point = _set("point", ordered[:3])
    if len(ordered) == 7:
        return [point, _set("quaternion", ordered[3:], "numbered")]
    is_rtde = "tcp" in point.words and numbers[0] == 0
    if not is_rtde and len(ordered) == 6 and _is_angle_first(ordered, table):
        ordered = [*ordered[3:], *ordered[:3]]
        point = _set("point", ordered[:3])
    if not is_rtde:
        return [point, _set("angles", ordered[3:], "pose")]
    # Universal Robots: actual_TCP_pose is in m and a rotation vector in rad
    rotation = _set("vector", ordered[3:], "rtde")
    return [
        ColumnSet("point", point.names, point.words, "m", "rtde", point.is_nominal),
        ColumnSet("vector", rotation.names, rotation.words, "rad", "rtde", rotation.is_nominal),
    ]


def _is_angle_first(headers: list[Header], table: RawTable) -> bool:
    """Whether only the last three of six components exceed 360 deg, so that they are the point."""
    cells = np.stack([np.abs(table.numbers(header.name)) for header in headers])
    return bool(np.nanmax(cells[:3]) <= 360 < np.nanmax(cells[3:]))
