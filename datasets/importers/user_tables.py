"""Tables of targets and points of a user, in the columns and units of the recording format.

Whatever `workbench import` reads is read here too, by the same readers: any separator, decimal comma, other headers and
units, Excel, robot programs. Nothing is measured that a unit or a rotation convention could be tested on; so what
neither header nor format states is asked for, with the line of a mapping file that states it.
"""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from datasets.errors import InputError, complaint
from datasets.files import read_text
from datasets.formats.table import Table, UserColumns, is_number, read_table
from datasets.importers.mapping import conversion
from datasets.importers.mapping.candidates import (
    ANGLE_UNITS,
    LENGTH_UNITS,
    length_units,
    rotation_candidates,
)
from datasets.importers.mapping.columns.column_units import (
    OPEN,
    ColumnUnits,
    each_unit,
    joined_units,
    unit_toml,
)
from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.model import QUANTITIES, Group, Mapping
from datasets.importers.mapping.proposal import propose
from datasets.importers.source import RawTable
from datasets.importers.sources.choice import read_sources
from datasets.importers.sources.programs.program_frames import NOTHING_STATED, StatedFrames
from datasets.importers.sources.programs.robot_programs import NAME_OF_POSITION, read_robot_program
from datasets.importers.units import ANGLES, DMS, LENGTHS, degrees_of
from datasets.samples.columns import KNOWN, POINT, joint_columns

_PARQUET = (".parquet", ".pq")
_DECIMAL_COMMA = re.compile(r"\"[+-]?\d+,\d+\"")
_REPEATED = re.compile(r"(.+) \(\d+\)")
_HEAD_CHARACTERS = 100_000
_MOSTLY = 0.5
_WITHOUT_HEADER = re.compile(r"column \d+")
_POINT_WIDTHS = (3, 6)  # of a point, and of a pose with three angles
_QUATERNION_WIDTH, _QUATERNION_ROUNDING = 7, 0.02  # of a pose with a quaternion; two digits of it
_TOOL_WORDS = frozenset("tcp tool ee eef effector gripper werkzeug".split())


def read_targets(
    path: Path, sliding: Sequence[bool], mapping: Mapping | None = None
) -> list[Table]:
    """Joint readings (q1_deg ...) and poses (x_mm ... qz) of a table of targets, and its other columns.

    sliding (R,): which joint readings are lengths. mapping: of `--map`, None for none; its columns of joints and of
    the flange are used as far as the table has them. Two tables for a robot program with joint positions and poses.
    Raises InputError with file, row and column.
    """
    if mapping is None and _is_native(path, POINT):  # other tables name a quaternion qw ... qz, too
        return [read_table(path, path.name, ("note", *_text_columns(path)))]
    return [_converted(raw, sliding, mapping) for raw in _tables(path, frames_of(mapping))]


def _converted(raw: RawTable, sliding: Sequence[bool], mapping: Mapping | None) -> Table:
    """A table of targets in the columns and units of the recording format."""
    _check_cells(raw)
    raw, found = _in_degrees(raw, _mapping(raw, mapping))
    columns: dict[str, np.ndarray] = {}
    joints = () if found.joints is None else _joint_sizes(raw, found, sliding)
    if found.joints is not None:
        columns |= _joints(raw, found, sliding)
    if found.flange_point is not None:
        if mapping is None or mapping.flange_point is None:
            _check_body(raw, found.flange_point.columns)
        columns |= _positions(raw, found)
    if found.flange_rotation is not None:
        columns |= _rotations(raw, found)
    is_program = NAME_OF_POSITION in raw.columns
    origin = None if is_program else UserColumns(*_with_units(raw, joints))
    return replace(_table(raw, columns, found), origin=origin)


