"""Design effect: by how much errors that the coordinates of one pose share reduce the number of independent values."""

import numpy as np
from scipy.sparse import csr_array

from workbench.diagnosis.levels import LEAST_NUMBER
from workbench.diagnosis.linear.problem import POSE_MEANS, Problem, cached


def design_effect(problem: Problem) -> float:
    """Kish's design effect of the coordinates of one pose, whose errors correlate, at least 1.

    Repeats of a pose share what the model misses there; they say ten times the same. The mean square of the residual's
    means over the samples of a pose against that of all coordinates (Kish, Survey Sampling, 1965: for equal numbers of
    repeats it is 1 + (m - 1) rho). Each by its own degrees of freedom, since a fit takes most of its own from the
    means: a set of terms that follows every pose would make the repeats seem independent.
    Times that of noise that is correlated from pose to pose.
    """
    y = remaining_residual(problem)
    m = len(y) // problem.n
    _, label, count = np.unique(problem.pose, return_inverse=True, return_counts=True)
    poses = len(count)
    if poses == problem.n or len(y) != m * problem.n:
        return problem.serial_effect
    coordinate = np.repeat(np.arange(m), problem.n)
    cell = np.tile(label, m) + len(count) * coordinate
    samples_of_pose = count[label[problem.sample]]
    root_weight = 1 / np.sqrt(samples_of_pose)
    number = np.arange(len(y))
    means = csr_array((root_weight, (cell, number)))
    free = m * len(count) - _spent_on_means(problem, means)
    between_poses = float(((means @ y) ** 2).sum())
    shared = between_poses / max(free, LEAST_NUMBER)
    remaining_degrees = max(len(y) - problem.rank, 1)
    mean_square = max(float(y @ y), 1e-300) / remaining_degrees
    return problem.serial_effect * max(shared / mean_square, 1.0)


def _spent_on_means(problem: Problem, means: csr_array) -> float:
    """Degrees of freedom that the fit takes from means (M, N) of the samples of each pose: |means Q|^2, Q its basis.

    Of retained effects by the inner products of their columns' means, which are computed once a solution.
    """
    used_degrees = float(((means @ problem.basis) ** 2).sum())
    if problem.retained is None:
        return used_degrees
    added, mixing = problem.retained.added, problem.retained.mixing

    def of_all_effects():
        of_columns = means @ added.columns
        return of_columns.T @ of_columns

    gram = cached(problem.cache, (POSE_MEANS,), of_all_effects)
    return used_degrees + float(((gram @ mixing) * mixing).sum())


def remaining_residual(problem: Problem) -> np.ndarray:
    """(N,) the residual, orthogonal to the baseline and to the retained effects."""
    retained = problem.retained
    if retained is None:
        return problem.orthogonalise(problem.residual)
    return retained.y
