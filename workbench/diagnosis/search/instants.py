"""The instant at which a step begins, and how well it is known: its posterior over all instants that were tried."""

import numpy as np
from scipy.special import logsumexp

from workbench.diagnosis.linear.estimates import Instant
from workbench.diagnosis.linear.evidence import Projected, scan_moments
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.linear.problem import Scan


def instant_of(search, i: int, own: Hypothesis) -> Instant | None:
    """Instant of an accepted hypothesis, `own` as it is judged next to the others; None where it begins at none.

    The uncertainty is the RMS distance of all instants, by their posterior, and the gap between the two samples about
    the one that is stated, anywhere in which the step may be.
    """
    if not own.effects or getattr(own.effects[0], "after", None) is None:
        return None
    scan, value = own.source
    here = search.problem.sources.get(scan.key, scan)
    projected = Projected(search.problem.conditional_on(search.others(i)))
    evidence = projected.judge(scan_moments(projected, here)).evidence
    logs = evidence + np.log(np.maximum(here.mass, 1e-300))
    weights = np.exp(logs - logsumexp(logs))
    spread = float(weights @ (here.options - value) ** 2)
    std = float(np.sqrt(spread + _gap(here, value) ** 2 / 12))
    is_timed = "time_s" in search.bench.chain.state.covariates
    return Instant(value, std, "s" if is_timed else "sample")


def _gap(scan: Scan, value: float) -> float:
    """Distance between the samples before and after an instant."""
    return float(scan.x[scan.x > value].min() - scan.x[scan.x <= value].max())


__all__ = ["instant_of"]
