"""`workbench calibrate`: a recording in, parameters, held-out errors and a report page out."""

from pathlib import Path
from typing import Annotated

import typer

from workbench import runs
from workbench.commands import answer, samples, tables

Plan = Annotated[
    Path | None, typer.Option("--plan", metavar="FILE", help="Stages to solve (TOML).")
]
FitSamples = Annotated[
    Path | None,
    typer.Option("--fit-samples", metavar="FILE", help="Fit on these: a sample number a line."),
]
TestSamples = Annotated[
    Path | None,
    typer.Option("--test-samples", metavar="FILE", help="Hold out these: a sample number a line."),
]
Folds = Annotated[
    int, typer.Option("--folds", min=2, help="Blocks of the cross-validation.")
]


def command(
    recording: Annotated[str, typer.Argument(help="Folder of a recording, or a known name.")],
    plan: Plan = None,
    fit_samples: FitSamples = None,
    test_samples: TestSamples = None,
    folds: Folds = 10,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write no page.")] = False,
) -> None:
    """Calibrate the robot of a recording and say how large the held-out errors are, in mm."""
    answer.check_target(json)
    with answer.progress(f"reading {recording}") as say:
        import datasets

        found = datasets.read(recording)
        known = frozenset(found.sample_ids.tolist())
        fit = samples.read_list(fit_samples, known, "--fit-samples")
        test = samples.read_list(test_samples, known, "--test-samples")
        samples.check_apart(fit, test, test_samples)
        options = dict(plan=plan, fit_samples=fit, test_samples=test, folds=folds)
        result, run = solve(found, recording, options, say, out, report=not no_report)
    deliver(result, run, json)


def solve(found, name: str, options: dict, say, out: Path | None, report: bool):
    """Calibrate, save and report into a run folder; the answer and where it stands.

    found: a `datasets.recording.Recording`; options: keyword arguments of
    `workbench.calibrate.calibrate`. Raises InputError.
    """
    from workbench.calibrate import calibrate, save

    with runs.opened("calibrate", name, out) as run:
        say(f"calibrating {name}")
        calibration = calibrate(found, progress=say, **options)
        result = {**calibration.as_json(), "run": run.path}
        save(calibration, run.partial)
        if report:
            say("writing the report")
            _report(calibration, run.partial)
        runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    return result, run


def deliver(result: dict, run: runs.Run, json: str | None) -> None:
    """Show the answer to a person, write the JSON, and name the folder last."""
    answer.deliver(result, json)
    console = answer.console(json)
    tables.calibration(console, result)
    page = run.path / "report.html"
    console.print(str(page if page.exists() else run.path), soft_wrap=True, markup=False)


def _report(calibration, folder: Path) -> None:
    from workbench.report import write_report

    write_report(calibration, folder)
