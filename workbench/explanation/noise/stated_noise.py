"""Whether the noise that a recording states is the noise that it has.

Two estimates are compared with the stated standard deviation: the scatter of replicates, which needs no model, and the
residual of the final model, where no structure is left in it. The test is one of the variance, with a standard error
from the samples themselves, so that heavy tails do not count as a wrong statement (Box, Biometrika 40 (1953) 318, on
the sensitivity of the chi-square test to kurtosis).
"""

from dataclasses import dataclass, replace

import numpy as np

from workbench.core.distributions import chi2, fisher, student
from workbench.core.least_squares.linear_algebra import symmetric_eigen
from workbench.diagnosis.levels import DATA_FAULT_LEVEL, ROUNDING
from workbench.diagnosis.linear.problem import Alternative, Finding
from workbench.explanation.noise.replicates import FROM_REPLICATES, LEAST_REPEATS, replicates

EFFECT = "stated-noise"
WHERE = "noise"
RELEVANT = 1.25
"""Ratio of standard deviations from which on a wrong statement matters: noise is seldom known better."""
_EXCESS = 1.1  # from which on a residual is above the noise, which is hardly ever known to a tenth
_QUANTILES = (0.5, 0.9)
FROM_RESIDUALS = "from residuals"


@dataclass(frozen=True)
class NoiseRatio:
    """Found over stated standard deviation: `factor`, its standard error, p-value that it is 1, and the `source`.

    `agreed`: the factor nearest to 1 of several estimates, which decides whether the statement is wrong.
    """

    factor: float
    error: float
    p_value: float
    source: str
    agreed: float

    @property
    def is_wrong(self) -> bool:
        """Whether the statement is wrong beyond chance and by more than matters."""
        return self.p_value < DATA_FAULT_LEVEL and abs(np.log(self.agreed)) > np.log(RELEVANT)


@dataclass(frozen=True)
class StatedNoise:
    """Estimate that is compared with the stated noise.

    white (m, n): residuals of the final model over the stated sigma, not weighted; degrees: their degrees of freedom;
    inliers (n,) bool: not an outlier; pose (n,): labels of repeated poses; index (n,): target of each sample.
    shares (n, m, m): covariance of the residual of each sample where the noise has the unit matrix, which is less what
    the fit follows at this sample; None: the same everywhere.
    """

    white: np.ndarray
    degrees: float
    inliers: np.ndarray
    pose: np.ndarray
    index: np.ndarray
    shares: np.ndarray | None = None

    @property
    def studentised(self) -> np.ndarray:
        """(m, n) residuals of equal variances (Cook & Weisberg, Residuals and Influence in Regression, 1982, ch. 2).

        A coordinate that the fit follows exactly has no residual, and counts as zero.
        """
        if self.shares is None:
            return self.white
        values, vectors = symmetric_eigen(self.shares)
        coordinates = np.einsum("nmk,mn->nk", vectors, self.white)
        is_free = values > ROUNDING
        scaled = np.where(is_free, coordinates / np.sqrt(np.where(is_free, values, 1.0)), 0.0)
        return np.einsum("nmk,nk->mn", vectors, scaled)

    def from_residuals(self) -> NoiseRatio | None:
        """The ratio from the residual of the final model; None without degrees of freedom."""
        share = self.degrees / self.white.size
        if not self.degrees >= len(self.white):
            return None
        mean_squares = (self.white**2).mean(0) / share
        return _ratio(
            mean_squares, len(self.white), self.pose, self.inliers, self.degrees, FROM_RESIDUALS
        )

    def from_replicates(self) -> NoiseRatio | None:
        """The ratio from the scatter of repeats of one pose and target; None where there are too few."""
        group, free = replicates(self.pose, self.index, self.white)
        count = np.bincount(group)[group]
        if free < LEAST_REPEATS * len(self.white):
            return None
        repeated = count > 1
        means = np.stack(
            [(np.bincount(group, row) / np.bincount(group))[group] for row in self.white]
        )
        mean_squares = ((self.white - means) ** 2).mean(0) * count / np.maximum(count - 1, 1)
        m = len(self.white)
        pose = self.pose[repeated]
        inliers = self.inliers[repeated]
        return _ratio(mean_squares[repeated], m, pose, inliers, free, FROM_REPLICATES)

    def lack_of_fit(self) -> float:
        """p-value that the residual is no larger than the scatter of replicates; 1 without replicates."""
        found = self.from_residuals()
        repeats = self.from_replicates()
        if found is None or repeats is None or not found.factor > RELEVANT * repeats.factor:
            return 1.0
        _, free = replicates(self.pose, self.index, self.white)
        poses = len(self.white) * len(np.unique(self.pose))
        return float(
            fisher.sf(
                (found.factor / repeats.factor) ** 2, max(min(self.degrees, poses), 1.0), free
            )
        )

    def is_exceeded(self) -> bool:
        """Whether the residual is larger than the noise, beyond chance: that of replicates, else the stated one."""
        if self.from_replicates() is not None:
            return self.lack_of_fit() < DATA_FAULT_LEVEL
        found = self.from_residuals()
        return found is not None and found.agreed > _EXCESS and found.p_value < DATA_FAULT_LEVEL


