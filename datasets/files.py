"""Reading of the user's files: size limits, encodings, TOML, and paths confined to their folder."""

import codecs
from pathlib import Path, PureWindowsPath

from datasets.errors import complaint
from workbench.core.text.structured_text import ContentError, parse_toml

LIMITS_MB = {".toml": 1, ".csv": 256, ".parquet": 1024, ".urdf": 16, "image": 256}
"""Largest size of a file that is opened at all, in MB (10^6 bytes); asked of the file system first."""


def label(path: Path) -> str:
    """Name of a file in a sentence: its folder's name and its own."""
    return f"{path.parent.name}/{path.name}"[:120]


def check_file(path: Path, called: str, kind: str | None = None) -> None:
    """Raise InputError where `path` is missing, no plain file, empty, or above its kind's limit."""
    limit = LIMITS_MB.get(kind or path.suffix.lower(), 1)
    try:
        found = "" if path.is_file() else "a folder" if path.is_dir() else "no such file"
        size = 0 if found else path.stat().st_size
    except (OSError, ValueError) as problem:
        raise complaint(
            called, "a file", f"a name that cannot be opened ({problem})", "correct the name"
        ) from None
    if found:
        raise complaint(called, "a file", found, "put it there or correct the name")
    if size == 0:
        raise complaint(
            called, "a file with content", "an empty file", "export it again or remove its key"
        )
    if size > limit * 1e6:
        raise complaint(
            called,
            f"at most {limit} MB",
            f"{size / 1e6:.0f} MB",
            "check that it is the right file, or split the recording",
        )


def read_text(path: Path, called: str) -> str:
    """Content of a UTF-8 text file, without a byte order mark. Raises InputError."""
    check_file(path, called)
    try:
        content = path.read_bytes()
    except OSError as problem:
        raise complaint(
            called, "a readable file", str(problem.strerror), "give read permission"
        ) from None
    save = 'save it as "UTF-8" (in a spreadsheet: CSV UTF-8, comma delimited)'
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise complaint(f"{called}, byte 1", "UTF-8 text", "UTF-16 text", save)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        found = "another encoding or a binary file"
        raise complaint(f"{called}, byte {problem.start + 1}", "UTF-8 text", found, save) from None


def read_toml(path: Path, called: str) -> dict:
    """Keys of a TOML file. Raises InputError with the line that does not parse."""
    text = read_text(path, called)
    try:
        return parse_toml(text)
    except ContentError as problem:
        raise complaint(
            called,
            "valid TOML",
            str(problem),
            "correct that line: text in quotes, numbers with a point",
        ) from None


def file_in_folder(folder: Path, name, key: str, called: str) -> Path:
    """The file `name` in `folder`. Raises InputError where it is no text or leaves the folder."""
    where = f"{called}, {key}"
    if not isinstance(name, str) or not name.strip() or "\0" in name:
        raise complaint(
            where, "a file name in quotes", repr(name)[:60], "name a file of the folder"
        )
    if Path(name).is_absolute() or PureWindowsPath(name).drive or name.startswith(("\\", "~")):
        raise complaint(
            where,
            "a path relative to the recording's folder",
            f"the absolute path {name[:60]!r}",
            "copy the file into the folder and name it from there",
        )
    if "\\" in name:
        raise complaint(where, "a path with forward slashes", repr(name)[:60], "write / for \\")
    try:
        path = (folder / name).resolve()
        stays = path.is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):
        raise complaint(
            where, "a path that can be opened", repr(name)[:60], "shorten or correct it"
        ) from None
    if not stays:
        raise complaint(
            where,
            "a path inside the recording's folder",
            f"{name[:60]!r}, which leaves it",
            "copy the file into the folder and name it from there",
        )
    return folder / name
