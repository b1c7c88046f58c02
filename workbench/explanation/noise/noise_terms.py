"""Terms that state the noise of a recording: outliers, random effects, heteroscedasticity."""

import numpy as np

from workbench.core.common_effects import NoiseLaw
from workbench.diagnosis.levels import RANDOM_EFFECT_LEVEL, UNMODELLED_LEVEL
from workbench.diagnosis.linear.problem import Finding, Found
from workbench.diagnosis.noise.random_effects import find_random_effect
from workbench.explanation.final_model import unwhitened
from workbench.explanation.result import Term

_UNEVEN = NoiseLaw.effect


def noise_terms(found: Found, terms, refused, problem) -> tuple[Term, ...]:
    """Findings on the noise, which have no mean to be held out: their p-value is valid over the whole search.

    If a term of the mean was rejected, only outliers and a persisting random effect are kept.
    """
    noise_findings = found.noise_findings
    if refused and noise_findings:
        moves = find_random_effect(problem, RANDOM_EFFECT_LEVEL)
        random_place = moves.site.where if moves else None
        noise_findings = [
            f for f in noise_findings if f.effect == "outliers" or f.where == random_place
        ]
    if (
        not terms
        and found.p_first <= UNMODELLED_LEVEL
        and {f.effect for f in noise_findings} <= {_UNEVEN, "outliers"}
    ):
        # a mean that nothing explains makes the noise heteroscedastic, too
        noise_findings = [f for f in noise_findings if f.effect != _UNEVEN]
    return tuple(Term(finding, size=_spread_size(finding, problem)) for finding in noise_findings)


def _spread_size(finding: Finding, problem) -> float | None:
    """RMS displacement (mm, px) of what a place does by chance, from its size in sigmas; None of all other noise."""
    if not finding.size:
        return None
    return float(finding.size * np.sqrt((unwhitened(problem) ** 2).sum() / problem.n))


__all__ = ["noise_terms"]
