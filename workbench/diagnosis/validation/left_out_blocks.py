"""Samples left out of a linearised fit, block by block: from inner products of each block, made once a solution.

e = (I - B_b B_b')^-1 r for a block b left out of a linear fit with hat matrix B B' (Cook & Weisberg, Residuals and
Influence in Regression (1982), sec. 3.6). The added effects have their priors in it, as in a fit of the samples.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve

from workbench.core.least_squares.linear_algebra import symmetric_eigen, symmetric_eigenvalues
from workbench.core.least_squares.matrix_functions import function_times
from workbench.diagnosis.levels import NEGLIGIBLE_SHARE
from workbench.diagnosis.linear.problem import BLOCK, Problem, cached


@dataclass(frozen=True)
class Block:
    """Rows (k,) of a problem, the columns (k, C) and observations (k,) of its fit there, and their inner products.

    The columns are those of all effects of the solution, so that every subset of these has the same blocks.
    """

    rows: np.ndarray
    columns: np.ndarray
    observed: np.ndarray
    gram: np.ndarray
    moments: np.ndarray


def _observed(problem: Problem) -> np.ndarray:
    """(N,) y: the residual without what the added effects make of it."""
    if problem.retained is None:
        return problem.residual
    return problem.retained.added.y


def _coefficients(problem: Problem) -> np.ndarray:
    """(R + A,) of `fit_columns`, in the fit whose hat matrix is that of `hat_mixing`."""
    if problem.retained is None:
        return problem.basis.T @ problem.residual
    mixing = problem.retained.hat_mixing
    score = problem.retained.added.score
    of_baseline = np.zeros(problem.basis.shape[1])
    return np.concatenate([of_baseline, mixing @ (mixing.T @ score)])


def fitted_residual(problem: Problem) -> np.ndarray:
    """(N,) y - B B' y, the residual of the fit whose hat matrix is that of `hat_mixing`."""
    return _observed(problem) - np.hstack(problem.fit_columns) @ _coefficients(problem)


def _block(problem: Problem, rows: np.ndarray) -> Block:
    """The block of some rows (N,) bool; made once a solution."""

    def make():
        columns = np.concatenate([part[rows] for part in problem.fit_columns], 1)
        observed = _observed(problem)[rows]
        return Block(
            np.flatnonzero(rows), columns, observed, columns.T @ columns, columns.T @ observed
        )

    return cached(problem.cache, (BLOCK, len(problem.fit_columns), rows.tobytes()), make)


def _information(problem: Problem, block: Block) -> np.ndarray:
    """(P, P) B_b'B_b of a block: its share of the information on each direction; made once a problem.

    The first columns of `hat_mixing` are those of the baseline's basis, as they are.
    """

    def make():
        size = problem.basis.shape[1]
        mixing = problem.hat_mixing[size:, size:]
        cross_terms = block.gram[:size, size:] @ mixing
        corner = mixing.T @ block.gram[size:, size:] @ mixing
        return np.block([[block.gram[:size, :size], cross_terms], [cross_terms.T, corner]])

    return cached(problem.information_of_blocks, block.rows.tobytes(), make)


def block_shares(problem: Problem, rows: np.ndarray) -> np.ndarray:
    """(P,) shares of the directions of a fit that the rows (N,) bool of a block alone determine, ascending."""
    return symmetric_eigenvalues(_information(problem, _block(problem, rows)))


def left_out_rows(
    problem: Problem, fold: np.ndarray, only: int | None = None, scored: bool = False
) -> np.ndarray:
    """(N,) residual (mm, rad, px) of each row when its sample's block is left out of the linearised fit.

    fold (n,) int: the block of each sample; only: the one block that is asked for; nan elsewhere then.
    scored: e has the covariance V = (I - B_b B_b')^-1, since its rows share what the other blocks leave uncertain. Its
    logarithmic score, e' V^-1 e + log det V, is made of V^-1/2 e = (I - B_b B_b')^-1/2 r and equal parts of log det V.
    """
    mixing, fitted = problem.hat_mixing, _coefficients(problem)
    out = np.full(len(problem.residual), np.nan)
    block_of_row = fold[problem.sample]
    leave_out = _scored_block if scored else _without_block
    for k in np.unique(fold) if only is None else (only,):
        block = _block(problem, block_of_row == k)
        inner = _information(problem, block)
        prediction = block.gram @ fitted
        score = mixing.T @ (block.moments - prediction)
        change, log_determinant = leave_out(inner, score)
        coefficients = fitted - mixing @ change
        errors = block.observed - block.columns @ coefficients
        if scored:
            errors = np.sqrt(errors**2 + log_determinant / len(errors))
        out[block.rows] = errors
    return out * problem.units


