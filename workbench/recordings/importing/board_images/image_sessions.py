"""Images with pose tables of several days as one source: one table, in which each row names its image."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.errors import InputError
from datasets.importers.mapping.columns.sets import find_sets, headers_of
from datasets.importers.mapping.joined_tables.sessions import SESSION, appended, signature
from datasets.importers.source import ImageFile, RawTable, Source
from workbench.recordings.importing.board_images.image_rows import file_link, matched_rows

_IMAGE = "image of the session"


def joined_image_sessions(source: Source) -> tuple[Source, tuple[str, ...]]:
    """The source with one pose table where it has several with the same columns, and what to say of it.

    The images of a table lie in its folder, or below it; where tables lie in one folder, their columns name the images.
    The column `session` counts the tables. Raises InputError where tables state different units, or where an image
    belongs to several rows.
    """
    tables = [table for table in source.tables if find_sets(table)]
    if len(tables) < 2 or len({signature(table) for table in tables}) > 1:
        return source, ()
    _check_units(tables)
    images: list[ImageFile] = []
    session_tables, notes = [], []
    for number, table in enumerate(tables, 1):
        images_of_table = _images_of(table, tables, source.images)
        pairs, left_out = matched_rows(images_of_table, table)
        names = [f"{number}-{image.name.replace('/', '-')}" for image, _ in pairs]
        images += [replace(image, name=name) for (image, _), name in zip(pairs, names)]
        column = (*file_link(images_of_table, table)[0], _IMAGE)[0]
        joined = table.take(np.array([row for _, row in pairs]))
        session_tables.append(_session(joined, number, {column: np.array(names)}))
        notes += [f"{table.file}: {sentence}" for sentence in left_out]
        notes.append(f"{_place(table)} is session {number} with {len(pairs)} images.")
    _check_distinct(images, tables)
    return replace(source, tables=(appended(session_tables),), images=tuple(images)), tuple(notes)


def _place(table: RawTable) -> str:
    folder = "" if table.folder is None else f"{table.folder.name}/"
    return f"{folder}{table.file}"


def _session(table: RawTable, number: int, images: dict[str, np.ndarray]) -> RawTable:
    columns = {**table.columns, **images, SESSION: np.full(table.n, float(number))}
    lines = np.array([f"{line} of {_place(table)}" for line in table.lines])
    return replace(table, columns=columns, lines=lines)


def _images_of(table: RawTable, tables: Sequence[RawTable], images) -> list[ImageFile]:
    """The images in the folder of a table or below it; all images where another table has the same folder."""
    folders = [other.folder for other in tables]
    if table.folder is None or folders.count(table.folder) > 1:
        return list(images)
    return [image for image in images if _is_below(image.path, table.folder, folders)]


def _is_below(path: Path, folder: Path, folders: Sequence[Path | None]) -> bool:
    """Whether a folder is the nearest one of `folders` above a path."""
    parent_folders = [
        folder_above
        for folder_above in folders
        if folder_above is not None and path.is_relative_to(folder_above)
    ]
    return (
        bool(parent_folders)
        and max(parent_folders, key=lambda folder_above: len(folder_above.parts)) == folder
    )


def _check_units(tables: Sequence[RawTable]) -> None:
    stated = []
    for table in tables:
        units = [header.unit for header in headers_of(table).values()]
        stated.append((units, dict(table.default_units), sorted(table.conventions.values())))
    for table, found in zip(tables, stated):
        if found != stated[0]:
            raise InputError(
                f"{_place(tables[0])} and {_place(table)}: expected the same units in the headers of pose tables that "
                "become one recording, found others; export them with the same units."
            )


def _check_distinct(images: Sequence[ImageFile], tables: Sequence[RawTable]) -> None:
    paths = [image.path for image in images]
    duplicate = next((path for path in paths if paths.count(path) > 1), None)
    if duplicate is not None:
        names = " and ".join(_place(table) for table in tables)
        raise InputError(
            f"{names}: expected each image in one of the tables, found {duplicate.name} in several; put each table "
            "into the folder of its images, or name the images of each table in a column."
        )
