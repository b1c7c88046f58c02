"""Writer of recording/1 folders; writes are atomic."""

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.recording import Recording
from datasets.samples.columns import INTEGERS
from datasets.samples.group_names import with_group_names
from workbench.core.robot_files.robot_description import copy_description
from workbench.core.text.csv_text import write_rows
from workbench.core.vocabulary import Covariate

_AT_A_TIME = 5_000  # rows of a CSV file: a cell as text takes ten times the room of a number


def write(recording: Recording, folder: str | Path, samples: str = "csv") -> Path:
    """Write `recording` as a new folder in recording/1 and return the folder.

    samples: "csv" or "parquet". The files are written under a temporary name in the parent folder and
    then renamed; an interrupted write leaves no files. If `folder` is that of the recording and holds
    its images but no recording.toml yet, the other files are added to the images. Raises
    InputError if `folder` exists and holds other files.
    """
    folder = Path(folder)
    if _holds_its_images(recording, folder):
        return _write_next_to_images(recording, folder, samples)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise complaint(
            str(folder), "a new or empty folder", "files in it", "name another folder or empty it"
        )
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as parent:
        made = Path(parent) / folder.name
        made.mkdir()
        _write_files(recording, made, samples)
        made.replace(folder)
    return folder


def _holds_its_images(recording: Recording, folder: Path) -> bool:
    is_own_folder = (
        recording.folder is not None and Path(recording.folder).resolve() == folder.resolve()
    )
    return is_own_folder and bool(recording.images) and not (folder / "recording.toml").exists()


def _write_next_to_images(recording: Recording, folder: Path, samples: str) -> Path:
    """All files but the images; recording.toml comes last, and without it a folder is no recording."""
    for row in recording.images:
        if not (folder / row["image"]).is_file():
            raise complaint(
                f"{folder.name}/{row['image']}",
                "an image that lies there",
                "no such file",
                "write the images first",
            )
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as parent:
        made = Path(parent)
        _write_files(recording, made, samples, copy=False)
        for file in sorted(made.iterdir(), key=lambda f: f.name == "recording.toml"):
            if (folder / file.name).exists():
                raise complaint(
                    f"{folder.name}/{file.name}",
                    "a folder with images only",
                    "this file",
                    "remove it or name another folder",
                )
        for file in sorted(made.iterdir(), key=lambda f: f.name == "recording.toml"):
            file.replace(folder / file.name)
    return folder


def _write_files(recording: Recording, folder: Path, samples: str, copy: bool = True) -> None:
    keys = _header(recording)
    keys["robot"] = _write_robot(recording.robot, folder)
    if recording.columns:
        keys["samples"] = {"file": f"samples.{samples}"}
        if recording.time_origin is not None:
            keys["samples"]["time_origin"] = recording.time_origin
        writer = {"csv": write_csv, "parquet": write_parquet}[samples]
        columns = with_group_names(recording.columns, recording.group_names)
        writer(folder / f"samples.{samples}", columns)
    if recording.balls:
        keys["artefact"] = {"file": "artefact.csv"}
        rows = np.array([(ball, *xyzr) for ball, xyzr in recording.balls.items()], float).T
        write_csv(
            folder / "artefact.csv", dict(zip(("ball", "x_mm", "y_mm", "z_mm", "radius_mm"), rows))
        )
    if recording.images:
        keys["images"] = {"file": "images.csv"}
        _write_images(recording, folder, copy)
    _write_toml(folder / "recording.toml", {k: v for k, v in keys.items() if v})


def _header(recording: Recording) -> dict:
    keys = {
        "format": "recording/1",
        "title": recording.title,
        "measures": recording.measures,
        "name": recording.name,
        "source": recording.source,
        "licence": recording.licence,
        "remarks": list(recording.remarks),
        "sigma_mm": recording.sigma_mm,
        "board": recording.board,
        "guess": recording.guess,
    }
    return {k: dict(v) if isinstance(v, Mapping) else v for k, v in keys.items()}


def _write_robot(robot: Mapping, folder: Path) -> dict:
    if "builtin" in robot:
        return dict(robot)
    if "urdf" in robot:
        name = copy_description(Path(robot["urdf"]), folder)
        return {"file": name} | {k: v for k, v in robot.items() if k != "urdf"}
    if not robot:
        return {}
    _write_toml(folder / "robot.toml", robot)
    return {"file": "robot.toml"}


def _write_toml(path: Path, keys: Mapping) -> None:
    import tomli_w

    path.write_text(tomli_w.dumps(keys), encoding="utf-8", newline="\n")


def write_csv(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """One CSV file; floats are written so that reading gives the same bits."""
    columns = {name: np.asarray(values) for name, values in columns.items()}
    with path.open("w", encoding="utf-8", newline="") as file:
        write_rows(file, [columns])
        for start in range(0, max(map(len, columns.values()), default=0), _AT_A_TIME):
            block = {
                name: values[start : start + _AT_A_TIME].tolist()
                for name, values in columns.items()
            }
            write_rows(
                file, zip(*([_cell(name, v) for v in values] for name, values in block.items()))
            )


def _cell(name: str, value) -> str:
    is_integer = name in INTEGERS or Covariate.of(name).kind == "approach"
    return str(int(value)) if is_integer and not isinstance(value, str) else str(value)


def write_parquet(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """One Parquet file with the same columns."""
    import pyarrow
    import pyarrow.parquet

    table = pyarrow.table({k: np.asarray(v) for k, v in columns.items()})
    pyarrow.parquet.write_table(table, path, write_page_checksum=True)


def _write_images(recording: Recording, folder: Path, copy: bool) -> None:
    names = dict.fromkeys(name for row in recording.images for name in row)
    rows = [[row.get(name, "") for name in names] for row in recording.images]
    with (folder / "images.csv").open("w", encoding="utf-8", newline="") as file:
        write_rows(file, [names, *rows])
    for row in recording.images if copy else ():
        target = folder / row["image"]
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(recording.folder / row["image"], target)
