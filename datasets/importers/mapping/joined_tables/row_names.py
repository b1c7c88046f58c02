"""Columns that name the rows of two tables: which of them belong together, however the names are written."""

import re
from collections.abc import Sequence
from itertools import product

import numpy as np

from datasets.importers.mapping.columns.sets import headers_of
from datasets.importers.source import RawTable

_KEYS = ("sample", "name", "pose")
OVERLAP = 0.9
"""Share of the names of a table that the other has to hold."""
_MOST = 0.5


def shared_keys(few: RawTable, many: RawTable):
    """Pairs of columns of both tables that may name the same rows: by their headers, then columns of one name."""
    mine = [(h.kind, h.core, name) for name, h in headers_of(few).items() if h.kind in _KEYS]
    its = [(h.kind, h.core, name) for name, h in headers_of(many).items() if h.kind in (*_KEYS,)]
    for kind, _, name in mine:
        for other_kind, _, other in its:
            if kind == other_kind:
                yield name, other
    places = {name.rpartition(": ")[2]: name for name in many.columns}
    for name, header in headers_of(few).items():
        other = places.get(name.rpartition(": ")[2])
        is_open = not header.kind and other is not None
        if is_open and may_name_rows(few.columns[name]) and may_name_rows(many.columns[other]):
            yield name, other


def other_keys(few: RawTable, many: RawTable):
    """Pairs of columns with different headers that may name the same rows: "No." with 7, and "Point" with P007.

    One of them has a header that says so; that of the other may be unknown.
    """
    mine, its = _possible_names(few), _possible_names(many)
    for (kind, name), (other_kind, other) in product(mine, its):
        if kind != other_kind:
            yield name, other


def repeated_keys(few: RawTable, many: RawTable):
    """Pairs of a column that names each row of one table once, and one that repeats these names in the other.

    Such as the poses of a joint log, and the group of each of several reflectors. Both hold most of the names, so that
    a column with the numbers of three reflectors is none of 45 poses.
    """
    for mine, its in product(_named_rows(few), _named_rows(many)):
        names = [set(part) for part in names_in_both(few.columns[mine], many.columns[its])]
        is_unique = [may_name_rows(few.columns[mine]), may_name_rows(many.columns[its])]
        is_same = len(names[0] & names[1]) >= _MOST * max(map(len, names))
        if is_same and any(is_unique) and not all(is_unique):
            yield mine, its


def _named_rows(table: RawTable) -> list[str]:
    """Columns without empty cells and with several values whose headers say that they name rows, or are unknown."""
    return [
        name
        for name, header in headers_of(table).items()
        if header.kind in (*_KEYS, "") and _is_filled(table.columns[name])
    ]


def _is_filled(cells: np.ndarray) -> bool:
    if cells.dtype.kind == "f":
        return bool(np.isfinite(cells).all() and (cells % 1 == 0).all())
    return all(_as_text(cells)) and len(set(_as_text(cells))) > 1


def _possible_names(table: RawTable) -> list[tuple[str, str]]:
    """(kind, column) of columns that may name rows, by headers that say so or that are unknown."""
    return [
        (header.kind, name)
        for name, header in headers_of(table).items()
        if header.kind in (*_KEYS, "") and may_name_rows(table.columns[name])
    ]


def unused_names(few: RawTable, many: RawTable) -> list[str]:
    """A sentence where tables are joined by row number although both name their rows."""
    names = differing_names(few, many)
    if not names:
        return []
    return [
        f"{few.file} and {many.file} are joined by row number: both have {few.n} rows, and {names}. If the rows are "
        'in different orders, give them the same names, or write [join] by = "key" into a mapping file for --map.'
    ]


def differing_names(few: RawTable, many: RawTable) -> str:
    """Contents of the first two columns that may name the rows of both tables; "" without such columns."""
    pairs = [
        (mine, its)
        for mine, its in shared_keys(few, many)
        if may_name_rows(few.columns[mine]) and may_name_rows(many.columns[its])
    ]
    if not pairs:
        return ""
    cells = zip(pairs[0], (few.columns[pairs[0][0]], many.columns[pairs[0][1]]), (few, many))
    said = [f"{table.file} has '{str(column[0])[:40]}' in {name}" for name, column, table in cells]
    return f"their names differ ({said[0]}, {said[1]})"


def may_name_rows(cells: np.ndarray) -> bool:
    """Whether cells are all filled and differ, and numbers are whole ones."""
    if cells.dtype.kind == "f" and not (np.isfinite(cells).all() and (cells % 1 == 0).all()):
        return False
    texts = _as_text(cells)
    return all(texts) and len(set(texts)) == len(texts)


def match_share(first: np.ndarray, second: np.ndarray) -> float:
    """Share of the values of the shorter list that the other holds; 0 where values repeat in both.

    A point that an instrument measured twice repeats in its table, and still belongs to one row of the joint table. A
    constant names no rows.
    """
    mine, its = names_in_both(first, second)
    is_repeated = [len(set(names)) < len(names) for names in (mine, its)]
    if all(is_repeated) or any(len(set(names)) == 1 < len(names) for names in (mine, its)):
        return 0.0
    return len(set(mine) & set(its)) / min(len(set(mine)), len(set(its)))


def names_in_both(first: np.ndarray, second: np.ndarray) -> tuple[list[str], list[str]]:
    """Names of the rows (or files) of two columns, simplified where they agree in nothing otherwise.

    "Arm::Poses::P001" and "P001" are one name if no two names of one table become equal, and so are "P1" and "p_001",
    and "P001" and "1" if all names of the table begin with "P".
    """
    mine, its = _as_text(first), _as_text(second)
    if set(mine) & set(its):
        return mine, its
    for simplify in (_without_groups, _plain_names, _numbers_of_names):
        plain = [simplify(names) for names in (mine, its)]
        is_distinct = all(len(set(p)) == len(set(n)) for p, n in zip(plain, (mine, its)))
        if is_distinct and set(plain[0]) & set(plain[1]):
            return plain[0], plain[1]
    return mine, its


def _without_groups(names: Sequence[str]) -> list[str]:
    """Names without the collection and group in front of them, as SpatialAnalyzer writes them."""
    return [name.rpartition("::")[2].strip() for name in names]


def _plain_names(names: Sequence[str]) -> list[str]:
    """Names without signs, and their numbers without leading zeros."""
    parts = [re.findall(r"\d+|[^\W\d_]+", name) for name in _without_groups(names)]
    return ["".join(part.lstrip("0") or "0" for part in found) for found in parts]


def _numbers_of_names(names: Sequence[str]) -> list[str]:
    """`_plain_names` without the letters that all names begin with."""
    plain = _plain_names(names)
    fronts = {re.match(r"\D*", name)[0] for name in plain}
    if len(fronts) > 1:
        return plain
    front = fronts.pop()
    return [name.removeprefix(front) for name in plain]


def _as_text(cells: np.ndarray) -> list[str]:
    if cells.dtype.kind == "f":
        return [f"{value:.12g}" for value in cells]
    return [str(cell).strip().lower() for cell in cells]
