"""`workbench demo`: the main job on a recording that is at hand, with nothing to prepare."""

from typing import Annotated

import typer

from workbench.commands import answer, calibrate
from workbench.core.errors import InputError

REAL = "irb120_faro"
BUNDLED = "elastic-arm"


def command(
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    bundled: Annotated[
        bool, typer.Option("--bundled", help="Use the small recording that is always there.")
    ] = False,
) -> None:
    """Calibrate a real recording where one is found, else the bundled one; it says which."""
    answer.check_target(json)
    name, recording, why = choose(bundled)
    console = answer.console(json)
    console.print(f"{why}\n", markup=False)
    with answer.progress(f"calibrating {name}") as say:
        result, run = calibrate.solve(recording, name, {}, say, out, report=True)
    calibrate.deliver({**result, "command": "demo"}, run, json)


def choose(bundled: bool) -> tuple:
    """Which recording to show: its name, the recording and the sentence that says why.

    bundled: leave real recordings aside even where there are any.
    """
    import datasets

    if bundled:
        return BUNDLED, datasets.read(BUNDLED), f"Recording: {BUNDLED}, bundled, as asked."
    try:
        recording = datasets.read(REAL)
    except InputError as missing:
        return BUNDLED, datasets.read(BUNDLED), (
            f"Recording: {BUNDLED}, bundled, because the real one is not here: {missing}")
    return REAL, recording, f"Recording: {REAL}, measured on a real robot."
