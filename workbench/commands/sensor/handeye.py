"""`workbench handeye`: images, profiles of a ball or measured points at flange poses in; the hand-eye transform out."""

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot import edit_session
from workbench.commands.shared import answer, flow, sensor_tables

HAND_EYE = "handeye"


class Kind(StrEnum):
    """Place of the sensor: on the flange, or stationary with the board on the flange."""

    IN_HAND = "in-hand"
    TO_HAND = "to-hand"


Recording = Annotated[
    str | None,
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
SessionFile = Annotated[
    Path | None,
    typer.Option(
        "--session",
        metavar="FILE",
        help="Repeat an edit session of `workbench open` (session.toml); replaces RECORDING, --camera, --scanner and "
        "--kind.",
    ),
]


def command(
    recording: Recording = None,
    camera: CameraFile = None,
    scanner: answer.ScannerFile = None,
    kind: Where = None,
    out: answer.OutFolder = None,
    tolerance: answer.Tolerance = None,
    trust_data: answer.TrustData = False,
    json: answer.JsonTarget = None,
    no_report: answer.NoReport = False,
    session: SessionFile = None,
) -> None:
    """Estimate the hand-eye transform from images, profiles, target poses or tracker points and flange poses."""
    given = {"RECORDING": recording, "--camera": camera, "--scanner": scanner, "--kind": kind}
    given["--trust-data"] = trust_data or None
    edits = edit_session.session_stated(session, HAND_EYE, given)
    options = _options(given) if edits is None else _session_options(edits)
    recording = recording if edits is None else edits.recording

    def work(run, progress) -> dict:
        import datasets
        from workbench.fitting.verdicts import hand_eye_verdict, verdict
        from workbench.jobs.sensor import hand_eye

        read = edit_session.edited(edits, datasets.read(recording, options["trust_data"]))
        units = hand_eye_verdict.units_of(read.measures)
        tolerances = verdict.parse_tolerances(tolerance, units)
        sensor = options["camera"] or options["scanner"]
        hand_eye_run = hand_eye.calibrate(
            read, sensor and Path(sensor), options["kind"], progress, options["trust_data"]
        )
        hand_eye.save(hand_eye_run, run.partial)
        edit_session.keep(edits, run.partial)
        if not no_report:
            progress("writing the report")
            _report(hand_eye_run, run.partial)
        stated = {"recording": recording, "options": options}
        return flow.with_reading_warnings(
            {**stated, **hand_eye.as_json(hand_eye_run, tolerances)}, read
        )

    flow.run(HAND_EYE, recording, out, json, work, sensor_tables.handeye)


def _options(given: Mapping) -> dict:
    """Options of the command line, with files as whole paths, so that a rerun in another folder finds them."""
    files = {name: given[f"--{name}"] for name in ("camera", "scanner")}
    kind = given["--kind"]
    return {
        **{name: None if path is None else str(path.resolve()) for name, path in files.items()},
        "kind": None if kind is None else kind.value,
        "trust_data": bool(given["--trust-data"]),
    }


def _session_options(edits) -> dict:
    """The same options as an edit session states them."""
    return {
        "camera": edits.camera or None,
        "scanner": edits.scanner or None,
        "kind": edits.kind or None,
        "trust_data": edits.trust_data,
    }


def _report(hand_eye_run, folder) -> None:
    from workbench.report.page import write_sheet
    from workbench.report.sensor import summary_image
    from workbench.report.sensor.handeye import page

    sheet = page(hand_eye_run)
    write_sheet(sheet, folder)
    summary_image.write_summary(sheet, summary_image.handeye(hand_eye_run), folder)
