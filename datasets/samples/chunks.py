"""A recording that is too long for memory: its samples.parquet checked once, then read a few thousand rows at a
time."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.files import check_file, label
from datasets.formats.recording1 import checked, read_head
from datasets.formats.table import Table, arrow_table, parquet_errors
from datasets.recording import Recording
from datasets.samples.checks import Context, check_samples
from datasets.samples.columns import TEXT
from datasets.samples.duplicates import (
    agree_by_rounding,
    first_of_each_key,
    measurement_keys,
    row_hashes,
)

ROWS = 8192
_NUMBERED = {
    "external-point": "reflector",
    "external-pose": "reflector",
    "partial-pose": "reflector",
    "ball-centre": "ball",
}
"""Kinds whose rows can be read apart, and the column that says which target a row saw."""
_THIN = 5000
_SHOWN = 8


@dataclass(frozen=True)
class Chunks:
    """`head` without columns; `n` moving rows in the file at `path`; `thin` some five to ten thousand of them, evenly
    spread
    and in order; `first_rows` one row of every target that is seen; `pose` (n,) a label that repeats of one pose share.
    `copies`: numbers of the moving rows that repeat an earlier row exactly; they are left out of everything.
    """

    head: Recording
    path: Path
    n: int
    thin: Recording
    first_rows: Recording
    pose: np.ndarray
    copies: np.ndarray

    def __iter__(self) -> Iterator[Recording]:
        """The moving rows in order, some thousand at a time, each with its number as column `row`."""
        first = 0
        for table in _tables(self.path):
            made = _moving(replace(self.head, columns=dict(table.columns)))
            rows = np.arange(first, first + made.n)
            first += made.n
            kept = ~np.isin(rows, self.copies)
            if kept.any():
                yield numbered(made, rows).select(kept)


def numbered(recording: Recording, rows: np.ndarray) -> Recording:
    """The recording with the number of each row as a column, which effects that drift read where there is no time."""
    return replace(recording, columns=recording.columns | {"row": rows.astype(float)})


def read_chunks(folder: Path, trust_data: bool = False) -> Chunks:
    """A recording folder whose samples are a Parquet file; every row is checked as `datasets.read` does.

    What only the whole recording can show (units, mixed-up balls) is judged on rows spread over all of it. Raises
    InputError, also for kinds whose rows say nothing alone. trust_data: as of `datasets.read`.
    """
    head, path, context = read_head(Path(folder), trust_data)
    if head.measures not in _NUMBERED:
        raise complaint(
            f"{head.name}/recording.toml, key measures",
            f"one of {', '.join(_NUMBERED)} to read in chunks",
            head.measures,
            "use `workbench calibrate`",
        )
    if path.suffix.lower() not in (".parquet", ".pq"):
        raise complaint(
            label(path),
            "a .parquet file to read in chunks",
            f"the ending {path.suffix!r}",
            "save the samples as samples.parquet, or use `workbench calibrate`",
        )
    check_file(path, label(path), ".parquet")
    numbers, poses, thin, first_rows, ids, keys = 0, [], [], {}, [], []
    step = max(_rows_of(path) // _THIN, 1)
    for table in _tables(path):
        _check(table, context)
        ids.append(table.columns["sample"].astype(np.int64))
        made = _moving(replace(head, columns=dict(table.columns)))
        made = numbered(made, np.arange(numbers, numbers + made.n))
        _first_of_each(made, _NUMBERED[head.measures], first_rows)
        poses.append(pose_labels(made))
        keys.append(row_hashes(measurement_keys(made)))
        thin.append(made.select(np.flatnonzero(_chosen(numbers + np.arange(made.n), step))))
        numbers += made.n
    _check_unique(np.concatenate(ids), label(path))
    sample = _joined(thin)
    plain = {k: v for k, v in sample.columns.items() if k != "row"}
    warnings = checked(Table(label(path), plain, sample.sample_ids), context)[1]
    copies = _copies(np.concatenate(keys), sample)
    if copies.size:
        warnings = (*warnings, _copies_sentence(head, numbers, copies))
    warnings = (*head.remarks, *warnings)
    head = replace(head, warnings=warnings)
    sample = replace(sample.select(~np.isin(sample.columns["row"], copies)), warnings=warnings)
    pose = np.delete(np.concatenate(poses), copies)
    targets = _joined([first_rows[key] for key in sorted(first_rows)])
    return Chunks(head, path, numbers - copies.size, sample, targets, pose, copies)


def _copies(hashes: np.ndarray, thin: Recording) -> np.ndarray:
    """Numbers of the moving rows that repeat an earlier one; thin: rows that show how coarsely values are rounded."""
    first = np.unique(hashes, return_index=True)[1]
    copies = np.setdiff1d(np.arange(len(hashes)), first, assume_unique=True)
    if copies.size and agree_by_rounding(thin, first_of_each_key(thin)):
        return copies[:0]
    return copies


def _copies_sentence(head: Recording, rows: int, copies: np.ndarray) -> str:
    shown = ", ".join(str(row + 1) for row in copies[:_SHOWN])
    remainder = f" and {copies.size - _SHOWN} more" if copies.size > _SHOWN else ""
    return (
        f"samples of recording '{head.name}': {copies.size} of {rows} moving rows repeat the joint readings and the "
        f"measured values of an earlier row exactly (moving row {shown}{remainder}); a copy is no further measurement "
        "and is counted once; remove these rows, or export the measurements again if they were repeated."
    )


def _chosen(rows: np.ndarray, step: int) -> np.ndarray:
    """(k,) bool: about one row in `step`, as good as at random: where reflectors take turns a stride would miss some.

    Knuth, The Art of Computer Programming 3, sec. 6.4: multiplicative hashing.
    """
    return (rows.astype(np.uint64) * np.uint64(2654435761) % np.uint64(2**32)) < np.uint64(
        2**32 // step
    )


def _rows_of(path: Path) -> int:
    import pyarrow.parquet as pq

    with parquet_errors(label(path)):
        return pq.ParquetFile(path).metadata.num_rows


def _tables(path: Path) -> Iterator[Table]:
    """The file's rows, one row group and then `ROWS` of it in memory."""
    import pyarrow.parquet as pq

    first = 1
    checked = dict(memory_map=False, page_checksum_verification=True)
    with parquet_errors(label(path)), pq.ParquetFile(path, **checked) as file:
        for batch in file.iter_batches(ROWS, use_threads=False):
            yield arrow_table(batch, label(path), TEXT, first)
            first += batch.num_rows