def decorrelated(problem: Problem, fold: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """(E, N) V^-1/2 e block by block, of E held-out errors e (E, N) in the units of `left_out_rows`; nan stays.

    V = (I - B_b B_b')^-1 is the covariance, over that of the noise, of the errors of a block that this problem
    predicts: a direction that the other blocks leave uncertain counts by as much less. V^-1/2 B_b u = sqrt(1 - v) B_b u
    for an eigenvector u of B_b'B_b with the eigenvalue v, so that V^-1/2 e = e - B_b f(B_b'B_b) B_b'e with f as
    `_shrinkage`.
    """
    mixing = problem.hat_mixing
    block_of_row = fold[problem.sample]
    out = errors / problem.units
    has_errors = np.isfinite(errors).any(0)
    for k in np.unique(block_of_row[has_errors]):
        block = _block(problem, block_of_row == k)
        matrix = _information(problem, block)
        # of a few errors, not of all directions: the products with these take as long as the eigenvectors
        by_column = out[:, block.rows] @ block.columns
        projected = by_column @ mixing
        change = function_times(_shrinkage, matrix, projected.T).T
        out[:, block.rows] -= change @ mixing.T @ block.columns.T
    problem.information_of_blocks.clear()  # megabytes a block, which nothing asks for again
    return out * problem.units


def _shrinkage(values: np.ndarray) -> np.ndarray:
    """(1 - sqrt(1 - v)) / v of eigenvalues v (E,), in the form that does not cancel at small ones."""
    return 1 / (1 + np.sqrt(np.clip(1 - values, NEGLIGIBLE_SHARE, 1.0)))


def variance_factor(problem: Problem, fold: np.ndarray, inliers: np.ndarray) -> float:
    """Expected mean square of a held-out position residual of a right model over the variance of its noise.

    A left-out block has the covariance sigma^2 (I + J C J') = sigma^2 (I - B_b B_b')^-1: noise, and the uncertainty C
    of parameters that the other blocks determine (Cook & Weisberg, sec. 3.6, as in `left_out_rows`). Mean over whitened
    rows of the inliers (n,) bool; fold (n,) int.

    Parameters that a block alone determines, as the pose of a board that only its own images show, follow the noise of
    the block: `left_out_rows` leaves them fitted, so that they lower the mean square.
    """
    mixing = problem.hat_mixing
    block_of_row = fold[problem.sample]
    counted = inliers[problem.sample]
    if problem.rotation is not None:
        counted = counted & ~problem.rotation
    if not counted.any():
        return 1.0
    added = 0.0
    for k in np.unique(fold[inliers]):
        block = _block(problem, block_of_row == k)
        matrix = _information(problem, block)
        values, vectors = symmetric_eigen(matrix)
        columns = block.columns[counted[block.rows]] @ mixing
        gram = columns.T @ columns
        shares = np.einsum("ij,ik,kj->j", vectors, gram, vectors)
        added += float((shares * _added_square(values)).sum())
    return 1.0 + added / int(counted.sum())


def _added_square(shares: np.ndarray) -> np.ndarray:
    """(P,) what directions add to the expected square of their held-out error, over the share v that the block has.

    The residual has the variance 1 - v, and the held-out error is 1 / (1 - v) times it: together 1 + v / (1 - v). Where
    the others determine less than `NEGLIGIBLE_SHARE` of a direction, `_without_block` multiplies by a limit instead.
    """
    remaining = np.clip(1 - shares, 0.0, 1.0)
    growth = 1 + shares / NEGLIGIBLE_SHARE
    of_block_alone = remaining * growth**2 - 1
    return np.where(
        remaining < NEGLIGIBLE_SHARE, of_block_alone, 1 / np.maximum(remaining, NEGLIGIBLE_SHARE)
    )


def _without_block(inner: np.ndarray, score: np.ndarray) -> tuple[np.ndarray, float]:
    """(P,) (I - B_b'B_b)^-1 B_b'e, of inner products (P, P) and score (P,), and no log determinant.

    A direction that the block alone determines counts as if the others determined `NEGLIGIBLE_SHARE` of it.
    """
    identity = np.eye(len(inner))
    try:
        np.linalg.cholesky((1 - NEGLIGIBLE_SHARE) * identity - inner)
        factor = np.linalg.cholesky(identity - inner)
    except np.linalg.LinAlgError:
        values, vectors = symmetric_eigen(inner)
        complement = np.maximum(1 - values, NEGLIGIBLE_SHARE)
        return vectors @ (vectors.T @ score / complement), 0.0
    return cho_solve((factor, True), score, check_finite=False), 0.0


def _scored_block(inner: np.ndarray, score: np.ndarray) -> tuple[np.ndarray, float]:
    """(P,) what V^-1/2 e has more than the residual, by directions, and log det V; see `left_out_rows`."""
    values, vectors = symmetric_eigen(inner)
    complement = np.clip(1 - values, NEGLIGIBLE_SHARE, 1.0)
    root_growth = 1 / np.sqrt(complement) - 1
    growth = root_growth / np.maximum(values, NEGLIGIBLE_SHARE)
    coordinates = vectors.T @ score
    log_determinant = float(-np.log(complement).sum())
    return vectors @ (growth * coordinates), log_determinant
