"""The global test of a calibration: its residual against the stated noise, replicates and its own structure."""

from dataclasses import replace

import numpy as np

from datasets.recording import SCATTER
from robot_model.measurements.ball_scan import FILE_KIND
from workbench.core.least_squares.adjustment_tests import (
    outlying,
    redundancy,
    robust_sigma,
    standardised_squares,
    variance_test,
)
from workbench.core.least_squares.identifiability import identifiability
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.core.least_squares.solver import Fit, solve
from workbench.core.model import Model
from workbench.fitting.verdicts.noise_report import (
    Findings,
    NoiseReport,
    Replicates,
    RotationNoise,
    is_above,
    replicate_noise,
    report,
)
from workbench.fitting.verdicts.residual_structure import Samples, Structure, structure
from workbench.fitting.verdicts.smooth_dependence import smooth_dependence

_OUTLIER_LEVEL = 0.002
_ROUNDS = 6
_MOST_OUTLYING = 0.25  # a larger share is no group of faulty samples but a model that fits nothing
_CONDITIONS = ("payload_kg", "approach")


def noise_report(calibration) -> NoiseReport:
    """The comparison of noise estimates for a `workbench.jobs.robot.calibrate.Calibration`."""
    everyone = np.ones(calibration.recording.n, bool)
    fitted = everyone if calibration.fitted is None else calibration.fitted
    recording = calibration.recording.select(fitted)
    model = calibration.model.at(fitted)
    fit = calibration.solution.fit
    position = fit.residual[:3]
    degrees = fit.degrees * position.size / fit.residual.size
    stated = None if model.chain.sigma_unknown else model.chain.stated_sigma[:3]
    test = None if stated is None else variance_test(position / stated, degrees)
    exceeds = test is None or is_above(test)
    wrong = _outlying(model, fit, stated, exceeds)
    known = structure(model, fit.parameters, fit.residual, _samples(recording))
    if exceeds and not known.found:
        smooth = smooth_dependence(model, fit.parameters, fit.residual)
        known = smooth if smooth.found else known
    if known.found or not exceeds:
        absorbed = None
    else:
        absorbed = _absorbed(model, fit, _samples(recording))
    corrected = (position**2).sum(0) * position.size / max(degrees, 1.0)
    found = Findings(
        stated=None if stated is None else float(f"{np.sqrt((stated**2).mean()):.12g}"),
        test=test,
        replicates=_replicates(recording, model, position, wrong),
        residual=robust_sigma(corrected, len(position)),
        residual_rms=float(np.sqrt(corrected.mean() / len(position))),
        degrees=degrees,
        structure=known,
        rms=calibration.fit["rms_mm"],
        reach=reach_of(model.chain.robot, model.chain.variables),
        samples=recording.n,
        components=len(position),
        outlying=tuple(int(k) for k in recording.sample_ids[wrong]),
        left_out=calibration.suspects,
        rotation=_rotation(recording, model, fit),
        absorbed=absorbed,
        within_scans=_within_scans(recording),
        **_held_out_errors(calibration),
    )
    return report(found)


def _held_out_errors(calibration) -> dict[str, float]:
    """Errors on left-out poses, and that of the orientation in the fit, as of `Findings`; nan where unknown."""
    held_out = calibration.held_out
    return {
        "held_out_rms": held_out.get("rms_mm", np.nan),
        "held_out_deg": held_out.get("rotation_rms_deg", np.nan),
        "fit_deg": calibration.fit.get("rotation_rms_deg", np.nan),
    }


def _within_scans(recording) -> float | None:
    """RMS distance (mm) by the scatter of points within scans; None where no sample is a scan."""
    scatter = recording.columns.get(SCATTER)
    return None if scatter is None else float(np.sqrt((scatter**2).mean()))


def _absorbed(model: Model, fit: Fit, samples: Samples) -> Structure | None:
    """Structure of the residual that the geometry alone leaves, to first order about the fit; None without effects."""
    _, rows = model.linearise(fit.parameters)
    free = np.flatnonzero(fit.parameters.mask)
    is_geometry = free < len(model.chain.parameters)
    if is_geometry.all():
        return None
    sigma = model.sigma(fit.parameters)
    effect_of_others = np.tensordot(
        fit.parameters.values[free[~is_geometry]], rows[~is_geometry], axes=1
    )
    white = ((fit.residual - effect_of_others) / sigma).ravel()
    columns = (rows[is_geometry] / sigma).reshape(is_geometry.sum(), -1).T
    change = least_squares(columns, white)
    remaining = (white - columns @ change).reshape(fit.residual.shape) * sigma
    return structure(model, fit.parameters, remaining, samples)


