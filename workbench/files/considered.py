"""Key `considered` of `solution.json`: terms that are not in the model and count for its uncertainty."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from robot_model.effects import CATALOGUE
from workbench.core.effect import Effect, make_effects
from workbench.core.errors import InputError


@dataclass(frozen=True)
class Considered:
    """Effects whose K parameters `keys` stay at 0 and are uncertain.

    `covariance` (F + K, F + K): of the F estimated parameters and these, in own units. `recorded_rms_mm`: RMS
    distance that they make at the recorded poses; 0 where an older version wrote the file.
    """

    effects: tuple[Effect, ...]
    keys: tuple[str, ...]
    covariance: np.ndarray
    recorded_rms_mm: float = 0.0

    def as_json(self) -> dict:
        """What `read_considered` reads."""
        rows = [
            {"effect": _name_of(effect), "where": effect.where, **effect.options}
            for effect in self.effects
        ]
        return {
            "effects": rows,
            "free": list(self.keys),
            "covariance": self.covariance.tolist(),
            "recorded_rms_mm": self.recorded_rms_mm,
        }


def read_considered(keys: Mapping | None, estimated: int) -> Considered | None:
    """The terms of a solution with F = `estimated` parameters; None where it has none. Raises ValueError, KeyError."""
    if keys is None:
        return None
    rows = [dict(row) for row in keys["effects"]]
    effects = make_effects(CATALOGUE, [(row.pop("effect"), row.pop("where"), row) for row in rows])
    names = tuple(str(key) for key in keys["free"])
    size = estimated + len(names)
    covariance = np.array(keys["covariance"], float).reshape(size, size)
    recorded = float(keys.get("recorded_rms_mm", 0.0))
    if not recorded >= 0:
        raise ValueError("considered.recorded_rms_mm")
    return Considered(effects, names, covariance, recorded)


def with_considered(arm, state):
    """The arm with its considered terms as effects at 0, as far as the covariates of a state hold what they read.

    arm: `workbench.files.solution_file.CalibratedArm`; state: `robot_model.state.State`.
    """
    considered = arm.considered
    if considered is None:
        return arm
    effects = tuple(e for e in considered.effects if e.linear and _is_evaluable(e, state))
    prefixes = tuple(f"{effect.where}.{effect.effect}." for effect in effects)
    is_selected = [k for k, key in enumerate(considered.keys) if key.startswith(prefixes)]
    order = [*range(len(arm.free)), *(len(arm.free) + k for k in is_selected)]
    keys = [considered.keys[k] for k in is_selected]
    return replace(
        arm,
        effects=(*arm.effects, *effects),
        values=arm.values | dict.fromkeys(keys, 0.0),
        free=(*arm.free, *keys),
        covariance=considered.covariance[np.ix_(order, order)],
        considered=None,
    )


def _is_evaluable(effect: Effect, state) -> bool:
    try:
        effect.basis(state)
    except InputError:
        return False
    return True


def _name_of(effect: Effect) -> str:
    return next(name for name, kind in CATALOGUE.items() if kind is type(effect))


__all__ = ["Considered", "read_considered", "with_considered"]
