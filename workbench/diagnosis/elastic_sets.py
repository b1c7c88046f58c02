"""Posterior over sets of elastic terms: which joints, links, bearings and pedestal deflect, with masses nearly known.

Bayesian variable selection with a closed-form marginal likelihood (George & McCulloch, Stat. Sinica 7 (1997) 339), the
posterior restricted to the sets near the best one (Occam's window: Madigan & Raftery, JASA 89 (1994) 1535). For a set
S with columns X of its compliances c, in the problem with the baseline projected out,

    y = X c + G(c) m + noise,   c ~ N(0, sigma^2 s^2 D^2), c >= 0,   m ~ N(0, sigma^2 I),

where G(c) = sum_e c_e R_e says what each first moment of a link, off by one standard deviation, changes in the
deflection. Masses are marginalised for every set alike. The scale s is common to all terms of a robot and summed over
a grid, so that the ratio of a link's compliance to that of joints under a like load is what the prior knows: joints of
industrial arms have 5 to 50 times the compliance of the link behind them (Dumas et al., Robot. Comput.-Integr. Manuf.
27 (2011) 881; Abele et al., CIRP Ann. 56 (2007) 387; Klimchik et al., Mech. Mach. Theory 107 (2017)).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import log_ndtr, logsumexp

from robot_model.effects import CATALOGUE
from robot_model.effects.elastic import JointCompliance
from robot_model.effects.transmission import TransmissionHarmonic
from workbench.core.least_squares.linear_algebra import (
    pseudo_inverse,
    solve_positive,
    symmetric_eigen,
)
from workbench.diagnosis.evidence import Projected
from workbench.diagnosis.problem import Candidate, Problem

_SCALES = np.geomspace(1e-7, 1e-2, 16)
"""Grid of the common scale s: compliance of a joint under 1 N m, rad/(N m); each is as likely as the others."""
_SIZE_BY_LOAD = -0.5
"""Exponent of the load (N m) that compliances scale with: stronger gears are stiffer, yet deflect more."""
_PRIORS = {
    kind.effect: kind.compliance_prior for kind in CATALOGUE.values() if kind.compliance_prior
}
"""Effect -> prior probability that it is of a size worth modelling, and its size relative to a joint's compliance."""
_HARMONIC = TransmissionHarmonic.effect
_HARMONIC_PRIOR = 0.05  # of the first order at one joint; its size is not tied to the compliances
_HARMONIC_SIZE = 1e-4  # rad, amplitude
_ANCHOR = 4.0  # degrees of freedom that the stated sigma is worth, as in `evidence`
_LAW_ERROR = 0.005
"""Relative error of every deflection that is computed: torques from joint angles that are off by 0.3 degrees."""
_WINDOW = float(
    np.log(200.0)
)  # posterior odds against the best set beyond which a set is left out of the posterior
_STEPS = 12  # moves of the climb
_EXPANDED = 6  # sets of the window whose neighbours are looked at, too
_SWAPS = 6  # absent terms that are tried in place of each present one, the most alike first

Key = tuple[str, str]


@dataclass(frozen=True)
class Term:
    """A term that a set may hold: its `key` (effect, where), columns in the Gram matrix, and `candidate`."""

    key: Key
    candidate: Candidate
    columns: np.ndarray
    responses: tuple[
        np.ndarray, ...
    ]  # for each column, the numbers of its mass responses; empty where it has none
    log_odds: float
    scale: np.ndarray
    tied: bool  # whether its size follows the common scale s
    positive: int


