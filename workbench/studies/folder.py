"""Folder of a study: it has a temporary name while the study runs, and a restarted study continues in it."""

import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from workbench.core.errors import InputError
from workbench.files.runs import RUNS, replace_file, slug
from workbench.studies.spec import Study
from workbench.studies.tables import PARTS_FOLDER, TABLE, parts_done

STUDY, LOCK = "study.json", ".lock"


@dataclass(frozen=True)
class Place:
    """`path`: folder of the finished study; `partial`: its folder until then."""

    path: Path
    partial: Path

    @property
    def finished(self) -> bool:
        return (self.path / TABLE).is_file()

    def holds(self, study: Study, data: str) -> bool:
        """True if the folder holds this study, finished, on the same data."""
        return self.finished and _digest_in(self.path / STUDY) == digest(study, data)


def digest(study: Study, extra: str = "") -> str:
    """Checksum of all keys of a study and of its data."""
    text = json.dumps(study.model_dump(mode="json"), sort_keys=True) + extra
    return hashlib.sha256(text.encode()).hexdigest()


def place_of(name: str, study: Study, data: str, out: Path | None) -> Place:
    """Folder of a study, the same in every call: `runs/study-<name>-<digest>`, or `out`."""
    path = (
        out.expanduser() if out else RUNS / f"study-{slug(name)}-{digest(study, data)[:8]}"
    ).resolve()
    return Place(path, path.with_name(f".partial-{path.name}"))


@contextmanager
def opened(place: Place, study: Study, data: str) -> Iterator[Path]:
    """The folder to write to, with the parts of an earlier start; renamed to its final name if the block succeeds.

    If the block fails, complete parts stay and a folder without parts is removed. Raises InputError if the folder
    holds other files or another process writes to it.
    """
    _check_free(place, study, data)
    created = [folder for folder in place.partial.parents if not folder.exists()]
    _make(place, study, data, created)
    with _alone(place.partial):
        try:
            yield place.partial
            _move(place)
        finally:
            if place.partial.is_dir() and not parts_done(place.partial):
                _remove(place, created)


def _remove(place: Place, created: list[Path]) -> None:
    """Remove the folder and the parent folders that were created for it."""
    shutil.rmtree(place.partial, ignore_errors=True)
    for folder in created:
        with suppress(OSError):  # it holds something else by now
            folder.rmdir()


def _check_free(place: Place, study: Study, data: str) -> None:
    if place.path.exists() and not (place.path.is_dir() and not any(place.path.iterdir())):
        raise InputError(
            f"{place.path} contains other files. To protect them, --out expects a new folder, an empty one, or "
            "that of the same study. Name another folder"
        )
    if _holds_work(place.partial) and _digest_in(place.partial / STUDY) != digest(study, data):
        raise InputError(
            f"{place.partial} holds another interrupted study, or one whose file, data or version has changed. "
            "Remove it, or name another folder with --out"
        )


def _holds_work(partial: Path) -> bool:
    """Whether a study was started in the folder; False if a kill interrupted the creation of the folder."""
    if not partial.is_dir():
        return partial.exists()
    others = [path.name for path in partial.iterdir() if path.name not in (PARTS_FOLDER, LOCK)]
    return bool(parts_done(partial)) or not all(map(_is_temporary, others))


def _is_temporary(name: str) -> bool:
    """Whether a file of that name was being written when a kill interrupted it."""
    return name.startswith(".partial-")


def _digest_in(path: Path) -> str:
    with suppress(OSError, ValueError, KeyError, TypeError):
        return json.loads(path.read_text(encoding="utf-8"))["digest"]
    return ""


def _make(place: Place, study: Study, data: str, created: list[Path]) -> None:
    keys = {"digest": digest(study, data), "study": study.model_dump(mode="json")}
    try:
        (place.partial / PARTS_FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputError(
            f"{place.partial} cannot be written ('{problem.strerror}'). Name a writable folder with --out"
        ) from problem
    if not (place.partial / STUDY).exists():
        try:
            replace_file(place.partial / STUDY, json.dumps(keys, indent=1))
        except InputError:
            _remove(place, created)
            raise


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Lock the folder. Raises InputError if another process holds the lock; the lock ends with its process."""
    try:
        import fcntl
    except ImportError:  # no locks on this system: two processes only repeat the same work
        yield
        return
    with (folder / LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(
                f"{folder} is being written by another process. Wait for it, or name another folder with --out"
            ) from None
        yield


def _move(place: Place) -> None:
    try:
        for path in place.partial.iterdir():
            if path.name == LOCK or _is_temporary(path.name):
                path.unlink(missing_ok=True)
        if place.path.is_dir():
            place.path.rmdir()  # fails if the folder is no longer empty
        os.rename(place.partial, place.path)
        shutil.rmtree(place.path / PARTS_FOLDER, ignore_errors=True)  # the table holds them all
    except OSError as problem:
        raise InputError(
            f"{place.path} cannot be written ('{problem.strerror}'). Name another folder with --out"
        ) from problem


def load(folder: Path) -> Study:
    """The study of a folder."""
    return Study(**json.loads((folder / STUDY).read_text(encoding="utf-8"))["study"])