def _in_degrees(raw: RawTable, found: Mapping) -> tuple[RawTable, Mapping]:
    """A table whose joint readings have minutes and seconds in their digits, in decimal degrees.

    Their headers then state the unit, since a corrected table has it too.
    """
    group = found.joints
    units = () if group is None else each_unit(group.unit, len(group.columns))
    if DMS not in units:
        return raw, found
    named = [name for name, unit in zip(group.columns, units) if unit == DMS]
    columns = {name: degrees_of(raw.numbers(name), DMS) for name in named}
    stated = joined_units(["deg" if unit == DMS else unit or None for unit in units])
    raw = replace(
        raw, columns={**raw.columns, **columns}, units={**raw.units, **dict.fromkeys(named, "deg")}
    )
    return raw, found.updated("joints", unit=stated)


def _joint_sizes(raw: RawTable, found: Mapping, sliding: Sequence[bool]):
    """Column and size of its unit, deg or mm, of each joint reading."""
    group = found.joints
    units = _joint_units(raw, group, sliding)
    if group.counts_per_deg is not None:
        return tuple((name, 1 / count) for name, count in zip(group.columns, group.counts_per_deg))
    return tuple((name, {**LENGTHS, **ANGLES}[unit]) for name, unit in zip(group.columns, units))


def _with_units(
    raw: RawTable, joints
) -> tuple[dict[str, np.ndarray], tuple[tuple[str, float], ...]]:
    """All columns and those of the joint readings, with the units of a row of units in their headers."""
    names = {}
    for name in raw.columns:
        unit = raw.units.get(name)
        is_in_header = unit is None or read_header(name).unit is not None
        names[name] = name if is_in_header else f"{name} [{unit}]"
    columns = {names[name]: cells for name, cells in raw.columns.items()}
    return columns, tuple((names[name], size) for name, size in joints)


def read_named_points(path: Path, labels: Sequence[str], unit: str | None = None) -> Table:
    """Points (x_mm, y_mm, z_mm) and the first column that is one of `labels` or a name, as `labels[0]`.

    unit: of coordinates whose unit neither header nor format states. Raises InputError with file, row and column.
    """
    if _is_native(path, POINT):
        return read_table(path, path.name, (*labels, "note"))
    raw = _one_table(path)
    _check_cells(raw)
    found = _mapping(raw, None)
    if found.flange_point is None:
        found = replace(found, flange_point=_point_without_header(raw))
    columns = {}
    if found.flange_point is not None:
        group = found.flange_point
        found = replace(found, flange_point=replace(group, unit=group.unit or unit))
        columns = _positions(raw, found, takes_map=False)
    names = [name for name, cells in raw.columns.items() if cells.dtype.kind != "f"]
    name_column = next((name for name in raw.columns if name.lower() in labels), None) or next(
        iter(names), None
    )
    if name_column is not None:
        columns[labels[0]] = raw.columns[name_column].astype(str)
    return _table(raw, columns, found)


def _point_without_header(raw: RawTable) -> Group | None:
    """The position in a table without headers: its three columns of numbers, or those of a pose."""
    names = [name for name, cells in raw.columns.items() if cells.dtype.kind == "f"]
    if not names or not all(_WITHOUT_HEADER.fullmatch(name) for name in raw.columns):
        return None
    first = raw.columns[names[0]]
    if len(names) == 3 or not ((first == np.round(first)).all() and (np.diff(first) == 1).all()):
        return _position_of(raw, names)
    of_quaternion = _position_of(raw, names) if len(names) == _QUATERNION_WIDTH else None
    return of_quaternion or _position_of(raw, names[1:])  # after the numbers of the rows


def _position_of(raw: RawTable, names: Sequence[str]) -> Group | None:
    """The position of columns of a point, or of a pose: before its angles, before or after its quaternion."""
    if len(names) in _POINT_WIDTHS:
        return Group(tuple(names[:3]))
    if len(names) != _QUATERNION_WIDTH:
        return None
    numbers = np.stack([raw.columns[name] for name in names])
    for position, quaternion in ((slice(0, 3), slice(3, 7)), (slice(4, 7), slice(0, 4))):
        lengths = np.linalg.norm(numbers[quaternion], axis=0)
        if np.allclose(lengths, 1.0, atol=_QUATERNION_ROUNDING):
            return Group(tuple(names[position]))
    return None


