"""Which image belongs to which row of a pose table: by file names, by time, or by the order of both."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datasets.importers.mapping.columns.sets import headers_of
from datasets.importers.mapping.joined_tables.joining import seconds_of
from datasets.importers.mapping.joined_tables.row_names import may_name_rows, names_in_both
from datasets.importers.source import ImageFile, RawTable
from datasets.importers.sources.choice import natural_order
from workbench.core.errors import InputError

_FEWEST = 4
_MOST_SHOWN = 12
_KINDS_OF_NAMES = ("image", "name", "sample", "pose", "")
"""Kinds of headers over numbers or names of images, the surest first; coordinates and joint readings are none."""
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
        return named, _left_out(images, table, named)
    timed = _by_time(images, table)
    if timed:
        return timed, _left_out(images, table, timed)
    if len(images) != table.n:
        raise InputError(
            f"{table.file}: expected as many rows as images or a column with the names of the image files, found "
            f"{table.n} rows and {len(images)} images; add a column image to the table."
        )
    pairs = [(image, row) for row, image in enumerate(images)]
    return pairs, ()


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
    min_pairs = max(_FEWEST, table.n // 2)
    for column, cells in table.columns.items():
        matched = _equal_names(images, cells)
        if len(matched) >= min_pairs:
            return matched, (column,)
    kinds = {column: header.kind for column, header in headers_of(table).items()}
    for kind in _KINDS_OF_NAMES:
        for column in (column_name for column_name, found in kinds.items() if found == kind):
            matched = _simplified_names(images, table.columns[column])
            if len(matched) >= min_pairs:
                return matched, (column,)
    return [], ()


def _equal_names(images, cells: np.ndarray) -> list[tuple[ImageFile, int]]:
    """Pairs of image and row whose cell is the name of the file, with or without folder and extension."""
    if cells.dtype.kind == "f":
        return []
    places = {Path(image.name).name.lower(): image for image in images}
    stems = {Path(image.name).stem.lower(): image for image in images}
    names = [Path(str(cell).replace("\\", "/")).name.lower() for cell in cells]
    pairs = [
        (places.get(name) or stems.get(Path(name).stem), row) for row, name in enumerate(names)
    ]
    return [(image, row) for image, row in pairs if image is not None]


def _simplified_names(images, cells: np.ndarray) -> list[tuple[ImageFile, int]]:
    """Pairs of image and row by `names_in_both`: "Bild 1", "001", "1.png", 1 and img_001.png are one name.

    None where rows and images are numbered from different starts, as from 0 and from 1: their order then decides.
    """
    if not may_name_rows(cells):
        return []
    if cells.dtype.kind != "f":
        cells = np.array([Path(str(cell).replace("\\", "/")).stem for cell in cells])
    stems = np.array([Path(image.name).stem for image in images])
    rows, files = names_in_both(cells, stems)
    place = dict(zip(files, images))
    if len(place) < len(images) or are_shifted(rows, files):
        return []
    return [(place[name], row) for row, name in enumerate(rows) if name in place]


def are_shifted(first: Sequence[str], second: Sequence[str]) -> bool:
    """Whether two lists count equally many neighbouring numbers from different starts."""
    if len(first) != len(second) or not all(name.isdigit() for name in (*first, *second)):
        return False
    numbers = [sorted(map(int, names)) for names in (first, second)]
    steps = {b - a for a, b in zip(*numbers)}
    return len(steps) == 1 and steps != {0}


def _by_time(images, table: RawTable) -> list[tuple[ImageFile, int]]:
    seconds = seconds_of(table)
    times = image_times([image.time_s for image in images], images)
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


def _left_out(images, table: RawTable, pairs) -> tuple[str, ...]:
    """Sentences on the images without a row and on the rows without an image, by name and row number in the file."""
    used = {id(image) for image, _ in pairs}
    matched_rows = {row for _, row in pairs}
    files = [Path(image.name).name for image in images if id(image) not in used]
    rows = [str(line) for row, line in enumerate(table.lines) if row not in matched_rows]
    sentences = []
    if files:
        sentences.append(
            f"Images without a row in {table.file} are left out ({len(files)} of {len(images)}): {_shown(files)}."
        )
    if rows:
        sentences.append(
            f"Rows of {table.file} without an image are left out ({len(rows)} of {table.n}): {_shown(rows)}."
        )
    return tuple(sentences)


def _shown(names: Sequence[str]) -> str:
    ellipsis = "" if len(names) <= _MOST_SHOWN else ", ..."
    return f"{', '.join(names[:_MOST_SHOWN])}{ellipsis}"
