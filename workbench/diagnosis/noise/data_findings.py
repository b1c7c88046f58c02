"""Findings about the data rather than the model: outliers and heteroscedastic noise."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import logsumexp

from workbench.core.common_effects import NoiseLaw
from workbench.core.effect import Effect
from workbench.core.vocabulary import Covariate
from workbench.diagnosis.levels import CONFIDENCE, DATA_FAULT_LEVEL, RARE_PRIOR
from workbench.diagnosis.linear.problem import Finding, Problem
from workbench.diagnosis.noise.outliers import (
    contaminated,
    spread_along,
    spread_in_blocks,
    spread_with,
)


def find_data_faults(
    problem: Problem, effects: Sequence[Effect]
) -> tuple[np.ndarray, tuple[Finding, ...]]:
    """(n,) bool of the outliers, and findings on the data: a spread that is not the same everywhere, and outliers.

    A spread that changes with the time and back again is a finding only: no weights follow from it.

    effects: of the model. Samples that they cannot predict, see `is_move_known`, are no outliers.
    """
    spread = _spread(problem) or _bursts(problem)
    factor, outlier_probability = _outlying(problem, spread[0].depends_on[0] if spread else "")
    found = (outlier_probability > 0.5) & is_move_known(problem.covariates, effects)
    # by Markov's inequality chance makes such a factor less than once in twenty times
    if factor < -np.log(1 - CONFIDENCE) or not found.any():
        outliers = np.zeros(problem.n, bool)
        return outliers, spread
    p = max(float(np.exp(-factor)), 1e-300)
    label = f"{found.sum()} of {problem.n}"
    probability = RARE_PRIOR / (RARE_PRIOR + (1 - RARE_PRIOR) * p)
    finding = Finding("outliers", "samples", label, (), p, probability, 0.0, 0.0)
    return found, (*spread, finding)


def is_move_known(
    covariates: Mapping[str, np.ndarray], effects: Sequence[Effect]
) -> np.ndarray | bool:
    """(n,) False for the first pose where an effect reads the last moves: nobody recorded how it was reached."""
    moves = []
    for name, values in covariates.items():
        known = Covariate.of(name)
        if known.kind == "move" and not known.unit:  # and no state that follows from the moves
            moves.append(values != 0)
    if not moves or not any(effect.by_moves for effect in effects):
        return True
    return np.any(moves, axis=0)


def unweighted_squares(problem: Problem, outliers: np.ndarray) -> float:
    """Whitened sum of squares of the samples `outliers` (n,) bool, without the robust weights."""
    return float((_unweighted(problem)[outliers[problem.sample]] ** 2).sum())


def relative_noise(problem: Problem) -> np.ndarray | None:
    """(n,) how far the noise of each sample is spread, 1 on average; None where it is the same everywhere.

    Noise that grows with something makes functions of it out of nothing: all is to be judged with it evened.
    """
    found = _spread(problem)
    if not found:
        return None
    return spread_along(
        _unweighted(problem).reshape(-1, problem.n),
        problem.sample_covariates[found[0].depends_on[0]],
    )


def with_equal_noise(problem: Problem, spread: np.ndarray) -> Problem:
    """The problem whitened by the spread (n,) of each sample's noise."""
    factor = (1 / spread)[problem.sample]
    return problem.transformed(lambda rows: rows * factor, problem.weights / spread**2)


def _unweighted(problem: Problem) -> np.ndarray:
    """(N,) residuals of all that is kept, without the robust weights."""
    return problem.orthogonalise(problem.residual) / problem.root_weights


def _outlying(problem: Problem, name: str) -> tuple[float, np.ndarray]:
    """Log Bayes factor that there are outliers, and the probability (n,) that a sample is one, if there are any.

    Those with equally many coordinates are judged together, and the factors averaged; `name`: of the covariate that
    the spread goes with.
    """
    white = _unweighted(problem)
    order = np.argsort(problem.sample, kind="stable")
    count = np.bincount(problem.sample, minlength=problem.n)
    probability = np.zeros(problem.n)
    factors = []
    for m in np.unique(count[count > 0]):  # a corner has two coordinates, a stripe one
        rows = order[count[problem.sample[order]] == m].reshape(-1, m)
        samples = problem.sample[rows[:, 0]]
        white_rows = white[rows].T
        if name:
            white_rows = white_rows / spread_along(
                white_rows, problem.sample_covariates[name][samples]
            )
        factor, probability[samples] = contaminated(white_rows)
        factors.append(factor)
    wrong = float(logsumexp(factors) - np.log(len(factors)))
    return wrong, probability


def _spread(problem: Problem) -> tuple[Finding, ...]:
    """Noise that is not the same everywhere, where that is beyond chance; samples of several kinds are not compared."""
    if len(problem.residual) % problem.n:
        return ()
    white = _unweighted(problem).reshape(-1, problem.n)
    found = spread_with(white, problem.sample_covariates)
    if found is None or found[1] > DATA_FAULT_LEVEL:
        return ()
    name, p = found
    return (_noise_with(name, p),)


def _bursts(problem: Problem) -> tuple[Finding, ...]:
    """Noise that is larger during a part of the recording, where that is beyond chance."""
    if len(problem.residual) % problem.n:
        return ()
    p = spread_in_blocks(_squared_lengths(problem), problem.order, problem.pose)
    return (_noise_with("time", p),) if p <= DATA_FAULT_LEVEL else ()


def _squared_lengths(problem: Problem) -> np.ndarray:
    """(n,) squared lengths of the residuals of samples with equally many coordinates, without the robust weights."""
    return (_unweighted(problem).reshape(-1, problem.n) ** 2).sum(0)


def _noise_with(name: str, p: float) -> Finding:
    """The finding that the spread of the noise goes with a covariate."""
    return Finding(NoiseLaw.effect, "noise", f"with {name}", (), p, 1.0 - p, 0.0, 0.0, (name,))
