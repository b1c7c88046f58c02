"""A mapping proposed from several tables of which nothing says how their rows belong together."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from datasets.importers.mapping.joined_tables.joining import with_own_names
from datasets.importers.mapping.left_out import unused_columns
from datasets.importers.mapping.model import Mapping
from datasets.importers.mapping.proposal import measures_of, propose
from datasets.importers.source import RawTable, with_distinct_stems
from datasets.importers.sources import read_sources


def propose_unjoined(paths: Sequence[Path], options, scratch: Path) -> tuple[Mapping, str] | None:
    """The mapping that the headers of all tables suggest, and comment lines with the open join; None for one table.

    options: `ImportOptions`.
    """
    source = read_sources(paths, scratch)
    tables = list(source.tables)
    if len(tables) < 2 or source.images or source.clouds:
        return None
    if len(tables) == 2:
        tables = list(with_own_names(*with_distinct_stems(tables)))
    mapping = options.mapping
    for table in tables:
        proposed = propose(table, stated=options.mapping).mapping
        columns = {**proposed.columns, **mapping.columns}
        mapping = replace(mapping.merged(proposed), columns=columns)
    measures = mapping.measures or (measures_of(mapping) if mapping.point is not None else None)
    return replace(mapping, measures=measures), _open_join(tables, mapping)


def _open_join(tables: Sequence[RawTable], mapping: Mapping) -> str:
    """Comment lines with the ways of joining and the columns that may name the rows."""
    lines = [
        "The rows of these tables could not be joined. Add one of the following, without the number signs:",
        "",
        "[join]",
        'by = "key"',
        'key = "FILL IN: a column"   # with the same names or numbers in both tables; rename one where they differ',
        "",
        "[join]",
        'by = "time"                 # a column of each table as "..." = "time_s" under [columns]',
        "",
    ]
    for table in tables:
        free = [
            f"'{name}' ({table.columns[name][0]}, ...)" for name in unused_columns(table, mapping)
        ]
        lines.append(f"Columns of {table.file} that are not used yet: {', '.join(free) or 'none'}")
    return "".join(f"# {line}".rstrip() + "\n" for line in lines)
