"""The file robot.toml: what it may hold, and one sentence for what is wrong with it."""

import tomllib
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    model_validator,
)

from robot_model.robot import PARALLEL, Robot, wrong
from workbench.core.errors import InputError
from workbench.core.text.key_names import closest_key

Finite = Annotated[float, Field(allow_inf_nan=False)]
Text = Annotated[str, StringConstraints(min_length=1)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Range = Annotated[list[Finite], Field(min_length=2, max_length=2)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Coupled(_Section):
    joint: int
    ratio: Finite


class _Payload(_Section):
    mass_kg: Annotated[Finite, Field(ge=0)]
    com_mm: Vector


class _Joint(_Section):
    theta_deg: Finite
    d_mm: Finite
    a_mm: Finite
    alpha_deg: Finite
    beta_deg: Finite = 0.0
    kind: Literal["revolute", "prismatic"] = "revolute"
    hayati: bool | None = None
    limits_deg: Range | None = None
    limits_mm: Range | None = None
    sign: Literal[-1, 1] = 1
    coupled: _Coupled | None = None
    gear_ratio: Finite | None = None
    mass_kg: Annotated[Finite, Field(ge=0)] | None = None
    com_mm: Vector | None = None

    @property
    def unit(self) -> float:
        """What one unit of the joint's column is in the model: rad a degree, or mm a mm."""
        return 1.0 if self.kind == "prismatic" else np.pi / 180

    @property
    def limits(self) -> list[float]:
        found = self.limits_mm if self.kind == "prismatic" else self.limits_deg
        return [np.nan, np.nan] if found is None else [limit * self.unit for limit in found]


class _File(_Section):
    name: Text
    convention: Literal["distal", "craig"]
    source: str = ""
    gravity: Vector = Field(default_factory=lambda: [0.0, 0.0, -1.0])
    joint: Annotated[list[_Joint], Field(min_length=1)]
    payload: _Payload | None = None

    @model_validator(mode="before")
    @classmethod
    def _joints_are_tables(cls, keys: Any) -> Any:
        """A single [joint] instead of [[joint]] is the commonest slip of the hand."""
        if isinstance(keys, Mapping) and isinstance(keys.get("joint"), Mapping):
            raise ValueError(
                "key joint: expected one [[joint]] a joint, found [joint]; write double brackets"
            )
        return keys


def read_toml(path) -> dict:
    """The keys of a TOML file; InputError where it is not there or is not TOML."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise wrong(path, "UTF-8 text", "other bytes", "save it as UTF-8") from None
    except OSError as problem:
        raise wrong(path, "a readable file", problem.strerror, "check the path") from None
    except tomllib.TOMLDecodeError as problem:
        raise wrong(path, "TOML", f"a mistake ({problem})", "correct it there") from None


def robot_from_keys(keys: Mapping, where: str) -> Robot:
    """The arm of robot.toml's keys; InputError with one sentence where they cannot be right."""
    try:
        file = _File.model_validate(dict(keys))
    except ValidationError as problem:
        raise InputError(_sentence(_most_helpful(problem.errors()), where)) from None
    for check in (
        _check_gravity,
        _check_angles,
        _check_lengths,
        _check_limits,
        _check_coupling,
        _check_rest,
    ):
        check(file, where)
    return _robot(file)


def _most_helpful(errors: list[dict]) -> dict:
    """The first error, unless an unknown key stands where a missing one belongs: then the unknown key."""
    missing = [error["loc"] for error in errors if error["type"] == "missing"]
    for error in errors:
        if error["type"] == "extra_forbidden":
            *section, name = error["loc"]
            if closest_key(name, [key for *place, key in missing if place == section]):
                return error
    return errors[0]


def _sentence(error: dict, where: str) -> str:
    """One sentence of a pydantic error: file, joint, key, expected, found, what to do."""
    place, names = _place(error["loc"])
    key = f"{where}: {place}" + (f"key {'.'.join(names)}" if names else "the whole table")
    if error["type"] == "value_error":
        return f"{where}: {error['ctx']['error']}."
    if error["type"] == "missing":
        return f"{key} is missing; add it."
    if error["type"] == "extra_forbidden":
        known = _known(place, names)
        near = closest_key(names[-1], known) if names else None
        question = f" (did you mean {near}?)" if near else ""
        return f"{key} is not known{question}, expected one of {', '.join(known)}; correct or remove it."
    expected = error["msg"].removeprefix("Input should be ").removeprefix("Input should ")
    return str(wrong(key, expected, repr(error["input"]), "correct it"))


def _place(path: tuple) -> tuple[str, list[str]]:
    """("joint 2, ", ["coupled", "ratio"]) of ("joint", 1, "coupled", "ratio")."""
    if len(path) > 1 and path[0] == "joint":
        return f"joint {path[1] + 1}, ", [part for part in path[2:] if isinstance(part, str)]
    return "", [part for part in path if isinstance(part, str)]


def _known(place: str, names: list[str]) -> list[str]:
    sections = {"coupled": _Coupled, "payload": _Payload}
    section = sections[names[0]] if len(names) > 1 else _Joint if place else _File
    return list(section.model_fields)


def _check_gravity(file: _File, where: str) -> None:
    if np.linalg.norm(file.gravity) < 1e-9:
        raise wrong(
            f"{where}: key gravity", "a direction", file.gravity, "write [0, 0, -1] if upright"
        )


def _check_angles(file: _File, where: str) -> None:
    """Radians, told by numbers that degrees would not take."""
    quarters = np.pi / 2 * np.arange(1, 5)
    for k, joint in enumerate(file.joint, 1):
        for key in ("theta_deg", "alpha_deg"):
            angle = getattr(joint, key)
            if np.abs(np.abs(angle) - quarters).min() < 2e-3:
                found = f"{angle}, which looks like radians"
                raise wrong(
                    f"{where}: joint {k}, key {key}",
                    "degrees",
                    found,
                    f"write {np.rad2deg(angle):.6g}",
                )
    widest = max(
        (abs(limit) for joint in file.joint for limit in joint.limits_deg or []), default=0
    )
    if 0 < widest < 2 * np.pi + 0.01:
        found = f"none beyond {widest:.4g}, which looks like radians"
        raise wrong(f"{where}: keys limits_deg", "degrees", found, "multiply them by 57.29578")


def _check_lengths(file: _File, where: str) -> None:
    length = sum(abs(joint.a_mm) + abs(joint.d_mm) for joint in file.joint)
    if 0 < length < 10:
        found = f"lengths that add up to {length:.4g}, which looks like metres"
        raise wrong(f"{where}: keys a_mm and d_mm", "millimetres", found, "multiply them by 1000")


def _check_limits(file: _File, where: str) -> None:
    for k, joint in enumerate(file.joint, 1):
        own, other = ("limits_mm", "limits_deg")[:: 1 if joint.kind == "prismatic" else -1]
        if getattr(joint, other) is not None:
            raise wrong(
                f"{where}: joint {k}", f"{own} for a {joint.kind} joint", other, "rename it"
            )
        limits = getattr(joint, own)
        if limits is not None and limits[0] >= limits[1]:
            raise wrong(
                f"{where}: joint {k}, key {own}", "the lower limit first", limits, "swap them"
            )


def _check_coupling(file: _File, where: str) -> None:
    for k, joint in enumerate(file.joint, 1):
        other = joint.coupled.joint if joint.coupled is not None else None
        if other is not None and (other == k or not 1 <= other <= len(file.joint)):
            expected = f"the number of another joint, 1 to {len(file.joint)}"
            raise wrong(f"{where}: joint {k}, key coupled.joint", expected, other, "correct it")


def _check_rest(file: _File, where: str) -> None:
    for k, joint in enumerate(file.joint, 1):
        if joint.gear_ratio == 0:
            raise wrong(
                f"{where}: joint {k}, key gear_ratio",
                "another number",
                0,
                "correct it or leave it out",
            )
        if joint.mass_kg and joint.com_mm is None:
            raise wrong(
                f"{where}: joint {k}",
                "com_mm beside mass_kg",
                "mass_kg alone",
                "add the centre of mass",
            )


def _robot(file: _File) -> Robot:
    joints = file.joint
    angles = np.deg2rad([[j.theta_deg, j.alpha_deg, j.beta_deg] for j in joints])
    geometry = np.column_stack(
        [angles[:, 0], [j.d_mm for j in joints], [j.a_mm for j in joints], angles[:, 1:]]
    )
    payload = file.payload or _Payload(mass_kg=0.0, com_mm=[0.0, 0.0, 0.0])
    return Robot(
        name=file.name,
        source=file.source,
        convention=file.convention,
        geometry=geometry,
        hayati=_hayati(file, geometry[:, 3]),
        prismatic=np.array([j.kind == "prismatic" for j in joints]),
        mixing=_mixing(joints),
        limits=np.array([j.limits for j in joints]),
        gear_ratio=np.array([np.nan if j.gear_ratio is None else j.gear_ratio for j in joints]),
        gravity=np.array(file.gravity) / np.linalg.norm(file.gravity),
        mass=np.array([j.mass_kg or 0.0 for j in joints]),
        com=np.array([j.com_mm or [0.0, 0.0, 0.0] for j in joints]),
        payload_mass=payload.mass_kg,
        payload_com=np.array(payload.com_mm),
        base=np.eye(4),
        flange=np.eye(4),
    )


def _hayati(file: _File, alpha: np.ndarray) -> np.ndarray:
    """As the file says; where it does not say, from the twist to the next axis."""
    parallel = np.abs(np.sin(alpha)) < PARALLEL
    # the last joint (Craig: the first) has no neighbour on that side
    parallel[-1 if file.convention == "distal" else 0] = False
    said = [j.hayati for j in file.joint]
    return np.array([bool(guess if word is None else word) for word, guess in zip(said, parallel)])


def _mixing(joints: list[_Joint]) -> np.ndarray:
    """(J, J) model variables from readings; a coupling's ratio is in the units of the files."""
    mixing = np.diag([float(j.sign) for j in joints])
    for k, joint in enumerate(joints):
        if joint.coupled is not None:
            other = joint.coupled.joint - 1
            mixing[k, other] += joint.coupled.ratio * joint.unit / joints[other].unit
    return mixing
