"""Tool and frame of the positions of a robot program, as a mapping states them: [tool] and [frame].

The controller keeps them (FANUC UT : 1, KUKA TOOL_DATA[3]); the program holds their numbers only.
"""

from collections.abc import Mapping as Keys
from dataclasses import dataclass
from math import isfinite

import numpy as np

from datasets.errors import complaint
from workbench.core.rigid import placement

_KEYS = ("xyz_mm", "rpy_deg")


@dataclass(frozen=True)
class Placement:
    """A fixed transform: translation in mm; roll, pitch and yaw about fixed x, y and z in degrees."""

    xyz_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def matrix(self) -> np.ndarray:
        """(4, 4), mm."""
        return placement(self.xyz_mm, self.rpy_deg)

    def as_keys(self) -> dict:
        """Plain keys for TOML."""
        return {"xyz_mm": list(self.xyz_mm), "rpy_deg": list(self.rpy_deg)}


def placement_from_keys(keys, where: str) -> Placement:
    """The transform that a section of a mapping states. Raises InputError for other keys and values."""
    if not isinstance(keys, Keys) or not keys or set(keys) - set(_KEYS):
        raise complaint(where, f"the keys {' and '.join(_KEYS)}", repr(keys)[:60], "correct it")
    for name, value in keys.items():
        if not isinstance(value, list) or len(value) != 3 or not all(map(_is_number, value)):
            raise complaint(f"{where}, key {name}", "three numbers", repr(value)[:60], "correct it")
    return Placement(**{name: tuple(map(float, value)) for name, value in keys.items()})


def _is_number(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
