"""Scale gauge of recordings that measure no length: the arm's size follows from all its nominal lengths.

Touches of a fixed point, or beams through one, are met as well by an arm grown as a whole. A length
left free would not stay where the data leave it: the squared gaps themselves fall as the arm
shrinks, and the solve follows them (Gubankov & Yukhimets, Sensors 2022, 22, 3376, section 4). So one
length is held while all else is solved, and then the whole is brought to the size that the priors of
all lengths want most: what one nominal length is wrong by must not scale the arm.
"""

import numpy as np

from robot_model.system import RobotChain
from workbench.core.parameters import Parameters


def size_of(chain: RobotChain, gauge_parameters: Parameters) -> str | None:
    """Key of the free length that is to give the arm its size; None where a length is measured or held.

    It is the longest nominal length between the first joint and the last, whose own lengths only
    shift the base or lengthen the tool.
    """
    if not chain.measurement.grounded or chain.measurement.measured.any():
        return None
    inner = [f"joint-{k}.{name}{k}" for k in range(2, chain.robot.joints) for name in "ad"]
    longest = max(
        inner,
        key=lambda key: abs(gauge_parameters.nulls[gauge_parameters.index[key]]),
        default=None,
    )
    if longest is not None and gauge_parameters.mask[gauge_parameters.index[longest]]:
        return longest
    return None


def non_negligible_lengths(parameters: Parameters, size: str) -> list[str]:
    """Keys of the free link lengths that are not negligible compared with `size`."""
    nulls = np.abs(parameters.nulls)
    long = (
        (nulls > 0.05 * nulls[parameters.index[size]])
        & parameters.mask
        & (parameters.precision > 0)
    )
    return [
        p.key
        for p, chosen in zip(parameters.table, long)
        if chosen and p.unit == "mm" and p.key != size
    ]


def resized(parameters: Parameters, size: str) -> Parameters:
    """Every free length, and `size`, times the one factor with which their priors are satisfied best.

    What the data say is not changed by it, but for lengths held for other reasons, which are gauges
    of their own: to be solved once more from there, which takes a step or two.
    """
    mask = parameters.mask & np.array([p.unit == "mm" for p in parameters.table])
    mask[parameters.index[size]] = True
    values = parameters.values[mask]
    precision = parameters.precision[mask]
    square = precision @ values**2
    if not square > 0:  # no length has a prior and a value: there is no size to keep
        return parameters
    factor = (precision * parameters.nulls[mask]) @ values / square
    new = parameters.values.copy()
    new[mask] *= factor
    return Parameters(parameters.table, new, parameters.mask)
