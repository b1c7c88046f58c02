"""`workbench stiffness`: what a wrench at the tool moves a calibrated arm by, pose by pose."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot.calibrate import Without
from workbench.commands.robot.compensate import Force, Solution
from workbench.commands.shared import answer, tables
from workbench.core.errors import InputError
from workbench.files import runs
from workbench.fitting.verdicts.verdict import no_verdict

Wrench = Annotated[
    tuple[float, float, float, float, float, float] | None,
    typer.Option(
        "--wrench",
        metavar="FX FY FZ MX MY MZ",
        help="Force (N) and moment (N m) at the tool point, in the robot's root frame.",
    ),
]
ToolPoint = Annotated[
    tuple[float, float, float],
    typer.Option("--tool-point", metavar="X Y Z", help="Where it acts, mm in the flange frame."),
]
_NO_RESIDUAL = "A stiffness is computed and not measured, so that there is no residual to judge."


def command(
    solution: Solution,
    targets: Annotated[Path, typer.Argument(help="Joint readings, a row a pose (CSV).")],
    wrench: Wrench = None,
    tool_point: ToolPoint = (0.0, 0.0, 0.0),
    without: Without = None,
    force: Force = False,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
) -> None:
    """Cartesian compliance and stiffness of a calibrated arm, and its deflection under a wrench by joint, bearing,
    link and pedestal.

    Writes stiffness.csv, compliance.npy (n, 6, 6), a map of the workspace as PDF and SVG, and map.vtk.
    """
    answer.check_target(json)
    runs.check_place(out)
    with answer.progress(f"reading {solution}"):
        from workbench.files.solution_file import read_solution, without_terms
        from workbench.files.targets import read_programme
        from workbench.jobs.robot.correction_limits import checked
        from workbench.jobs.robot.stiffness import cartesian_stiffness, save

        arm = checked(read_solution(solution), solution, force)
        arm = without_terms(arm, without or (), str(solution))
        programme = read_programme(targets, arm.robot)
        if programme.poses is not None:
            raise InputError(
                f"{targets}: expected joint readings q1_deg ..., found flange poses; correct them with "
                "`workbench compensate` first, which writes readings"
            )
        found = cartesian_stiffness(arm, programme.readings, tool_point)
        with runs.opened("stiffness", targets.stem, out) as run:
            save(found, wrench, run.partial)
            result = {**_summary(found, wrench), "targets": targets, "run": run.path}
            runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    answer.deliver(result, json)
    _show(answer.console(json), result)


def _summary(found, wrench) -> dict:
    """Extremes over the poses; the first pose's matrices as an example of the units."""
    import numpy as np

    translational = found.translational()
    made = {
        "command": "stiffness",
        "count": len(found.points),
        "compliance_least_mm_per_n": float(translational[:, 0].min()),
        "compliance_largest_mm_per_n": float(translational[:, 2].max()),
        "units": "twist (mm, rad) per wrench (N, N m), root frame",
        "wrench": None if wrench is None else list(wrench),
        "verdict": no_verdict(_NO_RESIDUAL).as_json(),
    }
    if wrench is None:
        return made
    moved = found.deflection(np.array(wrench))
    parts = {part: np.linalg.norm(value[:, :3], axis=1) for part, value in moved.items()}
    total = np.linalg.norm(sum(moved.values())[:, :3], axis=1)
    made["deflection_rms_mm"] = {part: _rms(value) for part, value in parts.items()}
    made["deflection_rms_mm"]["total"] = _rms(total)
    made["deflection_max_mm"] = float(total.max())
    return made


def _rms(values) -> float:
    return float((values**2).mean() ** 0.5)


def _show(console, result) -> None:
    rows = [
        ["least translational compliance, µm/N", 1e3 * result["compliance_least_mm_per_n"]],
        ["largest translational compliance, µm/N", 1e3 * result["compliance_largest_mm_per_n"]],
    ]
    for part, value in result.get("deflection_rms_mm", {}).items():
        rows.append([f"RMS deflection, {part}, mm", value])
    tables.grid(console, f"{result['count']} poses", ["", "value"], rows)
    console.print(str(result["run"]), soft_wrap=True, markup=False)
