"""What one concealed effect is: its name and place, what it does at a given size, and how large it may be."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from datasets.makers.blind import surviving
from datasets.makers.blind.world import Push, World


@dataclass(frozen=True)
class Concealed:
    """One effect at one place.

    act: size -> Push. trial: a size at which it is certainly visible and still small; most: the
    largest that a real machine would have. detail: what a fit that knows the truth must be told
    (order, instant, ...). accept: other (effect, where) that are the very same thing in these data.
    places: other places that are the same. depends_on: covariates that an unnamed law depends on, any
    of which is right. fixed: it has one size, and is not scaled.
    """

    effect: str
    where: str
    act: Callable[[float], Push]
    trial: float
    most: float
    unit: str
    detail: Mapping = field(default_factory=dict)
    accept: tuple[tuple[str, str], ...] = ()
    places: tuple[str, ...] = ()
    depends_on: tuple[str, ...] = ()
    fixed: bool = False


@dataclass(frozen=True)
class Sized:
    """An effect at the size that a case has: what it adds, what of it survives, in sigma of a coordinate."""

    concealed: Concealed
    size: float
    push: Push
    survives: float
    share: float

    def truth(self) -> dict:
        """What the sealed answer says of it."""
        one = self.concealed
        return {
            "effect": one.effect,
            "where": one.where,
            "value": self.size,
            "unit": one.unit,
            "survives_sigma": self.survives,
            "survives_share": self.share,
            "detail": dict(one.detail),
            "accept": [list(pair) for pair in one.accept],
            "places": list(one.places),
            "depends_on": list(one.depends_on),
        }


_LEAST_SHARE = 2e-3
_ENLARGED = 1.5


def sized(
    world: World, base: np.ndarray, one: Concealed, wanted: float, sign: float = 1.0
) -> Sized | None:
    """The effect at the size that leaves `wanted` sigma, RMS over coordinates, after the baseline.

    None where the baseline swallows all of it, or nothing of it is to be seen here. At most `most`,
    and then less survives. sign: 1 or -1.
    """
    size = one.trial
    for _ in range(1 if one.fixed else 3):  # a step of the encoder does not grow in proportion
        found = _at(world, base, one, size)
        if found.share < _LEAST_SHARE or found.survives <= 0:
            return None
        if one.fixed or abs(found.survives / wanted - 1) < 0.02:
            break
        size = min(size * wanted / found.survives, one.most)
    return _at(world, base, one, sign * size)


def _at(world, base, one, size) -> Sized:
    push = one.act(size)
    change = world.measured(push) - world.clean
    whole = surviving.rms(change)
    if np.any(push.spread):  # what a spread does is in the scatter, not in the mean
        return Sized(one, size, push, float(np.std(push.spread)), 1.0)
    rest = surviving.rms(surviving.left(base, change))
    return Sized(one, size, push, rest / world.sigma, rest / whole if whole > 0 else 0.0)
