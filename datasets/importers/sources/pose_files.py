"""One small file per pose (pos0.txt, pos1.txt, ... next to pos0.png): 6, 7, 12 or 16 numbers each.

Such a file holds these numbers alone, or they are the longest list in YAML or JSON, as in the files of hand-eye tools,
or they stand on the lines r and t of a pose file of HALCON.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datasets.importers.source import RawTable
from datasets.importers.sources.arrays import pose_columns

STRUCTURED = {".yml", ".yaml", ".json"}
_SIZES = (6, 7, 12, 16)
_LIST = re.compile(r"\[[\s\d.,eE+\-\[\]]*\]")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_HALCON = re.compile(r"^([rt])((?:\s+[+-]?[\d.]+(?:[eE][+-]?\d+)?){3})\s*$", re.MULTILINE)
_FEWEST, _LARGEST_BYTES = 3, 4096


def read_pose_files(paths: Sequence[Path]) -> tuple[list[RawTable], list[Path]]:
    """The tables of files that hold one pose each, and the paths that are none.

    Such files have a name that ends with a number and hold equally many numbers; the column "file" has their names. Two
    series of files (pose_rPe_1, ..., and pose_cPo_1, ...) make two tables.
    """
    values = {path: _numbers(path) for path in paths}
    sizes = [len(found) for found in values.values() if found is not None]
    size = max(set(sizes), key=sizes.count) if sizes else 0
    chosen = [path for path, found in values.items() if found is not None and len(found) == size]
    if size not in _SIZES or len(chosen) < _FEWEST:
        return [], list(paths)
    tables = [_table(part, [values[path] for path in part], size) for part in _series(chosen)]
    return tables, [path for path in paths if path not in chosen]


def _series(paths: Sequence[Path]) -> list[list[Path]]:
    """The files of two series with equally many files, or all together."""
    paths_by_stem: dict[str, list[Path]] = {}
    for path in paths:
        paths_by_stem.setdefault(re.sub(r"[\W_]*\d+$", "", path.stem), []).append(path)
    found = list(paths_by_stem.values())
    is_pair = len(found) == 2 and len(found[0]) == len(found[1]) >= _FEWEST
    return found if is_pair else [list(paths)]


def _table(chosen: Sequence[Path], values: Sequence[Sequence[float]], size: int) -> RawTable:
    cells = np.array(values)
    columns: dict[str, np.ndarray] = {"file": np.array([path.name for path in chosen])}
    if size in (6, 7):
        columns |= {f"pose {k + 1}": cells[:, k] for k in range(size)}
    else:
        poses = np.tile(np.eye(4), (len(cells), 1, 1))
        poses[:, : size // 4] = cells.reshape(-1, size // 4, 4)
        columns |= pose_columns("pose", poses)
    return RawTable(f"{chosen[0].name} ...", columns, np.arange(1, len(chosen) + 1))


def _numbers(path: Path) -> list[float] | None:
    """All numbers of a small file that holds nothing else; None for other files."""
    if not re.search(r"\d$", path.stem) or path.stat().st_size > _LARGEST_BYTES:
        return None
    try:
        text = path.read_text(encoding="utf-8")
        if path.suffix.lower() in STRUCTURED:
            lists = [_NUMBER.findall(match[0]) for match in _LIST.finditer(text)]
            longest = max(lists, key=len, default=[])
            if (
                len(longest) == 1
            ):  # a column vector, one number on each line, as in the files of ViSP
                longest = [match[0] for match in lists if match]
            return [float(cell) for cell in longest]
        halcon = {letter: numbers.split() for letter, numbers in _HALCON.findall(text)}
        if len(halcon) == 2:
            return [float(cell) for cell in (*halcon["t"], *halcon["r"])]
        return [float(cell) for cell in re.split(r"[\s,;]+", text.strip("[] \n\r\t")) if cell]
    except ValueError:
        return None
