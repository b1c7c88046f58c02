"""Whether the noise of an external instrument grows with the range, or is larger across the sight line than along it.

The range of a tracker is known better than its angles, whose error grows with the range. Along and across are compared
sample by sample by the logarithms of their squares: both have the same distribution where the noise has no direction,
whatever its tails and however it changes from sample to sample, so that the mean difference is zero.
"""

import numpy as np

from robot_model.effects.instrument import AngularNoise, sight_lines
from workbench.core.common_effects import NoiseLaw
from workbench.core.distributions import norm
from workbench.diagnosis.levels import DATA_FAULT_LEVEL
from workbench.diagnosis.linear.problem import Finding
from workbench.explanation.result import Term

_ISOTROPIC = 1.01  # ratio of stated sigmas of a sample's axes up to which they are equal
_MIN_SAMPLES = 30  # samples
_ROUNDING = 1e-12  # of the mean square, below which the logarithm of a square is rounding


def with_angular_noise(terms: tuple[Term, ...], bench, residual: np.ndarray, inliers: np.ndarray):
    """The terms with that of angular noise, where it is more probable than noise that depends on another covariate.

    residual (m, n): of a model that leaves no structure, its first three rows the position, mm, in the instrument's
    frame; inliers (n,) bool: not an outlier. Only where an external instrument measures points or poses, and the stated
    sigma is the same along all axes.
    """
    found = angular_noise(bench, residual[:3], inliers)
    others = [term for term in terms if term.finding.effect == NoiseLaw.effect]
    if found is None or any(term.finding.p_value < found.p_value for term in others):
        return terms
    return (*(term for term in terms if term not in others), Term(found))


def angular_noise(bench, residual: np.ndarray, inliers: np.ndarray) -> Finding | None:
    """The finding that the noise of position residuals (3, n) is angular, or None; arguments as above."""
    if bench.chain is None or not bench.chain.places("instrument") or len(residual) != 3:
        return None
    stated = bench.chain.stated_sigma[:3]
    if inliers.sum() < _MIN_SAMPLES or not (stated.max(0) <= _ISOTROPIC * stated.min(0)).all():
        return None
    sight, distance = (part[..., inliers] for part in sight_lines(bench.chain.state))
    p, ratio = direction_test(residual[:, inliers], sight)
    p_range, exponent = range_test(residual[:, inliers], distance)
    labels = [
        (p if ratio > 1 else 1.0, f"{ratio:.2g} times as large across the sight line as along it"),
        (p_range if exponent > 0 else 1.0, f"with the range to the power {exponent:.2g}"),
    ]
    min_p, label = min(labels)
    if 2 * min_p > DATA_FAULT_LEVEL:
        return None
    return Finding(
        AngularNoise.effect, "noise", label, (), 2 * min_p, 1 - 2 * min_p, 0.0, 0.0, ("range",)
    )


def range_test(residual: np.ndarray, distance: np.ndarray) -> tuple[float, float]:
    """p-value that noise (3, n) does not change with the range (n,), and the exponent with which it does.

    Ordinary least squares of the mean logarithm of the squares on twice the logarithm of the range (Harvey,
    Econometrica 44 (1976) 461), with the standard error of the residuals of that line.
    """
    rounding = _ROUNDING * float((residual**2).mean())
    logs = np.log(residual**2 + rounding).mean(0)
    x = 2 * np.log(distance)
    x = x - x.mean()
    squares = float(x @ x)
    if squares < _ROUNDING * len(x):
        return 1.0, 0.0
    slope = float(x @ logs) / squares
    remainder = logs - logs.mean() - slope * x
    error = np.sqrt(float(remainder @ remainder) / (len(x) - 2) / squares)
    return float(2 * norm.sf(abs(slope) / error)), slope


def direction_test(residual: np.ndarray, sight: np.ndarray) -> tuple[float, float]:
    """p-value that noise is the same along and across the sight line, and the ratio of standard deviations.

    residual (3, n) mm; sight (3, n) unit vectors. The ratio is across over along.
    """
    radial = (residual * sight).sum(0)
    axis_choice = np.where(np.abs(sight[2]) < 0.9, 1.0, 0.0)
    helper = np.stack([1 - axis_choice, np.zeros_like(axis_choice), axis_choice])
    first = np.cross(sight.T, helper.T).T
    first /= np.linalg.norm(first, axis=0)
    second = np.cross(sight.T, first.T).T
    transverse = [(residual * direction).sum(0) for direction in (first, second)]
    rounding = _ROUNDING * float((residual**2).mean())
    logs = [np.log(part**2 + rounding) for part in (radial, *transverse)]
    difference = (logs[1] + logs[2]) / 2 - logs[0]
    z = difference.mean() / (difference.std(ddof=1) / np.sqrt(len(difference)))
    ratio = np.sqrt(
        np.mean([part**2 for part in transverse]) / max(float((radial**2).mean()), 1e-300)
    )
    return float(2 * norm.sf(abs(z))), float(ratio)


__all__ = ["angular_noise", "direction_test", "range_test", "with_angular_noise"]
