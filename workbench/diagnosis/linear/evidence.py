"""Evidence of hypotheses on what is missing, after the baseline is projected out of everything.

A hypothesis is a set of P columns X that are added to the baseline's. With y = M r and Z = M X (M = I - Q Q'),
coefficients b ~ N(0, sigma^2 s^2 diag(typical^2)) and sigma^2 ~ inverse gamma, the marginal
likelihood is Student's and closed but for the size s, which is summed over a logarithmic grid:

    log E(s) = -1/2 log|I + s^2 D Z'Z D| - (nu + nu0)/2 log(1 - q(s) / (y'y + nu0)),
    q(s) = y'Z D (Z'Z-in-D + s^-2 I)^-1 D Z'y,   D = diag(typical)

(Zellner 1971, An Introduction to Bayesian Inference in Econometrics, ch. 3; MacKay, Neural Comp. 4,
1992). All that is needed of the data are Z'Z (P x P) and Z'y (P): the moments. They come from sums
over the coordinates of a sample, so a family of a thousand change points costs one cumulative sum.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.special import betainc, logsumexp

from workbench.core.least_squares.linear_algebra import symmetric_eigen
from workbench.diagnosis.levels import CHUNK_SIZE, ROUNDING
from workbench.diagnosis.linear.candidates import Scan, step_function
from workbench.diagnosis.linear.design_effect import design_effect, remaining_residual
from workbench.diagnosis.linear.problem import Problem, cached

Linear = Callable[[np.ndarray], np.ndarray]
SIZES = np.geomspace(0.1, 100.0, 7)
"""Sizes of a disturbance in units of what is typical: from a tenth to a hundred times, in steps over which the
evidence of a size changes by less than it does from data to data."""
_FALLING = np.log(np.maximum(1.0, SIZES / 3.0))  # as likely up to three times typical, then 1/s
_LOG_PRIOR = -_FALLING - logsumexp(-_FALLING)
_ANCHOR = 4.0
"""Degrees of freedom that the stated sigma is worth: it may be wrong."""


@dataclass(frozen=True)
class Moments:
    """C hypotheses of P columns: `gram` (C, P, P) = Z'Z, `score` (C, P) = Z'y, `raw` (C,) largest |X|^2,
    all in typical sizes."""

    gram: np.ndarray
    score: np.ndarray
    raw: np.ndarray

    @classmethod
    def joined(cls, groups: "list[Moments]") -> "Moments":
        """Of several groups of hypotheses with equally many columns, as one."""
        arrays = ((part.gram, part.score, part.raw) for part in groups)
        columns = zip(*arrays)
        return cls(*map(np.concatenate, columns))


@dataclass(frozen=True)
class Scores:
    """C hypotheses judged: `evidence` (C,) log Bayes factor against nothing, `gain` (C,) fall of y'y at
    best, `rank` (C,), `p` (C,) of an F test, each by itself."""

    evidence: np.ndarray
    gain: np.ndarray
    rank: np.ndarray
    p: np.ndarray

    def row(self, i: int) -> tuple[float, float, float, int]:
        """Evidence, p-value, gain and rank of one hypothesis."""
        gain = float(self.gain[i])
        rank = int(self.rank[i])
        evidence = float(self.evidence[i])
        p = float(self.p[i])
        return evidence, p, gain, rank

    def part(self, chosen: slice) -> "Scores":
        """Those of some of the hypotheses."""
        evidence = self.evidence[chosen]
        gain = self.gain[chosen]
        return Scores(evidence, gain, self.rank[chosen], self.p[chosen])


class Projected:
    """A problem with its baseline projected out: y, y'y, the degrees left, and moments of hypotheses.

    Inner products of columns with one another, with y and with the columns of all added effects are made once a
    solution and kept with the problem (`Problem.known`). Conditional on any of these effects, moments follow by a Schur
    complement.
    """

    def __init__(self, problem: Problem, remainder: Problem | None = None):
        """remainder: the problem that keeps more effects, where more are fitted; its design effect counts."""
        self.problem, self.retained = problem, problem.retained
        self.y = remaining_residual(problem)
        self.design_effect = design_effect(problem if remainder is None else remainder)
        # a set of effects may spend all numbers of a fold: the residual is then zero, and so is all evidence
        self.yy = float(self.y @ self.y) / self.design_effect
        self.degrees = max(problem.degrees, 1) / self.design_effect
        self.cache = problem.cache

    def column_moments(self, columns: np.ndarray, name: tuple | None = None) -> Moments:
        """columns (C, N, P), already in typical sizes; `name`: of columns that are the problem's own."""

        def first():
            raw = np.einsum("cnp,cnq->cpq", columns, columns, optimize=True)
            return _without_projections(raw, _projections(self.problem.basis, columns)), np.einsum(
                "cpp->cp", raw
            ).max(1)

        def coupling():
            return np.einsum("cnp,n->cp", columns, self._y()), _projections(
                self._basis_of_effects(), columns
            )

        return self._conditional({} if name is None else self.cache, (name,), first, coupling)

    def _conditional(self, cache: dict, name: tuple, first, coupling) -> Moments:
        """Moments conditional on the retained effects, of columns that `cache` knows by `name`.

        first() gives gram (C, P, P) on the baseline and `raw` (C,); coupling() score (C, P) there and cross (C, P, W)
        with the basis of all effects. Where most of these are retained, moments conditional on all of them are made
        once, and corrected for the few directions that are not.
        """
        gram, largest = cached(cache, (*name, "gram"), first)
        score, cross = cached(cache, (*name, "added"), coupling)
        retained = self.retained
        if retained is None or not retained.mixing.shape[1]:
            return Moments(gram, score, largest)
        full_subspace = retained.added.full_subspace
        if 2 * retained.mixing.shape[1] < cross.shape[2]:
            projections = _product(cross, retained.within_whole)
            remaining = _without_projections(gram, projections)
            score_given_all = score - projections @ retained.score
            return Moments(remaining, score_given_all, largest)

        def given_all():
            return _without_projections(gram, cross), score - cross @ full_subspace.score

        remaining, remaining_score = cached(cache, (*name, "whole"), given_all)
        if retained.mixing.shape[1] < cross.shape[2]:
            omitted = retained.omitted
            projections = _product(cross, omitted)
            remaining = remaining + projections @ projections.swapaxes(1, 2)
            remaining_score = remaining_score + projections @ (omitted.T @ full_subspace.score)
        return Moments(remaining, remaining_score, largest)

    def _y(self) -> np.ndarray:
        """(N,) the residual, orthogonal to the baseline alone."""
        if self.retained is None:
            return self.y
        return self.retained.added.y

    def _basis_of_effects(self) -> np.ndarray:
        """(N, W) orthonormal basis of the columns of all added effects, orthogonal to the baseline."""
        if self.retained is None:
            return np.zeros((len(self.y), 0))
        return self.retained.added.basis

    def sample_sums(self, rows: np.ndarray, name: tuple) -> "SampleSums":
        """Sums over each sample's coordinates of rows (k, N) of the problem; `name` as of `SampleSums`."""
        return SampleSums(rows, self, name)

    def sums(self, values: np.ndarray) -> np.ndarray:
        """(E n, R) sums over each arm pose's coordinates of values (E N, R)."""
        return self._sum @ values

    @cached_property
    def _sum(self) -> csr_array:
        """(E n, E N) of ones, that sums over the coordinates of each arm pose."""
        problem = self.problem
        number = problem.ends.numbers(problem.sample)
        n = problem.ends.count * problem.n
        size = len(number)
        indices = (number, np.arange(size))
        return csr_array((np.ones(size), indices), shape=(n, size))

    def row_sums(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """(k, E n, R) sums over each arm pose's coordinates of rows (k, E N) times columns (E N, R)."""
        n = self.problem.n
        count = len(columns) // n
        if not self._is_even:
            return np.stack([self.sums(columns * row[:, None]) for row in rows])
        by_sample = columns.reshape(count, n, -1).swapaxes(0, 1)
        by_row = rows.reshape(-1, count, n).transpose(2, 0, 1)
        return (by_row @ by_sample).swapaxes(0, 1)

    @cached_property
    def _is_even(self) -> bool:
        """Whether every sample has the same components, so that its sums are one small product."""
        sample, n = self.problem.sample, self.problem.n
        is_single = self.problem.ends.count == 1 and len(sample) % n == 0
        return is_single and np.array_equal(sample, np.tile(np.arange(n), len(sample) // n))

    def score_hypotheses(self, moments: Moments) -> Scores:
        """Evidence, gain and p-value of each hypothesis, every coordinate counting for as much as it is worth."""
        arrays = (moments.gram, moments.score, moments.raw)
        scores = score_hypotheses(
            Moments(*(part / self.design_effect for part in arrays)), self.yy, self.degrees
        )
        return replace(scores, gain=scores.gain * self.design_effect)

    def score_groups(self, groups: list[Moments]) -> list[Scores]:
        """`score_hypotheses` of several groups of hypotheses, of all groups with equally many columns at once."""
        found: list = [None] * len(groups)
        widths = np.array([group.score.shape[1] for group in groups])
        for width in np.unique(widths):
            rows = np.flatnonzero(widths == width)
            members = [groups[i] for i in rows]
            moments = Moments.joined(members)
            scores = self.score_hypotheses(moments)
            counts = [len(groups[i].score) for i in rows]
            ends = np.cumsum(counts)
            for i, end in zip(rows, ends):
                first = end - len(groups[i].score)
                found[i] = scores.part(slice(first, end))
        return found


def _projections(basis: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(C, P, R) what a basis (N, R) makes of columns (C, N, P)."""
    return np.einsum("nr,cnp->cpr", basis, columns, optimize=True)


def _product(blocks: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(C, P, R) blocks (C, P, A) times a matrix (A, R), as one product: many small ones take far longer."""
    rows = blocks.reshape(-1, len(matrix))
    product = rows @ matrix
    return product.reshape(*blocks.shape[:2], matrix.shape[1])


def _without_projections(gram: np.ndarray, projections: np.ndarray) -> np.ndarray:
    """(C, P, P) inner products less those of projections (C, P, R)."""
    if projections.shape[2]:
        return gram - projections @ projections.swapaxes(1, 2)
    return gram


@dataclass(frozen=True)
class SampleSums:
    """Sums over the coordinates of each sample of k components with `rows` (k, E N), computed on demand.

    `score` (E n, k) with the residual, `added` (k, E n, W) with the basis of all added effects, `basis` (k, E n, R)
    with that of the baseline, `squares` (k, E n, k) with one another. `name`: under which what depends on these alone
    is kept. A column is a function of the arm pose times a row, summed over the E poses of a sample.
    """

    rows: np.ndarray
    projected: Projected
    name: tuple

    @cached_property
    def score(self) -> np.ndarray:
        y = self.projected.problem.ends.repeated(self.projected._y())
        return self.projected.sums((self.rows * y).T)

    @cached_property
    def added(self) -> np.ndarray:
        ends = self.projected.problem.ends
        basis = ends.repeated(self.projected._basis_of_effects())
        return self.projected.row_sums(self.rows, basis)

    @cached_property
    def basis(self) -> np.ndarray:
        problem = self.projected.problem
        return self.projected.row_sums(self.rows, problem.ends.repeated(problem.basis))

    @cached_property
    def squares(self) -> np.ndarray:
        return self.projected.row_sums(self.rows, self.rows.T)

    def _moments(self, option: tuple, linear: Linear, raw, typical: np.ndarray) -> Moments:
        """Of C hypotheses, each V functions on every component; typical (C, k V) prior sizes, ordered by component.

        linear: maps values (n, R) of the samples to their sums with the functions, (C, V, R). raw(): inner products
        (C, k V, k V) of the columns.
        """
        count = len(typical)

        def made(basis):
            sums = np.stack([linear(values) for values in basis], 1)  # (C, k, V, R)
            by_sum = sums.reshape(*typical.shape, -1)
            return by_sum * typical[:, :, None]

        def first():
            products = raw() * typical[:, :, None] * typical[:, None, :]
            diagonals = np.einsum("cpp->cp", products)
            largest = diagonals.max(1)
            remaining = _without_projections(products, made(self.basis))
            return remaining, largest

        def coupling():
            score = linear(self.score).swapaxes(1, 2).reshape(count, -1)
            return score * typical, made(self.added)

        return self.projected._conditional(
            self.projected.cache, (self.name, option), first, coupling
        )

    def function_moments(self, name: tuple, waves: np.ndarray, typical: np.ndarray) -> Moments:
        """Moments of V functions (V, E n) on every component, as one hypothesis a group; waves (C, V, E n).

        name: of the functions. typical (C, k V): prior size of each coefficient, component after component.
        """
        groups, count, n = waves.shape
        flat = waves.reshape(groups * count, n)

        def linear(values):
            return (flat @ values).reshape(groups, count, -1)

        def raw():
            if self.projected.problem.ends.count > 1:
                return np.stack([self._products_of_ends(functions) for functions in waves])
            k = len(self.rows)
            out = np.empty((groups, k, count, k, count))
            for i in range(k):
                for j in range(i + 1):
                    weighted = waves * self.squares[i, :, j]
                    part = weighted @ waves.swapaxes(1, 2)  # symmetric
                    out[:, i, :, j] = out[:, j, :, i] = part
            return out.reshape(groups, k * count, k * count)

        return self._moments(name, linear, raw, typical)

    def _products_of_ends(self, waves: np.ndarray) -> np.ndarray:
        """(k V, k V) inner products of the columns of functions (V, E n), where the ends of a sample are not apart."""
        problem = self.projected.problem
        waves = waves[:, problem.ends.numbers(problem.sample)]
        columns = problem.ends.joined(self.rows[:, None] * waves)
        columns = columns.reshape(-1, columns.shape[-1])
        return columns @ columns.T

    def step_moments(self, x: np.ndarray, options: np.ndarray, typical: np.ndarray, centred: bool):
        """Moments of rows * (x > option), one hypothesis an option (V,); typical (k,).

        centred: each step less its mean over the samples. Sums over a step are differences of cumulative sums.
        """
        order = np.argsort(x, kind="stable")[::-1]
        after = len(x) - np.searchsorted(x[order][::-1], options, side="right")
        if centred:
            mean = after / len(x)
        else:
            mean = np.zeros(len(options))

        def summed(values, of_all, of_after=None):
            sums = np.zeros((len(x) + 1, values.shape[1]))
            np.cumsum(values[order], 0, out=sums[1:])
            out = sums[after]
            if of_after is not None:
                out *= of_after[:, None]
            if of_all.any():
                out += sums[-1] * of_all[:, None]
            return out

        def linear(values):
            return summed(values, -mean)[:, None]

        def raw():
            if self.projected.problem.ends.count > 1:
                return np.stack(
                    [
                        self._products_of_ends(step_function(x, option, centred))
                        for option in options
                    ]
                )
            return np.stack([summed(r, mean**2, 1 - 2 * mean) for r in self.squares], 1)

        sizes = np.broadcast_to(typical, (len(options), len(typical)))
        return self._moments(("step",), linear, raw, sizes)


def log_evidence(volume: np.ndarray, gain: np.ndarray, projected: "Projected") -> np.ndarray:
    """Log Bayes factor from log|I + s^2 D Z'Z D| and q(s), each (sizes, ...), summed over the sizes."""
    return marginalise_sizes(log_evidence_by_size(volume, gain, projected))


def log_evidence_by_size(volume: np.ndarray, gain: np.ndarray, projected) -> np.ndarray:
    """The same of each size by itself."""
    share = np.minimum(gain / (projected.yy + _ANCHOR), 1 - 1e-12)
    exponent = 0.5 * (projected.degrees + _ANCHOR)
    return -0.5 * volume - exponent * np.log1p(-share)


def log_null(projected) -> float:
    """Log evidence of no term at all, up to a constant of the samples: of problems about several solutions."""
    degrees = projected.degrees + _ANCHOR
    return float(-0.5 * degrees * np.log(projected.yy + _ANCHOR))


def marginalise_sizes(logs: np.ndarray) -> np.ndarray:
    """Log of the average over the sizes (the first axis) of exp(logs), each size as likely as it is."""
    further_axes = [1] * (logs.ndim - 1)
    logs = logs + _LOG_PRIOR.reshape(-1, *further_axes)
    top = logs.max(0)
    ratios = np.exp(logs - top)
    return top + np.log(ratios.sum(0))


def score_hypotheses(moments: Moments, yy: float, degrees: float) -> Scores:
    """Evidence against nothing, fall of y'y, rank and F-test p-value of C hypotheses; p = 1 where no degree of freedom
    would remain."""
    values, vectors = symmetric_eigen(moments.gram)
    least_value = np.maximum(ROUNDING * moments.raw, 1e-12)
    seen = values > least_value[:, None]
    values = np.where(seen, values, 0.0)
    coordinates = np.einsum("cpq,cp->cq", vectors, moments.score)
    projected = np.where(seen, coordinates, 0.0)
    ratio = np.divide(projected**2, values, out=np.zeros_like(values), where=seen)
    gain = ratio.sum(1)
    gain = np.minimum(gain, (1 - 1e-12) * yy)
    rank = seen.sum(1)
    spread = SIZES[:, None, None] ** 2
    explained = projected**2 * spread / (1 + spread * values)
    share = explained.sum(-1) / (yy + _ANCHOR)
    volume = np.log1p(spread * values).sum(-1)
    limited_share = np.minimum(share, 1 - 1e-12)
    log_remainder = np.log1p(-limited_share)
    logs = -0.5 * volume - 0.5 * (degrees + _ANCHOR) * log_remainder
    evidence = marginalise_sizes(logs)
    remaining_degrees = np.maximum(degrees - rank, 1)
    remaining_share = 1 - gain / max(yy, 1e-300)
    tested_rank = np.maximum(rank, 1)
    tail = betainc(remaining_degrees / 2, tested_rank / 2, remaining_share)
    # a set of columns that spends every degree of freedom leaves no variance to test it against
    is_testable = (rank > 0) & (degrees - rank >= 1)
    p = np.where(is_testable, tail, 1.0)
    evidence_or_none = np.where(rank > 0, evidence, 0.0)
    positive_p = np.maximum(p, 1e-300)
    return Scores(evidence_or_none, gain, rank, positive_p)


def scan_moments(projected: Projected, scan: Scan) -> Moments:
    """Moments of every option of a scan."""
    sample_sums = projected.sample_sums(scan.rows, scan.key)
    if scan.kind == "step":
        return sample_sums.step_moments(scan.x, scan.options, scan.typical, scan.centred)
    chunks = []
    step = max(CHUNK_SIZE // len(scan.x), 1)
    for start in range(0, len(scan.options), step):
        waves = _waves(projected.problem, scan, slice(start, start + step))
        pairs = np.repeat(scan.typical, 2)
        typical = np.broadcast_to(pairs, (len(waves), 2 * len(scan.typical)))
        moments = sample_sums.function_moments(("wave", start), waves, typical)
        chunks.append(moments)
    return Moments.joined(chunks)


def _waves(problem: Problem, scan: Scan, chunk: slice) -> np.ndarray:
    """(C, 2, n) cosines and sines of a chunk of a scan's options."""

    def make():
        return scan.waves(scan.options[chunk])

    is_small = scan.options.size * problem.n <= CHUNK_SIZE and not scan.is_exact
    cache = problem.function_cache if is_small else {}
    return cached(cache, ("wave", scan.where, scan.effect, chunk.start), make)
