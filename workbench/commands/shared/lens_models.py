"""The option `--model` of the commands that calibrate a camera."""

from enum import StrEnum
from typing import Annotated

import typer


class Lens(StrEnum):
    """Distortion model."""

    AUTO = "auto"
    BROWN = "brown"
    RATIONAL = "rational"
    FISHEYE = "fisheye"


Model = Annotated[
    Lens,
    typer.Option(
        "--model",
        help="Distortion model: brown (k1 k2 p1 p2 k3), rational (also k4 k5 k6), fisheye (k1 to k4 of the angle), or "
        "auto: the one with the smallest error on held-out board poses.",
    ),
]
