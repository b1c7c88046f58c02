"""How far empirical functions of a calibrated arm may be off at targets beyond the range that they were fitted on."""

import numpy as np

from workbench.core.model import Model
from workbench.core.parameters import Parameters


def extrapolation_mm(model: Model, parameters: Parameters) -> np.ndarray:
    """(n,) mm: 1 sigma of the 3-D place of the measured point from what empirical functions leave open there.

    An error curve of a joint or a smooth function is known where samples support it. Beyond its range it keeps its
    value at the end, and may differ by as much as it changes over the same distance before the end
    (`Effect.extrapolation`). Functions of different places are independent.
    """
    evaluation = model.evaluate(parameters)
    squares = np.zeros(model.chain.n)
    for effect, span in zip(model.effects, model.spans):
        change = effect.extrapolation(parameters.values[span], model.chain.state)
        if change is None or not change.any():
            continue
        slots = np.asarray(effect.slots(model.chain))
        moved = np.einsum("smn,sn->mn", evaluation.rows(effect.port, slots)[:, :3], change)
        squares += (moved**2).sum(0)
    return np.sqrt(squares)


__all__ = ["extrapolation_mm"]
