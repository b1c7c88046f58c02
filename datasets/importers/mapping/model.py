"""The mapping of an import: which columns are which quantity, in which unit and convention; read and written as TOML.

format = "import/1"
measures = "external-pose"
robot = "ur10"
[join]
by = "index"
[joints]
columns = ["A1", "A2", "A3", "A4", "A5", "A6"]
unit = "deg"                                   # or one for each column: ["deg", "deg", "rad", ...]
[point]
columns = ["X", "Y", "Z"]
unit = "mm"
[rotation]
columns = ["Rx", "Ry", "Rz"]
unit = "deg"
convention = "intrinsic XYZ"
[flange_point]
...
[flange_rotation]
...
[columns]
"Temp" = "temperature_c"
"""

from collections.abc import Collection
from collections.abc import Mapping as Keys
from dataclasses import dataclass, field, fields, replace
from math import isfinite
from pathlib import Path

from datasets.errors import complaint
from datasets.importers.mapping.columns import spherical
from datasets.importers.mapping.columns.column_units import OPEN, ColumnUnits
from datasets.importers.mapping.placements import Controller, Placements, placements_from_keys
from datasets.importers.mapping.rotations import CONVENTIONS, SIZES
from datasets.importers.units import ANGLE_NAMES, LENGTHS
from datasets.samples.columns import KINDS
from workbench.core.robot_files.robot_description import file_and_tip
from workbench.core.text.sections import checked_section
from workbench.core.text.structured_text import ContentError, read_toml

FORMAT = "import/1"
QUANTITIES = ("joints", "point", "rotation", "axis", "flange_point", "flange_rotation", "time")
PLACEMENTS = ("tool", "frame")
OF_PROGRAMS = (*PLACEMENTS, "controller")
"""Sections on robot programs, which tables of measurements do not have."""
JOINS = ("index", "key", "time", "append")


@dataclass(frozen=True)
class Group:
    """Columns of one quantity. `unit`, `convention`: None where neither header, format nor user states them.

    `unit`: of all columns, or one for each of them ("" where it is open). `counts_per_deg`: of joint readings, counts
    of the encoders in one degree (of a prismatic joint, one mm) for each column; the unit is then "deg".
    """

    columns: tuple[str, ...]
    unit: ColumnUnits = None
    convention: str | None = None
    inverse: bool = False
    counts_per_deg: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Join:
    """Join of two tables: by row number, by a column that both have, by time, or with their rows appended.

    `time_offset_s` is added to the times of the shorter table; None where nothing states it.
    """

    by: str | None = None
    key: str | None = None
    time_offset_s: float | None = None


@dataclass(frozen=True)
class Mapping:
    """The complete mapping; quantities that a source does not hold are None.

    `reflectors`: columns of the point of each of several reflectors in one row, by name; `point` then holds the columns
    of the first one. `tool`, `frame`: T_flange_tool and T_root_frame of the positions of a program; `controller`: how
    its controller counts the joints.
    """

    measures: str | None = None
    robot: str | None = None
    join: Join = Join()
    joints: Group | None = None
    point: Group | None = None
    rotation: Group | None = None
    axis: Group | None = None
    flange_point: Group | None = None
    flange_rotation: Group | None = None
    time: Group | None = None
    reflectors: Keys[str, tuple[str, ...]] = field(default_factory=dict)
    columns: Keys[str, str] = field(default_factory=dict)
    board: Keys | None = None
    tool: Placements | None = None
    frame: Placements | None = None
    controller: Controller | None = None

    def updated(self, quantity: str, **changes) -> "Mapping":
        """The mapping with other fields of one quantity."""
        return replace(self, **{quantity: replace(getattr(self, quantity), **changes)})

    def merged(self, other: "Mapping") -> "Mapping":
        """This mapping, completed where it says nothing by another one (a proposal)."""
        made = {}
        for entry in fields(self):
            own_value, other_value = getattr(self, entry.name), getattr(other, entry.name)
            made[entry.name] = _completed(own_value, other_value)
        return Mapping(**made)

    def as_keys(self) -> dict:
        """Plain keys for TOML and JSON."""
        keys: dict = {"format": FORMAT}
        for name in ("measures", "robot"):
            if getattr(self, name) is not None:
                keys[name] = getattr(self, name)
        if self.join.by is not None:
            keys["join"] = {k: v for k, v in vars(self.join).items() if v is not None}
        for name in QUANTITIES:
            group = getattr(self, name)
            if group is not None:
                keys[name] = _group_keys(group)
        if self.reflectors:
            del keys["point"]["columns"]
            keys["point"] |= {name: {"columns": list(n)} for name, n in self.reflectors.items()}
        for name in PLACEMENTS:
            if getattr(self, name) is not None:
                keys[name] = getattr(self, name).as_keys()
        if self.controller is not None:
            keys["controller"] = self.controller.model_dump()
        if self.columns:
            keys["columns"] = dict(self.columns)
        if self.board:
            keys["board"] = dict(self.board)
        return keys


