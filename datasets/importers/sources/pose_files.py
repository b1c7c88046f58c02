"""One small file per pose (pos0.txt, pos1.txt, ... next to pos0.png): 6, 7, 12 or 16 numbers each.

Such a file holds these numbers alone, or they are the longest list in YAML or JSON, as in the files of hand-eye tools,
or they stand on the lines r and t of a pose file of HALCON.
Lines that begin with # are comments. Rotations (9 numbers) and positions (3 numbers) may have files of their own, in
series such as R_1, ... and t_1, ..., or in folders of their own.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.importers.source import RawTable
from datasets.importers.sources.arrays import pose_columns

STRUCTURED = {".yml", ".yaml", ".json"}
_SIZES = (6, 7, 12, 16)
_LIST = re.compile(r"\[[\s\d.,eE+\-\[\]]*\]")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_HALCON = re.compile(r"^([rt])((?:\s+[+-]?[\d.]+(?:[eE][+-]?\d+)?){3})\s*$", re.MULTILINE)
_COMMENT = re.compile(r"^\s*#.*$", re.MULTILINE)
_NUMBER_AT_END = re.compile(r"[\W_]*\d+$")
_PART_WORD = re.compile(
    r"^(?:rotations?|rot|rmat|translations?|trans|positions?|pos|R|t|T|P|p)(?=[\W_]|[A-Z0-9]|$)"
    r"|^(?:R|P|T)(?=[a-z0-9]+2[a-z]+$)"
)
_OF_ROTATION, _OF_POSITION = 9, 3
_FEWEST, _LARGEST_BYTES = 3, 4096


def read_pose_files(paths: Sequence[Path]) -> tuple[list[RawTable], list[Path]]:
    """The tables of files that hold one pose each, and the paths that are none.

    Such files have a name that ends with a number and hold equally many numbers; the column "file" has their names. Two
    series of files (pose_rPe_1, ..., and pose_cPo_1, ...) make two tables, and so do two folders of files.
    """
    values = {}
    for path in paths:
        numbers = _numbers(path)
        if numbers is not None:
            values[path] = numbers
    tables, taken = _tables_of_parts(values)
    open_paths = [path for path in values if path not in taken]
    sizes = [len(values[path]) for path in open_paths]
    size = max(set(sizes), key=sizes.count) if sizes else 0
    chosen = [path for path in open_paths if len(values[path]) == size]
    if size in _SIZES and len(chosen) >= _FEWEST:
        for part in _series(chosen):
            cells = [values[path] for path in part]
            tables.append(_table(part, cells, size))
        taken |= set(chosen)
    others = [path for path in paths if path not in taken]
    return tables, others


def _groups(paths: Sequence[Path]) -> dict[tuple[str, str], list[Path]]:
    """The files by folder and name, both without the number at their end."""
    groups: dict[tuple[str, str], list[Path]] = {}
    for path in paths:
        folder = _NUMBER_AT_END.sub("", path.parent.name)
        name = _NUMBER_AT_END.sub("", path.stem)
        groups.setdefault((folder, name), []).append(path)
    return groups


def _series(paths: Sequence[Path]) -> list[list[Path]]:
    """The files of two series whose numbers are mostly the same, or all together."""
    single_series = [list(paths)]
    found = list(_groups(paths).values())
    if len(found) != 2:
        return single_series
    lengths = [len(group) for group in found]
    if min(lengths) < _FEWEST:
        return single_series
    numbers = [_number(path) for path in found[0]]
    others = [_number(path) for path in found[1]]
    common = set(numbers) & set(others)
    return found if 2 * len(common) >= max(lengths) else single_series


def _number(path: Path) -> int:
    digits = re.search(r"\d+$", path.stem)
    return int(digits[0])


def _tables_of_parts(values: Mapping[Path, Sequence[float]]) -> tuple[list[RawTable], set[Path]]:
    """Tables of poses whose rotations and positions have files of their own, and these files."""
    parts_of_poses: dict[int, dict[str, dict[int, Path]]] = {_OF_ROTATION: {}, _OF_POSITION: {}}
    for (folder, name), group in _groups(list(values)).items():
        sizes = {len(values[path]) for path in group}
        size = sizes.pop()
        is_part = size in parts_of_poses and not sizes
        if is_part and len(group) >= _FEWEST:
            called = _object(folder, name)
            parts_of_poses[size][called] = {_number(path): path for path in group}
    tables, taken = [], set()
    for called, rotations in parts_of_poses[_OF_ROTATION].items():
        positions = parts_of_poses[_OF_POSITION].get(called)
        if positions is not None:
            table = _joined(called, rotations, positions, values)
            tables.append(table)
            taken |= set(rotations.values())
            taken |= set(positions.values())
    return tables, taken


def _object(folder: str, name: str) -> str:
    """The object of the poses: the folder, else the name of its files, without a word for rotation or position."""
    of_folder = _PART_WORD.sub("", folder, count=1)
    of_name = _PART_WORD.sub("", name, count=1)
    named = of_name if of_folder == folder else of_folder
    return named.strip(" _-.") or "pose"


def _joined(name: str, rotations, positions, values) -> RawTable:
    """The table of poses with a rotation and a position; a warning names the numbers that have only one of them."""
    numbers = sorted(rotations.keys() & positions.keys())
    poses = np.tile(np.eye(4), (len(numbers), 1, 1))
    for pose, number in zip(poses, numbers):
        rotation = values[rotations[number]]
        pose[:3, :3] = np.reshape(rotation, (3, 3))
        pose[:3, 3] = values[positions[number]]
    lonely = sorted(rotations.keys() ^ positions.keys())
    warnings = ()
    if lonely:
        listed = ", ".join(map(str, lonely))
        warnings = (
            f"{name}: the files with the numbers {listed} hold a rotation or a position alone.",
        )
    files = [rotations[number].name for number in numbers]
    columns = {"file": np.array(files)}
    columns |= pose_columns(name, poses)
    return RawTable(f"{name} ...", columns, np.array(numbers), warnings=warnings)


def _table(chosen: Sequence[Path], values: Sequence[Sequence[float]], size: int) -> RawTable:
    cells = np.array(values)
    columns: dict[str, np.ndarray] = {"file": np.array([path.name for path in chosen])}
    if size in (6, 7):
        columns |= {f"pose {k + 1}": cells[:, k] for k in range(size)}
    else:
        poses = np.tile(np.eye(4), (len(cells), 1, 1))
        poses[:, : size // 4] = cells.reshape(-1, size // 4, 4)
        columns |= pose_columns("pose", poses)
    folders = {path.parent for path in chosen}
    folder = folders.pop() if len(folders) == 1 else None
    name = f"{chosen[0].name} ..."
    lines = np.arange(1, len(chosen) + 1)
    table = RawTable(name, columns, lines, folder=folder)
    is_number_alone = chosen[0].stem.isdigit()
    if folder is None or not is_number_alone:
        return table
    # the folder says whose poses they are
    return replace(table, file=f"{folder.name}/{name}", prefix=folder.name)


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
        plain = _COMMENT.sub("", text).strip("[] \n\r\t")
        return [float(cell) for cell in re.split(r"[\s,;]+", plain) if cell]
    except ValueError:
        return None
