"""Variances of the flange poses at the origin of the flange: position and rotation, estimated jointly.

The adjustment takes the pose errors as independent at the middle of the board, where a rotation error of the flange is
a position error as well. What a robot is judged by is the error at its flange: both components are estimated there, by
restricted maximum likelihood on the linear model of the adjustment.

Their standard deviations are the larger of two. The Fisher information holds for normal errors that are alike in all
directions. Errors of real arms have heavier tails and prefer directions, which makes the variance of a few poses less
certain by a factor of 1.3 to 2 (simulated); the jackknife over the poses (Efron & Stein, Ann. Stat. 9 (1981) 586)
allows for both, but scatters itself.
"""

from dataclasses import dataclass, replace

import numpy as np

from sensors.hand_eye.adjust import (
    Adjusted,
    grams,
    restricted_likelihood,
    solve_linear,
    without_pose,
)
from workbench.core.least_squares.linear_algebra import covariance_of, symmetric_eigen

_SEEN = 2.0
"""Standard deviations by which a variance exceeds zero where it is called one."""


@dataclass(frozen=True)
class FlangeVariance:
    """1 sigma (position, rotation) of one coordinate, mm and rad, and pose errors (P, 6) at the flange.

    `spread` (2,): 0 where the variance is not distinguishable from zero. `std` (2,): 1 sigma of `spread`; of a
    component of 0 the size whose variance is one standard deviation.
    """

    spread: np.ndarray
    std: np.ndarray
    errors: np.ndarray

    def as_keys(self) -> dict[str, float]:
        """Keys of `robot_sigma`."""
        (position, rotation), (position_std, rotation_std) = self.spread, self.std
        return {
            "flange_position_mm": float(position),
            "flange_position_std_mm": float(position_std),
            "flange_rotation_deg": float(np.degrees(rotation)),
            "flange_rotation_std_deg": float(np.degrees(rotation_std)),
        }


def flange_variance(adjusted: Adjusted, pivot: np.ndarray) -> FlangeVariance:
    """Variances of the pose errors of an adjustment of a board, taken at pivot (P, 3) mm, the origin of the flange."""
    chain = replace(adjusted.chain, pivot=pivot, errors=np.zeros_like(adjusted.chain.errors))
    parameters = adjusted.parameters
    model_grams = grams(chain, parameters)
    found = restricted_likelihood(chain, model_grams, parameters, adjusted.variances)
    spread = np.array(found.spread)
    std = np.zeros(2)
    min_sigma = np.array([group.min_sigma for group in chain.groups])
    is_seen = np.zeros(2, bool)
    for k in range(2):
        # tested where it is zero: its standard deviation there is that of the other component alone
        null = np.where(np.arange(2) == k, min_sigma, spread)
        alone = _variance_std(model_grams, parameters, found.noise, null)[k]
        is_seen[k] = spread[k] ** 2 > _SEEN * alone
        std[k] = np.sqrt(alone)
    variance_std = _variance_std(model_grams, parameters, found.noise, spread)
    variance_std = np.maximum(variance_std, _jackknife_std(chain, model_grams, parameters, found))
    std = np.where(is_seen, variance_std / (2 * spread), std)
    errors = solve_linear(model_grams, parameters, found.noise, np.repeat(spread, 3)).errors
    return FlangeVariance(np.where(is_seen, spread, 0.0), std, errors)


def _jackknife_std(chain, model_grams, parameters, found) -> np.ndarray:
    """(2,) 1 sigma of the two variances from their scatter when one pose at a time is left out."""
    used = np.flatnonzero(model_grams[1])
    others = [
        restricted_likelihood(chain, without_pose(model_grams, k), parameters, found).spread
        for k in used
    ]
    variances = np.square(others)
    count = len(used)
    sum_of_squares = ((variances - variances.mean(0)) ** 2).sum(0)
    return np.sqrt((count - 1) / count * sum_of_squares)


def _variance_std(model_grams, parameters, noise: float, spread: np.ndarray) -> np.ndarray:
    """(2,) 1 sigma of the two variances: the inverse of their Fisher information under restricted likelihood.

    With S the variances of all pose errors and C their posterior covariance, T = S^-1 - S^-1 C S^-1, and the
    information of two groups is half the sum of the squares of their block of T (Harville 1977).
    """
    sigma = np.repeat(spread, 3)
    free = parameters.mask
    gram = model_grams[0] / noise**2
    size = int(free.sum())
    group_columns = slice(size, size + len(sigma))
    shared = solve_linear(model_grams, parameters, noise, sigma).covariance
    inverse = covariance_of(gram[:, group_columns, group_columns], sigma**-2) / np.outer(
        sigma, sigma
    )
    mix = (inverse * sigma) @ gram[:, group_columns, :size]
    poses = len(gram)
    rows = mix.reshape(poses * len(sigma), size)
    covariance = (rows @ shared @ rows.T).reshape(poses, len(sigma), poses, len(sigma))
    pose_index = np.arange(poses)
    covariance[pose_index, :, pose_index] += inverse
    projection = -covariance
    projection[pose_index, :, pose_index] += np.eye(len(sigma))
    squares = (projection**2).sum(axis=(0, 2)).reshape(2, 3, 2, 3).sum(axis=(1, 3)) / 2
    values, vectors = symmetric_eigen(squares)
    weights = vectors**2 / np.maximum(values, 1e-300)
    return spread**2 * np.sqrt(weights.sum(axis=1))
