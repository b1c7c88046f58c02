"""`workbench identifiability`: parameters that a recording identifies, before any fit."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer, flow, tables
from workbench.fitting.verdicts.verdict import no_verdict

_NO_RESIDUAL = "Nothing is fitted, so there is no residual to judge; run `workbench calibrate`."

Plan = Annotated[
    Path | None,
    typer.Option(
        "--plan",
        metavar="NAME|FILE",
        help="Plan (name or TOML file) instead of the default plan.",
    ),
]


def command(
    recording: answer.RecordingName,
    plan: Plan = None,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    trust_data: answer.TrustData = False,
    no_report: answer.NoReport = False,
) -> None:
    """List the parameters that a recording identifies and those that are confounded; nothing is fitted."""

    def work(run, report) -> dict:
        import datasets
        from workbench.jobs.robot.identify import identifiability

        found = datasets.read(recording, trust_data)
        report("analysing the poses")
        result = {"recording": recording, **identifiability(found, plan, trust_data, report)}
        if not no_report:
            report("writing the report")
            _write_report(found, result, run.partial)
        return {**result, "verdict": no_verdict(_NO_RESIDUAL).as_json()}

    flow.run("identifiability", recording, out, json, work, tables.identifiability)


def _write_report(recording, result: dict, folder: Path) -> None:
    from workbench.report.page import write_sheet
    from workbench.report.planning import identifiability

    write_sheet(identifiability.page(recording, result), folder)
