"""Alarms on values that no machine has, although they fit: the law then stands for something else."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from robot_model.effects.drift import LinkThermalGrowth
from robot_model.effects.elastic import MountTilt
from robot_model.effects.sensed import ArtefactExpansion
from workbench.core.covariates import LARGEST_EXPANSION
from workbench.diagnosis.levels import CRITICAL_T
from workbench.diagnosis.robot.derived import DEFLECTION
from workbench.explanation.sentences.words import length, measured

_MAX_SIGMAS = 10.0
"""Standard deviations of its prior beyond which a value is not plausible: they are orders of magnitude."""
_EXPANSIONS = (LinkThermalGrowth.effect, ArtefactExpansion.effect)
_TILT_DEG = 10.0
"""Tilt of gravity that no floor has: the arm is mounted otherwise."""


def implausible_values(
    rows: Sequence[Mapping], size: float | None, compliances: Collection[str] = ()
) -> tuple[str, ...]:
    """One sentence for each value that is significantly different from 0 and not plausible, without a full stop.

    rows: of a term's parameters, as `Bench.parameters` has them. size: RMS displacement by the term, mm. A deflection
    that is not significant while it moves the points by `size` has no direction that the data determine. compliances:
    keys of parameters that no part has below 0.
    """
    found = []
    for row in rows:
        value = row["value"]
        std = row["std"]
        prior = row.get("prior")
        value_text = measured(value, std, row["unit"])
        if prior and abs(value) > max(_MAX_SIGMAS * prior, CRITICAL_T * std):
            expected = measured(prior, None, row["unit"])
            found.append(
                f"{row['label']} is {value_text}, which is not plausible (expected before measuring: 0 ± {expected}): "
                "another cause may stand behind it"
            )
        elif _is_no_expansion(row):
            found.append(
                f"{row['label']} is {value_text}, and no material expands so (metals by 5 to 25 ppm/K): "
                "another cause grows with the temperature, or the part warms by more than the column states"
            )
        elif row.get("key") in compliances and value < -std:
            found.append(
                f"{row['label']} is {value_text}, and no part has a negative one: the direction of gravity, the masses "
                "or a spring of the arm may differ from the robot file (keys gravity, mass_kg and com_mm)"
            )
        elif _is_large_tilt(row):
            found.append(
                f"{row['label']} is {np.rad2deg(value):.3g} deg, which is no small tilt of a mount: the arm is mounted "
                "otherwise than the robot file states (key gravity), or another cause stands behind it"
            )
        elif row["name"] == DEFLECTION and size and value < CRITICAL_T * std:
            found.append(
                f"the deflection of {value_text} is not significant in these poses. The {length(size)} that the "
                "term makes are cancelled by other terms or by the geometry: other causes explain the poses as well"
            )
    return tuple(found)


def _is_no_expansion(row: Mapping) -> bool:
    """Whether a coefficient of linear expansion is significantly negative or larger than that of any material."""
    if row.get("effect") not in _EXPANSIONS or row["unit"] != "1/K":
        return False
    excess = max(-row["value"], row["value"] - LARGEST_EXPANSION)
    return excess > CRITICAL_T * row["std"]


def _is_large_tilt(row: Mapping) -> bool:
    """Whether a parameter is an angle of gravity that is significant and not small."""
    if row.get("effect") != MountTilt.effect or row["unit"] != "rad":
        return False
    return abs(row["value"]) > max(np.deg2rad(_TILT_DEG), CRITICAL_T * row["std"])


__all__ = ["implausible_values"]
