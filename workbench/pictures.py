"""The pictures of a recording: which there are of a role, where they lie, and work on them as a stream."""

import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from workbench.core.errors import InputError


def by_role(recording, role: str) -> list[Mapping]:
    """Rows of images.csv with that role, in the file's order.

    Raises InputError where the recording has no pictures at all.
    """
    if not recording.images:
        raise InputError(
            f"{recording.name}: expected a recording with pictures, found one of {recording.measures} "
            "without images.csv; name a board-images or scan-images recording"
        )
    return [row for row in recording.images if row["role"] == role]


def path_of(recording, row: Mapping) -> Path:
    """Where the picture of a row lies."""
    return Path(recording.folder) / row["image"]


def streamed(rows: Sequence, work: Callable, tick: Callable[[int, int], None]) -> Iterator:
    """What `work` makes of each row, in order; a few rows ahead at a time, so that no more are in memory.

    tick: called with (done, all). The libraries that read and search pictures let go of the
    interpreter, so that threads keep every core busy.
    """
    waiting: deque = deque()
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(max_workers=cores) as pool:
        for taken, row in enumerate(rows, start=1):
            waiting.append(pool.submit(work, row))
            if len(waiting) > cores:
                yield waiting.popleft().result()
                tick(taken - len(waiting), len(rows))
        while waiting:
            yield waiting.popleft().result()
            tick(len(rows) - len(waiting), len(rows))
