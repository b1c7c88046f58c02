"""Optimal design: the most informative subset of candidate poses, by exchange.

Every pose contributes a block of whitened rows of the Jacobian; the normal matrix of a set is the sum over its
blocks. Fedorov, Theory of Optimal Experiments (1972); Mitchell's exchange, Technometrics 16 (1974) 203.
The continuous (approximate) design gives a lower bound for all sets.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from workbench.core.least_squares.linear_algebra import inverse_positive, symmetric_eigenvalues
from workbench.core.least_squares.task_variances import TaskVariances

_SWEEPS = 12
# of the largest eigenvalue: added where nothing else is known, so that a set with too few poses has a volume at all
_RIDGE = 1e-9
# of the same, in addition to prior information: for rounding alone, since more would be taken for knowledge
_ROUNDING = 1e-13
_SHARES = 400


@dataclass(frozen=True)
class Design:
    """`chosen` (n,) candidates in order; `value` of the criterion and `random` (draws,) of random sets as large.

    For the criterion "task", where asked for, `twice` (draws,) of random sets of twice the size (none where there
    are not that many candidates), `everything` the value of all candidates, and `bound`: below it is no set of n.
    """

    chosen: np.ndarray
    value: float
    random: np.ndarray
    larger_is_better: bool
    twice: np.ndarray = field(default_factory=lambda: np.empty(0))
    everything: float | None = None
    bound: float | None = None

    @property
    def gain(self) -> float:
        """Ratio to the median random set; above 1 is better."""
        usual = float(np.median(self.random))
        if not usual or not self.value:  # nothing is determined: no ratio says anything
            return 1.0 if usual == self.value else float("nan")
        if self.larger_is_better:
            return self.value / usual
        return usual / self.value


def choose(
    rows: np.ndarray,
    n: int,
    criterion: str = "D",
    tasks: np.ndarray | None = None,
    seed: int = 0,
    draws: int = 200,
    known: np.ndarray | None = None,
    repeats: int = 1,
    bounded: bool = False,
    progress: Callable[[str, int, int], None] = lambda label, done, total: None,
) -> Design:
    """The n of N candidates with the best criterion.

    rows (N, m, F): whitened rows of each candidate, columns scaled to like sizes. criterion: "D"
    (det^(1/F) of the normal matrix), "O1" ... "O5" (see `Identifiability.observability`), or
    "task": the least mean variance of the rows `tasks` (T, m, F). known (F, F): normal matrix of what
    is known already. draws: random sets to compare with, which only the other criteria also start from. repeats: how
    often one candidate may be taken. bounded: with "task", also what
    the larger sets and the bound are, and a second search from there. progress: called with kind, number and total
    of the steps. Deterministic for a seed.
    """
    rng = np.random.default_rng(seed)
    largest = symmetric_eigenvalues(normal_of(rows))[-1] * np.eye(rows.shape[2])
    if known is None:
        ridge = _RIDGE * largest
    else:
        ridge = known + _ROUNDING * largest
    if tasks is None:
        weight = None
    else:
        weight = np.einsum("tmf,tmg->fg", tasks, tasks) / len(tasks)
    score, with_each = _criterion(criterion, n, rows, ridge, weight)

    def worth(indices):
        return score(normal_of(rows[indices]) + ridge)

    def random_sets(size):
        return [rng.choice(len(rows), size, replace=False) for _ in range(draws)]

    search = _Search(len(rows), with_each, repeats, progress)
    is_error = criterion == "task"  # the smaller the better
    several = random_sets(n)
    random = np.array([worth(indices) for indices in several])
    chosen = search.exchange(search.grow(n))
    comparisons = {}
    if is_error and bounded:
        grams = np.swapaxes(rows, 1, 2) @ rows
        shares, bound = least_error(grams, n, weight, ridge, repeats)
        chosen = min(chosen, search.exchange(_rounded_counts(shares, n, repeats)), key=worth)
        if 2 * n <= len(rows):
            larger = random_sets(2 * n)
        else:
            larger = []
        comparisons = {
            "twice": np.array([worth(indices) for indices in larger]),
            "everything": score(normal_of(rows) + ridge),
            "bound": bound,
        }
    if not is_error and random.max(initial=-np.inf) > worth(chosen):
        # the exchange ended in a local optimum: start again from the best random set
        chosen = search.exchange(several[int(random.argmax())])
    return Design(np.sort(chosen), worth(chosen), random, not is_error, **comparisons)


def least_error(grams, n: int, weight, ridge, repeats: int = 1) -> tuple[np.ndarray, float]:
    """Shares (N,) of the candidates, in sum n, none above `repeats`, with the least "task" value; and a bound.

    grams (N, F, F), weight and ridge (F, F). No n whole candidates are below the bound: the value is convex in
    the shares, and so nowhere lies below its tangent plane, whose least value is taken over all shares there may
    be (Kiefer, Annals of Statistics 2 (1974) 849). Shares by the multiplicative algorithm (Silvey, Titterington &
    Torsney, Communications in Statistics A 7 (1978) 1379), held below their limit
    (Wynn, Statistical Decision Theory and Related Topics III, 1982).
    """
    flat = grams.reshape(len(grams), -1)
    shares = np.full(len(grams), n / len(grams))
    bound = 0.0
    for _ in range(_SHARES):
        matrix = (shares @ flat).reshape(ridge.shape) + ridge
        inverse = inverse_positive(matrix)
        value = float((inverse * weight).sum())
        slope = flat @ (inverse @ weight @ inverse).ravel()
        cycle, part = divmod(n, repeats)
        best = np.sort(slope)[::-1]
        largest = repeats * best[:cycle].sum() + (part * best[cycle] if part else 0.0)
        bound = max(bound, value - (largest - slope @ shares))
        if bound > value * (1 - 1e-3):
            break
        shares = _filled(shares * np.sqrt(np.maximum(slope, 0)), n, repeats)
    return shares, float(bound)


def _filled(shares, n, limit):
    """The shares scaled to the sum n, with those above `limit` limited to it."""
    order = np.argsort(-shares)
    falling = shares[order]
    tail_sums = np.cumsum(falling[::-1])[::-1]
    factor = (n - limit * np.arange(len(shares))) / np.maximum(tail_sums, 1e-300)
    first = int(np.argmax(factor * falling <= limit * (1 + 1e-12)))
    return np.minimum(shares * factor[first], limit)


def _rounded_counts(shares, n, limit):
    """n candidates (n,) whose numbers, up to `limit` of each, are nearest to the shares (N,)."""
    counts = np.floor(shares).astype(int)
    counts[np.argsort(np.where(counts < limit, counts - shares, 1.0))[: n - counts.sum()]] += 1
    return np.repeat(np.arange(len(shares)), counts)


def normal_of(rows: np.ndarray) -> np.ndarray:
    """(F, F) normal matrix of some candidates' rows (k, m, F)."""
    flat = rows.reshape(-1, rows.shape[2])
    return flat.T @ flat


