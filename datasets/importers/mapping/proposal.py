"""A mapping proposed from the headers of one table; what they leave open is None until the test on the robot."""

import re
from dataclasses import dataclass, replace

import numpy as np

from datasets.errors import complaint
from datasets.importers.mapping.columns.column_units import ColumnUnits, joined_units
from datasets.importers.mapping.columns.headers import Header, read_header
from datasets.importers.mapping.columns.reflectors import reflector_lines
from datasets.importers.mapping.columns.sets import ColumnSet, find_sets, headers_of
from datasets.importers.mapping.columns.spherical import is_spherical
from datasets.importers.mapping.left_out import unused_columns
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.source import RawTable
from datasets.importers.units import COVARIATE_UNITS

_TURNS = ("angles", "quaternion", "vector", "matrix")
_KINDS = {
    "joints": ("joints",),
    "point": ("point",),
    "flange_point": ("point",),
    "rotation": _TURNS,
    "flange_rotation": _TURNS,
    "axis": ("axis",),
}
_COPIED = (
    "pose",
    "repeat",
    "reflector",
    "ball",
    "temperature_c",
    "payload_kg",
    "length_mm",
    "pair",
)
_COVARIATE = re.compile(
    r"approach\d+|qdot\d+_(deg|mm)_s|current\d+_a|torque\d+_nm|temperature(_\w+)?_c|range_mm|[uv]_px|incidence_deg"
)
"""Covariates by the names that the recording format gives them."""
_SENSOR_WORDS = frozenset("sensor scanner camera kamera ball kugel sphere".split())
_MOST_REFLECTORS = 8  # that can each have been measured once only


@dataclass(frozen=True)
class Proposal:
    """`mapping` from the headers; `unused` columns that it leaves out."""

    mapping: Mapping
    unused: tuple[str, ...]


def propose(
    table: RawTable,
    has_images: bool = False,
    has_clouds: bool = False,
    stated: Mapping | None = None,
) -> Proposal:
    """The mapping that the headers of a table suggest.

    has_images, has_clouds: the source also holds images of a board, or clouds of a ball, which then are what was
    measured. stated: the user's mapping; its columns decide between several sets. Raises InputError where two sets of
    columns may be the same quantity.
    """
    stated = stated or Mapping()
    column_sets = [_usable(column_set, table) for column_set in find_sets(table)]
    column_sets = [
        column_set
        for column_set in column_sets
        if column_set is not None and not _is_taken(column_set, stated)
    ]
    joints = _joints_of(column_sets, table, stated)
    points = [column_set for column_set in column_sets if column_set.kind == "point"]
    point, flange_point = _points_of(points, joints, has_images or has_clouds, table, stated)
    others = [column_set.words for column_set in points if column_set not in (point, flange_point)]
    used = [column_set.words for column_set in (point, flange_point) if column_set is not None]
    rotations = [
        column_set
        for column_set in column_sets
        if column_set.kind in _TURNS
        and (column_set.words in used or column_set.words not in others)
    ]
    rotation, flange_rotation = _rotations_of((point, flange_point), rotations, table, stated)
    axes = [column_set for column_set in column_sets if column_set.kind == "axis"]
    axis = None
    if rotation is None:
        axis = _stated_set(axes, stated.axis, table) or _best(axes, table, "axis")
    mapping = Mapping(
        joints=_group(joints, table, "angle"),
        point=_group(point, table, "length"),
        rotation=_group(rotation, table, "angle"),
        axis=None if axis is None else Group(axis.names, None, None),
        flange_point=_group(flange_point, table, "length"),
        flange_rotation=_group(flange_rotation, table, "angle"),
        columns=_copied(table, () if point is None else point.names),
    )
    mapping = replace(mapping, measures=_measures(mapping, point, has_images, has_clouds))
    return Proposal(mapping, unused_columns(table, mapping))


