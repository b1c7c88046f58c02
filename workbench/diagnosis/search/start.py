"""The start of a search inside a fold: the terms of the search on all samples, without what they were found on.

The search inside a fold has all moves of any search, and climbs from nothing as well. A start decides only which of
several local maxima of the posterior is reached, and saves the way to it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.diagnosis.linear.candidates import Candidate, Scan, Source
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.search.state import Search


def without_samples(terms: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """The terms without columns and covariates of samples: small, and nothing of a sample is left in them."""
    return tuple(replace(h, source=_without_samples(h.source)) for h in terms)


def _without_samples(source: Source) -> Source:
    if isinstance(source, Candidate):
        return replace(source, columns=source.columns[:0])
    rows = source.rows[:, :0]
    if not isinstance(source, Scan):
        return replace(source, rows=rows)
    kept = slice(None) if source.is_exact else slice(0)
    return replace(
        source,
        rows=rows,
        x=source.x[:0],
        options=source.options[kept],
        prior_weight=source.prior_weight[kept],
        make=None,
    )


def start_from(search: Search, terms: Sequence[Hypothesis]) -> None:
    """Accept the terms of another search, as far as the problem of this one has them, and solve with them."""
    search.accepted = tuple(terms)
    search.solve_feasible()
    values = [h.value for h in search.accepted]
    present = [h.at(search.problem) for h in search.accepted]
    search.accepted = tuple(_at_own_instant(h) for h in present if h is not None)
    if [h.value for h in search.accepted] != values:
        search.solve_feasible()


def _at_own_instant(h: Hypothesis) -> Hypothesis:
    """A step at the nearest instant that its samples distinguish: the exact one is known from others."""
    scan = h.source
    if not isinstance(scan, Scan) or scan.kind != "step" or h.value in scan.options:
        return h
    value = float(scan.options[int(np.argmin(np.abs(scan.options - h.value)))])
    return replace(h, label=scan.word.format(value), effects=scan.make(value), value=value)
