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
    """Whether a file is a URDF or MJCF file by its suffix; its name may be followed by #LINK."""
    return file_and_tip(name)[0].suffix.lower() in DESCRIPTIONS


def file_and_tip(name: str | PathLike) -> tuple[Path, str | None]:
    """The file of FILE or FILE#LINK, and the link that is the flange: one file may hold several arms."""
    file, _, tip = str(name).rpartition("#")
    if file and tip and Path(file).suffix.lower() in DESCRIPTIONS:
        return Path(file), tip
    return Path(name), None


def description_keys(name: str | PathLike) -> dict[str, str]:
    """{"urdf": file}, with "tip" where FILE#LINK names it, as `robot_model.load_robot` takes it."""
    file, tip = file_and_tip(name)
    if tip is None:
        return {"urdf": str(file)}
    return {"urdf": str(file), "tip": tip}


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
    """Root element of an XML file, every <include> replaced by the content of its file. Raises InputError."""
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


__all__ = [
    "DESCRIPTIONS",
    "copy_description",
    "description_keys",
    "file_and_tip",
    "is_description",
    "is_robot_file",
    "read_included",
]