def _rotation(recording, model: Model, fit: Fit) -> RotationNoise | None:
    """Orientations against their own stated noise; None where the recording states none (column sigma_deg)."""
    if "sigma_deg" not in recording.columns or len(fit.residual) <= 3:
        return None
    stated = model.chain.stated_sigma[3:]
    rotation = fit.residual[3:]
    degrees = fit.degrees * rotation.size / fit.residual.size
    expected = float(np.rad2deg(np.sqrt((stated**2).sum(0).mean())))
    rotation_rms = float(np.rad2deg(np.sqrt((rotation**2).sum(0).mean())))
    return RotationNoise(expected, variance_test(rotation / stated, degrees), rotation_rms)


def _outlying(model: Model, fit: Fit, stated: np.ndarray | None, exceeds: bool) -> np.ndarray:
    """(n,) True for samples that do not agree with the others (iterated data snooping).

    Least squares spreads faulty samples over all residuals (masking). The set of faulty samples therefore starts from
    a robust solve; then all samples are tested against least squares without that set until it does not change.
    """
    nobody = np.zeros(fit.residual.shape[1], bool)
    wrong = _tested(model, fit, stated, nobody)
    if not wrong.any() and not exceeds:
        return nobody
    robust = solve(_with_scale(model, 0.0), fit.parameters, "cauchy")
    white = robust.residual[:3] / model.chain.sigma[:3]
    wrong = outlying(
        standardised_squares(white), len(white), _least_scale(model, stated), _OUTLIER_LEVEL
    )
    for _ in range(_ROUNDS):
        if wrong.mean() > _MOST_OUTLYING:
            return nobody
        squares = (white[:, ~wrong] ** 2).sum(0)
        scale = robust_sigma(squares, len(white))
        fit_without = solve(_with_scale(model, scale).at(~wrong), robust.parameters)
        before = wrong
        wrong = _tested(_with_scale(model, scale), fit_without, stated, wrong)
        if np.array_equal(before, wrong):
            break
    return wrong if wrong.mean() <= _MOST_OUTLYING else nobody


def _with_scale(model: Model, scale: float) -> Model:
    """The model with sigmas of `scale` times those of the fit, but never below the stated ones.

    A calibration widens sigma until it explains faulty samples too; priors would then outweigh the good ones.
    """
    chain = model.chain
    scaled = np.maximum(
        max(scale, 1e-3) * chain.sigma, 0 if chain.sigma_unknown else chain.stated_sigma
    )
    return replace(model, chain=replace(chain, sigma=scaled), _bases={})


def _least_scale(model: Model, stated: np.ndarray | None) -> float:
    if stated is None:
        return 0.0
    return float(np.median(stated / model.chain.sigma[:3]))


def _tested(model: Model, fit: Fit, stated: np.ndarray | None, left_out: np.ndarray) -> np.ndarray:
    """(n,) True for samples that a fit without the samples `left_out` (n,) finds outlying."""
    squares = _squares(model, fit, left_out)
    components = min(3, len(fit.residual))
    return outlying(squares, components, _least_scale(model, stated), _OUTLIER_LEVEL, ~left_out)


def _squares(model: Model, fit: Fit, left_out: np.ndarray) -> np.ndarray:
    """(n,) squared position residuals over their covariance; left_out (n,): samples that `fit` did not see."""
    residual, rows = model.linearise(fit.parameters)
    sigma = model.sigma(fit.parameters)
    covariance = identifiability(fit.normal, fit.parameters).covariance
    reduced = redundancy((rows / sigma)[:, :3], covariance)
    predicted = (
        2 * np.eye(reduced.shape[1]) - reduced
    )  # I + H instead of I - H: the fit adds its own uncertainty
    reduced[left_out] = predicted[left_out]
    return standardised_squares((residual / sigma)[:3], reduced)


def _replicates(
    recording, model: Model, residual: np.ndarray, wrong: np.ndarray
) -> Replicates | None:
    """Noise from rows of one pose, target and load; rows that are copies of one another are counted once.

    None for points of a ball's surface: those of one pose lie at different places of the ball, and repeat nothing.
    """
    if recording.measures == FILE_KIND:
        return None
    retained = np.flatnonzero(~wrong)
    retained = retained[_first_of_copies(residual[:, retained])]
    keys = [recording.poses, model.chain.measurement.numbers[: recording.n]]
    keys += [np.round(v, 3) for k, v in recording.covariates.items() if k.startswith(_CONDITIONS)]
    _, group = np.unique(np.stack(keys)[:, retained], axis=1, return_inverse=True)
    return replicate_noise(group.ravel(), residual[:, retained])


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
