"""The global test of a calibration: its residual against the stated noise, replicates and its own structure."""

import numpy as np

from workbench.core.adjustment_tests import (
    outlying,
    redundancy,
    robust_sigma,
    standardised_squares,
    variance_test,
)
from workbench.core.identifiability import identifiability
from workbench.core.model import Model
from workbench.core.solve import solve
from workbench.noise_report import Findings, NoiseReport, Replicates, replicate_noise, report
from workbench.residual_structure import Samples, structure

_OUTLIER_LEVEL = 0.002
_MOST_OUTLYING = 0.25  # a larger share is no group of faulty samples but a model that fits nothing
_CONDITIONS = ("payload_kg", "approach")


def noise_report(calibration) -> NoiseReport:
    """The comparison of noise estimates for a `workbench.calibrate.Calibration`."""
    everyone = np.ones(calibration.recording.n, bool)
    fitted = everyone if calibration.fitted is None else calibration.fitted
    recording = calibration.recording.select(fitted)
    model, fit = calibration.model.at(fitted), calibration.solution.fit
    position = fit.residual[:3]
    degrees = fit.degrees * position.size / fit.residual.size
    stated = None if model.chain.sigma_unknown else model.chain.stated_sigma[:3]
    squares = _checked_squares(model, fit)
    wrong = _outlying(squares, len(position), stated, model, fit)
    corrected = (position**2).sum(0) * position.size / max(degrees, 1.0)
    found = Findings(
        stated=None if stated is None else float(f"{np.sqrt((stated**2).mean()):.12g}"),
        test=None if stated is None else variance_test(position / stated, degrees),
        replicates=_replicates(recording, model, position, wrong),
        residual=robust_sigma(corrected, len(position)),
        residual_rms=float(np.sqrt(corrected.mean() / len(position))),
        degrees=degrees,
        structure=structure(model, fit.parameters, fit.residual, _samples(recording)),
        rms=calibration.fit["rms_mm"],
        reach=reach_of(model.chain.robot, model.chain.variables),
        samples=recording.n,
        components=len(position),
        outlying=tuple(int(k) for k in recording.sample_ids[wrong]),
        left_out=calibration.suspects,
    )
    return report(found)


def _checked_squares(model: Model, fit) -> np.ndarray:
    """(n,) squared position residuals over their covariance, under the sigma that the fit used."""
    _, rows = model.linearise(fit.parameters)
    sigma = model.sigma(fit.parameters)
    covariance = identifiability(fit.normal, fit.parameters).covariance
    return standardised_squares((fit.residual / sigma)[:3], redundancy((rows / sigma)[:, :3], covariance))


def _outlying(squares, components: int, stated, model: Model, fit) -> np.ndarray:
    """(n,) True for samples that do not agree with the others.

    Least squares spreads faulty samples over all residuals (masking). Where it finds none, or many, the test is made
    again on the residual of a robust solve.
    """
    sigma = model.sigma(fit.parameters)[:3]
    least = 0.0 if stated is None else float(np.median(stated / sigma))
    wrong = outlying(squares, components, least, _OUTLIER_LEVEL)
    robust = solve(model, fit.parameters, "cauchy")
    white = robust.residual[:3] / sigma
    more = outlying(standardised_squares(white), components, least, _OUTLIER_LEVEL)
    # Of the robust solve only samples that its weights have all but removed: the leverage of a clean sample is not
    # known there.
    more &= robust.weights < 0.1
    both = wrong | more
    return both if both.mean() <= _MOST_OUTLYING else np.zeros(len(both), bool)


def _replicates(recording, model: Model, residual: np.ndarray, wrong: np.ndarray) -> Replicates | None:
    """Noise from rows of one pose, target and load; rows that are copies of one another are counted once."""
    kept = np.flatnonzero(~wrong)
    kept = kept[_first_of_copies(residual[:, kept])]
    keys = [recording.poses, model.chain.measurement.numbers[: recording.n]]
    keys += [np.round(v, 3) for k, v in recording.covariates.items() if k.startswith(_CONDITIONS)]
    _, group = np.unique(np.stack(keys)[:, kept], axis=1, return_inverse=True)
    return replicate_noise(group.ravel(), residual[:, kept])


def _first_of_copies(residual: np.ndarray) -> np.ndarray:
    """Indices of columns that no earlier column repeats exactly."""
    return np.sort(np.unique(residual, axis=1, return_index=True)[1])


def _samples(recording) -> Samples:
    order = np.arange(recording.n, dtype=float)
    return Samples(recording.poses, recording.columns.get("time_s", order))


def reach_of(robot, variables: np.ndarray) -> float:
    """Sum of the nominal lengths and offsets, and of the travel of slides, mm; joint variables (J, n) in rad or mm."""
    travel = np.abs(variables).max(1)[robot.prismatic]
    return float(np.abs(robot.geometry[:, 1:3]).sum() + travel.sum())


__all__ = ["noise_report", "reach_of"]
