"""Minimal detectable and minimal separable size of each candidate on these data.

Both follow from the projected columns alone, before any effect is looked for. With a signature of length d sigmas
orthogonal to the baseline, the fall of chi-square is a non-central chi-square with d^2, so that

- it is *visible* with 95 % power where P(chi'^2_P(d^2) > threshold) = 0.95, the threshold being that of a family of
  all candidates together (Sidak, J. Am. Stat. Assoc. 62 (1967) 626);
- it is *separable* from an alternative with probability 0.95, at a posterior of 0.95, where the part that that cannot
  make, of length d, gives a log-likelihood ratio N(d^2/2, d^2) above log 19 in 95 % of all cases. That is d = 4.58.

The minimal detectable and minimal identifiable bias of geodesy: Teunissen, J. Geod. 92 (2018) 59.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from workbench.core.least_squares.linear_algebra import symmetric_eigen
from workbench.diagnosis.linear.candidates import Candidate
from workbench.diagnosis.linear.problem import Problem

POWER = 0.95
FAMILY = 0.01
_DRAWS = 24
_BROAD = 10.0  # typical sizes that an alternative may well have; one that needs a thousand of them is no alternative
_NOTHING = (
    1e-9  # of a column's own squared length: what rounding leaves of one that the baseline makes
)


@dataclass(frozen=True)
class DetectableBias:
    """The smallest size of one candidate at its place.

    `size`: RMS displacement of the measured point (mm, or px) that it causes, and `orthogonal_size` its part that is
    orthogonal to the fitted baseline; `parameter`, `unit`: the same size in the parameter's own unit, of several
    parameters their root mean square. `orthogonal_share`: share of the mean square that is orthogonal to the baseline.
    `alternative` is the candidate that it is most confounded with, `separable` the size from which the two
    are distinguishable.
    None: at no size (the baseline makes all of it; the alternative makes the same).
    """

    effect: str
    where: str
    label: str
    size: float | None
    orthogonal_size: float | None
    orthogonal_share: float
    parameter: float | None
    unit: str
    separable: float | None
    separable_parameter: float | None
    alternative: str
    alternative_where: str


def minimal_detectable_biases(
    problem: Problem, sigma: np.ndarray, units: Callable[[Candidate], Sequence[str]]
) -> list[DetectableBias]:
    """The smallest visible and the smallest separable size of every candidate, in their order.

    problem: of the baseline. sigma (N,): 1 sigma of each coordinate (mm, px), scaled to the noise that is there, over
    the square root of the sample's weight; columns times sigma are displacements. One direction in several
    parameters is as likely as another of the same length in typical sizes: sizes are medians over such directions.
    units: of a candidate's parameters.
    """
    all_candidates = problem.candidates
    if not all_candidates:
        return []
    table = _Table(problem, sigma, all_candidates)
    seen = np.sqrt(_threshold([c.columns.shape[1] for c in all_candidates], len(all_candidates)))
    separability, alternative = table.separable_lengths()
    return [
        _row(table, k, seen[k], separability[k], int(alternative[k]), units(all_candidates[k]))
        for k in range(len(all_candidates))
    ]


class _Table:
    """Gram matrices of all candidates' columns, scaled by typical sizes, and directions drawn in them."""

    def __init__(self, problem, sigma, all_candidates):
        self.candidates = all_candidates
        typical = np.concatenate([c.typical for c in all_candidates])
        columns = np.concatenate([c.columns for c in all_candidates], axis=1) * typical
        orthogonal = problem.orthogonalise(columns)
        self.gram, total = orthogonal.T @ orthogonal, columns.T @ columns
        for table in (columns, orthogonal):  # in place: there are hundreds of megabytes of columns
            table *= sigma[:, None]
        self.first = np.concatenate([[0], np.cumsum([c.columns.shape[1] for c in all_candidates])])
        self.draws = _directions(self.first)
        self.length = self._sizes(self.gram)
        sizes = self._sizes(columns.T @ columns)
        self.raw = sizes / np.sqrt(problem.n)
        self.left = self._sizes(orthogonal.T @ orthogonal) / np.sqrt(problem.n)
        self.whole = self._sizes(total)
        self.parameter = self._sizes(
            np.diag(typical**2 / np.repeat(np.diff(self.first), np.diff(self.first)))
        )

    def _sizes(self, gram):
        """(C, D) length of each candidate's drawn directions under a Gram matrix."""
        spread = self._block_products(gram)
        return np.sqrt(np.maximum(np.add.reduceat(self.draws * spread, self.first[:-1]), 0))

    def _block_products(self, gram):
        """(T, D) the block-diagonal part of a Gram matrix times the draws."""
        out = np.empty_like(self.draws)
        for low, high in zip(self.first, self.first[1:]):
            out[low:high] = gram[low:high, low:high] @ self.draws[low:high]
        return out

    def separable_lengths(self):
        """(C, D) the least length that is left of each candidate when one other takes what it can, and (C,) which."""
        min_length = np.full_like(self.length, np.inf)
        alternative = np.full(len(self.candidates), -1)
        middle = np.full(len(self.candidates), np.inf)
        for k, other in enumerate(self.candidates):
            remaining_length = np.sqrt(np.maximum(self.length**2 - self._made_by(k), 0))
            share = np.median(remaining_length / np.maximum(self.length, 1e-300), axis=1)
            share[[i for i, c in enumerate(self.candidates) if c.family == other.family]] = np.inf
            closer = share < middle
            middle[closer], min_length[closer], alternative[closer] = (
                share[closer],
                remaining_length[closer],
                k,
            )
        return min_length, alternative

    def _made_by(self, k):
        """(C, D) squared length of the part of each candidate's directions that candidate k makes at a likely size."""
        columns_of_effect = slice(self.first[k], self.first[k + 1])
        values, vectors = symmetric_eigen(self.gram[columns_of_effect, columns_of_effect])
        length = np.sqrt(np.maximum(values, 0) + _BROAD**-2)
        orthonormal = (vectors / length).T
        shared = orthonormal @ self.gram[columns_of_effect]
        drawn = shared[:, :, None] * self.draws
        sums = np.add.reduceat(drawn, self.first[:-1], axis=1)
        return (sums**2).sum(0)


