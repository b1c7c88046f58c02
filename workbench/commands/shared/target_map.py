"""The option --map of commands that read a table of targets."""

from pathlib import Path
from typing import Annotated

import typer

TargetMap = Annotated[
    Path | None,
    typer.Option(
        "--map",
        metavar="FILE",
        help="Columns, units and conventions of a table of targets with other headers: a mapping as of `workbench "
        "import`.",
    ),
]