def _is_native(path: Path, others: Sequence[str]) -> bool:
    """Whether a file is a table of the recording format: comma-separated, with its names, numbers with a point.

    Times in a column of another name, or dates, are those of a clock that only `workbench import` reads.
    """
    if path.suffix.lower() in _PARQUET:
        return True
    if path.suffix.lower() != ".csv" or not path.is_file():
        return path.suffix.lower() == ".csv"
    head = read_text(path, path.name)[:_HEAD_CHARACTERS]
    first = next((line for line in head.splitlines() if line.strip()), "")
    try:
        names = [name.strip() for name in next(csv.reader([first]), [])]
    except csv.Error:
        return True
    is_ours = bool(joint_columns(names)) or bool(set(others) & set(names))
    has_other_clock = any(
        name != "time_s" and read_header(name).kind in ("time", "date") for name in names
    )
    return is_ours and not has_other_clock and not _DECIMAL_COMMA.search(head)


def _text_columns(path: Path) -> list[str]:
    """Columns of a table of the recording format with names in most cells, such as those of the targets.

    A quantity that the format knows is none of them: a cell of it that is no number is a mistake.
    """
    if path.suffix.lower() in _PARQUET or not path.is_file():
        return []
    rows = [row for row in csv.reader(read_text(path, path.name).splitlines()) if row]
    header = [name.strip() for name in rows[0]] if rows else []
    known = {*KNOWN, *joint_columns(header)}
    found = []
    for k, name in enumerate(header):
        cells = [row[k].strip() for row in rows[1:] if k < len(row)]
        numbers = sum(map(is_number, cells))
        if name not in known and numbers < _MOSTLY * len(cells):
            found.append(name)
    return found


def _one_table(path: Path) -> RawTable:
    tables = _tables(path)
    if len(tables) > 1:
        raise complaint(
            str(path),
            "positions of one kind",
            "joint positions and poses",
            "name a file with one table",
        )
    return tables[0]


def frames_of(mapping: Mapping | None) -> StatedFrames:
    """Tools and frames of the positions of a program, as stated in a mapping."""
    if mapping is None:
        return NOTHING_STATED
    stated = (mapping.tool, mapping.frame)
    return StatedFrames(
        *({} if placements is None else placements.matrices for placements in stated)
    )


def _tables(path: Path, stated: StatedFrames = NOTHING_STATED) -> list[RawTable]:
    """The table of a file, or the joint positions and the poses of a robot program. Raises InputError for others."""
    with TemporaryDirectory() as scratch:
        tables = read_sources([path], Path(scratch)).tables
    is_program = len(tables) == 2 and all(
        NAME_OF_POSITION in each_table.columns for each_table in tables
    )
    if len(tables) != 1 and not is_program:
        shown = [f"{table.file} with {', '.join(list(table.columns)[:4])}, ..." for table in tables]
        found = " and ".join(shown) or "none"
        raise complaint(str(path), "one table", found, "name a file with one table")
    if stated.tools or stated.frames:
        if not all(NAME_OF_POSITION in table.columns for table in tables):
            expected = "[tool] and [frame] of a mapping for a robot program"
            raise complaint(str(path), expected, "a table", "remove them from the mapping")
        tables = read_robot_program(path, stated)
    for table in tables:
        if table.frame_question:
            raise InputError(table.frame_question)
        if table.warnings:
            raise complaint(
                table.file,
                "a table that ends with its last row",
                table.warnings[0].rstrip("."),
                "correct or remove these rows",
            )
    return list(tables)


def _check_cells(raw: RawTable) -> None:
    """Raise InputError for a column that stands twice, or that is numbers but for some cells."""
    for name, cells in raw.columns.items():
        repeated = _REPEATED.fullmatch(name)
        if repeated and repeated[1] in raw.columns:
            raise complaint(
                f"{raw.file}, column {repeated[1]}", "every column once", "it twice", "rename one"
            )
        if cells.dtype.kind == "f":
            continue
        digits = [bool(re.match(r"[+-]?[.,]?\d", str(cell))) for cell in cells]
        if np.mean(digits) > _MOSTLY and not all(digits):
            raw.numbers(name)


