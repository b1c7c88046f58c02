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
from workbench.fitting.shrinkage import rescaled

_DAMPING = 1e-4
"""Information on a parameter, per squared typical size, below which it stays where it is, as in `solve`."""
_SAME_FIT = 1e-3
"""Share of chi-square by which a step may miss its prediction."""
_CORRECTIONS = 3
"""Most corrections of a step, which use the derivative at the fit of all samples (simplified Newton method)."""
_SETTLED = 1e-2
"""Squared sigmas that a last correction moves: the next is far below that of a solve, and is not taken."""


def cross_validate_linearised(
    model: Model, start: Parameters, fold: np.ndarray, steps: int = 50, settle: bool = False
) -> HeldOut:
    """As `cross_validate` with the linear loss, from one linearisation at `start`, the fit of all samples.

    fold (n,) int, -1: left out; steps: of a fold that needs a fit of its own; settle: as of `cross_validate`.
    """
    residual, located = no_residual(model), {}
    folds = _Folds.at(model, start, fold)
    for k in range(len(folds.blocks)):
        test = fold == folds.numbers[k]
        found = folds.held_out(k, settle)
        if found is None:
            others = (fold >= 0) & ~test
            exact = hold_out(model, start, test, others, "linear", steps, settle)
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
        flat, right = rows.reshape(len(rows), residual.size), residual.ravel()
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
        away = start.pack() - parameters.nulls[parameters.mask]
        weight = parameters.precision[parameters.mask] * max(1.0, squares / self.count)
        information = self.normal * np.outer(size, size) + np.diag(weight * size**2 + _DAMPING)
        return -size * solve_positive(information, size * (self.gradient + weight * away))


@dataclass(frozen=True)
class _Folds:
    """The samples of all folds, linearised at `start`; `fold` (n,) and `blocks` in the order of `numbers`.

    `rows` (F, m n): whitened derivative of the residual; `sigma` (m, n): 1 sigma of the residual.
    """

    model: Model
    start: Parameters
    fold: np.ndarray
    numbers: np.ndarray
    rows: np.ndarray
    sigma: np.ndarray
    blocks: tuple[_Block, ...]

    @classmethod
    def at(cls, model: Model, start: Parameters, fold: np.ndarray) -> "_Folds":
        part, fold = model.part(fold >= 0), fold[fold >= 0]
        numbers = np.unique(fold)
        residual, rows = part.linearise(start)
        sigma = np.broadcast_to(part.sigma(start), residual.shape)
        residual = residual / sigma
        rows /= sigma
        blocks = tuple(_Block.of(rows[..., fold == k], residual[:, fold == k]) for k in numbers)
        flat = rows.reshape(len(rows), residual.size)
        return cls(part, start, fold, numbers, flat, sigma, blocks)

    def held_out(self, k: int, settle: bool) -> tuple[np.ndarray, dict[str, float]] | None:
        """Residual (m, n) on fold k and what was located on it; None where the fold needs a fit of its own."""
        if noise_mask(self.model, self.start).any() or len(self.blocks) < 2:
            return None
        others = self.blocks[:k] + self.blocks[k + 1 :]
        known = sum(others[1:], others[0])
        test = self.fold == self.numbers[k]
        found = self._fit(known, ~test, settle)
        if found is None:
            return None
        fitted, residual = found
        unseen = self._unseen(known, self.blocks[k])
        if not unseen.any():
            return pad_to_position(residual[:, test]), {}
        seen = self.model.part(test)
        placed = solve(seen, fitted.only(unseen)).parameters
        located = {key: placed[key] for key, mine in zip(placed.keys, unseen) if mine}
        fitted = replace(fitted, values=placed.values)
        return pad_to_position(seen.residual(fitted)), located

    def _fit(
        self, known: _Block, fitted_on: np.ndarray, settle: bool
    ) -> tuple[Parameters, np.ndarray] | None:
        """Fit on the samples `fitted_on` (n,) bool, and the residual (m, n) of all; None where it is not reached."""
        fitted, predicted = self._first_step(known, settle)
        for correction in range(_CORRECTIONS + 1):
            residual = self.model.residual(fitted)
            white = residual / self.sigma * fitted_on
            squares = float((white**2).sum())
            if not correction and not abs(squares - predicted) <= _SAME_FIT * squares:
                return None
            here = replace(known, gradient=self.rows @ white.ravel(), squares=squares)
            move = here.step(fitted, fitted, squares)
            if move @ known.normal @ move <= _SETTLED * max(1.0, squares / known.count):
                return fitted, residual
            fitted = fitted.unpack(fitted.pack() + move)
        return None

    def _first_step(self, known: _Block, settle: bool) -> tuple[Parameters, float]:
        """Parameters after one step from `start`, and the sum of squares that the linearisation predicts there."""
        move = known.step(self.start, self.start, known.squares)
        fitted = self.start.unpack(self.start.pack() + move)
        if settle:
            scaled = rescaled(self.model, fitted, normal=known.normal)
            if scaled is not fitted:
                move = known.step(scaled, self.start, known.squares_after(move))
                fitted = scaled.unpack(self.start.pack() + move)
        return fitted, known.squares_after(move)

    def _unseen(self, known: _Block, block: _Block) -> np.ndarray:
        """(P,) True for places on tool or artefact that only this block shows."""
        unseen = places_of_target(self.model, self.start)
        silent = (np.diag(known.normal) == 0) & (np.diag(block.normal) > 0)
        unseen[self.start.mask] &= silent
        return unseen & self.start.mask


__all__ = ["cross_validate_linearised"]