def _ratio(
    mean_squares: np.ndarray,
    m: int,
    pose: np.ndarray,
    inliers: np.ndarray,
    degrees: float,
    source: str,
) -> NoiseRatio:
    """The ratio from mean squares (n,) of samples of m coordinates, in units of the stated variance."""
    factors = np.sqrt(_variances(mean_squares, m, inliers))
    agreed = _agreed(factors)
    factor = float(factors[1])
    usable = mean_squares[inliers] if inliers.any() else mean_squares
    _, group = np.unique(pose[inliers] if inliers.any() else pose, return_inverse=True)
    sums = np.bincount(group, usable - usable.mean())  # repeats of one pose may err together
    spread = float(np.sqrt((sums**2).sum()) / max(usable.sum(), 1e-300))
    normal = float(np.sqrt(2.0 / max(degrees, 1.0)))
    relative = 0.5 * max(spread, normal)  # of the standard deviation: half of that of the variance
    t = abs(np.log(agreed)) / max(relative, 1e-300)
    p = 2 * float(student.sf(t, max(min(len(sums) - 1, degrees), 1.0)))
    return NoiseRatio(factor, factor * relative, max(p, 1e-300), source, agreed)


def _variances(mean_squares: np.ndarray, m: int, inliers: np.ndarray) -> np.ndarray:
    """(4,) variance over the stated one: of all samples, of all but outliers, and of the bulk by two quantiles."""
    inner = mean_squares[inliers] if inliers.any() else mean_squares
    bulk = [m * np.quantile(mean_squares, q) / chi2.ppf(q, m) for q in _QUANTILES]
    return np.maximum([mean_squares.mean(), inner.mean(), *bulk], 1e-300)


def _agreed(factors: np.ndarray) -> float:
    """The factor that all estimates agree on: the one nearest to 1, and 1 where they lie on both sides of it.

    Outliers and heavy tails move the RMS, a mixture of instruments the quantiles; a wrong sigma moves all alike.
    """
    if (factors > 1).all():
        return float(factors.min())
    if (factors < 1).all():
        return float(factors.max())
    return 1.0


def compare(stated: StatedNoise, structure_left: bool) -> NoiseRatio | None:
    """The wrong statement, from replicates where there are enough, else from residuals without structure; else None.

    Structure only adds to the noise: a sigma above such a residual is stated too large all the same.
    """
    found = stated.from_replicates() or stated.from_residuals()
    if found is not None and structure_left and found.source == FROM_RESIDUALS and found.factor > 1:
        return None
    return found if found is not None and found.is_wrong else None


def finding_of(found: NoiseRatio, alternatives: tuple[Alternative, ...] = ()) -> Finding:
    """The finding of a wrong statement, with laws that the residual may hold instead."""
    label = f"{found.factor:.3g} times the stated sigma, {found.source}"
    probability = 1.0 - found.p_value - sum(law.probability for law in alternatives)
    finding = Finding(EFFECT, WHERE, label, (), found.p_value, probability, 0.0, 0.0)
    return replace(finding, alternatives=alternatives)


def parameters_of(found: NoiseRatio) -> tuple[dict, ...]:
    """The factor as a row of parameters."""
    row = {
        "key": "noise.stated-noise.factor",
        "name": "factor",
        "where": WHERE,
        "label": "noise found over noise stated",
        "effect": EFFECT,
        "value": found.factor,
        "std": found.error,
        "unit": "1",
        "typical": 1.0,
        "size_mm": None,
    }
    return (row,)


__all__ = ["EFFECT", "NoiseRatio", "StatedNoise", "compare", "finding_of", "parameters_of"]
