"""Held-out errors of folds whose fits are one Gauss-Newton step from the fit of all samples.

Stages of a plan are compared over ten folds, and each fit differs from that of all samples by a fraction of a sigma.
The normal equations of a sum of squares add up over the folds, so that one linearisation serves all of them. The
residual is then that of the model itself, without linearisation. Where it shows that a step was not enough, the fold is
fitted as `cross_validate` does.

Source: the update of a fit when observations are removed, Cook & Weisberg, Residuals and Influence in Regression
(1982), section 3.2.
"""

from dataclasses import dataclass, replace

import numpy as np

from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.least_squares.noise import noise_mask
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.fitting.cross_validation import (
    HeldOut,
    hold_out,
    no_residual,
    pad_to_position,
    places_of_target,
    stated_sigma,
)
from workbench.fitting.priors.shrinkage import rescaled

_DAMPING = 1e-4
"""Information on a parameter, per squared typical size, below which it stays where it is, as in `solve`."""
_SAME_FIT = 1e-3
"""Share of chi-square by which a step may miss its prediction."""


def cross_validate_linearised(
    model: Model, start: Parameters, fold: np.ndarray, steps: int = 50, settle: bool = False
) -> HeldOut:
    """As `cross_validate` with the linear loss, from one linearisation at `start`, the fit of all samples.

    fold (n,) int, -1: left out; steps: of a fold that needs a fit of its own; settle: as of `cross_validate`.
    """
    residual, located = no_residual(model), {}
    folds = _Folds.at(model, start, fold)
    is_linear = len(folds.blocks) > 1 and not noise_mask(model, start).any()
    for k in range(len(folds.blocks)):
        test = fold == folds.numbers[k]
        start_of_fold, found, is_settled = start, None, False
        if is_linear:
            known = folds.normal_without(k)
            fitted = folds.fitted(known, settle)
            found = folds.held_out(k, known, fitted)
            start_of_fold, is_settled = (
                fitted,
                True,
            )  # also the scales of its priors are those of the other folds
        if found is None:
            others = (fold >= 0) & ~test
            settle_again = settle and not is_settled
            exact = hold_out(model, start_of_fold, test, others, "linear", steps, settle_again)
            found = exact.residual[:, test], exact.located
        residual[:, test] = found[0]
        located |= found[1]
    return HeldOut(residual, fold, located, stated_sigma(model))


@dataclass(frozen=True)
class _Block:
    """Whitened normal equations of some samples: `normal` (F, F), `gradient` (F,), `squares` of `count` residuals."""

    normal: np.ndarray
    gradient: np.ndarray
    squares: float
    count: int

    @classmethod
    def of(cls, rows: np.ndarray, residual: np.ndarray) -> "_Block":
        """Of whitened rows (F, m, n) and residuals (m, n)."""
        flat = rows.reshape(len(rows), residual.size)
        right = residual.ravel()
        return cls(flat @ flat.T, flat @ right, float(right @ right), right.size)

    def __add__(self, other: "_Block") -> "_Block":
        return _Block(
            self.normal + other.normal,
            self.gradient + other.gradient,
            self.squares + other.squares,
            self.count + other.count,
        )

    def squares_after(self, move: np.ndarray) -> float:
        """Sum of squares after a move (F,) of the parameters, were the residual linear."""
        return self.squares + float(2 * self.gradient @ move + move @ self.normal @ move)

    def step(self, parameters: Parameters, start: Parameters, squares: float) -> np.ndarray:
        """(F,) move from `start` to the least squares under the priors of `parameters`.

        squares: of the residuals; where they exceed their stated sigma, the priors weigh so much more, as in `solve`.
        """
        size = parameters.typical[parameters.mask]
        from_null = start.pack() - parameters.nulls[parameters.mask]
        weight = parameters.precision[parameters.mask] * max(1.0, squares / self.count)
        information = self.normal * np.outer(size, size) + np.diag(weight * size**2 + _DAMPING)
        right = size * (self.gradient + weight * from_null)
        return -size * solve_positive(information, right)


@dataclass(frozen=True)
class _Folds:
    """The samples of all folds, linearised at `start`; `fold` (n,) and `blocks` in the order of `numbers`.

    `white` (m, n): 1 / sigma of the residuals.
    """

    model: Model
    start: Parameters
    fold: np.ndarray
    numbers: np.ndarray
    blocks: tuple[_Block, ...]
    white: np.ndarray

    @classmethod
    def at(cls, model: Model, start: Parameters, fold: np.ndarray) -> "_Folds":
        part = model.part(fold >= 0)
        fold = fold[fold >= 0]
        numbers = np.unique(fold)
        residual, rows = part.linearise(start)
        white = np.broadcast_to(1 / part.sigma(start), residual.shape)
        residual, rows = residual * white, rows * white
        blocks = (_Block.of(rows[..., fold == k], residual[:, fold == k]) for k in numbers)
        return cls(part, start, fold, numbers, tuple(blocks), white)

    def normal_without(self, k: int) -> _Block:
        """The normal equations of all folds but one."""
        others = self.blocks[:k] + self.blocks[k + 1 :]
        return sum(others[1:], others[0])

    def fitted(self, known: _Block, settle: bool) -> Parameters:
        """The fit to some folds, one step from the start and, to settle, one more under priors of another scale."""
        move = known.step(self.start, self.start, known.squares)
        fitted = self.start.unpack(self.start.pack() + move)
        if not settle:
            return fitted
        scaled = rescaled(self.model, fitted, normal=known.normal)
        if scaled is fitted:
            return fitted
        move = known.step(scaled, self.start, known.squares_after(move))
        return scaled.unpack(self.start.pack() + move)

    def held_out(
        self, k: int, known: _Block, fitted: Parameters
    ) -> tuple[np.ndarray, dict[str, float]] | None:
        """Residual (m, n) on fold k and what was located on it; None where the fold needs a fit of its own."""
        residual = self.model.residual(fitted)
        test = self.fold == self.numbers[k]
        white = (residual * self.white)[:, ~test]
        move = fitted.pack() - self.start.pack()
        squares = float((white**2).sum())
        if not abs(squares - known.squares_after(move)) <= _SAME_FIT * squares:
            return None
        unseen = self._unseen(known, self.blocks[k])
        if not unseen.any():
            return pad_to_position(residual[:, test]), {}
        seen = self.model.part(test)
        placed = solve(seen, fitted.only(unseen)).parameters
        located = {key: placed[key] for key, is_unseen in zip(placed.keys, unseen) if is_unseen}
        fitted = replace(fitted, values=placed.values)
        return pad_to_position(seen.residual(fitted)), located

    def _unseen(self, known: _Block, block: _Block) -> np.ndarray:
        """(P,) True for places on tool or artefact that only this block shows."""
        unseen = places_of_target(self.model, self.start)
        silent = (np.diag(known.normal) == 0) & (np.diag(block.normal) > 0)
        unseen[self.start.mask] &= silent
        return unseen & self.start.mask


__all__ = ["cross_validate_linearised"]
