"""Whether the sigmas of a camera hold: the cost two sigmas away from the solution is four more, or they do not."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensors.camera.corners import Corners
from workbench.core.effect import Effect
from workbench.core.least_squares.bundle import BundleFit
from workbench.core.model import Model

_STEP = 2.0  # sigmas
_EXPECTED = _STEP**2
_HOLDS = 1.5  # factor by which the cost's rise may differ from what is expected
_WEAK = 0.05  # sigma over typical size below which derivatives stay as they are over two sigmas
_WITH = 0.1  # share of a parameter's variance that moves with the weakest one


@dataclass(frozen=True)
class Curved:
    """The weakest parameter's `label`, the free ones (F,) that move with it, and by how much (in squared sigmas)
    the cost `rise`s two sigmas below and above: four, where sigmas hold.
    """

    label: str
    members: np.ndarray
    rise: tuple[float, float]

    @property
    def sentence(self) -> str:
        low, high = self.rise
        return (
            f"{self.label} is so weakly known that no sigma holds for it: two sigmas below and above, chi-square is "
            f"{low:.3g} and {high:.3g} higher instead of {_EXPECTED:g}"
        )


def curved(chain: Corners, fit: BundleFit, effects: Sequence[Effect]) -> Curved | None:
    """Move all unknowns along the weakest parameter's course, poses with it; None where the cost rises as it must."""
    table = fit.table
    covariance = fit.covariance
    sigma = np.sqrt(np.diag(covariance))
    weak = np.where(fit.known.determined, sigma / table.typical, 0.0)
    k = int(np.argmax(weak))
    if weak[k] < _WEAK:
        return None
    course = covariance[:, k] / sigma[k]
    poses = fit.group_cross()[:, :, k] / sigma[k]
    model = Model(chain, tuple(effects))
    cost_at_solution, *costs_at_steps = (
        _cost(model, fit, step * course, step * poses) for step in (0.0, -_STEP, _STEP)
    )
    rise = tuple((cost - cost_at_solution) / fit.sigma_scale**2 for cost in costs_at_steps)
    if all(_EXPECTED / _HOLDS < ratio < _EXPECTED * _HOLDS for ratio in rise):
        return None
    return Curved(table.table[k].label or table.keys[k], (course / sigma) ** 2 > _WITH, rise)


def _cost(model, fit, move, poses):
    """Weighted squares with the shared parameters and the poses moved, and those of priors as the bundle has them."""
    parameters = fit.parameters.unpack(fit.parameters.pack() + move)
    chain = replace(
        model.chain, poses=fit.values["placement"] + poses, _kept_state=model.chain.state
    )
    residual = model.with_chain(chain).residual(parameters)
    squares = float(fit.weights[0] @ ((residual / model.chain.sigma) ** 2).sum(0))
    free = parameters.mask
    prior = parameters.precision[free] @ (parameters.pack() - parameters.nulls[free]) ** 2
    return squares + float(prior) * max(1.0, squares / residual.size)
