"""Linear algebra that does not raise on rank-deficient, badly scaled or constant data.

Every function first brings the matrix to unit diagonal or unit largest entry. Symmetric positive semi-definite
matrices are factorised by Cholesky; where rounding leaves no positive pivot, the eigen-decomposition decides
which directions are determined. A direction counts as undetermined where its eigenvalue, at unit diagonal, is
below `RANK_TOLERANCE` times the size of the matrix: that is what rounding of the entries alone can make of zero.

Unit diagonal is within a factor F of the best scaling of an F x F matrix: van der Sluis, Numer. Math. 14 (1969) 14;
Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed. (2002), sections 7.3, 10.1 and 19.4.
"""

from collections.abc import Callable

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from workbench.core.errors import InputError

RANK_TOLERANCE = 1e-14
"""Relative size, per row of a matrix, of what rounding leaves of zero."""
_SAME_VARIANCE = 1e-3
"""Relative error of a variance that rounding may cause before a slower, more accurate factorisation is used."""
_ROOT = 1e-12
NOT_FINITE = (
    "the equations of this solve hold numbers that are not finite, so that nothing can be computed from them; check "
    "the units of coordinates and joint readings, and the stated sigma, for numbers that are far too large or too small"
)


def all_finite(*arrays: np.ndarray) -> bool:
    """Whether no entry of any array is nan or infinite."""
    return all(np.isfinite(array).all() for array in arrays)


def check_finite(*arrays: np.ndarray) -> None:
    """Raise InputError, as one sentence, where an array holds nan or infinity."""
    if not all_finite(*arrays):
        raise InputError(NOT_FINITE)


def diagonal_scale(matrix: np.ndarray) -> np.ndarray:
    """(..., F) root of the diagonal of symmetric matrices (..., F, F), 1 where the diagonal is not positive."""
    diagonal = np.diagonal(matrix, axis1=-2, axis2=-1)
    return np.sqrt(np.where(diagonal > 0, diagonal, 1.0))


