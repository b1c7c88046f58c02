"""Points of a ball's surface that one pose sees are no repeats of one measurement."""

from types import SimpleNamespace

import numpy as np
import pytest

from workbench.fitting.verdicts.fit_quality import _replicates


def found(measures):
    """Replicates of 20 poses with 10 rows each, whose residuals vary along each profile far beyond the noise."""
    poses = np.repeat(np.arange(20.0), 10)
    place = np.tile(np.linspace(-1, 1, 10), 20)
    slopes = np.repeat(np.linspace(-0.2, 0.2, 20), 10)
    noise = np.random.default_rng(2).normal(0, 0.01, 200)
    recording = SimpleNamespace(measures=measures, poses=poses, n=200, covariates={})
    model = SimpleNamespace(
        chain=SimpleNamespace(measurement=SimpleNamespace(numbers=np.zeros(200)))
    )
    residual = (slopes * place + noise)[None]
    return _replicates(recording, model, residual, np.zeros(200, bool))


def test_points_of_a_profile_are_no_replicates():
    assert found("ball-surface") is None


def test_rows_of_one_pose_of_a_reflector_are_replicates():
    assert found("external-point").sigma == pytest.approx(np.sqrt(0.01**2 + 0.2**2 / 9), rel=0.3)
