"""The real recordings that this project knows: their source, terms and checksums; finding and fetching them.

The files themselves are not part of the project. They are looked for in the folder that the
environment variable WORKBENCH_RECORDINGS names, else in `../shared/recordings` next to the project,
else in the cache that `get` fills.
"""

import hashlib
import os
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from urllib.parse import quote

from datasets.errors import complaint

SETTING = "WORKBENCH_RECORDINGS"
TIMEOUT_S = 30
LIMIT_MB = 500
"""Largest file that is downloaded; the largest known one has less than a fifth of it."""


@dataclass(frozen=True)
class RemoteFile:
    """One file of a set: its place in the set's folder, its checksum, and its place in the public repository.

    remote: "" where the file as it is used here cannot be fetched alone; the set's `by_hand` says how it is made.
    """

    path: str
    sha256: str
    remote: str = ""


@dataclass(frozen=True)
class Source:
    """A real recording by its source. `variants` are what `name:variant` may be; "" is the name alone.

    repository and commit on GitHub, or else the `page` that tells of the source; `by_hand`: how files
    without a place in a repository are made from what is published.
    """

    name: str
    title: str
    measures: str
    licence: str
    variants: tuple[str, ...]
    files: tuple[RemoteFile, ...]
    repository: str = ""
    commit: str = ""
    page: str = ""
    by_hand: str = ""

    @property
    def url(self) -> str:
        """Web page of the source at the commit that the checksums belong to."""
        return self.page or f"https://github.com/{self.repository}/tree/{self.commit}"

    def url_of(self, file: RemoteFile) -> str:
        """Address of one file."""
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{quote(file.remote)}"


@cache
def sources() -> Mapping[str, Source]:
    """Every known real set by its name."""
    keys = tomllib.loads(
        resources.files("datasets").joinpath("sources.toml").read_text(encoding="utf-8")
    )
    return {s["name"]: _source(s) for s in keys["set"]}


def _source(keys: Mapping) -> Source:
    files = tuple(RemoteFile(**f) for f in keys["file"])
    further_keys = {k: v for k, v in keys.items() if k not in ("file", "variants")}
    return Source(**further_keys, variants=tuple(keys["variants"]), files=files)


def source(name: str) -> Source:
    """The set of that name (a variant behind a colon is ignored). Raises InputError."""
    known = sources()
    base = name.partition(":")[0]
    if base not in known:
        raise complaint(
            f"recording {name}",
            f"one of {', '.join(known)}",
            f"{base!r}",
            "correct the name, or give the path of a recording/1 folder",
        )
    return known[base]


def cache_folder() -> Path:
    """Folder of `get` when none is named."""
    home = os.environ.get("XDG_CACHE_HOME")
    try:
        home = Path(home) if home else Path.home() / ".cache"
    except RuntimeError:  # a user without a home folder, as in some containers
        home = Path(tempfile.gettempdir())
    return home / "vision-sensor-workbench" / "recordings"


def places() -> list[Path]:
    """Folders in which real sets are looked for, in this order."""
    if setting := os.environ.get(SETTING):
        return [Path(setting), cache_folder()]
    return [Path(__file__).resolve().parents[2] / "shared" / "recordings", cache_folder()]


def find(name: str) -> Path | None:
    """Folder that holds every file of the set `name`, or None. Raises InputError for unknown names."""
    wanted = source(name)
    for place in places():
        folder = place / wanted.name
        if all((folder / f.path).is_file() for f in wanted.files):
            return folder
    return None


def listing() -> list[dict]:
    """One row a set, for tables: name, title, variants, licence, url, and the folder or None."""
    return [
        {
            "name": s.name,
            "title": s.title,
            "measures": s.measures,
            "variants": list(s.variants),
            "licence": s.licence,
            "url": s.url,
            "folder": find(s.name),
        }
        for s in sources().values()
    ]


def get(name: str, folder: str | Path | None = None) -> Path:
    """Download the set `name` into `folder`/<name> (default: the cache) and return that folder.

    Every file comes under a temporary name, is compared with its checksum and then moved. Files
    that are there and whole are kept. Raises InputError where the source cannot be reached or has
    changed.
    """
    wanted = source(name)
    target = (Path(folder) if folder else cache_folder()) / wanted.name
    for file in wanted.files:
        if not _is_whole(target / file.path, file):
            if not file.remote:
                raise complaint(
                    f"{wanted.name}/{file.path}",
                    f"this file in {target} or where {SETTING} says",
                    f"none, and it cannot be fetched alone from {wanted.url}",
                    wanted.by_hand,
                )
            _download(wanted, file, target / file.path)
    return target


def check_file(name: str, path: Path, folder: Path) -> None:
    """Raise InputError where a file of a known set differs from the one that its checksum is of."""
    file = next(f for f in source(name).files if folder / f.path == path)
    if not _is_whole(path, file):
        raise complaint(
            f"{name}/{file.path}",
            f"the published file (sha256 {file.sha256[:12]}…)",
            "another one or none",
            f"fetch it again with: workbench datasets get {name}",
        )


def _is_whole(path: Path, file: RemoteFile) -> bool:
    return path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == file.sha256


def _download(wanted: Source, file: RemoteFile, target: Path) -> None:
    from http.client import HTTPException
    from urllib.request import urlopen

    url = wanted.url_of(file)
    try:
        with urlopen(url, timeout=TIMEOUT_S) as answer:
            content = answer.read(LIMIT_MB * 10**6 + 1)
    except (OSError, HTTPException) as problem:  # HTTPException: the answer breaks off
        raise complaint(
            f"{wanted.name}/{file.path}",
            f"an answer from {url}",
            f"none ({problem})",
            f"connect to the network, or copy the set into a folder and name that in {SETTING}",
        ) from None
    if len(content) > LIMIT_MB * 10**6:
        raise complaint(
            f"{wanted.name}/{file.path}",
            f"at most {LIMIT_MB} MB from {url}",
            "more",
            "report it: the source has changed",
        )
    found = hashlib.sha256(content).hexdigest()
    if found != file.sha256:
        raise complaint(
            f"{wanted.name}/{file.path}",
            f"sha256 {file.sha256[:12]}… from {url}",
            f"{found[:12]}…",
            "report it: the source has changed",
        )
    _keep(content, target)


def _keep(content: bytes, target: Path) -> None:
    """Write a file under a temporary name and move it into place. Raises InputError."""
    part = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=target.parent, delete=False) as file:
            part = Path(file.name)
            file.write(content)
        part.replace(target)
    except OSError as problem:
        if part is not None:
            part.unlink(missing_ok=True)
        raise complaint(
            str(target),
            "a place that can be written",
            str(problem.strerror),
            "free space there, or name another folder",
        ) from None
