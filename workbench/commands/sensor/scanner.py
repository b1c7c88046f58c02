"""`workbench scanner`: images of a board, without and with the laser, in; a calibrated scanner out."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer, flow, sensor_tables
from workbench.commands.shared.lens_models import Lens, Model
from workbench.files import runs

Recording = Annotated[
    str,
    typer.Argument(
        help="Folder of a recording with images of a board under the laser, or a known name."
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="FILE",
        help="Also write the scanner to this file; other commands read it with --scanner FILE.",
    ),
]


def command(
    recording: Recording,
    out: Out = None,
    model: Model = Lens.AUTO,
    tolerance: answer.Tolerance = None,
    json: answer.JsonTarget = None,
    no_report: answer.NoReport = False,
) -> None:
    """Calibrate a laser scanner from images of a board: camera, light planes and mirror axis in one adjustment."""
    answer.check_target(None if out is None else str(out), "--out")

    from workbench.fitting.verdicts import sensor_verdict, verdict

    tolerances = verdict.parse_tolerances(tolerance, sensor_verdict.SCANNER_UNITS)

    def work(run, progress) -> dict:
        import datasets
        from workbench.jobs.sensor import scanner

        read = datasets.read(recording)
        scanner_run = scanner.calibrate(read, model.value, progress)
        scanner.save(scanner_run, run.partial)
        if not no_report:
            progress("writing the report")
            _report(scanner_run, run.partial)
        if out is not None:
            runs.replace_file(out, (run.partial / scanner.FILE).read_text(encoding="utf-8"))
        place = out.resolve() if out else run.path / scanner.FILE
        result = {
            "recording": recording,
            **scanner.as_json(scanner_run, tolerances),
            "scanner_file": place,
        }
        return flow.with_reading_warnings(result, read)

    flow.run("scanner", recording, None, json, work, sensor_tables.scanner)


def _report(scanner_run, folder) -> None:
    from workbench.report.page import write_sheet
    from workbench.report.sensor import summary_image
    from workbench.report.sensor.scanner import page

    sheet = page(scanner_run)
    write_sheet(sheet, folder)
    summary_image.write_summary(sheet, summary_image.scanner(scanner_run), folder)
