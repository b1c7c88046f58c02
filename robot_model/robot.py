"""What the model knows of an arm before anything is measured, and where it is loaded from."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from os import PathLike
from pathlib import Path

import numpy as np

from workbench.core.errors import InputError

PARALLEL = np.sin(np.deg2rad(1))
"""sin of the angle below which two axes are parallel: their common normal is then ill-defined."""


@dataclass(frozen=True, eq=False)
class Robot:
    """Nominal kinematics and statics of a serial arm with J joints and R joint readings.

    R = J but for a URDF with mimic joints, which are chain joints without a reading of their own.
    """

    name: str
    source: str
    convention: str
    """"distal": Rz(q+theta) Tz(d) Tx(a) Rx(alpha) Ry(beta), Hayati & Mirmirani 1985;
    "craig": alpha, beta and a stand before the joint (Craig, Introduction to Robotics, eq. 3.6)."""
    geometry: np.ndarray
    """(J, 5) theta, d, a, alpha, beta of every joint, rad and mm."""
    hayati: np.ndarray
    """(J,) bool: the next axis is parallel, so that beta is identified and d is not."""
    prismatic: np.ndarray
    """(J,) bool: the joint variable adds to d (mm) instead of theta."""
    mixing: np.ndarray
    """(J, R) joint variables = mixing @ readings: signs and coupled joints, rad and mm."""
    limits: np.ndarray
    """(R, 2) lowest and highest reading, rad or mm, nan where unknown."""
    gear_ratio: np.ndarray
    """(J,) nan where unknown."""
    gravity: np.ndarray
    """(3,) unit vector in the root frame, which for every arm but a URDF's is the base frame."""
    mass: np.ndarray
    """(J,) kg of the body that moves with joint k, 0 where unknown."""
    com: np.ndarray
    """(J, 3) mm, centre of that mass in frame k, the frame after joint k's full transform."""
    payload_mass: float
    """kg of the empty tool, 0 where unknown."""
    payload_com: np.ndarray
    """(3,) mm in the flange frame."""
    base: np.ndarray
    """(4, 4) T_root_base, mm."""
    flange: np.ndarray
    """(4, 4) T_last_flange, mm: from the frame after the last joint to the flange."""

    @property
    def joints(self) -> int:
        return len(self.geometry)


def wrong(where: object, expected: str, found: object, remedy: str) -> InputError:
    """One sentence: where it stands, what was expected, what was found, what to do."""
    return InputError(f"{where}: expected {expected}, found {found}; {remedy}.")


def builtin_robots() -> list[str]:
    """Names that `load_robot` knows without a file."""
    folder = resources.files("robot_model").joinpath("robots")
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))


def load_robot(spec: Mapping | str | PathLike, where: str = "robot") -> Robot:
    """The arm that `spec` names.

    spec: the keys of robot.toml; {"builtin": name}; {"urdf": path, "joints": [...], "tip": link}
    (see `robot_model.urdf.robot_from_urdf`); a path to a .toml or .urdf file; or a builtin name.
    where: what to call a mapping in an error sentence, usually the file that it came from.
    Raises InputError where the arm is not known or its numbers cannot be right.
    """
    if not isinstance(spec, Mapping):
        return _load_named(Path(spec))
    if "urdf" in spec:
        from robot_model.urdf import robot_from_urdf

        return robot_from_urdf(spec, where)
    if "builtin" in spec:
        return _load_builtin(spec, where)
    from robot_model.robot_file import robot_from_keys

    return robot_from_keys(spec, where)


def _load_named(path: Path) -> Robot:
    if path.suffix.lower() == ".urdf":
        return load_robot({"urdf": str(path)}, str(path))
    if path.suffix.lower() == ".toml":
        from robot_model.robot_file import read_toml

        keys = read_toml(path)
        if isinstance(keys.get("urdf"), str):
            keys["urdf"] = str(path.parent / keys["urdf"])
        return load_robot(keys, str(path))
    return load_robot({"builtin": str(path)})


def _load_builtin(spec: Mapping, where: str) -> Robot:
    from robot_model.robot_file import read_toml, robot_from_keys

    name, known = spec["builtin"], builtin_robots()
    if len(spec) > 1:
        raise wrong(f"{where}: key builtin", "no other key beside it", ", ".join(map(str, spec)), "remove the others")
    if name not in known:
        raise wrong(f"{where}: key builtin", f"one of {', '.join(known)}", repr(name), "name one, or give a file")
    file = resources.files("robot_model").joinpath("robots", f"{name}.toml")
    return robot_from_keys(read_toml(file), f"{name}.toml")
