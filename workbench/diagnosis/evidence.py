"""Evidence of hypotheses on what is missing, after the baseline is projected out of everything.

A hypothesis is a set of P columns X beside the baseline's. With y = M r and Z = M X (M = I - Q Q'),
coefficients b ~ N(0, sigma^2 s^2 diag(typical^2)) and sigma^2 ~ inverse gamma, the marginal
likelihood is Student's and closed but for the size s, which is summed over a logarithmic grid:

    log E(s) = -1/2 log|I + s^2 D Z'Z D| - (nu + nu0)/2 log(1 - q(s) / (y'y + nu0)),
    q(s) = y'Z D (Z'Z-in-D + s^-2 I)^-1 D Z'y,   D = diag(typical)

(Zellner 1971, An Introduction to Bayesian Inference in Econometrics, ch. 3; MacKay, Neural Comp. 4,
1992). All that is needed of the data are Z'Z (P x P) and Z'y (P): the moments. They come from sums
over the coordinates of a sample, so a family of a thousand change points costs one cumulative sum.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.special import betainc, logsumexp

from workbench.diagnosis.problem import Problem, Scan, Site

SIZES = np.geomspace(0.1, 100.0, 13)
"""Sizes of a disturbance in units of what is typical."""
_LIKELY = -np.log(np.maximum(1.0, SIZES / 3.0))  # each as likely as the others up to three times typical, then 1/s
_TOTAL = float(logsumexp(_LIKELY))
_ANCHOR = 4.0  # degrees of freedom that the stated sigma is worth: it may be wrong
_GONE = 1e-9  # squared share of a direction that rounding leaves when the baseline makes it exactly
_CHUNK = 4096


@dataclass(frozen=True)
class Moments:
    """C hypotheses of P columns: `gram` (C, P, P) = Z'Z, `score` (C, P) = Z'y, `raw` (C,) largest |X|^2,
    all in typical sizes."""

    gram: np.ndarray
    score: np.ndarray
    raw: np.ndarray


@dataclass(frozen=True)
class Scores:
    """C hypotheses judged: `evidence` (C,) log Bayes factor against nothing, `gain` (C,) fall of y'y at
    best, `rank` (C,), `p` (C,) of an F test, each by itself."""

    evidence: np.ndarray
    gain: np.ndarray
    rank: np.ndarray
    p: np.ndarray


class Projected:
    """A problem with its baseline projected out: y, y'y, the degrees left, and moments of hypotheses."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.y = problem.clear(problem.residual)
        self.crowd = crowding(self.y, problem)
        self.yy, self.degrees = float(self.y @ self.y) / self.crowd, problem.degrees / self.crowd
        n, size = problem.n, len(problem.sample)
        self._sum = csr_array((np.ones(size), (problem.sample, np.arange(size))), shape=(n, size))

    def of_columns(self, columns: np.ndarray) -> Moments:
        """columns (C, N, P), already in typical sizes."""
        basis = self.problem.basis
        made = np.einsum("nr,cnp->crp", basis, columns, optimize=True)
        raw = np.einsum("cnp,cnq->cpq", columns, columns, optimize=True)
        score = np.einsum("cnp,n->cp", columns, self.y)
        return Moments(raw - np.swapaxes(made, 1, 2) @ made, score, np.einsum("cpp->cp", raw).max(1))

    def slots(self, rows: np.ndarray) -> "Slots":
        """Sums over each sample's coordinates of rows (k, N) with y, with the basis and with one another."""
        basis, add = self.problem.basis, self._sum
        with_basis = np.stack([add @ (basis * row[:, None]) for row in rows])
        with_rows = np.stack([add @ (rows * row).T for row in rows])
        return Slots(add @ (rows * self.y).T, with_basis, with_rows)

    def fall(self, columns: np.ndarray) -> float:
        """Fall of y'y by columns (N, P)."""
        return float(self.judge(self.of_columns(columns[None] / np.sqrt((columns**2).sum(0)))).gain[0])

    def judge(self, moments: Moments) -> Scores:
        """Evidence, gain and p-value of each hypothesis, every coordinate counting for as much as it is worth."""
        parts = (moments.gram, moments.score, moments.raw)
        scores = judge(Moments(*(part / self.crowd for part in parts)), self.yy, self.degrees)
        return replace(scores, gain=scores.gain * self.crowd)


