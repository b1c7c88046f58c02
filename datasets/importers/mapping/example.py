"""A complete mapping file from the headers of a table, for a person to edit: what could not be inferred is marked."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datasets.importers.mapping.columns.column_units import unit_toml
from datasets.importers.mapping.columns.sets import headers_of
from datasets.importers.mapping.left_out import similar_columns, unused_columns
from datasets.importers.mapping.model import FORMAT, Group, Mapping
from datasets.importers.source import RawTable

OPEN_NAME = "?"
"""Stands for what a person has to fill in."""
_USUAL_JOINTS = 6
_MOST_SHOWN = 12
_SIZES = {"point": 3, "flange_point": 3, "flange_rotation": 3}
_NOUNS = {
    "joints": "joint readings, in the order of the joints",
    "point": "the measured point, in the order x, y, z",
    "rotation": "the measured rotation",
    "axis": "the measured axis",
    "flange_point": "the position of the flange, in the order x, y, z",
    "flange_rotation": "the rotation of the flange",
}
_UNITS = {
    "joints": 'unit = "deg"        # deg, rad or gon',
    "point": 'unit = "mm"         # mm, m, in or cm',
    "flange_point": 'unit = "mm"         # mm, m, in or cm',
    "rotation": 'unit = "deg"        # deg, rad or gon, for angles',
    "flange_rotation": 'unit = "deg"        # deg, rad or gon, for angles',
}
_CONVENTION = (
    '# convention = "intrinsic XYZ"   # or "quaternion wxyz", ...; without this line all are tested'
)


_COUNTS = "# counts_per_deg = [...]   # in place of unit: encoder counts in one degree, one number for each column"


@dataclass(frozen=True)
class Wanted:
    """Requirements of a recording: `quantities` in their order, the number of `joints`, and a valid `robot`, if any."""

    quantities: tuple[str, ...]
    joints: int | None = None
    robot: str | None = None


def example_mapping(table: RawTable, mapping: Mapping, wanted: Wanted) -> str:
    """The text of a mapping file with every wanted quantity; `mapping`: what headers and user state."""
    guessed = _guessed(table, mapping, wanted)
    lines = [f'format = "{FORMAT}"', *_head(mapping, wanted)]
    extra = [name for name in ("rotation", "axis") if getattr(mapping, name) is not None]
    for quantity in (*wanted.quantities, *extra):
        group = getattr(mapping, quantity)
        lines += ["", f"[{quantity}]"]
        lines += _group_lines(quantity, group or guessed[quantity], group is not None)
    used = {name for group in guessed.values() for name in group.columns}
    lines += ["", *_other_lines(table, mapping, used)]
    return "\n".join(lines) + "\n"


def _head(mapping: Mapping, wanted: Wanted) -> list[str]:
    if "flange_point" in wanted.quantities:
        return []
    measures = mapping.measures or "external-point"
    remark = (
        "" if mapping.measures else "   # CHECK: or external-pose (with [rotation]), ball-centre"
    )
    robot = wanted.robot or OPEN_NAME
    asked = "" if wanted.robot else "   # FILL IN: built-in name, robot.toml, URDF or DH table"
    return [f'measures = "{measures}"{remark}', f"robot = {_quoted(robot)}{asked}"]


def _group_lines(quantity: str, group: Group, is_known: bool) -> list[str]:
    columns = ", ".join(_quoted(name) for name in group.columns)
    noun = _NOUNS[quantity]
    source = "from the headers"
    if not is_known:
        filled = OPEN_NAME not in group.columns
        source = "CHECK: taken by the order of the columns" if filled else "FILL IN"
    lines = [f"# {noun}: {source}", f"columns = [{columns}]"]
    if group.unit is not None:
        lines.append(f"unit = {unit_toml(group.unit)}")
    elif quantity in _UNITS:
        lines.append(f"# {_UNITS[quantity]}; without this line all are tested")
        lines += [_COUNTS] if quantity == "joints" else []
    if group.convention is not None:
        lines.append(f"convention = {_quoted(group.convention)}")
    elif quantity.endswith("rotation"):
        lines.append(_CONVENTION)
    return lines


def _other_lines(table: RawTable, mapping: Mapping, used: set[str]) -> list[str]:
    """[columns], with a comment on every column that is not used."""
    lines = ["[columns]"]
    lines += [f"{_quoted(name)} = {_quoted(target)}" for name, target in mapping.columns.items()]
    left = [name for name in unused_columns(table, mapping) if name not in used]
    if left:
        lines.append('# Not used; to keep one, state it as in "Temp" = "temperature_c":')
    lines += [f"# {_quoted(name)}: {_content(table.columns[name])}" for name in left[:_MOST_SHOWN]]
    if len(left) > _MOST_SHOWN:
        lines.append(f"# and {len(left) - _MOST_SHOWN} more")
    return lines


def _content(cells: np.ndarray) -> str:
    """Content of a column, in words."""
    if cells.dtype.kind != "f":
        return f"text such as {_quoted(str(cells[0]))}" if len(cells) else "no rows"
    finite = cells[np.isfinite(cells)]
    if not len(finite):
        return "empty"
    return f"numbers from {finite.min():.6g} to {finite.max():.6g}"


def _guessed(table: RawTable, mapping: Mapping, wanted: Wanted) -> dict[str, Group]:
    """Columns for the quantities that neither headers nor user name: similar ones first, then neighbouring ones."""
    free = _usable(table, mapping)
    guessed = {}
    for quantity in wanted.quantities:
        if getattr(mapping, quantity) is not None:
            continue
        count = _SIZES.get(quantity) or wanted.joints or _USUAL_JOINTS
        chosen = _chosen(table, mapping, free, count)
        free = [name for name in free if name not in chosen]
        guessed[quantity] = Group(tuple(chosen) or (OPEN_NAME,) * count)
    return guessed


def _chosen(table: RawTable, mapping: Mapping, free: Sequence[str], count: int) -> list[str]:
    """Columns with similar headers, of which a joint at rest may be one, else neighbouring ones that change."""
    numeric = [n for n in unused_columns(table, mapping) if table.columns[n].dtype.kind == "f"]
    for names in similar_columns(table, numeric):
        if len(names) == count and 2 * len(set(names) & set(free)) > count:
            order = list(table.columns)
            return sorted(names, key=order.index)
    return list(free[:count]) if len(free) >= count else []


def _usable(table: RawTable, mapping: Mapping) -> list[str]:
    """Unused columns of numbers that change and do not only count."""
    headers = headers_of(table)
    usable = []
    for name in unused_columns(table, mapping):
        cells, header = table.columns[name], headers[name]
        if cells.dtype.kind != "f" or header.kind in ("time", "sample") or header.is_nominal:
            continue
        steps = np.diff(cells[np.isfinite(cells)])
        if len(steps) and np.ptp(steps) > 1e-9 * max(np.abs(steps).max(), 1e-12):
            usable.append(name)
    return usable


def _quoted(text: str) -> str:
    """A TOML string."""
    return json.dumps(text, ensure_ascii=False)
