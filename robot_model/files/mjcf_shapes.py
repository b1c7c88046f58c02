"""Masses of the shapes (<geom>) of an MJCF file. A mesh is not read and has none but a stated one."""

from collections.abc import Mapping

import numpy as np

from robot_model.files.mjcf_file import numbers

_DENSITY = "1000"  # kg/m^3, MuJoCo's default
_MESHLIKE = ("mesh", "plane", "hfield", "sdf")
_SIZES = {"sphere": 1, "box": 3, "ellipsoid": 3, "cylinder": 2, "capsule": 2}


def shape_mass(keys: Mapping[str, str], where: str) -> float:
    """kg of a geom with its attributes, those of its class among them."""
    if keys.get("mass") is not None:
        return float(numbers(keys["mass"], 1, where)[0])
    kind = keys.get("type", "sphere")
    if kind in _MESHLIKE or kind not in _SIZES or "size" not in keys:
        return 0.0
    density = float(numbers(keys.get("density", _DENSITY), 1, where)[0])
    return density * _volume(kind, _size(kind, keys, where))


def shape_ends(keys: Mapping[str, str], where: str) -> np.ndarray | None:
    """(2, 3) m: the ends of the axis of a shape that is given by them; None where it has a place of its own."""
    ends = keys.get("fromto")
    if ends is None:
        return None
    return numbers(ends, 6, where).reshape(2, 3)


def _size(kind: str, keys: Mapping[str, str], where: str) -> list[float]:
    """Radii and half lengths, m; the half length of a shape between two ends is theirs."""
    size = [float(word) for word in keys["size"].split()]
    ends = shape_ends(keys, where)
    if ends is not None and size:
        half = float(np.linalg.norm(ends[1] - ends[0])) / 2
        if _SIZES[kind] == 2:
            size = [size[0], half]
        else:
            size = [size[0], size[0], half]
    numbers(" ".join(map(str, size[: _SIZES[kind]])), _SIZES[kind], f"{where}: geom size")
    return size


def _volume(kind: str, size: list[float]) -> float:
    """m^3."""
    first, *others = size
    if kind == "sphere":
        return 4 / 3 * np.pi * first**3
    if kind == "cylinder":
        return 2 * np.pi * first**2 * others[0]
    if kind == "capsule":
        return np.pi * first**2 * (2 * others[0] + 4 / 3 * first)
    of_unit = 8.0 if kind == "box" else 4 / 3 * np.pi
    return of_unit * first * others[0] * others[1]
