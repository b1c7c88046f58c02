"""Run folders: every command's output appears in one place, whole or not at all.

A run is written under a temporary name beside its final place and renamed when all of it is
there, so that no reader ever meets half a result, and no earlier run is overwritten.
"""

import os
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from workbench.core.errors import InputError

RUNS = Path("runs")


@dataclass(frozen=True)
class Run:
    """One run: `partial` is written to while it lasts, `path` is where it stands afterwards.

    `made`: folders above it that were not there before, innermost first.
    """

    path: Path
    partial: Path
    made: tuple[Path, ...] = ()


@contextmanager
def opened(command: str, subject: str | Path, out: Path | None = None) -> Iterator[Run]:
    """A new run, moved into place when the block ends well and removed when it does not.

    command, subject: name the folder `runs/<timestamp>-<command>-<subject>`.
    out: the folder to write instead; it must be new or empty.
    Raises InputError when the place cannot be written or is taken.
    """
    run = _named(out) if out else _numbered(f"{_now()}-{command}-{slug(subject)}")
    try:
        yield run
        _move_into_place(run)
    finally:
        shutil.rmtree(run.partial, ignore_errors=True)
        for folder in run.made:
            with suppress(OSError):  # it holds something, as it should after a run that ended well
                folder.rmdir()


def slug(subject: str | Path) -> str:
    """The last part of a path or name, reduced to what every file system takes."""
    last = Path(subject).name or Path(subject).resolve().name
    return re.sub(r"[^A-Za-z0-9._]+", "-", last).strip("-.")[:60] or "recording"


def replace_file(path: Path, text: str | Iterable[str]) -> None:
    """Write `text`, whole or in parts, under a temporary name, then move it to `path`. Raises InputError.

    A pipe or a device is written as it is: moving a file there would take its place.
    """
    partial = path.with_name(f".partial-{os.getpid()}-{path.name}")
    special = path.exists() and not path.is_file()
    try:
        with (path if special else partial).open("w", encoding="utf-8") as file:
            file.writelines([text] if isinstance(text, str) else text)
        if not special:
            partial.replace(path.resolve())
    except OSError as error:
        if not special:
            partial.unlink(missing_ok=True)
        raise InputError(_refused(path, error)) from error


def _now() -> str:
    return datetime.now().strftime("%Y%m%d-%H%M%S")


def _named(out: Path) -> Run:
    path = out.expanduser().resolve()
    if path.exists() and not path.is_dir():
        raise InputError(f"{out} is a file, where --out expects a folder; name a new folder.")
    if path.is_dir() and any(path.iterdir()):
        raise InputError(
            f"{out} already holds files, where --out expects a folder that is new or "
            "empty, so that nothing is overwritten; name another folder."
        )
    partial = path.with_name(f".partial-{path.name}")
    if partial.exists():
        raise InputError(
            f"{partial} is there already, from a run that still writes {out} or was "
            "cut off; wait for that run or remove this folder."
        )
    return Run(path, partial, _make(partial))


def _numbered(name: str) -> Run:
    """The first free name; making the partial folder is what reserves it among processes."""
    for number in range(1, 1000):
        path = RUNS.resolve() / (name if number == 1 else f"{name}-{number}")
        partial = path.with_name(f".partial-{path.name}")
        if partial.exists() or path.exists():
            continue
        return Run(path, partial, _make(partial))
    raise InputError(f"{RUNS.resolve()} holds a thousand runs named {name}; name one with --out.")


def _make(partial: Path) -> tuple[Path, ...]:
    missing = tuple(folder for folder in partial.parents if not folder.exists())
    try:
        partial.mkdir(parents=True)
    except OSError as error:
        raise InputError(_refused(partial.parent, error)) from error
    return missing


def _move_into_place(run: Run) -> None:
    try:
        if run.path.is_dir():
            run.path.rmdir()  # it was empty; where it no longer is, this refuses
        run.partial.rename(run.path)
    except OSError as error:
        raise InputError(_refused(run.path, error)) from error


def _refused(path: Path, error: OSError) -> str:
    return (
        f"{path} cannot be written, because the system says '{error.strerror}'; "
        "name a place that you may write with --out or --json."
    )
