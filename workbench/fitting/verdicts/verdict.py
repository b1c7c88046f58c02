"""The verdict of a command: its residual compared with the noise and with a tolerance.

Two questions are answered separately. Is the residual larger than the noise explains (chi-square test of the
variance)? Is it small enough for the user (`--tolerance`)? Of these only the second one decides the exit status: a real
arm practically always leaves more than the noise of the tracker, and is good enough all the same. A result that is not
usable at all (an alarm) fails without a tolerance.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from workbench.core.errors import InputError

UNITS = ("mm", "deg", "px")
STATED, REPLICATES, RESIDUALS = "stated", "from replicates", "from residuals"
AS_STATED, WITH_ROUNDING = "as the recording states", ", with the rounding of the readings"
DIAGNOSE = "unmodelled effects, faulty observations or too small a noise statement remain; run `workbench diagnose`"

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-z°µ]*)\s*")
_LEVEL = 0.001
# A ratio of standard deviations below this is not reported, however many samples make it significant: noise is
# hardly ever known to better than a tenth.
_RELEVANT = 1.1
# A held-out error agrees with the noise up to this ratio: the estimated parameters add to it.
_AGREES = 1.25
# No error of an arm is so many times the noise of an instrument: the noise is stated in another unit, or nothing fits.
_INCREDIBLE = 300.0
_UNKNOWN_NOISE = "the noise is unknown (not stated, and too few repeated measurements)"
# Without degrees of freedom there is no test. Twice the noise is then called far above it.
_FAR_UNTESTED = 2.0


@dataclass(frozen=True)
class Tolerance:
    """Largest residual that the user accepts; `unit` is one of `UNITS`."""

    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:g} {self.unit}"


@dataclass(frozen=True)
class Residual:
    """The error that is judged.

    `value` in `unit`; `name` says which statistic it is ("held-out RMS position error"). `degrees` of freedom of its
    mean square where they are known. `is_significant` overrides the test, where the caller has made a better one.
    `has_noise` False: the noise is no yardstick for it (an error that is predicted and not measured).
    """

    value: float
    unit: str = "mm"
    name: str = "RMS residual"
    degrees: float | None = None
    is_significant: bool | None = None
    has_noise: bool = True


@dataclass(frozen=True)
class Noise:
    """Expectation of the same statistic under noise alone, in the same unit.

    `value`: for the RMS of a 3-D distance it is sqrt(3) times sigma of one coordinate. `source` says how it is known:
    `STATED`, `REPLICATES`, `RESIDUALS` or a phrase of the caller's. `expected`: what noise and estimated parameters,
    which are uncertain, make together in samples that no fit used; None where that is not known.
    """

    value: float
    source: str = STATED
    expected: float | None = None


@dataclass(frozen=True)
class Verdict:
    """Whether a result meets its tolerance, and how its residual compares with the noise.

    `passed` None where no tolerance was given and nothing makes the result unusable. `residual`, `noise` and
    `tolerance` in `unit`, None where unknown. `parts`: the verdicts of the single quantities where several were judged
    (position and orientation).
    """

    passed: bool | None
    tolerance: float | None
    unit: str | None
    residual: float | None
    noise: float | None
    noise_source: str | None
    residual_over_noise: float | None
    sentence: str
    parts: tuple["Verdict", ...] = ()

    def as_json(self) -> dict:
        """The object `verdict` of the JSON contract; `checks` holds one object per quantity where there are several."""
        answer = {
            "pass": self.passed,
            "tolerance": self.tolerance,
            "unit": self.unit,
            "residual": self.residual,
            "noise": self.noise,
            "noise_source": self.noise_source,
            "residual_over_noise": self.residual_over_noise,
            "sentence": self.sentence,
        }
        if self.parts:
            answer["checks"] = [part.as_json() for part in self.parts]
        return answer


def parse_tolerances(
    values: Sequence[str] | None, units: Sequence[str] = ("mm",)
) -> tuple[Tolerance, ...]:
    """Tolerances from the values of the repeatable option `--tolerance`: `0.1`, `0.1mm`, `0.05deg`, `0.3px`.

    units: those that the command can judge here, the first is that of a bare number. Raises InputError for a value
    that is not a positive number, a unit that is not judged here, and a unit that is given twice.
    """
    found: list[Tolerance] = []
    for text in values or ():
        tolerance = _parse_tolerance(text, units)
        if any(other.unit == tolerance.unit for other in found):
            raise InputError(
                f"--tolerance {text}: expected one tolerance per unit, found a second one in {tolerance.unit}; "
                "leave one of them out"
            )
        found.append(tolerance)
    return tuple(found)


def _parse_tolerance(text: str, units: Sequence[str]) -> Tolerance:
    match = _NUMBER.fullmatch(text)
    allowed = " or ".join(units)
    if match is None:
        raise InputError(
            f"--tolerance {text}: expected a positive number, with its unit where it is not {units[0]} "
            f"({allowed}), such as 0.1{units[0]}; found '{text}'; correct it"
        )
    value = float(match[1])
    unit = match[2] or units[0]
    if not math.isfinite(value) or value <= 0:
        raise InputError(
            f"--tolerance {text}: expected a number above 0, found {value:g}; correct it"
        )
    if unit not in units:
        raise InputError(
            f"--tolerance {text}: expected a tolerance in {allowed}, which this command judges here, "
            f"found unit '{unit}'; correct the unit or leave the option out"
        )
    return Tolerance(value, unit)


def judge(
    residual: Residual,
    noise: Noise | None = None,
    tolerances: Sequence[Tolerance] = (),
    advice: str = DIAGNOSE,
) -> Verdict:
    """The verdict on one residual.

    noise: None where it is neither stated nor can be estimated. tolerances: of any units; the one in the residual's
    unit applies. advice: what a residual far above the noise means and what to do, without a full stop.
    """
    limit = next(
        (tolerance.value for tolerance in tolerances if tolerance.unit == residual.unit), None
    )
    known = noise is not None and noise.value > 0
    if known and math.isfinite(residual.value):
        ratio = residual.value / noise.value
    else:
        ratio = None
    passed = None if limit is None else bool(residual.value <= limit)
    phrases = [_against_tolerance(residual, limit), _against_noise(residual, noise, ratio, advice)]
    return Verdict(
        passed,
        limit,
        residual.unit,
        residual.value,
        noise.value if known else None,
        noise.source if known else None,
        ratio,
        "; ".join(phrase for phrase in phrases if phrase) + ".",
    )


def no_verdict(sentence: str) -> Verdict:
    """The verdict of a command that measures no residual; the sentence says why there is none."""
    return Verdict(None, None, None, None, None, None, None, sentence)


def combine(verdicts: Sequence[Verdict]) -> Verdict:
    """One verdict on several quantities: it passes where none of them fails.

    Its figures are those of the first that fails, else of the first with a tolerance, else of the first.
    """
    if len(verdicts) == 1:
        return verdicts[0]
    by_rank = sorted(verdicts, key=lambda verdict: {False: 0, True: 1, None: 2}[verdict.passed])
    sentence = _without_repetition([verdict.sentence for verdict in verdicts])
    return replace(by_rank[0], sentence=sentence, parts=tuple(verdicts))


def _without_repetition(sentences: Sequence[str]) -> str:
    """The sentences of several quantities; that the noise is unknown is stated once, at the end."""
    partitions = [sentence.partition(f"; {_UNKNOWN_NOISE}") for sentence in sentences]
    if sum(bool(clause) for _, clause, _ in partitions) < 2:
        return " ".join(sentences)
    kept = [f"{head}." if clause else head for head, clause, _ in partitions]
    clause = _UNKNOWN_NOISE[:1].upper() + _UNKNOWN_NOISE[1:]
    return f"{' '.join(kept)} {clause}, so that these values cannot be compared with it."


def is_far_above(ratio: float, degrees: float | None) -> bool:
    """Whether a residual of `ratio` times the noise is more than chance explains.

    Chi-square test of the variance, one-sided at 0.1 %: degrees * ratio^2 is chi-square distributed with `degrees`
    of freedom where noise is all there is.
    """
    if degrees is None:
        return ratio > _FAR_UNTESTED
    from workbench.core.distributions import chi2

    return bool(ratio > _RELEVANT and chi2.sf(degrees * ratio**2, degrees) < _LEVEL)


def _against_tolerance(residual: Residual, limit: float | None) -> str:
    stated = f"{residual.name} {residual.value:.3g} {residual.unit}"
    stated = stated[:1].upper() + stated[1:]
    if limit is None:
        return stated
    if residual.value <= limit:
        return f"{stated} meets the tolerance of {limit:g} {residual.unit}"
    if not math.isfinite(residual.value):
        return f"{stated} is no number and does not meet the tolerance of {limit:g} {residual.unit}"
    return f"{stated} exceeds the tolerance of {limit:g} {residual.unit} ({residual.value / limit:.3g} times as large)"


def _against_noise(
    residual: Residual, noise: Noise | None, ratio: float | None, advice: str
) -> str:
    if not residual.has_noise:
        return ""
    if noise is None or ratio is None:
        size = f"{residual.value:.3g} {residual.unit}"
        return f"{_UNKNOWN_NOISE}, so that {size} cannot be compared with it"
    stated = f"the noise of {noise.value:.3g} {residual.unit} ({noise.source})"
    is_far = residual.is_significant
    if is_far is None:
        is_far = is_far_above(ratio, residual.degrees)
    if ratio > _INCREDIBLE and noise.source == STATED:
        return (
            f"it is {ratio:.3g} times {stated}, which therefore cannot be that of this recording, or the model is that "
            "of another arm: correct the unit of the noise first (mm and deg)"
        )
    if is_far and ratio < 1:
        return f"it is not larger than {stated}, but it is not random: {advice}"
    if is_far:
        return f"it is {ratio:.3g} times {stated}: {advice}"
    if ratio < 1 / _RELEVANT:
        return f"it is not larger than {stated}, so that smaller model errors cannot be excluded"
    if ratio > _AGREES and residual.value <= _AGREES * (noise.expected or 0.0):
        return (
            f"it agrees with {noise.expected:.3g} {residual.unit}, which {stated} and the uncertainty of the "
            "parameters cause together"
        )
    if ratio > _AGREES:
        return f"it is {ratio:.3g} times {stated}, a difference that is not significant"
    return f"it agrees with {stated}"
