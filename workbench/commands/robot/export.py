"""`workbench export`: what was calibrated in another program's format, read back before it is kept."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot.calibrate import WithoutOption
from workbench.commands.robot.compensate import Force, Start
from workbench.commands.robot.export_arm import FORMATS as ARM_FORMATS
from workbench.commands.robot.export_arm import STEPS, ArmOptions, export_arm
from workbench.commands.shared import answer
from workbench.commands.shared.target_map import PayloadKg, TargetMap
from workbench.core.errors import InputError
from workbench.files.runs import replace_file
from workbench.machine.progress import counted

ARM, CAMERA, HAND_EYE = "calibrated arm", "calibrated camera", "hand-eye transform"
FORMATS = {
    ARM: ARM_FORMATS,
    CAMERA: ("ros", "opencv", "kalibr"),
    HAND_EYE: ("ros",),
}
ALL_FORMATS = tuple(dict.fromkeys(name for names in FORMATS.values() for name in names))
# Files of a run folder and what they hold; of a camera the scanner's file comes first, since it is the later one.
_FILES = (
    ("solution.json", ARM),
    ("hand-eye.toml", HAND_EYE),
    ("scanner.toml", CAMERA),
    ("camera.toml", CAMERA),
)

ParentFrame = Annotated[
    str | None,
    typer.Option(
        "--parent-frame",
        metavar="NAME",
        help="Name of the ROS frame of flange or base, for a hand-eye transform.",
    ),
]
ChildFrame = Annotated[
    str | None,
    typer.Option(
        "--child-frame",
        metavar="NAME",
        help="Name of the ROS frame of the sensor, for a hand-eye transform.",
    ),
]


UrdfFile = Annotated[
    Path | None,
    typer.Option(
        "--urdf",
        metavar="FILE",
        help="The URDF whose joint origins are corrected; FILE#LINK names its flange, too.",
    ),
]
Tip = Annotated[
    str | None, typer.Option("--tip", metavar="LINK", help="Link of the URDF that is the flange.")
]
Targets = Annotated[
    Path | None,
    typer.Option(
        "--targets", metavar="FILE", help="Targets of a robot program, as for `compensate`."
    ),
]


@dataclass(frozen=True)
class _Frames:
    """Names of the ROS frames that the user wants; None for the usual ones."""

    parent: str | None
    child: str | None


def command(
    source: Annotated[
        Path,
        typer.Argument(
            help="Run folder, solution.json, camera.toml, scanner.toml or hand-eye.toml."
        ),
    ],
    to: Annotated[str, typer.Option("--to", metavar="FORMAT", help=", ".join(ALL_FORMATS))],
    file: Annotated[Path, typer.Option("--out", metavar="FILE", help="File to write.")],
    force: Force = False,
    parent_frame: ParentFrame = None,
    child_frame: ChildFrame = None,
    without: WithoutOption = None,
    urdf: UrdfFile = None,
    tip: Tip = None,
    targets: Targets = None,
    map: TargetMap = None,
    start: Start = None,
    payload_kg: PayloadKg = None,
    json: answer.JsonTarget = None,
) -> None:
    """Write a calibrated model or a corrected program in another format; the file is read back as a check.

    A calibrated arm goes to urdf (your own file with corrected origins, where there is one), mjcf, python (one module
    that needs numpy alone), ros (kinematics of a Universal Robots arm), urscript, krl, rapid and fanuc (a program
    in which the --targets are corrected), mdh-json and mdh-csv. A camera or the camera of a scanner goes to ros, opencv
    and kalibr; a hand-eye transform to ros: a static transform and a launch file that publishes it.
    """
    answer.check_target(json)
    if to not in ALL_FORMATS:
        raise InputError(
            f"--to: expected one of {', '.join(ALL_FORMATS)}, found '{to}'; name one of them"
        )
    if not file.parent.is_dir() or file.is_dir():
        raise InputError(
            f"--out {file} expects a file in a folder that exists; make {file.parent} or name another"
        )
    kind, path = _choose(source, to)
    options = ArmOptions(urdf, tip, targets, tuple(without or ()), force, map, start, payload_kg)
    frames = _Frames(parent_frame, child_frame)
    with answer.progress(f"writing {file} and reading it back") as progress:
        step = counted(progress, STEPS)
        texts, left_out, notes = _made((kind, path), source, (to, file), frames, options, step)
    for target, text in texts.items():
        replace_file(target, text)
    other_files = [target for target in texts if target != file]
    result = {
        "command": "export",
        "source": source,
        "format": to,
        "file": file,
        "left_out": left_out,
        "notes": list(notes),
    }
    if other_files:
        result["launch_file" if kind == HAND_EYE else "control_file"] = other_files[0]
    answer.deliver(result, json)
    console = answer.console(json)
    if left_out:
        console.print(
            f"Not in this file, since its format cannot say it: {', '.join(left_out)}.",
            markup=False,
        )
    for note in notes:
        console.print(note, markup=False)
    for target in (*other_files, file):
        console.print(str(target), soft_wrap=True, markup=False)


def _made(content, source: Path, output, frames: _Frames, options: ArmOptions, step):
    """Texts by file, what the format cannot hold, and notes. InputError for options of another kind of source.

    content: kind of what goes out and its file; output: format and file to write; step: called with every step.
    """
    (kind, path), (format_name, file) = content, output
    if kind != HAND_EYE and (frames.parent or frames.child):
        raise InputError(
            f"--parent-frame, --child-frame: expected with a hand-eye transform only, found a {kind} in {source}; "
            "leave them out"
        )
    if kind != ARM and options != ArmOptions(force=options.force):
        raise InputError(
            "--without, --urdf, --tip, --targets, --map: expected with a calibrated arm only, found a "
            f"{kind} in {source}; leave them out"
        )
    if kind == HAND_EYE:
        return *_hand_eye(path, file, frames, options.force), ()
    if kind == CAMERA:
        text, left_out = _camera(path, format_name)
        return {file: text}, left_out, ()
    exported = export_arm(path, format_name, file, options, step)
    return exported.texts, exported.left_out, exported.notes


def _choose(source: Path, format_name: str) -> tuple[str, Path]:
    """Part of the source that goes to the format, and its file. InputError names the formats of the source."""
    found = _contents(source)
    # `ros` of a folder that also holds a camera or a hand-eye transform means these
    for kind, path in sorted(found.items(), key=lambda item: item[0] == ARM):
        if format_name in FORMATS[kind]:
            return kind, path
    if found:
        offered = "; ".join(f"of its {kind} {', '.join(FORMATS[kind])}" for kind in found)
        raise InputError(
            f"{source}: expected something that can be written as {format_name}, found none; it gives {offered}"
        )
    raise InputError(
        f"{source}: expected a run folder of `workbench calibrate`, `camera`, `scanner` or `handeye`, or one of "
        f"{', '.join(name for name, _ in _FILES)}, found none of them; name another"
    )


def _contents(source: Path) -> Mapping[str, Path]:
    """Kinds that a run folder holds, or that a file is, with their files."""
    if source.is_dir():
        return _contents_of_folder(source)
    if source.suffix.lower() == ".json":
        return {ARM: source}
    if not source.exists():
        return _by_name(source)
    return {HAND_EYE if _is_hand_eye(source) else CAMERA: source}


def _contents_of_folder(folder: Path) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for name, kind in _FILES:
        if (folder / name).is_file():
            found.setdefault(kind, folder / name)
    return found


def _by_name(source: Path) -> Mapping[str, Path]:
    """The kind of a file that is not there, so that the sentence names the file and not its kind."""
    return {kind: source for name, kind in _FILES if name == source.name}


def _is_hand_eye(source: Path) -> bool:
    from workbench.core.text.structured_text import ContentError, read_toml
    from workbench.files.exports.hand_eye import FORMAT

    try:
        return read_toml(source).get("format") == FORMAT
    except (OSError, ContentError):
        return False


def _camera(path, format_name) -> tuple[str, list[str]]:
    from workbench.files.exports import camera_text
    from workbench.files.exports.camera import with_supported_distortion
    from workbench.files.exports.check import check_camera, read_calibrated_camera

    camera, deviation = with_supported_distortion(read_calibrated_camera(path), format_name)
    text = camera_text(camera, format_name)
    check_camera(camera, text, format_name)
    return text, _left_out_of_camera(deviation, path.name == "scanner.toml")


def _left_out_of_camera(deviation: float, is_scanner: bool) -> list[str]:
    """What the export of a camera does not contain; deviation: px, of its distortion from the calibrated one."""
    left_out = []
    if deviation:
        left_out.append(
            f"terms beyond k1, k2, p1, p2, without which pixels are off by up to {deviation:.2g} px"
        )
    if is_scanner:
        left_out.append("light planes and mirror of the scanner")
    return left_out


def _hand_eye(
    path: Path, file: Path, frames: _Frames, force: bool
) -> tuple[dict[Path, str], list[str]]:
    from workbench.files.exports.check import check_static_transform
    from workbench.files.exports.hand_eye import (
        CHILD,
        StaticTransform,
        checked_hand_eye,
        launch_yaml,
        read_hand_eye,
        transform_yaml,
    )

    found = checked_hand_eye(read_hand_eye(path), path, force)
    hand_eye_transform = StaticTransform(
        found.matrix, frames.parent or found.parent, frames.child or CHILD
    )
    texts = {
        file: transform_yaml(hand_eye_transform),
        file.with_name(f"{file.stem}.launch.yaml"): launch_yaml(hand_eye_transform),
    }
    check_static_transform(hand_eye_transform, *texts.values())
    return texts, ["the uncertainty of the transform"]
