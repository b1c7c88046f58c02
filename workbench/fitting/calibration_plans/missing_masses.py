"""Elastic effects under the weight of links and load of an arm whose masses nobody states."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.effects.elastic import FirstMoment
from robot_model.effects.unknown_masses import GravityCompliance
from robot_model.robot import Robot
from robot_model.state import State
from workbench.core.errors import InputError
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.solution import Stage

_CONTRADICTION_SIGMAS = 5.0  # prior standard deviations of a first moment: 6e-7 by chance
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


def wrong_mass_warnings(parameters: Parameters, robot: Robot) -> tuple[str, ...]:
    """A sentence if an estimated first moment is far from that of the masses in the robot file.

    parameters: of a calibrated model. A fit widens the priors of moments that its data contradict, so that the
    deviations are compared with the prior of the effect.
    """
    moments = {
        row.label: abs(value)
        for row, value, is_free in zip(parameters.table, parameters.values, parameters.mask)
        if is_free and f".{FirstMoment.effect}." in row.key
    }
    if not robot.mass.any() or not moments:
        return ()
    label = max(moments, key=moments.get)
    deviation = moments[label] / FirstMoment.prior_size(robot)
    if deviation < _CONTRADICTION_SIGMAS:
        return ()
    return (
        f"{label[0].upper()}{label[1:]} differs by {deviation:.1f} prior standard deviations from that of the masses "
        "in the robot file: mass_kg or com_mm there are wrong, or another effect acts like them. The stiffness of the "
        "joints is then wrong, too: correct the masses, or leave them out and measure with known loads.",
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