def _is_taken(column_set: ColumnSet, stated: Mapping) -> bool:
    """Whether a mapping states some of the columns of a set as a quantity of another kind: a, b, c as a point."""
    for quantity, kinds in _KINDS.items():
        group = getattr(stated, quantity)
        if (
            group is not None
            and column_set.kind not in kinds
            and set(column_set.names) & set(group.columns)
        ):
            return True
    return False


def _usable(column_set: ColumnSet, table: RawTable) -> ColumnSet | None:
    """The set; None for columns with text, and for rotations that are zero in every row (not measured)."""
    for name in column_set.names:
        if table.columns[name].dtype.kind != "f":
            return None
    if column_set.kind in ("angles", "vector"):
        cells = np.stack([table.columns[name] for name in column_set.names])
        if not np.nan_to_num(cells).any():
            return None
    return column_set


def _stated_set(
    column_sets: list[ColumnSet], group: Group | None, table: RawTable
) -> ColumnSet | None:
    """The set of the columns that a mapping states, also where headers show none; None for columns elsewhere."""
    if group is None or not set(group.columns) <= set(table.columns):
        return None
    same = [column_set for column_set in column_sets if column_set.names == group.columns]
    words = read_header(group.columns[0]).words
    return same[0] if same else ColumnSet("stated", group.columns, frozenset(words), None, "")


def _joints_of(column_sets: list[ColumnSet], table: RawTable, stated: Mapping) -> ColumnSet | None:
    """The joint readings: the stated columns, else the only set."""
    joints = [column_set for column_set in column_sets if column_set.kind == "joints"]
    return _stated_set(joints, stated.joints, table) or _best(joints, table, "joints")


def _points_of(points, joints, measured_elsewhere: bool, table: RawTable, stated: Mapping):
    """The measured point and the flange's point, as `_classified`, with the columns that a mapping states."""
    point = _stated_set(points, stated.point, table)
    flange = _stated_set(points, stated.flange_point, table)
    if point is None and flange is None:
        return _classified(points, joints, measured_elsewhere, table)
    taken = {
        name
        for column_set in (point, flange)
        if column_set is not None
        for name in column_set.names
    }
    free = [column_set for column_set in points if not taken & set(column_set.names)]
    of_flange = [
        column_set for column_set in free if column_set.is_flange and not column_set.is_measured
    ]
    if flange is None and joints is not None:
        flange = _best(of_flange, table, "flange_point")
    elif flange is None:
        flange = _best(of_flange or free, table, "flange_point")
    if point is None and not measured_elsewhere:
        point = _best(
            [column_set for column_set in free if column_set not in of_flange], table, "point"
        )
    return (None if measured_elsewhere else point), flange


def _best(column_sets: list[ColumnSet], table: RawTable, quantity: str) -> ColumnSet | None:
    """The only set; of several the actual values, not the commanded ones. Raises InputError for two alike."""
    if not column_sets:
        return None
    for rule in (lambda s: s.is_actual, lambda s: not s.is_nominal):
        chosen = [column_set for column_set in column_sets if rule(column_set)]
        if chosen and len(chosen) < len(column_sets):
            column_sets = chosen
    longest = max(len(column_set.names) for column_set in column_sets)
    column_sets = [column_set for column_set in column_sets if len(column_set.names) == longest]
    if len(column_sets) > 1:
        found = " and ".join(
            f"{column_set.names[0]} ... {column_set.names[-1]}" for column_set in column_sets
        )
        columns = ", ".join(f'"{name}"' for name in column_sets[0].names)
        remedy = (
            f"add [{quantity}] columns = [{columns}], or the others, to a mapping file for --map"
        )
        if quantity == "point":
            remedy += (
                "; if they are several reflectors in one row, keep all of them with one section for each, as in "
                f"{reflector_lines([column_set.names for column_set in column_sets])}"
            )
        raise complaint(
            table.file, f"one set of columns for the {quantity.replace('_', ' ')}", found, remedy
        )
    return column_sets[0]


