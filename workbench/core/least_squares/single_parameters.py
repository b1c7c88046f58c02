"""Parameters that the data determine one by one, under the priors of the fit.

A parameter is determined where the fit leaves it a standard deviation of at most half of what was known before:
the data then hold at least three times the information of the prior. A direction in which single parameters have
only a small share does not count against them; what counts is how far the direction moves each of them. The same
rule applied to combinations of parameters gives their number: eigenvalues of the posterior covariance in units of
the prior. A unit vector never has less variance than the smallest eigenvalue, so the two never contradict.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from workbench.core.least_squares.identifiability import Identifiability, confounded_sentence
from workbench.core.least_squares.linear_algebra import solve_positive, symmetric_eigenvalues
from workbench.core.parameters import Parameters

LARGEST_SHARE = 0.5
"""Posterior over prior standard deviation up to which a parameter, or a combination, is determined."""
_NAMED = 12
_MIN_PRIOR = 1e-100  # of a prior that a fit has shrunk to nothing: its square is not zero


@dataclass(frozen=True)
class SingleParameters:
    """Identifiability of F parameters one by one, including those held because others carry them.

    `known` with the covariance of all F; `before` (F,) standard deviation known before, in own units; `free` (F,)
    True for the parameters that the fit solves for.
    """

    known: Identifiability
    before: np.ndarray
    free: np.ndarray

    @classmethod
    def of(cls, known: Identifiability, parameters: Parameters) -> "SingleParameters":
        """Judged under the priors that `parameters` hold."""
        rows = np.array([parameters.index[key] for key in known.keys], int)
        return cls(known, _known_before(known, parameters, rows), parameters.mask[rows])

    @property
    def sigma(self) -> np.ndarray:
        """(F,) posterior standard deviation, with all others uncertain too."""
        return np.sqrt(np.maximum(np.diag(self.known.covariance), 0))

    @property
    def determined(self) -> np.ndarray:
        """(F,) True where the data determine the parameter by itself."""
        return self.sigma <= LARGEST_SHARE * self.before

    @property
    def combinations(self) -> int:
        """Number of determined combinations of the F parameters."""
        return self.combinations_of(self.known.keys)

    def combinations_of(self, keys: Collection[str]) -> int:
        """Number of determined combinations of some of the parameters, whatever the others are."""
        rows = np.isin(self.known.keys, list(keys))
        before = self.before[rows]
        scaled = self.known.covariance[np.ix_(rows, rows)] / np.outer(before, before)
        return int((symmetric_eigenvalues(scaled) <= LARGEST_SHARE**2).sum())

    def from_held(self) -> dict[str, float]:
        """Key of every free parameter -> the part of its variance that the held ones cause (law of total variance)."""
        free = np.flatnonzero(self.free)
        held_places = np.flatnonzero(~self.free)
        cross = self.known.covariance[np.ix_(free, held_places)]
        held_covariance = self.known.covariance[np.ix_(held_places, held_places)]
        part = (cross * solve_positive(held_covariance, cross.T).T).sum(1)
        return {self.known.keys[k]: max(float(v), 0.0) for k, v in zip(free, part)}

    def groups(self) -> list[list[str]]:
        """Keys of every combination that is not identifiable, each once.

        Directions in which no measurement changes keep all their members. Of a direction that is only weak, the
        members are the other parameters that are not determined; weak directions with a common member are one group.
        """
        return [*self._exact(), *self._weak()]

    def tied(self) -> dict[str, list[str]]:
        """Parameter -> those that it is confounded with; determined ones only through exact directions."""
        found: dict[str, set[str]] = {}
        for group in self.groups():
            for key in group:
                found.setdefault(key, set()).update(other for other in group if other != key)
        return {key: sorted(others) for key, others in found.items()}

    def sentences(self) -> list[str]:
        """Combinations that are not identifiable, in words; then the parameters that keep their prior values."""
        label = dict(zip(self.known.keys, self.known.labels))
        group_sentences = [
            self.known.alone(group[0])
            if len(group) == 1
            else confounded_sentence([label[key] for key in group])
            for group in self._exact()
        ]
        for members in self._weak():
            count = self.combinations_of(members)
            group_sentences.append(_weak_sentence([label[key] for key in members], count))
        covered = {key for group in self.groups() for key in group}
        alone = [key for key in self._open() if key not in covered]
        return group_sentences + ([_prior_sentence([label[key] for key in alone])] if alone else [])

    def _open(self) -> list[str]:
        return [
            key for key, is_determined in zip(self.known.keys, self.determined) if not is_determined
        ]

    def _exact(self) -> list[list[str]]:
        """Members of each direction without any effect that holds a parameter which is not determined."""
        undetermined = set(self._open())
        return [group for group in self.known.exact_groups() if undetermined & set(group)]

    def _weak(self) -> list[list[str]]:
        """Disjoint groups of two or more parameters that share weak directions and are not determined."""
        undetermined = set(self._open()).difference(*self._exact())
        merged: list[list[str]] = []
        for group in self.known.weak_groups():
            merged = _joined(merged, [key for key in group if key in undetermined])
        return [members for members in merged if len(members) > 1]


def _joined(merged: Sequence[list[str]], members: Sequence[str]) -> list[list[str]]:
    """The groups with one more; those that share a member with it become one with it."""
    keys = list(members)
    disjoint = []
    for others in merged:
        if set(others) & set(members):
            keys += [key for key in others if key not in keys]
        else:
            disjoint.append(others)
    return [*disjoint, keys]


def _known_before(known: Identifiability, parameters: Parameters, rows: np.ndarray) -> np.ndarray:
    """(F,) prior standard deviation.

    A parameter without a prior (base, tool) has its typical size, or the widest prior in its unit where that is
    less: it carries what others are held for, and moves as far as their priors allow.
    """
    precision = parameters.precision[rows]
    has_prior = precision > 0
    prior = 1 / np.sqrt(np.where(has_prior, precision, 1.0))
    widest = {
        unit: max(
            (
                p
                for p, prior_unit, has in zip(prior, known.units, has_prior)
                if has and prior_unit == unit
            )
        )
        for unit in {unit for unit, has in zip(known.units, has_prior) if has}
    }
    limit = np.array([widest.get(unit, np.inf) for unit in known.units])
    before = np.where(has_prior, prior, np.minimum(known.typical, limit))
    return np.maximum(before, _MIN_PRIOR)


def _weak_sentence(labels: Collection[str], count: int) -> str:
    """Of parameters that share weak directions; count: of their combinations that are determined."""
    statement = f"no combination of these {len(labels)} parameters is determined"
    if count:
        plural = " is" if count == 1 else "s are"
        statement = f"only {count} combination{plural} determined of these {len(labels)} parameters"
    return f"{statement}: {_names(labels)}"


def _prior_sentence(labels: Collection[str]) -> str:
    """Of parameters that are not confounded with others."""
    return f"too small an effect here, left at what was known before: {_names(labels)}"


def _names(labels: Collection[str]) -> str:
    shown = list(labels)[:_NAMED]
    unlisted_count = len(labels) - len(shown)
    return ", ".join(shown) + (f" and {unlisted_count} more" if unlisted_count else "")


__all__ = ["LARGEST_SHARE", "SingleParameters"]
