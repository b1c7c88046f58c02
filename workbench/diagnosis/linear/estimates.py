"""Estimates of a diagnosis with their standard deviations: parameters, instants, options that are real numbers."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from workbench.core.effect import Effect
from workbench.core.parameters import Parameter
from workbench.diagnosis.levels import CRITICAL_T, UNDETERMINED_STD


@dataclass(frozen=True)
class Instant:
    """When something begins: `value` and its standard deviation `std`, in `unit`: "s", or "sample" without a time."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class RealOption:
    """An option of an effect that is a real number: `name`, `value` and standard deviation `std`, in `unit`.

    `word`: format string of the label of a variant, with its value as {:g}.
    """

    name: str
    value: float
    std: float
    unit: str
    word: str

    def changed(self, effect: Effect, step: float) -> Effect:
        """An effect with another value of this option, `step` standard deviations away."""
        value = self.value + step * self.std
        options = effect.options | {self.name: value}
        return type(effect)(effect.where, **options)


Options = Mapping[Effect, RealOption]
"""Effects with an option that was estimated, and this option."""


def parameter_row(
    p: Parameter, effect: Effect, value: float, std: float, conditional_std: float | None = None
) -> dict:
    """A row of `Bench.parameters`, but for the sizes of what the parameter does.

    std: with the uncertainty of options that were estimated; conditional_std: with these options known.

    A parameter that could be many times its typical size, and zero as well, is not identifiable by itself.
    """
    is_identifiable = std < UNDETERMINED_STD * p.typical or abs(value) > CRITICAL_T * std
    return {
        "key": p.key,
        "name": p.key.split(".", 2)[2],
        "where": effect.where,
        "label": p.label,
        "effect": effect.effect,
        "value": float(value),
        "std": float(std),
        "conditional_std": float(std if conditional_std is None else conditional_std),
        "unit": p.unit,
        "typical": p.typical,
        "prior": p.prior,
        "identifiable": bool(is_identifiable),
    }


def with_variation(rows: Sequence[Mapping], variation: float) -> tuple:
    """Rows of one finding, the first with the variance between the probable sets of terms added to that in one set.

    variation: as of `Finding`. A compliance is smaller where another part deflects as well: the law of total variance.
    """
    if not rows or not variation:
        return tuple(rows)
    first = rows[0]
    std_of_variation = variation * first["value"]
    std = math.hypot(first["std"], std_of_variation)
    return ({**rows[0], "std": std}, *rows[1:])
