"""The error of a calibrated model at a target: what its held-out error leaves without noise and known uncertainty."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from workbench.core.distributions import chi2
from workbench.files.solution_file import CalibratedArm
from workbench.fitting.discrepancy import expected_discrepancy
from workbench.fitting.verdicts.verdict import REPLICATES, STATED, Noise

_LEVEL = 0.001
_SAME_SIGMA = 0.01  # relative difference up to which two recordings state the same noise
_THREE_COORDINATES = ("external-point", "external-pose")
_MEASURED_POINTS = (*_THREE_COORDINATES, "ball-centre")


@dataclass(frozen=True)
class KnownNoise:
    """`noise` of the instrument as an RMS distance in mm, None where it is unknown or refuted.

    `refuted`: a stated noise that is significantly above the held-out error; None where there is none.
    """

    noise: Noise | None
    refuted: Noise | None = None


def known_noise(arm: CalibratedArm) -> KnownNoise:
    """The noise that a held-out error contains: stated, unless that error refutes it; then that of replicates.

    A held-out error is the noise and errors of the model together. Chi-square test of its variance, one-sided at 0.1 %.
    """
    stated = _of_calibration(arm.keys)
    if stated is None or not _is_refuted(arm, stated.value):
        return KnownNoise(stated)
    replicates = arm.keys.get("replicate_noise_rms_mm")
    if replicates and not _is_refuted(arm, replicates):
        return KnownNoise(Noise(float(replicates), REPLICATES), stated)
    return KnownNoise(None, stated)


def model_error_mm(arm: CalibratedArm) -> float | None:
    """RMS mm that the model misses on unseen poses beyond its uncertainty; None: the noise is unknown.

    The held-out error contains the noise, and what the uncertainty of the parameters and considered terms make at the
    recorded poses: both are part of the uncertainty of every target. What it misses beyond them is a posterior mean
    (`expected_discrepancy`), since the held-out error is itself uncertain.
    """
    noise = known_noise(arm).noise
    if noise is None:
        return None
    causes = noise.value, _of_parameters(arm, noise.value), _considered(arm)
    count = _coordinates(arm)
    if not count:
        return _remaining_sigma(arm.held_out_mm, *causes)
    known = sum(cause**2 for cause in causes)
    return math.sqrt(expected_discrepancy(arm.held_out_mm**2, known, noise.value**2, count))


def remaining_error_mm(arm: CalibratedArm) -> float:
    """RMS mm that a target has apart from `sigma_mm`: the error of the model, with the noise where that is unknown."""
    error = model_error_mm(arm)
    if error is None:
        return _remaining_sigma(arm.held_out_mm, _considered(arm))
    return error


def _remaining_sigma(total: float, *components: float) -> float:
    return math.sqrt(max(total**2 - sum(part**2 for part in components), 0.0))


def _of_parameters(arm: CalibratedArm, noise: float) -> float:
    """RMS mm of what the uncertainty of the parameters makes of the held-out error.

    The mean variance of a prediction at the n fitted measurements is that of the noise times p/n, the mean of the
    hat matrix's diagonal (Hoaglin & Welsch, Am. Stat. 32 (1978) 17); a fold fits n less its own. p: effective number of
    parameters, each less the share of its prior in its precision. 0 where the number of measurements is unknown.
    """
    folds = max(arm.keys["held_out"].get("folds") or 0, 2)
    samples = (arm.keys["held_out"].get("samples") or 0) * (1 - 1 / folds)
    if not samples or arm.keys.get("measures") not in _MEASURED_POINTS:
        return 0.0
    priors = arm.keys.get("priors", {})
    variances = np.diag(arm.covariance)
    shares = []
    for key, v in zip(arm.free, variances):
        shares.append(v / priors[key] ** 2 if priors.get(key) else 0.0)
    effective = sum(max(1.0 - share, 0.0) for share in shares)
    return noise * math.sqrt(effective / (3 * samples))


def _considered(arm: CalibratedArm) -> float:
    return 0.0 if arm.considered is None else arm.considered.recorded_rms_mm


def _of_calibration(keys: Mapping) -> Noise | None:
    """The noise that the verdict of the calibration used; older solutions hold only a stated one."""
    known = keys.get("noise")
    if known is not None:
        return Noise(known["rms_mm"], known["source"])
    stated = keys.get("noise_rms_mm")
    return None if stated is None else Noise(stated)


def _coordinates(arm: CalibratedArm) -> int:
    """Number of measured lengths that the held-out error is of; 0 where it is unknown."""
    samples = arm.keys["held_out"].get("samples") or 0
    return samples * (3 if arm.keys.get("measures") in _THREE_COORDINATES else 1)


def _is_refuted(arm: CalibratedArm, noise: float) -> bool:
    """Whether the held-out error is significantly below a noise (mm); False where the number of samples is unknown."""
    degrees = _coordinates(arm)
    if not degrees or not noise > 0:
        return False
    return bool(chi2.cdf(degrees * (arm.held_out_mm / noise) ** 2, degrees) < _LEVEL)


def noise_factor(arm: CalibratedArm, sigma: np.ndarray) -> float:
    """Noise that a diagnosis found over the stated one, for a recording that states the same; 1 elsewhere.

    sigma: mm, what another recording states for each coordinate.
    """
    factor = arm.keys.get("noise_factor")
    known = arm.keys.get("noise_rms_mm")
    if not factor or not known:
        return 1.0
    stated = math.sqrt(3 * float(np.mean(np.square(sigma))))
    if math.isclose(stated, known, rel_tol=_SAME_SIGMA):
        return float(factor)
    return 1.0


def stated_source(arm: CalibratedArm, sigma: np.ndarray) -> str:
    """Source of the noise of another recording, in words: stated, or stated times the factor of a diagnosis."""
    factor = noise_factor(arm, sigma)
    if factor == 1:
        return STATED
    return f"{STATED}, times {factor:.3g} as the diagnosis found"


__all__ = [
    "KnownNoise",
    "known_noise",
    "model_error_mm",
    "noise_factor",
    "remaining_error_mm",
    "stated_source",
]
