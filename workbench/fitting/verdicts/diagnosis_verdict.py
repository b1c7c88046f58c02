"""The verdict of `workbench diagnose`: what its final model leaves, against the noise and against a tolerance.

The word `verdict` of a diagnosis says whether structure was found and explained. It says nothing about the size of
what is left: `consistent` also holds where the noise is stated three times too small, or where an effect is too
irregular for any test. This module says it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robot_model import load_robot
from robot_model.measurements import samples_of
from workbench.core.least_squares.adjustment_tests import robust_sigma, variance_test
from workbench.fitting.verdicts.fit_quality import reach_of
from workbench.fitting.verdicts.noise_report import Findings, NoiseReport, Replicates, report
from workbench.fitting.verdicts.residual_structure import JOINTS, Structure
from workbench.fitting.verdicts.verdict import (
    AS_STATED,
    REPLICATES,
    STATED,
    WITH_ROUNDING,
    Noise,
    Residual,
    Tolerance,
    Verdict,
    judge,
)

_SOURCES = {"from replicates": REPLICATES, AS_STATED: STATED}
_NEIGHBOURS = (
    "from neighbouring points"  # of a sensor's stripes and corners, as "... and jitter" too
)
NOISE_LEVELS = ("stated-noise", "noise-heavy-tailed")
"""Findings of a diagnosis that give another RMS of the noise than the recording states."""
_WITHOUT_STRUCTURE = ("consistent", "explained")


@dataclass(frozen=True)
class DiagnosisCheck:
    """The verdict on the size of what is left, and the comparison of noise estimates; None for a sensor."""

    verdict: Verdict
    noise: NoiseReport | None

    def keys(self, answer: Mapping) -> dict:
        """Keys added to the JSON `answer` of the diagnosis: verdict_details, noise and more warnings."""
        noise_warnings = self.noise.warnings if self.noise else ()
        if any(effect["effect"] in NOISE_LEVELS for effect in answer["effects"]):
            noise_warnings = self.noise.alarms if self.noise else ()  # the finding says the rest
        noise = {"noise": self.noise.as_json()} if self.noise else {}
        warnings = [*answer["warnings"], *noise_warnings]
        return {"verdict_details": self.verdict.as_json(), **noise, "warnings": warnings}


def check_diagnosis(diagnosis, recording, tolerances: Sequence[Tolerance] = ()) -> DiagnosisCheck:
    """Judge what a `workbench.explanation.result.Diagnosis` of a recording leaves."""
    answer = diagnosis.as_json()
    unit, held_out = diagnosis.unit, answer["held_out"]
    if unit == "mm" and diagnosis.views is not None:
        noise = noise_of(diagnosis, recording, held_out)
    else:
        noise = None
    if any(effect["effect"] in NOISE_LEVELS for effect in answer["effects"]):
        is_above = None
        expected = Noise(held_out[f"noise_{unit}"], held_out["noise_from"])
    else:
        is_above = None if noise is None else noise.is_above
        expected = _expected(noise, held_out, unit)
    if expected is not None and held_out[f"noise_{unit}"]:  # repeats may be identical
        grown = held_out[f"expected_{unit}"] / held_out[f"noise_{unit}"]
        expected = replace(expected, expected=expected.value * grown)
    error = Residual(held_out[f"after_{unit}"], unit, "held-out RMS error", is_significant=is_above)
    verdict = judge(error, expected, tolerances, _advice(diagnosis, noise))
    if expected is None and diagnosis.correlation is not None:
        shared = _shared_by_neighbours(diagnosis.correlation.value, held_out, unit)
        verdict = replace(verdict, sentence=f"{verdict.sentence} {shared}")
    return DiagnosisCheck(verdict, noise)


def _shared_by_neighbours(correlation: float, held_out: Mapping, unit: str) -> str:
    """What samples one after another share of a residual whose noise is unknown, and what would judge it.

    The covariance of neighbours, correlation * sigma^2, is at most the variance of what they share.
    """
    total = held_out[f"noise_{unit}"]
    shared = np.sqrt(correlation) * total
    return (
        f"Of the residual of {total:.3g} {unit} (RMS), samples measured one after another share at least "
        f"{shared:.3g} {unit} (correlation {correlation:.2f}). Slow noise and an unmodelled effect are not "
        "distinguishable in it: state sigma_mm, or measure some poses again at other times."
    )


def _expected(noise: NoiseReport | None, held_out: Mapping, unit: str) -> Noise | None:
    """The stated noise where there is one, since the test is against it; else that of replicates."""
    if noise is not None and noise.stated_rms is not None:
        rounded = held_out["noise_from"].endswith(WITH_ROUNDING)
        return Noise(noise.stated_rms, STATED + WITH_ROUNDING * rounded)
    named = held_out["noise_from"]
    if named and named.startswith(_NEIGHBOURS):
        source = named
    else:
        source = _SOURCES.get(named)
    if source is None:
        return None
    return Noise(held_out[f"noise_{unit}"], source)


def noise_of(diagnosis, recording, held_out: Mapping) -> NoiseReport | None:
    """The final model's residual against the stated noise and replicates; outliers are left out.

    The degrees of freedom that the parameters have spent are not counted, so that the factor is never overstated.
    """
    moving = samples_of(recording)
    residual = diagnosis.views.after[:3]
    if (
        residual.shape[1] != moving.n
    ):  # a scan of a ball is one sample, and its noise is not that of points
        return None
    usual = ~np.isin(moving.sample_ids, diagnosis.outliers) & np.isfinite(residual).all(0)
    if not usual.any():
        return None
    remaining = residual[:, usual]
    components = len(residual)
    squares = (remaining**2).sum(0)
    sigma = None if moving.sigma is None else moving.sigma[usual]
    if sigma is not None and diagnosis.views.rounding is not None:
        rounding = (diagnosis.views.rounding[:3] ** 2).mean(0)[usual]
        sigma = np.sqrt(sigma**2 + rounding)
    robot = load_robot(recording.robot, f"robot of {recording.name}")
    if sigma is None:
        stated = None
    else:
        stated = float(f"{np.sqrt((sigma**2).mean()):.12g}")
    return report(
        Findings(
            stated=stated,
            test=None if sigma is None else variance_test(remaining / sigma, remaining.size),
            replicates=_replicates(held_out, components),
            residual=robust_sigma(squares, components),
            residual_rms=float(np.sqrt(squares.mean() / components)),
            degrees=float(remaining.size),
            structure=_structure(diagnosis),
            rms=float(np.sqrt(squares.mean())),
            reach=reach_of(robot, robot.mixing @ moving.joints.T),
            samples=moving.n,
            components=components,
            outlying=tuple(diagnosis.outliers),
            is_diagnosed=True,
        )
    )


def _replicates(held_out: Mapping, components: int) -> Replicates | None:
    lack = held_out.get("lack_of_fit")
    if not lack or held_out["noise_from"] != "from replicates":
        return None
    return Replicates(
        held_out["noise_mm"] / np.sqrt(components), float(lack["after"]["degrees"][1])
    )


def _structure(diagnosis) -> Structure:
    """Structure of the residual according to the diagnosis, which searches more than the global test does."""
    if diagnosis.verdict in _WITHOUT_STRUCTURE:
        return Structure(1.0, 0.0, ())
    names = [
        name
        for located in (*diagnosis.located, *diagnosis.remainder)
        for name in located.depends_on
    ]
    return Structure(
        float(diagnosis.found.p_remainder), 0.0, tuple(dict.fromkeys(names))[:3] or (JOINTS,)
    )


def _advice(diagnosis, noise: NoiseReport | None) -> str:
    if noise is not None and noise.alarms:
        return noise.advice
    if diagnosis.verdict in _WITHOUT_STRUCTURE and diagnosis.unit == "px":
        return (
            "errors that whole stripes or boards share, which no single centre shows, remain in it"
        )
    if diagnosis.verdict in _WITHOUT_STRUCTURE:
        return (
            "no structure is found in it, so that noise stated too small is more likely than an unmodelled effect; "
            "check sigma_mm, or measure some poses repeatedly"
        )
    return "part of it is structure that stays unexplained; see the next experiment"
