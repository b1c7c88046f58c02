"""Bases of effects on some of the samples, as slices of those on all samples.

The search repeats in every fold what it did on all samples. The small factor of a linear effect is a function of each
sample's own state, so that a fold needs no second one.
"""

import numpy as np

from workbench.core.effect import Effect
from workbench.core.model import Model


class SlicedBases(dict):
    """What `Model.basis` keeps of a model on `samples` (n,) bool: (effect, cause) -> basis there.

    whole: a model of all samples. names: description of an effect -> the effect by which `whole` knows it; shared by
    all parts, whose libraries make equal effects of their own.
    """

    def __init__(self, whole: Model, samples: np.ndarray, names: dict[tuple, Effect]):
        super().__init__()
        self._columns = whole.chain.columns_of(np.flatnonzero(samples))
        self._whole, self._names = whole, names

    def __missing__(self, key: tuple[Effect, Effect | None]) -> np.ndarray:
        made = self._whole.basis(*map(self._known, key))
        if made.shape[-1] > 1:
            made = np.take(made, self._columns, axis=-1)
        self[key] = made
        return made

    def _known(self, effect: Effect | None) -> Effect | None:
        """The effect of the whole model that is equal to one of a part."""
        if effect is None:
            return None
        return self._names.setdefault(describe(effect), effect)


def describe(effect: Effect) -> tuple:
    """Class, place and options of an effect: equal for effects that do the same."""
    return type(effect), effect.where, *map(repr, effect.options.values())
