"""images.csv and its images: checked to exist, to be complete and to be readable."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from datasets.errors import complaint
from datasets.files import check_file, file_in_folder, label
from datasets.formats.table import Table, read_table
from datasets.recording_files.rows import Rows

ROLES = ("board", "board-laser", "scan")
NEEDS = {"board": "placement", "board-laser": "placement", "scan": "scan"}
TEXT = ("image", "role", "placement", "scan", "note")
INTEGERS = ("step", "sample")
UNITS = {
    "mirror": "mirror_deg",
    "mirror_rad": "mirror_deg",
    "table": "table_deg",
    "table_rad": "table_deg",
    "time": "time_s",
    "temperature": "temperature_c",
    "mirror_speed": "mirror_speed_deg_s",
}
"""Column names without a unit or with another one -> the expected name."""
MARKS = {
    "PNG": (b"\x89PNG", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", b"IEND\xaeB`\x82"),
    "JPEG": (b"\xff\xd8", b"\xff\xd8\xff", b"\xff\xd9"),
}
"""Signature, header and end of each image format; OpenCV checks the header of other formats."""


def read_images(folder: Path, name: str, called: str, samples) -> Rows:
    """Rows of images.csv as mappings, every image checked to exist and to be complete.

    A row holds text for image, role, placement, scan and note, whole numbers for step and sample,
    and floats for all else; an empty cell of a column of numbers is left out of its row.
    samples: sample numbers of the recording. Raises InputError.
    """
    path = file_in_folder(folder, name, "key images.file", called)
    table = read_table(path, label(path), TEXT, blanks=True)
    _check_columns(table)
    rows = Rows.of(table.columns)
    for k, row in enumerate(rows):
        _check_row(table, k, row, samples)
        image = file_in_folder(
            folder, row["image"], f"row {table.rows[k]}, column image", table.called
        )
        check_image(image, f"{table.where(k, 'image')}, {row['image']}")
    _check_together(table, rows)
    return replace(rows, integers=frozenset(INTEGERS))


def _check_columns(table: Table) -> None:
    for column in ("image", "role"):
        if column not in table.columns:
            raise complaint(
                f"{table.called}, column {column}", "this column", "no such column", "add it"
            )
    for column in table.columns:
        if column in UNITS:
            raise complaint(
                f"{table.called}, column {column}",
                f"the column {UNITS[column]}",
                column,
                f"convert it and rename it to {UNITS[column]}",
            )


def _check_row(table: Table, k: int, row: Mapping, samples) -> None:
    if row["role"] not in ROLES:
        raise complaint(
            table.where(k, "role"),
            "board, board-laser or scan",
            repr(row["role"])[:40],
            "write one of these three",
        )
    need = NEEDS[row["role"]]
    if row["role"] != "board" and not row.get(need):
        raise complaint(
            table.where(k, need),
            f"which {need} the image is of",
            "nothing",
            f"add a {need} number",
        )
    for name in INTEGERS:
        if row.get(name, 0) != int(row.get(name, 0)):
            raise complaint(
                table.where(k, name), "a whole number", f"{row[name]:g}", "number them 0, 1, 2 …"
            )
    if row.get("sweep", 0) not in (-1, 0, 1):
        raise complaint(
            table.where(k, "sweep"),
            "-1, 0 or 1",
            f"{row['sweep']:g}",
            "write only the direction of the mirror's rotation",
        )
    if "sample" in row and row["sample"] not in samples:
        raise complaint(
            table.where(k, "sample"),
            "a sample of samples.csv",
            f"{row['sample']:g}",
            "correct the number" if len(samples) else "add [samples] with that row",
        )


def _check_together(table: Table, rows: Rows) -> None:
    """Check that images and steps of a scan are unique, and that every laser placement has a board image."""
    same = np.fromiter(
        (hash(str(PurePosixPath(name))) for name in table.columns["image"]), np.int64, len(rows)
    )
    if repeated := _repeated(same[:, None]):
        first, second = repeated
        raise complaint(
            table.where(second, "image"),
            "every image once",
            f"{rows[second]['image']} again (first in row {table.rows[first]})",
            "delete the copy or name the image that was meant",
        )
    role = table.columns["role"]
    none = np.zeros(len(rows), "U1")
    place = np.where(
        role == "scan", *(table.columns.get(name, none) for name in ("scan", "placement"))
    )
    swept = np.flatnonzero(role != "board")
    numbers = [np.unique(values, return_inverse=True)[1].ravel() for values in (role, place)]
    moved = [
        np.where(role == "scan", rows.values(name, np.inf), np.inf)
        for name in ("sample", "table_deg")
    ]
    swept_by = [rows.values(name, np.inf) for name in ("step", "sweep")]
    steps = np.stack([*numbers, *swept_by, *moved], 1)
    if repeated := _repeated(steps[swept]):
        first, second = swept[list(repeated)]
        raise complaint(
            table.where(second, "step"),
            f"every step of a {NEEDS[role[second]]} once",
            f"the step of row {table.rows[first]} again",
            "number the steps; where the robot or a turntable moves between images, add sample or table_deg",
        )
    alone = np.flatnonzero((role == "board-laser") & ~np.isin(place, place[role == "board"]))
    if len(alone):
        raise complaint(
            table.where(alone[0], "placement"),
            "an image of role board with the same placement",
            f"none at {str(place[alone[0]])!r}",
            "add that image or delete the row",
        )


def _repeated(keys: np.ndarray) -> tuple[int, int] | None:
    """The first repeated row of keys (n, k), as (first occurrence, row); None without one."""
    order = np.lexsort(keys.T)
    repeats = np.flatnonzero((keys[order[1:]] == keys[order[:-1]]).all(1))
    if not len(repeats):
        return None
    row = order[repeats + 1].min()
    return int(np.flatnonzero((keys == keys[row]).all(1))[0]), int(row)


def check_image(path: Path, called: str) -> None:
    """Raise InputError where an image is missing, empty, truncated or of an unknown kind."""
    check_file(path, called, "image")
    try:
        with path.open("rb") as file:
            head = file.read(16)
            file.seek(max(0, path.stat().st_size - 64))
            tail = file.read()
    except OSError as problem:
        raise complaint(
            called, "a readable image", str(problem.strerror), "give read permission"
        ) from None
    for kind, (known, header, end) in MARKS.items():
        if head.startswith(known):
            if not head.startswith(header) or end not in tail:
                raise complaint(
                    called,
                    f"a whole {kind} image",
                    "one with a broken header or no end",
                    "copy it again",
                )
            return
    import cv2

    if not cv2.haveImageReader(str(path)):
        raise complaint(
            called,
            "an image that OpenCV reads (PNG, JPEG, TIFF, BMP)",
            "another kind of file",
            "save it as PNG",
        )
