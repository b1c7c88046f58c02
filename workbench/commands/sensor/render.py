"""`workbench render`: a scene in; a recording with rendered images out."""

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
        help="Write the ground truth of the rendering (JSON).",
    ),
]


def command(
    scene: Scene,
    out: answer.OutFolder = None,
    truth: Truth = None,
    json: answer.JsonTarget = None,
) -> None:
    """Render a scene file to images: a recording of a camera or scanner with known errors."""
    answer.check_target(json)
    answer.check_target(None if truth is None else str(truth), "--truth")
    with answer.progress(f"reading {scene}") as progress:
        from workbench.jobs.sensor.render import render

        with runs.opened("render", scene.stem, out) as run:
            rendered = render(scene, run.partial, progress)
            if truth is not None:
                runs.replace_file(truth, answer.as_text(rendered["truth"]))
    found = {key: value for key, value in rendered.items() if key != "truth"}
    found["verdict"] = no_verdict(
        "A rendering has no reference, so there is no residual to judge."
    ).as_json()
    answer.deliver(
        {"command": "render", "scene": scene, "recording": run.path, **found, "run": run.path}, json
    )
    console = answer.console(json)
    console.print(f"{found['images']} images, {found['samples']} samples", markup=False)
    console.print(str(run.path), soft_wrap=True, markup=False)
