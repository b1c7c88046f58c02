"""The schema of robot.toml: what the file may hold, and one sentence for what is wrong with it."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, StringConstraints, ValidationError, model_validator

from workbench.core.errors import InputError, complaint
from workbench.core.text.key_names import closest_key
from workbench.core.text.sections import Finite, Placement, Section, Vector

Text = Annotated[str, StringConstraints(min_length=1)]
CONVENTIONS = {"distal": "standard", "craig": "modified"}
"""Denavit-Hartenberg conventions: names in the code, which robot files may also have, and the usual ones."""
_NAMES = {usual: name for name, usual in CONVENTIONS.items()}
Range = Annotated[list[Finite], Field(min_length=2, max_length=2)]


class Coupled(Section):
    """`coupled`: the joint variable gets `ratio` times the reading of `joint` in addition.

    `mechanical`: whether the drive of `joint` moves this joint, by a linkage or through gears, so that its errors and
    its compliance act on both; otherwise only the controller counts so. Left out: the recording decides.
    """

    joint: int
    ratio: Finite
    mechanical: bool | None = None


class Payload(Section):
    """`[payload]`: mass and centre of the tool, in the flange frame."""

    mass_kg: Annotated[Finite, Field(ge=0)]
    com_mm: Vector


class Joint(Section):
    """`[[joint]]`: one row of the kinematic table, with limits, transmission and mass."""

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
    coupled: Coupled | None = None
    gear_ratio: Finite | None = None
    pitch_mm: Annotated[Finite, Field(gt=0)] | None = None
    mass_kg: Annotated[Finite, Field(ge=0)] | None = None
    com_mm: Vector | None = None

    @property
    def unit(self) -> float:
        """Return one unit of the joint's column in units of the model: rad per degree, or mm per mm."""
        return 1.0 if self.kind == "prismatic" else np.pi / 180

    @property
    def revolutions(self) -> float:
        """Return revolutions of the motor per revolution of the joint, or of the screw per mm; nan if not stated."""
        if self.kind == "prismatic":
            if self.pitch_mm is None:
                return np.nan
            return 1 / self.pitch_mm
        return np.nan if self.gear_ratio is None else self.gear_ratio

    @property
    def limits(self) -> list[float]:
        """[low, high] rad or mm, nan where the file states none."""
        found = self.limits_mm if self.kind == "prismatic" else self.limits_deg
        if found is None:
            return [np.nan, np.nan]
        return [limit * self.unit for limit in found]


class RobotFile(Section):
    """The whole file."""

    name: Text
    convention: Annotated[
        Literal["standard", "modified", "distal", "craig"],
        AfterValidator(lambda stated: _NAMES.get(stated, stated)),
    ]
    source: str = ""
    gravity: Vector = Field(default_factory=lambda: [0.0, 0.0, -1.0])
    joint: Annotated[list[Joint], Field(min_length=1)]
    payload: Payload | None = None
    base: Placement | None = None
    flange: Placement | None = None

    @model_validator(mode="before")
    @classmethod
    def _joints_are_tables(cls, keys: Any) -> Any:
        """A single [joint] instead of [[joint]] is the commonest slip of the hand."""
        if isinstance(keys, Mapping) and isinstance(keys.get("joint"), Mapping):
            raise ValueError(
                "key joint: expected one [[joint]] a joint, found [joint]; write double brackets"
            )
        return keys


def checked_robot_file(keys: Mapping, where: str) -> RobotFile:
    """The file of these keys; InputError with one sentence, that begins with `where`, if they cannot be right."""
    try:
        file = RobotFile.model_validate(dict(keys))
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
    return file


def _most_helpful(errors: list[dict]) -> dict:
    """The first error, unless an unknown key stands where a missing one belongs: then the unknown key."""
    missing = [error["loc"] for error in errors if error["type"] == "missing"]
    for error in errors:
        if error["type"] == "extra_forbidden":
            *section, name = error["loc"]
            known = [key for *place, key in missing if place == section]
            if closest_key(name, known):
                return error
    return errors[0]


def _sentence(error: dict, where: str) -> str:
    """One sentence of a pydantic error: file, joint, key, expected, found, what to do."""
    place, names = _place(error["loc"])
    key = f"{where}: {place}" + (f"key {'.'.join(names)}" if names else "the whole table")
    if error["type"] == "value_error":
        return f"{where}: {error['ctx']['error']}."
    if error["type"] == "missing":
        return f"{key} is missing: expected a value, found no such key; add {names[-1]}."
    if error["type"] == "extra_forbidden":
        known = _known(place, names)
        closest = closest_key(names[-1], known) if names else None
        question = f" (did you mean {closest}?)" if closest else ""
        do = f"rename it to {closest} and mind the unit" if closest else "remove it"
        text = f"expected one of {', '.join(known)}, found {names[-1]}"
        return f"{key} is not known{question}: {text}; {do}."
    expected = error["msg"].removeprefix("Input should be ").removeprefix("Input should ")
    return str(complaint(key, expected, repr(error["input"]), "correct it"))


