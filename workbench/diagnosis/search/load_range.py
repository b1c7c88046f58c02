"""Masses of an unrecorded load that the recorded poses do not exclude, next to an accepted compliance.

With the compliance l, the moments L of the links, m M of the load's mass and H h of its first moment, the deflection is
l (L + m M + H h). For a given mass m it is linear in l and in the product l h, so that the sum of squares, minimised
over both, is a profile over m alone. A range is the set of masses whose sum of squares exceeds the least by no more
than the quantile of a chi-square distribution (Venzon & Moolgavkar, Appl. Stat. 37 (1988) 87).
"""

from dataclasses import dataclass

import numpy as np

from workbench.core.distributions import chi2
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.diagnosis.levels import CONFIDENCE, ROUNDING

_MASSES = np.concatenate([[0.0], np.geomspace(0.01, 1000.0, 101)])
"""kg: the largest stands for any mass, next to which the links weigh nothing."""


@dataclass(frozen=True)
class MassRange:
    """Lowest and highest mass (kg) of a load that the poses do not exclude; `high` is inf where they exclude none."""

    low: float
    high: float

    @property
    def words(self) -> str:
        """The range as a part of a sentence: "a mass of 0.5 to 6 kg"."""
        if not np.isfinite(self.high):
            return self._words_unbounded
        if self.low > 0:
            return f"a mass of {self.low:.2g} to {self.high:.2g} kg"
        return f"a mass of up to {self.high:.2g} kg"

    @property
    def _words_unbounded(self) -> str:
        if self.low > 0:
            return f"any mass above {self.low:.2g} kg"
        return "any mass: it is not determined"


def mass_range(
    links: np.ndarray, load: np.ndarray, residual: np.ndarray, variance: float
) -> MassRange:
    """The range of masses of a load with a probability of 95 %.

    links (N,): deflection under the links at the estimated compliance; load (4, N): its change by a mass (kg) and a
    first moment of the load; residual (N,) without both; variance: of one of its numbers. The baseline and other laws
    are projected out of all.
    """
    squares = np.array([_remaining(links + mass * load[0], load[1:], residual) for mass in _MASSES])
    limit = squares.min() + chi2.ppf(CONFIDENCE, 1) * variance
    allowed = _MASSES[squares <= limit]
    high = np.inf if allowed[-1] == _MASSES[-1] else float(allowed[-1])
    return MassRange(float(allowed[0]), high)


def _remaining(deflection: np.ndarray, moments: np.ndarray, residual: np.ndarray) -> float:
    """Sum of squares that a compliance and a centre leave."""
    columns = _normalised(np.column_stack([deflection, *moments]))
    left = residual - columns @ least_squares(columns, residual, ROUNDING)
    return float(left @ left)


def _normalised(columns: np.ndarray) -> np.ndarray:
    """(N, P) columns of length 1."""
    return columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)


__all__ = ["MassRange", "mass_range"]
