"""Key `considered` of `solution.json`: terms that are not in the model and count for its uncertainty."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from robot_model.effects import CATALOGUE
from workbench.core.effect import Effect, make_effects
from workbench.core.errors import InputError


@dataclass(frozen=True)
class ConsideredModel:
    """The model with one term that was not retained, fitted to the same recording.

    `effects` of the term; `values` of all parameters by key (mm, rad); `free` (F,) keys of the estimated ones with
    their `covariance` (F, F) in own units; `probability` that this model predicts better.
    """

    effects: tuple[Effect, ...]
    values: Mapping[str, float]
    free: tuple[str, ...]
    covariance: np.ndarray
    probability: float

    def as_json(self) -> dict:
        """JSON that `read_considered` reads."""
        return {
            "effects": [
                {"effect": _name_of(effect), "where": effect.where, **effect.options}
                for effect in self.effects
            ],
            "values": dict(self.values),
            "free": list(self.free),
            "covariance": self.covariance.tolist(),
            "probability": self.probability,
        }


@dataclass(frozen=True)
class Considered:
    """Models with a further term each, and the RMS distance (mm) that all make at the recorded poses."""

    models: tuple[ConsideredModel, ...]
    recorded_rms_mm: float

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Of all terms."""
        return tuple(effect for model in self.models for effect in model.effects)

    def as_json(self) -> dict:
        """What `read_considered` reads."""
        return {
            "models": [model.as_json() for model in self.models],
            "recorded_rms_mm": self.recorded_rms_mm,
        }


def read_considered(keys: Mapping | None) -> Considered | None:
    """The terms of a solution; None where it has none. Raises ValueError, KeyError, TypeError."""
    if keys is None:
        return None
    recorded = float(keys["recorded_rms_mm"])
    if not recorded >= 0:
        raise ValueError("recorded_rms_mm")
    models = tuple(_read_model(model) for model in keys["models"])
    return Considered(models, recorded)


def _read_model(keys: Mapping) -> ConsideredModel:
    rows = [dict(row) for row in keys["effects"]]
    effects = make_effects(CATALOGUE, [(row.pop("effect"), row.pop("where"), row) for row in rows])
    values = {str(key): float(value) for key, value in keys["values"].items()}
    free = tuple(str(key) for key in keys["free"])
    covariance = np.array(keys["covariance"], float).reshape(len(free), len(free))
    probability = float(keys["probability"])
    if not 0 <= probability <= 1:
        raise ValueError("probability")
    if not set(free) <= set(values) or not np.isfinite(list(values.values())).all():
        raise ValueError("values")
    return ConsideredModel(effects, values, free, covariance, probability)


def considered_arms(arm) -> Iterator[tuple[object, float]]:
    """The arm with each term that counts for its uncertainty, and the probability of that model.

    arm: `workbench.files.solution_file.CalibratedArm`. Terms of its own that are switched off stay so.
    """
    for model in () if arm.considered is None else arm.considered.models:
        other = replace(
            arm,
            effects=(*arm.effects, *model.effects),
            values=dict(model.values),
            free=model.free,
            covariance=model.covariance,
            considered=None,
        )
        yield other, model.probability


def is_evaluable(effects, state) -> bool:
    """Whether the covariates of a `robot_model.state.State` hold what some effects read."""
    try:
        for effect in effects:
            effect.basis(state)
    except InputError:
        return False
    return True


def _name_of(effect: Effect) -> str:
    return next(name for name, kind in CATALOGUE.items() if kind is type(effect))


__all__ = ["Considered", "ConsideredModel", "considered_arms", "is_evaluable", "read_considered"]
