"""Result of every importer: tables, images, clouds and a board, as in their files."""

from collections.abc import Mapping
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
    as the time; "" where the headers decide.
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

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.lines)

    @property
    def stem(self) -> str:
        """Name of the file without extension; prefix of columns whose names clash.

        Without folder, unless `file` begins with it because another table has the same name.
        """
        stem = Path(self.file).stem
        is_in_name = self.folder is not None and self.file.startswith(f"{self.folder.name}/")
        return f"{self.folder.name}/{stem}" if is_in_name else stem

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