@dataclass
class ElasticSets:
    """Log posterior of sets of terms, from one Gram matrix; `seen` holds every set that was weighed."""

    terms: tuple[Term, ...]
    gram: np.ndarray
    score: np.ndarray
    yy: float
    degrees: float
    given: np.ndarray = field(
        default_factory=lambda: np.zeros(0, int)
    )  # columns of the baseline's own mass response
    seen: dict[frozenset, float] = field(default_factory=dict)

    @classmethod
    def of(cls, problem: Problem) -> "ElasticSets | None":
        """Of a problem that keeps none of its elastic terms; None where the robot has no mass-dependent term."""
        wanted = [c for c in problem.candidates if is_member(c.effect, c.effects)]
        if not any(c.effect in _PRIORS for c in wanted):
            return None
        projected = Projected(problem)
        responses = {(c.effect, c.where): c.columns for c in problem.mass_responses}
        blocks, terms, at = [], [], 0
        for candidate in wanted:
            own = np.arange(at, at + candidate.columns.shape[1])
            blocks.append(candidate.columns)
            at += len(own)
            made = responses.get((candidate.effect, candidate.where))
            numbers = ()
            if made is not None:
                each = made.shape[1] // len(own)
                numbers = tuple(
                    np.arange(at + i * each, at + (i + 1) * each) for i in range(len(own))
                )
                blocks.append(made)
                at += made.shape[1]
            terms.append(_term(candidate, own, numbers))
        given = _given_response(problem, responses)
        blocks.append(given)
        constant = np.arange(at, at + given.shape[1])
        clear = problem.clear(np.concatenate(blocks, axis=1))
        # the residual is predicted minus measured, so that what is missing from the prediction has its sign reversed
        gram, score = clear.T @ clear / projected.crowd, -clear.T @ projected.y / projected.crowd
        inexact = _LAW_ERROR**2 * _explained(terms, gram, score)
        return cls(tuple(terms), gram, score, projected.yy + inexact, projected.degrees, constant)

    def weight(self, members: Sequence[int]) -> float:
        """Log posterior of a set, up to a constant."""
        key = frozenset(members)
        if key not in self.seen:
            self.seen[key] = self._weigh(tuple(sorted(key)))
        return self.seen[key]

    def _weigh(self, members: tuple[int, ...]) -> float:
        prior = sum(self.terms[i].log_odds for i in members)
        if not members:
            return prior
        columns = np.concatenate([self.terms[i].columns for i in members])
        scale = np.concatenate([self.terms[i].scale for i in members])
        tied = np.concatenate(
            [np.full(len(self.terms[i].columns), self.terms[i].tied) for i in members]
        )
        gram, score = self.gram[np.ix_(columns, columns)], self.score[columns]
        spread = np.where(tied, scale * _SCALES[:, None], scale)  # (S, P)
        values = self._values(gram, score, scale, tied)
        for _ in range(2):  # G depends on the values, and the values on what G takes
            masses = self._masses(members, values)
            log, values, error = self._evidence(gram, score, spread, columns, masses)
        own = np.concatenate(
            [np.arange(len(self.terms[i].columns)) < self.terms[i].positive for i in members]
        )
        z = values[own] / np.maximum(error[own], 1e-300)
        return prior + log + float((np.log(2) + log_ndtr(z)).sum())

    def _values(self, gram, score, scale, tied) -> np.ndarray:
        """(P,) values of the compliances where masses are as stated, hardly shrunk."""
        widest = np.where(tied, scale * _SCALES[-1], scale)
        scaled = gram * np.outer(widest, widest) + np.eye(len(score))
        return widest * solve_positive(scaled, widest * score)

    def _masses(self, members, values: np.ndarray) -> np.ndarray:
        """(T, M) weights of the Gram matrix's columns that make G, one column a first moment."""
        at, parts = 0, []
        for i in members:
            term = self.terms[i]
            for k, numbers in enumerate(term.responses):
                parts.append((numbers, values[at + k]))
            at += len(term.columns)
        count = max((len(numbers) for numbers, _ in parts), default=len(self.given))
        out = np.zeros((len(self.score), count))
        out[self.given, np.arange(len(self.given))] = 1.0
        for numbers, value in parts:
            out[numbers, np.arange(len(numbers))] += value
        return out

    def _evidence(self, gram, score, spread, columns, masses):
        """Log marginal likelihood summed over the scales, and values (P,) and errors (P,) at the likeliest scale."""
        count, mass_count = len(score), masses.shape[1]
        used = np.flatnonzero(masses.any(1))
        weights = masses[used]
        cross = self.gram[np.ix_(columns, used)] @ weights
        inner = weights.T @ self.gram[np.ix_(used, used)] @ weights
        size = count + mass_count
        whole = np.empty((size, size))
        whole[:count, :count], whole[:count, count:] = gram, cross
        whole[count:, :count], whole[count:, count:] = cross.T, inner
        right = np.concatenate([score, weights.T @ self.score[used]])
        factor = np.concatenate([spread, np.ones((len(spread), mass_count))], axis=1)
        matrix = whole * factor[:, :, None] * factor[:, None, :] + np.eye(size)
        eigenvalues, vectors = symmetric_eigen(matrix)
        eigenvalues = np.maximum(eigenvalues, 1.0)  # rounding alone brings them below
        along = np.einsum("sij,si->sj", vectors, factor * right)
        gained = (along**2 / eigenvalues).sum(1)
        share = np.minimum(gained / (self.yy + _ANCHOR), 1 - 1e-12)
        logs = -0.5 * np.log(eigenvalues).sum(1) - 0.5 * (self.degrees + _ANCHOR) * np.log1p(-share)
        best = int(np.argmax(logs))
        solution = factor[best] * (vectors[best] @ (along[best] / eigenvalues[best]))
        variance = max(self.yy - gained[best], 1e-300) / max(self.degrees, 1.0)
        spread_of = (
            np.sqrt(((vectors[best] ** 2) / eigenvalues[best]).sum(1) * variance) * factor[best]
        )
        return float(logsumexp(logs) - np.log(len(logs))), solution[:count], spread_of[:count]

    def best(self, start: Sequence[int]) -> tuple[int, ...]:
        """The likeliest set that is climbed to from a set, from all joints, and from the terms not tied to these."""
        joints = [i for i, term in enumerate(self.terms) if term.key[0] == JointCompliance.effect]
        free = [i for i in start if not self.terms[i].tied]
        return max((self._climb(s) for s in (start, [*joints, *free], joints)), key=self.weight)

    def _climb(self, start: Sequence[int]) -> tuple[int, ...]:
        """The likeliest set by adding, dropping and exchanging one term at a time."""
        present = tuple(sorted(start))
        for _ in range(_STEPS):
            around = max(self._neighbours(present), key=self.weight, default=present)
            if self.weight(around) <= self.weight(present) + 1e-9:
                break
            present = around
        return present

    def _neighbours(self, present: tuple[int, ...]) -> list[tuple[int, ...]]:
        absent = [i for i in range(len(self.terms)) if i not in present]
        out = [tuple(sorted((*present, i))) for i in absent]
        for i in present:
            fewer = tuple(j for j in present if j != i)
            out.append(fewer)
            likely = sorted(absent, key=lambda j: -self.alike(i, j))[:_SWAPS]
            out += [tuple(sorted((*fewer, j))) for j in likely]
        return out

    def alike(self, i: int, j: int) -> float:
        """Share (0-1) of the first column of term i, the baseline projected out, that the columns of term j make."""
        own, other = self.terms[i].columns[:1], self.terms[j].columns
        length = float(self.gram[own[0], own[0]])
        if not length > 0:
            return 0.0
        cross = self.gram[np.ix_(own, other)][0]
        inner = self.gram[np.ix_(other, other)]
        made = float(cross @ pseudo_inverse(inner, 1e-9) @ cross)
        return float(np.clip(made / length, 0.0, 1.0))

    def window(self, best: tuple[int, ...]) -> tuple[list[frozenset], np.ndarray]:
        """The sets near the likeliest one and their posterior probabilities."""
        done: set[frozenset] = set()
        for _ in range(_EXPANDED):
            top = max(self.seen.values())
            near = [s for s, w in self.seen.items() if w > top - _WINDOW and s not in done]
            if not near:
                break
            chosen = max(near, key=self.seen.__getitem__)
            done.add(chosen)
            for members in self._neighbours(tuple(sorted(chosen))):
                self.weight(members)
        top = max(self.seen.values())
        sets = [s for s, w in self.seen.items() if w > top - _WINDOW]
        weights = np.array([self.seen[s] for s in sets])
        return sets, np.exp(weights - logsumexp(weights))


