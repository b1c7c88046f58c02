"""The mapping of an import as a form: one row a quantity, with its columns, unit and rotation convention.

The form works on the plain keys of the mapping, which may be incomplete while somebody edits them.
"""

import copy
from collections.abc import Iterable, Mapping

from datasets.importers.mapping.joined_tables.joining import time_columns
from datasets.importers.mapping.model import QUANTITIES
from datasets.importers.mapping.rotations import CONVENTIONS
from datasets.importers.source import RawTable
from datasets.importers.units import ANGLE_NAMES, LENGTHS
from datasets.samples.columns import KINDS
from workbench.core.errors import InputError

CALLED = "the mapping"
TITLES = {
    "joints": "Joint readings",
    "point": "Measured point",
    "rotation": "Measured rotation",
    "axis": "Measured axis",
    "flange_point": "Flange position",
    "flange_rotation": "Flange rotation",
    "time": "Time",
}
_UNITS = dict.fromkeys(("joints", "rotation", "flange_rotation"), ANGLE_NAMES)
_UNITS |= {name: tuple(LENGTHS) for name in ("point", "flange_point")}
_ROTATIONS = ("rotation", "flange_rotation")
_TESTED = {"title": "tested on the robot", "value": ""}
_NOT_USED = "not used"
_TIME = "time_s, by its header"
_SHOWN = 3
_SEPARATOR = ", "


def kinds() -> list[dict]:
    """Kinds of measurement that an import makes, for a list; "" where the columns say it."""
    return [{"title": "from the columns", "value": ""}, *_items(KINDS)]


def form_rows(keys: Mapping, table: RawTable | None) -> list[dict]:
    """One row a quantity: `name`, `title`, `columns`, `unit`, `convention`, `inverse`, choices and first cells.

    table: whose cells are shown; None where there is no table.
    """
    return [_row(name, keys.get(name, {}), table) for name in QUANTITIES]


def _row(name: str, group: Mapping, table: RawTable | None) -> dict:
    columns = list(group.get("columns", ()))
    return {
        "name": name,
        "title": TITLES[name],
        "columns": columns,
        "unit": _as_text(group.get("unit", "")),
        "units": _unit_items(name, group) if name in _UNITS else [],
        "convention": group.get("convention", ""),
        "conventions": [_TESTED, *_items(CONVENTIONS)] if name in _ROTATIONS else [],
        "inverse": bool(group.get("inverse")),
        "cells": "" if table is None else first_cells(table, columns),
    }


def _as_text(unit: str | list) -> str:
    """A unit of all columns, or one for each of them, as the value of a list."""
    return _SEPARATOR.join(unit) if isinstance(unit, list) else unit


def _unit_items(name: str, group: Mapping) -> list[dict]:
    """Units that a quantity can have, and the units of single columns where the mapping states them."""
    unit = group.get("unit")
    unit_items = _items([_as_text(unit)]) if isinstance(unit, list) else []
    return [_TESTED, *unit_items, *_items(_UNITS[name])]


def _items(names: Iterable[str]) -> list[dict]:
    return [{"title": name, "value": name} for name in names]


def first_cells(table: RawTable, columns: Iterable[str]) -> str:
    """The first rows of some columns, as they stand in the file."""
    known = [name for name in columns if name in table.columns]
    if not known:
        return ""
    rows = zip(*(table.columns[name][:_SHOWN].tolist() for name in known))
    return "   |   ".join(", ".join(_text(cell) for cell in row) for row in rows)


def _text(cell) -> str:
    return cell if isinstance(cell, str) else f"{cell:.6g}"


def other_rows(keys: Mapping, table: RawTable | None) -> list[dict]:
    """Columns that no quantity uses: `name`, `target` ("" where it is left out), first cells, and `unnamed`.

    `unnamed` says what becomes of a column without a name: the importer reads times by their header.
    """
    if table is None:
        return []
    used_names = {name for row in form_rows(keys, None) for name in row["columns"]}
    remaining = [name for name in table.columns if name not in used_names]
    named = keys.get("columns", {})
    times = () if "time" in keys else time_columns(table)
    return [
        {
            "name": name,
            "target": named.get(name, ""),
            "unnamed": _TIME if name in times else _NOT_USED,
            "cells": first_cells(table, [name]),
        }
        for name in remaining
    ]


def with_cell(keys: Mapping, name: str, key: str, value: object) -> dict:
    """Keys of the mapping after an edit of the form. Raises InputError for a quantity that does not exist.

    name: a quantity, "" for the mapping itself (key measures), or "columns" (key is a column's name).
    """
    keys = copy.deepcopy(dict(keys))
    if name == "":
        keys.pop(key, None)
        keys |= {key: value} if value else {}
    elif name == "columns":
        named = {k: v for k, v in keys.get("columns", {}).items() if k != key}
        keys["columns"] = named | ({key: str(value)} if value else {})
    elif name in QUANTITIES:
        _edit_group(keys, name, key, value)
    else:
        raise InputError(f"{CALLED}: expected a quantity, found {name!r}; choose another")
    return keys


def _edit_group(keys: dict, name: str, key: str, value: object) -> None:
    """Change one key of a quantity; a quantity without columns is removed.

    Other columns have another unit and convention, which are tested again. A column belongs to one quantity only.
    """
    if key == "columns":
        columns = [str(column) for column in value or []]
        keys.pop(name, None)
        if not columns:
            return
        for other in QUANTITIES:
            _release(keys, other, columns)
        keys["columns"] = {k: v for k, v in keys.get("columns", {}).items() if k not in columns}
        keys[name] = {"columns": columns}
        return
    group = dict(keys.get(name) or {})
    if not group:
        raise InputError(f"{TITLES[name]}: expected columns first, found none; choose them")
    group.pop(key, None)
    if key == "unit" and _SEPARATOR in str(value):
        value = str(value).split(_SEPARATOR)
    keys[name] = group | ({key: value} if value else {})


def _release(keys: dict, name: str, columns: list[str]) -> None:
    """Take columns away from a quantity; without any column it is removed."""
    group = keys.get(name)
    if not group or not set(group["columns"]) & set(columns):
        return
    column_places = [k for k, column in enumerate(group["columns"]) if column not in columns]
    keys.pop(name)
    if not column_places:
        return
    keys[name] = {"columns": [group["columns"][k] for k in column_places]}
    unit = group.get("unit")
    if unit:
        keys[name]["unit"] = [unit[k] for k in column_places] if isinstance(unit, list) else unit
