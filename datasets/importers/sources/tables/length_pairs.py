"""Tables with one row for each length, as of a ballbar: the joint readings at both ends stand side by side.

Nr, A1 start, ..., A6 start, A1 end, ..., A6 end, Length [mm]
"""

import re
from dataclasses import replace

import numpy as np

from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.source import RawTable

_NUMBERED = re.compile(r"(.{0,40}?[A-Za-z][ _]?)(\d{1,2})(?!\d)(.{0,40})")
_FEWEST_JOINTS = 3
_PAIR = "pair"


def two_rows_per_length(table: RawTable) -> RawTable | None:
    """The table with a row for each end of a length, and the column `pair`; None for another table."""
    kinds = {name: read_header(name, table.units.get(name)).kind for name in table.columns}
    if list(kinds.values()).count("length_mm") != 1 or _PAIR in kinds.values():
        return None
    ends = _columns_of_ends(table)
    if len(ends) != 2 or set(ends[0]) != set(ends[1]):
        return None
    rows = np.repeat(np.arange(table.n), 2)
    end_rows = table.take(rows)
    taken = {name for end in ends for name in end.values()}
    columns = {name: cells for name, cells in end_rows.columns.items() if name not in taken}
    units = dict(table.units)
    for number in sorted(ends[0]):
        names = [end[number] for end in ends]
        columns[f"J{number}"] = np.stack([table.columns[name] for name in names], 1).ravel()
        unit = read_header(names[0], table.units.get(names[0])).unit
        units |= {f"J{number}": unit} if unit else {}
    return replace(end_rows, columns={**columns, _PAIR: rows + 1.0}, units=units)


def _columns_of_ends(table: RawTable) -> list[dict[int, str]]:
    """Columns by the number of the joint, for each set of headers that differ in this number only."""
    found: dict[tuple[str, str], dict[int, str]] = {}
    for name, cells in table.columns.items():
        match = _NUMBERED.fullmatch(name)
        if match and cells.dtype.kind == "f":
            found.setdefault((match[1], match[3]), {})[int(match[2])] = name
    return [numbers for numbers in found.values() if len(numbers) >= _FEWEST_JOINTS]
