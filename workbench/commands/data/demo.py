"""`workbench demo`: from rendered images to a calibrated arm, and a real arm measured by a tracker."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot import calibration_run
from workbench.commands.shared import answer, tables
from workbench.core.errors import InputError
from workbench.files import runs

REAL = "irb120_faro"
BUNDLED = "elastic-arm"
SCENE = "scanner-on-arm.toml"
RENDERED, TRACKER, IMAGES = "from-pictures", "tracker", "recording"


def command(
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    bundled: Annotated[
        bool,
        typer.Option(
            "--bundled", help="Use the bundled table of an arm instead of a real recording."
        ),
    ] = False,
    images: Annotated[
        bool,
        typer.Option(
            "--pictures/--no-pictures", help="Render images and calibrate the scanner from them."
        ),
    ] = True,
) -> None:
    """Run a complete example: calibrate scanner and arm from rendered images, then an arm from a table of points.

    No public data set covers the whole chain from images to the arm, so the images are rendered.
    The table is that of a real robot if it is available, else the bundled one.
    """
    answer.check_target(json)
    name, recording, why = choose(bundled)
    console = answer.console(json)
    console.print(f"{why}\n", markup=False)
    with runs.opened("demo", name, out) as run:
        rendered = None
        if images:
            with answer.progress("rendering images") as progress:
                rendered = _from_images(run, progress)
            _show(console, rendered)
        (run.partial / TRACKER).mkdir()
        with answer.progress(f"calibrating {name}") as progress:
            table = calibration_run.solve_into(
                run.partial / TRACKER, run.path / TRACKER, recording, name, {}, progress, True
            )
            _front(run.partial, rendered, table, why)
        result = {**table, "command": "demo", "from_pictures": rendered, "run": run.path}
        runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    calibration_run.deliver(result, run, json)


def choose(bundled: bool) -> tuple:
    """The table of an arm to use: its name, the recording, and a sentence with the reason.

    bundled: use the bundled table even if a real recording is available.
    """
    import datasets

    if bundled:
        return BUNDLED, datasets.read(BUNDLED), f"Recording: {BUNDLED}, bundled, as requested."
    try:
        recording = datasets.read(REAL)
    except InputError as missing:
        why = f"Recording: {BUNDLED}, bundled, because the real one is not here: {missing}"
        return BUNDLED, datasets.read(BUNDLED), why
    return REAL, recording, f"Recording: {REAL}, measured on a real robot."


def scene() -> Path:
    """The bundled scene of the rendering."""
    from importlib import resources

    return Path(str(resources.files("workbench").joinpath("files", "demo_scenes", SCENE)))


def _from_images(run: runs.Run, progress) -> dict:
    """Rendered images -> scanner -> clouds -> ball centres -> arm, and the error against the truth."""
    import datasets
    from workbench.files.images.ground_truth import centre_errors
    from workbench.jobs.sensor.render import render

    folder, place = run.partial / RENDERED, run.path / RENDERED
    folder.mkdir()
    truth = render(scene(), folder / IMAGES, progress)["truth"]
    runs.replace_file(folder / "truth.json", answer.as_text(truth))
    found = datasets.read(folder / IMAGES)
    calibration = calibration_run.solve_into(
        folder, place, found, "rendered images", {}, progress, True
    )
    return {
        **calibration,
        "recording": str(place / IMAGES),
        "against_truth": centre_errors(calibration["sensor"]["scans"], truth),
    }


def _show(console, rendered: dict) -> None:
    """Print the results of the rendered chain."""
    sensor = rendered["sensor"]["calibration"]
    corner_rms = sensor["camera"]["rms_coordinate_px"]
    centre_rms = rendered["against_truth"]["rms_mm"]
    arm_rms = rendered["held_out"]["rms_mm"]
    rows = [
        ["corners, RMS per coordinate", corner_rms, "px"],
        ["stripe points from their planes, RMS", sensor["plane_rms_mm"], "mm"],
        ["ball centres from the truth, RMS", centre_rms, "mm"],
        ["arm, held-out RMS", arm_rms, "mm"],
    ]
    tables.grid(console, "From rendered images to the arm", ["", "value", "unit"], rows)


def _front(folder: Path, rendered: dict | None, table: dict, why: str) -> None:
    from workbench.report.front import page
    from workbench.report.page import write_sheet

    write_sheet(page(folder, rendered, table, why), folder)
