"""First moments that the gravity compliances of an arm without stated masses share.

Joints, bearings, links and pedestal deflect under the same links. Each law has the first moments of these as unknowns
of its own, so that a set of two laws would pay for the same unknowns twice, and one with the fewest unknowns would seem
the simplest. Once something is known to deflect, the moments are therefore estimated with all laws in the model, and
each law has one unknown left, its compliance, as it has where masses are stated. A set with any of these laws pays once
for the moments (Laplace's approximation: Kass & Raftery, J. Am. Stat. Assoc. 90 (1995) 773, sec. 4.1). The solution of
an accepted set estimates all unknowns of its laws.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from robot_model.effects.unknown_masses import TYPICAL_RAD, GravityCompliance
from workbench.core.effect import Effect
from workbench.core.least_squares.linear_algebra import solve_positive, symmetric_eigenvalues
from workbench.diagnosis.levels import MAX_ROUNDS, UNDETERMINED_STD
from workbench.diagnosis.linear.candidates import Candidate
from workbench.diagnosis.linear.evidence import SIZES, marginalise_sizes
from workbench.diagnosis.linear.problem import Problem


def with_shared_moments(problem: Problem, chain) -> Problem:
    """The problem with one column for each law of unknown first moments.

    Unchanged where nothing deflects yet, and next to a law of stated loads that has moments of its own.
    """
    laws = [c for c in problem.candidates if c.effect == GravityCompliance.effect]
    first = next((c for c in laws if type(c.effects[0]) is GravityCompliance), None)
    own_moments = [e for e in problem.effects if e.estimates_moments and not _is_like_gravity(e)]
    if first is None or own_moments or not any(map(_is_like_gravity, problem.effects)):
        return problem
    others = [i for i, e in enumerate(problem.effects) if not _is_like_gravity(e)]
    without_gravity = problem.conditional_on(others)
    y = without_gravity.orthogonalise(without_gravity.residual)
    maps = [_map(law, first, chain) for law in laws]
    columns = np.stack([_typical(law) @ m for law, m in zip(laws, maps)], 1)  # (N, C, P)
    flat = columns.reshape(len(y), -1)
    orthogonal = without_gravity.orthogonalise(flat)
    by_law = orthogonal.reshape(columns.shape).swapaxes(0, 1)
    blocks = np.ascontiguousarray(by_law)
    moments, sizes = _estimated(blocks, y)
    degrees = max(problem.degrees, 1)
    cost = _cost(blocks, y, moments, sizes, degrees)
    known = {law.key: _directed(law, m @ moments) for law, m in zip(laws, maps)}
    candidates = tuple(known.get(c.key, c) for c in problem.candidates)
    return replace(problem, candidates=candidates, moments_cost=cost, cache={})


def _is_like_gravity(effect: Effect) -> bool:
    """Whether an effect deflects the arm under its links, or is the harmonic that is most like it."""
    return effect.effect == GravityCompliance.effect or getattr(effect, "order", None) == 1.0


def _typical(law: Candidate) -> np.ndarray:
    """(N, P) columns of a law, each in its typical size, and all in that of what it is where a joint deflects."""
    _, relative = law.effects[0].compliance_prior
    relative_size = relative * TYPICAL_RAD / law.typical[0]
    typical_columns = law.columns * law.typical
    return typical_columns * relative_size


def _map(law: Candidate, first: Candidate, chain) -> np.ndarray:
    """(P, P') coefficients of a law from those of another one under the same moments, both in typical sizes."""
    sizes = first.typical / law.typical[:, None]
    of_law = law.effects[0].moments_of(first.effects[0], chain)
    moments = of_law * sizes
    return moments / moments[0, 0]


def _estimated(laws: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Moments (P,), the first of which is 1, and compliances (C,) of laws with columns (C, N, P), in turn.

    The residual is predicted minus measured: what is missing has the opposite sign, and no compliance is negative.
    """
    moments = np.eye(laws.shape[2])[0]
    for _ in range(MAX_ROUNDS):
        sizes = _nonpositive((laws @ moments).T, y)
        columns = np.tensordot(sizes, laws, 1)  # (N, P)
        remaining = y - columns[:, 0]
        moments[1:] = _solved(columns[:, 1:], remaining)
    return moments, _nonpositive((laws @ moments).T, y)


def _cost(laws: np.ndarray, y: np.ndarray, moments, sizes, degrees: int) -> float:
    """Minus the log of the share of the moments' prior that the data leave, next to all compliances.

    The prior has the sizes of the coefficients of every other law: a wider one would cost more than moments of its own
    cost a single law.
    """
    columns = (laws @ moments).T
    residual = y - columns @ sizes
    variance = float(residual @ residual) / degrees
    changes = np.tensordot(sizes, laws[:, :, 1:], 1)
    changes = changes - columns @ _solved(columns, changes)
    curvature = changes.T @ changes / variance
    values = np.maximum(symmetric_eigenvalues(curvature), 0.0)
    spread = SIZES[:, None] ** 2
    log_volume = np.log1p(spread * values).sum(1)
    squares = moments[1:] ** 2 / spread
    unlikely = squares.sum(1)
    logs = -0.5 * (log_volume + unlikely)
    return -float(marginalise_sizes(logs))


def _nonpositive(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Coefficients (T,) with their priors, none of them above 0."""
    priors = np.eye(columns.shape[1]) / UNDETERMINED_STD
    rows = np.vstack([columns, priors])
    target = np.concatenate([-y, np.zeros(columns.shape[1])])
    return -nnls(rows, target)[0]


def _solved(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Coefficients (T,) or (T, K) with their priors."""
    priors = np.eye(columns.shape[1]) / UNDETERMINED_STD**2
    gram = columns.T @ columns + priors
    return solve_positive(gram, columns.T @ y)


def _directed(law: Candidate, direction: np.ndarray) -> Candidate:
    """A law with one unknown, its first, which the others follow in proportion; direction in typical sizes."""
    typical_columns = law.columns * law.typical
    columns = typical_columns @ direction / law.typical[0]
    return replace(law, columns=columns[:, None], typical=law.typical[:1])
