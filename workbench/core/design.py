"""Which poses to measure: the subset of candidates that tells most, by exchange.

Every pose brings a block of whitened rows of the Jacobian; a set's normal matrix is the sum over its
blocks. Fedorov, Theory of Optimal Experiments (1972); Mitchell's exchange, Technometrics 16 (1974) 203.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

_SWEEPS = 12
# of the largest eigenvalue, added so that a set with too few poses has a volume at all
_RIDGE = 1e-9


@dataclass(frozen=True)
class Design:
    """`chosen` (n,) candidates in order; `value` of the criterion and `random` (draws,) of random sets as large."""

    chosen: np.ndarray
    value: float
    random: np.ndarray
    larger_is_better: bool

    @property
    def gain(self) -> float:
        """How many times better than the median random set; above 1 is better."""
        usual = float(np.median(self.random))
        return self.value / usual if self.larger_is_better else usual / self.value


def choose(rows: np.ndarray, n: int, criterion: str = "D", tasks: np.ndarray | None = None, seed: int = 0,
           draws: int = 200, known: np.ndarray | None = None) -> Design:  # fmt: skip
    """The n of N candidates with the best criterion.

    rows (N, m, F): whitened rows of each candidate, columns scaled to like sizes. criterion: "D"
    (det^(1/F) of the normal matrix), "O1" ... "O5" (see `Identifiability.observability`), or
    "task": the least mean variance of the rows `tasks` (T, m, F). known (F, F): normal matrix of what
    has been measured already. Deterministic for a seed.
    """
    rng = np.random.default_rng(seed)
    grams = np.swapaxes(rows, 1, 2) @ rows
    ridge = _RIDGE * np.linalg.eigvalsh(grams.sum(0))[-1] * np.eye(rows.shape[2])
    ridge = ridge if known is None else ridge + known
    weight = None if tasks is None else np.einsum("tmf,tmg->fg", tasks, tasks) / len(tasks)
    score, swap = _criterion(criterion, n, weight)
    chosen = _grow(rows, grams, n, ridge, swap)
    chosen = _exchange(rows, grams, chosen, ridge, swap)
    several = [rng.choice(len(rows), n, replace=False) for _ in range(draws)]
    random = np.array([score(grams[some].sum(0) + ridge) for some in several])
    value, best = score(grams[chosen].sum(0) + ridge), several[int(random.argmax())]
    if criterion != "task" and random.max() > value:  # an exchange may end in a hole: start once more from there
        chosen = _exchange(rows, grams, list(best), ridge, swap)
        value = score(grams[chosen].sum(0) + ridge)
    return Design(np.sort(chosen), value, random, criterion != "task")


def _criterion(name, n, weight) -> tuple[Callable, Callable]:
    """The score of a normal matrix, and what adding each candidate to one makes of it (larger is better)."""
    if name == "D":
        return _volume, _volumes_with
    if name == "task":
        return (lambda normal: float(np.trace(np.linalg.solve(normal, weight)))), \
               (lambda normal, rows, grams: -_variances_with(normal, rows, weight))  # fmt: skip
    index = int(name[1:]) - 1

    def score(normals):
        s = np.sqrt(np.maximum(np.linalg.eigvalsh(normals), 1e-300))
        return observability(s, n)[index]

    return (lambda normal: float(score(normal))), (lambda normal, rows, grams: score(normal + grams))


def observability(s: np.ndarray, n: int) -> tuple[np.ndarray, ...]:
    """O1 ... O5 (...,) of singular values s (..., F), ascending, of n poses; Sun & Hollerbach, ICRA 2008."""
    low, high = s[..., 0], s[..., -1]
    return (np.exp(np.log(s).mean(-1)) / np.sqrt(n), low / high, low, low**2 / high, 1 / (1 / s).sum(-1))


def _volume(normal):
    sign, log = np.linalg.slogdet(normal)
    return float(np.exp(log / len(normal))) if sign > 0 else 0.0


def _volumes_with(normal, rows, grams):
    """log det with each candidate, less log det without: Sylvester's identity on its few rows."""
    inner = rows @ np.linalg.solve(normal, np.swapaxes(rows, 1, 2))
    return np.linalg.slogdet(np.eye(rows.shape[1]) + inner)[1]


def _variances_with(normal, rows, weight):
    """Trace of weight times the covariance with each candidate: Woodbury's identity."""
    inverse = np.linalg.inv(normal)
    half = rows @ inverse
    inner = np.eye(rows.shape[1]) + half @ np.swapaxes(rows, 1, 2)
    gain = np.linalg.solve(inner, half @ weight @ np.swapaxes(half, 1, 2))
    return np.trace(inverse @ weight) - np.trace(gain, axis1=1, axis2=2)


def _grow(rows, grams, n, ridge, swap):
    """Candidates one by one, each time the one that helps most."""
    chosen, normal = [], ridge.copy()
    for _ in range(n):
        value = swap(normal, rows, grams)
        value[chosen] = -np.inf
        chosen.append(int(np.argmax(value)))
        normal = normal + grams[chosen[-1]]
    return chosen


def _exchange(rows, grams, chosen, ridge, swap):
    """Every chosen candidate against all others, until nothing gets better."""
    chosen = list(chosen)
    for _ in range(_SWEEPS):
        changed = False
        for k, now in enumerate(chosen):
            others = chosen[:k] + chosen[k + 1 :]
            value = swap(grams[others].sum(0) + ridge, rows, grams)
            value[others] = -np.inf
            best = int(np.argmax(value))
            if value[best] > value[now] + 1e-9 * abs(value[now]):
                chosen[k], changed = best, True
        if not changed:
            break
    return chosen
