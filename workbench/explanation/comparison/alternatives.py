"""Other sets of parameters that explain a recording about as well as one that was named.

A parameter that was named may stand for another, or for two or three others together. With the frames, the effects and
the other named parameters in the model, the parameter is exchanged for each set of up to three of those that were not
named. Sets are compared by the Bayesian information criterion (Schwarz, Ann. Stat. 6 (1978) 461): the sum of squared
whitened residuals, and log N a parameter. exp(-difference / 2) approximates the ratio of their posterior probabilities
(Kass and Raftery, J. Am. Stat. Assoc. 90 (1995) 773).
"""

from itertools import combinations

import numpy as np

from workbench.core.least_squares.linear_algebra import least_squares

_MOST_MEMBERS = 3
_LEAST_ODDS = 0.05
"""Probability of an alternative over that of the named parameter below which it is not listed."""
_MOST_LISTED = 4  # the most probable ones
_DEPENDENT = 1e-6  # share of a column that others leave, below which it is a combination of them


def alternative_sets(
    columns: np.ndarray, white: np.ndarray, chosen: list[int], member: int
) -> list[tuple[int, ...]]:
    """Sets of columns that replace one member of the chosen ones, most probable first.

    columns (C, N): whitened derivatives of the C candidates; white (N,): whitened residual; both without what is always
    estimated. chosen: indices of the named candidates. No listed set contains another.
    """
    kept = [i for i in chosen if i != member]
    orthogonal, residual = _project_out(columns, white, columns[kept])
    seen = np.linalg.norm(orthogonal, axis=1) > _DEPENDENT * np.linalg.norm(columns, axis=1)
    others = [int(i) for i in np.flatnonzero(seen) if i not in chosen]
    gram = orthogonal @ orthogonal.T
    right = orthogonal @ residual
    penalty = np.log(len(white))
    named = _explained(gram, right, [(member,)])[0] - penalty
    found: list[tuple[float, tuple[int, ...]]] = []
    for size in range(1, _MOST_MEMBERS + 1):
        candidate_sets = list(combinations(others, size))
        if not candidate_sets:
            break
        gains = _explained(gram, right, candidate_sets) - size * penalty
        likely = np.flatnonzero(gains - named >= 2 * np.log(_LEAST_ODDS))
        smaller = [set(indices) for _, indices in found]
        found += [
            (float(gains[k]), candidate_sets[k])
            for k in likely
            if not any(indices <= set(candidate_sets[k]) for indices in smaller)
        ]
    found.sort(key=lambda row: -row[0])
    return [indices for _, indices in found[:_MOST_LISTED]]


def _project_out(columns, white, known) -> tuple[np.ndarray, np.ndarray]:
    """Columns (C, N) and residual (N,) with the rows of `known` (K, N) projected out."""
    if not len(known):
        return columns, white
    fitted = least_squares(known.T, np.column_stack([columns.T, white]))
    remaining = np.column_stack([columns.T, white]) - known.T @ fitted
    orthogonal = remaining[:, :-1].T
    return orthogonal, remaining[:, -1]


def _explained(gram, right, member_sets) -> np.ndarray:
    """(S,) sum of squares that each of S sets of equal size explains; 0 where its columns are dependent."""
    members = np.array(member_sets)
    matrices = gram[members[:, :, None], members[:, None, :]]
    scale = np.sqrt(np.einsum("skk->sk", matrices))
    scaled = matrices / scale[:, :, None] / scale[:, None, :]
    values, vectors = np.linalg.eigh(scaled)
    values = np.where(values > _DEPENDENT, values, np.inf)
    projected = np.einsum("skj,sk->sj", vectors, right[members] / scale)
    return (projected**2 / values).sum(1)


__all__ = ["alternative_sets"]
