"""Run folders: the output of a command is written atomically to one folder.

A run is written under a temporary name next to its final folder and renamed when it is complete.
Incomplete results are never visible, and no earlier run is overwritten. A lock next to the
temporary folder ends with its process; the leftovers of a killed run are recognised and
replaced. A long command writes its first result to `provisional.json` in the final folder, which
holds that file alone until the run replaces it.
"""

import os
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from workbench.core.errors import InputError

try:
    import fcntl
except ImportError:  # Windows: a temporary folder that is left behind has to be removed by hand
    fcntl = None

RUNS = Path("runs")
KEPT_RECORDING = "recording"
"""Folder inside a run with its recording, where that was in memory alone."""
PROVISIONAL = "provisional.json"
"""First result of a run that is not complete; a folder with this file alone counts as empty."""
_root: ContextVar[Path | None] = ContextVar("root", default=None)
_MANY_FILES = 200
_PARTIAL = ".partial-"
"""Start of the names of files and folders that are being written."""


@dataclass(frozen=True)
class Run:
    """One run: `partial` is written to while it lasts, `path` is where it stands afterwards.

    `made`: folders above it that were not there before, innermost first. `lock`: file descriptor of
    the lock file next to `partial`.
    """

    path: Path
    partial: Path
    made: tuple[Path, ...] = ()
    lock: int | None = None


@contextmanager
def opened(command: str, subject: str | Path, out: Path | None = None) -> Iterator[Run]:
    """A new run, moved into place when the block ends well and removed when it does not.

    command, subject: name the folder `runs/<timestamp>-<command>-<subject>`.
    out: the folder to write instead; it must be new or empty.
    Raises InputError when the place cannot be written or is taken.
    """
    if out:
        run = _named(out)
    else:
        run = _numbered(f"{_now()}-{command}-{slug(subject)}")
    try:
        yield run
        _move_into_place(run)
    finally:
        _release(run)


def write_provisional(run: Run, text: str) -> None:
    """Write the first result of a run where it stays if the run is interrupted. Raises InputError."""
    try:
        run.path.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(_refused(run.path, error)) from error
    replace_file(run.path / PROVISIONAL, text)


@contextmanager
def placed_in(folder: Path) -> Iterator[None]:
    """Runs without a name of their own are written below `folder` instead of `runs` meanwhile."""
    before = _root.set(folder)
    try:
        yield
    finally:
        _root.reset(before)


def check_place(out: Path | None) -> None:
    """Raise InputError where `opened` would, before the work whose result is to be written.

    out: the folder of --out; None: a new folder under `runs`.
    """
    _release(_named(out) if out else _numbered(".check"))


def _release(run: Run) -> None:
    """Remove what a run leaves besides its result: temporary folder, lock, parent folders without content."""
    shutil.rmtree(run.partial, ignore_errors=True)
    if run.lock is not None:
        _lock_of(run.partial).unlink(missing_ok=True)
        os.close(run.lock)
    for folder in run.made:
        with suppress(OSError):  # it holds something, as it should after a run that ended well
            folder.rmdir()


def slug(subject: str | Path) -> str:
    """The last part of a path or name, reduced to what every file system takes."""
    last = Path(subject).name or Path(subject).resolve().name
    return re.sub(r"[^A-Za-z0-9._]+", "-", last).strip("-.")[:60] or "recording"


def input_name(subject: str | Path) -> str:
    """Name of a recording in a run from which it can be read again: an absolute path, or a known name."""
    path = Path(subject)
    if path.exists():
        return str(path.resolve())
    return str(subject)