def _place(path: tuple) -> tuple[str, list[str]]:
    """("joint 2, ", ["coupled", "ratio"]) of ("joint", 1, "coupled", "ratio")."""
    if len(path) > 1 and path[0] == "joint":
        names = [part for part in path[2:] if isinstance(part, str)]
        return f"joint {path[1] + 1}, ", names
    names = [part for part in path if isinstance(part, str)]
    return "", names


def _known(place: str, names: list[str]) -> list[str]:
    sections = {"coupled": Coupled, "payload": Payload, "base": Placement, "flange": Placement}
    if len(names) > 1:
        section = sections[names[0]]
    else:
        section = Joint if place else RobotFile
    return list(section.model_fields)


def _check_gravity(file: RobotFile, where: str) -> None:
    if np.linalg.norm(file.gravity) < 1e-9:
        raise complaint(
            f"{where}: key gravity", "a direction", file.gravity, "write [0, 0, -1] if upright"
        )


def _check_angles(file: RobotFile, where: str) -> None:
    """Raise InputError for angles that are plausible only in radians."""
    quarters = np.pi / 2 * np.arange(1, 5)
    for k, joint in enumerate(file.joint, 1):
        for key in ("theta_deg", "alpha_deg"):
            angle = getattr(joint, key)
            if np.abs(np.abs(angle) - quarters).min() < 2e-3:
                found = f"{angle}, which looks like radians"
                raise complaint(
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
        raise complaint(f"{where}: keys limits_deg", "degrees", found, "multiply them by 57.29578")


def _check_lengths(file: RobotFile, where: str) -> None:
    length = sum(abs(joint.a_mm) + abs(joint.d_mm) for joint in file.joint)
    if 0 < length < 10:
        found = f"lengths that add up to {length:.4g}, which looks like metres"
        raise complaint(
            f"{where}: keys a_mm and d_mm", "millimetres", found, "multiply them by 1000"
        )


def _check_limits(file: RobotFile, where: str) -> None:
    for k, joint in enumerate(file.joint, 1):
        limit, other = ("limits_mm", "limits_deg")[:: 1 if joint.kind == "prismatic" else -1]
        if getattr(joint, other) is not None:
            raise complaint(
                f"{where}: joint {k}", f"{limit} for a {joint.kind} joint", other, "rename it"
            )
        limits = getattr(joint, limit)
        if limits is not None and limits[0] == limits[1]:
            raise complaint(
                f"{where}: joint {k}, key {limit}",
                "a lower and a higher limit",
                limits,
                f"remove the key {limit}: a joint without it may stand still, and moves as far as its readings do",
            )
        if limits is not None and limits[0] > limits[1]:
            raise complaint(
                f"{where}: joint {k}, key {limit}", "the lower limit first", limits, "swap them"
            )


def _check_coupling(file: RobotFile, where: str) -> None:
    for k, joint in enumerate(file.joint, 1):
        if joint.coupled is not None:
            _check_coupled_joint(k, joint.coupled.joint, len(file.joint), where)


def _check_coupled_joint(k: int, other: int, count: int, where: str) -> None:
    """Raise InputError where joint k of `count` is coupled to itself or to none of them."""
    if other == k or not 1 <= other <= count:
        raise complaint(
            f"{where}: joint {k}, key coupled.joint",
            f"the number of another joint, 1 to {count}",
            other,
            "name the joint whose motion is added",
        )


def _check_rest(file: RobotFile, where: str) -> None:
    for k, joint in enumerate(file.joint, 1):
        if joint.gear_ratio == 0:
            raise complaint(
                f"{where}: joint {k}, key gear_ratio",
                "another number",
                0,
                "correct it or leave it out",
            )
        if joint.pitch_mm is not None and joint.kind != "prismatic":
            raise complaint(
                f"{where}: joint {k}, key pitch_mm",
                'kind = "prismatic"',
                f'kind = "{joint.kind}"',
                "correct the kind or leave the pitch out",
            )
        if joint.mass_kg and joint.com_mm is None:
            raise complaint(
                f"{where}: joint {k}",
                "com_mm with mass_kg",
                "mass_kg alone",
                "add the centre of mass",
            )
