"""Simulated recordings with known noise: an arm that is off its data sheet, measured with noise of any kind."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from robot_model import load_robot
from robot_model.system import geometry_free
from scenes import model_of, scene
from workbench.core.solution import Stage
from workbench.fitting.calibration_plans.plans import FRAMES
from workbench.jobs.robot.calibrate import Calibration, calibrate

SIGMA = 0.02
XYZ = ("x_mm", "y_mm", "z_mm")


def normal(rng, n):
    return rng.standard_normal((3, n))


def heavy(rng, n):
    """Student's t with 5 degrees of freedom, scaled to variance 1: moderately heavy tails."""
    return rng.standard_t(5, (3, n)) / np.sqrt(5 / 3)


@lru_cache(maxsize=8)
def _true(measures, n, seed):
    """Scene and the exact columns that an arm off its data sheet makes."""
    made = scene(measures, n=n, seed=seed, sigma=SIGMA)
    rng, model = np.random.default_rng(seed), model_of(made)
    truth = model.parameters
    free = truth.only(truth.matching(*geometry_free(made.robot)))
    size = np.array([1e-3 if p.unit == "rad" else 0.4 for p in free.table])[free.mask]
    truth = free.unpack(free.pack() + size * rng.standard_normal(len(size)))
    return made, model.chain.measurement.columns(model.residual(truth))


def recorded(seed, n=80, law=normal, measures="external-point", times=1.0, arm=0, change=None):
    """A recording with noise of `times` the stated sigma.

    change: a function of points (3, n) and generator that makes the points that are recorded.
    """
    made, exact = _true(measures, n, arm)
    rng = np.random.default_rng(1000 + seed)
    points = np.stack([exact[name] for name in XYZ]) + times * SIGMA * law(rng, n)
    if change is not None:
        points = change(points, rng)
    return replace(
        made.recording, columns={**made.recording.columns, **exact, **dict(zip(XYZ, points))}
    )


def geometry_of(recording, **more) -> Calibration:
    """The calibration by geometry alone, in two folds: cheap."""
    robot = load_robot(recording.robot)
    plan = (
        Stage("geometry", "lengths and angles", free=(*FRAMES, *geometry_free(robot)), earn=False),
    )
    return calibrate(recording, plan, folds=2, **more)
