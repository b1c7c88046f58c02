"""Options of commands that read a table of targets: --map and --payload-kg."""

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

PayloadKg = Annotated[
    float | None,
    typer.Option(
        "--payload-kg",
        metavar="KG",
        min=0.0,
        help="Load of all targets, beyond the empty tool; for targets without a column payload_kg, as a robot program.",
    ),
]
