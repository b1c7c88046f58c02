"""`workbench handeye`: images of a board, or profiles of a ball, at flange poses in; the hand-eye transform out."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer, flow, sensor_tables


class Kind(StrEnum):
    """Place of the sensor: on the flange, or stationary with the board on the flange."""

    IN_HAND = "in-hand"
    TO_HAND = "to-hand"


Recording = Annotated[
    str,
    typer.Argument(
        help="Folder of a recording with flange poses or joint readings, or a known name."
    ),
]
CameraFile = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        metavar="FILE",
        help="Use this calibrated camera (camera.toml of `workbench camera`).",
    ),
]
Where = Annotated[
    Kind | None,
    typer.Option(
        "--kind",
        help="Sensor on the flange or stationary; default: key fixed_to of [board].",
    ),
]


def command(
    recording: Recording,
    camera: CameraFile = None,
    scanner: answer.ScannerFile = None,
    kind: Where = None,
    out: answer.OutFolder = None,
    tolerance: answer.Tolerance = None,
    trust_data: answer.TrustData = False,
    json: answer.JsonTarget = None,
    no_report: answer.NoReport = False,
) -> None:
    """Estimate the pose of the sensor on the flange, and its prediction error on held-out poses."""

    def work(run, say) -> dict:
        import datasets
        from workbench.fitting.verdicts import hand_eye_verdict, verdict
        from workbench.jobs.sensor import hand_eye

        read = datasets.read(recording, trust_data)
        is_profile = read.measures in ("ball-surface", "ball-centre")
        units = hand_eye_verdict.PROFILE_UNITS if is_profile else hand_eye_verdict.UNITS
        tolerances = verdict.parse_tolerances(tolerance, units)
        made = hand_eye.calibrate(read, camera or scanner, kind and kind.value, say, trust_data)
        hand_eye.save(made, run.partial)
        if not no_report:
            say("writing the report")
            _report(made, run.partial)
        return flow.with_reading_warnings(
            {"recording": recording, **hand_eye.as_json(made, tolerances)}, read
        )

    flow.run("handeye", recording, out, json, work, sensor_tables.handeye)


def _report(made, folder) -> None:
    from workbench.report.page import write_sheet
    from workbench.report.sensor import summary_image
    from workbench.report.sensor.handeye import page

    sheet = page(made)
    write_sheet(sheet, folder)
    summary_image.write_summary(sheet, summary_image.handeye(made), folder)
