"""`workbench identifiability`: parameters that a recording identifies, before any fit."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer, tables
from workbench.fitting.verdicts.verdict import no_verdict

_NO_RESIDUAL = "Nothing is fitted, so there is no residual to judge; run `workbench calibrate`."

Plan = Annotated[
    Path | None,
    typer.Option(
        "--plan",
        metavar="NAME|FILE",
        help="Use the stages of this plan instead of the default plan.",
    ),
]


def command(
    recording: Annotated[str, typer.Argument(help="Folder of a recording, or a known name.")],
    plan: Plan = None,
    json: answer.JsonTarget = None,
    trust_data: answer.TrustData = False,
) -> None:
    """State which parameters a recording identifies, and which are confounded."""
    answer.check_target(json)
    with answer.progress(f"reading {recording}") as say:
        import datasets
        from workbench.jobs.robot.identify import identifiability

        found = datasets.read(recording, trust_data)
        say("analysing the poses")
        result = {
            "command": "identifiability",
            "recording": recording,
            **identifiability(found, plan, trust_data),
        }
        result["verdict"] = no_verdict(_NO_RESIDUAL).as_json()
    answer.deliver(result, json)
    tables.identifiability(answer.console(json), result)
