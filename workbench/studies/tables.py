"""The table of a study: its parts are written atomically as they finish, and merged at the end one by one."""

import errno
import hashlib
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from workbench.core.errors import InputError
from workbench.core.text.csv_text import protect_text_columns
from workbench.files.runs import flush_to_disk
from workbench.studies.robots import Row

PARTS_FOLDER, TABLE, CSV = "parts", "table.parquet", "table.csv"


def write_part(folder: Path, number: int, rows: Sequence[Row]) -> None:
    """Write part `number` (0, 1, …) of the table atomically. Raises InputError if writing fails."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = dict.fromkeys(name for row in rows for name in row)
    table = pa.table({name: _column(pa, [row.get(name) for row in rows]) for name in names})
    buffer = pa.BufferOutputStream()
    pq.write_table(table, buffer, write_page_checksum=True)
    content = buffer.getvalue().to_pybytes()
    with replace_whole_file(folder / PARTS_FOLDER / _name(number, content)) as partial:
        partial.write_bytes(content)


def _column(pa, cells):
    """Integers, floats or text: the narrowest type of all cells; an empty column has floats."""
    kinds = {type(cell) for cell in cells if cell is not None}
    if kinds and kinds <= {int, bool}:
        return pa.array(cells, pa.int64())
    if kinds <= {int, bool, float}:
        return pa.array([None if cell is None else float(cell) for cell in cells], pa.float64())
    return pa.array([None if cell is None else str(cell) for cell in cells], pa.string())


def _name(number: int, content: bytes) -> str:
    """File name of a part; the checksum in it shows later whether the file is whole."""
    return f"part-{number:08d}-{_checksum(content)}.parquet"


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


@contextmanager
def replace_whole_file(path: Path) -> Iterator[Path]:
    """A temporary file in the folder of `path`, renamed to `path` if the block succeeds, else removed.

    Raises InputError if the system refuses, such as for a full disk or missing permission.
    """
    partial = path.with_name(f".partial-{os.getpid()}-{path.name}")
    try:
        yield partial
        flush_to_disk(partial)
        partial.replace(path)
    except OSError as problem:
        full = problem.errno in (errno.ENOSPC, errno.EDQUOT)
        why = "the disk is full" if full else f"the system says '{problem.strerror}'"
        raise InputError(
            f"{path} cannot be written: {why}. Free space or name another folder with --out; the same command "
            "continues the study"
        ) from problem
    finally:
        partial.unlink(missing_ok=True)


def parts_done(folder: Path) -> set[int]:
    """Numbers of the existing parts."""
    return set(_part_files(folder))


def remove_damaged_parts(folder: Path) -> int:
    """Remove parts that differ from their checksum, as after a loss of power; returns their number."""
    damaged = []
    for path in (folder / PARTS_FOLDER).glob("part-*.parquet"):
        if _checksum(path.read_bytes()) != path.stem.rpartition("-")[2]:
            damaged.append(path)
    for path in damaged:
        path.unlink()
    return len(damaged)


def _part_files(folder: Path) -> dict[int, Path]:
    """File of each existing part by its number."""
    return {
        int(path.stem.split("-")[1]): path
        for path in (folder / PARTS_FOLDER).glob("part-*.parquet")
    }


def put_together(folder: Path, count: int) -> None:
    """Write table.parquet and table.csv from parts 0 … `count` - 1, one part in memory at a time.

    A column that some runs lack has empty cells. The rows are in order of the run numbers.
    """
    import pyarrow as pa
    import pyarrow.csv as pc
    import pyarrow.parquet as pq

    files = _part_files(folder)
    paths = [files[number] for number in range(count)]
    schema = _schema(pa, (pq.read_schema(path) for path in paths))
    csv_schema = protect_text_columns(schema.empty_table()).schema
    with replace_whole_file(folder / TABLE) as table, replace_whole_file(folder / CSV) as text:
        with (
            pq.ParquetWriter(table, schema, write_page_checksum=True) as writer,
            pc.CSVWriter(text, csv_schema) as lines,
        ):
            for path in paths:
                joined_table = _as(pa, pq.read_table(path, page_checksum_verification=True), schema)
                writer.write_table(joined_table)
                lines.write_table(protect_text_columns(joined_table))


def _schema(pa, schemas):
    """All columns in order of appearance, each with the widest type of its parts (text, float, integer)."""
    rank = [pa.int64(), pa.float64(), pa.string()]
    kinds = {}
    for schema in schemas:
        for field in schema:
            kinds[field.name] = max(kinds.get(field.name, 0), rank.index(field.type))
    kinds["outcome"] = kinds.pop("outcome", 2)
    return pa.schema([(name, rank[kind]) for name, kind in kinds.items()])


def _as(pa, table, schema):
    columns = [
        table.column(field.name).cast(field.type)
        if field.name in table.column_names
        else pa.nulls(table.num_rows, field.type)
        for field in schema
    ]
    return pa.table(columns, schema=schema)


def column_names(folder: Path) -> list[str]:
    """Columns of the whole table."""
    import pyarrow.parquet as pq

    return list(pq.read_schema(folder / TABLE).names)


def columns(folder: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Some columns of the whole table: numbers (n,) with nan where empty, text as object arrays."""
    import pyarrow.parquet as pq
    from pyarrow import types

    table = pq.read_table(folder / TABLE, columns=list(names), memory_map=True)
    return {
        name: np.array(column.to_pylist(), object)
        if types.is_string(column.type)
        else column.cast("float64").to_numpy().astype(float)
        for name, column in zip(table.column_names, table.columns)
    }
