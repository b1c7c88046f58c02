"""`workbench significance`: sensitivity of the end-effector pose to each kinematic parameter."""

from typing import Annotated

import typer

from workbench.commands.shared import answer, tables
from workbench.files import runs
from workbench.fitting.verdicts.verdict import no_verdict

_NO_RESIDUAL = (
    "Sensitivities are computed from the nominal robot alone, so there is no residual to judge."
)


def command(
    robot: Annotated[
        str, typer.Argument(help="Built-in robot, robot.toml, URDF, MJCF, or a recording.")
    ],
    points: Annotated[
        int,
        typer.Option(
            "--points", min=1, help="Number of configurations, random or from a recording."
        ),
    ] = 50,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="Seed of the random configurations.")
    ] = 0,
    step_mm: Annotated[float, typer.Option("--mm", min=1e-6, help="Error of a length, mm.")] = 0.1,
    step_rad: Annotated[
        float, typer.Option("--rad", min=1e-9, help="Error of an angle, rad.")
    ] = 0.1,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    no_report: answer.NoReport = False,
) -> None:
    """Compute how an error of each parameter of a robot changes position and axes of the flange."""
    answer.check_target(json)
    runs.check_place(out)
    with answer.progress(f"reading {robot}") as report:
        from workbench.jobs.robot.significance import robot_called, save, significance

        arm, readings = robot_called(robot)
        found = significance(arm, points, seed, step_mm, step_rad, readings, report)
        report("drawing")
        with runs.opened("significance", robot, out) as run:
            save(found, run.partial)
            if not no_report:
                from workbench.report.page import write_sheet
                from workbench.report.planning import significance as sheet

                write_sheet(sheet.page(found), run.partial)
            result = {
                **found.as_json(),
                "verdict": no_verdict(_NO_RESIDUAL).as_json(),
                "run": run.path,
            }
            runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    answer.deliver(result, json)
    _show(answer.console(json), result)


def _show(console, result) -> None:
    keys = [f"index_{part}" for part in ("position", "x", "y", "z")]
    rows = [[row["parameter"], *(row[key] for key in keys)] for row in result["parameters"]]
    step = f"{result['step_mm']:g} mm or {result['step_rad']:g} rad"
    title = (
        f"{result['robot']}: mean change by {step}, {result['points']} {result['configurations']}"
    )
    tables.grid(console, title, ["parameter", "position, mm", "x axis", "y axis", "z axis"], rows)
    for part, index_without in result["without_effect"].items():
        angles = [
            key for key in index_without if ".d" not in key and (".a" not in key or "alpha" in key)
        ]
        if part != "position" and angles:
            console.print(
                f"The {part} axis alone is not sensitive to {', '.join(angles)}.", markup=False
            )
    answer.last_line(console, result["run"])
