"""Column space of the effects of a solution, orthogonal to the baseline, and of any subset of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpstrf, dtrtri

from workbench.core.least_squares.linear_algebra import check_finite, thin_svd
from workbench.diagnosis.levels import ROUNDING


@dataclass(frozen=True)
class AddedEffects:
    """Columns (N, A) of all added effects, orthogonal to the baseline, of unit length; `start` (E + 1,) of each.

    `gram` (A, A) their inner products; `y` (N,) the residual without all of these effects, the baseline projected out;
    `score` (A,) inner products of the two; `precision` (A,) of their coefficients' priors. `mixing` (A, W): columns
    times it are an orthonormal basis of the column space of all effects. That of any subset of the effects follows from
    these without the samples.
    """

    columns: np.ndarray
    start: np.ndarray
    gram: np.ndarray
    y: np.ndarray
    score: np.ndarray
    precision: np.ndarray
    mixing: np.ndarray

    @classmethod
    def of(cls, problem) -> "AddedEffects":
        """Of a `Problem` solved with effects."""
        columns = np.concatenate(problem.added, 1)
        fitted = columns @ np.concatenate(problem.values)
        y = problem.orthogonalise(problem.residual - fitted)
        raw_length = np.sqrt(np.einsum("np,np->p", columns, columns))
        columns /= np.maximum(raw_length, 1e-300)
        orthogonal = problem.orthogonalise(columns)
        del columns
        orthogonal = problem.orthogonalise(
            orthogonal
        )  # again: rounding of the first time is no direction
        length = np.sqrt(np.einsum("np,np->p", orthogonal, orthogonal))
        orthogonal *= np.where(length > ROUNDING, 1 / np.maximum(length, 1e-300), 0.0)
        start = np.concatenate([[0], np.cumsum([part.shape[1] for part in problem.added])])
        precisions = problem.precisions or tuple(np.zeros(part.shape[1]) for part in problem.added)
        precision = np.concatenate(precisions) / np.maximum((raw_length * length) ** 2, 1e-200)
        gram = orthogonal.T @ orthogonal
        score = orthogonal.T @ y
        return cls(orthogonal, start, gram, y, score, precision, orthonormal(gram))

    def reordered(self, order: Sequence[int]) -> "AddedEffects":
        """The same effects in another order, with the same orthonormal basis of the column space of all of them."""
        columns = np.concatenate([self._span(i) for i in order])
        widths = np.diff(self.start)[list(order)]
        return AddedEffects(
            self.columns[:, columns],
            np.concatenate([[0], np.cumsum(widths)]),
            self.gram[np.ix_(columns, columns)],
            self.y,
            self.score[columns],
            self.precision[columns],
            self.mixing[columns],
        )

    def order_by_gain(self, allowed: Callable[[list[int]], list[int]]) -> list[int]:
        """Indices of all effects: first what explains most, then what explains most conditional on it, and so on.

        allowed: those of the remaining effects that may come next.
        """
        gram = self.gram.copy()
        score = self.score.copy()
        remaining = list(range(len(self.start) - 1))
        ordered = []
        while remaining:
            gains = {}
            for i in allowed(remaining):
                span = self._span(i)
                directions = orthonormal(gram[np.ix_(span, span)])
                gains[i] = float(((directions.T @ score[span]) ** 2).sum())
            chosen = max(gains, key=gains.get)
            span = self._span(chosen)
            directions = orthonormal(gram[np.ix_(span, span)])
            projections = gram[:, span] @ directions
            score -= projections @ (directions.T @ score[span])
            gram -= projections @ projections.T
            ordered.append(chosen)
            remaining.remove(chosen)
        return ordered

    def _span(self, effect: int) -> np.ndarray:
        return np.arange(self.start[effect], self.start[effect + 1])

    @cached_property
    def full_subspace(self) -> "RetainedSubspace":
        """Column space of all effects."""
        return RetainedSubspace(self, self.mixing, np.arange(len(self.score)))

    @cached_property
    def basis(self) -> np.ndarray:
        """(N, W) orthonormal basis of the column space of all effects."""
        return self.full_subspace.basis

    def subspace(self, effects: Sequence[int]) -> "RetainedSubspace":
        """Column space of some of the effects, which are given by their indices."""
        indices = np.concatenate([np.zeros(0, int), *map(self._span, effects)])
        directions = orthonormal(self.gram[np.ix_(indices, indices)])
        mixing = np.zeros((len(self.score), directions.shape[1]))
        mixing[indices] = directions
        return RetainedSubspace(self, mixing, indices)


def orthonormal(gram: np.ndarray) -> np.ndarray:
    """(h, R) Q with Q' gram Q = I for gram (h, h) of columns of about unit length.

    By a Cholesky factorisation with pivoting, at a tenth of the time of eigenvectors: it ends where no column has more
    than `ROUNDING` of its square left that others do not make (Higham, Accuracy and Stability of Numerical Algorithms,
    2nd ed., sec. 10.3).
    """
    check_finite(gram)
    if not len(gram):
        return gram
    factor, pivots, rank, _ = dpstrf(gram, tol=ROUNDING, lower=0)
    transform = np.zeros((len(gram), rank))
    if rank:
        transform[pivots[:rank] - 1] = dtrtri(np.triu(factor[:rank, :rank]))[0]
    return transform


@dataclass(frozen=True)
class RetainedSubspace:
    """Column space of some of the added effects: columns of `added` times `mixing` (A, R) are orthonormal.

    `column_numbers`: indices of the columns of these effects.
    """

    added: AddedEffects
    mixing: np.ndarray
    column_numbers: np.ndarray

    @property
    def basis(self) -> np.ndarray:
        """(N, R) orthonormal basis."""
        return self.added.columns @ self.mixing

    @cached_property
    def hat_mixing(self) -> np.ndarray:
        """(A, P) with H H' the inverse of X'X + L: X the columns of these effects, L the precisions of their priors."""
        # a coefficient is fixed by a prior of this precision; next to one of 1e200 all others are rounding
        precision = np.minimum(self.added.precision[self.column_numbers], 1 / ROUNDING)
        scale = 1 / np.sqrt(1 + precision)
        gram = self.added.gram[np.ix_(self.column_numbers, self.column_numbers)] * np.outer(
            scale, scale
        )
        directions = orthonormal(gram + np.diag(precision * scale**2))
        mixing = np.zeros((len(self.added.score), directions.shape[1]))
        mixing[self.column_numbers] = scale[:, None] * directions
        return mixing

    @cached_property
    def within_whole(self) -> np.ndarray:
        """(W, R) coordinates of the basis in that of all effects."""
        return (self.added.full_subspace.mixing.T @ self.added.gram) @ self.mixing

    @cached_property
    def omitted(self) -> np.ndarray:
        """(W, W - R) orthonormal coordinates of what the space of all effects has beyond this one, as above."""
        all_coordinates = self.added.full_subspace.mixing
        numbers = np.setdiff1d(np.arange(len(all_coordinates)), self.column_numbers)
        others = all_coordinates.T @ self.added.gram[:, numbers]
        others -= self.within_whole @ (self.within_whole.T @ others)
        return thin_svd(others)[0][:, : all_coordinates.shape[1] - self.mixing.shape[1]]

    @property
    def y(self) -> np.ndarray:
        """(N,) the residual orthogonal to the baseline and to the retained effects."""
        return self.added.y - self.added.columns @ (self.mixing @ self.score)

    @property
    def score(self) -> np.ndarray:
        """(R,) inner products of the basis with the residual."""
        return self.mixing.T @ self.added.score
