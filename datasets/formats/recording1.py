"""Reader of recording/1 folders: every file is checked; an error is reported in one message."""

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.files import file_in_folder, label, read_toml
from datasets.formats.table import Table, read_table
from datasets.recording import Recording
from datasets.recording_files.arms import read_robot
from datasets.recording_files.images import read_images
from datasets.recording_files.keys import RECORDING, SECTIONS, check_keys
from datasets.samples.checks import Context, check_samples
from datasets.samples.columns import GROUPS, KINDS, TEXT, joint_columns, misspelt
from datasets.samples.plausible import check_plausible

_NOMINAL_RADIUS_MM = 10.0


def read_recording(folder: Path, trust_data: bool = False) -> Recording:
    """The recording in `folder`.

    trust_data: accept implausible units, motions and ball distances with a warning.
    Raises InputError: one sentence that names file, row and key, what was expected, what was
    found and what to do.
    """
    toml = folder / "recording.toml"
    called = f"{folder.resolve().name}/recording.toml"
    keys = read_toml(toml, called)
    _check_recording(keys, called)
    robot = read_robot(folder, keys["robot"], called) if "robot" in keys else {}
    balls = _read_artefact(folder, keys, called)
    columns, warnings, names = _read_samples(folder, keys, called, robot, balls, trust_data)
    balls = balls or _unknown_ball(keys, columns, called)
    if KINDS[keys["measures"]].joints and joint_columns(columns):
        _has_section(keys, "robot", "robot.toml", called)
    images = ()
    if "images" in keys:
        images = read_images(folder, keys["images"]["file"], called, columns.get("sample", ()))
    return Recording(
        measures=keys["measures"],
        columns=columns,
        robot=robot,
        title=keys.get("title", ""),
        sigma_mm=keys.get("sigma_mm"),
        balls=balls,
        images=images,
        board=keys.get("board"),
        guess=keys.get("guess", {}),
        name=keys.get("name", folder.resolve().name),
        folder=folder,
        source=keys.get("source", ""),
        licence=keys.get("licence", ""),
        sha256=_digest(folder, keys),
        warnings=(*keys.get("remarks", ()), *warnings),
        remarks=tuple(keys.get("remarks", ())),
        group_names=names,
        time_origin=keys.get("samples", {}).get("time_origin"),
    )


def read_head(folder: Path, trust_data: bool = False) -> tuple[Recording, Path, Context]:
    """A recording of joint readings without its samples, the file that holds them, and what they are checked against.

    Raises InputError as `read_recording` does.
    """
    called = f"{folder.resolve().name}/recording.toml"
    keys = read_toml(folder / "recording.toml", called)
    _check_recording(keys, called)
    for section in ("robot", "samples"):
        _has_section(
            keys, section, f"{section}.{'toml' if section == 'robot' else 'parquet'}", called
        )
    robot, balls = read_robot(folder, keys["robot"], called), _read_artefact(folder, keys, called)
    head = Recording(
        measures=keys["measures"],
        columns={},
        robot=robot,
        title=keys.get("title", ""),
        sigma_mm=keys.get("sigma_mm"),
        balls=balls,
        guess=keys.get("guess", {}),
        name=keys.get("name", folder.resolve().name),
        folder=folder,
        source=keys.get("source", ""),
        licence=keys.get("licence", ""),
        time_origin=keys["samples"].get("time_origin"),
        remarks=tuple(keys.get("remarks", ())),
    )
    path = file_in_folder(folder, keys["samples"]["file"], "key samples.file", called)
    small = keys["samples"].get("small_range", False)
    return (
        head,
        path,
        Context(keys["measures"], robot, balls, keys.get("sigma_mm"), small, trust_data),
    )


def _check_recording(keys: Mapping, called: str) -> None:
    check_keys(keys, RECORDING, called)
    if "payload" in keys:
        raise complaint(
            f"{called}, [payload]",
            "this section in robot.toml",
            "it in the recording, where it has no effect",
            "move it to robot.toml, or name it [robot.payload] next to builtin",
        )
    for section, wanted in SECTIONS.items():
        if section in keys:
            check_keys(keys[section], wanted, f"{called}, [{section}]")
    kind = KINDS[keys["measures"]]
    balls = (
        kind.artefact and keys["measures"] != "ball-centre"
    )  # of one ball alone, the place may be unknown
    needed = {
        "artefact": balls,
        "images": kind.images,
        "board": kind.images,
        "samples": kind.joints,
    }
    for section, wanted in needed.items():
        if wanted:
            _has_section(keys, section, "" if section == "board" else f"{section}.csv", called)
    if "board" in keys:
        _check_board(keys["board"], f"{called}, [board]")


def _has_section(keys: Mapping, section: str, file: str, called: str) -> None:
    if section not in keys:
        raise complaint(
            f"{called}, key [{section}]",
            f"this section in a {keys['measures']} recording",
            "none",
            f"add [{section}]" + (f' with file = "{file}"' if file else ""),
        )


