"""`workbench poses`: which poses to measure."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer, tables
from workbench.core.errors import InputError
from workbench.files import runs
from workbench.fitting.verdicts import verdict

StandOff = Annotated[
    tuple[float, float] | None,
    typer.Option("--stand-off", metavar="NEAR FAR", help="Distance of a ball from the sensor, mm."),
]
Tasks = Annotated[
    str | None,
    typer.Option("--tasks", metavar="RECORDING", help="Poses whose error shall be small."),
]


def command(
    candidates: Annotated[
        str, typer.Argument(help="A recording, a known name, or a scene (TOML) to draw poses from.")
    ],
    count: Annotated[int, typer.Option("--count", "-n", help="How many poses to choose.")] = 40,
    criterion: Annotated[str, typer.Option("--criterion", help="D, O1 ... O5, or task.")] = "D",
    tasks: Tasks = None,
    effects: Annotated[
        bool, typer.Option("--effects", help="Determine transmission and compliance too.")
    ] = False,
    link_radius: Annotated[
        float, typer.Option("--link-radius", min=0, help="Half the links' thickness, mm.")
    ] = 50.0,
    stand_off: StandOff = None,
    field: Annotated[
        float | None, typer.Option("--field", help="Half the sensor's field of view, deg.")
    ] = None,
    cap: Annotated[
        float | None, typer.Option("--cap", help="How far off its top a ball is seen from, deg.")
    ] = None,
    repeats: Annotated[
        int, typer.Option("--repeats", min=1, help="How often one pose may be measured.")
    ] = 1,
    seed: Annotated[
        int, typer.Option("--seed", help="Of the random sets that it is compared with.")
    ] = 0,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    tolerance: answer.Tolerance = None,
    trust_data: answer.TrustData = False,
) -> None:
    """Choose the poses from which most is learnt, and say what even they leave open."""
    answer.check_target(json)
    with answer.progress(f"reading {candidates}") as say:
        from workbench.imaging.visibility import Sight
        from workbench.jobs.poses import choose_poses, write_poses

        tolerances = _tolerances(tolerance, criterion)
        found = _read(candidates, trust_data)
        wanted = None if tasks is None else _read(tasks, trust_data)
        say("choosing")
        sight = Sight(stand_off, field, cap)
        chosen = choose_poses(
            found, count, criterion, wanted, effects, link_radius, seed, sight, repeats, trust_data
        )
        with runs.opened("poses", candidates.removesuffix(".toml"), out) as run:
            write_poses(chosen, run.partial)
            told = chosen.as_json()
            told["recording"] = told["recording"] or candidates
            told["verdict"] = _verdict(told, tolerances).as_json()
            result = {**told, "run": run.path, "file": run.path / "poses.csv"}
            runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    answer.deliver(result, json)
    console = answer.console(json)
    _show(console, result)
    answer.conclude(console, result, run.path)


def _tolerances(values, criterion: str):
    """Only the criterion task predicts an error that a tolerance can be compared with. Raises InputError."""
    if values and criterion != "task":
        raise InputError(
            f"--tolerance {values[0]}: expected --criterion task, which predicts an error in mm, found criterion "
            f"{criterion}; name --criterion task and --tasks, or leave --tolerance out"
        )
    return verdict.parse_tolerances(values)


def _verdict(told, tolerances) -> verdict.Verdict:
    """The predicted error at the tasks against the tolerance; none where no error is predicted."""
    predicted = told["predicted"]
    if predicted is None:
        return verdict.no_verdict("Nothing is measured yet, so that there is no residual to judge.")
    error = verdict.Residual(
        predicted["chosen_mm"], "mm", "predicted RMS error at the tasks", has_noise=False
    )
    return verdict.judge(error, None, tolerances)


def _read(name: str, trust_data: bool):
    """A recording, or what the scene of a TOML file simulates."""
    if Path(name).suffix == ".toml" and Path(name).name != "recording.toml":
        from workbench.jobs.simulate import simulate

        return simulate(Path(name))
    import datasets

    return datasets.read(name, trust_data)


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
    left = [f"{count} {why}" for why, count in result["left_out"].items() if count]
    if left:
        console.print(f"No candidates: {', '.join(left)}.")
    console.print(
        "Not determined even then:" if result["undetermined"] else "Everything is determined."
    )
    for sentence in result["undetermined"]:
        console.print(f"  - {sentence}", markup=False)


def _show_predicted(console, n, error) -> None:
    """What error to expect at the tasks, beside random sets, and whether any other set could do better."""
    rows = [
        [f"these {n}", error["chosen_mm"]],
        [f"{n} at random", error["random_mm"]],
        [f"{2 * n} at random", error["random_twice_mm"]],
        ["all candidates", error["all_mm"]],
        [f"least that any {n} could", error["bound_mm"]],
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
    twice, bound = error["random_twice_mm"], error["bound_mm"]
    if twice is not None and bound > twice:
        console.print(
            f"No {n} of these candidates can do what {2 * n} at random do: they are too much alike. "
            "Bring more of them, in other attitudes and places."
        )
    elif twice is not None:
        console.print(
            f"Better than {100 * error['share_of_twice_beaten']:.0f} % of the random sets of {2 * n}."
        )