def _mapping(raw: RawTable, stated: Mapping | None) -> Mapping:
    """The mapping of the headers, completed by what the user states for columns of this table."""
    proposed = propose(raw, has_images=True).mapping
    if stated is None:
        return proposed
    _check_stated(raw, stated)
    kept = {}
    for quantity in QUANTITIES:
        group = getattr(stated, quantity)
        is_here = group is not None and set(group.columns) <= set(raw.columns)
        kept[quantity] = group if is_here else None
    columns = {name: target for name, target in stated.columns.items() if name in raw.columns}
    return replace(stated, **kept, columns=columns).merged(proposed)


def _check_stated(raw: RawTable, stated: Mapping) -> None:
    """Raise InputError where a quantity of the mapping has some of its columns in the table, or none of them all has.

    The mapping of a measurement also names columns, such as those of the point, that a table of targets does not have.
    """
    groups = {quantity: getattr(stated, quantity) for quantity in QUANTITIES}
    groups = {quantity: group.columns for quantity, group in groups.items() if group is not None}
    present = {quantity: set(names) & set(raw.columns) for quantity, names in groups.items()}
    for quantity, names in groups.items():
        missing = [name for name in names if name not in raw.columns]
        if missing and (present[quantity] or not any(present.values())):
            shown = ", ".join(list(raw.columns)[:12])
            raise complaint(
                f"--map, key {quantity}.columns",
                f"columns of {raw.file}",
                f"{missing[0]}, which is not among them ({shown})",
                "correct the name in the mapping file",
            )


def _joints(raw: RawTable, found: Mapping, sliding: Sequence[bool]) -> dict[str, np.ndarray]:
    group = found.joints
    made = replace(group, unit=_joint_units(raw, group, sliding))
    return conversion.joint_columns(raw, made, sliding, "mm")


def _joint_units(raw: RawTable, group: Group, sliding: Sequence[bool]) -> tuple[str, ...]:
    """The unit of every joint reading: an angle of a joint that rotates, a length of one that slides.

    Raises InputError for a unit of the other kind, for joints whose unit nothing states, and for another number of
    columns than joints.
    """
    if len(group.columns) != len(sliding):
        raise complaint(
            raw.file,
            f"{len(sliding)} columns of joint readings, one for each joint of the robot",
            f"{len(group.columns)} ({', '.join(group.columns)})",
            "name the columns of all joints in their order under [joints] in a mapping file for --map",
        )
    words = list(each_unit(group.unit, len(group.columns)))
    for k, (name, slides) in enumerate(zip(group.columns, sliding)):
        if words[k] in (LENGTHS if slides else ANGLES):
            continue
        unit_of_column = read_header(name, raw.units.get(name)).unit
        if words[k] and (unit_of_column == words[k] or isinstance(group.unit, tuple)):
            raise complaint(
                f"{raw.file}, column {name}",
                f"a unit of {'length, since this joint slides' if slides else 'angle, since this joint rotates'}",
                words[k],
                "correct the unit, or name the columns in the order of the joints",
            )
        words[k] = (
            OPEN  # one unit that a mapping states for all joints is that of those that it can be
        )
    if OPEN in words:
        _ask_joint_units(raw, group, sliding, words)
    return tuple(words)


def _ask_joint_units(
    raw: RawTable, group: Group, sliding: Sequence[bool], words: Sequence[str]
) -> None:
    """Raise InputError: the question for the units of the joints that have none."""
    missing = [k for k, word in enumerate(words) if word == OPEN]
    kinds = {sliding[k]: LENGTH_UNITS if sliding[k] else ANGLE_UNITS for k in missing}
    usual = [
        word or (LENGTH_UNITS if slides else ANGLE_UNITS)[0] for word, slides in zip(words, sliding)
    ]
    question = _Question(
        tuple(group.columns[k] for k in missing),
        "; ".join(", ".join(kinds[slides]) for slides in sorted(kinds)),
        usual[missing[0]],
    )
    raise _unit_question(raw, question, "joints", group.columns, joined_units(usual))


