"""Which reader takes a file: by its extension, and by its content where the extension leaves it open."""

import gzip
import re
import shutil
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from datasets.errors import InputError, complaint
from datasets.importers.mapping.columns.sets import find_sets
from datasets.importers.source import ImageFile, RawTable, Source
from datasets.importers.sources import arrays, clouds, geodetic_words, ros_bags, storage
from datasets.importers.sources.pose_files import STRUCTURED, read_pose_files
from datasets.importers.sources.programs import joint_lists, robot_programs, yaskawa_jobs
from datasets.importers.sources.stored_profiles import is_stored_profile
from datasets.importers.sources.tables import axis_reports, excel, text_tables
from datasets.importers.sources.tables.line_blocks import read_line_blocks
from datasets.importers.sources.tables.reshaped import one_row_per_sample
from datasets.importers.sources.tables.sections import with_second_section
from datasets.importers.sources.tables.summary_rows import without_summary_rows

IMAGES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}
_TEXT = {".csv", ".tsv", ".txt", ".log", ".asc", ".dat", ".prn", ".tab", ".res", ".pos", ""}
_PROGRAMS = {".src", ".mod", ".sys", ".ls", ".prg", ".mxt"}
_ARRAYS = {".mat", ".npy", ".npz", ".parquet", ".pq", ".feather"}
_EXCEL = {".xlsx", ".xlsm"}
_UNREADABLE = {
    ".xls": ("a workbook of Excel 97", "save it as .xlsx or CSV"),
    ".ods": ("an OpenDocument spreadsheet", "save it as .xlsx or CSV"),
    ".zip": ("an archive", "unpack it and name the files"),
    ".7z": ("an archive", "unpack it and name the files"),
    ".rar": ("an archive", "unpack it and name the files"),
    ".tar": ("an archive", "unpack it and name the files"),
    ".xit": ("a job of SpatialAnalyzer", "export points or frames as text"),
    ".xit64": ("a job of SpatialAnalyzer", "export points or frames as text"),
    ".pdf": ("a document", "export the numbers as CSV"),
    ".docx": ("a document", "export the numbers as CSV"),
}
"""Extension -> what such a file is, and what to do."""
_OFTEN_TEXT = {".xls"}
_IN_FOLDERS = (
    *(*IMAGES, *(_TEXT - {""}), *_PROGRAMS, *_EXCEL, *(_ARRAYS - {".npy"}), ".gz"),
    *(*storage.EXTENSIONS, *joint_lists.EXTENSIONS, *yaskawa_jobs.EXTENSIONS, *clouds.EXTENSIONS),
    *geodetic_words.EXTENSIONS,
)
"""Extensions of the files that are read in a folder."""
_OUTPUT_FILES = {"recording.toml", "import.toml"}
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
    found = _read_file(path, scratch)
    tables = tuple(replace(one_row_per_sample(t), folder=path.parent) for t in found.tables)
    return replace(found, tables=tables)


def _read_file(path: Path, scratch: Path) -> Source:
    suffix = path.suffix.lower()
    if suffix == ".gz":
        return _read_file(_unpacked(path, scratch), scratch)
    if suffix in IMAGES:
        return Source(images=(ImageFile(path, path.name),))
    if suffix in _EXCEL:
        return Source(tables=tuple(map(without_summary_rows, excel.read_excel(path))))
    if suffix == ".mat":
        return Source(tables=tuple(arrays.read_matlab(path)))
    if suffix in {".parquet", ".pq", ".feather"}:
        return Source(tables=tuple(arrays.read_parquet(path)))
    if suffix in {".npy", ".npz"}:
        return Source(tables=tuple(arrays.read_numpy(path)))
    if suffix in storage.EXTENSIONS or suffix in storage.XML:
        return storage.read_storage(path)
    if suffix in clouds.EXTENSIONS or clouds.is_text_cloud(path):
        return Source(clouds=(path,))
    if suffix in yaskawa_jobs.EXTENSIONS:
        return Source(tables=tuple(yaskawa_jobs.read_job(path)))
    if suffix in _TEXT | geodetic_words.EXTENSIONS and geodetic_words.is_gsi(path):
        return Source(tables=tuple(geodetic_words.read_gsi(path)))
    if suffix in _PROGRAMS | _TEXT | joint_lists.EXTENSIONS:
        if robot_programs.is_robot_program(path):
            return Source(tables=tuple(robot_programs.read_robot_program(path)))
        if joint_lists.has_joint_lists(path):
            return Source(tables=tuple(joint_lists.read_joint_lists(path)))
        if axis_reports.is_axis_report(path):
            return Source(tables=tuple(axis_reports.read_axis_report(path)))
        return Source(tables=with_second_section(path, _text_table(path)))
    return _read_unknown(path, suffix)


