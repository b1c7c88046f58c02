"""Mistakes whose effect is small: of a joint whose axis nearly carries the measured point, or of all ranges.

The recording then fits to a fraction of a millimetre, and only the noise shows that something is wrong. Every single
correction of joint columns is screened at the nominal geometry; those that leave the misfit of the same size are fitted
again with plausible geometry errors and compared with the data as recorded.
"""

from dataclasses import dataclass

import numpy as np

from workbench.core.distributions import chi2
from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import Fit, fit_recording, nominal_scale
from workbench.fitting.plausibility.hypotheses.corrections import Correction
from workbench.fitting.plausibility.hypotheses.joint_corrections import joint_corrections
from workbench.fitting.plausibility.joint_columns.coupled_readings import coupled_readings
from workbench.fitting.plausibility.joint_columns.reading_scales import scaled_readings
from workbench.fitting.plausibility.misfit import rank
from workbench.fitting.plausibility.range_offset import range_offset
from workbench.fitting.plausibility.sampling import even_rows
from workbench.fitting.plausibility.search import CLOSE, SIGN, screen
from workbench.fitting.plausibility.suspicion import Suspicion
from workbench.fitting.plausibility.wording import correction_sentence

_ROWS, _STEPS = 240, 60
_SAME_SIZE, _MAX_FITTED = 4.0, 6
_LEVEL, _RELEVANT = 0.001, 1.1
_EVIDENCE = 30.0
"""Difference of the negative log posteriors: odds of 10^13."""
# Ratio of the misfits without and with an offset of the ranges. Where the flange keeps its orientation, base and tool
# absorb most of an offset, and what remains of it resembles deflections: a smaller ratio is no evidence of either.
_LEAST_RATIO = 1.5
_FALLS, _NEAR_RATIO = 2.0, 1.3
_PLAUSIBLE = 5.0
_LEAST_DEGREES = 12


@dataclass(frozen=True)
class Alternative:
    """One correction, the fit under it, and the fit of the data as recorded on the same rows."""

    correction: Correction
    fit: Fit
    recorded: Fit

    @property
    def gain(self) -> float:
        """Log odds of the corrected against the recorded data; negative where the recorded data fit better."""
        return self.recorded.improbability - self.fit.improbability

    @property
    def is_plausible(self) -> bool:
        """Whether the corrected fit needs no geometry errors beyond those of a data sheet."""
        return bool(np.abs(self.fit.deviations).max(initial=0.0) <= _PLAUSIBLE)


def small_mistakes(robot, recording, recorded: Fit) -> list[Suspicion]:
    """The joint column whose correction explains nearly all that a good fit leaves beyond the noise, or nothing.

    recorded: fit of the data as they are. Unmodelled effects of a sound arm leave a misfit too; a correction is named
    only where it lowers the misfit to about the noise, or to less than half.
    """
    noise = _stated_noise(recording, recorded)
    if recorded.degrees < _LEAST_DEGREES or not _is_above(recorded, noise):
        return []
    found = [
        alternative
        for alternative in (
            *alternatives(robot, recording),
            *_scaled(robot, recording),
            *_coupled(robot, recording),
        )
        if _explains(alternative, noise)
    ]
    found += _of_range(robot, recording)
    if not found:
        return []
    min_scale = min(alternative.fit.scale for alternative in found)
    close = [alternative for alternative in found if alternative.fit.scale <= CLOSE * min_scale]
    best, *others = sorted(
        close, key=lambda alternative: (rank(alternative), alternative.fit.scale)
    )
    sentence = correction_sentence(
        recording, best.recorded, best, [alternative.correction for alternative in others]
    )
    return [Suspicion(sentence, False, best.correction.cause)]


def untested_signs(robot, recording) -> list[Alternative]:
    """Joint columns that fit about as well, or better, with the opposite sign: the data do not test their sign."""
    signs = [
        alternative
        for alternative in alternatives(robot, recording)
        if alternative.correction.cause == SIGN
    ]
    return [
        alternative
        for alternative in signs
        if alternative.is_plausible and alternative.gain > -_EVIDENCE
    ]