def _check_body(raw: RawTable, names: Sequence[str]) -> None:
    """Raise InputError for positions of a tool: they are those of the flange only where the tool has no length."""
    named = [name for name in names if _TOOL_WORDS & set(read_header(name).words)]
    if named:
        columns = ", ".join(f'"{name}"' for name in names)
        raise complaint(
            f"{raw.file}, columns {', '.join(names)}",
            "positions of the flange",
            "those of a tool",
            "give joint readings or poses of the flange; where the tool has no length, rename the columns as in "
            f'"flange X [mm]", or add [flange_point] columns = [{columns}] to a mapping file and name it with --map',
        )


def _positions(raw: RawTable, found: Mapping, takes_map: bool = True) -> dict[str, np.ndarray]:
    """x_mm, y_mm, z_mm; takes_map: whether the command has the option --map."""
    units = length_units(found.flange_point)
    if len(units) != 1:
        group = found.flange_point
        question = _Question(group.columns, ", ".join(map(str, units)), str(LENGTH_UNITS[0]))
        quantity = "flange_point" if takes_map else ""
        raise _unit_question(raw, question, quantity, group.columns, units[0])
    return conversion.point_columns(raw, replace(found.flange_point, unit=units[0]))


def _rotations(raw: RawTable, found: Mapping) -> dict[str, np.ndarray]:
    group = found.flange_rotation
    candidates = rotation_candidates(group, raw)
    if len(candidates) != 1:
        titles = ", ".join(candidate.title for candidate in candidates[:4]) or "none"
        raise complaint(
            f"{raw.file}, columns {', '.join(group.columns)}",
            "rotations whose convention is stated",
            f"{len(candidates)} readings ({titles}{', ...' if len(candidates) > 4 else ''})",
            'add [flange_rotation] with columns, unit and convention = "intrinsic XYZ", or another, to a mapping file, '
            "and name it with --map",
        )
    return conversion.rotation_columns(raw, candidates[0].group)


@dataclass(frozen=True)
class _Question:
    """Columns whose unit nothing states, the units that they may have, in words, and the usual one of the first."""

    columns: tuple[str, ...]
    units: str
    usual: str


def _unit_question(
    raw: RawTable, question: _Question, quantity: str, columns: Sequence[str], units: ColumnUnits
):
    """The InputError that asks for a unit; quantity "" for a command without --map, else its line of a mapping."""
    names = ", ".join(f'"{name}"' for name in columns)
    remedy = (
        f", or add [{quantity}] columns = [{names}] and unit = {unit_toml(units)} to a mapping file, and name it with "
        "--map"
        if quantity
        else ""
    )
    return complaint(
        f"{raw.file}, columns {', '.join(question.columns)}",
        f"a unit, which targets cannot be tested for ({question.units})",
        "none in the headers",
        f'write it into a header, as in "{question.columns[0]} [{question.usual}]"{remedy or ", or add --unit"}',
    )


def _table(raw: RawTable, columns: dict[str, np.ndarray], found: Mapping) -> Table:
    """The converted columns, and all others of the table under their own names."""
    used = set()
    for quantity in QUANTITIES:
        group = getattr(found, quantity)
        used |= set() if group is None else set(group.columns)
    copied = {name: target for name, target in found.columns.items() if target not in columns}
    made = dict(columns)
    for name, target in copied.items():
        made |= conversion.other_columns(raw, replace(found, columns={name: target}))
    if "time_s" not in made:
        made |= conversion.other_columns(raw, replace(found, columns={}))
    origin = conversion.time_origin(raw, replace(found, columns=copied))
    for name, cells in raw.columns.items():
        if name not in used and name not in copied:
            made.setdefault(name, cells)
    return Table(raw.file, made, raw.lines, time_origin=origin)