def _check_board(board: Mapping, where: str) -> None:
    """Keys that only go together."""
    if board["kind"] == "charuco":
        for name in ("marker_mm", "dictionary"):
            if name not in board:
                raise complaint(
                    f"{where}, key {name}",
                    "this key of a ChArUco board",
                    "none",
                    'add it, such as marker_mm = 7.5 and dictionary = "DICT_5X5_250"',
                )
    if board["kind"] == "aprilgrid" and "marker_mm" not in board:
        raise complaint(
            f"{where}, key marker_mm",
            "the side of a tag of the AprilGrid",
            "none",
            "add it; square_mm is the distance between the same corners of neighbouring tags",
        )
    if board.get("marker_mm", 0.0) >= board["square_mm"]:
        raise complaint(
            f"{where}, key marker_mm",
            f"a marker smaller than its square of {board['square_mm']:g} mm",
            f"{board['marker_mm']:g} mm",
            "measure both again",
        )
    if board.get("asymmetric") and board["kind"] != "circles":
        raise complaint(
            f"{where}, key asymmetric",
            "this key with circles only",
            f"a {board['kind']}",
            "remove it",
        )


def _read_artefact(folder: Path, keys: Mapping, called: str) -> dict[int, tuple]:
    if "artefact" not in keys:
        return {}
    path = file_in_folder(folder, keys["artefact"]["file"], "key artefact.file", called)
    table = read_table(path, label(path), ("note",))
    names = ("ball", "x_mm", "y_mm", "z_mm", "radius_mm")
    for name in names:
        if name not in table.columns:
            raise complaint(
                f"{table.called}, column {name}", "this column", "no such column", "add it"
            )
    balls: dict[int, tuple] = {}
    for k in range(len(table.rows)):
        cells = [float(table.columns[name][k]) for name in names]
        _check_ball(table, k, cells, balls)
        balls[int(cells[0])] = tuple(cells[1:])
    return balls


def _unknown_ball(keys: Mapping, columns: Mapping, called: str) -> dict[int, tuple]:
    """Centres of one ball need no artefact.csv: its place is where the artefact's frame then stands.

    Its radius enters nothing that centres tell; a nominal one stands for it where a ball may hide another.
    """
    if keys["measures"] != "ball-centre" or "artefact" in keys:
        return {}
    numbers = np.unique(columns["ball"])
    if len(numbers) > 1:
        _has_section(keys, "artefact", "artefact.csv", called)
    return {int(numbers[0]): (0.0, 0.0, 0.0, _NOMINAL_RADIUS_MM)}


def _check_ball(table: Table, k: int, cells: list[float], balls: Mapping) -> None:
    for name, value in zip(("ball", "x_mm", "y_mm", "z_mm", "radius_mm"), cells):
        if not abs(value) < 1e9:
            raise complaint(
                table.where(k, name), "a finite number", f"{value:g}", "correct the cell"
            )
    if cells[0] != round(cells[0]) or int(cells[0]) in balls:
        raise complaint(
            table.where(k, "ball"),
            "a whole number, every ball once",
            f"{cells[0]:g}",
            "number the balls 1, 2, 3 …",
        )
    if not cells[4] > 0.1:
        raise complaint(
            table.where(k, "radius_mm"),
            "a radius in mm, above 0.1",
            f"{cells[4]:g}",
            "correct it, or multiply the whole table by 1000 if it is in metres",
        )


def _read_samples(
    folder: Path, keys: Mapping, called: str, robot: Mapping, balls: Mapping, trust_data: bool
):
    """Columns of the samples, sentences on what is unusual in them, and the names of groups that have names."""
    if "samples" not in keys:
        return {}, (), {}
    path = file_in_folder(folder, keys["samples"]["file"], "key samples.file", called)
    small = keys["samples"].get("small_range", False)
    context = Context(keys["measures"], robot, balls, keys.get("sigma_mm"), small, trust_data)
    table = read_table(path, label(path), TEXT, groups=GROUPS)
    return *checked(table, context), table.names


def checked(table: Table, context: Context) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The columns of a table of samples, or of some of its rows, and sentences on what is unusual in them.

    Raises InputError for the first cell that cannot be right.
    """
    if "fixed_to" in table.columns:
        fixed = table.columns["fixed_to"]
        table.columns["fixed_to"] = np.where(fixed == "", "tool", fixed)
    check_samples(table, context)
    warnings = (*check_plausible(table, context), *_misspelt_columns(table))
    return dict(table.columns), warnings


def _misspelt_columns(table: Table) -> list[str]:
    """Sentences on columns that nearly have the name of a known one, and are therefore not read as it."""
    found = []
    for name in table.columns:
        right = misspelt(name)
        if right is not None and right not in table.columns:
            found.append(
                f"{table.called}, column {name}: it is read as a covariate of its own, and nearly has the name of "
                f"{right}; rename it if it holds that."
            )
    return found


def _digest(folder: Path, keys: Mapping) -> str:
    named = [
        keys[s]["file"]
        for s in ("robot", "samples", "artefact", "images")
        if "file" in keys.get(s, {})
    ]
    total = hashlib.sha256()
    for name in ("recording.toml", *named):
        total.update(hashlib.sha256((folder / name).read_bytes()).digest())
    return total.hexdigest()
