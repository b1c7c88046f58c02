"""Held-out gains of terms conditional on one another, to first order about one solution with all of them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.diagnosis.levels import OUTLIER_WEIGHT
from workbench.diagnosis.linear.evidence import cached
from workbench.diagnosis.linear.problem import Problem
from workbench.diagnosis.validation.folds import Scheme, schemes
from workbench.diagnosis.validation.held_out import (
    critical_t,
    left_out_components,
    paired_t,
    rms,
    significance,
)
from workbench.diagnosis.validation.judging import combined_t, judging_schemes
from workbench.diagnosis.validation.terms import Term


class ConditionalGains:
    """The held-out gain of terms conditional on one another, to first order about one solution with all of them."""

    def __init__(self, bench, problem: Problem, sigma):
        self._bench, self._problem, self._sigma = bench, problem, sigma
        self._schemes = schemes(problem.pose, problem)
        self._judges: dict[tuple, list[Scheme]] = {}
        self._errors: dict[tuple, np.ndarray] = {}

    def judged(self, term: Term, own: Sequence[int], kept: Sequence[int]) -> Term:
        """The term, with the effects `own`, with t, t_fall and gain of its presence next to the effects `kept`."""
        inliers, sigma, pose = (
            self._problem.weights > OUTLIER_WEIGHT,
            self._sigma,
            self._problem.pose,
        )
        rest = [i for i in kept if i not in own]
        t, falls, gain = [], [], []
        for scheme in self._judges_of(term, tuple(own)):
            with_it, without = self._left_out(scheme, kept), self._left_out(scheme, rest)
            t.append(significance(pose, without, with_it, inliers, sigma))
            lengths = [np.sqrt((one**2).sum(0)) for one in (without, with_it)]
            falls.append(paired_t(pose, *lengths, inliers, sigma))
            gain.append(rms(lengths[0], inliers, sigma) - rms(lengths[1], inliers, sigma))
        worst = int(np.argmin(t))
        known = combined_t(t, sigma)
        return replace(
            term,
            t=known,
            t_fall=float(np.mean(falls)),
            gain=gain[0] if known > critical_t(sigma) else gain[worst],
        )

    def _judges_of(self, term: Term, own: tuple[int, ...]) -> list[Scheme]:
        def make():
            return judging_schemes(
                self._bench, term.finding.effects, self._schemes, self._problem, own
            )

        return cached(self._judges, own, make)

    def _left_out(self, scheme: Scheme, kept: Sequence[int]) -> np.ndarray:
        """(m, n) components of the errors next to some effects; those of a sensor scored."""

        def make():
            scored = self._sigma is not None
            problem = self._problem.conditional_on(kept)
            return left_out_components(problem, scheme.fold, scored=scored)

        return cached(self._errors, (scheme.name, *sorted(kept)), make)
