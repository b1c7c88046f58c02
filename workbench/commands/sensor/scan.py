"""`workbench scan`: images of scans in; clouds, ball centres with their uncertainty and acceptance figures out."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer, flow, sensor_tables

Recording = Annotated[
    str,
    typer.Argument(
        help="Folder of a recording with images of scans, or with points on balls, or a known name."
    ),
]

HandEyeFile = Annotated[
    Path | None,
    typer.Option(
        "--hand-eye",
        metavar="FILE",
        help="Join images of several flange poses with this transform (hand-eye.toml of `workbench handeye`).",
    ),
]


def command(
    recording: Recording,
    scanner: answer.ScannerFile = None,
    hand_eye: HandEyeFile = None,
    out: answer.OutFolder = None,
    tolerance: answer.Tolerance = None,
    json: answer.JsonTarget = None,
    no_report: answer.NoReport = False,
) -> None:
    """Compute point clouds and ball centres from images of laser scans, or from profiles or clouds of balls.

    Without --scanner, the scanner is calibrated first. Images, profiles and clouds of several flange poses are joined
    in the base frame of the robot; without --hand-eye, the hand-eye transform is calibrated first.
    """
    from workbench.fitting.verdicts import sensor_verdict, verdict

    tolerances = verdict.parse_tolerances(tolerance, sensor_verdict.SCAN_UNITS)

    def work(run, progress) -> dict:
        import datasets
        from workbench.jobs.sensor import ball_centres, scan, surface_scan

        read = datasets.read(recording)
        if read.measures == "ball-surface":
            scan_run = surface_scan.join_surface(read, hand_eye, run.partial, progress)
        else:
            scan_run = scan.scan(read, scanner, run.partial, progress, hand_eye)
        progress("writing the ball centres")
        ball_centres.save(scan_run, run.partial)
        if not no_report:
            progress("writing the report")
            _report(scan_run, run.partial)
        result = {"recording": recording, **ball_centres.as_json(scan_run, run.path, tolerances)}
        return flow.with_reading_warnings(result, read)

    flow.run("scan", recording, out, json, work, sensor_tables.scan)


def _report(scan_run, folder) -> None:
    from workbench.report.page import write_sheet
    from workbench.report.sensor import summary_image
    from workbench.report.sensor.scan import page

    sheet = page(scan_run)
    write_sheet(sheet, folder)
    summary_image.write_summary(sheet, summary_image.scan(scan_run), folder)
