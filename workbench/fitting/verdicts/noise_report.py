"""Three estimates of the noise compared: as stated, from replicates, from the residuals; and what they say of a fit."""

from dataclasses import dataclass, field

import numpy as np

from workbench.core.distributions import chi2, fisher
from workbench.core.least_squares.adjustment_tests import VarianceTest, effective_degrees, p_text
from workbench.fitting.plausibility.hypotheses.corrections import listed
from workbench.fitting.verdicts.residual_structure import ORDER, Structure
from workbench.fitting.verdicts.verdict import REPLICATES, STATED

NONE, NOTICE, ALARM = "none", "notice", "alarm"
_LEVEL = 0.001
# Ratios of standard deviations between these are not reported: noise is hardly ever known to better than a tenth, and
# an instrument that is somewhat better than stated harms nothing.
_RELEVANT, _TOO_LARGE = 1.1, 1 / 1.5
_ROBUST_AGREES = 1.3  # of the robust sigma, which is less certain
_STILL_LARGE = 1.5
_LEAST_REPEATS = 6  # degrees of freedom per component below which replicates say little
# Industrial arms that were never calibrated are accurate to 0.05 to 0.3 % of their reach (ISO 9283 tests), calibrated
# ones to 0.01 to 0.05 %. A fit that leaves more than this is no calibration, whatever the noise.
IMPLAUSIBLE_SHARE = 0.002
# The same of an orientation: by it, a tool of a tenth of the reach is displaced by 0.2 % of the reach.
IMPLAUSIBLE_DEG = float(np.rad2deg(10 * IMPLAUSIBLE_SHARE))
# Cross-validation of a right model inflates the held-out error by about sqrt(1 + u/(N - u)), with u parameters and N
# coordinates. At 1.5 times, parameters take more than half of the coordinates.
TOO_FEW = 1.5
_NAMED = 12
DIAGNOSE = "run `workbench diagnose`"


@dataclass(frozen=True)
class Replicates:
    """Noise from repeated measurements: `sigma` of one coordinate (mm) with `degrees` of freedom."""

    sigma: float
    degrees: float


@dataclass(frozen=True)
class RotationNoise:
    """Stated noise of an orientation: RMS (deg) of its angle, the test of the variance factor against it, and the RMS
    (deg) of the angles that the fit leaves."""

    stated_rms_deg: float
    test: VarianceTest
    fit_rms_deg: float


@dataclass(frozen=True)
class Findings:
    """Summary of a fit's residual; lengths in mm, sigmas of one coordinate.

    `stated` None where the recording does not say; `test` of the variance factor then None too. `residual`: sigma from
    the residuals, robust; `residual_rms` the same from their mean square, with `degrees` of freedom. `rms`: of the 3-D
    distances. `reach` of the arm (mm). `outlying`: sample numbers that do not agree with the others, of `samples`.
    `components`: coordinates of one measured position (1 where lengths are measured).
    `left_out`: sample numbers that the fit leaves out as blunders. `rotation`: where the noise of orientations is
    stated. `absorbed`: structure of the residual of the geometry alone, where retained terms leave none.
    `is_diagnosed`: whether the fit is that of a diagnosis, after which another one is no advice. `within_scans`: where
    samples are scans of balls, the RMS distance (mm) that the scatter of the points within a scan makes. `held_out_rms`
    (mm) and `held_out_deg`: errors on left-out poses, `fit_deg` that of the orientation in the fit; nan where unknown.
    """

    stated: float | None
    test: VarianceTest | None
    replicates: Replicates | None
    residual: float
    residual_rms: float
    degrees: float
    structure: Structure | None
    rms: float
    reach: float
    samples: int
    components: int = 3
    outlying: tuple[int, ...] = ()
    left_out: tuple[int, ...] = ()
    rotation: RotationNoise | None = None
    absorbed: Structure | None = None
    is_diagnosed: bool = False
    within_scans: float | None = None
    held_out_rms: float = np.nan
    held_out_deg: float = np.nan
    fit_deg: float = np.nan

    @property
    def is_absorbed(self) -> bool:
        """Whether the residual has a structure that the retained terms absorb."""
        return self.absorbed is not None and self.absorbed.found