def _completed(stated, proposed):
    if stated is None or stated == {}:
        return proposed
    if isinstance(stated, Join):
        return proposed if stated == Join() else stated
    if (
        isinstance(stated, Group)
        and isinstance(proposed, Group)
        and stated.columns == proposed.columns
    ):
        return replace(
            stated,
            unit=stated.unit or proposed.unit,
            convention=stated.convention or proposed.convention,
        )
    return stated


def _group_keys(group: Group) -> dict:
    keys: dict = {"columns": list(group.columns)}
    if group.counts_per_deg is not None:
        keys["counts_per_deg"] = list(group.counts_per_deg)
    elif group.unit is not None:
        keys["unit"] = list(group.unit) if isinstance(group.unit, tuple) else group.unit
    if group.convention is not None:
        keys["convention"] = group.convention
    if group.inverse:
        keys["inverse"] = True
    return keys


def write_mapping(mapping: Mapping, path: Path, comment: str = "") -> None:
    """Write a mapping as TOML, comment lines first."""
    import tomli_w

    path.write_text(comment + tomli_w.dumps(mapping.as_keys()), encoding="utf-8", newline="\n")


def read_mapping(path: Path) -> Mapping:
    """The mapping of a TOML file. Raises InputError with file and key where it cannot be right."""
    try:
        keys = read_toml(path)
    except OSError as problem:
        raise complaint(
            f"--map {path}", "a readable file", str(problem.strerror), "correct the name"
        ) from None
    except ContentError as problem:
        raise complaint(
            f"--map {path}", "TOML", f"a mistake ({problem})", "correct it there"
        ) from None
    mapping = mapping_from_keys(keys, path.name)
    return replace(mapping, robot=_relative_to(path, mapping.robot))


def _relative_to(mapping_file: Path, robot: str | None) -> str | None:
    """The robot of a mapping file: a relative path is relative to that file where it exists there."""
    if robot is None:
        return None
    file = mapping_file.parent / robot
    return str(file) if file_and_tip(file)[0].is_file() else robot


def mapping_from_keys(keys: Keys, called: str) -> Mapping:
    """The mapping of the keys of a file that errors name `called`. Raises InputError."""
    known = {"format", "measures", "robot", "join", "columns", "board", *QUANTITIES, *OF_PROGRAMS}
    for name in keys:
        if name not in known:
            raise complaint(
                f"{called}, key {name}",
                f"one of {', '.join(sorted(known))}",
                "this key",
                "correct it",
            )
    if keys.get("format", FORMAT) != FORMAT:
        raise complaint(f"{called}, key format", f'"{FORMAT}"', repr(keys["format"]), "correct it")
    measures = keys.get("measures")
    if measures is not None and measures not in KINDS:
        raise complaint(
            f"{called}, key measures", f"one of {', '.join(KINDS)}", repr(measures), "correct it"
        )
    keys, reflectors = _with_first_reflector(keys, called)
    groups = {name: _group(keys[name], name, called) for name in QUANTITIES if name in keys}
    frames = {
        name: placements_from_keys(keys[name], f"{called}, [{name}]")
        for name in PLACEMENTS
        if name in keys
    }
    where = f"{called}, [controller]"
    stated = keys.get("controller")
    columns = keys.get("columns", {})
    if not isinstance(columns, Keys) or not all(isinstance(v, str) for v in columns.values()):
        raise complaint(
            f"{called}, [columns]",
            'pairs like "Temp" = "temperature_c"',
            repr(columns)[:60],
            "correct it",
        )
    return Mapping(
        measures=measures,
        robot=_robot(keys, called),
        join=_join(keys.get("join", {}), called),
        reflectors=reflectors,
        columns=dict(columns),
        board=keys.get("board"),
        controller=None if stated is None else checked_section(Controller, stated, where),
        **groups,
        **frames,
    )


def _robot(keys: Keys, called: str) -> str | None:
    robot = keys.get("robot")
    if robot is not None and not isinstance(robot, str):
        place = f"{called}, key robot"
        raise complaint(place, "the name or the file of a robot", repr(robot)[:60], "correct it")
    return robot


def _with_first_reflector(keys: Keys, called: str) -> tuple[Keys, dict[str, tuple[str, ...]]]:
    """The keys with the columns of the first reflector under [point], and the columns of all [point.NAME].

    Raises InputError for sections that cannot be reflectors of one row.
    """
    point = keys.get("point")
    named = (
        {n: v for n, v in point.items() if isinstance(v, Keys)} if isinstance(point, Keys) else {}
    )
    if not named:
        return keys, {}
    common = {name: value for name, value in point.items() if name not in named}
    reflectors = {}
    for name, section in named.items():
        where = f"{called}, [point.{name}]"
        columns = section.get("columns")
        stated = {key: value for key, value in section.items() if key != "columns"}
        is_list = isinstance(columns, list) and len(columns) == 3
        if not is_list or not all(isinstance(column, str) for column in columns):
            raise complaint(
                where, "columns = [...] with three names", repr(columns)[:60], "write them"
            )
        if "columns" in common or any(common.setdefault(k, v) != v for k, v in stated.items()):
            expected = "columns of its own, and one unit and convention for all reflectors"
            raise complaint(where, expected, "others under [point]", "state them once")
        reflectors[name] = tuple(columns)
    return {
        **keys,
        "point": {**common, "columns": list(next(iter(reflectors.values())))},
    }, reflectors


