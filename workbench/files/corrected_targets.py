"""Targets that `workbench compensate` or `workbench export` wrote: they are corrected already."""

from pathlib import Path

from workbench.core.errors import InputError
from workbench.files.exports.programs import HEAD_START
from workbench.files.targets import CORRECTION_COLUMNS, Programme

_HEAD_CHARACTERS = 2000


def check_uncorrected(programme: Programme, path: Path) -> None:
    """InputError for targets of `path` that are corrected: a second correction moves the arm off by the first one.

    A table is recognised by the columns of corrected.csv, a program by the head that `workbench export` writes.
    """
    found = [name for name in CORRECTION_COLUMNS if name in programme.table.columns]
    if len(found) == len(CORRECTION_COLUMNS):
        raise _corrected_twice(path, f"the columns {', '.join(found)} of a corrected table")
    if HEAD_START in _head_of(path):
        raise _corrected_twice(path, f"'{HEAD_START} ...' in its head")


def _head_of(path: Path) -> str:
    with path.open("rb") as file:
        return file.read(_HEAD_CHARACTERS).decode("utf-8", "replace")


def _corrected_twice(path: Path, found: str) -> InputError:
    return InputError(
        f"{path}: expected targets that are not yet corrected, found {found}; name the original targets (`workbench "
        "export` corrects them, too), or add --force to correct these once more"
    )
