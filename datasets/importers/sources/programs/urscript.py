"""Joint positions of a URScript program (Universal Robots): rad, in the order in which they stand in the file.

Read are the lists of six numbers of movej and movel, and of variables such as `q1 = [...]`. Poses, which are written
p[...] and are those of the tool centre point that the installation states, are counted and not read.
"""

import re
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import RawTable
from datasets.importers.sources.tables.text_tables import encoding_of

EXTENSIONS = {".script", ".urscript"}
_POSITION = re.compile(r"(?:\bmove[jlp]\s*\(\s*|\b(\w+)\s*=\s*)(p?)\[([^\[\]]*)\]", re.IGNORECASE)
_COMMENT = re.compile(r"#.*$", re.MULTILINE)
_JOINTS = 6


def read_urscript(path: Path) -> list[RawTable]:
    """The table of the joint positions. Raises InputError where there are none."""
    text = _COMMENT.sub("", path.read_text(encoding=encoding_of(path), errors="replace"))
    names, rows, lines, poses = [], [], [], 0
    for match in _POSITION.finditer(text):
        values = _numbers(match[3])
        if len(values) != _JOINTS:
            continue
        if match[2]:
            poses += 1
            continue
        rows.append(values)
        lines.append(text.count("\n", 0, match.start()) + 1)
        names.append(match[1] or f"P{len(rows)}")
    if not rows:
        raise complaint(
            path.name,
            "joint positions such as movej([0.1, -1.2, 1.5, 0.3, 1.5, 0.0])",
            f"{poses} poses p[...] of the tool only" if poses else "none",
            "record joint positions, or export a table of flange poses",
        )
    said = (f"{path.name}: {poses} poses p[...] of the tool are not read.",) if poses else ()
    columns = {f"J{k + 1} [rad]": column for k, column in enumerate(np.array(rows).T)}
    table = {"position name": np.array(names), **columns}
    return [RawTable(path.name, table, np.array(lines), warnings=said)]


def _numbers(text: str) -> list[float]:
    """The numbers of a list; [] where one of them is an expression."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return []
