"""`workbench render`: a scene in; a recording with rendered images out, which every command reads."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer
from workbench.files import runs
from workbench.fitting.verdicts.verdict import no_verdict

Scene = Annotated[Path, typer.Argument(help="Scene file (TOML).")]
Truth = Annotated[
    Path | None,
    typer.Option(
        "--truth",
        metavar="FILE",
        help="Write what the images were made from (JSON), for scoring.",
    ),
]


def command(
    scene: Scene,
    out: answer.OutFolder = None,
    truth: Truth = None,
    json: answer.JsonTarget = None,
) -> None:
    """Render the images that an instrument with known faults would have taken; the folder comes last."""
    answer.check_target(json)
    answer.check_target(None if truth is None else str(truth), "--truth")
    with answer.progress(f"reading {scene}") as say:
        from workbench.jobs.render import render

        with runs.opened("render", scene.stem, out) as run:
            made = render(scene, run.partial, say)
            if truth is not None:
                runs.replace_file(truth, answer.as_text(made["truth"]))
    found = {key: value for key, value in made.items() if key != "truth"}
    found["verdict"] = no_verdict(
        "A rendering measures nothing, so there is no residual to judge."
    ).as_json()
    answer.deliver(
        {"command": "render", "scene": scene, "recording": run.path, **found, "run": run.path}, json
    )
    console = answer.console(json)
    console.print(f"{found['images']} images, {found['samples']} samples", markup=False)
    console.print(str(run.path), soft_wrap=True, markup=False)
