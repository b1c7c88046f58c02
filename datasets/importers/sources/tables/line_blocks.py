"""Text with several labelled lines for each sample, as programs print them, and alternating rows of two objects.

    At time 1700000000.5                              hand, 0.41, 0.12, 0.38, 0.0, 0.71, 0.0, 0.71
    - Translation: [2.31, -0.84, 0.41]                eye, 0.02, 0.11, 0.61, 0.5, 0.5, 0.5, 0.5
    - Rotation: in Quaternion [0.0, 0.0, 0.7, 0.7]    hand, 0.43, ...

The labels repeat in one order; each block is a row, and the numbers of a line are its columns "label 1", "label 2".
"""

import re
from collections import Counter
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np

from datasets.importers.source import RawTable
from datasets.importers.sources.tables.text_tables import encoding_of
from datasets.importers.units import is_unit

_NUMBER = r"[+-]?(?:\d{1,30}\.?\d{0,30}|\.\d{1,30})(?:[eE][+-]?\d{1,3})?"
_LINE = re.compile(
    rf"(?:(?!\n)[\W\d_]){{0,20}}(?P<label>[^\W\d_][^\n]{{0,80}}?)"
    rf"(?:\s{{0,9}}[:=,;：]\s{{0,9}}|\s{{1,20}})[\[({{]?\s{{0,9}}"
    rf"(?P<numbers>{_NUMBER}(?:(?:\s{{0,9}}[,;]\s{{0,9}}|\s{{1,9}}){_NUMBER}){{0,30}})"
    rf"\s{{0,9}}[\])}}]?\s{{0,9}}(?P<unit>[A-Za-z°]{{0,12}})\s{{0,9}}$"
)
_LONGEST = 2000  # characters of a line
_MOST_LABELS = 40
_FEWEST_BLOCKS = 3
_SAMPLE_LINES = 200


def read_line_blocks(path: Path) -> RawTable | None:
    """The table with a row for each block of lines; None for a file of another layout."""
    encoding = encoding_of(path)
    with path.open(encoding=encoding, errors="replace", newline=None) as file:
        if _period(_without_head(_lines(islice(file, _SAMPLE_LINES)))) is None:
            return None
    with path.open(encoding=encoding, errors="replace", newline=None) as file:
        lines = _without_head(_lines(file))
    period = _period(lines)
    if period is None:
        return None
    blocks = [lines[k : k + period] for k in range(0, len(lines) // period * period, period)]
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    for place, (_, label, first, unit) in enumerate(blocks[0]):
        cells = np.array([block[place][2] for block in blocks])
        names = [label] if len(first) == 1 else [f"{label} {k + 1}" for k in range(len(first))]
        columns |= dict(zip(names, cells.T))
        units |= dict.fromkeys(names, unit) if is_unit(unit) else {}
    starts = np.array([block[0][0] for block in blocks])
    remainder = len(lines) % period
    incomplete = "last line is" if remainder == 1 else f"last {remainder} lines are"
    sentences = (f"{path.name}: the {incomplete} no complete block and not read.",)
    return RawTable(
        path.name, columns, starts, units=units, warnings=sentences if remainder else ()
    )


def _lines(texts: Iterable[str]) -> list[tuple[int, str, list[float], str]]:
    """(number, label, numbers, unit) of each line with a label in front of its numbers."""
    found = []
    for number, text in enumerate(texts, 1):
        match = _LINE.match(text[:_LONGEST].rstrip())
        if match and match["label"].count("(") == match["label"].count(")"):
            numbers = [float(part) for part in re.findall(_NUMBER, match["numbers"])]
            label = re.sub(r"\s+", " ", match["label"].strip())
            found.append((number, label, numbers, match["unit"]))
    return found


def _without_head(lines: list) -> list:
    """The lines from the first one whose label repeats: a number of measurements above them is no part of a block."""
    counts = Counter((label, len(numbers)) for _, label, numbers, _ in lines)
    repeats = [counts[label, len(numbers)] >= _FEWEST_BLOCKS for _, label, numbers, _ in lines]
    return lines[repeats.index(True) :] if any(repeats) else lines


def _period(lines: list) -> int | None:
    """The number of lines of a block: all labels repeat in this order, with equally many numbers."""
    shapes = [(label, len(numbers)) for _, label, numbers, _ in lines]
    if not shapes or shapes.count(shapes[0]) < _FEWEST_BLOCKS:
        return None
    period = shapes.index(shapes[0], 1)
    block = shapes[:period]
    is_block = 1 < period <= _MOST_LABELS and len({label for label, _ in block}) == period
    repeats = -(-len(shapes) // period)
    return period if is_block and shapes == (block * repeats)[: len(shapes)] else None
