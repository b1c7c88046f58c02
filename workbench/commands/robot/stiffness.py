"""`workbench stiffness`: what a wrench at the tool moves a calibrated arm by, pose by pose."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot.calibrate import WithoutOption
from workbench.commands.robot.compensate import Force
from workbench.commands.shared import answer, tables
from workbench.commands.shared.target_map import TargetMap
from workbench.core.errors import InputError
from workbench.files import runs
from workbench.fitting.verdicts.verdict import no_verdict

Source = Annotated[
    Path,
    typer.Argument(
        metavar="SOLUTION",
        help="Run folder of `workbench calibrate` or `workbench diagnose`, its solution.json, or a file of measured "
        "or published stiffness (TOML).",
    ),
]
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
    typer.Option(
        "--tool-point",
        metavar="X Y Z",
        help="Point at which the wrench acts, mm in the flange frame.",
    ),
]
_NO_RESIDUAL = "A stiffness is computed and not measured, so that there is no residual to judge."


def command(
    solution: Source,
    targets: Annotated[
        Path,
        typer.Argument(
            help="Joint readings, one row per pose: any table that `workbench import` reads."
        ),
    ],
    wrench: Wrench = None,
    tool_point: ToolPoint = (0.0, 0.0, 0.0),
    without: WithoutOption = None,
    force: Force = False,
    map: TargetMap = None,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
) -> None:
    """Compute the Cartesian compliance and stiffness of an arm at given poses, and its deflection under a wrench.

    Writes stiffness.csv, compliance.npy and stiffness.npy (n, 6, 6), a map of the workspace and a comparison of the
    rigid, joint, joint and bearing, and complete models as PDF and SVG, models.csv and map.vtk.
    """
    answer.check_target(json)
    runs.check_place(out)
    with answer.progress(f"reading {solution}"):
        from datasets.samples.columns import joint_columns
        from workbench.files.targets import read_programme
        from workbench.jobs.robot.stiffness import cartesian_stiffness, save

        arm = _arm(solution, without or (), force)
        programme = read_programme(targets, arm.robot, map)
        if programme.poses is not None:
            raise InputError(
                f"{targets}: expected joint readings q1_deg ..., found flange poses; correct them with "
                "`workbench compensate` first, which writes readings"
            )
        found = cartesian_stiffness(arm, programme.readings, tool_point)
        with runs.opened("stiffness", targets.stem, out) as run:
            joints = {
                name: programme.table.columns[name]
                for name in joint_columns(programme.table.columns)
            }
            save(found, wrench, run.partial, joints)
            stated = {"robot": arm.robot.name, "source": arm.keys.get("source", "")}
            result = {**_summary(found, wrench), **stated, "targets": targets, "run": run.path}
            runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    answer.deliver(result, json)
    _show(answer.console(json), result)


def _arm(source: Path, excluded_terms: list[str], force: bool):
    """The arm of a calibration, or of a file that states its stiffness, without the terms that are switched off."""
    from workbench.files.solution_file import read_solution, without_terms
    from workbench.files.stiffness_file import read_stiffness
    from workbench.jobs.robot.compensation.correction_limits import checked

    if source.suffix.lower() == ".toml":
        return without_terms(read_stiffness(source), excluded_terms, str(source))
    return without_terms(checked(read_solution(source), source, force), excluded_terms, str(source))


def _summary(found, wrench) -> dict:
    """Extremes over the poses; the first pose's matrices as an example of the units."""
    import numpy as np

    translational = found.translational()
    summary = {
        "command": "stiffness",
        "count": len(found.points),
        "compliance_least_mm_per_n": float(translational[:, 0].min()),
        "compliance_largest_mm_per_n": float(translational[:, 2].max()),
        "units": "twist (mm, rad) per wrench (N, N m), root frame",
        "wrench": None if wrench is None else list(wrench),
        "models": _models(found, wrench),
        "first_pose": {
            "tool_point_mm": found.points[0].tolist(),
            "compliance": found.total[0].tolist(),
            "stiffness": _plain(found.stiffness[0]),
        },
        "verdict": no_verdict(_NO_RESIDUAL).as_json(),
    }
    if wrench is None:
        return summary
    moved = found.deflection(np.array(wrench))
    norms = {part: np.linalg.norm(value[:, :3], axis=1) for part, value in moved.items()}
    total = np.linalg.norm(sum(moved.values())[:, :3], axis=1)
    summary["deflection_rms_mm"] = {part: _rms(value) for part, value in norms.items()}
    summary["deflection_rms_mm"]["total"] = _rms(total)
    summary["deflection_max_mm"] = float(total.max())
    return summary


def _models(found, wrench) -> list[dict]:
    """A row a model: RMS and largest translation (mm) under the wrench, or compliance (mm/N) without one."""
    unit = "mm_per_n" if wrench is None else "mm"
    return [
        {"model": name, f"rms_{unit}": _rms(values), f"max_{unit}": float(values.max())}
        for name, values in found.models(wrench).items()
    ]


def _plain(matrix) -> list[list[float]] | None:
    """The rows of a matrix; None where a direction does not deflect."""
    import numpy as np

    return matrix.tolist() if np.isfinite(matrix).all() else None


def _rms(values) -> float:
    return float((values**2).mean() ** 0.5)


def _show(console, result) -> None:
    rows = [
        ["least translational compliance, mm/N", result["compliance_least_mm_per_n"]],
        ["largest translational compliance, mm/N", result["compliance_largest_mm_per_n"]],
    ]
    for part, value in result.get("deflection_rms_mm", {}).items():
        rows.append([f"RMS deflection, {part}, mm", value])
    tables.grid(console, f"{result['count']} poses", ["", "value"], rows)
    unit = "mm_per_n" if result["wrench"] is None else "mm"
    models = [[m["model"], m[f"rms_{unit}"], m[f"max_{unit}"]] for m in result["models"]]
    title = "Models: " + ("largest compliance" if unit == "mm_per_n" else "deflection")
    shown = "mm/N" if unit == "mm_per_n" else "mm"
    tables.grid(console, title, ["what deflects", f"RMS {shown}", f"max {shown}"], models)
    console.print(str(result["run"]), soft_wrap=True, markup=False)