def _text_table(path: Path) -> RawTable:
    """The table of a text file: one row in each line, or in each block of lines. Raises InputError for others."""
    try:
        table = without_summary_rows(text_tables.read_text_table(path))
    except InputError:
        blocks = read_line_blocks(path)
        if blocks is None:
            raise
        return blocks
    is_known = bool(find_sets(one_row_per_sample(table)))
    return table if is_known else read_line_blocks(path) or table


def _unpacked(path: Path, scratch: Path) -> Path:
    """The file in a gzip file, in a folder of its own below `scratch`. Raises InputError for a damaged one."""
    target = scratch / f"{path.name}-unpacked" / path.stem
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        with gzip.open(path) as packed, target.open("wb") as plain:
            shutil.copyfileobj(packed, plain)
    except (OSError, EOFError, zlib.error) as problem:
        raise complaint(
            path.name, "a gzip file", f"a damaged one ({problem})", "pack it again"
        ) from None
    return target


def _read_unknown(path: Path, suffix: str) -> Source:
    """The table of a file with an unusual extension, as far as it is text. Raises InputError for other files."""
    try:
        if suffix not in _UNREADABLE or suffix in _OFTEN_TEXT:
            return Source(tables=(_text_table(path),))
    except InputError:
        pass  # the sentence on the kind of the file says more
    if suffix in _UNREADABLE:
        found, remedy = _UNREADABLE[suffix]
        raise complaint(path.name, "a table, images or clouds", found, remedy)
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
    profiles = _many([path for path in texts if path.suffix and clouds.is_profile(path)])
    scans = [path for path in files if path.suffix.lower() == ".npy"]
    profiles += _many([path for path in scans if clouds.is_array_cloud(path)])
    structured = [path for path in files if path.suffix.lower() in STRUCTURED]
    profiles += _many([path for path in structured if is_stored_profile(path)])
    series, others = read_pose_files([p for p in texts + structured if p not in profiles])
    tables = tuple(replace(table, folder=table.folder or folder) for table in series)
    found, skipped = Source(tables=tables), []
    found = found + Source(clouds=tuple(profiles))
    for path in files:
        if path.suffix.lower() in _TEXT | STRUCTURED and path not in others:
            continue
        is_ours = path.name in _OUTPUT_FILES or path.stem.lower().startswith("readme")
        if is_ours or path.suffix.lower() not in _IN_FOLDERS:
            skipped.append(path.name)
            continue
        found = found + _read(path, scratch)
    if skipped:
        found = found + Source(warnings=(f"{folder.name}: not read are {', '.join(skipped[:5])}.",))
    return found


def _many(paths: list[Path]) -> list[Path]:
    """The paths, none of them where they are so few that they may be something else than scans."""
    return paths if len(paths) >= _FEWEST_PROFILES else []


def natural_order(path: Path | str) -> list:
    """Sort key by which image-2 comes before image-10."""
    pieces = re.split(r"(\d+)", str(path).lower())
    return [(1, int(part), "") if part.isdigit() else (0, 0, part) for part in pieces]
