"""Smooth nonparametric alternatives: functions of one or two covariates at a port.

Whatever no row of the library makes must not get the name of the row that is least bad. So next to
every named effect there stands, at every place, 'a smooth function of this covariate', with a prior
that is broad in shape and size; the evidence then charges it for every number that it spends.
"""

from dataclasses import dataclass

import numpy as np

from robot_model.effects.nonparametric import SHARP_DEGREE, functions
from robot_model.effects.nonparametric import PeriodicMotion as Wave
from robot_model.effects.nonparametric import SmoothFunction as Smooth


@dataclass(frozen=True)
class Function:
    """A fitted function at a site: `x` names -> grids, `value` (k, grid) in the slots' unit, `std` alike."""

    names: tuple[str, ...]
    x: np.ndarray
    value: np.ndarray
    std: np.ndarray
    unit: str


__all__ = ["SHARP_DEGREE", "Function", "Smooth", "Wave", "functions"]
