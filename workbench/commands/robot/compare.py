"""`workbench compare`: cross-validated comparison of several plans on one recording."""

from typing import Annotated

import typer

from workbench.commands.robot.calibrate import FitSamples, Folds, TestSamples
from workbench.commands.shared import answer, samples, tables
from workbench.files import runs

Plans = Annotated[
    list[str],
    typer.Option(
        "--plan",
        metavar="NAME|FILE",
        help="Plan: a name such as default, a TOML file, or a run folder of `workbench diagnose`. Repeatable.",
    ),
]


def command(
    recording: answer.RecordingName,
    plan: Plans,
    fit_samples: FitSamples = None,
    test_samples: TestSamples = None,
    folds: Folds = 10,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    tolerance: answer.Tolerance = None,
    trust_data: answer.TrustData = False,
    no_report: answer.NoReport = False,
) -> None:
    """Compare calibration plans on one recording: held-out errors on the same folds, with significance tests."""
    answer.check_target(json)
    with answer.progress(f"reading {recording}") as progress:
        import datasets
        from workbench.jobs.robot.compare import compare, save

        found = datasets.read(recording, trust_data)
        known = frozenset(found.sample_ids.tolist())
        fit = samples.read_list(fit_samples, known, "--fit-samples")
        test = samples.read_list(test_samples, known, "--test-samples")
        samples.check_apart(fit, test, test_samples)
        tolerances = answer.read_tolerances(tolerance, found.measures)
        with runs.opened("compare", recording, out) as run:
            comparison = compare(found, plan, fit, test, folds, progress, trust_data)
            save(comparison, run.partial)
            result = {**comparison.as_json(tolerances), "run": run.path}
            if not no_report:
                _write_page(comparison, result, run.partial)
            runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    answer.deliver(result, json)
    console = answer.console(json)
    _show(console, result)
    answer.conclude(console, result, run.path)


def _write_page(comparison, result, folder) -> None:
    from workbench.report.page import write_sheet
    from workbench.report.planning import compare as sheet

    write_sheet(sheet.page(comparison, result), folder)


def _show(console, result) -> None:
    tables.warnings(console, result)
    title = f"{result['recording']}: {result['held_out_samples']} samples held out by {result['held_out_by']}"
    for unit, prefix in (("mm", ""), ("deg", "rotation_")):
        if f"fit_{prefix}rms_{unit}" not in result["plans"][0]:
            continue
        head = [
            "plan",
            "free",
            "identified",
            f"fit RMS {unit}",
            "held out",
            "mean",
            "std",
            "max",
            "ratio",
            "p",
        ]
        errors = [f"{name}_{unit}" for name in ("rms", "mean", "std", "max")]
        keys = [f"fit_{prefix}{errors[0]}", *(f"held_out_{prefix}{name}" for name in errors)]
        keys = ["free", "identifiable", *keys, f"{prefix}ratio", f"{prefix}p"]
        rows = [[row["plan"], *(row[key] for key in keys)] for row in result["plans"]]
        tables.grid(console, title, head, rows)
        title = "Orientation"
    for row in result["plans"]:
        if row["p"] is None and row["test"].startswith("not computed"):
            console.print(f"p of {row['plan']} {row['test']}", markup=False)
