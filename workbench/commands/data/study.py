"""`workbench study`: many runs with varied parameters, collected in a table."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer, tables
from workbench.files import runs

StudyFile = Annotated[
    Path,
    typer.Argument(metavar="STUDY", help="A study file (TOML), or the name of a bundled study."),
]
Workers = Annotated[
    int | None,
    typer.Option("--workers", min=1, max=4096, help="Number of processes; default: all cores."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", metavar="ADDRESS", help="Address of a Dask scheduler, to run on a cluster."
    ),
]
Run = Annotated[
    int | None,
    typer.Option("--run", min=1, help="Compute only this run and print its row; writes nothing."),
]


def command(
    study: StudyFile,
    workers: Workers = None,
    scheduler: Scheduler = None,
    run: Run = None,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    no_report: answer.NoReport = False,
) -> None:
    """Run a study file: repeated simulation, calibration, diagnosis and compensation, with one table row per run.

    An interrupted study continues with the same command.
    """
    answer.check_target(json)
    if run is not None:
        _alone(study, run, json)
        return
    with answer.progress(f"reading {study}") as progress:
        from workbench.studies.study import carried_out

        def close(study_run, place, tell):
            _close(study_run, place, tell, no_report)

        finished = carried_out(study, out, workers, scheduler, progress, close)
    _deliver(finished, json)


def _close(study_run, place: Path, progress, no_report: bool) -> None:
    """Write answer.json and the report page into the folder of a study with a finished table."""
    from workbench.studies.summary import summary

    progress("computing the summary")
    found = summary(study_run)
    runs.replace_file(study_run.path / "answer.json", answer.as_text({**found, "run": place}))
    if not no_report:
        progress("writing the report")
        _write_report(study_run, found)


def _write_report(study_run, found: dict) -> None:
    from workbench.report.page import write_sheet
    from workbench.report.study.page import page

    write_sheet(page(study_run, found), study_run.path)


def _deliver(finished, json: str | None) -> None:
    import json as text

    found = text.loads((finished.path / "answer.json").read_text(encoding="utf-8"))
    answer.deliver(found, json)
    console = answer.console(json)
    if finished.done is None:
        console.print("This study is already finished.", markup=False)
    shown = _shown(found)
    rows = [
        [row["column"], row["n"], row["mean"], row["std"], row["p5"], row["median"], row["p95"]]
        for row in shown
    ]
    title = f"{found['title']}: {found['done']:,} of {found['runs']:,} runs done"
    tables.grid(console, title, ["column", "runs", "mean", "std", "5 %", "median", "95 %"], rows)
    if len(shown) < len(found["columns"]):
        unlisted_count = len(found["columns"]) - len(shown)
        console.print(
            f"{unlisted_count} more columns are in table.csv and on the report page.", markup=False
        )
    for sentence in found["sentences"]:
        console.print(sentence, markup=False)
    answer.last_line(console, finished.path)


_SHOWN = 12


def _shown(found: dict) -> list[dict]:
    """At most twelve rows: the outcome of the study, the same quantity of other models, other columns."""
    outcome = found["outcome"]
    ranked = sorted(found["columns"], key=lambda row: _rank(row["column"], outcome))
    return ranked[:_SHOWN]


def _rank(column: str, outcome: str | None) -> int:
    """0 for the outcome, 1 for a column of the same quantity (`…_test_3kg_mm`), 2 for others."""
    if outcome is None:
        return 2
    quantity = outcome.partition("_")[2]
    same = bool(quantity) and column.endswith(f"_{quantity}")
    return 0 if column == outcome else 2 - same


def _alone(study: Path, run: int, json: str | None) -> None:
    """One run, by its number."""
    with answer.progress(f"run {run} of {study}"):
        from workbench.core.errors import InputError
        from workbench.machine.processes import one_thread
        from workbench.studies.runs import row_of, seed_of
        from workbench.studies.study import read
        from workbench.studies.variation import count

        one_thread()
        found, _ = read(study)
        if run > count(found):
            raise InputError(
                f"--run {run}: expected one of the study's {count(found):,} runs, found none; lower it"
            )
        row = row_of(found, run)
    answer.deliver(
        {"command": "study", "study": study, "run": run, "seed": seed_of(found, run), "row": row},
        json,
    )
    rows = [list(pair) for pair in row.items()]
    tables.grid(answer.console(json), f"run {run} of {study}", ["column", "value"], rows)
