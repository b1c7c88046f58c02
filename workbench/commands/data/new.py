"""`workbench new`: a commented recording with example rows, to fill in with one's own data."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer

Kind = Annotated[
    str,
    typer.Argument(
        help="What is measured: external-point, external-pose, ball-centre, board-images, ...; or a scanner: "
        "fixed-plane, galvanometer, turntable, profiler, 3d-camera."
    ),
]
Robot = Annotated[
    str | None,
    typer.Option(
        "--robot",
        metavar="NAME|FILE",
        help="Built-in robot, robot.toml, URDF or MJCF; FILE#LINK where a file holds several arms.",
    ),
]


def command(
    kind: Kind,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New folder.")],
    robot: Robot = None,
    json: answer.JsonTarget = None,
) -> None:
    """Write a template of a recording: files with a comment on every key, and simulated rows to replace with yours."""
    answer.check_target(json)
    with answer.progress(f"writing {folder}") as progress:
        from workbench.recordings.templates import write_template

        template = write_template(kind, folder, robot, progress)
    result = {
        "command": "new",
        "measures": template.measures,
        "samples": template.samples,
        "images": template.images,
        "files": list(template.files),
        "folder": template.folder,
    }
    answer.deliver(result, json)
    console = answer.console(json)
    images = f", {template.images} images" if template.images else ""
    console.print(
        f"{template.measures}: {template.samples} example rows{images}; see recording.toml",
        markup=False,
    )
    console.print(str(template.folder), markup=False, soft_wrap=True)
