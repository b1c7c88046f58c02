"""`workbench poses`: optimal selection of the poses to measure."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot.calibrate import WithoutOption
from workbench.commands.shared import answer, tables
from workbench.commands.shared.model_run import SCENE, is_model_run
from workbench.core.errors import InputError
from workbench.files import runs
from workbench.fitting.verdicts import verdict

StandOff = Annotated[
    tuple[float, float] | None,
    typer.Option("--stand-off", metavar="NEAR FAR", help="Distance of a ball from the sensor, mm."),
]
Tasks = Annotated[
    str | None,
    typer.Option(
        "--tasks",
        metavar="RECORDING",
        help="Recording with the task poses at which the error is minimised.",
    ),
]


def command(
    candidates: Annotated[
        str,
        typer.Argument(
            help="A recording, a known name, a scene (TOML) or a run of `workbench diagnose` to draw poses from."
        ),
    ],
    count: Annotated[int, typer.Option("--count", "-n", help="Number of poses to choose.")] = 40,
    criterion: Annotated[
        str,
        typer.Option(
            "--criterion",
            help="Criterion: D (D-optimal), O1 ... O5 (observability indices), or task (error at --tasks).",
        ),
    ] = "D",
    tasks: Tasks = None,
    effects: Annotated[
        bool, typer.Option("--effects", help="Also estimate transmission errors and compliance.")
    ] = False,
    without: WithoutOption = None,
    link_radius: Annotated[
        float,
        typer.Option(
            "--link-radius", min=0, help="Radius of the links for the collision test, mm."
        ),
    ] = 50.0,
    stand_off: StandOff = None,
    field: Annotated[
        float | None, typer.Option("--field", help="Half the sensor's field of view, deg.")
    ] = None,
    cap: Annotated[
        float | None,
        typer.Option("--cap", help="Largest angle between line of sight and top of a ball, deg."),
    ] = None,
    repeats: Annotated[
        int, typer.Option("--repeats", min=1, help="Largest number of measurements at one pose.")
    ] = 1,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="Seed of the random sets for comparison.")
    ] = 0,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    tolerance: answer.Tolerance = None,
    trust_data: answer.TrustData = False,
    no_report: answer.NoReport = False,
) -> None:
    """Select the most informative measurement poses of a recording or a scene: a table of poses and the gain."""
    answer.check_target(json)
    runs.check_place(out)
    with answer.progress(f"reading {candidates}") as report:
        from workbench.files.images.visibility import Sight
        from workbench.jobs.robot.poses import choose_poses, write_poses

        tolerances = _tolerances(tolerance, criterion)
        rows = _terms(candidates, without)
        found = _read(candidates, trust_data)
        tasks_read = None if tasks is None else _read(tasks, trust_data)
        report("choosing")
        sight = Sight(stand_off, field, cap)
        chosen = choose_poses(
            found,
            count,
            criterion,
            tasks_read,
            rows or effects,
            link_radius,
            seed,
            sight,
            repeats,
            trust_data,
            report,
        )
        with runs.opened("poses", candidates.removesuffix(".toml"), out) as run:
            write_poses(chosen, run.partial)
            design = chosen.as_json()
            design["recording"] = design["recording"] or candidates
            design["verdict"] = _verdict(design, tolerances).as_json()
            result = {**design, "run": run.path, "file": run.path / "poses.csv"}
            if not no_report:
                _write_page(chosen, design, run.partial)
            runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    answer.deliver(result, json)
    console = answer.console(json)
    _show(console, result)
    answer.conclude(console, result, run.path)


def _write_page(chosen, design, folder) -> None:
    from workbench.report.page import write_sheet
    from workbench.report.planning import poses as sheet

    write_sheet(sheet.page(chosen, design), folder)


def _tolerances(values, criterion: str):
    """Only the criterion task predicts an error that a tolerance can be compared with. Raises InputError."""
    if values and criterion != "task":
        raise InputError(
            f"--tolerance {values[0]}: expected --criterion task, which predicts an error in mm, found criterion "
            f"{criterion}; name --criterion task and --tasks, or omit --tolerance"
        )
    return verdict.parse_tolerances(values)


def _verdict(design, tolerances) -> verdict.Verdict:
    """Verdict on the predicted error at the tasks; no verdict if no error is predicted."""
    predicted = design["predicted"]
    if predicted is None:
        return verdict.no_verdict("No error is predicted; --criterion task --tasks predicts one.")
    error = verdict.Residual(
        predicted["chosen_mm"], "mm", "predicted RMS error at the tasks", has_noise=False
    )
    return verdict.judge(error, None, tolerances)


def _terms(name: str, excluded_terms: list[str] | None):
    """Effects of the plan of a diagnosis run, as (name, where, options) rows; () for everything else."""
    if not is_model_run(Path(name)):
        if excluded_terms:
            raise InputError(
                f"--without: expected a run of `workbench diagnose`, whose terms have names, found {name}; "
                "leave --without out."
            )
        return ()
    from workbench.fitting.calibration_plans.plan_file import without_terms
    from workbench.fitting.calibration_plans.plans import read_plan

    stages = without_terms(read_plan(Path(name)), excluded_terms or (), name)
    return tuple(row for stage in stages for row in stage.effects)


def _read(name: str, trust_data: bool):
    """A recording, or what the scene of a TOML file, or of a diagnosis run, simulates."""
    path = Path(name)
    if is_model_run(path):
        return _simulated(path / SCENE, name)
    if path.suffix == ".toml" and path.name != "recording.toml":
        return _simulated(path, name)
    import datasets

    return datasets.read(name, trust_data)


def _simulated(scene: Path, name: str):
    """What a scene simulates, with the name that the user gave: a scene itself has none."""
    from workbench.jobs.robot.simulate import simulate

    return replace(simulate(scene), name=name)


def _show(console, result) -> None:
    tables.warnings(console, result)
    rows = [
        [
            result["criterion"],
            result["poses"],
            result["candidates"],
            result["value"],
            result["random_median"],
            result["gain_over_random"],
        ]
    ]
    head = ["criterion", "chosen", "of candidates", "value", "random sets", "times better"]
    tables.grid(console, f"Poses from {result['recording']}", head, rows)
    if result["predicted"]:
        _show_predicted(console, result["poses"], result["predicted"])
    left_out = [f"{count} {why}" for why, count in result["left_out"].items() if count]
    if left_out:
        console.print(f"Excluded candidates: {', '.join(left_out)}.")
    console.print(
        "Not identifiable from these poses:"
        if result["undetermined"]
        else "All parameters are identifiable."
    )
    for sentence in result["undetermined"]:
        console.print(f"  - {sentence}", markup=False)


def _show_predicted(console, n, error) -> None:
    """Predicted error at the tasks, compared with random sets and with the lower bound of any set."""
    rows = [
        [f"these {n}", error["chosen_mm"]],
        [f"{n} at random", error["random_mm"]],
        [f"{2 * n} at random", error["random_twice_mm"]],
        ["all candidates", error["all_mm"]],
        [f"lower bound for any {n}", error["bound_mm"]],
    ]
    tables.grid(
        console, "Predicted error at the tasks, mm RMS in space", ["measured", "error"], rows
    )
    if "chosen_deg" in error:
        rows = [[f"these {n}", error["chosen_deg"]], ["all candidates", error["all_deg"]]]
        tables.grid(
            console,
            "Predicted orientation error at the tasks, deg RMS",
            ["measured", "error"],
            rows,
        )
    random_twice, bound = error["random_twice_mm"], error["bound_mm"]
    if random_twice is not None and bound > random_twice:
        console.print(
            f"No {n} of these candidates reach the error of {2 * n} random ones: they are too similar. "
            "Add candidates with other orientations and positions."
        )
    elif random_twice is not None:
        console.print(
            f"Better than {100 * error['share_of_twice_beaten']:.0f} % of the random sets of {2 * n}."
        )
