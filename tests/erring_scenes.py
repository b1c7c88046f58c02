"""Scenes of an arm that errs from its data sheet as arms do, measured with noise."""

from dataclasses import replace

import numpy as np

from robot_model.system import geometry_free
from scenes import model_of, scene


def erring(measures, seed, n=60, lengths=0.4, degrees=0.06, **more):
    """Robot and recording; lengths (mm) and degrees: 1 sigma of the deviations from the data sheet."""
    made = scene(measures, n=n, seed=seed, **more)
    rng, model = np.random.default_rng(seed), model_of(made)
    truth = model.parameters
    free = truth.only(truth.matching(*geometry_free(made.robot)))
    size = np.array([np.deg2rad(degrees) if p.unit == "rad" else lengths for p in free.table])[
        free.mask
    ]
    truth = free.unpack(free.pack() + size * rng.standard_normal(len(size)))
    # Orientations are measured too: they come from the same erring arm as the positions.
    residual = model.residual(truth)
    noise = model.chain.sigma * rng.standard_normal(residual.shape)
    columns = {**made.recording.columns, **model.chain.measurement.columns(residual + noise)}
    return made.robot, replace(made.recording, columns=columns)
