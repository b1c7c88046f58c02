"""Functions of a symmetric matrix times a few vectors, without its eigenvectors."""

from collections.abc import Callable

import numpy as np

from workbench.core.least_squares.linear_algebra import check_finite, symmetric_eigen

_SMALL = 64
"""Columns up to which the eigenvectors of a matrix take no longer than its products with vectors."""
_FIRST, _INTERVAL = 40, 16
"""Products after which the result is computed first, and again each so many."""
_SAME = 1e-6
"""Change of the result, relative to the vector, below which it has converged."""
_BREAKDOWN = 1e-12
"""Length of a next direction, relative to the norm of the matrix, below which the directions span all that matters."""

Function = Callable[[np.ndarray], np.ndarray]


def function_times(function: Function, matrix: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """f(A) X (F, K) for a symmetric matrix A (F, F) and vectors X (F, K); function: of eigenvalues (E,).

    By Lanczos's method, all vectors in step: Higham, Functions of Matrices (2008), sec. 13.2. Without
    reorthogonalisation, which delays it and does not make it less accurate: Druskin & Knizhnerman, SIAM J. Matrix Anal.
    Appl. 12 (1991) 239. It converges the sooner the smoother f is between the eigenvalues; small matrices, and those of
    which it has not converged after as many products as columns, go by their eigenvectors. Raises InputError where an
    entry is not finite.
    """
    check_finite(matrix, vectors)
    found = None
    if len(matrix) > _SMALL:
        found = _by_lanczos(function, matrix, vectors)
    if found is None:
        values, directions = symmetric_eigen(matrix)
        found = directions @ (function(values)[:, None] * (directions.T @ vectors))
    return found


def _by_lanczos(function: Function, matrix: np.ndarray, vectors: np.ndarray) -> np.ndarray | None:
    """f(A) X (F, K) of vectors X (F, K); None where it does not converge."""
    lengths = np.sqrt((vectors**2).sum(0))
    size, count = vectors.shape
    basis = [vectors.T * _reciprocals(lengths)[:, None]]  # (K, F) each
    diagonal, off_diagonal = np.zeros((2, size, count))
    before = np.zeros((0, count))
    for k, last in enumerate(basis):
        product = last @ matrix
        diagonal[k] = np.einsum("cf,cf->c", last, product)
        product -= diagonal[k][:, None] * last
        if k:
            product -= off_diagonal[k - 1][:, None] * basis[k - 1]
        off_diagonal[k] = np.sqrt(np.einsum("cf,cf->c", product, product))
        # nothing is left of a vector whose directions span all that A makes of it
        off_diagonal[k][off_diagonal[k] <= _BREAKDOWN * np.abs(diagonal[k])] = 0.0
        is_complete = not off_diagonal[k].any()
        if is_complete or k + 1 >= _FIRST and (k + 1 - _FIRST) % _INTERVAL == 0:
            now = _first_columns(function, diagonal[: k + 1], off_diagonal[:k])
            if is_complete or _is_same(before, now):
                return lengths * np.einsum("kc,kcf->fc", now, np.array(basis))
            before = now
        if k + 1 < size:
            basis.append(product * _reciprocals(off_diagonal[k])[:, None])
    return None


def _reciprocals(lengths: np.ndarray) -> np.ndarray:
    """(K,) 1 / lengths, 0 where a length is 0."""
    return np.where(lengths > 0, 1 / np.where(lengths > 0, lengths, 1.0), 0.0)


def _first_columns(function: Function, diagonal: np.ndarray, off_diagonal: np.ndarray):
    """(k, K) first columns of f of K tridiagonal matrices: diagonal (k, K), off_diagonal (k - 1, K)."""
    out = np.empty_like(diagonal)
    for c in range(diagonal.shape[1]):
        values, directions = symmetric_eigen(_tridiagonal(diagonal[:, c], off_diagonal[:, c]))
        out[:, c] = (directions * function(values)) @ directions[0]
    return out


def _tridiagonal(diagonal: np.ndarray, off_diagonal: np.ndarray) -> np.ndarray:
    """(k, k) symmetric matrix."""
    return np.diag(diagonal) + np.diag(off_diagonal, 1) + np.diag(off_diagonal, -1)


def _is_same(before: np.ndarray, now: np.ndarray) -> bool:
    """Whether fewer coordinates (j, K) are those of now (k, K), nearly."""
    change = now.copy()
    change[: len(before)] -= before
    return bool((change**2).sum(0).max() <= _SAME**2 * (now**2).sum(0).max())