def _check(table: Table, context: Context) -> None:
    if "fixed_to" in table.columns:
        fixed = table.columns["fixed_to"]
        table.columns["fixed_to"] = np.where(fixed == "", "tool", fixed)
        if not (table.columns["fixed_to"] == "tool").any():
            return  # a part in which nothing moves is no fault of the whole
    check_samples(table, context)


def _check_unique(ids: np.ndarray, called: str) -> None:
    known, count = np.unique(ids, return_counts=True)
    if len(known) < len(ids):
        raise complaint(
            f"{called}, column sample",
            "every number once",
            f"{known[count > 1][0]} twice",
            "number the rows",
        )


def _moving(recording: Recording) -> Recording:
    return recording.select(recording.moving)


def _first_of_each(made: Recording, column: str, first_rows: dict) -> None:
    for number, row in zip(*np.unique(getattr(made, column), return_index=True)):
        first_rows.setdefault(int(number), made.select(np.array([row])))


def _joined(recordings: list[Recording]) -> Recording:
    names = recordings[0].columns
    return replace(
        recordings[0],
        columns={
            name: np.concatenate([part.columns[name] for part in recordings]) for name in names
        },
    )


def pose_labels(recording: Recording) -> np.ndarray:
    """(n,) 64-bit labels that rows of one `pose`, of one `repeat`, or else of the same readings (1e-4 rad) share.

    Unlike `Recording.poses` they need no other row, and do not link rows through others.
    """
    for name in ("pose", "repeat"):
        if name in recording.columns:
            return recording.columns[name].astype(np.int64)
    return row_hashes(recording.joints.round(4)).view(np.int64)
