"""Files that were dropped into the app: kept in a folder that ends with the app."""

from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from robot_model.files.mjcf import is_mjcf
from robot_model.files.urdf import tree_of
from workbench.core.errors import InputError
from workbench.core.robot_files.robot_description import is_description

MOST_BYTES = 1 << 30
_ROBOTS = (".toml", ".urdf", ".mjcf")
_MOST_NAME = 120


class Dropped:
    """Dropped files by name, in a temporary folder."""

    def __init__(self) -> None:
        self._folder = TemporaryDirectory(prefix="workbench-import-")
        self.names: list[str] = []

    @property
    def folder(self) -> Path:
        return Path(self._folder.name)

    def add(self, files: Iterable[Mapping]) -> None:
        """Keep files as the browser sends them, with `name` and `content`. Raises InputError.

        A file of the same name is replaced.
        """
        for file in files:
            name = safe_name(file.get("name"))
            content = _content(file)
            used_bytes = sum(path.stat().st_size for path in self.folder.iterdir())
            if used_bytes + len(content) > MOST_BYTES:
                raise InputError(
                    f"{name}: expected at most {MOST_BYTES >> 20} MiB in all, found more; use workbench import"
                )
            (self.folder / name).write_bytes(content)
            if name not in self.names:
                self.names.append(name)

    def clear(self) -> None:
        """Forget all files."""
        for path in self.folder.iterdir():
            path.unlink()
        self.names.clear()

    @property
    def robots(self) -> list[str]:
        """Names of files that may describe a robot, as FILE#LINK for each arm where one holds several."""
        return [arm for name in self._robot_files for arm in self._arms_of(name)]

    @property
    def _robot_files(self) -> list[str]:
        return [name for name in self.names if self._is_robot(name)]

    def _arms_of(self, name: str) -> list[str]:
        if not is_description(name):
            return [name]
        try:
            ends = tree_of({"urdf": str(self.folder / name)}, name).flanges()
        except InputError:
            return [name]  # the test of the mapping says what is wrong with the file
        return [name] if len(ends) < 2 else [f"{name}#{end}" for end in ends]

    def _is_robot(self, name: str) -> bool:
        """Controllers write tables as XML, too: the root element tells an MJCF file from them."""
        return Path(name).suffix.lower() in _ROBOTS or is_mjcf(self.folder / name)

    @property
    def tables(self) -> list[str]:
        """Names of files that may be an artefact.csv."""
        return [name for name in self.names if Path(name).suffix.lower() == ".csv"]

    def sources(self, used: Iterable[str]) -> list[Path]:
        """Paths of the files to import. used: names of files that describe robot or artefact."""
        left_out = {*used, *self._robot_files}
        return [self.folder / name for name in self.names if name not in left_out]


def safe_name(name: object) -> str:
    """The name of a file without any folder. Raises InputError where nothing is left of it."""
    text = str(name or "").replace("\\", "/")
    last = PurePosixPath(text).name
    printable = "".join(
        letter for letter in last if letter.isprintable() and letter not in '<>:"|?*'
    )
    if printable.strip(". ") == "":
        raise InputError(f"File {text[:40]!r}: expected a file name, found none; rename the file")
    return printable[-_MOST_NAME:].lstrip(".")


def _content(file: Mapping) -> bytes:
    """The bytes of a file; the browser sends them in one or several pieces."""
    content = file.get("content", b"")
    if isinstance(content, list | tuple):
        content = b"".join(bytes(piece) for piece in content)
    if not isinstance(content, bytes | bytearray | memoryview):
        raise InputError(f"{file.get('name')}: expected a file, found text; drop the file again")
    return bytes(content)
