"""The objective of the search: log posterior of a set of terms in the linearised problem.

With the baseline projected out of everything, a set S of terms with columns X (in typical sizes) explains

    y = X b + G m + e,     b ~ N(0, sigma^2 s^2 I),   m ~ N(0, sigma^2 I),   e ~ N(0, sigma^2 I).

The log posterior of S, up to a constant, is the sum of

- the log prior of its terms (`Priors`),
- the log marginal likelihood, closed in b, m and sigma (inverse gamma) and summed over a grid of sizes s,
- the log probability that every coefficient which cannot be negative is not, log 2 Phi(z) each.

G says what first moments of the links that are only nearly known change in the deflection of the arm. It is the same
for all sets, so that it is marginalised once, in the inner products. Everything follows from the inner products
X' S^-1 [X, y] of all candidate terms, S = I + G G': no move of the search touches the samples.

Zellner, An Introduction to Bayesian Inference in Econometrics (1971), ch. 3; George & McCulloch, Stat. Sinica 7 (1997).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr

from workbench.core.least_squares.linear_algebra import solve_positive, symmetric_eigen
from workbench.diagnosis.linear.evidence import SIZES, Projected, log_evidence, log_evidence_by_size
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.linear.problem import Problem
from workbench.diagnosis.search.compatible import compatible
from workbench.diagnosis.search.prior import MassUncertainty, Priors, elastic_prior, is_elastic

Members = tuple[int, ...]
_SMALL = 8
"""Columns up to which what a group of terms costs is the call and not the numbers."""
_KEPT = 16
"""Solved sets of large terms that an objective keeps: each is some megabytes."""


def columns_of_terms(start: np.ndarray, members: Members) -> np.ndarray:
    """Numbers of the columns of some terms; start (T + 1,): first column of each term."""
    ranges = [np.arange(start[i], start[i + 1]) for i in members]
    return np.concatenate([np.zeros(0, int), *ranges])


@dataclass(frozen=True)
class Accepted:
    """Number of accepted terms, and number -> columns (N, P) of the loads among them, as solved."""

    count: int = 0
    loads: Mapping[int, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Table:
    """Inner products `gram` (T, T) and `score` (T,) of all columns, `shrink` (S,) the inverse squares of the sizes."""

    gram: np.ndarray
    score: np.ndarray
    shrink: np.ndarray


class ConditionalSolution:
    """A set of columns `columns` (h,) of a table, solved once: moments conditional on it, by Schur complements.

    With A = G_ss + s^-2 I the set's own inner products for disturbances of size s, what is left of the others' is
    G_cc - G_cs A^-1 G_sc. One eigenvalue decomposition of G_ss serves all sizes. Where the set contains another one
    that is solved already, `given`, the rest is solved conditional on that: for each size, but with few columns.
    """

    def __init__(
        self, table: Table, columns: np.ndarray, given: "ConditionalSolution | None" = None
    ):
        """columns (h,): those of the set that `given` does not hold."""
        self.table, self.given, self._columns = table, given, columns
        if given is None:
            inner = table.gram[np.ix_(columns, columns)][None]
            score = table.score[columns][None]
        else:
            inner = given.remaining(columns, columns)
            score = given.scores[:, columns]
        values, self._vectors = symmetric_eigen(inner)  # (1 or S, h), (1 or S, h, h)
        # (S, h): of A^-1, along the vectors
        self._inverse_eigenvalues = 1 / (np.maximum(values, 0.0) + table.shrink[:, None])
        self._score = np.einsum("skh,sk->sh", self._vectors, score)
        self._solution = self._inverse_eigenvalues * self._score

    @cached_property
    def _projected_gram(self) -> np.ndarray:
        """(1 or S, h, T) of the set's inner products with all columns, along the vectors."""
        if self.given is None:
            rows = self.table.gram[self._columns]
        else:
            rows = self.given.remaining(self._columns, slice(None))
        return self._vectors.swapaxes(1, 2) @ rows

    def remaining(self, rows: np.ndarray, columns: np.ndarray | slice) -> np.ndarray:
        """(S, k, c) what is left of the inner products of some columns of the table, `rows` (k,), with others (c,)."""
        if self.given is None:
            inner = self.table.gram[rows][:, columns]
        else:
            inner = self.given.remaining(rows, columns)
        weighted = self._projected_gram[..., rows] * self._inverse_eigenvalues[..., None]
        return inner - weighted.swapaxes(1, 2) @ self._projected_gram[..., columns]

    @cached_property
    def scores(self) -> np.ndarray:
        """(S, T) the scores conditional on the set."""
        score = self.table.score if self.given is None else self.given.scores
        return score - (self._solution[:, None] @ self._projected_gram)[:, 0]

    @cached_property
    def log_determinant(self) -> np.ndarray:
        """(S,) log determinant of the set."""
        block_determinant = -np.log(self._inverse_eigenvalues).sum(1)
        block_determinant -= len(self._columns) * np.log(self.table.shrink)
        if self.given is None:
            return block_determinant
        return self.given.log_determinant + block_determinant

    @cached_property
    def gain(self) -> np.ndarray:
        """(S,) gain of the set."""
        block_gain = (self._solution * self._score).sum(1)
        if self.given is None:
            return block_gain
        return self.given.gain + block_gain

    def coefficients(self, size: int, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (k,) of some columns (k,) and their standard errors (k,) in sigmas, for one of the sizes.

        columns: in ascending order, of the set and not of `given`.
        """
        order = np.argsort(self._columns)
        rows = order[np.searchsorted(self._columns[order], columns)]
        inverse_eigenvalues = self._inverse_eigenvalues[size]
        vectors = self._vectors[size if len(self._vectors) > 1 else 0][rows]
        spread = np.sqrt((vectors**2 * inverse_eigenvalues).sum(1))
        return vectors @ self._solution[size], spread

    def blocks(self, columns: np.ndarray) -> np.ndarray:
        """(S, C, w, w) what is left of the inner products of C terms with columns (C, w)."""
        if self.given is None:
            inner = self.table.gram[columns[:, :, None], columns[:, None, :]]
            inner = np.broadcast_to(inner, (len(self.table.shrink), *inner.shape))
        else:
            inner = self.given.blocks(columns)
        if not len(self._columns):
            return inner
        cross = np.moveaxis(self._projected_gram, 1, 2)[:, columns]  # (1 or S, C, w, h)
        return inner - (cross * self._inverse_eigenvalues[:, None, None]) @ cross.swapaxes(2, 3)


@dataclass(frozen=True)
class LogPosterior:
    """Log posterior of sets of K terms with T columns: `gram` (T, T), `score` (T,), `start` (K + 1,) of each term.

    `yy`, `degrees`: squared length of y and the coordinates that it is worth; `seen`: sets that were weighed; `large`:
    sets of large terms that were solved.
    `is_rigid`: whether the baseline holds no compliance, so that loads act through those of a set alone.
    """

    terms: tuple[Hypothesis, ...]
    gram: np.ndarray
    score: np.ndarray
    start: np.ndarray
    yy: float
    degrees: float
    priors: Priors
    is_rigid: bool = False
    seen: dict[frozenset, float] = field(default_factory=dict)
    joined: dict[tuple, np.ndarray] = field(default_factory=dict)
    large: dict[frozenset, ConditionalSolution] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        problem: Problem,
        terms: Sequence[Hypothesis],
        remainder: Problem | None = None,
        accepted: Accepted | None = None,
    ) -> "LogPosterior":
        """Of some terms, their columns taken at a problem that keeps none of them.

        remainder: the problem that keeps the terms accepted so far. Repeats of a pose err together by what these
        explain, so that only the remainder says how many independent numbers the samples are worth.
        accepted: of the first terms. Other terms that act through their compliances (loads) count for what these do not
        explain.
        """
        projected = Projected(problem, remainder)
        accepted = accepted or Accepted()
        blocks = [accepted.loads.get(i, h.columns(problem)) for i, h in enumerate(terms)]
        start = np.concatenate([[0], np.cumsum([c.shape[1] for c in blocks])]).astype(int)
        raw = np.concatenate(blocks, 1)
        columns = problem.orthogonalise(raw)
        _condition_on_compliances(columns, start, terms, accepted)
        others = _other_laws(raw, start, terms, accepted)
        priors = elastic_prior(problem, projected, terms, others)
        columns *= np.repeat(priors.scale, np.diff(start))
        masses = MassUncertainty.of(problem, projected, priors)
        gram, score, yy = masses.marginalised(columns, projected.y)
        design_effect = projected.design_effect
        yy = (yy + masses.law_error(priors)) / design_effect
        return cls(
            tuple(terms),
            gram / design_effect,
            score / design_effect,
            start,
            yy,
            projected.degrees,
            priors,
            not problem.given_values,
        )

    def select_terms(self, rows: np.ndarray) -> "LogPosterior":
        """The objective of sets of some of the terms, by their numbers (k,); those that are not looked at cost most."""
        if len(rows) == len(self.terms):
            return self
        index = self.index(rows)
        return LogPosterior(
            tuple(self.terms[i] for i in rows),
            self.gram[np.ix_(index, index)],
            self.score[index],
            np.concatenate([[0], np.cumsum(np.diff(self.start)[rows])]),
            self.yy,
            self.degrees,
            self.priors.select_terms(rows),
            self.is_rigid,
        )

    @cached_property
    def compatible_pairs(self) -> np.ndarray:
        """(K, K) bool: which may act side by side."""
        count = len(self.terms)
        out = np.zeros((count, count), bool)
        for i, first in enumerate(self.terms):
            for j in range(i):
                out[i, j] = out[j, i] = compatible(first, self.terms[j])
        return out

    @cached_property
    def is_smooth(self) -> np.ndarray:
        """(K,) bool: smooth nonparametric functions."""
        return np.array([bool(h.smooth_covariates) for h in self.terms])

    @cached_property
    def is_large(self) -> np.ndarray:
        """(K,) bool: terms of many columns, whose coefficients may have any sign."""
        return (np.diff(self.start) > _SMALL) & (self.priors.positive == 0)

    @cached_property
    def groups(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Numbers (C,) of terms with about as many columns, and those columns (C, w); few groups are quicker.

        Small w are powers of two, larger ones at most a quarter more than a term has. What it lacks is filled with the
        last column of the table, which is zero: one that explains nothing and spends nothing.
        """
        widths = np.diff(self.start)
        power = 2 ** np.ceil(np.log2(np.maximum(widths, 1))).astype(int)
        step = np.where(power <= _SMALL, power, power // _SMALL)
        padded = -(-widths // step) * step
        out = []
        for width in np.unique(padded):
            rows = np.flatnonzero(padded == width)
            place = np.arange(width)
            columns = self.start[rows][:, None] + place
            out.append((rows, np.where(place < widths[rows][:, None], columns, len(self.score))))
        return out

    @cached_property
    def table(self) -> Table:
        """The inner products, and zeros for a further column."""
        gram = np.pad(self.gram, (0, 1))
        score = np.pad(self.score, (0, 1))
        return Table(gram, score, 1 / SIZES**2)

    def index(self, members: Members) -> np.ndarray:
        """Columns of a set."""
        return columns_of_terms(self.start, members)

    def gain(self, members: Members) -> float:
        """Fall of the sum of squares by a set, its coefficients hardly held back."""
        index = self.index(members)
        of_members = self.gram[np.ix_(index, index)]
        gram = of_members + np.eye(len(index)) / SIZES[-1] ** 2
        score = self.score[index]
        return float(score @ solve_positive(gram, score))

    def value(self, members: Members) -> float:
        """Log posterior of a set."""
        key = frozenset(members)
        if key not in self.seen:
            self.seen[key] = self.value_at(members, np.inf)
        return self.seen[key]

    def value_at(self, members: Members, gain: float) -> float:
        """Log posterior of a set where a larger fall of the sum of squares than `gain` counts for nothing.

        Of loads without a compliance that they deflect it is -inf: their columns are those of compliances that the set
        does not hold.
        """
        if members and not self._carries_loads(members[:-1])[members[-1]]:
            return -np.inf
        solved = self._solved(members)
        gain_of_set = np.minimum(solved.gain, gain)
        logs = float(log_evidence(solved.log_determinant, gain_of_set, self))
        return logs + self.priors.of(members) + self._signs(members, solved)

    def _signs(self, members: Members, solved: ConditionalSolution) -> float:
        """Log probability, times 2 for each, that what cannot be negative is not; the coefficients one by one."""
        cannot = self._cannot_be_negative(members)
        if not len(cannot):
            return 0.0
        best = self._most_probable_size(solved)
        value, spread = solved.coefficients(best, cannot)
        remaining = max(self.yy - solved.gain[best], 1e-300)
        variance = remaining / max(self.degrees, 1.0)
        # the residual is predicted minus measured: what is missing has the opposite sign
        std = spread * np.sqrt(variance)
        z = -value / np.maximum(std, 1e-300)
        log_chances = np.log(2) + log_ndtr(z)
        return float(log_chances.sum())

    def _most_probable_size(self, solved: ConditionalSolution) -> int:
        """Number of the size whose evidence is highest."""
        logs = log_evidence_by_size(solved.log_determinant, solved.gain, self)
        return int(np.argmax(logs))

    def _cannot_be_negative(self, members: Members) -> np.ndarray:
        """Columns of a set whose coefficients cannot be negative, in ascending order."""
        first = [
            self.start[i] + np.arange(self.priors.positive[i])
            for i in sorted(members)
            if self.priors.positive[i]
        ]
        return np.concatenate([np.zeros(0, int), *first])

    def coefficient(self, members: Members, number: int) -> float:
        """Likeliest value of the first coefficient of a member of a set that cannot be negative, in its prior size."""
        solved = self._solved(members)
        best = self._most_probable_size(solved)
        columns = self.start[number : number + 1]
        values = solved.coefficients(best, columns)[0]
        return float(values[0])

    def most_probable_extension(self, base: Members, allowed: np.ndarray) -> tuple[float, Members]:
        """The most probable set with one more of the terms allowed (K,) bool; the set itself where none has room."""
        free = allowed & (self.compatible_pairs[list(base)].all(0) if base else True)
        free &= self._carries_loads(base)
        weights = self._with_each(base, free)
        positive = self.priors.positive[list(base)]
        signs = int(positive.sum())
        sign_bonus = np.log(2) * (signs + self.priors.positive)  # that signs add
        top = (-np.inf, base)
        in_order = np.argsort(-(weights + sign_bonus))
        for k in in_order:
            if not weights[k] + sign_bonus[k] > top[0]:
                break
            members = (*base, int(k))
            top = max(top, (self.value(members) if sign_bonus[k] else float(weights[k]), members))
        return top

    def _carries_loads(self, base: Members) -> np.ndarray:
        """(K,) whether a set with each other term holds a compliance for its loads, or has no load."""
        is_load, is_carrier = self._loads_and_carriers
        if not self.is_rigid or is_carrier[list(base)].any():
            return np.ones(len(self.terms), bool)
        if is_load[list(base)].any():
            return is_carrier
        return ~is_load

    @cached_property
    def _loads_and_carriers(self) -> np.ndarray:
        """(2, K) which terms act through compliances alone, and which are such compliances."""
        kinds = [(h.needs_compliance, h.carries_load) for h in self.terms]
        return np.array(kinds, bool).reshape(-1, 2).T

    def _with_each(self, base: Members, free: np.ndarray) -> np.ndarray:
        """(K,) log posterior, but for signs, of a set with each term that is free (K,) bool; of others -inf."""
        key = frozenset(base), free.tobytes()
        if key not in self.joined:
            weights = np.full(len(self.terms), -np.inf)
            solved = self._solved(base)
            for rows, columns in self.groups:
                chosen = free[rows]
                if chosen.any():
                    weights[rows[chosen]] = self._evidence_with(solved, columns[chosen])
            conditional_prior = self.priors.conditional(base)
            self.joined[key] = weights + self.priors.of(base) + conditional_prior
        return self.joined[key]

    def _solved(self, members: Members) -> ConditionalSolution:
        """A set, solved conditional on its large terms, which most other sets share."""
        large = frozenset(i for i in members if self.is_large[i])
        if not large:
            return ConditionalSolution(self.table, self.index(members))
        if large not in self.large:
            if len(self.large) >= _KEPT:
                del self.large[next(iter(self.large))]
            self.large[large] = ConditionalSolution(self.table, self.index(tuple(sorted(large))))
        small = tuple(i for i in members if i not in large)
        solved = self.large[large]
        if small:
            return ConditionalSolution(self.table, self.index(small), solved)
        return solved

    def _evidence_with(self, solved: ConditionalSolution, columns: np.ndarray) -> np.ndarray:
        """(C,) log evidence of a set with each of C terms with columns (C, w).

        One Cholesky factor of each, the score as its last row, gives both determinant and gain.
        """
        blocks = solved.blocks(columns)
        shrink = self.table.shrink
        width = columns.shape[1]
        bordered = np.zeros((*blocks.shape[:2], width + 1, width + 1))
        bordered[..., :-1, :-1] = blocks
        bordered[..., range(width), range(width)] += shrink[:, None, None]
        scores = solved.scores[:, columns]
        bordered[..., -1, :-1] = scores
        bordered[..., -1, -1] = np.finfo(float).max  # of the factor's corner, which nobody reads
        try:
            factor = np.linalg.cholesky(bordered)
            coupling = factor[..., -1, :-1]
            added_gain = (coupling**2).sum(-1)
            diagonal = np.diagonal(factor, axis1=-2, axis2=-1)
            log_determinant = 2 * np.log(diagonal[..., :-1]).sum(-1)
        except np.linalg.LinAlgError:  # hardly any noise: rounding exceeds what is left
            values, vectors = symmetric_eigen(blocks)
            values = np.maximum(values, 0.0) + shrink[:, None, None]
            projected = np.einsum("scij,sci->scj", vectors, solved.scores[:, columns])
            added_gain = (projected**2 / values).sum(-1)
            log_determinant = np.log(values).sum(-1)
        volume = log_determinant - width * np.log(shrink)[:, None]
        all_volumes = solved.log_determinant[:, None] + volume
        all_gains = solved.gain[:, None] + added_gain
        return log_evidence(all_volumes, all_gains, self)


def _other_laws(
    columns: np.ndarray, start: np.ndarray, terms: Sequence[Hypothesis], accepted: Accepted
) -> np.ndarray:
    """(N, P) columns of the accepted laws that are not elastic; smooth functions may represent elastic ones."""
    is_other_law = [
        i < accepted.count
        and not h.smooth_covariates
        and not is_elastic(h)
        and not h.needs_compliance
        for i, h in enumerate(terms)
    ]
    return columns[:, np.repeat(is_other_law, np.diff(start)).astype(bool)]


def _condition_on_compliances(
    orthogonal: np.ndarray, start: np.ndarray, terms: Sequence[Hypothesis], accepted: Accepted
) -> None:
    """Take out of the columns (N, T) of loads, in place, what the accepted compliances make."""
    widths = np.diff(start)
    carriers = [i < accepted.count and h.carries_load for i, h in enumerate(terms)]
    loads = [h.needs_compliance and i not in accepted.loads for i, h in enumerate(terms)]
    carried = np.repeat(loads, widths).astype(bool)
    base = orthogonal[:, np.repeat(carriers, widths).astype(bool)]
    if carried.any() and base.shape[1]:
        orthonormal = np.linalg.qr(base)[0]
        orthogonal[:, carried] -= orthonormal @ (orthonormal.T @ orthogonal[:, carried])
