"""Scene files: what to simulate, read from TOML and checked key by key."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from workbench.core.errors import InputError
from workbench.core.text.sections import Ball, SceneTable, rising
from workbench.core.text.structured_text import ContentError, read_toml

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Mass = Annotated[float, Field(ge=0)]


class Pose(SceneTable):
    """A transform: translation in mm, then roll, pitch, yaw about fixed x, y, z in degrees."""

    xyz_mm: Vector = [0.0, 0.0, 0.0]
    rpy_deg: Vector = [0.0, 0.0, 0.0]


class Errors(SceneTable):
    """1 sigma of random errors of the true geometry about the nominal one."""

    length_mm: float = Field(0.0, ge=0)
    angle_deg: float = Field(0.0, ge=0)


class Cause(BaseModel):
    """An effect, its place, its options (any further key) and the values of its parameters.

    `values`: by the last part of a parameter's key, or by the whole key where several end alike.
    """

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)
    effect: str
    where: str
    values: dict[str, float]


class Scene(SceneTable):
    """One file; lengths mm, angles deg.

    `robot`: a built-in name, or a .toml or .urdf file, relative to the scene. Poses are random within
    `share_of_limits` of the joints' limits; in a ball-centre scene they look at `balls`, `stand_off_mm` away
    along the sensor's z axis, up to `field_deg` off it (15 mm each way where not said) and `cap_deg` off
    the vertical. `geometry`: true values of the arm's own parameters by key ("joint-2.a2"; mm, rad), such as a
    calibration found; the others are nominal with `errors`. Optional
    covariates: `payload_kg` [low, high] and `approach` at random; `speeds_deg_s`, each joint's speed at
    random up to it (mm/s of a slide); `temperature_c` [first, last], a smooth ramp over the recording.
    """

    robot: str
    measures: Literal["external-point", "external-pose", "ball-centre"] = "external-point"
    title: str = "simulated"
    samples: int = Field(200, ge=4, le=10_000_000)
    seed: int = Field(0, ge=0)
    sigma_mm: float = Field(0.02, gt=0)
    base: Pose = Pose()
    tool: Pose = Pose()
    reflectors: Annotated[list[Vector], Field(min_length=1)] = [[0.0, 0.0, 100.0]]
    balls: list[Ball] = []
    errors: Errors = Errors()
    geometry: dict[str, float] = {}
    stand_off_mm: Annotated[tuple[float, float], AfterValidator(rising)] = (115.0, 135.0)
    field_deg: float | None = Field(None, gt=0, lt=80)
    cap_deg: float = Field(50.0, gt=0, le=90)
    share_of_limits: float = Field(0.7, gt=0, le=1)
    payload_kg: Annotated[tuple[Mass, Mass], AfterValidator(rising)] | None = None
    approach: bool = False
    speeds_deg_s: float | None = Field(None, gt=0)
    temperature_c: tuple[float, float] | None = None
    seconds_per_sample: float = Field(10.0, gt=0)
    effect: list[Cause] = []


def unreadable(path: Path, problem: Exception) -> InputError:
    """The error for a scene file that is missing or not TOML."""
    if isinstance(problem, FileNotFoundError):
        return InputError(f"{path}: expected a scene (TOML), found no such file; correct its name.")
    return InputError(
        f"{path}: expected a scene (TOML), found what cannot be read ({problem}); correct it."
    )


def read_scene(path: Path) -> Scene:
    """The scene of a TOML file; InputError with the file, the key and what was expected."""
    try:
        keys = read_toml(path)
    except (OSError, ContentError) as problem:
        raise unreadable(path, problem) from None
    try:
        return Scene(**keys)
    except ValidationError as problem:
        first = problem.errors()[0]
        key = ".".join(str(part + 1 if isinstance(part, int) else part) for part in first["loc"])
        message = first["msg"].removeprefix("Value error, ")
        message = message[0].lower() + message[1:]
        raise InputError(
            f"scene {path}, key {key}: {message}, found {first['input']!r}; correct or remove it"
        ) from None
