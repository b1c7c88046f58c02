"""`workbench simulate`: a scene in, a recording on disk out."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot.calibrate import WithoutOption
from workbench.commands.shared import answer
from workbench.commands.shared.model_run import scene_of
from workbench.files import runs
from workbench.fitting.verdicts.verdict import no_verdict

_NO_RESIDUAL = "A simulation has no reference, so there is no residual to judge."


def command(
    scene: Annotated[
        Path, typer.Argument(help="Scene file (TOML), or run folder of `workbench diagnose`.")
    ],
    without: WithoutOption = None,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
) -> None:
    """Simulate the measurements of an arm that a scene file describes, and write them as a recording."""
    answer.check_target(json)
    runs.check_place(out)
    with answer.progress(f"simulating {scene}") as report:
        import datasets
        from workbench.jobs.robot.simulate import simulate

        recording = simulate(scene_of(scene), without or ())
        with runs.opened("simulate", scene.stem, out) as run:
            report("writing the recording")
            datasets.write(recording, run.partial)
    deliver(scene, recording, run, json)


def deliver(scene: Path, recording, run: runs.Run, json: str | None) -> None:
    """Print content and folder of the simulated recording; the folder comes last."""
    answer.deliver(_as_json(scene, recording, run.path), json)
    console = answer.console(json)
    console.print(f"{recording.n} samples, {recording.measures}", markup=False)
    console.print(str(run.path), soft_wrap=True, markup=False)


def _as_json(scene: Path, recording, folder: Path) -> dict:
    return {
        "command": "simulate",
        "scene": scene,
        "recording": folder,
        "measures": recording.measures,
        "samples": recording.n,
        "sigma_mm": recording.sigma_mm,
        "verdict": no_verdict(_NO_RESIDUAL).as_json(),
        "run": folder,
    }
