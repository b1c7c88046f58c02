"""Elastic effects under the weight of links and load of an arm whose masses nobody states."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.effects.unknown_masses import GravityCompliance
from robot_model.state import State
from workbench.core.errors import InputError
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.solution import Stage

_ROUNDING = 1e-9  # mm or rad; a smaller change of a measurement is a rounding error
_REMEDY = (
    f"Use {GravityCompliance.effect} (or the gravity- effect of the same part), which needs no masses, or state "
    "mass_kg and com_mm of the links."
)


def missing_mass_warnings(stages: Sequence[Stage], state: State) -> tuple[str, ...]:
    """A sentence if a plan names effects of gravity torques, and neither links nor load of the arm have a mass."""
    planned = {name: None for stage in stages for name, _, _ in stage.effects}
    names = [name for name in planned if name in CATALOGUE and CATALOGUE[name].mass_dependent]
    if not names or state.has_masses:
        return ()
    return (
        f"The robot has no masses and the recording no payload_kg: {', '.join(names)} has no effect, and nothing is "
        f"estimated for it. {_REMEDY}",
    )


def check_loads(model: Model, parameters: Parameters) -> None:
    """InputError where an effect of gravity torques has values and changes no measurement, since nothing has a mass."""
    if model.chain.state.has_masses:
        return
    residual = model.residual(parameters)
    for effect, span in zip(model.effects, model.spans):
        if not effect.mass_dependent or not parameters.values[span].any():
            continue
        values = parameters.values.copy()
        values[span] = 0.0
        change = model.residual(replace(parameters, values=values)) - residual
        if np.abs(change).max() < _ROUNDING:
            raise InputError(
                f"{effect.effect} at {effect.where} has no torque to act on: the robot has no masses and the scene "
                f"no payload_kg. {_REMEDY}"
            )