def crowding(y: np.ndarray, problem: Problem) -> float:
    """How many coordinates of one pose are worth one, as they err together: Kish's design effect, at least 1.

    Repeats of a pose share what the model misses there; they say ten times the same. From the sums
    over a pose against the sum of squares: 1 + (m - 1) rho on average (Kish, Survey Sampling, 1965).
    """
    m = len(y) // problem.n
    _, label = np.unique(problem.pose, return_inverse=True)
    if len(label) == label.max() + 1 or len(y) != m * problem.n:
        return 1.0
    sums = np.stack([np.bincount(label, row) for row in y.reshape(m, problem.n)])
    return float(np.clip((sums**2).sum() / max(y @ y, 1e-300), 1.0, np.bincount(label).max()))


@dataclass(frozen=True)
class Slots:
    """What is left of k slots once each sample's coordinates are summed: `score` (n, k), `basis` (k, n, R),
    `rows` (k, n, k)."""

    score: np.ndarray
    basis: np.ndarray
    rows: np.ndarray

    def times(self, waves: np.ndarray, typical: np.ndarray) -> Moments:
        """Moments of V functions (V, n) on every slot, as one hypothesis a group; waves (C, V, n).

        typical (C, k V): prior size of each coefficient, slot after slot.
        """
        groups, count, n = waves.shape
        k = len(self.basis)
        score = np.einsum("cvn,nk->ckv", waves, self.score, optimize=True).reshape(groups, -1)
        flat = waves.reshape(groups * count, n)
        made = np.stack([flat @ b for b in self.basis]).reshape(k, groups, count, -1)
        made = made.transpose(1, 0, 2, 3).reshape(groups, k * count, -1)
        raw = np.empty((groups, k, count, k, count))
        for i in range(k):
            for j in range(i, k):
                block = (waves * self.rows[i, :, j]) @ waves.transpose(0, 2, 1)
                raw[:, i, :, j], raw[:, j, :, i] = block, block.transpose(0, 2, 1)
        raw = raw.reshape(groups, k * count, k * count)
        return _scaled(raw - made @ made.transpose(0, 2, 1), score, raw, typical)

    def steps(self, x: np.ndarray, options: np.ndarray, typical: np.ndarray) -> Moments:
        """Moments of rows * (x > option), one hypothesis an option (V,); typical (k,)."""
        order = np.argsort(x, kind="stable")[::-1]
        after = len(x) - np.searchsorted(x[order][::-1], options, side="right")
        score = _summed(self.score[order])[after]
        made = np.stack([_summed(b[order])[after] for b in self.basis], 1)
        raw = np.stack([_summed(r[order])[after] for r in self.rows], 1)
        sizes = np.broadcast_to(typical, score.shape)
        return _scaled(raw - made @ made.transpose(0, 2, 1), score, raw, sizes)


    def waves(self, x: np.ndarray, options: np.ndarray, typical: np.ndarray) -> Moments:
        """Moments of rows * cos(option x) and rows * sin(option x), one hypothesis an option (V,); typical (k,).

        Squares and products of waves are waves of twice the option, so that sums over samples are two products.
        """
        k, n, rank = self.basis.shape
        turned, size = np.exp(1j * options[:, None] * x), (len(options), 2 * k)
        pair = turned.real, turned.imag
        score = np.stack([part @ self.score for part in pair], 2).reshape(size)
        flat = self.basis.transpose(1, 0, 2).reshape(n, k * rank)
        made = np.stack([(part @ flat).reshape(-1, k, rank) for part in pair], 2).reshape(*size, rank)
        rows = self.rows.transpose(1, 0, 2).reshape(n, k * k)
        once, twice = rows.sum(0), turned**2
        even, odd = twice.real @ rows, (twice.imag @ rows) / 2
        blocks = np.stack([(once + even) / 2, odd, odd, (once - even) / 2]).reshape(2, 2, -1, k, k)
        raw = blocks.transpose(2, 3, 0, 4, 1).reshape(*size, 2 * k)
        sizes = np.broadcast_to(np.repeat(typical, 2), size)
        return _scaled(raw - made @ made.transpose(0, 2, 1), score, raw, sizes)


