"""Identifiability of parameters: rank, null space in words, observability, covariance.

All of it works on the whitened normal matrix with every column scaled by its parameter's typical
size. A singular value s of a direction then reads: the data know it 1/s typical sizes well. Where
s < 1 they know less than one knew before measuring, and the direction is called undetermined.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr, solve_triangular

from workbench.core.least_squares.linear_algebra import (
    covariance_of,
    least_squares,
    symmetric_eigen,
    thin_svd,
)
from workbench.core.parameters import Parameters

OBSERVABLE_SIGMAS = 1e-2
"""Sigmas by which a direction of the parameters moves all measurements for one typical size: one that moves them by
less can neither hide nor imitate anything."""
_PART = 0.05
_NAMED = 6
_SAME = (
    1e-12  # squared: what rounding leaves of a column, in its own length, that others make exactly
)
_NO_EFFECT = 1e-6  # sigmas: what rounding makes of a column of zeros
_ROUNDING = (
    1e-13  # of the largest column: what is left of a column of zeros where the sigma is tiny
)
_LEAST_SCALE = 1e-9  # residuals of exactly zero make no data infinitely good
_FAINT = 1e-4  # knows a parameter to a hundred typical sizes
_AMPLIFIED = (
    1e-12  # of squared column lengths: rounding of sums of many products in double precision
)
_CONFOUNDED = 1e-2  # squared: what is left of a column, in typical sizes, below which it is confounded with others


@dataclass(frozen=True)
class Identifiability:
    """F free parameters: `singular` (F,) ascending, `directions` (F, F) their unit directions in
    columns (typical sizes), `rank`: all from the data alone, without priors; `covariance` (F, F) in
    the parameters' own units, with the priors, and a hundred typical sizes where nothing is known;
    `weight` (F,) what one typical size of each does to all measurements, in sigmas; `exact` (E, F)
    directions in which nothing changes at all, whatever the sigmas and typical sizes.
    """

    keys: tuple[str, ...]
    labels: tuple[str, ...]
    units: tuple[str, ...]
    typical: np.ndarray
    singular: np.ndarray
    directions: np.ndarray
    rank: int
    covariance: np.ndarray
    weight: np.ndarray
    exact: np.ndarray

    @property
    def null(self) -> np.ndarray:
        """(F, F - rank) undetermined directions."""
        return self.directions[:, : len(self.keys) - self.rank]

    @property
    def determined(self) -> np.ndarray:
        """(F,) True where a parameter takes no part in an undetermined direction."""
        tied = {key for group in self.groups() for key in group}
        return np.array([key not in tied for key in self.keys], bool)

    def tied(self) -> dict[str, list[str]]:
        """For every parameter that is not identifiable, the parameters that it is confounded with."""
        found: dict[str, list[str]] = {
            key: [] for key, known in zip(self.keys, self.determined) if not known
        }
        for group in self.groups():
            for key in group:
                found.setdefault(key, []).extend(other for other in group if other != key)
        return {key: sorted(set(others)) for key, others in found.items()}

    def groups(self) -> list[list[str]]:
        """Keys of each undetermined direction, in a sparse basis of the null space."""
        return [[self.keys[k] for k in self._members(row)] for row in self._short()]

    def exact_groups(self) -> list[list[str]]:
        """Keys of each direction in which no measurement changes."""
        return self.groups()[: len(self.exact)]

    def weak_groups(self) -> list[list[str]]:
        """Keys of each other undetermined direction."""
        return self.groups()[len(self.exact) :]

    def _members(self, row):
        """Indices of the parameters in a direction, by their individual effect on the measurements."""
        part = np.abs(row) * self.weight
        if (
            part.max() < 1
        ):  # no parameter of it changes a measurement: a single parameter without effect
            return [int(np.argmax(np.abs(row)))]
        part = (part / part.max()).round(
            6
        )  # of equals the first comes first, whatever rounding left of them
        return [int(k) for k in np.argsort(-part, kind="stable") if part[k] > _PART]

    def _short(self):
        """(F - rank, F) rows that span the null space, each with a pivot parameter.

        Exact null directions come first and separately. They are not mixed with directions that these
        samples determine only weakly.
        """
        exact, pivots = _echelon(self.exact)
        remaining = self.null.T - self.null.T[:, pivots] @ exact
        basis = thin_svd(remaining)[2][: max(len(remaining) - len(exact), 0)]
        return np.concatenate([exact, _echelon(basis)[0]])

    def sentences(self) -> list[str]:
        """The null space in words, one sentence per undetermined direction."""
        label = dict(zip(self.keys, self.labels))
        return [
            self.alone(group[0])
            if len(group) == 1
            else confounded_sentence([label[k] for k in group])
            for group in self.groups()
        ]

    def alone(self, key: str) -> str:
        """Sentence on a parameter that is not identifiable and not confounded with others."""
        k = self.keys.index(key)
        if self.weight[k] < _NO_EFFECT:
            return f"{self.labels[k]} has no effect on these measurements"
        size = self.typical[k] / self.weight[k]
        unit = self.units[k]
        if unit == "rad" and size < 1e-3:
            size, unit = 1e3 * size, "mrad"
        detection_limit = f"{size:.2g} {unit}"
        return f"{self.labels[k]} has too small an effect here: it is detectable only from about {detection_limit}"

    def observability(self, samples: int) -> dict[str, float]:
        """O1-O5 of the determined directions, columns scaled by their typical sizes.

        O1 (Borm & Menq 1991) (prod s)^(1/r) / sqrt(n), O2 (Driels & Pathre 1990) s_min / s_max,
        O3 (Nahvi et al. 1994) s_min, O4 (Nahvi & Hollerbach 1996) s_min^2 / s_max, O5 (Sun &
        Hollerbach 2008) 1 / sum(1/s), as collected by Sun & Hollerbach, ICRA 2008.
        """
        s = self.singular[len(self.keys) - self.rank :]
        if not s.size:
            return dict.fromkeys(("O1", "O2", "O3", "O4", "O5"), 0.0)
        low = float(s[0])
        high = float(s[-1])
        mean = float(np.exp(np.log(s).mean()) / np.sqrt(samples))
        return {
            "O1": mean,
            "O2": low / high,
            "O3": low,
            "O4": low**2 / high,
            "O5": float(1 / (1 / s).sum()),
        }


def identifiability(
    normal: np.ndarray, parameters: Parameters, scale: float = 1.0
) -> Identifiability:
    """From the whitened normal matrix (F, F) of the data and the free parameters, in their own units.

    scale: ratio of the residuals to their stated sigmas; the information is reduced accordingly.
    """
    mask = parameters.mask
    typical = parameters.typical[mask]
    scaled = normal * np.outer(typical, typical) / max(scale, _LEAST_SCALE) ** 2
    values, vectors = symmetric_eigen((scaled + scaled.T) / 2)
    if len(values):
        rounding = 1e-14 * len(values) * max(values[-1], 0)
    else:
        rounding = 0
    singular = np.sqrt(np.maximum(np.where(values < rounding, 0, values), 0))
    rank = int((singular >= 1).sum())
    weight = np.sqrt(np.maximum(np.diag(scaled), 0))
    prior = parameters.precision[mask] * typical**2 + _FAINT
    covariance = covariance_of(scaled, prior) * np.outer(typical, typical)
    table = [p for p, free in zip(parameters.table, mask) if free]
    names = (
        tuple(p.key for p in table),
        tuple(p.label or p.key for p in table),
        tuple(p.unit for p in table),
    )
    return Identifiability(
        *names, typical, singular, vectors, rank, covariance, weight, _exact(scaled, weight)
    )


def _exact(scaled, weight):
    """(E, F) null directions of the matrix with columns of unit length, back in typical sizes."""
    has_effect = _has_effect(weight)
    length = np.where(has_effect, weight, 1)
    matrix = scaled * np.outer(has_effect, has_effect) / np.outer(length, length)
    values, vectors = symmetric_eigen(matrix)
    return (vectors[:, values < _SAME] / length[:, None]).T


def _has_effect(weight):
    """Whether columns of length `weight` are more than what rounding leaves of a column of zeros."""
    return weight > max(_NO_EFFECT, _ROUNDING * weight.max(initial=0.0))


def _echelon(rows):
    """The same row space with one column of its own for each row, largest entry 1; and those columns."""
    if not len(rows):
        return rows, []
    weight = 1 + 1e-3 * np.arange(rows.shape[1])  # of equals the later one gives its name
    pivots = qr(rows * weight, pivoting=True, mode="r")[1][: len(rows)]
    return least_squares(rows[:, pivots], rows), pivots


def independent(
    normal: np.ndarray, parameters: Parameters, scale: float = 1.0, redundant: Collection[str] = ()
) -> tuple[Parameters, dict[str, list[str]]]:
    """Parameters with only an independent set free, and for each one left out what it is tied to.

    Goes through the free ones, those without a prior (base, tool) first and then in order, and
    leaves out each whose column is a linear combination of earlier ones: parameters about which nothing
    was known carry what is not identifiable. Keys in `redundant` come last. They are parameters that
    the convention replaces by others (beta between axes that are not parallel): an independent set
    that holds one instead of a length represents millimetres by large angles on short levers.
    """
    free = np.flatnonzero(parameters.mask)
    has_prior = parameters.precision[free] > 0
    comes_last = np.isin(np.array(parameters.keys)[free], list(redundant))
    free = free[np.lexsort((has_prior, comes_last))]
    typical = parameters.typical[free]
    place = np.searchsorted(np.flatnonzero(parameters.mask), free)
    scaled = (
        normal[np.ix_(place, place)] * np.outer(typical, typical) / max(scale, _LEAST_SCALE) ** 2
    )
    retained, left_out = _greedy(scaled)
    mask = np.zeros(len(parameters), bool)
    mask[free[retained]] = True
    keys = [parameters.keys[k] for k in free]
    weight = np.sqrt(np.maximum(np.diag(scaled), 0))
    tied = {
        keys[k]: _partners(mix * weight[retained[: len(mix)]], keys, retained)
        for k, mix in left_out.items()
    }
    return parameters.only(mask), tied


def _partners(part, keys, retained):
    """Keys of the kept parameters that make a left-out one, the main ones first."""
    part = np.abs(part)
    return [
        keys[retained[j]]
        for j in np.argsort(-part, kind="stable")
        if part[j] > max(_PART * part.max(), 1e-9)
    ]


def _greedy(scaled):
    """Indices kept, and for each one left out its mix of the kept (Cholesky, column by column)."""
    retained = []
    left_out = {}
    lower = np.zeros_like(scaled)
    norms = np.sqrt(np.maximum(np.diag(scaled), 0))
    for k in range(len(scaled)):
        size = len(retained)
        factor = lower[:size, :size]
        row = _solve_lower(factor, scaled[retained, k])
        pivot = scaled[k, k] - row @ row
        mix = _solve_lower(factor, row, transposed=True)
        # rounding of the entries, as the mix of nearly dependent columns amplifies it: it is no information
        rounding = _AMPLIFIED * (norms[k] + np.abs(mix) @ norms[retained]) ** 2
        if pivot > max(_CONFOUNDED, rounding):
            lower[size, :size], lower[size, size] = row, np.sqrt(pivot)
            retained.append(k)
        else:
            left_out[k] = mix
    return retained, left_out


def _solve_lower(factor: np.ndarray, right: np.ndarray, transposed: bool = False) -> np.ndarray:
    """L^-1 b or, transposed, L^-T b for a lower triangular L (K, K); an empty array where K is 0."""
    if not len(factor):
        return np.zeros(0)
    return solve_triangular(factor, right, trans=int(transposed), lower=True, check_finite=False)


def confounded_sentence(labels: Sequence[str]) -> str:
    """A combination of parameters, by their labels, that is not identifiable."""
    first, *others = labels
    if len(others) == 1:
        return f"{first} and {others[0]} are confounded: only a combination of them is identifiable"
    return f"{first} is confounded with a combination of {_listed(others)}"


def _listed(labels: Sequence[str]) -> str:
    """Two labels or more as a list in words, the last ones by their number where they are many."""
    if len(labels) > _NAMED:
        shown = labels[: _NAMED - 1]
        labels = [*shown, f"{len(labels) - len(shown)} more"]
    return ", ".join(labels[:-1]) + f" and {labels[-1]}"
