"""`workbench import`: from files of other programs to a recording."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer
from workbench.core.errors import InputError

Sources = Annotated[
    list[Path],
    typer.Argument(help="Tables, robot programs, ROS bags, images, clouds, or folders of them."),
]
Robot = Annotated[
    str | None,
    typer.Option(
        "--robot",
        metavar="NAME|FILE",
        help="Built-in robot, robot.toml, URDF or MJCF; FILE#LINK where a file holds several arms.",
    ),
]
Map = Annotated[
    Path | None,
    typer.Option(
        "--map",
        metavar="FILE",
        help="Mapping file (TOML): columns, units and conventions of the tables.",
    ),
]
Propose = Annotated[
    Path | None,
    typer.Option("--propose", metavar="FILE", help="Write the proposed mapping file and stop."),
]
Board = Annotated[
    str | None,
    typer.Option(
        "--board",
        metavar="TEXT",
        help='Board in the images: "chessboard 11x8 5mm", "circles 7x6 10mm", "circles 4x11 10mm asymmetric", '
        '"charuco 7x5 30mm 22mm DICT_5X5_250" or "aprilgrid 6x6 71.5mm 55mm"; "on tool" at the end where the robot '
        "holds it.",
    ),
]
CameraFile = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        metavar="FILE",
        help="Test the poses of images with this calibrated camera (camera.toml); default: it is calibrated from the "
        "same images.",
    ),
]
OutFolder = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="New folder for the recording.")
]
Artefact = Annotated[
    Path | None,
    typer.Option(
        "--artefact",
        metavar="FILE",
        help="File with the certified ball centres and radii (artefact.csv).",
    ),
]
BallRadius = Annotated[
    float | None,
    typer.Option(
        "--ball-radius", metavar="MM", min=0.1, help="Radius of the ball in point clouds."
    ),
]
Sigma = Annotated[
    float | None,
    typer.Option(
        "--sigma",
        metavar="MM",
        help="Standard deviation of a measured coordinate (sigma_mm), with which the fit is compared; leave it out if "
        "it is unknown.",
    ),
]
TimeOffset = Annotated[
    str | None,
    typer.Option(
        "--time-offset",
        metavar="auto|none|SECONDS",
        help="Offset between the clocks of two tables that are joined by time: estimated from the motion (auto), none, "
        "or SECONDS to add to the times of the shorter table. Default: what --map states, else auto.",
    ),
]
_GUESS_S = 30.0
"""Processor time of the test of unknown columns on the robot."""
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Accept the preview without a question.")]


def _camera(path: Path):
    from workbench.jobs.sensor import camera

    return camera.read_stated(path)[0]


def command(
    sources: Sources,
    out: OutFolder = None,
    robot: Robot = None,
    map: Map = None,
    propose: Propose = None,
    board: Board = None,
    camera: CameraFile = None,
    artefact: Artefact = None,
    ball_radius: BallRadius = None,
    sigma: Sigma = None,
    time_offset: TimeOffset = None,
    title: Annotated[str, typer.Option("--title", help="Title of the recording.")] = "",
    json: answer.JsonTarget = None,
    trust_data: answer.TrustData = False,
    yes: Yes = False,
) -> None:
    """Convert tables, logs, ROS bags, images or clouds to a recording; units and conventions are tested on the robot.

    If the data do not determine a unit or convention, the command asks at a terminal. Without a terminal it stops
    and names the missing line of the mapping file.
    """
    answer.check_target(json)
    if sigma is not None and sigma <= 0:
        raise InputError(
            f"--sigma {sigma:g}: expected a standard deviation above 0 mm; correct it."
        )
    from datasets.importers.mapping.model import Mapping, read_mapping
    from workbench.commands.data import import_dialogue
    from workbench.recordings.importing import ImportOptions
    from workbench.recordings.importing.board_images.notation import board_keys

    options = ImportOptions(
        robot=robot,
        mapping=Mapping() if map is None else read_mapping(map),
        board=None if board is None else board_keys(board),
        camera=None if camera is None else _camera(camera),
        artefact=artefact,
        ball_radius_mm=ball_radius,
        sigma_mm=sigma,
        title=title,
        ask=import_dialogue.asker(),
        trust_data=trust_data,
        time_offset=_offset_mode(time_offset),
    )
    if propose is not None:
        _propose(sources, propose, options, json)
        return
    _check_out(out)
    _import(sources, out, options, json, yes)


def _offset_mode(text: str | None) -> float | str | None:
    """The value of --time-offset. Raises InputError for what is neither a word nor a number of seconds."""
    if text in (None, "auto", "none"):
        return text
    try:
        seconds = float(str(text).replace(",", "."))
    except ValueError:
        seconds = math.nan
    if not math.isfinite(seconds):
        raise InputError(
            f"--time-offset: expected auto, none or a number of seconds, found '{text}'; correct it."
        )
    return seconds


def _check_out(out: Path | None) -> None:
    if out is None:
        raise InputError(
            "workbench import: expected --out with a new folder for the recording; add it."
        )
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"--out {out}: expected a new or empty folder, found files; name another.")


def _propose(sources: Sequence[Path], file: Path, options, json: str | None) -> None:
    """Write the mapping that headers and formats suggest, without any test."""
    from tempfile import TemporaryDirectory

    from datasets.importers.mapping.model import write_mapping
    from workbench.recordings.importing.chain import find_mapping, never_read
    from workbench.recordings.importing.sources.unjoined import propose_unjoined

    answer.check_target(str(file), "--propose")
    with answer.progress("reading the files"), TemporaryDirectory() as scratch:
        try:
            found = find_mapping(sources, options, Path(scratch))
        except InputError as problem:
            unjoined = propose_unjoined(sources, options, Path(scratch))
            if unjoined is None:
                raise
            _write_unjoined(*unjoined, problem, file, json)
            return
    found, guess = _guessed(found, options)
    unread = never_read(found, found.mapping, with_times=True)
    unused = ", ".join(f"'{name}'" for name in unread) or "none"
    notes = (*found.warnings, *found.left_out())
    lines = ["Proposed from the headers. Columns that are not used: " + unused, *notes, *guess]
    comment = "".join(f"# {line}\n" for line in lines)
    example = _example(found, options)
    if example:
        file.write_text(
            f"{comment}# Correct the lines with CHECK and FILL IN.\n\n{example}", "utf-8"
        )
    else:
        write_mapping(found.mapping, file, comment)
    result = {"command": "import", "mapping": found.mapping.as_keys(), "file": file}
    answer.deliver({**result, "unused_columns": list(unread), "warnings": list(notes)}, json)
    console = answer.console(json)
    for sentence in notes:
        console.print(f"Warning: {sentence}", style="bold red", markup=False, soft_wrap=True)
    console.print(str(file), markup=False, soft_wrap=True)


def _write_unjoined(mapping, comment: str, problem: InputError, file: Path, json: str | None):
    """Write the mapping of tables that could not be joined, with what is open about them."""
    from datasets.importers.mapping.model import write_mapping

    write_mapping(mapping, file, f"# {problem}\n#\n{comment}\n")
    result = {"command": "import", "mapping": mapping.as_keys(), "file": file}
    answer.deliver({**result, "unused_columns": [], "warnings": [str(problem)]}, json)
    _print_problem(answer.console(json), problem, file)


def _print_problem(console, problem: InputError, file: Path) -> None:
    """The problem, then the file where its mapping is."""
    console.print(f"Warning: {problem}", style="bold red", markup=False, soft_wrap=True)
    console.print(str(file), markup=False, soft_wrap=True)


def _guessed(found, options):
    """Mapping with the columns without a known header that fit the robot, and a comment on them.

    Unchanged and () where no robot is named, or no set of columns fits it, or several do.
    """
    from dataclasses import replace

    from workbench.core.deadline import OutOfTime, limited
    from workbench.recordings.importing.measured_robot import with_unnamed_columns

    if not _is_robot(found) or _is_complete(found.mapping):
        return found, ()
    try:
        with (
            answer.progress("testing columns on the robot") as progress,
            limited(_GUESS_S, progress),
        ):
            mapping, notes = with_unnamed_columns(found, replace(options, ask=None), progress)
    except (InputError, OutOfTime):
        return found, ()
    if not notes:
        return found, ()
    guess = f"CHECK, a guess from the fit to the robot: {' '.join(notes)}"
    return replace(found, mapping=replace(mapping, robot=options.robot or mapping.robot)), (guess,)


def _is_robot(found) -> bool:
    return found.table is not None and not found.source.images and not found.source.clouds


def _is_complete(mapping) -> bool:
    return mapping.joints is not None and mapping.measures is not None


def _example(found, options) -> str:
    """A complete mapping file where the headers leave quantities of a robot open; "" where they leave none."""
    from workbench.recordings.importing.sources.header_problems import table_example

    if not _is_robot(found) or _is_complete(found.mapping):
        return ""
    return table_example(found.table, found.mapping, options.robot or found.mapping.robot)


def _import(sources: Sequence[Path], out: Path, options, json: str | None, yes: bool) -> None:
    from workbench.commands.data import import_dialogue
    from workbench.recordings.importing import import_recording

    console = answer.console(json)
    asks = options.ask is not None and not yes
    if asks:
        result = import_recording(sources, out, options)
    else:
        with answer.progress("importing") as progress:
            result = import_recording(sources, out, options, progress)
    summary = {"command": "import", "sources": list(sources), **result.as_json(), "folder": out}
    import_dialogue.show(console, summary, result)
    if asks and not import_dialogue.is_confirmed():
        import shutil

        shutil.rmtree(out)
        raise InputError(
            "The import was rejected and nothing is kept; write the mapping with --propose FILE, correct it, and name "
            "it with --map."
        )
    answer.deliver(summary, json)
    for line in import_dialogue.next_lines(result, sources, out, options):
        console.print(line, markup=False, soft_wrap=True)
    console.print(str(out), markup=False, soft_wrap=True)