@dataclass(frozen=True)
class NoiseReport:
    """The comparison in words. `level`: `NONE`, `NOTICE` (usual for a real arm) or `ALARM` (the result is not usable).

    `sentence` sums it up; `warnings` are the findings that a user has to know of, `alarms` those of them that put the
    whole result in doubt.
    """

    findings: Findings
    level: str
    sentence: str
    warnings: tuple[str, ...] = ()
    alarms: tuple[str, ...] = field(default=())

    @property
    def is_above(self) -> bool | None:
        """Whether the residual exceeds the stated noise, else that of replicates; None where neither is known."""
        found = self.findings
        if found.test is not None:
            return is_above(found.test)
        return None if found.replicates is None else _exceeds_replicates(found)

    @property
    def stated_rms(self) -> float | None:
        """RMS distance, mm, that the stated noise causes; None where none is stated."""
        found = self.findings
        if found.stated is None:
            return None
        return float(np.sqrt(found.components) * found.stated)

    @property
    def replicates_rms(self) -> float | None:
        """RMS distance, mm, that the noise of replicates causes; None without replicates."""
        found = self.findings
        if found.replicates is None:
            return None
        return float(np.sqrt(found.components) * found.replicates.sigma)

    @property
    def known_rms(self) -> tuple[float, str] | None:
        """RMS distance, mm, that the noise causes, and its source: stated, else from replicates."""
        found = self.findings
        if found.stated is not None:
            return float(np.sqrt(found.components) * found.stated), STATED
        if found.replicates is not None:
            return float(np.sqrt(found.components) * found.replicates.sigma), REPLICATES
        return None

    @property
    def is_above_scatter(self) -> bool | None:
        """Whether the residual exceeds what the scatter within scans makes; None where no sample is a scan."""
        found = self.findings
        if not found.within_scans:
            return None
        ratio = np.sqrt(found.components) * found.residual_rms / found.within_scans
        return bool(ratio > _RELEVANT and chi2.sf(found.degrees * ratio**2, found.degrees) < _LEVEL)

    @property
    def discrepancy_rms(self) -> float | None:
        """RMS distance (mm) that the model misses: what the fit leaves beyond the noise. None: the noise is unknown.

        0 where the residual agrees with the noise, or is larger by what may be noise stated too small. The noise is
        that of replicates where there are some.
        """
        found = self.findings
        sigma = found.stated if found.replicates is None else found.replicates.sigma
        if sigma is None:
            return None
        has_structure = found.structure is not None and found.structure.found
        is_missed = has_structure if found.replicates is None else _exceeds_replicates(found)
        if not (self.is_above and is_missed):
            return 0.0
        unexplained_square = max(found.residual_rms**2 - sigma**2, 0.0)
        return float(np.sqrt(found.components * unexplained_square))

    @property
    def advice(self) -> str:
        """Most probable cause of a residual above the noise and what to do, as a part of a sentence."""
        found = self.findings
        if self.alarms and not found.outlying:
            return "recording and model probably do not belong together; see the warnings"
        agrees = found.stated is not None and found.residual < _ROBUST_AGREES * found.stated
        if found.outlying and (agrees or self.alarms):
            return f"{_counted(found.outlying)} do not agree with the others; see the warnings"
        if found.within_scans and found.stated is None and found.replicates is None:
            return (
                "errors of the arm's poses, such as its repeatability, or unmodelled effects remain; "
                f"{DIAGNOSE}"
            )
        known_cause = found.replicates is None or _exceeds_replicates(found)
        if known_cause and (
            found.replicates is not None or (found.structure is not None and found.structure.found)
        ):
            return f"unmodelled effects remain, as in most real arms; {DIAGNOSE}"
        if found.is_absorbed and found.replicates is None:
            return f"an effect that is modelled only in part, or noise stated too small; {DIAGNOSE}"
        if found.is_diagnosed:
            return "noise stated too small is more likely than an unmodelled effect; check sigma_mm"
        return (
            "an effect without a slow dependence on one or two joint angles (gear orders, backlash, compliance), or "
            f"noise stated too small; {DIAGNOSE} before you change sigma_mm"
        )

    def as_json(self) -> dict:
        """The object `noise` of the answer; sigmas of one coordinate, mm."""
        found = self.findings
        test = found.test
        return {
            "stated_mm": found.stated,
            "from_repeats_mm": found.replicates.sigma if found.replicates else None,
            "within_scans_mm": found.within_scans,
            "from_residuals_mm": found.residual,
            "at_most_mm": _bound(found),
            "factor": test.factor if test else None,
            "degrees": test.degrees if test else None,
            "p_value": test.p_above if test else None,
            "p_structure": found.structure.p_value if found.structure else None,
            "residual_depends_on": list(found.structure.depends_on) if found.structure else [],
            "outlying_samples": list(found.outlying),
            "level": self.level,
            "findings": [text for text in self.warnings if text not in self.alarms],
            "sentence": self.sentence,
        }


