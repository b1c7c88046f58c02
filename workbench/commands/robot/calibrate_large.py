"""`workbench calibrate-large`: calibrates a recording that does not fit into memory, in chunks of samples."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot.calibrate import Folds
from workbench.commands.shared import answer, tables
from workbench.files import runs

Plan = Annotated[
    Path | None, typer.Option("--plan", metavar="NAME|FILE", help="Plan: a name or a TOML file.")
]


def command(
    recording: Annotated[
        Path, typer.Argument(help="Folder of a recording whose samples are a samples.parquet.")
    ],
    plan: Plan = None,
    folds: Folds = 10,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    tolerance: answer.Tolerance = None,
    trust_data: answer.TrustData = False,
) -> None:
    """Calibrate an arm from millions of samples (Parquet), with little memory: parameters and held-out errors.

    The stages are selected on a subset of the samples; then all samples are fitted.
    """
    answer.check_target(json)
    with answer.progress(f"reading {recording}") as progress:
        from datasets.formats.recording1 import read_head
        from workbench.fitting.verdicts.calibration_verdict import calibration_verdict
        from workbench.jobs.robot.calibrate_large import calibrate_chunks, save

        tolerances = answer.read_tolerances(tolerance, read_head(recording)[0].measures)
        with runs.opened("calibrate-large", recording, out) as run:
            calibration = calibrate_chunks(recording, plan, folds, progress, trust_data)
            save(calibration, run.partial)
            verdict = calibration_verdict(calibration.held_out, calibration.noise, tolerances)
            result = {**calibration.as_json(), "verdict": verdict.as_json(), "run": run.path}
            runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    answer.deliver(result, json)
    console = answer.console(json)
    tables.calibration(console, result)
    answer.conclude(console, result, run.path)
