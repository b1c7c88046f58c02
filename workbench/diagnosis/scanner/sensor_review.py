"""Findings of a sensor and the effects that are confounded with them to first order.

A mirror's parameters absorb nearly all of a wobble. A wobble that is detected is therefore large, and its linearisation
at zero explains only about nine tenths of it. Such a difference of gains is no evidence for one effect, nor for a
smooth nonparametric alternative against a large effect: in a solution with the function the effect seems small.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.diagnosis.linear.candidates import Candidate
from workbench.diagnosis.linear.hypotheses import Hypothesis, ranked_hypotheses
from workbench.diagnosis.linear.problem import Alternative, Bench, Finding, Found, Problem

_LARGE = 20.0
"""Typical sizes beyond which an effect is no longer linear, nor small compared with what the baseline moves by."""
_REACH = 0.1  # share of the gain by which first order is wrong then


def reviewed(bench: Bench, found: Found, samples: np.ndarray | None = None) -> Found:
    """The same, with confounded effects of each named finding added if one of the two would have to be large."""
    findings = list(found.findings)
    for i, finding in enumerate(findings):
        if finding.effects:
            others = [e for j, f in enumerate(findings) if j != i for e in f.effects]
            findings[i] = _with_alternatives(
                bench, bench.problem(others, samples).conditional_on(), finding
            )
    return replace(found, findings=tuple(findings))


def _with_alternatives(bench, bare: Problem, finding: Finding) -> Finding:
    table = ranked_hypotheses(bare)
    tested = next(
        (h for h in table if (*h.key, h.label) == (finding.effect, finding.where, finding.label)),
        None,
    )
    named = [h for h in table if not h.smooth_covariates]
    if tested is None:
        alternatives = []
    else:
        alternatives = (_laws if tested.smooth_covariates else _confounded_effects)(
            bench, bare, named, tested
        )
    if not alternatives:
        return finding
    weights = np.array(
        [
            np.logaddexp.reduce([h.log_prior for h in table if h.key == other.key])
            for other in (tested, *alternatives)
        ]
    )
    shares = np.exp(weights - np.logaddexp.reduce(weights))
    return _finding_among(finding, tested, alternatives, shares)


def _confounded_effects(
    bench, bare: Problem, table: Sequence[Hypothesis], tested: Hypothesis
) -> list[Hypothesis]:
    """The most probable variant of each other effect with a gain within reach, where it or the finding is large."""
    best: dict[tuple, Hypothesis] = {}
    for h in table:
        if h.key != tested.key and abs(h.gain - tested.gain) < _REACH * max(h.gain, tested.gain):
            best.setdefault(h.key, h)
    if not best or large(bench, bare, tested):
        return list(best.values())
    return [h for h in best.values() if large(bench, bare, h)]


def _laws(
    bench, bare: Problem, named: Sequence[Hypothesis], tested: Hypothesis
) -> list[Hypothesis]:
    """Laws that would be large at the place of a smooth alternative, and are more probable than it about nothing."""
    best: dict[tuple, Hypothesis] = {}
    for h in named:
        if h.where == tested.where and h.log_weight > tested.log_weight and large(bench, bare, h):
            best.setdefault(h.key, h)
    return list(best.values())


def large(bench, bare: Problem, h: Hypothesis) -> bool:
    """Whether the least values that make what is there exceed what is typical by far."""
    if not isinstance(h.source, Candidate):
        return False
    columns = h.columns(bare)
    values = np.linalg.lstsq(
        bare.orthogonalise(columns), bare.orthogonalise(bare.residual), rcond=1e-3
    )[0]
    typical = bench.typical(h.effects[0])
    sizes = values * h.source.typical / typical
    return bool((np.abs(sizes) > _LARGE).any())


def _finding_among(finding: Finding, tested: Hypothesis, alternatives, shares) -> Finding:
    """The finding with its confounded effects as alternatives; probabilities are the prior ones."""
    names = {h.key for h in (tested, *alternatives)}
    unchanged = tuple(a for a in finding.alternatives if (a.effect, a.where) not in names)
    shared = 1 - sum(a.probability for a in unchanged)
    confounded = [
        Alternative(
            *h.key,
            h.label,
            float(shared * share),
            float(min(1.0, h.gain / max(tested.gain, 1e-300))),
            "one of the two would be so large that to first order they are confounded",
            h.missing_covariate,
        )
        for h, share in zip(alternatives, shares[1:])
    ]
    return replace(
        finding, probability=float(shared * shares[0]), alternatives=(*confounded, *unchanged)
    )
