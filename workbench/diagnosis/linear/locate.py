"""Where along the chain a mismatch sits: what smooth functions at each place explain of it."""

from collections.abc import Sequence

from workbench.diagnosis.linear.hypotheses import Hypothesis, ranked_hypotheses
from workbench.diagnosis.linear.problem import Located, Problem


def located(problem: Problem, table: Sequence[Hypothesis] | None = None) -> tuple[Located, ...]:
    """Each place with the covariate whose smooth function explains most there, the clearest first.

    `share`: of what the residual holds beyond noise (the unit variance that the degrees of freedom
    leave is taken off both). `p_value`: of the best function at the place over all places and covariates.
    """
    table = ranked_hypotheses(problem) if table is None else table
    best: dict[tuple, Hypothesis] = {}
    for h in table:
        if h.smooth_covariates and (
            (at := (h.where, _port(h))) not in best or h.evidence > best[at].evidence
        ):
            best[at] = h
    yy = float((problem.orthogonalise(problem.residual) ** 2).sum())
    noise = yy / max(problem.degrees, 1)
    rows = [
        Located(
            *at,
            h.smooth_covariates,
            max(0.0, h.gain - h.rank * noise) / max(yy, 1e-300),
            min(1.0, h.p / h.weight),
            float((h.gain / len(problem.sample)) ** 0.5),
        )
        for at, h in best.items()
    ]
    return tuple(sorted(rows, key=lambda row: (row.p_value, -row.share)))


def _port(h: Hypothesis) -> str:
    """The port of a smooth nonparametric alternative; one of which only the period is known moves a frame."""
    return getattr(h.source, "port", "frame")
