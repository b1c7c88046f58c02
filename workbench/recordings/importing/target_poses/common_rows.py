"""Rows of two tables that belong together by the names or numbers of both, such as those of one file for each pose."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datasets.importers.mapping.columns.sets import headers_of
from datasets.importers.mapping.joined_tables.row_names import may_name_rows, names_in_both
from datasets.importers.source import RawTable
from workbench.recordings.importing.board_images.image_rows import are_shifted

_KINDS = ("image", "name", "sample", "pose")
"""Kinds of headers over names of rows; those of files and images first."""
_FEWEST = 4
_LEAST_SHARE = 0.5
_MOST_LISTED = 5


def with_common_rows(tables: Sequence[RawTable]) -> tuple[Sequence[RawTable], tuple[str, ...]]:
    """Two tables with the rows that both name, in one order, and sentences on the others; all else as it is.

    Numbers from 0 in one table and from 1 in the other name no common rows: their order decides.
    """
    if len(tables) != 2:
        return tables, ()
    for kind in _KINDS:
        named = _named_rows(tables, kind)
        if named is None:
            continue
        first, second = named
        order = [name for name in first if name in second]
        fewest = min(len(first), len(second))
        is_enough = len(order) >= max(_FEWEST, _LEAST_SHARE * fewest)
        is_to_do = first != second and not are_shifted(first, second)
        if is_enough and is_to_do:
            sentences = _sentences(tables, named)
            common = [
                _in_order(tables[0], first, order),
                _in_order(tables[1], second, order),
            ]
            return common, sentences
    return tables, ()


def _in_order(table: RawTable, names: list[str], order: list[str]) -> RawTable:
    """The rows of a table, which have `names`, in the order of some of these."""
    rows = [names.index(name) for name in order]
    return table.take(np.array(rows))


def _named_rows(tables: Sequence[RawTable], kind: str) -> tuple[list[str], list[str]] | None:
    """Names of the rows of both tables, by columns of a kind; None where a table has none."""
    cells = []
    for table in tables:
        column = _name_column(table, kind)
        if column is None:
            return None
        cells.append(table.columns[column])
    if kind == "image":
        cells = [_without_extension(part) for part in cells]
    return names_in_both(cells[0], cells[1])


def _without_extension(cells: np.ndarray) -> np.ndarray:
    """Names of files without folder and extension."""
    stems = [Path(str(cell)).stem for cell in cells]
    return np.array(stems)


def _name_column(table: RawTable, kind: str) -> str | None:
    """The column of a kind that names each row once; None without one."""
    for name, header in headers_of(table).items():
        is_of_kind = header.kind == kind
        if is_of_kind and may_name_rows(table.columns[name]):
            return name
    return None


def _sentences(tables, names) -> tuple[str, ...]:
    """The rows without a partner, and that the rows of the tables are in different orders, where they are."""
    first, second = tables
    sentences = [
        _left_out(first, second, names[0], names[1]),
        _left_out(second, first, names[1], names[0]),
    ]
    orders = [
        [name for name in names[0] if name in names[1]],
        [name for name in names[1] if name in names[0]],
    ]
    if orders[0] != orders[1]:
        sentences.append(
            f"The rows of {first.file} and {second.file} are in different orders and are joined by their names."
        )
    return tuple(filter(None, sentences))


def _left_out(table: RawTable, other: RawTable, names, other_names) -> str:
    """A sentence on the rows of a table whose names the other one lacks; "" without any."""
    lonely = [name for name in names if name not in other_names]
    if not lonely:
        return ""
    listed = ", ".join(lonely[:_MOST_LISTED])
    if len(lonely) > _MOST_LISTED:
        listed = f"{listed}, ..."
    return (
        f"{table.file}: {len(lonely)} of {table.n} rows ({listed}) have no row of the same name in {other.file} and "
        "are left out."
    )