def _classified(points, joints, measured_elsewhere: bool, table: RawTable):
    """The measured point and the flange's point, each None where it is not there."""
    flange = [
        column_set for column_set in points if column_set.is_flange and not column_set.is_measured
    ]
    others = [column_set for column_set in points if column_set not in flange]
    stated = [column_set for column_set in others if column_set.is_measured]
    plain = [column_set for column_set in others if not column_set.is_measured]
    if measured_elsewhere:
        return None, _best(flange or others, table, "flange_point")
    if stated and plain and not flange and joints is None:
        return _best(stated, table, "point"), _best(plain, table, "flange_point")
    measured = _best(stated or plain, table, "point")
    if measured is None and joints is not None and len(flange) == 2:
        return _best(flange, table, "point"), None
    return measured, _best(flange, table, "flange_point")


def _is_of(rotation_set: ColumnSet, points, table: RawTable) -> bool:
    """Whether a rotation belongs to the flange's point: by the same words in front, or by its place without words.

    points: the measured point and the flange's, None for one that is not there.
    """
    point, flange_point = points
    if rotation_set.is_flange and not rotation_set.is_measured:
        return True
    if flange_point is None or rotation_set.words == flange_point.words:
        return flange_point is not None
    if rotation_set.words:
        return False
    names = list(table.columns)
    start, end = names.index(rotation_set.names[0]), names.index(rotation_set.names[-1])
    follows = start == names.index(flange_point.names[-1]) + 1
    precedes = end == names.index(flange_point.names[0]) - 1
    is_measured = point is not None and start == names.index(point.names[-1]) + 1
    return follows or (precedes and not is_measured)


def _rotations_of(points, rotations: list[ColumnSet], table: RawTable, stated: Mapping):
    """The rotations of the measured point and of the flange's point `points`."""
    point, flange_point = points
    rotation = flange_rotation = None
    if stated.rotation is None:
        free = [column_set for column_set in rotations if not _is_of(column_set, points, table)]
        rotation = _rotation_of(point, free, table, "rotation")
    if stated.flange_rotation is None:
        named = () if stated.rotation is None else stated.rotation.columns
        free = [
            column_set
            for column_set in rotations
            if column_set is not rotation and not set(column_set.names) & set(named)
        ]
        flange_rotation = _rotation_of(flange_point, free, table, "flange_rotation")
    return rotation or _same_set(rotations, stated.rotation), (
        flange_rotation or _same_set(rotations, stated.flange_rotation)
    )


def _same_set(column_sets: list[ColumnSet], group: Group | None) -> ColumnSet | None:
    """The set with exactly the columns of a stated group; None without it."""
    same_sets = (
        column_set
        for column_set in column_sets
        if group is not None and column_set.names == group.columns
    )
    return next(same_sets, None)


def _rotation_of(
    point: ColumnSet | None, rotations: list[ColumnSet], table: RawTable, quantity: str
) -> ColumnSet | None:
    """The rotation that belongs to a point: the one with the same words, else the only one."""
    if point is None:
        return None
    same = [column_set for column_set in rotations if column_set.words == point.words]
    same = (
        same
        or [column_set for column_set in rotations if column_set.words & point.words]
        or rotations
    )
    if len(same) > 1:  # the same rotation in two forms: the one that is no convention is preferred
        for kind in ("matrix", "quaternion", "vector"):
            chosen = [
                column_set
                for column_set in same
                if column_set.kind == kind and not column_set.is_nominal
            ]
            if len(chosen) == 1:
                return chosen[0]
    return _best(same, table, quantity)


def _group(column_set: ColumnSet | None, table: RawTable, quantity: str) -> Group | None:
    """Columns of a set with what headers and format state about them."""
    if column_set is None:
        return None
    unit = _unit(column_set, table.default_units.get(quantity))
    if column_set.kind in ("joints", "point", "stated"):
        return Group(
            column_set.names, unit, column_set.labels if is_spherical(column_set.labels) else None
        )
    stated = table.conventions.get(column_set.names[0])
    if stated is not None:
        return Group(column_set.names, unit if column_set.kind == "angles" else None, stated)
    if column_set.kind == "vector":
        return Group(column_set.names, unit, "rotation vector")
    if column_set.kind == "matrix":
        return Group(column_set.names, None, None)
    if column_set.kind == "quaternion" and column_set.labels == "wxyz":
        return Group(column_set.names, None, "quaternion wxyz")
    return Group(column_set.names, unit if column_set.kind == "angles" else None, None)


