"""Result of every importer: tables, images, clouds and a board, as in their files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.formats.table import is_number


@dataclass(frozen=True, eq=False)
class RawTable:
    """A table of n rows in the units of its file.

    `columns`: (n,) float64 with nan for empty cells, or (n,) str. `lines` (n,): line or row number in the file.
    `units`: unit that a row of units or the format states, by column. `conventions`: rotation convention that the
    format states, by the first column of the rotation. `default_units`: unit of a quantity ("length", "angle")
    that the file states for all its columns. `frame_question`: why its poses are not known to be those of the flange.
    `folder`: where the file lies, None where it was not read from one. `time_name`: the column that a mapping names
    as the time; "" where the headers decide. `sheet`: title of the sheet of a workbook. `prefix`: as `stem`, where
    another table has the same.
    """

    file: str
    columns: Mapping[str, np.ndarray]
    lines: np.ndarray
    units: Mapping[str, str] = field(default_factory=dict)
    conventions: Mapping[str, str] = field(default_factory=dict)
    default_units: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    frame_question: str = ""
    folder: Path | None = None
    time_name: str = ""
    sheet: str = ""
    prefix: str = ""

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.lines)

    @property
    def stem(self) -> str:
        """Name of the file without folder and extension; prefix of columns whose names clash."""
        return self.prefix or Path(self.file).stem

    @property
    def place(self) -> str:
        """Name of the folder; "" for the current one."""
        return "" if self.folder is None else self.folder.name

    def numbers(self, name: str) -> np.ndarray:
        """(n,) float64 cells of a column.

        Raises InputError with file, row and column where a cell holds text.
        """
        cells = self.columns[name]
        if cells.dtype.kind == "f":
            return cells
        for row, cell in enumerate(cells):
            if cell and not is_number(cell):
                raise complaint(
                    f"{self.file}, row {self.lines[row]}, column {name}",
                    "a number",
                    repr(str(cell)),
                    "correct the cell or map another column",
                )
        return np.array([float(cell) if cell else np.nan for cell in cells])

    def take(self, rows: np.ndarray) -> "RawTable":
        """The table with only `rows`, indices in the wanted order."""
        columns = {name: cells[rows] for name, cells in self.columns.items()}
        return replace(self, columns=columns, lines=self.lines[rows])


@dataclass(frozen=True)
class ImageFile:
    """An image: where it lies, its name in the source, and its time stamp (s) where one is known."""

    path: Path
    name: str
    time_s: float | None = None


@dataclass(frozen=True)
class Source:
    """All that was found in the named files and folders."""

    tables: tuple[RawTable, ...] = ()
    images: tuple[ImageFile, ...] = ()
    clouds: tuple[Path, ...] = ()
    board: Mapping | None = None
    camera: Mapping | None = None
    warnings: tuple[str, ...] = ()

    def __add__(self, other: "Source") -> "Source":
        return Source(
            self.tables + other.tables,
            self.images + other.images,
            self.clouds + other.clouds,
            other.board if self.board is None else self.board,
            other.camera if self.camera is None else self.camera,
            self.warnings + other.warnings,
        )


def with_distinct_stems(tables: Sequence[RawTable]) -> list[RawTable]:
    """Tables that are joined; folder or sheet, else a number, distinguishes those of the same stem.

    With the folder, messages name the file by it, too.
    """
    made = list(tables)
    by_stem: dict[str, list[int]] = {}
    for k, table in enumerate(tables):
        by_stem.setdefault(table.stem, []).append(k)
    for places in by_stem.values():
        if len(places) > 1:
            for k, table in zip(places, _distinct([tables[k] for k in places])):
                made[k] = table
    return made


def _distinct(tables: Sequence[RawTable]) -> list[RawTable]:
    """Tables of the same stem with prefixes that differ."""
    folders = ["/".join(filter(None, (table.place, table.stem))) for table in tables]
    if len(set(folders)) == len(tables):
        return [
            replace(table, prefix=prefix, file="/".join(filter(None, (table.place, table.file))))
            for table, prefix in zip(tables, folders)
        ]
    sheets = [f"{table.stem} {table.sheet}" for table in tables]
    if len(set(sheets)) < len(tables):
        sheets = [f"{table.stem} {number}" for number, table in enumerate(tables, 1)]
    return [replace(table, prefix=prefix) for table, prefix in zip(tables, sheets)]
