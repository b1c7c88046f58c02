"""A planted effect: name, place, action at a given size, and plausible range of sizes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from datasets.makers.blind import baseline_span
from datasets.makers.blind.world import Perturbation, World


@dataclass(frozen=True)
class PlantedEffect:
    """One effect at one place.

    act: size -> Perturbation. trial: a size that is detectable and still small; max_size: the largest size on a
    real machine. detail: options that an oracle fit needs (order, instant, ...). accept: other
    (effect, where) that are equivalent in these data. places: equivalent places. depends_on:
    covariates of an effect outside the vocabulary, any of which is correct. fixed: the size is not scaled.
    """

    effect: str
    where: str
    act: Callable[[float], Perturbation]
    trial: float
    max_size: float
    unit: str
    detail: Mapping = field(default_factory=dict)
    accept: tuple[tuple[str, str], ...] = ()
    places: tuple[str, ...] = ()
    depends_on: tuple[str, ...] = ()
    fixed: bool = False


@dataclass(frozen=True)
class Sized:
    """A planted effect at the size of a case; `orthogonal_sigma`: RMS orthogonal to the baseline, in sigma."""

    planted: PlantedEffect
    size: float
    push: Perturbation
    orthogonal_sigma: float
    share: float

    def truth(self) -> dict:
        """Its entry in the truth."""
        effect = self.planted
        return {
            "effect": effect.effect,
            "where": effect.where,
            "value": self.size,
            "unit": effect.unit,
            "survives_sigma": self.orthogonal_sigma,
            "survives_share": self.share,
            "detail": dict(effect.detail),
            "accept": [list(pair) for pair in effect.accept],
            "places": list(effect.places),
            "depends_on": list(effect.depends_on),
        }


_LEAST_SHARE = 2e-3


def sized(
    world: World, base: np.ndarray, effect: PlantedEffect, wanted: float, sign: float = 1.0
) -> Sized | None:
    """The effect at the size with `wanted` sigma, RMS over coordinates, orthogonal to the baseline.

    None if the baseline absorbs it completely or it has no effect here. The size is at most `max_size`; the
    orthogonal part is then smaller. sign: 1 or -1.
    """
    size = effect.trial
    for _ in range(1 if effect.fixed else 3):  # a step of the encoder does not grow in proportion
        found = _sized_at(world, base, effect, size)
        if found.share < _LEAST_SHARE or found.orthogonal_sigma <= 0:
            return None
        if effect.fixed or abs(found.orthogonal_sigma / wanted - 1) < 0.02:
            break
        size = min(size * wanted / found.orthogonal_sigma, effect.max_size)
    return _sized_at(world, base, effect, sign * size)


def _sized_at(world, base, effect, size) -> Sized:
    push = effect.act(size)
    change = world.measured(push) - world.clean
    total = baseline_span.rms(change)
    if np.any(push.spread):  # an effect on the noise does not change the mean
        return Sized(effect, size, push, float(np.std(push.spread)), 1.0)
    remaining = baseline_span.rms(baseline_span.left(base, change))
    share = remaining / total if total > 0 else 0.0
    return Sized(effect, size, push, remaining / world.sigma, share)
