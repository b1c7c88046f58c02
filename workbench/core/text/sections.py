"""Sections of TOML files as pydantic models: no unknown key, no conversion of types, one sentence for a mistake."""

from collections.abc import Mapping
from typing import Annotated, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from workbench.core.errors import InputError, complaint
from workbench.core.rigid import placement

Finite = Annotated[float, Field(allow_inf_nan=False, gt=-1e12, lt=1e12)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]


def rising(pair: tuple[float, float]) -> tuple[float, float]:
    """A range whose lower end comes first. Raises ValueError otherwise."""
    if pair[0] > pair[1]:
        raise ValueError("expected the lower one first")
    return pair


def _ball(ball: list[float]) -> list[float]:
    if not ball[3] > 0.1:
        raise ValueError("expected [x, y, z, radius] in mm with a radius above 0.1")
    return ball


Ball = Annotated[list[float], Field(min_length=4, max_length=4), AfterValidator(_ball)]


class SceneTable(BaseModel):
    """A table of a scene or a study, which people write by hand: whole numbers are also read as real ones."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Section(BaseModel):
    """A table of a file."""

    model_config = ConfigDict(extra="forbid", strict=True)


class Placement(Section):
    """A fixed transform: translation in mm; roll, pitch and yaw about fixed x, y and z in degrees."""

    xyz_mm: Vector = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    rpy_deg: Vector = Field(default_factory=lambda: [0.0, 0.0, 0.0])

    @property
    def matrix(self) -> np.ndarray:
        """(4, 4), mm."""
        return placement(self.xyz_mm, self.rpy_deg)


Kind = TypeVar("Kind", bound=Section)


def checked_section(kind: type[Kind], keys: object, where: str) -> Kind:
    """The section of these keys. Raises InputError that begins with `where` for keys or values that cannot be right,
    and where there are no keys."""
    names = " and ".join(kind.model_fields)
    if not isinstance(keys, Mapping) or not keys or set(keys) - set(kind.model_fields):
        raise complaint(where, f"the keys {names}", repr(keys)[:60], "correct it")
    try:
        return kind.model_validate(dict(keys))
    except ValidationError as problem:
        raise _sentence(problem.errors()[0], where) from None


def _sentence(error, where: str) -> InputError:
    """The first mistake that pydantic found, in one sentence."""
    key = f"{where}, key {error['loc'][0]}"
    return complaint(key, _expected(error), repr(error["input"])[:60], "correct it")


def _expected(error) -> str:
    """The value that pydantic expected, in words."""
    limits = error.get("ctx", {})
    size = limits.get("min_length") or limits.get("max_length")
    if size:
        return f"a list of {size} numbers"
    return error["msg"].removeprefix("Input should be ").removeprefix("Input should ")
