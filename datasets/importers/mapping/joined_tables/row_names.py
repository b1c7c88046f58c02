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
_MAX_SHARE = 0.5


def shared_keys(shorter: RawTable, longer: RawTable):
    """Pairs of columns of both tables that may name the same rows: by their headers, then columns of one name."""
    short_headers = [
        (h.kind, h.core, name) for name, h in headers_of(shorter).items() if h.kind in _KEYS
    ]
    its = [(h.kind, h.core, name) for name, h in headers_of(longer).items() if h.kind in (*_KEYS,)]
    for kind, _, name in short_headers:
        for other_kind, _, other in its:
            if kind == other_kind:
                yield name, other
    places = {name.rpartition(": ")[2]: name for name in longer.columns}
    for name, header in headers_of(shorter).items():
        other = places.get(name.rpartition(": ")[2])
        is_open = not header.kind and other is not None
        if (
            is_open
            and may_name_rows(shorter.columns[name])
            and may_name_rows(longer.columns[other])
        ):
            yield name, other


def other_keys(shorter: RawTable, longer: RawTable):
    """Pairs of columns with different headers that may name the same rows: "No." with 7, and "Point" with P007.

    One of them has a header that says so; that of the other may be unknown.
    """
    short_names, long_names = _possible_names(shorter), _possible_names(longer)
    for (kind, name), (other_kind, other) in product(short_names, long_names):
        if kind != other_kind:
            yield name, other


def repeated_keys(shorter: RawTable, longer: RawTable):
    """Pairs of a column that names each row of one table once, and one that repeats these names in the other.

    Such as the poses of a joint log, and the group of each of several reflectors. Both hold most of the names, so that
    a column with the numbers of three reflectors is none of 45 poses.
    """
    for column, other_column in product(_named_rows(shorter), _named_rows(longer)):
        names = [
            set(part)
            for part in names_in_both(shorter.columns[column], longer.columns[other_column])
        ]
        is_unique = [
            may_name_rows(shorter.columns[column]),
            may_name_rows(longer.columns[other_column]),
        ]
        is_same = len(names[0] & names[1]) >= _MAX_SHARE * max(map(len, names))
        if is_same and any(is_unique) and not all(is_unique):
            yield column, other_column


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


def unused_names(shorter: RawTable, longer: RawTable) -> list[str]:
    """A sentence where tables are joined by row number although both name their rows."""
    names = differing_names(shorter, longer)
    if not names:
        return []
    return [
        f"{shorter.file} and {longer.file} are joined by row number: both have {shorter.n} rows, and {names}. If the "
        "rows are "
        'in different orders, give them the same names, or write [join] by = "key" into a mapping file for --map.'
    ]


def differing_names(shorter: RawTable, longer: RawTable) -> str:
    """Contents of the first two columns that may name the rows of both tables; "" without such columns."""
    pairs = [
        (short_column, other_column)
        for short_column, other_column in shared_keys(shorter, longer)
        if may_name_rows(shorter.columns[short_column])
        and may_name_rows(longer.columns[other_column])
    ]
    if not pairs:
        return ""
    cells = zip(
        pairs[0], (shorter.columns[pairs[0][0]], longer.columns[pairs[0][1]]), (shorter, longer)
    )
    sentences = [
        f"{table.file} has '{str(column[0])[:40]}' in {name}" for name, column, table in cells
    ]
    return f"their names differ ({sentences[0]}, {sentences[1]})"


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
    first_names, second_names = names_in_both(first, second)
    is_repeated = [len(set(names)) < len(names) for names in (first_names, second_names)]
    if all(is_repeated) or any(
        len(set(names)) == 1 < len(names) for names in (first_names, second_names)
    ):
        return 0.0
    return len(set(first_names) & set(second_names)) / min(
        len(set(first_names)), len(set(second_names))
    )


def names_in_both(first: np.ndarray, second: np.ndarray) -> tuple[list[str], list[str]]:
    """Names of the rows (or files) of two columns, simplified where they agree in nothing otherwise.

    "Arm::Poses::P001" and "P001" are one name if no two names of one table become equal, and so are "P1" and "p_001",
    and "P001" and "1" if all names of the table begin with "P".
    """
    first_names, second_names = _as_text(first), _as_text(second)
    if set(first_names) & set(second_names):
        return first_names, second_names
    for simplify in (_without_groups, _plain_names, _numbers_of_names):
        plain = [simplify(names) for names in (first_names, second_names)]
        is_distinct = all(
            len(set(p)) == len(set(n)) for p, n in zip(plain, (first_names, second_names))
        )
        if is_distinct and set(plain[0]) & set(plain[1]):
            return plain[0], plain[1]
    return first_names, second_names


def _without_groups(names: Sequence[str]) -> list[str]:
    """Names without the collection and group in front of them, as SpatialAnalyzer writes them."""
    return [name.rpartition("::")[2].strip() for name in names]


def _plain_names(names: Sequence[str]) -> list[str]:
    """Names without signs, and their numbers without leading zeros."""
    name_parts = [re.findall(r"\d+|[^\W\d_]+", name) for name in _without_groups(names)]
    return ["".join(part.lstrip("0") or "0" for part in found) for found in name_parts]


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