def is_member(effect: str, effects) -> bool:
    """Whether a term belongs to the sets: what deflects under gravity, and the harmonic that is most like it."""
    if effect in _PRIORS:
        return True
    return effect == _HARMONIC and bool(effects) and getattr(effects[0], "order", None) == 1.0


def _given_response(problem: Problem, responses) -> np.ndarray:
    """(N, M) what first moments change in the deflections that the baseline holds; (N, 0) where it holds none."""
    made = [
        (responses[key], values)
        for key, values in problem.given_values.items()
        if key in responses and responses[key].shape[1] % len(values) == 0
    ]
    total = np.zeros((len(problem.sample), 0))
    for columns, values in made:
        each = columns.shape[1] // len(values)
        own = sum(columns[:, i * each : (i + 1) * each] * value for i, value in enumerate(values))
        total = own if total.shape[1] != own.shape[1] else total + own
    return total


def _explained(terms: Sequence[Term], gram: np.ndarray, score: np.ndarray) -> float:
    """Fall of the sum of squares by all joints' compliances together."""
    columns = [term.columns for term in terms if term.key[0] == JointCompliance.effect]
    if not columns:
        return 0.0
    own = np.concatenate(columns)
    return float(score[own] @ pseudo_inverse(gram[np.ix_(own, own)], 1e-9) @ score[own])


def _term(candidate: Candidate, own: np.ndarray, responses) -> Term:
    if candidate.effect in _PRIORS:
        chance, relative = _PRIORS[candidate.effect]
        scale, tied = np.full(len(own), relative * max(candidate.load, 1e-3) ** _SIZE_BY_LOAD), True
    else:
        chance, scale, tied = _HARMONIC_PRIOR, np.full(len(own), _HARMONIC_SIZE), False
    log_odds = float(np.log(chance) - np.log1p(-chance))
    return Term(
        (candidate.effect, candidate.where),
        candidate,
        own,
        responses,
        log_odds,
        scale,
        tied,
        candidate.positive,
    )


__all__ = ["ElasticSets", "Term", "is_member"]
