"""Rotations and their uncertainty."""

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.core.rigid import rotation_vector_std


def test_the_spread_of_a_rotation_vector_follows_that_of_a_small_rotation():
    """Against drawn small rotations about the axes of the frame, at an angle of 90 deg."""
    rng = np.random.default_rng(0)
    vector = np.array([0.4, -1.2, 0.9])
    covariance = np.diag([1e-3, 4e-4, 2e-4]) ** 2
    turns = Rotation.from_rotvec(rng.multivariate_normal(np.zeros(3), covariance, 20000))
    drawn = (turns * Rotation.from_rotvec(vector)).as_rotvec()
    stated = rotation_vector_std(vector, covariance)
    np.testing.assert_allclose(drawn.std(0), stated, rtol=0.03)
    assert np.abs(stated / np.sqrt(np.diag(covariance)) - 1).max() > 0.1
    unknown = np.diag([np.inf, 1.0, 1.0])
    assert rotation_vector_std(vector, unknown)[0] == np.inf