def _criterion(name, n, rows, ridge, weight) -> tuple[Callable, Callable]:
    """The score of a normal matrix, and of a set (k,) with each candidate added (larger is better there)."""
    if name == "task":
        variances = TaskVariances(rows, ridge, weight)
        return (
            lambda normal: float(np.trace(inverse_positive(normal) @ weight)),
            lambda members: -variances.with_each(members),
        )
    if name == "D":
        return _volume, lambda members: _volumes_with(normal_of(rows[members]) + ridge, rows)
    index = int(name[1:]) - 1
    grams = np.swapaxes(rows, 1, 2) @ rows

    def score(normals):
        s = np.sqrt(np.maximum(symmetric_eigenvalues(normals), 1e-300))
        return observability(s, n)[index]

    return (lambda normal: float(score(normal))), (
        lambda members: score(normal_of(rows[members]) + ridge + grams)
    )


def observability(s: np.ndarray, n: int) -> tuple[np.ndarray, ...]:
    """O1 ... O5 (...,) of singular values s (..., F), ascending, of n poses; Sun & Hollerbach, ICRA 2008."""
    low = s[..., 0]
    high = s[..., -1]
    return (
        np.exp(np.log(s).mean(-1)) / np.sqrt(n),
        low / high,
        low,
        low**2 / high,
        1 / (1 / s).sum(-1),
    )


def _volume(normal):
    sign, log = np.linalg.slogdet(normal)
    if sign > 0:
        return float(np.exp(log / len(normal)))
    return 0.0


def _volumes_with(normal, rows):
    """log det with each candidate, less log det without: Sylvester's identity on its few rows."""
    inner = rows @ inverse_positive(normal) @ np.swapaxes(rows, 1, 2)
    return np.linalg.slogdet(np.eye(rows.shape[1]) + inner)[1]


@dataclass(frozen=True)
class _Search:
    """For the best set of `count` candidates: the score of a set with each of them added, how often one may come."""

    count: int
    with_each: Callable[[np.ndarray], np.ndarray]
    repeats: int
    progress: Callable[[str, int, int], None] = lambda what, done, total: None

    def worth(self, others) -> np.ndarray:
        """(N,) what each candidate would add to the others; -inf for those that may not come again."""
        value = self.with_each(others)
        value[np.bincount(others, minlength=self.count) >= self.repeats] = -np.inf
        return value

    def grow(self, n) -> list[int]:
        """Greedy selection: add the best candidate one by one."""
        chosen: list[int] = []
        for k in range(n):
            self.progress("choosing pose", k + 1, n)
            chosen.append(int(np.argmax(self.worth(np.array(chosen, int)))))
        return chosen

    def exchange(self, start) -> list[int]:
        """Exchange each chosen candidate for the best other one, until the score does not improve."""
        chosen = [int(k) for k in start]
        for sweep in range(_SWEEPS):
            changed = False
            for k, now in enumerate(chosen):
                self.progress(f"exchanging in sweep {sweep + 1} pose", k + 1, len(chosen))
                value = self.worth(np.array(chosen[:k] + chosen[k + 1 :], int))
                best = int(np.argmax(value))
                if value[best] > value[now] + 1e-9 * abs(value[now]):
                    chosen[k], changed = best, True
            if not changed:
                break
        return chosen
