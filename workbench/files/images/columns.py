"""Which columns of images.csv are covariates: all numbers that do not merely identify an image."""

from collections.abc import Mapping, Sequence

_IDENTIFIERS = {
    "image",
    "role",
    "placement",
    "scan",
    "step",
    "sample",
    "mirror_deg",
    "table_deg",
    "note",
}


def recorded_columns(rows: Sequence[Mapping]) -> list[str]:
    """Names of the columns that hold a number in every row, sorted."""
    if not len(rows):
        return []
    first = rows[0]
    names = [name for name in first if name not in _IDENTIFIERS and _is_number(first[name])]
    return sorted(name for name in names if all(_is_number(row.get(name)) for row in rows))


def _is_number(value) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
