"""Sections of one text file as tables of their own: a log of poses, and below it one of points with as many rows.

    Robot input:
    Print1=[559.22,-1576.65,1645.19],[0.32,0.10,0.91,0.23]
    ...
    Calibration input:
    P1=[327.50,1696.31,1629.44]
    ...

The reader of text takes the lines of one width. What stands below them, or above them and their header, is a second
section where it is a table with the same number of rows; other lines, such as a summary, stay unread, and the warning
says so.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from datasets.errors import InputError
from datasets.importers.source import RawTable
from datasets.importers.sources.tables.text_tables import encoding_of, read_text_table

_FEWEST = 4
_MOST_TITLES = 3  # lines above the rows of a section
_UNREAD = "after the table are not read"


def with_second_section(path: Path, table: RawTable) -> tuple[RawTable, ...]:
    """The table alone, or with that of the section above or below it, each with its number in the name of its file."""
    if table.n < _FEWEST:
        return (table,)
    first, last = int(table.lines[0]), int(table.lines[-1])
    upper = _table_in(path, slice(0, first - 1), table.n) if first > table.n else None
    if upper is not None:
        alone = _table_in(path, slice(int(upper.lines[-1]), None), table.n)
        if alone is not None and (alone.lines == table.lines).all():
            table = replace(alone, warnings=table.warnings)  # its names are no rows of the other
        return _numbered(path, (replace(upper, warnings=()), table))
    is_cut = any(_UNREAD in sentence for sentence in table.warnings)
    second = _table_in(path, slice(last, None), table.n) if is_cut else None
    if second is None or list(second.columns) == list(table.columns):
        return (table,)
    sentences = [text for text in table.warnings if _UNREAD not in text]
    end = int(second.lines[-1])
    if any(line.strip() for line in _lines_of(path)[end:]):
        sentences.append(
            f"{path.name}: the lines after row {end}, below both tables, are not read."
        )
    tables = (replace(table, warnings=tuple(sentences)), replace(second, warnings=()))
    return _numbered(path, tables)


def _numbered(path: Path, tables: Sequence[RawTable]) -> tuple[RawTable, ...]:
    names = [f"{path.stem} ({place}){path.suffix}" for place in (1, 2)]
    return tuple(replace(part, file=name) for part, name in zip(tables, names))


def _lines_of(path: Path) -> list[str]:
    return path.read_text(encoding=encoding_of(path), errors="replace").splitlines()


def _table_in(path: Path, part: slice, count: int) -> RawTable | None:
    """The first table with `count` rows in a part of the lines of a file; None without one."""
    lines = _lines_of(path)[part]
    with TemporaryDirectory() as folder:
        for first, end in _blocks(lines, count):
            block = Path(folder) / path.name
            block.write_text("\n".join(lines[first:end]) + "\n", encoding="utf-8")
            try:
                found = read_text_table(block)
            except InputError:
                continue
            if found.n == count:
                return replace(found, lines=found.lines + part.start + first)
    return None


def _blocks(lines: Sequence[str], count: int) -> Iterator[tuple[int, int]]:
    """Start and end of each run of lines that are not empty, with `count` rows and a title at most."""
    start = None
    for place, line in enumerate([*lines, ""]):
        if line.strip() and start is None:
            start = place
        if not line.strip() and start is not None:
            if count <= place - start <= count + _MOST_TITLES:
                yield start, place
            start = None
