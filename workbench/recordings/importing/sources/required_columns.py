"""Columns that a kind of measurement needs in addition to joint readings: the touched plane, the pair, ..."""

from dataclasses import replace

from datasets.errors import complaint
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from datasets.samples.columns import KINDS

_MEANINGS = {
    "plane": "the number of the plane that each row touches",
    "point": "the number of the point that each row touches",
    "sphere": "the number of the sphere that each row belongs to",
    "pair": "the number of the pair that each row belongs to",
    "length_mm": "the length between the two places of a pair",
}


def with_required_columns(table: RawTable, mapping: Mapping) -> Mapping:
    """The mapping with the columns of the table that have the names which `measures` needs.

    Raises InputError for a needed column that is neither there nor in the mapping.
    """
    kind = KINDS.get(mapping.measures)
    if kind is None:
        return mapping
    columns = dict(mapping.columns)
    for name in kind.columns:
        if name not in _MEANINGS or name in columns.values():
            continue
        same = [column for column in table.columns if column.strip().lower() == name]
        if not same:
            raise complaint(
                f'{table.file}, measures = "{mapping.measures}"',
                f"a column {name} with {_MEANINGS[name]}",
                f"{', '.join(list(table.columns)[:16])}",
                f'add the column, with one number in all rows for a single {name}, or write "its header" = "{name}" '
                "under [columns] in the mapping file",
            )
        columns[same[0]] = name
    return replace(mapping, columns=columns)
