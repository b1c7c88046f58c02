"""The images of a recording: which there are of a role, where they lie, and work on them as a stream."""

import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import reduce
from pathlib import Path

import numpy as np

from datasets.recording_files.images import TEXT
from datasets.recording_files.rows import Rows
from sensors.images import read_grey
from sensors.stripe.clipping import Counts
from workbench.core.errors import InputError
from workbench.files.images.sweep import with_sweep

_GROUP = {"board-laser": "placement", "scan": "scan"}
"""Column that says which images with the laser belong to one sweep, by role."""


def by_role(recording, role: str) -> Rows:
    """Rows of images.csv with that role, in the file's order; of images with the laser also the sweep's direction.

    Raises InputError where the recording has no images at all.
    """
    if not recording.images:
        raise InputError(
            f"{recording.name}: expected a recording with images, found one of {recording.measures} "
            "without images.csv; name a board-images or scan-images recording"
        )
    rows = Rows.kept(recording.images, TEXT).where("role", role)
    if role in _GROUP:
        return with_sweep(rows, _GROUP[role])
    return rows


def path_of(recording, row: Mapping) -> Path:
    """Path of the image of a row."""
    return Path(recording.folder) / row["image"]


def check_size(camera, size: tuple[int, int], images: str, called: str) -> None:
    """Raise InputError where `called`, a file with a camera, is not of images of this size (width, height) px."""
    if tuple(camera.size) != tuple(size):
        raise InputError(
            f"{called}: expected the camera of images of {size[0]} x {size[1]} px, as {images} has, found one of "
            f"{camera.size[0]} x {camera.size[1]} px; name the file that was calibrated with these settings"
        )


def full_scale(recording, rows: Sequence[Mapping]) -> int | None:
    """Largest count that the camera of these images can give, from all of them; None where they are of 8 bits.

    One image tells its depth in the file, but not how many of 16 bits the camera fills: those are read once more.
    """

    def counts(row):
        grey = read_grey(path_of(recording, row), f"{recording.name}/{row['image']}")
        return Counts.of(grey)

    if (
        not rows
        or read_grey(path_of(recording, rows[0]), f"{recording.name}/{rows[0]['image']}").dtype
        != np.uint16
    ):
        return None
    return reduce(Counts.__or__, streamed(rows, counts, lambda done, of: None)).full


def streamed(rows: Sequence, work: Callable, tick: Callable[[int, int], None]) -> Iterator:
    """Results of `work` for each row, in order; only a few rows ahead are computed and kept in memory.

    tick: called with (done, all). The libraries that read and search images let go of the
    interpreter, so that threads keep every core busy.
    """
    waiting: deque = deque()
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(max_workers=cores) as pool:
        for rows_read, row in enumerate(rows, start=1):
            waiting.append(pool.submit(work, row))
            if len(waiting) > cores:
                yield waiting.popleft().result()
                tick(rows_read - len(waiting), len(rows))
        while waiting:
            yield waiting.popleft().result()
            tick(len(rows) - len(waiting), len(rows))
