"""Entries of the catalogue page: an effect in an ideal recording, and the residual of a fit without it.

Sizes, confounded effects and, for the robot, the experiment that separates them come from the diagnosis.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workbench.diagnosis.linear.problem import Problem
from workbench.explanation.final_model import unwhitened

ORTHOGONAL_SIGMA = 6.0
"""Sigmas of one coordinate, RMS, that each effect is made so large as to leave."""
_MOST = 40.0  # typical sizes: larger than that nothing is made
_CONFOUNDED, _LEAST = 3, 0.3
_BROAD = 10.0  # prior of a confounded effect, in typical sizes
FAINT = 8.0
"""Size of the effect for the separating experiment, in sigmas of all samples together: hardly distinguishable."""


@dataclass(frozen=True)
class Entry:
    """One effect at one place. Sizes in `unit`; `orthogonal_share` of its square is orthogonal to the baseline.

    `confounded`: (effect, share of the orthogonal part of the signature that it explains). `separates`: a sentence.
    `problem`: of the fit without it.
    `points` (3, n) mm or (2, n) px: where its samples are, for the image.
    """

    name: str
    kind: type
    where: str
    values: tuple[str, ...]
    size: float
    left: float
    orthogonal_share: float
    unit: str
    confounded: tuple[tuple[str, float], ...]
    separates: str
    problem: Problem
    points: np.ndarray


def direction(typical: np.ndarray) -> np.ndarray:
    """A direction in the parameters in which all take part: typical sizes, every other one negative."""
    return typical * np.resize([1.0, -1.0], len(typical)) / np.sqrt(len(typical))


def large_enough(problem: Problem, typical: np.ndarray) -> np.ndarray:
    """(P,) values of the first added effect that leave `ORTHOGONAL_SIGMA` sigmas RMS once the baseline is fitted."""
    along = direction(typical)
    left = problem.orthogonalise(problem.added[0] @ along)
    size = float(np.sqrt((left**2).mean()))
    return along * min(ORTHOGONAL_SIGMA / max(size, 1e-12), _MOST)


def sizes(problem: Problem, values: np.ndarray) -> tuple[float, float, float]:
    """RMS of the first added effect at `values`, of its part orthogonal to the baseline, and the share of the square.

    problem: of the perfect recording, so that everything is linearised where nothing acts.
    """
    moved = problem.added[0] @ values
    left = problem.orthogonalise(moved)
    scale = unwhitened(problem)
    whole, remaining = (float(np.sqrt(((x * scale) ** 2).sum() / problem.n)) for x in (moved, left))
    return whole, remaining, float((left**2).sum() / (moved**2).sum())


def confounded(problem: Problem, values: np.ndarray, family: str) -> list[tuple[object, float]]:
    """(candidate, share of the orthogonal part of the signature that it explains), largest first, one per family."""
    own = problem.orthogonalise(problem.added[0] @ values)
    best: dict[str, tuple[object, float]] = {}
    for c in problem.candidates:
        if c.family == family:
            continue
        share = made_by(problem, c.columns * c.typical, own)
        if share > best.get(c.family, (None, 0.0))[1]:
            best[c.family] = c, share
    ranked = sorted(best.values(), key=lambda row: -row[1])[:_CONFOUNDED]
    return [row for row in ranked if row[1] >= _LEAST]


def made_by(problem: Problem, columns: np.ndarray, own: np.ndarray) -> float:
    """Share of `own` (N,), already cleared, that columns (N, P), in typical sizes, make at a likely size."""
    orthogonal = problem.orthogonalise(columns)
    along = orthogonal.T @ own
    return float(
        along
        @ np.linalg.solve(orthogonal.T @ orthogonal + _BROAD**-2 * np.eye(len(along)), along)
        / (own @ own)
    )


def listed(candidates: Sequence[tuple[object, float]]) -> tuple[tuple[str, float], ...]:
    """Names of confounded effects with their shares."""
    return tuple(
        (f"`{c.effect}`{f' ({c.label})' if c.label else ''} at {c.where}", share)
        for c, share in candidates
    )