def replicate_noise(group: np.ndarray, residual: np.ndarray) -> Replicates | None:
    """Noise from the scatter of residuals (m, n) within groups (n,) of repeated measurements; None without enough."""
    counts = np.bincount(group)
    free = len(residual) * int((np.maximum(counts, 1) - 1).sum())
    if free < _LEAST_REPEATS * len(residual):
        return None
    means = np.stack([np.bincount(group, row) for row in residual]) / np.maximum(counts, 1)
    squares = ((residual - means[:, group]) ** 2).sum(0)
    repeated = counts[group] > 1
    sigma = float(np.sqrt(squares.sum() / free))
    size = len(residual) * int(repeated.sum())
    if sigma > 0:
        return Replicates(sigma, effective_degrees(squares[repeated], free, size))
    return None


def report(found: Findings) -> NoiseReport:
    """Compare the estimates of the noise and put the result into words."""
    alarms = _implausible(found) or _implausible_held_out(found)
    exceeds = found.test is not None and is_above(found.test)
    cause = _cause(found) if exceeds else _agreement(found)
    first = [_factor(found), cause] if exceeds else [cause]
    sentence = " ".join(part for part in first if part)
    statement = _replicates_disagree(found)
    notices = [sentence] if exceeds or _is_below(found) else []
    notices += [
        text for text in (statement, _rotation(found), _outliers(found), _left_out(found)) if text
    ]
    level = ALARM if alarms else NOTICE if notices else NONE
    full_text = " ".join(part for part in (sentence, statement) if part)
    return NoiseReport(found, level, full_text, (*alarms, *notices), alarms)


def is_above(test: VarianceTest) -> bool:
    """Whether a variance factor is larger than 1 significantly and by more than noise is ever known."""
    return test.factor > _RELEVANT and test.p_above < _LEVEL


def _is_below(found: Findings) -> bool:
    test = found.test
    return test is not None and test.factor < _TOO_LARGE and test.p_below < _LEVEL


def _bound(found: Findings) -> float:
    """Upper bound of the noise: the residual less its certain structure."""
    share = found.structure.share if found.structure else 0.0
    return float(found.residual_rms * np.sqrt(max(1 - share, 0.0)))


def _implausible(found: Findings) -> tuple[str, ...]:
    if not found.reach > 0 or _above_noise(found) <= IMPLAUSIBLE_SHARE * found.reach:
        return ()
    share = 100 * found.rms / found.reach
    cause = (
        "The samples named below are probably faulty, so the parameters are not to be trusted; correct these samples, "
        "or leave them out with --fit-samples."
        if found.outlying
        else "Recording and model probably do not belong together, so the parameters are not to be trusted; check "
        "units, signs and order of the columns, the robot file, and whether instrument and base stood still."
    )
    return (
        f"The calibrated model fits to only {found.rms:.3g} mm RMS, which is {share:.2g} % of the arm's reach; "
        f"calibrated arms fit to 0.01 to 0.05 %. {cause}",
    )


def _implausible_held_out(found: Findings) -> tuple[str, ...]:
    """An alarm where left-out poses are predicted worse than the nominal geometry of a sound arm would."""
    noise = np.sqrt(found.components) * _known_sigma(found)
    position = _excess(found.held_out_rms, max(found.rms, noise))
    stated = found.rotation.stated_rms_deg if found.rotation else 0.0
    rotation = _excess(found.held_out_deg, max(found.fit_deg, stated))
    errors = []
    if found.reach > 0 and position > IMPLAUSIBLE_SHARE * found.reach:
        share = 100 * found.held_out_rms / found.reach
        errors.append(
            f"{found.held_out_rms:.3g} mm RMS off ({share:.2g} % of the arm's reach; fit {found.rms:.2g} mm)"
        )
    if rotation > IMPLAUSIBLE_DEG:
        errors.append(f"{found.held_out_deg:.3g} deg RMS off (fit {found.fit_deg:.2g} deg)")
    if not errors:
        return ()
    return (
        f"Poses that the model is not fitted to are {' and '.join(errors)}: the recording does not determine this "
        "model. Measure more poses, spread over the range of every joint, or estimate less (--plan).",
    )