def _directions(first):
    """(T, D) directions of length 1 within each candidate's parameters, in typical sizes."""
    draws = np.random.default_rng(0).normal(size=(first[-1], _DRAWS))
    length = np.sqrt(np.add.reduceat(draws**2, first[:-1]))
    return draws / np.repeat(length, np.diff(first), axis=0)


def _threshold(columns, count):
    """(C,) squared length d^2 that is seen with `POWER` at a false-alarm rate of `FAMILY` for all together."""
    from scipy.optimize import brentq
    from scipy.stats import chi2, ncx2

    level = 1 - (1 - FAMILY) ** (1 / count)
    needed = {
        p: brentq(lambda d, p=p: ncx2.sf(chi2.isf(level, p), p, d) - POWER, 1e-3, 1e3)
        for p in set(columns)
    }
    return np.array([needed[p] for p in columns])


def separable_distance() -> float:
    """d with P(N(d^2/2, d^2) > log(POWER / (1 - POWER))) = POWER, in sigmas."""
    from scipy.stats import norm

    z = norm.isf(1 - POWER)
    odds = np.log(POWER / (1 - POWER))
    return float(z + np.sqrt(z**2 + 2 * odds))


def _row(table: _Table, k, seen, separability, alternative, units) -> DetectableBias:
    candidate = table.candidates[k]
    orthogonal_share = float(
        np.median(table.length[k] ** 2 / np.maximum(table.whole[k] ** 2, 1e-300))
    )
    unit = units[0] if len(set(units)) == 1 else ""
    length = (
        table.length[k] if orthogonal_share > _NOTHING else np.full_like(table.length[k], np.nan)
    )  # nothing is seen of it
    median_share = _median(seen / length)
    distinct = separability > _NOTHING * table.length[k]
    ratio = np.divide(
        table.length[k], separability, out=np.full_like(separability, np.inf), where=distinct
    )
    smallest = np.maximum(seen, separable_distance() * ratio)
    same = alternative < 0 or np.median(separability / np.maximum(table.length[k], 1e-300)) < 1e-4
    separable_size = None if same else _median(smallest / length)
    other = table.candidates[alternative] if alternative >= 0 else None
    raw, remaining_median, explained_median = (
        float(np.median(size[k])) for size in (table.raw, table.left, table.parameter)
    )
    return DetectableBias(
        candidate.effect,
        candidate.where,
        candidate.label,
        None if median_share is None else median_share * raw,
        None if median_share is None else median_share * remaining_median,
        orthogonal_share,
        None if median_share is None or not unit else median_share * explained_median,
        unit,
        None if separable_size is None else separable_size * raw,
        None if separable_size is None or not unit else separable_size * explained_median,
        other.effect if other else "",
        other.where if other else "",
    )


def _median(values) -> float | None:
    middle = float(np.median(values))
    return middle if np.isfinite(middle) else None
