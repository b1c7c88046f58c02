"""Whether the noise has heavier tails than a Gaussian, and its RMS then, which the stated sigma may not hold.

A sigma that describes most samples says little of the RMS of such noise, which a few samples make.
"""

import numpy as np

from workbench.diagnosis.levels import DATA_FAULT_LEVEL
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.noise.outliers import tails
from workbench.diagnosis.validation.terms import Term
from workbench.explanation.noise.stated_noise import StatedNoise

EFFECT = "noise-heavy-tailed"
_LIGHTEST = 8.0
"""Degrees of freedom from which on the RMS of the noise is less than 1.15 times the sigma that fits most samples."""


def heavy_tails(stated: StatedNoise) -> Term | None:
    """The finding that inliers have Student's noise and no Gaussian, with degrees of freedom and RMS; else None.

    Its p-value is one over the Bayes factor, by Markov's inequality; a term of the mean is to be left by none. The
    residuals are studentised: a fit with few degrees of freedom leaves Gaussian noise of many different variances, and
    a mixture of these has heavy tails.
    """
    log_factor, degrees, std = tails(stated.studentised[:, stated.inliers])
    level = stated.from_residuals()
    if log_factor < -np.log(DATA_FAULT_LEVEL) or degrees > _LIGHTEST or level is None:
        return None
    p = max(float(np.exp(-log_factor)), 1e-300)
    label = f"Student's t, {degrees:.2g} degrees of freedom"
    rows = (
        _row("degrees", "degrees of freedom of Student's t distribution", degrees, std),
        _row("factor", "RMS of the noise over the stated sigma", level.factor, level.error),
    )
    finding = Finding(EFFECT, "noise", label, (), p, 1.0 - p, 0.0, 0.0)
    return Term(finding, rows)


def _row(name: str, label: str, value: float, std: float) -> dict:
    description = {"key": f"noise.{EFFECT}.{name}", "name": name, "where": "noise", "label": label}
    of_value = {"value": value, "std": std, "unit": "1", "typical": 1.0, "size_mm": None}
    return {**description, "effect": EFFECT, **of_value}


__all__ = ["EFFECT", "heavy_tails"]