def replace_file(path: Path, text: str | bytes | Iterable[str]) -> None:
    """Write `text`, whole or in parts, under a temporary name, then move it to `path`. Raises InputError.

    Bytes are written as they are.

    A pipe or a device is written as it is: moving a file there would take its place.
    """
    partial = path.with_name(f"{_PARTIAL}{os.getpid()}-{path.name}")
    special = path.exists() and not path.is_file()
    try:
        target = path if special else partial
        if isinstance(text, bytes):
            target.write_bytes(text)
        else:
            with target.open("w", encoding="utf-8") as file:
                file.writelines([text] if isinstance(text, str) else text)
        if not special:
            flush_to_disk(partial)
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
    if path.is_dir() and any(not _is_provisional(entry) for entry in path.iterdir()):
        raise InputError(
            f"{out} contains files. To protect them, --out expects a new or empty folder; name another folder."
        )
    partial = path.with_name(f"{_PARTIAL}{path.name}")
    reserved, lock = _reserve(partial)
    if lock is None and fcntl is not None:
        raise InputError(
            f"Another run is writing {out} at this moment; wait for it or name another folder."
        )
    return Run(path, partial, reserved, lock)


def _is_provisional(path: Path) -> bool:
    """Whether it is the first result of an interrupted run, or its temporary file if a kill interrupted the writing."""
    return path.name == PROVISIONAL or (
        path.name.startswith(_PARTIAL) and path.name.endswith(f"-{PROVISIONAL}")
    )


def _numbered(name: str) -> Run:
    """The first free name; making the partial folder is what reserves it among processes."""
    root = (_root.get() or RUNS).resolve()
    for number in range(1, 1000):
        path = root / (name if number == 1 else f"{name}-{number}")
        partial = path.with_name(f"{_PARTIAL}{path.name}")
        if partial.exists() or path.exists():
            continue
        reserved, lock = _reserve(partial)
        if lock is None and fcntl is not None:
            continue
        return Run(path, partial, reserved, lock)
    raise InputError(f"{root} holds a thousand runs named {name}; name one with --out.")


def _reserve(partial: Path) -> tuple[tuple[Path, ...], int | None]:
    """Make the temporary folder and lock it: the folders that were missing, and the lock.

    What a run that was killed left in the folder is removed. The lock is None where another process
    holds it. Raises InputError where the folder cannot be made.
    """
    missing = tuple(folder for folder in partial.parents if not folder.exists())
    try:
        partial.mkdir(parents=True, exist_ok=fcntl is not None)
        if fcntl is None:
            return missing, None
        lock = os.open(_lock_of(partial), os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        raise InputError(_refused(partial.parent, error)) from error
    if not _is_ours(lock, _lock_of(partial)):
        os.close(lock)
        return missing, None
    for leftover in partial.iterdir():
        if leftover.is_dir() and not leftover.is_symlink():
            shutil.rmtree(leftover, ignore_errors=True)
        else:
            leftover.unlink(missing_ok=True)
    return missing, lock


def _lock_of(partial: Path) -> Path:
    return partial.with_name(f"{partial.name}.lock")


def _is_ours(lock: int, path: Path) -> bool:
    """Whether this process got the lock, and the file is still the one at `path`."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return os.fstat(lock).st_ino == path.stat().st_ino
    except OSError:
        return False


def flush_to_disk(path: Path) -> None:
    """Ask the system to write a file or folder to the disk, so that it survives a loss of power.

    Raises OSError where that fails, such as for a full disk. Windows has no handles of folders.
    """
    if path.is_dir() and os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _flush_folder(folder: Path) -> None:
    """All files of a folder to the disk; one call for the whole system where there are many."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
    if len(files) > _MANY_FILES and hasattr(os, "sync"):
        os.sync()
        return
    for path in files:
        flush_to_disk(path)


def _move_into_place(run: Run) -> None:
    try:
        _flush_folder(run.partial)
        if run.path.is_dir():
            for leftover in filter(_is_provisional, run.path.iterdir()):
                leftover.unlink(missing_ok=True)
            run.path.rmdir()  # it was empty; where it no longer is, this refuses
        run.partial.rename(run.path)
        flush_to_disk(run.path.parent)
    except OSError as error:
        raise InputError(_refused(run.path, error)) from error


def _refused(path: Path, error: OSError) -> str:
    return (
        f"{path} cannot be written ('{error.strerror}'); name a writable path with --out or --json."
    )
