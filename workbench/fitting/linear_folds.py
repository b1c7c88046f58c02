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
from workbench.core.least_squares.solver import Fit, solve
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
_SAME_FIT = 1e-2
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
        found = folds.held_out(k, steps, settle)
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
class _Point:
    """Parameters, and the normal equations of the fitted samples there; `residual` (m, n) of all, where it is known."""

    parameters: Parameters
    block: _Block
    residual: np.ndarray | None = None


@dataclass(frozen=True)
class _Part:
    """The samples `fitted_on` (n,) bool of all folds, with normal equations `known` at the linearisation."""

    folds: "_Folds"
    known: _Block
    fitted_on: np.ndarray

    def reach(self, point: _Point, priors: Parameters) -> _Point | None:
        """Least squares under some priors, by steps with the derivative at the linearisation; None: not reached."""
        parameters = priors.unpack(point.parameters.pack())
        for correction in range(_CORRECTIONS + 2):
            block = point.block
            move = block.step(priors, parameters, block.squares)
            if correction and self.is_small(move, block):
                return point
            parameters = parameters.unpack(parameters.pack() + move)
            point = self.at(parameters)
            missed = abs(point.block.squares - block.squares_after(move))
            if not missed <= _SAME_FIT * point.block.squares:
                return None
        return None

    def is_small(self, move: np.ndarray, block: _Block) -> bool:
        """Whether a move (F,) changes no prediction by more than `_SETTLED` allows."""
        unit = max(1.0, block.squares / block.count)
        return bool(move @ self.known.normal @ move <= _SETTLED * unit)

    def at(self, parameters: Parameters) -> _Point:
        """The normal equations at other parameters, with the derivative at the linearisation."""
        folds = self.folds
        residual = folds.model.residual(parameters)
        white = residual / folds.sigma * self.fitted_on
        squares = float((white**2).sum())
        block = replace(self.known, gradient=folds.rows @ white.ravel(), squares=squares)
        return _Point(parameters, block, residual)

    def solved(self, point: _Point, priors: Parameters, steps: int) -> _Point:
        """The fit under some priors that starts from a point."""
        start = priors.unpack(point.parameters.pack())
        residual = point.residual[:, self.fitted_on]
        linearised = Fit(
            start,
            residual,
            np.ones(residual.shape[1]),
            self.known.normal,
            1.0,
            gradient=point.block.gradient,
        )
        model = self.folds.model.part(self.fitted_on)
        fit = solve(model, start, "linear", steps, linearised)
        return _Point(fit.parameters, self.known)


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

    def held_out(
        self, k: int, steps: int, settle: bool
    ) -> tuple[np.ndarray, dict[str, float]] | None:
        """Residual (m, n) on fold k and what was located on it; None where the fold needs a fit of its own."""
        if noise_mask(self.model, self.start).any() or len(self.blocks) < 2:
            return None
        others = self.blocks[:k] + self.blocks[k + 1 :]
        known = sum(others[1:], others[0])
        test = self.fold == self.numbers[k]
        found = self._fit(known, ~test, steps, settle)
        if found is None:
            return None
        unseen = self._unseen(known, self.blocks[k])
        if found.residual is not None and not unseen.any():
            return pad_to_position(found.residual[:, test]), {}
        seen, fitted = self.model.part(test), found.parameters
        placed = solve(seen, fitted.only(unseen)).parameters if unseen.any() else fitted
        located = {key: placed[key] for key, mine in zip(placed.keys, unseen) if mine}
        fitted = replace(fitted, values=placed.values)
        return pad_to_position(seen.residual(fitted)), located

    def _fit(self, known: _Block, fitted_on: np.ndarray, steps: int, settle: bool) -> _Point | None:
        """Fit on the samples `fitted_on` (n,) bool, with normal equations `known` at `start`; None: not reached."""
        part, start = _Part(self, known, fitted_on), _Point(self.start, known)
        if settle:
            move = known.step(self.start, self.start, known.squares)
            linear = self.start.unpack(self.start.pack() + move)
            scaled = rescaled(self.model, linear, normal=known.normal)
            point = part.reach(start, scaled)
            if point is not None:
                return point
        point = part.reach(start, self.start)
        if point is None or not settle:
            return point
        scaled = rescaled(self.model, point.parameters, normal=known.normal)
        if scaled is point.parameters:
            return point
        return part.reach(point, scaled) or part.solved(point, scaled, steps)

    def _unseen(self, known: _Block, block: _Block) -> np.ndarray:
        """(P,) True for places on tool or artefact that only this block shows."""
        unseen = places_of_target(self.model, self.start)
        silent = (np.diag(known.normal) == 0) & (np.diag(block.normal) > 0)
        unseen[self.start.mask] &= silent
        return unseen & self.start.mask


__all__ = ["cross_validate_linearised"]
