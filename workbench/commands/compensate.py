"""`workbench compensate`: targets in, corrected targets out, with what error is left."""

from pathlib import Path
from typing import Annotated

import typer

from workbench import runs
from workbench.commands import answer, tables

Solution = Annotated[Path, typer.Argument(help="Run folder of `workbench calibrate`, or its solution.json.")]
Force = Annotated[bool, typer.Option("--force", help="Use a calibration that did not prove itself, too.")]


def command(
    solution: Solution,
    targets: Annotated[Path, typer.Argument(help="Joint readings or flange poses, a row a target (CSV).")],
    force: Force = False,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
) -> None:
    """Correct targets by inverting the calibrated model: where the nominal arm was sent, the real one goes.

    A target out of reach or limits keeps no joint readings, and the exit status is then 1.
    """
    answer.check_target(json)
    with answer.progress(f"reading {solution}") as say:
        from workbench.compensate import checked, compensate
        from workbench.programme import as_csv, corrected_columns, doubts, read_programme
        from workbench.solution_file import read_solution

        arm = checked(read_solution(solution), solution, force)
        programme = read_programme(targets, arm.robot)
        say("inverting the model")
        found = compensate(arm, programme.readings, programme.poses, programme.covariates, programme.anywhere)
        with runs.opened("compensate", targets.stem, out) as run:
            result = {
                **_summary(arm, found), "warnings": doubts(programme, arm.robot), "targets": targets,
                "solution": solution, "run": run.path, "corrected": run.path / "corrected.csv",
            }  # fmt: skip
            runs.replace_file(run.partial / "corrected.csv", as_csv(corrected_columns(programme, arm.robot, found)))
            runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    answer.deliver(result, json)
    _show(answer.console(json), result)
    if result["unreached_rows"]:
        raise typer.Exit(1)


def _summary(arm, found) -> dict:
    """What a person wants to know first; errors are 3-D, of the flange, in mm."""
    good = found.reached
    return {
        "command": "compensate", "count": len(good), "reached": int(good.sum()),
        "unreached_rows": [int(k) + 1 for k in (~good).nonzero()[0]],
        "correction_rms_mm": _rms(found.correction_mm[good]), "left_rms_mm": _rms(found.left_mm[good]),
        "sigma_rms_mm": _rms(found.sigma_mm[good]), "expected_error_mm": arm.held_out_mm,
        "nominal_error_mm": arm.keys["nominal"]["rms_mm"],
        "why_expected": "held-out RMS of the calibration: what the model does not explain comes back at every target",
    }  # fmt: skip


def _rms(values) -> float | None:
    return float((values**2).mean() ** 0.5) if len(values) else None


def _show(console, result) -> None:
    head = ["", "RMS mm"]
    rows = [["error of the nominal arm, held out", result["nominal_error_mm"]],
            ["error to expect now, held out", result["expected_error_mm"]],
            ["unsure at these targets, 1 sigma", result["sigma_rms_mm"]],
            ["the corrections, at the flange", result["correction_rms_mm"]],
            ["left by the inversion", result["left_rms_mm"]]]  # fmt: skip
    tables.grid(console, f"{result['reached']} of {result['count']} targets corrected", head, rows)
    for sentence in result["warnings"]:
        console.print(sentence, markup=False)
    if result["unreached_rows"]:
        console.print("Out of reach or limits, with no readings in corrected.csv: target "
                      f"{', '.join(map(str, result['unreached_rows'][:12]))}.")  # fmt: skip
    console.print(str(result["run"]), soft_wrap=True, markup=False)