def _summed(values):
    """(n + 1, ...) sums of the first 0, 1, ... n."""
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, 0)])


def _scaled(gram, score, raw, typical):
    largest = (np.einsum("cpp->cp", raw) * typical**2).max(1)
    return Moments(gram * typical[:, :, None] * typical[:, None, :], score * typical, largest)


def log_evidence(volume: np.ndarray, gained: np.ndarray, projected: "Projected") -> np.ndarray:
    """Log Bayes factor from log|I + s^2 D Z'Z D| and q(s), each (sizes, ...), summed over the sizes."""
    share = np.minimum(gained / (projected.yy + _ANCHOR), 1 - 1e-12)
    logs = -0.5 * volume - 0.5 * (projected.degrees + _ANCHOR) * np.log1p(-share)
    return _summed_over_sizes(logs)


def _summed_over_sizes(logs: np.ndarray) -> np.ndarray:
    """Log of the average over the sizes (the first axis) of exp(logs), each size as likely as it is."""
    logs = logs + (_LIKELY - _TOTAL).reshape(-1, *[1] * (logs.ndim - 1))
    top = logs.max(0)
    return top + np.log(np.exp(logs - top).sum(0))


def judge(moments: Moments, yy: float, degrees: float) -> Scores:
    """Evidence against nothing, fall of y'y, rank and F-test p-value of C hypotheses."""
    values, vectors = np.linalg.eigh(moments.gram)
    seen = values > np.maximum(_GONE * moments.raw, 1e-12)[:, None]
    values = np.where(seen, values, 0.0)
    along = np.where(seen, np.einsum("cpq,cp->cq", vectors, moments.score), 0.0)
    gain = np.divide(along**2, values, out=np.zeros_like(values), where=seen).sum(1)
    gain, rank = np.minimum(gain, (1 - 1e-12) * yy), seen.sum(1)
    spread = SIZES[:, None, None] ** 2
    share = (along**2 * spread / (1 + spread * values)).sum(-1) / (yy + _ANCHOR)
    volume, left = np.log1p(spread * values).sum(-1), np.log1p(-np.minimum(share, 1 - 1e-12))
    logs = -0.5 * volume - 0.5 * (degrees + _ANCHOR) * left
    evidence = _summed_over_sizes(logs)
    left = np.maximum(degrees - rank, 1)
    p = np.where(rank > 0, betainc(left / 2, np.maximum(rank, 1) / 2, 1 - gain / max(yy, 1e-300)), 1.0)
    return Scores(np.where(rank > 0, evidence, 0.0), gain, rank, np.maximum(p, 1e-300))


def scan_moments(projected: Projected, scan: Scan) -> Moments:
    """Moments of every option of a scan."""
    slots = projected.slots(scan.rows)
    if scan.kind == "step":
        return slots.steps(scan.x, scan.options, scan.typical)
    parts = [slots.waves(scan.x, scan.options[start : start + _CHUNK // 4], scan.typical)
             for start in range(0, len(scan.options), _CHUNK // 4)]  # fmt: skip
    return Moments(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("gram", "score", "raw")))


def site_moments(slots: Slots, waves: np.ndarray, sizes: np.ndarray, site: Site) -> Moments:
    """Moments of one smooth function, waves (V, n) with prior sizes (V,), on all slots of a site."""
    typical = np.outer(site.typical, sizes).ravel()[None]
    return slots.times(waves[None], typical)
