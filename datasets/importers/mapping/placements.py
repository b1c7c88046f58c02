"""Statements of a mapping on data of a controller that a robot program lacks: [tool], [frame], [controller].

[tool], [frame]: one transform for all positions, or one for each number or name, as in [tool.3].
"""

from collections.abc import Mapping as Keys
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from datasets.errors import complaint
from workbench.core.text.sections import Finite, Placement, Section, checked_section

ALL = ""
"""Key of the transform that holds for all positions of a program."""


@dataclass(frozen=True)
class Placements:
    """Transforms by the number or name of the tool or frame; `ALL`: of all positions."""

    by_name: Keys[str, Placement]

    @property
    def matrices(self) -> dict[str, np.ndarray]:
        """(4, 4) mm by number or name."""
        return {name: placement.matrix for name, placement in self.by_name.items()}

    def as_keys(self) -> dict:
        """Plain keys for TOML."""
        keys = {name: placement.model_dump() for name, placement in self.by_name.items()}
        return {**keys.pop(ALL, {}), **keys}


class Controller(Section):
    """[controller]: reading of the controller = sign * reading of the robot file + zero, joint by joint."""

    joint_signs: Annotated[list[Literal[-1, 1]], Field(min_length=6, max_length=6)]
    joint_zeros_deg: Annotated[list[Finite], Field(min_length=6, max_length=6)] = Field(
        default_factory=lambda: [0.0] * 6
    )


def placements_from_keys(keys: object, where: str) -> Placements:
    """The transforms of [tool] or [frame]. Raises InputError for other keys and values."""
    if not isinstance(keys, Keys) or not keys:
        names = " and ".join(Placement.model_fields)
        raise complaint(where, f"the keys {names}", repr(keys)[:60], "correct it")
    numbered = {str(name): value for name, value in keys.items() if isinstance(value, Keys)}
    of_all = {name: value for name, value in keys.items() if not isinstance(value, Keys)}
    found = {ALL: checked_section(Placement, of_all, where)} if of_all else {}
    for name, value in numbered.items():
        found[name] = checked_section(Placement, value, f"{where.rstrip(']')}.{name}]")
    return Placements(found)
