"""`workbench export`: a calibrated arm or camera in another program's format, read back before it is kept."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands import answer
from workbench.commands.compensate import Force
from workbench.core.errors import InputError
from workbench.runs import replace_file

ARM, CAMERA = ("urdf", "mdh-json", "mdh-csv"), ("ros", "opencv", "kalibr")


def command(
    source: Annotated[Path, typer.Argument(help="Run folder, solution.json, camera.toml or scanner.toml.")],
    to: Annotated[str, typer.Option("--to", metavar="FORMAT", help=", ".join(ARM + CAMERA))],
    file: Annotated[Path, typer.Option("--out", metavar="FILE", help="Write this file.")],
    force: Force = False,
    json: answer.JsonTarget = None,
) -> None:
    """Write what was calibrated for another program; it is read back and compared before it is kept."""
    answer.check_target(json)
    if to not in ARM + CAMERA:
        raise InputError(f"--to {to}: expected one of {', '.join(ARM + CAMERA)}, found another; name one of them")
    if not file.parent.is_dir() or file.is_dir():
        raise InputError(f"--out {file} expects a file in a folder that exists; make {file.parent} or name another")
    text, left_out = _camera(source, to) if to in CAMERA else _arm(source, to, force)
    replace_file(file, text)
    answer.deliver({"command": "export", "source": source, "format": to, "file": file, "left_out": left_out}, json)
    console = answer.console(json)
    if left_out:
        console.print(f"Not in this file, since its format cannot say it: {', '.join(left_out)}.", markup=False)
    console.print(str(file), soft_wrap=True, markup=False)


def _arm(source, to, force) -> tuple[str, list[str]]:
    from workbench.correction_limits import checked
    from workbench.exports import mdh_csv, mdh_json, urdf
    from workbench.exports.check import check_mdh, check_urdf
    from workbench.exports.mdh import left_out
    from workbench.solution_file import read_solution

    arm = checked(read_solution(source), source, force)
    text = {"urdf": urdf, "mdh-json": mdh_json, "mdh-csv": mdh_csv}[to](arm)
    (check_urdf if to == "urdf" else check_mdh)(arm, text)
    return text, left_out(arm)


def _in_run(source: Path) -> Path:
    """The camera's or scanner's file of a run folder; any other path as it is."""
    there = [source / name for name in ("scanner.toml", "camera.toml") if (source / name).is_file()]
    return there[0] if there else source


def _camera(source, to) -> tuple[str, list[str]]:
    from workbench.exports import camera_text
    from workbench.exports.camera import as_held
    from workbench.exports.check import check_camera, read_calibrated_camera

    camera, off = as_held(read_calibrated_camera(_in_run(source)), to)
    text = camera_text(camera, to)
    check_camera(camera, text, to)
    return text, [f"terms beyond k1, k2, p1, p2, without which pixels are off by up to {off:.2g} px"] if off else []
