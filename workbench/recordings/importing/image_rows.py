"""Which image belongs to which row of a pose table: by file names, by time, or by the order of both."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datasets.importers.mapping.joining import seconds_of
from datasets.importers.source import ImageFile, RawTable
from datasets.importers.sources.choice import natural_order
from workbench.core.errors import InputError

_FEWEST = 4
_IMAGE_GAP_S = 0.2
_TIME_NAME = re.compile(r"1\d{9}(?:\.\d+|\d{3}|\d{6}|\d{9})?")


def matched_rows(
    images: Sequence[ImageFile], table: RawTable
) -> tuple[list[tuple[ImageFile, int]], tuple[str, ...]]:
    """Image and row of the table that belong together: by file name, by time, or by order.

    Raises InputError where neither file names nor times nor equal numbers connect them.
    """
    images = sorted(images, key=lambda image: natural_order(image.name))
    named = _by_name(images, table)
    if named:
        return named, _left_out(len(images), table.n, len(named))
    timed = _by_time(images, table)
    if timed:
        return timed, _left_out(len(images), table.n, len(timed))
    if len(images) != table.n:
        raise InputError(
            f"{table.file}: expected as many rows as images or a column with the names of the image files, found "
            f"{table.n} rows and {len(images)} images; add a column image to the table."
        )
    return [(image, row) for row, image in enumerate(images)], ()


def _by_name(images, table: RawTable) -> list[tuple[ImageFile, int]]:
    """Pairs by a text column with file names, or by a number that the file names end with."""
    return _name_column(images, table)[0]


def file_link(files: Sequence[ImageFile | Path], table: RawTable) -> tuple[tuple[str, ...], str]:
    """Name of the column that holds the names of images or clouds, () where none does; and how rows find their file."""
    column = _name_column(files, table)[1]
    if column:
        return column, "names of the files"
    if all(isinstance(file, ImageFile) for file in files) and _by_time(files, table):
        return (), "the nearest time"
    return (), "rows and files in the order of their names"


def _name_column(images, table: RawTable):
    """Pairs of image and row, and the column that connects them."""
    places = {Path(image.name).name.lower(): image for image in images}
    stems = {Path(image.name).stem.lower(): image for image in images}
    for column, cells in table.columns.items():
        if cells.dtype.kind == "f":
            continue
        names = [Path(str(cell).replace("\\", "/")).name.lower() for cell in cells]
        pairs = [
            (places.get(name) or stems.get(Path(name).stem), row) for row, name in enumerate(names)
        ]
        kept = [(image, row) for image, row in pairs if image is not None]
        if len(kept) >= max(_FEWEST, table.n // 2):
            return kept, (column,)
    return [], ()


def _by_time(images, table: RawTable) -> list[tuple[ImageFile, int]]:
    seconds, times = seconds_of(table), image_times([image.time_s for image in images], images)
    if seconds is None or times is None or len(images) == table.n:
        return []
    pairs = []
    for image, time_s in zip(images, times):
        row = int(np.argmin(np.abs(seconds - time_s)))
        if abs(seconds[row] - time_s) <= _IMAGE_GAP_S:
            pairs.append((image, row))
    return pairs if len(pairs) >= _FEWEST else []


def image_times(stamps, images) -> list[float] | None:
    """s of the images: their time stamps, or their names where these are times since 1970; None without either.

    Names of 19, 16, 13 and 10 digits are in ns, us, ms and s, as recorders for ROS and EuRoC write them.
    """
    if all(stamp is not None for stamp in stamps):
        return list(stamps)
    stems = [Path(image.name).stem for image in images]
    if not all(_TIME_NAME.fullmatch(stem) for stem in stems):
        return None
    digits = {len(stem.partition(".")[0]) for stem in stems}
    if len(digits) > 1:
        return None
    unit = 10.0 ** (10 - digits.pop())
    return [unit * float(stem) for stem in stems]


def _left_out(images: int, rows: int, used: int) -> tuple[str, ...]:
    if used == images == rows:
        return ()
    return (f"{used} of {images} images have a pose among {rows} rows; the others are left out.",)
