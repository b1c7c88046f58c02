"""Resampling of a real recording: bootstrap of its poses, or parametric bootstrap of its fitted model."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

import datasets
from datasets.recording import Recording
from workbench.core.errors import InputError
from workbench.jobs.robot.calibrate import Calibration, calibrate
from workbench.studies.robots import plan_of
from workbench.studies.spec import Study


@lru_cache(maxsize=2)
def original(name: str) -> Recording:
    """The samples of the recording that move with the arm; read once per process."""
    recording = datasets.read(name)
    return recording.select(recording.moving)


@lru_cache(maxsize=4)
def fitted(name: str, model: str, folds: int) -> Calibration:
    """The calibration of the whole recording; computed once per process."""
    recording = original(name)
    return calibrate(recording, plan_of(model, recording), folds=folds)


def resampled(study: Study, rng: np.random.Generator) -> Recording:
    """The recording of one run."""
    recording = original(study.recording)
    if study.resample.how == "poses":
        return by_poses(recording, study.resample.count, rng)
    return with_new_noise(
        fitted(study.recording, study.models[0], study.folds), study.resample.noise, rng
    )


def by_poses(recording: Recording, count: int | None, rng: np.random.Generator) -> Recording:
    """Whole poses drawn with replacement (the pairs bootstrap over clusters: Davison & Hinkley, Bootstrap Methods and
    their Application, 1997, sec. 3.8), in the order in which they were measured; `count` None draws all of them."""
    labels = recording.poses
    rows = np.argsort(labels, kind="stable")
    first = np.searchsorted(labels[rows], np.arange(labels.max() + 2))
    drawn = np.sort(rng.integers(labels.max() + 1, size=count or labels.max() + 1))
    if len(np.unique(drawn)) < 4:
        raise InputError(
            f"study, key resample.count: expected enough poses for a calibration, found "
            f"{len(np.unique(drawn))} different ones of {recording.name}; increase it"
        )
    order = np.concatenate([rows[first[pose] : first[pose + 1]] for pose in drawn.tolist()])
    chosen = recording.select(order)
    columns = chosen.columns | {"sample": np.arange(1.0, len(order) + 1)}
    return replace(chosen, columns=columns, is_resampled=True)


def with_new_noise(calibration: Calibration, scale: float, rng: np.random.Generator) -> Recording:
    """Measurements of the calibrated robot at the same readings, with noise of `scale` times the fitted sigma."""
    model, parameters = calibration.model, calibration.solution.parameters
    residual = model.residual(parameters)
    # sigma of the fit: the stated one, scaled by the residuals
    sigma = model.sigma(parameters) * calibration.solution.fit.sigma_scale
    noisy = residual + scale * sigma * rng.normal(size=residual.shape)
    recording = calibration.recording
    columns = recording.columns | model.chain.measurement.columns(noisy)
    return replace(recording, columns=columns)
