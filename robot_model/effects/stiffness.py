"""Which stiffness a calibrated model states in N m/rad, and which it knows only times a first moment."""

from dataclasses import dataclass

import numpy as np

from robot_model.effects.elastic import JointCompliance
from robot_model.effects.unknown_masses import GravityCompliance

LOADS, MASSES, PRODUCT = "recorded loads", "stated masses", "product only"
_SIGNIFICANT = 2.0  # sigmas that a compliance must be above zero for a stiffness to be stated
_VARIES_KG = 1e-6


@dataclass(frozen=True)
class StiffnessRow:
    """What is known of one joint's compliance.

    `known_from`: "recorded loads" or "stated masses", as uncertain as these; or "product only": compliance times first
    moment, an angle. `value`, `std` in `unit` (rad/(N m) or rad); `clear`: significantly above zero. `stiffness` and
    `stiffness_std` in N m/rad, None where the compliance is not known by itself or not clear.
    """

    where: str
    known_from: str
    value: float
    std: float | None
    unit: str
    clear: bool
    stiffness: float | None = None
    stiffness_std: float | None = None

    def as_json(self) -> dict:
        """The fields by name."""
        return dict(self.__dict__)


def stiffness_rows(model, parameters, std) -> list[StiffnessRow]:
    """One row per joint with a compliance in a model; std: key -> 1 sigma of the estimated parameters."""
    rows = []
    for effect, span in zip(model.effects, model.spans):
        if isinstance(effect, JointCompliance | GravityCompliance) and parameters.mask[span][0]:
            rows.append(_row(effect, model.chain, parameters, span.start, std))
    return [row for row in rows if row is not None]


def _row(effect, chain, parameters, first: int, std) -> StiffnessRow | None:
    key, unit = parameters.table[first].key, parameters.table[first].unit
    value, sigma = float(parameters.values[first]), std.get(key)
    is_clear = sigma is not None and value > _SIGNIFICANT * sigma
    if isinstance(effect, GravityCompliance):
        return StiffnessRow(effect.where, PRODUCT, value, sigma, unit, is_clear)
    if unit != "rad/(N m)":
        return None
    is_loaded = np.ptp(chain.state.payload) > _VARIES_KG
    known_from = MASSES if chain.robot.mass.any() else LOADS
    if not chain.robot.mass.any() and not is_loaded and not chain.robot.payload_mass:
        known_from = PRODUCT
    if known_from == PRODUCT or not is_clear:
        return StiffnessRow(effect.where, known_from, value, sigma, unit, is_clear)
    stiffness = 1 / value, sigma / value**2
    return StiffnessRow(effect.where, known_from, value, sigma, unit, is_clear, *stiffness)


__all__ = ["LOADS", "MASSES", "PRODUCT", "StiffnessRow", "stiffness_rows"]
