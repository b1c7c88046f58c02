"""Positions of a Yaskawa job (.JBI): pulses of the encoders, in the order in which they stand in the file.

    ///POSTYPE PULSE
    ///PULSE
    C00000=12286,-37428,-71791,88038,63538,31483

Positions of external axes (EC, BC) are not read. The counts of a degree stand in no job: a mapping states them.
"""

import re
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import RawTable
from datasets.importers.sources.tables.text_tables import encoding_of
from datasets.importers.units import COUNTS

EXTENSIONS = {".jbi"}
_POSITION = re.compile(r"^\s*(C\d+)\s*=\s*([-+\d.,\s]+?)\s*$")
_KIND = re.compile(r"^\s*///POSTYPE\s+(\w+)", re.IGNORECASE)
_AXES = ("S", "L", "U", "R", "B", "T")


def read_job(path: Path) -> list[RawTable]:
    """The table of the positions in pulses. Raises InputError where there are none, or some have other numbers."""
    kind, names, rows, lines = "PULSE", [], [], []
    text = path.read_text(encoding=encoding_of(path), errors="replace")
    for number, line in enumerate(text.splitlines(), 1):
        stated = _KIND.match(line)
        kind = stated[1].upper() if stated else kind
        match = _POSITION.match(line)
        if match and kind == "PULSE":
            names.append(match[1])
            rows.append([float(cell) for cell in match[2].split(",") if cell.strip()])
            lines.append(number)
    counts = {len(row) for row in rows}
    if len(counts) != 1:
        raise complaint(
            path.name,
            "positions in pulses of the encoders with equally many axes",
            "none" if not counts else f"{' and '.join(map(str, sorted(counts)))} axes",
            "export the joint angles in degrees as CSV",
        )
    axes = _AXES if counts == {len(_AXES)} else [f"J{k + 1}" for k in range(counts.pop())]
    cells = dict(zip(axes, np.array(rows).T))
    units = dict.fromkeys(axes, COUNTS)
    return [RawTable(path.name, {"name": np.array(names), **cells}, np.array(lines), units=units)]