def alternatives(robot, recording) -> list[Alternative]:
    """Single corrections of joint columns that leave about the misfit of the recorded data, each fitted."""
    chosen = recording.select(even_rows(recording, _ROWS))
    moving = [
        correction
        for correction in joint_corrections(robot, chosen)
        if _is_moving(chosen, correction)
    ]
    limit = _SAME_SIZE * nominal_scale(robot, chosen)
    promising = [
        screened.correction for screened in screen(robot, chosen, moving) if screened.scale <= limit
    ]
    if not promising:
        return []
    recorded = fit_recording(robot, chosen, steps=_STEPS)
    fitted = []
    for correction in promising[:_MAX_FITTED]:
        try:
            fit = fit_recording(*correction.apply(robot, chosen), steps=_STEPS)
        except (np.linalg.LinAlgError, InputError, ValueError):
            continue
        fitted.append(Alternative(correction, fit, recorded))
    return fitted


def _scaled(robot, recording) -> list[Alternative]:
    """The columns of readings that are in a wrong scale."""
    scales = scaled_readings(robot, recording)
    if not scales:
        return []
    chosen = recording.select(even_rows(recording, _ROWS))
    recorded = fit_recording(robot, chosen, steps=_STEPS)
    return [Alternative(scale.correction, scale.fit, recorded) for scale in scales]


def _coupled(robot, recording) -> list[Alternative]:
    """Couplings of joint readings that the robot file lacks."""
    found = coupled_readings(robot, recording, is_far=False)
    if not found:
        return []
    chosen = recording.select(even_rows(recording, _ROWS))
    recorded = fit_recording(robot, chosen, steps=_STEPS)
    return [Alternative(explanation.correction, explanation.fit, recorded) for explanation in found]


def _of_range(robot, recording) -> list[Alternative]:
    """The constant error of all ranges of the instrument; far larger than any effect of the arm."""
    found = range_offset(robot, recording)
    if found is None:
        return []
    chosen = recording.select(even_rows(recording, _ROWS))
    recorded = fit_recording(robot, chosen, steps=_STEPS)
    if recorded.scale < _LEAST_RATIO * found.fit.scale:
        return []
    alternative = Alternative(found.correction, found.fit, recorded)
    is_clear = alternative.is_plausible and alternative.gain > _EVIDENCE
    return [alternative] if is_clear else []


def _is_moving(recording, correction) -> bool:
    """Whether every column that a correction changes varies: of a constant one, the tool absorbs any change."""
    columns = [recording.columns[name] for name in correction.touches if name in recording.columns]
    return all(np.ptp(values) > 0 for values in columns)


def _stated_noise(recording, fit: Fit) -> float:
    """mm, what the stated noise makes of the misfit of positions; 0 where none is stated or orientations count too."""
    if recording.sigma is None or not np.isnan(fit.rotation_deg):
        return 0.0
    return float(np.median(recording.sigma)) * np.sqrt(len(fit.residual))


def _is_above(fit: Fit, noise: float) -> bool:
    """Chi-square test of the variance, one-sided at 0.1 %; True where no noise is known."""
    if not noise > 0:
        return True
    ratio = fit.scale / noise
    return bool(ratio > _RELEVANT and chi2.sf(fit.degrees * ratio**2, fit.degrees) < _LEVEL)


def _explains(alternative: Alternative, noise: float) -> bool:
    if not alternative.is_plausible or alternative.gain < _EVIDENCE:
        return False
    corrected = alternative.correction.comparable(alternative.fit.scale)
    recorded = alternative.recorded.scale
    to_noise = corrected < _NEAR_RATIO * noise and recorded > _NEAR_RATIO * corrected
    return to_noise or _FALLS * corrected < recorded
