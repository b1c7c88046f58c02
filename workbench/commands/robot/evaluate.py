"""`workbench evaluate`: how well a finished model predicts a recording that it was not fitted to."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer, flow, tables


class Refit(StrEnum):
    """Parameters that are estimated again on the recording."""

    NONE = "none"
    BASE = "base"
    TOOL = "tool"
    BASE_AND_TOOL = "base-and-tool"


Solution = Annotated[
    Path,
    typer.Argument(
        help="Run folder of `workbench calibrate` or `workbench diagnose`, or its solution.json."
    ),
]
RefitOption = Annotated[
    Refit,
    typer.Option(
        "--refit",
        help="Estimate the pose of the instrument (base), the target on the flange (tool), or both on this recording.",
    ),
]

Later = Annotated[
    bool,
    typer.Option(
        "--later",
        help="Treat all samples as measured after those of the calibration, whatever their times: a drift keeps its "
        "last value, a shift remains.",
    ),
]


def command(
    solution: Solution,
    recording: answer.RecordingName,
    refit: RefitOption = Refit.NONE,
    later: Later = False,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    tolerance: answer.Tolerance = None,
    trust_data: answer.TrustData = False,
    no_report: answer.NoReport = False,
) -> None:
    """Test a calibrated model on another recording: position and orientation errors, without fitting the arm again.

    The errors of the nominal arm are stated for comparison, with base and tool estimated on the recording.
    """

    def work(run, progress) -> dict:
        import datasets
        from workbench.files.solution_file import read_solution
        from workbench.jobs.robot.evaluate import evaluate, save

        arm = read_solution(solution)
        read = datasets.read(recording, trust_data)
        tolerances = answer.read_tolerances(tolerance, read.measures)
        progress(f"predicting {read.n} samples")
        evaluated = evaluate(arm, read, str(refit), trust_data, later)
        save(evaluated, run.partial)
        result = evaluated.as_json(tolerances)
        if not no_report:
            from workbench.report.page import write_sheet
            from workbench.report.planning import evaluation

            write_sheet(evaluation.page(evaluated, result), run.partial)
        return {**result, "solution": solution}

    flow.run("evaluate", recording, out, json, work, _show)


def _show(console, result) -> None:
    title = f"{result['recording']}: {result['samples']} samples, refit: {result['refit']}"
    models = (
        ("calibrated arm", result["error"]),
        ("the same, base and tool estimated here", result["refitted"]),
        ("nominal arm, base and tool estimated here", result["nominal"]),
    )
    for unit, prefix in (("mm", ""), ("deg", "rotation_")):
        keys = [f"{prefix}{name}_{unit}" for name in ("rms", "mean", "p95", "max")]
        if keys[0] not in result["error"]:
            continue
        rows = [[name, *(errors[key] for key in keys)] for name, errors in models]
        tables.grid(console, title, ["model", f"RMS {unit}", "mean", "95 %", "max"], rows)
        title = "Orientation"
    from workbench.report.text import joint_label

    rows = [[joint_label(row["joint"]), *row["rms_mm"]] for row in result["by_joint"]]
    head = ["joint", "lowest third", "middle", "highest third"]
    tables.grid(console, "RMS position error by joint reading, mm", head, rows)
