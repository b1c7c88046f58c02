"""Scene files: what to simulate, read from TOML and checked key by key."""

import tomllib
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from workbench.core.errors import InputError

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Pose(_Table):
    """A transform: translation in mm, then roll, pitch, yaw about fixed x, y, z in degrees."""

    xyz_mm: Vector = [0.0, 0.0, 0.0]
    rpy_deg: Vector = [0.0, 0.0, 0.0]


class Errors(_Table):
    """1 sigma of random errors of the true geometry about the nominal one."""

    length_mm: float = Field(0.0, ge=0)
    angle_deg: float = Field(0.0, ge=0)


class Cause(BaseModel):
    """An effect, its place, its options (any further key) and the values of its parameters."""

    model_config = ConfigDict(extra="allow")
    effect: str
    where: str
    values: dict[str, float]


class Scene(_Table):
    """One file; lengths mm, angles deg. `joints` is a CSV with q1_deg ... to use instead of random poses."""

    robot: str
    measures: str = "external-point"
    title: str = "simulated"
    samples: int = Field(200, ge=4, le=10_000_000)
    seed: int = 0
    sigma_mm: float = Field(0.02, gt=0)
    base: Pose = Pose()
    tool: Pose = Pose()
    reflectors: list[Vector] = [[0.0, 0.0, 100.0]]
    balls: list[Annotated[list[float], Field(min_length=4, max_length=4)]] = []
    errors: Errors = Errors()
    share_of_limits: float = Field(0.7, gt=0, le=1)
    payload_kg: tuple[float, float] | None = None
    approach: bool = False
    seconds_per_sample: float = Field(10.0, gt=0)
    effect: list[Cause] = []


def read_scene(path: Path) -> Scene:
    """The scene of a TOML file; InputError with the file, the key and what was expected."""
    try:
        keys = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as problem:
        raise InputError(f"scene {path} cannot be read ({problem}); write it as TOML") from None
    try:
        return Scene(**keys)
    except ValidationError as problem:
        first = problem.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise InputError(
            f"scene {path}, key {key}: {first['msg'].lower()}, found {first['input']!r}; correct or remove it"
        ) from None