def symmetric_eigen(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (..., F) ascending and eigenvectors (..., F, F) in columns of symmetric matrices (..., F, F).

    Scaled to largest entry 1, so that nothing over- or underflows; the slower QR algorithm takes over where divide
    and conquer does not converge. Raises InputError where an entry is not finite.
    """
    matrix = np.asarray(matrix, float)
    check_finite(matrix)
    largest = np.abs(matrix).max(axis=(-2, -1), initial=0.0)
    size = np.where(largest > 0, largest, 1.0)
    scaled = matrix / size[..., None, None]
    try:
        values, vectors = np.linalg.eigh(scaled)
    except np.linalg.LinAlgError:
        values, vectors = _eigen_one_by_one(scaled)
    return values * size[..., None], vectors


def _eigen_one_by_one(matrices):
    """The same by the QR algorithm (LAPACK syev), which converges where divide and conquer does not."""
    flat = matrices.reshape(-1, *matrices.shape[-2:])
    pairs = [linalg.eigh((matrix + matrix.T) / 2, driver="ev") for matrix in flat]
    values, vectors = (_stacked(factors, matrices.shape[:-2]) for factors in zip(*pairs))
    return values, vectors


def symmetric_eigenvalues(matrix: np.ndarray) -> np.ndarray:
    """(..., F) ascending; see `symmetric_eigen`."""
    return symmetric_eigen(matrix)[0]


def thin_svd(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """u (..., m, k), singular values (..., k) descending and vt (..., k, n) of matrices (..., m, n), k = min(m, n).

    Scaled to largest entry 1; the slower QR iteration takes over where divide and conquer does not converge.
    Raises InputError where an entry is not finite.
    """
    matrix = np.asarray(matrix, float)
    check_finite(matrix)
    largest = np.abs(matrix).max(axis=(-2, -1), initial=0.0)
    size = np.where(largest > 0, largest, 1.0)
    scaled = matrix / size[..., None, None]
    try:
        u, values, vt = np.linalg.svd(scaled, full_matrices=False)
    except np.linalg.LinAlgError:
        u, values, vt = _svd_one_by_one(scaled)
    return u, values * size[..., None], vt


def _svd_one_by_one(matrices):
    """The same by QR iteration (LAPACK gesvd), which converges where divide and conquer does not."""
    flat = matrices.reshape(-1, *matrices.shape[-2:])
    decompositions = [
        linalg.svd(matrix, full_matrices=False, lapack_driver="gesvd") for matrix in flat
    ]
    return tuple(_stacked(factors, matrices.shape[:-2]) for factors in zip(*decompositions))


def _stacked(factors, shape: tuple[int, ...]) -> np.ndarray:
    """Factors of single matrices as one array (*shape, ...)."""
    return np.stack(factors).reshape(*shape, *factors[0].shape)


def solve_positive(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """x (..., F, K) or (F,) with matrix x = right, for symmetric positive semi-definite matrices (..., F, F).

    Where the matrix is singular to rounding, x is the solution of least norm at unit diagonal: nothing moves along
    directions that the matrix does not determine. right (..., F, K), or (F,) for one matrix. Raises InputError
    where an entry is not finite.
    """
    matrix = np.asarray(matrix, float)
    right = np.asarray(right, float)
    if right.ndim == 1:
        return solve_positive(matrix, right[:, None])[:, 0]
    check_finite(matrix, right)
    if not right.size:
        return np.zeros_like(right)
    size = diagonal_scale(matrix)
    unit = matrix / (size[..., :, None] * size[..., None, :])
    scaled = right / size[..., None]
    return _solve_unit_diagonal(unit, scaled) / size[..., None]


def _solve_unit_diagonal(matrix, right):
    lower = _cholesky(matrix)
    if lower is None:
        return _solve_by_eigen(matrix, right)
    if matrix.ndim == 2:
        return linalg.cho_solve((lower, True), right, check_finite=False)
    return np.linalg.solve(matrix, right)


def _cholesky(matrix):
    """Lower factor of matrices (..., F, F) of unit diagonal, None where one of them is singular to rounding."""
    try:
        lower = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return None
    pivots = np.diagonal(lower, axis1=-2, axis2=-1)
    # a squared pivot is what is left of a column that those before it do not make
    if (pivots**2 > _cutoff(matrix)).all():
        return lower
    return None


def _solve_by_eigen(matrix, right):
    values, vectors = symmetric_eigen(matrix)
    inverse = _reciprocals(values, _cutoff(matrix))
    return vectors @ (inverse[..., None] * (np.swapaxes(vectors, -1, -2) @ right))


def _cutoff(matrix):
    """Eigenvalue below which a matrix of unit diagonal says nothing about a direction."""
    return RANK_TOLERANCE * max(matrix.shape[-1], 1)


def _reciprocals(values, cutoff):
    """1 / values, 0 where a value is not above `cutoff`."""
    is_above = values > cutoff
    return np.where(is_above, 1 / np.where(is_above, values, 1.0), 0.0)


def inverse_positive(matrix: np.ndarray) -> np.ndarray:
    """(..., F, F) covariance from information matrices, symmetric positive semi-definite.

    Where a matrix is singular to rounding, its eigenvalues at unit diagonal are raised to what rounding can make of
    zero: what is undetermined gets a very large variance, and not the 0 of a pseudo-inverse. With a known prior,
    `covariance_of` says how large. Raises InputError where an entry is not finite.
    """
    check_finite(matrix)
    if not matrix.size:
        return np.zeros_like(matrix)
    size = diagonal_scale(matrix)
    outer = size[..., :, None] * size[..., None, :]
    unit = matrix / outer
    lower = _cholesky(unit)
    if lower is not None:
        inverse = _inverse_of(unit, lower)
    else:
        values, vectors = symmetric_eigen(unit)
        inverse = (vectors / np.maximum(values, _cutoff(unit))[..., None, :]) @ np.swapaxes(
            vectors, -1, -2
        )
    return (inverse + np.swapaxes(inverse, -1, -2)) / 2 / outer


def pseudo_inverse(matrix: np.ndarray, tolerance: float = 1e-13) -> np.ndarray:
    """(F, F) Moore-Penrose inverse, at unit diagonal, of a symmetric positive semi-definite matrix (F, F).

    tolerance: eigenvalue at unit diagonal below which a direction counts as not in the matrix at all.
    """
    size = diagonal_scale(matrix)
    values, vectors = symmetric_eigen(matrix / np.outer(size, size))
    inverse = (vectors * _reciprocals(values, tolerance)) @ vectors.T
    return inverse / np.outer(size, size)


def covariance_of(information: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """(..., F, F) inverse of information + diag(prior), accurate where the information is singular and far larger.

    information (..., F, F): of the data, symmetric positive semi-definite up to rounding. prior (F,): precisions, each
    above 0, in units in which they are comparable. Along a direction that the data do not determine the result has
    the variance that the prior alone leaves, and not what rounding of the information would make of it.
    Raises InputError where an entry is not finite.
    """
    prior = np.asarray(prior, float)
    check_finite(information, prior)
    if not information.size:
        return np.zeros_like(information)
    total = (information + np.swapaxes(information, -1, -2)) / 2 + np.diag(prior)
    size = diagonal_scale(total)
    outer = size[..., :, None] * size[..., None, :]
    lower = _accurate_factor(total / outer, prior / size**2)
    if lower is not None:
        return _inverse_of(total / outer, lower) / outer
    flat = information.reshape(-1, *information.shape[-2:])
    return np.stack([_covariance_by_rows(matrix, prior) for matrix in flat]).reshape(
        information.shape
    )


def posterior_of(
    information: np.ndarray, prior: np.ndarray, right: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (F,) and variances (F,) of the posterior with precision information + diag(prior), mean times it = right.

    information (F, F), prior (F,): as of `covariance_of`, whose other entries are not computed; right (F,).
    """
    check_finite(information, prior, right)
    total = (information + information.T) / 2 + np.diag(prior)
    size = diagonal_scale(total)
    lower = _accurate_factor(total / np.outer(size, size), prior / size**2)
    if lower is None or not len(size):
        covariance = covariance_of(information, prior)
        return covariance @ right, np.diag(covariance).copy()
    upper = lapack.dtrtri(lower.T, lower=0)[0]
    mean = linalg.cho_solve((lower, True), right / size, check_finite=False) / size
    variances = np.einsum("ij,ij->i", upper, upper) / size**2
    return mean, variances


def _accurate_factor(total: np.ndarray, prior: np.ndarray) -> np.ndarray | None:
    """Lower Cholesky factor of total (..., F, F), of unit diagonal; None where rounding changes variances too much.

    Rounding is small against the prior (..., F), or against the squared pivots: what is left of a column that those
    before it do not make is the information that its variance comes from.
    """
    lower = _cholesky(total)
    if lower is None:
        return None
    rounding = _cutoff(total)
    pivots = np.diagonal(lower, axis1=-2, axis2=-1)
    is_small = (rounding < _SAME_VARIANCE * prior).all()
    if is_small or (rounding < _SAME_VARIANCE * pivots**2).all():
        return lower
    return None


def _inverse_of(matrix: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """(..., F, F) symmetric inverse of matrices (..., F, F) with lower Cholesky factors `lower`."""
    if matrix.ndim > 2:
        inverse = np.linalg.inv(matrix)
        return (inverse + np.swapaxes(inverse, -1, -2)) / 2
    half = lapack.dpotri(lower.T, lower=0)[0]  # the upper triangle; zeros below
    inverse = half + half.T
    inverse[np.diag_indices_from(inverse)] /= 2
    return inverse


def _covariance_by_rows(information, prior):
    """The same from square roots: (R^T R)^-1 with R the triangle of the stacked rows of data and prior.

    Sorted rows and pivoted columns preserve small rows next to large ones: Cox & Higham, BIT 38 (1998) 34.
    """
    size = diagonal_scale(information)
    values, vectors = symmetric_eigen(information / np.outer(size, size))
    is_retained = values > _cutoff(information)
    data = np.sqrt(values[is_retained])[:, None] * vectors[:, is_retained].T * size
    rows = np.concatenate([data, np.diag(np.sqrt(prior))])
    rows = rows[np.argsort(-np.abs(rows).max(axis=1), kind="stable")]
    triangle, order = linalg.qr(rows, mode="r", pivoting=True)
    triangle = triangle[: len(prior)]
    unit = np.abs(np.diag(triangle))
    inverse = linalg.solve_triangular(
        triangle / unit[:, None], np.diag(1 / unit), check_finite=False
    )
    covariance = np.empty_like(information)
    covariance[np.ix_(order, order)] = inverse @ inverse.T
    return covariance


def least_squares(rows: np.ndarray, right: np.ndarray, tolerance: float = 1e-12) -> np.ndarray:
    """x (F,) or (F, K) of least norm, at columns of unit length, that minimises |rows x - right|.

    rows (m, F), right (m,) or (m, K). tolerance: singular value, relative to the largest, below which a direction
    is left alone. Raises InputError where an entry is not finite.
    """
    check_finite(rows, right)
    largest = np.abs(rows).max(axis=0, initial=0.0)
    largest = np.where(largest > 0, largest, 1.0)
    length = largest * np.maximum(np.sqrt(((rows / largest) ** 2).sum(0)), 1.0)
    u, values, vt = thin_svd(rows / length)
    inverse = _reciprocals(values, tolerance * values.max(initial=0.0))
    shape = (-1, *(1,) * (right.ndim - 1))
    found = vt.T @ (inverse.reshape(shape) * (u.T @ right))
    return found / length.reshape(shape)


def root_between(function: Callable[[float], float], low: float, high: float) -> float:
    """Find the sign change of a function between `low` and `high`; without one, the end with the smaller value."""
    at_low = function(low)
    at_high = function(high)
    if not (np.isfinite(at_low) and np.isfinite(at_high) and at_low * at_high < 0):
        if abs(at_low) <= abs(at_high) or not np.isfinite(at_high):
            return low
        return high
    return _bracketed_root(function, (low, at_low), (high, at_high))


def _bracketed_root(function, last, other) -> float:
    """Root between two places, (x, value) each of another sign, to `_ROOT` of itself: Chandrupatla's method.

    Inverse quadratic interpolation where it is safe, else bisection: Chandrupatla, Adv. Eng. Software 28 (1997) 145.
    Loading scipy.optimize for its root finders takes longer than all roots of a command.
    """
    share = 0.5
    for _ in range(200):
        x = last[0] + share * (other[0] - last[0])
        new = (x, function(x))
        if new[1] * last[1] > 0:
            third, last = last, new
        else:
            third, other, last = other, last, new
        best = min(last, other, key=lambda place: abs(place[1]))
        tolerance = (_ROOT * abs(best[0]) + 1e-300) / abs(other[0] - last[0])
        if best[1] == 0 or tolerance > 0.5:
            break
        share = min(max(_interpolated(last, other, third), tolerance), 1 - tolerance)
    return float(best[0])


def _interpolated(last, other, third) -> float:
    """Share of the way from `last` to `other`: where the inverse parabola through three places is 0; half where it is
    not monotonous between them."""
    place = (last[0] - other[0]) / (third[0] - other[0])
    value = (last[1] - other[1]) / (third[1] - other[1])
    if not (value**2 < place and (1 - value) ** 2 < 1 - place):
        return 0.5
    first = last[1] / (other[1] - last[1]) * third[1] / (other[1] - third[1])
    ratio = (third[0] - last[0]) / (other[0] - last[0])
    return first + ratio * last[1] / (third[1] - last[1]) * other[1] / (third[1] - other[1])
