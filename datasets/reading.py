"""One way to read any recording: a folder in recording/1, a known real set, or a bundled one."""

from dataclasses import replace
from importlib import import_module, resources
from pathlib import Path

from datasets import registry
from datasets.errors import complaint
from datasets.formats.recording1 import read_recording
from datasets.recording import Recording
from workbench.core.text.structured_text import ContentError, read_json

_FOREIGN = {
    ".csv",
    ".txt",
    ".tsv",
    ".xlsx",
    ".png",
    ".jpg",
    ".jpeg",
    ".tif",
    ".tiff",
    ".bmp",
    ".ply",
    ".pcd",
}
"""Suffixes of tables, images and point clouds that `workbench import` reads."""


def bundled() -> dict[str, Path]:
    """Name and folder of every recording that comes with the project."""
    home = Path(str(resources.files("datasets").joinpath("bundled")))
    return {f.name: f for f in sorted(home.glob("*")) if (f / "recording.toml").is_file()}


def read(path: str | Path, trust_data: bool = False) -> Recording:
    """The recording at `path`.

    path: a folder in recording/1 (or its recording.toml), the name of a bundled recording, or the
    name or the folder of a known real set with its variant ("motoman_leica_ctu:left").
    trust_data: accept implausible units, motions and ball distances with a warning.
    Raises InputError: one sentence that says what is wrong and what to do.
    """
    folder, name = Path(path), str(path)
    if folder.name == "recording.toml":
        folder = folder.parent
    if known := _known_set(name):
        return _read_real(*known)
    if folder.is_dir():
        _check_imported(folder)
        return read_recording(folder, trust_data)
    if name in bundled():
        return read_recording(bundled()[name], trust_data)
    if name.partition(":")[0] in registry.sources():
        return _read_real(name, registry.find(name))
    if folder.is_file():
        raise complaint(
            name,
            "a folder in recording/1",
            f"a file ({folder.suffix or 'no suffix'})",
            "make a recording of it first: run `workbench import` on this file",
        )
    raise complaint(
        name or "the recording's path",
        "the folder of a recording or a name that `workbench datasets` lists",
        "neither a folder nor such a name",
        "correct it",
    )


def _known_set(path: str) -> tuple[str, Path] | None:
    """Name with its variant, and folder, of a path to all files of a known real set, as they were downloaded."""
    place, colon, variant = path.partition(":")
    folder = Path(place).resolve()
    source = registry.sources().get(folder.name)
    if source is None or (folder / "recording.toml").exists():
        return None
    if not all((folder / file.path).is_file() for file in source.files):
        return None
    return source.name + colon + variant, folder


def _check_imported(folder: Path) -> None:
    """Raise InputError for a folder of foreign files: tables or images without recording.toml."""
    if (folder / "recording.toml").exists():
        return
    _check_no_results(folder)
    found = sorted({file.suffix.lower() for file in folder.iterdir() if file.is_file()} & _FOREIGN)
    if found:
        raise complaint(
            folder.name or str(folder),
            "a folder in recording/1, which has recording.toml",
            f"only other files ({', '.join(found)})",
            "make a recording of them first: run `workbench import` on this folder",
        )


def _check_no_results(folder: Path) -> None:
    """Raise InputError for the run folder of a command, whose answer.json names the command and its input."""
    file = folder / "answer.json"
    try:
        answer = read_json(file) if file.is_file() else {}
    except (OSError, ContentError):
        return  # another program's file of this name
    if not isinstance(answer, dict) or not isinstance(answer.get("command"), str):
        return
    given = answer.get("input")
    remedy = f"pass {given}, which it was made of" if isinstance(given, str) else "pass its input"
    raise complaint(
        folder.name or str(folder),
        "the folder of a recording",
        f"results of `workbench {answer['command']}`",
        remedy,
    )


def _read_real(name: str, folder: Path | None) -> Recording:
    source = registry.source(name)
    variant = name.partition(":")[2]
    if variant not in source.variants:
        known = ", ".join(f"{source.name}:{v}" if v else source.name for v in source.variants)
        found = repr(variant) if variant else "no variant"
        raise complaint(f"recording {name}", f"one of {known}", found, "name one of these")
    if folder is None:
        places = " or ".join(map(str, registry.places()))
        raise complaint(
            f"recording {name}",
            f"the files of {source.name} in {places}",
            "not all of them",
            f"fetch them with: workbench datasets get {source.name}, or set {registry.SETTING}",
        )
    reader = import_module(f"datasets.formats.{source.name}")
    recording = reader.read(folder, variant)
    return replace(recording, name=name, folder=folder, source=source.url, licence=source.licence)
