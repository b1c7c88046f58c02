"""Text tables with a row for each axis of a point, whose rows may hold a single number (PolyWorks).

    Name     Control  Nominal  Measured  Dev
    point 1  X                 477.206
    point 1  Y                 655.087
    point 1  Z                  68.906

The usual rule, the separator by which most cells are numbers, divides the names of such tables at their spaces.
"""

from collections.abc import Sequence

from datasets.importers.sources.tables.cells import split_cells

AXES = ("x", "y", "z")
_SEPARATORS = ("\t", ";", "|", ",")
_FEWEST_POINTS = 3
_LEAST_SHARE = 0.5  # of the rows with an axis, if others stand between them, such as distances


def find_axis_rows(lines: Sequence[str]) -> tuple[str, int, int] | None:
    """Separator, number of cells and index of the first row of a table with a row for each axis; None for others.

    Rows may have fewer cells, where empty ones at their end are not written.
    """
    for separator in _SEPARATORS:
        rows = _rows_with_axis(lines, separator)
        if are_axes([axis for _, _, axis in rows]):
            first = rows[0][0]
            header = split_cells(lines[first - 1], separator) if first else []
            return separator, max(len(header), *(width for _, width, _ in rows)), first
    return None


def _rows_with_axis(lines: Sequence[str], separator: str) -> list[tuple[int, int, str]]:
    """(index, number of cells, axis) of the lines with exactly one cell X, Y or Z."""
    found = []
    for number, line in enumerate(lines):
        cells = split_cells(line, separator)
        axes = [cell.lower() for cell in cells if cell.lower() in AXES]
        if len(axes) == 1 and len(cells) > 2:
            found.append((number, len(cells), axes[0]))
    # the last line may be cut off by the end of the sample
    return found[: len(found) // len(AXES) * len(AXES)]


def are_axes(words: Sequence[str]) -> bool:
    """Whether words are x, y, z again and again, for a few points at least."""
    count = len(words) // len(AXES)
    return count >= _FEWEST_POINTS and tuple(words) == AXES * count


def rows_of_axes(words: Sequence[str]) -> list[int] | None:
    """Rows of a column of words that hold x, y, z again and again; None for another column.

    Other words may stand between them, such as a distance after the three axes of a point.
    """
    rows = [row for row, word in enumerate(words) if word in AXES]
    is_most = len(rows) >= _LEAST_SHARE * len(words)
    return rows if is_most and are_axes([words[row] for row in rows]) else None
