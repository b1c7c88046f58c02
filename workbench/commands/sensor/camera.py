"""`workbench camera`: images of a board in, a calibrated camera with its uncertainty and a report page out."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot import edit_session
from workbench.commands.shared import answer, flow, sensor_tables
from workbench.commands.shared.lens_models import Lens, Model

Recording = Annotated[
    str | None,
    typer.Argument(help="Folder of a recording with images of a board, or a known name."),
]
SessionFile = Annotated[
    Path | None,
    typer.Option(
        "--session",
        metavar="FILE",
        help="Repeat an edit session of `workbench open` (session.toml); replaces RECORDING.",
    ),
]


def command(
    recording: Recording = None,
    model: Model = Lens.AUTO,
    out: answer.OutFolder = None,
    tolerance: answer.Tolerance = None,
    json: answer.JsonTarget = None,
    no_report: answer.NoReport = False,
    session: SessionFile = None,
) -> None:
    """Calibrate a camera from images of a board: intrinsics, distortion, their uncertainty, and reprojection errors."""
    from workbench.fitting.verdicts import sensor_verdict, verdict

    tolerances = verdict.parse_tolerances(tolerance, sensor_verdict.CAMERA_UNITS)
    edits = edit_session.session_stated(session, "camera", {"RECORDING": recording})
    recording = recording if edits is None else edits.recording

    def work(run, progress) -> dict:
        import datasets
        from workbench.jobs.sensor import camera

        read = edit_session.edited(edits, datasets.read(recording))
        edit_session.keep(edits, run.partial)
        calibration = camera.calibrate(read, model.value, progress)
        camera.save(calibration, run.partial)
        if not no_report:
            progress("writing the report")
            _report(calibration, run.partial)
        result = {
            "recording": recording,
            **camera.as_json(calibration, tolerances),
            "camera_file": run.path / camera.FILE,
        }
        return flow.with_reading_warnings(result, read)

    flow.run("camera", recording, out, json, work, sensor_tables.camera)


def _report(calibration, folder) -> None:
    from workbench.report.page import write_sheet
    from workbench.report.sensor import summary_image
    from workbench.report.sensor.camera import page

    sheet = page(calibration)
    write_sheet(sheet, folder)
    summary_image.write_summary(sheet, summary_image.camera(calibration), folder)