def _excess(value: float, expected: float) -> float:
    """The part of an RMS value above the expected one, by squares; 0 where a right model may have it, or unknown."""
    return float(np.sqrt(value**2 - expected**2)) if value > TOO_FEW * expected else 0.0


def _known_sigma(found: Findings) -> float:
    """Noise of a coordinate (mm): stated, else from replicates, else 0."""
    return found.stated or (found.replicates.sigma if found.replicates else 0.0)


def _above_noise(found: Findings) -> float:
    """Part of the 3-D RMS (mm) above the stated noise, else above that of replicates."""
    noise = _known_sigma(found)
    return float(np.sqrt(max(found.rms**2 - found.components * noise**2, 0.0)))


def _factor(found: Findings) -> str:
    test = found.test
    return (
        f"The RMS residual is {found.residual_rms:.3g} mm per coordinate, {test.factor:.3g} times the stated "
        f"noise of {found.stated:.3g} mm (chi-square test of the variance, {test.degrees:.0f} degrees of freedom, "
        f"{p_text(test.p_above)})."
    )


def _cause(found: Findings) -> str:
    """Which is more likely: faulty observations, noise stated too small, or an unmodelled effect; and what to do."""
    if found.outlying and found.residual < _ROBUST_AGREES * found.stated:
        return "Without the outlying samples it agrees with the stated noise."
    if _implausible(found):
        return ""
    if found.replicates is not None:
        return _cause_by_replicates(found)
    if found.structure is not None and found.structure.found:
        return _cause_by_structure(found)
    if found.is_absorbed:
        return (
            f"With the geometry alone, the residual depends on {' and '.join(found.absorbed.depends_on)}; with the "
            "retained terms no dependence is found. These terms may describe an effect only in part (a drift in the "
            "place of a changed load or a slipped tool), or the noise is stated too small. Run `workbench diagnose` "
            "before you change sigma_mm."
        )
    none = (
        "No slow dependence of the residual on one or two joint angles or recorded columns, or on the order of the "
        "samples, is significant."
    )
    if found.is_diagnosed:
        return (
            f"{none} A noise that is stated too small is therefore more likely than an unmodelled effect (the arm's "
            "repeatability counts as noise). Measure some poses repeatedly before you state sigma_mm = "
            f"{found.residual_rms:.2g}."
        )
    return (
        f"{none} Either the noise is stated too small (the arm's repeatability counts as noise), or there is an effect "
        "that these tests do not see: gear orders, backlash, or one that depends on many joints at once (compliance, "
        "an inaccurate load). Run `workbench diagnose`, or measure some poses repeatedly, before you state sigma_mm = "
        f"{found.residual_rms:.2g}."
    )


def _cause_by_structure(found: Findings) -> str:
    names = found.structure.depends_on
    moved = ", or an instrument, sensor, tool or base moved" if ORDER in names else ""
    limit = _bound(found)
    ratio = limit / found.stated
    check = (
        f", {ratio:.3g} times the stated value: check the stated noise, too"
        if ratio > _STILL_LARGE
        else ""
    )
    return (
        f"The residual depends on {listed(names)}, unlike noise: unmodelled effects remain{moved}. The noise is at "
        f"most {limit:.3g} mm{check}.{_next(found, ' Run `workbench diagnose`.')}"
    )


def _next(found: Findings, advice: str) -> str:
    """The advice to diagnose, which a diagnosis itself does not give."""
    return "" if found.is_diagnosed else advice


def _cause_by_replicates(found: Findings) -> str:
    replicates = found.replicates
    if _exceeds_replicates(found):
        return (
            f"Repeated measurements of one pose scatter by {replicates.sigma:.3g} mm only, so that the rest comes from "
            f"unmodelled effects{_next(found, '; run `workbench diagnose`')}."
        )
    return f"Repeated measurements of one pose scatter by as much ({replicates.sigma:.3g} mm)."


