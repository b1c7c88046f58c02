"""`workbench demo`: from rendered images to a calibrated arm, and a real arm under a tracker; nothing to prepare."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot import calibrate
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
        bool, typer.Option("--bundled", help="Use the small table of an arm that is always there.")
    ] = False,
    images: Annotated[
        bool,
        typer.Option("--pictures/--no-pictures", help="Render images and calibrate from them too."),
    ] = True,
) -> None:
    """Render images and calibrate scanner and arm from them; then a real arm's table where one is found.

    No public set holds the whole chain from images to the arm, so that its images are rendered;
    the table is measured on a real robot, else the bundled one; it says which.
    """
    answer.check_target(json)
    name, recording, why = choose(bundled)
    console = answer.console(json)
    console.print(f"{why}\n", markup=False)
    with runs.opened("demo", name, out) as run:
        rendered = None
        if images:
            with answer.progress("rendering images") as say:
                rendered = _from_pictures(run, say)
            _show(console, rendered)
        (run.partial / TRACKER).mkdir()
        with answer.progress(f"calibrating {name}") as say:
            table = calibrate.solve_into(
                run.partial / TRACKER, run.path / TRACKER, recording, name, {}, say, True
            )
            _front(run.partial, rendered, table, why)
        result = {**table, "command": "demo", "from_pictures": rendered, "run": run.path}
        runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    calibrate.deliver(result, run, json)


def choose(bundled: bool) -> tuple:
    """Which table of an arm to show: its name, the recording and the sentence that says why.

    bundled: leave real recordings aside even where there are any.
    """
    import datasets

    if bundled:
        return BUNDLED, datasets.read(BUNDLED), f"Recording: {BUNDLED}, bundled, as asked."
    try:
        recording = datasets.read(REAL)
    except InputError as missing:
        return (
            BUNDLED,
            datasets.read(BUNDLED),
            (f"Recording: {BUNDLED}, bundled, because the real one is not here: {missing}"),
        )
    return REAL, recording, f"Recording: {REAL}, measured on a real robot."


def scene() -> Path:
    """The scene that is rendered; it comes with the package."""
    from importlib import resources

    return Path(str(resources.files("workbench").joinpath("files", "demo_scenes", SCENE)))


def _from_pictures(run: runs.Run, say) -> dict:
    """Rendered images -> scanner -> clouds -> ball centres -> arm, and how far that is from the truth."""
    import datasets
    from workbench.imaging.ground_truth import centre_errors
    from workbench.jobs.render import render

    folder, place = run.partial / RENDERED, run.path / RENDERED
    folder.mkdir()
    truth = render(scene(), folder / IMAGES, say)["truth"]
    runs.replace_file(folder / "truth.json", answer.as_text(truth))
    found = datasets.read(folder / IMAGES)
    made = calibrate.solve_into(folder, place, found, "rendered images", {}, say, True)
    return {
        **made,
        "recording": str(place / IMAGES),
        "against_truth": centre_errors(made["sensor"]["scans"], truth),
    }


def _show(console, rendered: dict) -> None:
    """The rendered chain in a terminal."""
    told, camera = rendered["against_truth"], rendered["sensor"]["calibration"]["camera"]
    planes = rendered["sensor"]["calibration"]["plane_rms_mm"]
    rows = [
        ["corners, RMS a coordinate", camera["rms_coordinate_px"], "px"],
        ["stripes from their planes, RMS", planes, "mm"],
        ["ball centres from the truth, RMS", told["rms_mm"], "mm"],
        ["arm, held-out RMS", rendered["held_out"]["rms_mm"], "mm"],
    ]
    tables.grid(console, "From rendered images to the arm", ["", "value", "unit"], rows)


def _front(folder: Path, rendered: dict | None, table: dict, why: str) -> None:
    from workbench.report.front import page
    from workbench.report.page import write_sheet

    write_sheet(page(folder, rendered, table, why), folder)
