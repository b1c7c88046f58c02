"""Where a study stands: a folder under a temporary name while it runs, found again when it is started again."""

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
from workbench.study.spec import Study
from workbench.study.tables import PARTS, TABLE, parts_done

STUDY = "study.json"


@dataclass(frozen=True)
class Place:
    """`path` where the finished study stands, `partial` where it is written until then."""

    path: Path
    partial: Path

    @property
    def finished(self) -> bool:
        return (self.path / TABLE).is_file()

    def holds(self, study: Study, data: str) -> bool:
        """Whether the finished study there is this one, of the same data."""
        return self.finished and _told(self.path / STUDY) == digest(study, data)


def digest(study: Study, more: str = "") -> str:
    """What tells one study from another: every key, and the data that it resamples."""
    text = json.dumps(study.model_dump(mode="json"), sort_keys=True) + more
    return hashlib.sha256(text.encode()).hexdigest()


def place_of(name: str, study: Study, data: str, out: Path | None) -> Place:
    """The same study always stands in the same place: `runs/study-<name>-<digest>`, or `out`."""
    path = (
        out.expanduser() if out else RUNS / f"study-{slug(name)}-{digest(study, data)[:8]}"
    ).resolve()
    return Place(path, path.with_name(f".partial-{path.name}"))


@contextmanager
def opened(place: Place, study: Study, data: str) -> Iterator[Path]:
    """The folder to write to, with what an earlier start left there; moved to its place when the block ends well.

    Parts that are whole stay when the block does not end well; a folder without any is removed. Raises
    InputError where the place is taken by something else, or another process is at it.
    """
    _check_free(place, study, data)
    made = [folder for folder in place.partial.parents if not folder.exists()]
    _make(place, study, data, made)
    with _alone(place.partial):
        try:
            yield place.partial
            _move(place)
        finally:
            if place.partial.is_dir() and not parts_done(place.partial):
                _remove(place, made)


def _remove(place: Place, made: list[Path]) -> None:
    """Take away the folder and those above it that were made for it."""
    shutil.rmtree(place.partial, ignore_errors=True)
    for folder in made:
        with suppress(OSError):  # it holds something else by now
            folder.rmdir()


def _check_free(place: Place, study: Study, data: str) -> None:
    if place.path.exists() and not (place.path.is_dir() and not any(place.path.iterdir())):
        raise InputError(
            f"{place.path} already holds something, where --out expects a folder that is new, empty or of "
            "this very study, so that nothing is overwritten; name another folder"
        )
    left = place.partial / STUDY
    if place.partial.exists() and (not left.is_file() or _told(left) != digest(study, data)):
        raise InputError(
            f"{place.partial} holds another study that was stopped, or one whose file, data or version "
            "has changed since; remove it, or name another place with --out"
        )


def _told(path: Path) -> str:
    with suppress(OSError, ValueError, KeyError, TypeError):
        return json.loads(path.read_text(encoding="utf-8"))["digest"]
    return ""


def _make(place: Place, study: Study, data: str, made: list[Path]) -> None:
    keys = {"digest": digest(study, data), "study": study.model_dump(mode="json")}
    try:
        (place.partial / PARTS).mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputError(
            f"{place.partial} cannot be written, because the system says '{problem.strerror}'; name a "
            "place that you may write with --out"
        ) from problem
    if not (place.partial / STUDY).exists():
        try:
            replace_file(place.partial / STUDY, json.dumps(keys, indent=1))
        except InputError:
            _remove(place, made)
            raise


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """InputError where another process works at this study; the lock goes with the process that holds it."""
    try:
        import fcntl
    except ImportError:  # no such locks here: two at once only do the same work twice
        yield
        return
    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(
                f"{folder} is being written by another process; wait for it, or name another place with "
                "--out"
            ) from None
        yield


def _move(place: Place) -> None:
    try:
        (place.partial / ".lock").unlink(missing_ok=True)
        if place.path.is_dir():
            place.path.rmdir()  # it was empty; where it no longer is, this refuses
        os.rename(place.partial, place.path)
        shutil.rmtree(place.path / PARTS, ignore_errors=True)  # the table holds them all
    except OSError as problem:
        raise InputError(
            f"{place.path} cannot be written, because the system says '{problem.strerror}'; name another "
            "place with --out"
        ) from problem


def load(folder: Path) -> Study:
    """The study of a folder."""
    return Study(**json.loads((folder / STUDY).read_text(encoding="utf-8"))["study"])