def _exceeds_replicates(found: Findings) -> bool:
    """F-test of the residual's variance against that of replicates (lack of fit)."""
    replicates = found.replicates
    ratio = found.residual_rms / replicates.sigma
    degrees = found.degrees if found.test is None else found.test.degrees
    return bool(ratio > _RELEVANT and fisher.sf(ratio**2, degrees, replicates.degrees) < _LEVEL)


def _agreement(found: Findings) -> str:
    if found.stated is None:
        return _without_statement(found)
    if _is_below(found):
        return (
            f"The RMS residual is {found.residual_rms:.3g} mm per coordinate, only {found.test.factor:.2g} times "
            f"the stated noise of {found.stated:.3g} mm; the noise is stated too large, or samples are copies of one "
            "another; correct sigma_mm."
        )
    agrees = "less than" if found.test.p_below < _LEVEL else "in agreement with"
    return (
        f"The RMS residual is {found.residual_rms:.3g} mm per coordinate, {agrees} the stated noise of "
        f"{found.stated:.3g} mm."
    )


def _without_statement(found: Findings) -> str:
    sentence = f"The recording states no noise; the RMS residual is {found.residual_rms:.3g} mm per coordinate"
    if found.within_scans:
        return (
            f"{sentence}. The scatter of the points within a scan makes {found.within_scans:.3g} mm RMS of "
            "the distance; it does not contain errors of the arm's poses. Measure some poses repeatedly to have these "
            "compared."
        )
    if found.replicates is None:
        return (
            f"{sentence}. Write sigma_mm into recording.toml (workbench import: --sigma), or measure some poses "
            "repeatedly, to have it compared."
        )
    ratio = found.residual_rms / found.replicates.sigma
    return f"{sentence}, {ratio:.3g} times the {found.replicates.sigma:.3g} mm by which repeated measurements scatter."


def _replicates_disagree(found: Findings) -> str:
    """Stated noise against that of replicates, two-sided."""
    if found.stated is None or found.replicates is None:
        return ""
    replicates = found.replicates
    ratio = found.replicates.sigma / found.stated
    statistic = replicates.degrees * ratio**2
    if ratio > _RELEVANT and chi2.sf(statistic, replicates.degrees) < _LEVEL:
        return (
            f"Repeated measurements of one pose scatter by {replicates.sigma:.3g} mm per coordinate, {ratio:.3g} times "
            f"the stated noise of {found.stated:.3g} mm; the statement leaves out the repeatability of the arm or is "
            f"too small. State sigma_mm = {replicates.sigma:.2g}."
        )
    if ratio < _TOO_LARGE and chi2.cdf(statistic, replicates.degrees) < _LEVEL:
        return (
            f"Repeated measurements of one pose scatter by only {replicates.sigma:.3g} mm per coordinate, {ratio:.2g} "
            f"times the stated noise of {found.stated:.3g} mm; they are no independent measurements, or the noise "
            "is stated too large."
        )
    return ""


def _rotation(found: Findings) -> str:
    if found.rotation is None or not is_above(found.rotation.test):
        return ""
    test = found.rotation.test
    return (
        f"Orientations: the RMS residual is {test.factor:.3g} times the stated noise of "
        f"{found.rotation.stated_rms_deg:.3g} deg ({p_text(test.p_above)}); unmodelled effects remain, or sigma_deg "
        "is stated too small."
    )


def _outliers(found: Findings) -> str:
    if not found.outlying:
        return ""
    return (
        f"{_counted(found.outlying)} of {found.samples} do not agree with the others (test of each observation, "
        f"family-wise level 0.2 %): {_listed(found.outlying)}. Look into them, or leave them out with --fit-samples."
    )


def _left_out(found: Findings) -> str:
    if not found.left_out:
        return ""
    was = "was" if len(found.left_out) == 1 else "were"
    return (
        f"{_counted(found.left_out)} lay so far off that {'it' if was == 'was' else 'they'} {was} left out of the "
        f"fit as faulty: {_listed(found.left_out)}. Look into why."
    )


def _counted(numbers) -> str:
    return f"{len(numbers)} sample{'s' if len(numbers) != 1 else ''}"


def _listed(numbers) -> str:
    if len(numbers) > _NAMED:
        unlisted = f" and {len(numbers) - _NAMED} more"
    else:
        unlisted = ""
    return f"number {', '.join(map(str, numbers[:_NAMED]))}{unlisted}"
