"""Which reader takes a file: by its extension, and by its content where the extension leaves it open."""

import re
from collections.abc import Sequence
from pathlib import Path

from datasets.errors import complaint
from datasets.importers.source import ImageFile, Source
from datasets.importers.sources import (
    arrays,
    axis_reports,
    clouds,
    excel,
    robot_programs,
    ros_bags,
    storage,
    text_tables,
)
from datasets.importers.sources.pose_files import read_pose_files

IMAGES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}
_TEXT = {".csv", ".tsv", ".txt", ".log", ".asc", ".dat", ".prn", ".tab", ".res", ".pos", ""}
_PROGRAMS = {".src", ".mod", ".sys", ".ls", ".prg", ".mxt"}
_STORAGE = {".yml", ".yaml", ".xml", ".json"}
_OURS = {"recording.toml", "import.toml"}
_FEWEST_PROFILES = 3


def read_sources(paths: Sequence[Path], scratch: Path) -> Source:
    """Everything in the files and folders, in the order of the names.

    scratch: folder for images that have to be unpacked. Raises InputError for a file that no reader takes.
    """
    found = Source()
    for path in paths:
        if not path.exists():
            raise complaint(str(path), "a file or folder", "no such path", "correct the name")
        found = found + _read(path, scratch)
    if not (found.tables or found.images or found.clouds):
        names = ", ".join(str(path) for path in paths)
        raise complaint(
            names,
            "a table, images or clouds",
            "nothing that any reader takes",
            "name the data files",
        )
    return found


def _read(path: Path, scratch: Path) -> Source:
    if ros_bags.is_bag(path):
        return ros_bags.read_bag(path, scratch / path.stem)
    if path.is_dir():
        return _read_folder(path, scratch)
    suffix = path.suffix.lower()
    if suffix in IMAGES:
        return Source(images=(ImageFile(path, path.name),))
    if suffix in {".xlsx", ".xlsm"}:
        return Source(tables=tuple(excel.read_excel(path)))
    if suffix == ".mat":
        return Source(tables=tuple(arrays.read_matlab(path)))
    if suffix in {".parquet", ".pq", ".feather"}:
        return Source(tables=tuple(arrays.read_parquet(path)))
    if suffix in {".npy", ".npz"}:
        return Source(tables=tuple(arrays.read_numpy(path)))
    if suffix in _STORAGE:
        return storage.read_storage(path)
    if suffix in {".ply", ".pcd", ".xyz", ".pts"}:
        return Source(clouds=(path,))
    if suffix in _PROGRAMS | _TEXT:
        if robot_programs.is_robot_program(path):
            return Source(tables=tuple(robot_programs.read_robot_program(path)))
        if axis_reports.is_axis_report(path):
            return Source(tables=tuple(axis_reports.read_axis_report(path)))
        return Source(tables=(text_tables.read_text_table(path),))
    raise complaint(
        path.name,
        "CSV, text, .xlsx, .mat, .npz, Parquet, JSON, OpenCV or Kalibr YAML, a ROS bag, a robot program, images",
        f"a file of type {suffix}",
        "export it as CSV",
    )


def _read_folder(folder: Path, scratch: Path) -> Source:
    """All files of a folder and of its direct subfolders; what no reader takes is left out with a warning."""
    files = [
        path
        for path in folder.rglob("*")
        if path.is_file() and len(path.relative_to(folder).parts) <= 2
    ]
    files = sorted(files, key=natural_order)
    texts = [path for path in files if path.suffix.lower() in _TEXT]
    profiles = [path for path in texts if path.suffix and clouds.is_profile(path)]
    profiles = profiles if len(profiles) >= _FEWEST_PROFILES else []
    table, others = read_pose_files([path for path in texts if path not in profiles])
    found, skipped = Source() if table is None else Source(tables=(table,)), []
    found = found + Source(clouds=tuple(profiles))
    for path in files:
        if path.suffix.lower() in _TEXT and path not in others:
            continue
        suffix = path.suffix.lower()
        known = (
            IMAGES
            | _TEXT
            | _PROGRAMS
            | _STORAGE
            | clouds.EXTENSIONS
            | {".xlsx", ".xlsm", ".mat", ".npz", ".parquet", ".pq", ".feather"}
        )
        if (
            suffix not in known - {""}
            or path.name in _OURS
            or path.stem.lower().startswith("readme")
        ):
            skipped.append(path.name)
            continue
        found = found + _read(path, scratch)
    if skipped:
        found = found + Source(warnings=(f"{folder.name}: not read are {', '.join(skipped[:5])}.",))
    return found


def natural_order(path: Path | str) -> list:
    """Sort key by which image-2 comes before image-10."""
    parts = re.split(r"(\d+)", str(path).lower())
    return [(1, int(part), "") if part.isdigit() else (0, 0, part) for part in parts]
