"""Files that describe an arm as a tree of links (URDF, MJCF), with the files that an MJCF file includes."""

import shutil
import xml.etree.ElementTree as ET
from os import PathLike
from pathlib import Path

from workbench.core.errors import complaint

DESCRIPTIONS = (".urdf", ".xml", ".mjcf")
"""Suffixes of these files."""
_DEEPEST = 20  # files that include one another: more is a circle


def is_description(name: str | PathLike) -> bool:
    """Whether a file is a URDF or MJCF file by its suffix."""
    return Path(name).suffix.lower() in DESCRIPTIONS


def is_robot_file(name: str | PathLike) -> bool:
    """Whether a file describes a robot by its suffix: a URDF, MJCF or TOML file."""
    return Path(name).suffix.lower() == ".toml" or is_description(name)


def copy_description(file: Path, folder: Path) -> str:
    """Copy a URDF or MJCF file into a folder; its new name, "robot" with its suffix. Raises InputError.

    Included files stand in their places in the copy, so that it depends on no other file. A file without included
    files is copied byte by byte.
    """
    name = f"robot{file.suffix.lower()}"
    if file.suffix.lower() != ".urdf" and next(_parsed(file).iter("include"), None) is not None:
        ET.ElementTree(read_included(file)).write(folder / name, encoding="utf-8")
    else:
        shutil.copyfile(file, folder / name)
    return name


def read_included(file: Path) -> ET.Element:
    """The root element, with the content of included files in the place of every <include>. Raises InputError."""
    return _with_included(file, file.parent, 0)


def _with_included(file: Path, folder: Path, depth: int) -> ET.Element:
    """Paths of includes are relative to the folder of the main file, as MuJoCo has it."""
    root = _parsed(file)
    if depth > _DEEPEST:
        raise complaint(file, "files that end", "files that include one another", "cut the circle")
    for parent in list(root.iter()):
        for place, child in reversed(list(enumerate(parent))):
            if child.tag == "include":
                inner = _with_included(folder / child.get("file", ""), folder, depth + 1)
                parent[place : place + 1] = list(inner)
    return root


def _parsed(file: Path) -> ET.Element:
    try:
        return ET.parse(file).getroot()
    except OSError as problem:
        raise complaint(file, "a readable MJCF file", problem.strerror, "check the path") from None
    except (ET.ParseError, ValueError, LookupError) as problem:
        raise complaint(file, "XML", f"a mistake ({problem})", "correct it there") from None


__all__ = ["DESCRIPTIONS", "copy_description", "is_description", "is_robot_file", "read_included"]
