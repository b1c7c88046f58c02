"""Writing a template: rows of the example, robot.toml from the named robot, and recording.toml with comments."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory

from datasets.errors import complaint
from datasets.formats.recording1_writer import write_csv
from datasets.recording import Recording
from datasets.samples.columns import KINDS as ALL_KINDS
from robot_model import builtin_robots
from workbench.core.robot_files.robot_description import (
    copy_description,
    file_and_tip,
    is_description,
)
from workbench.recordings.importing.robots import robot_keys
from workbench.recordings.templates import scanner_kinds
from workbench.recordings.templates.comments import recording_toml
from workbench.recordings.templates.examples import EXAMPLES
from workbench.recordings.templates.images import board_images, scan_images

KINDS = (*ALL_KINDS, *scanner_kinds.KINDS)
DEFAULT_ROBOT = "ur10"
DEFAULT_SCANNER_ROBOT = "abb_irb120"
_ROBOT_COMMENT = """# Nominal robot: one [[joint]] per joint, from the base outward. Replace it by your own data sheet.
#   theta_deg, d_mm, a_mm, alpha_deg: Denavit-Hartenberg row, Rz(q+theta) Tz(d) Tx(a) Rx(alpha)
#   hayati = true: the next axis is parallel (beta is estimated instead of d)
#   sign = -1: the controller counts the other way; limits_deg: [lowest, highest] reading
#   mass_kg, com_mm: body that moves with the joint, needed for compliance only
"""


@dataclass(frozen=True)
class Template:
    """Template as written: folder, kind, number of rows and images, and the names of the files."""

    folder: Path
    measures: str
    samples: int
    images: int
    files: tuple[str, ...]


def write_template(
    kind: str,
    folder: Path,
    robot: str | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Template:
    """Write a recording of a kind into a new folder, with comments and simulated example rows.

    kind: a kind of measurement, or a kind of scanner (`scanner_kinds.KINDS`).
    robot: built-in name, robot.toml, URDF or MJCF file of the nominal robot. Raises InputError for an unknown kind,
    a robot that the example cannot use, or a folder that holds files.
    """
    if kind not in KINDS:
        raise complaint(
            f"workbench new {kind}", f"one of {', '.join(KINDS)}", "another kind", "correct it"
        )
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise complaint(str(folder), "a new or empty folder", "files in it", "name another folder")
    if kind in scanner_kinds.KINDS and robot is not None:
        raise complaint(
            f"workbench new {kind} --robot {robot}",
            "no robot: this kind records flange poses, as any controller shows them, or none",
            "one",
            "omit the option",
        )
    default = DEFAULT_SCANNER_ROBOT if kind == "scan-images" else DEFAULT_ROBOT
    name = robot or default
    keys = dict(robot_keys(name, f"workbench new {kind}"))
    if "urdf" in keys:  # the example is simulated in another folder
        keys["urdf"] = str(Path(keys["urdf"]).resolve())
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as parent:
        example_folder = Path(parent) / "recording"
        recording = _example(kind, example_folder, keys, progress)
        _write_files(recording, example_folder, name, kind)
        files = tuple(
            sorted(
                str(path.relative_to(example_folder))
                for path in example_folder.rglob("*.*")
                if path.is_file()
            )
        )
        if folder.exists():
            folder.rmdir()
        example_folder.replace(folder)
    return Template(folder, recording.measures, recording.n, len(recording.images), files)


def _example(kind: str, folder: Path, keys: Mapping, progress) -> Recording:
    """The recording; images are rendered into `folder`."""
    if kind == "board-images":
        progress("rendering images")
        return board_images(folder, progress)
    if kind in scanner_kinds.KINDS:
        return scanner_kinds.example(kind, folder, progress).recording
    if kind == "scan-images":
        progress("rendering images")
        return scan_images(folder, _full_keys(keys), progress)
    folder.mkdir()
    progress("simulating rows")
    return EXAMPLES[kind](keys)


def _full_keys(keys: Mapping) -> dict:
    """Keys of robot.toml, of a built-in robot too."""
    import tomllib

    if "builtin" not in keys:
        return dict(keys)
    return tomllib.loads(_builtin_text(keys["builtin"]))


def _builtin_text(name: str) -> str:
    file = resources.files("robot_model").joinpath("robots", f"{name}.toml")
    return file.read_text(encoding="utf-8")


def _write_files(recording: Recording, folder: Path, robot: str, kind: str) -> None:
    """Tables, robot and the commented recording.toml, over what rendering has written."""
    if recording.columns and not (folder / "samples.csv").exists():
        write_csv(folder / "samples.csv", recording.columns)
    if recording.balls and not (folder / "artefact.csv").exists():
        rows = zip(*((ball, *xyzr) for ball, xyzr in recording.balls.items()))
        write_csv(
            folder / "artefact.csv", dict(zip(("ball", "x_mm", "y_mm", "z_mm", "radius_mm"), rows))
        )
    text = recording_toml(recording, bool(recording.columns), kind)
    if recording.robot:
        if is_description(robot):
            file, tip = file_and_tip(robot)
            text = text.replace('"robot.toml"', f'"{copy_description(file, folder)}"')
            if tip is not None:
                text = text.replace("[robot]", f'[robot]\ntip = "{tip}"', 1)
        else:
            if robot in builtin_robots():
                source = _builtin_text(robot)
            else:
                source = Path(robot).read_text("utf-8")
            (folder / "robot.toml").write_text(_ROBOT_COMMENT + source, encoding="utf-8")
    (folder / "recording.toml").write_text(text, encoding="utf-8", newline="\n")