def _unit(column_set: ColumnSet, default: str | None) -> ColumnUnits:
    """The unit of a set, columns without one with that of the file."""
    if column_set.unit is None or default is None or not isinstance(column_set.unit, tuple):
        return column_set.unit or default
    return joined_units([word or default for word in column_set.unit])


def _copied(table: RawTable, measured: tuple[str, ...]) -> dict[str, str]:
    """Columns that are taken over under the name of the recording format; not those of the measured point."""
    headers = headers_of(table)
    kept: dict[str, str] = {}
    for name, header in headers.items():
        if name in measured:
            continue
        if _COVARIATE.fullmatch(name) and _is_numeric(table.columns[name]):
            kept[name] = name
            continue
        if header.is_deviation:
            continue
        if header.kind in _COPIED and header.kind not in kept.values():
            if _fits(table, name, header):
                kept[name] = header.kind
    if measured or "pair" in kept.values():
        return kept
    return kept | _pairs(table, kept)


def _pairs(table: RawTable, kept: dict[str, str]) -> dict[str, str]:
    """The column that numbers or names the two rows of each length, whatever its header: {name: "pair"}, or {}.

    Every value stands in two rows, and these have one length.
    """
    lengths = [name for name, target in kept.items() if target == "length_mm"]
    if len(lengths) != 1:
        return {}
    found = []
    for name, cells in table.columns.items():
        _, label, count = np.unique(cells, return_inverse=True, return_counts=True)
        if name in kept or len(count) < 2 or not (count == 2).all():
            continue
        ordered = table.columns[lengths[0]][np.argsort(label, kind="stable")].reshape(-1, 2)
        if (ordered[:, 0] == ordered[:, 1]).all():
            found.append(name)
    return {found[0]: "pair"} if len(found) == 1 else {}


def _fits(table: RawTable, name: str, header: Header) -> bool:
    """Whether the cells can be what the header says: groups may have names, all else is numbers without gaps.

    A column whose stated unit is none of its quantity holds something else.
    """
    cells = table.columns[name]
    if header.unit is not None and header.unit not in COVARIATE_UNITS.get(header.kind, ("1",)):
        return False
    if header.kind == "reflector" and len(set(cells.tolist())) == len(cells) > _MOST_REFLECTORS:
        return False  # names of the measured points, as in "Target" with SMR_101, SMR_102, ...
    if header.kind in ("pose", "repeat", "reflector", "pair") and cells.dtype.kind != "f":
        return all(map(bool, cells))
    return _is_numeric(cells)


def _is_numeric(cells: np.ndarray) -> bool:
    """Whether all cells are finite numbers."""
    return cells.dtype.kind == "f" and bool(np.isfinite(cells).all())


def _measures(
    mapping: Mapping, point: ColumnSet | None, has_images: bool, has_clouds: bool
) -> str | None:
    """The kind of recording that the quantities make; None where they make none."""
    if has_images:
        return "board-images"
    if has_clouds:
        return "ball-surface"
    if point is None:
        return "distance" if {"length_mm", "pair"} <= set(mapping.columns.values()) else None
    return measures_of(mapping, bool(point.words & _SENSOR_WORDS))


def measures_of(mapping: Mapping, by_sensor: bool = False) -> str:
    """The kind of recording of a mapped point; by_sensor: headers say that a sensor on the arm measured it."""
    if mapping.rotation is not None:
        return "external-pose"
    if mapping.axis is not None:
        return "partial-pose"
    if by_sensor or "ball" in mapping.columns.values():
        return "ball-centre"
    return "external-point"
