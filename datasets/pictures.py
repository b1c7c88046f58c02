"""images.csv and the pictures that it names: there, whole, and of a kind that can be read."""

from collections.abc import Mapping
from pathlib import Path

from datasets.errors import complaint
from datasets.files import check_file, inside, label
from datasets.formats.table import Table, read_table

ROLES = ("board", "board-laser", "scan")
NEEDS = {"board": "placement", "board-laser": "placement", "scan": "scan"}
TEXT = ("image", "role", "placement", "scan", "note")
MARKS = {
    "PNG": (b"\x89PNG", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", b"IEND\xaeB`\x82"),
    "JPEG": (b"\xff\xd8", b"\xff\xd8\xff", b"\xff\xd9"),
}
"""How a picture is known, what its header must be, and how it ends; other kinds
are left to OpenCV's own look at the header."""


def read_images(folder: Path, name: str, called: str, samples) -> tuple[Mapping, ...]:
    """Rows of images.csv as mappings, every picture checked to exist and to be complete.

    samples: sample numbers of the recording. Raises InputError.
    """
    path = inside(folder, name, "key images.file", called)
    table = read_table(path, label(path), TEXT)
    for column in ("image", "role"):
        if column not in table.columns:
            raise complaint(f"{table.called}, column {column}", "this column", "no such column", "add it")
    rows = tuple(_row(table, k) for k in range(len(table.rows)))
    for k, row in enumerate(rows):
        _check_row(table, k, row, samples)
        picture = inside(folder, row["image"], f"row {table.rows[k]}, column image", table.called)
        check_picture(picture, f"{table.where(k, 'image')}, {row['image']}")
    return rows


def _row(table: Table, k: int) -> dict:
    cells = {name: values[k] for name, values in table.columns.items()}
    return {name: str(v) if isinstance(v, str) else float(v) for name, v in cells.items()}


def _check_row(table: Table, k: int, row: Mapping, samples) -> None:
    if row["role"] not in ROLES:
        raise complaint(table.where(k, "role"), "board, board-laser or scan", repr(row["role"])[:40],
                        "write one of these three")
    need = NEEDS[row["role"]]
    if row["role"] != "board" and not row.get(need):
        raise complaint(table.where(k, need), f"which {need} the picture is of", "nothing", f"add a {need} number")
    if "sample" in row and row["role"] == "scan" and len(samples) and row["sample"] not in samples:
        raise complaint(table.where(k, "sample"), "a sample of samples.csv", f"{row['sample']:g}", "correct the number")


def check_picture(path: Path, called: str) -> None:
    """Raise InputError where a picture is missing, empty, truncated or of an unknown kind."""
    check_file(path, called, "picture")
    try:
        with path.open("rb") as file:
            head = file.read(16)
            file.seek(max(0, path.stat().st_size - 64))
            tail = file.read()
    except OSError as problem:
        raise complaint(called, "a readable picture", str(problem.strerror), "give read permission") from None
    for kind, (known, header, end) in MARKS.items():
        if head.startswith(known):
            if not head.startswith(header) or end not in tail:
                raise complaint(called, f"a whole {kind} picture", "one with a broken header or no end",
                                "copy it again")
            return
    import cv2

    if not cv2.haveImageReader(str(path)):
        raise complaint(called, "a picture that OpenCV reads (PNG, JPEG, TIFF, BMP)", "another kind of file",
                        "save it as PNG")