def _join(keys: Keys, called: str) -> Join:
    where = f"{called}, [join]"
    if not isinstance(keys, Keys) or set(keys) - {"by", "key", "time_offset_s"}:
        raise complaint(
            where, "the keys by, key and time_offset_s", repr(keys)[:60], "remove the others"
        )
    if keys.get("by") not in (None, *JOINS):
        raise complaint(
            f"{where}, key by", f"one of {', '.join(JOINS)}", repr(keys["by"]), "correct it"
        )
    offset = keys.get("time_offset_s")
    if "time_offset_s" in keys and not is_number(offset):
        raise complaint(
            f"{where}, key time_offset_s", "a number of seconds", repr(offset), "correct it"
        )
    return Join(keys.get("by"), keys.get("key"), None if offset is None else float(offset))


def is_number(value) -> bool:
    """Whether a value of a TOML file is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _group(keys, name: str, called: str) -> Group:
    where = f"{called}, [{name}]"
    columns = keys.get("columns") if isinstance(keys, Keys) else None
    if not isinstance(columns, list) or not columns or not all(isinstance(c, str) for c in columns):
        raise complaint(
            f"{where}, key columns", "a list of column names", repr(columns)[:60], "write the names"
        )
    known = ["columns", "unit", "convention", "inverse"]
    known += ["counts_per_deg"] if name == "joints" else []
    if unknown := set(keys) - set(known):
        choices = f"{', '.join(known[:-1])} or {known[-1]}"
        raise complaint(f"{where}, key {sorted(unknown)[0]}", choices, "it", "remove it")
    counts = _counts(keys, len(columns), where)
    unit, convention = keys.get("unit"), keys.get("convention")
    units = LENGTHS if name in ("point", "flange_point") else ANGLE_NAMES
    if name != "time" and unit is not None:
        unit = _unit(unit, units, name, len(columns), where)
    if name == "point":
        _check_point_convention(convention, where)
    elif convention is not None and convention not in CONVENTIONS:
        words = "quaternion wxyz, quaternion xyzw, rotation vector, matrix, intrinsic XYZ, extrinsic ZYX, ..."
        raise complaint(
            f"{where}, key convention", f"one of {words}", repr(convention), "correct it"
        )
    wanted = (
        SIZES.get(convention)
        if convention
        else 3
        if name in ("point", "flange_point", "axis")
        else None
    )
    if wanted is not None and len(columns) != wanted:
        raise complaint(
            f"{where}, key columns", f"{wanted} columns", f"{len(columns)}", "correct the list"
        )
    if not isinstance(keys.get("inverse", False), bool):
        raise complaint(
            f"{where}, key inverse", "true or false", repr(keys["inverse"]), "correct it"
        )
    inverse = keys.get("inverse", False)
    return Group(tuple(columns), unit if counts is None else "deg", convention, inverse, counts)


def _counts(keys: Keys, count: int, where: str) -> tuple[float, ...] | None:
    """The value of a key counts_per_deg, one number for each column; None without it. Raises InputError for others."""
    if "counts_per_deg" not in keys:
        return None
    stated = keys["counts_per_deg"]
    numbers = stated if isinstance(stated, list) else [stated] * count
    if len(numbers) != count or not all(is_number(number) and number != 0 for number in numbers):
        expected = f"one number, or {count} numbers, none of them 0"
        raise complaint(f"{where}, key counts_per_deg", expected, repr(stated)[:60], "correct it")
    if "unit" in keys:
        raise complaint(
            f"{where}, key unit", "no unit next to counts_per_deg", repr(keys["unit"]), "remove it"
        )
    return tuple(float(number) for number in numbers)


def _unit(unit, known: Collection[str], name: str, count: int, where: str) -> ColumnUnits:
    """The value of a key `unit`: one word, or a list of one word for each column. Raises InputError for another."""
    where = f"{where}, key unit"
    if not isinstance(unit, list):
        if unit not in known:
            raise complaint(where, f"one of {', '.join(known)}", repr(unit), "correct it")
        return unit
    allowed = {*known, *(LENGTHS if name == "joints" else ()), OPEN}
    if len(unit) != count:
        raise complaint(
            where, f"{count} units, one for each column", f"{len(unit)}", "correct the list"
        )
    for word in unit:
        if not isinstance(word, str) or word not in allowed:
            raise complaint(where, f"units out of {', '.join(known)}", repr(word), "correct it")
    return tuple(unit)


def _check_point_convention(convention, where: str) -> None:
    """Raise InputError where the convention of a point is neither absent nor spherical coordinates."""
    if convention is not None and convention not in spherical.CONVENTIONS:
        raise complaint(
            f"{where}, key convention",
            'none, or one such as "spherical elevation deg counterclockwise"',
            repr(convention),
            "correct it",
        )
