"""Does the hand-eye model fit the data as recorded, and if not, which single mistake explains it?

The scatter of the estimated board pose is compared with what the corner noise alone makes of it. Where it is larger,
alternatives are fitted: every frequent mistake undone, images assigned to other poses, a free scale of the flange
positions, poses of another moment than the images, and a sensor or a board that moved between two images. A cause is
named only where its alternative fits near the noise, several times better than the recorded data, and better than the
number of alternatives tried makes likely by chance.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensors.hand_eye.checks.alternatives import (
    OUTLIERS,
    Alternative,
    change_alternatives,
    outlier_alternative,
    outlying,
    permutation_alternatives,
    reading_alternatives,
    scale_alternative,
)
from sensors.hand_eye.checks.corner_noise import CornerNoise
from sensors.hand_eye.checks.mistakes import Reading
from sensors.hand_eye.checks.nouns import BOARD_IMAGES, Nouns
from sensors.hand_eye.checks.pose_data import PoseData, PoseFit
from sensors.hand_eye.checks.pose_fit import fit_poses
from sensors.hand_eye.checks.time_lag import lag_alternatives
from workbench.core.rigid import inverse, rotation_vector

# mm, and a share of the distance from flange to board: what an arm that was never calibrated is off by.
_ARM_MM, _ARM_SHARE = 1.0, 0.002
_NOISY = 4.0
_CERTAIN = 2.0
_CHANCE = 1e-4
# An unexplained scatter of this many times an arm's error is reported.
_UNEXPLAINED = 3.0
# Beyond this the data are wrong, whatever the reason.
_IMPOSSIBLE, _IMPOSSIBLE_DEG = 10.0, 5.0
_CLOSE = 1.5
UNEXPLAINED = "unexplained"
"""Cause of a finding that knows none."""


@dataclass(frozen=True)
class Finding:
    """A suspected mistake: `cause` a short name, `sentence` for people; `certain`: the recorded data cannot be right.

    `corrected_mm`: scatter of the board with the mistake undone, nan where that is not known.
    """

    cause: str
    sentence: str
    certain: bool
    corrected_mm: float = float("nan")


@dataclass(frozen=True)
class Review:
    """The recorded data against the model.

    `scatter_mm`: RMS scatter of the estimated board's corners as recorded, `trimmed_mm` of the best three quarters of
    the images. `noise`: what the corner noise alone makes of it. `findings`: the most likely first. `outliers`: images,
    counted from 0, without which the others fit, so that these alone are wrong.
    """

    scatter_mm: float
    trimmed_mm: float
    noise: CornerNoise
    findings: tuple[Finding, ...]
    fit: PoseFit | None = None
    outliers: tuple[int, ...] = ()

    @property
    def expected_mm(self) -> float:
        """mm, RMS scatter of the board corners that the corner noise alone causes."""
        return self.noise.corners_mm

    @property
    def noise_px(self) -> float:
        """px, 1 sigma of one coordinate of a detected corner."""
        return self.noise.sigma_px

    @property
    def certain(self) -> bool:
        """Whether a finding is certain: one mistake undone explains data that cannot be right as recorded."""
        return any(finding.certain for finding in self.findings)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The sentences of the review."""
        return tuple(finding.sentence for finding in self.findings)


@dataclass(frozen=True)
class Named:
    """Names of the images or rows, kind ("in-hand" or "to-hand": where the sensor is) and nouns of the sentences."""

    images: Sequence[str]
    kind: str
    nouns: Nouns = BOARD_IMAGES


def review(
    data: PoseData,
    noise: CornerNoise,
    named: Named,
    readings: Iterable[Reading],
    starts=(),
    further_alternatives: Callable[[PoseData], Sequence[Alternative]] | None = None,
) -> Review:
    """Test the recorded data and, where they fail, every alternative.

    noise: of the corners, from each image alone; zero where it is unknown. readings: flange poses with one mistake
    undone each. starts: (4, 4) sensor poses to start from. further_alternatives: further alternatives.
    """
    recorded = fit_poses(data, starts=starts)
    result = Review(recorded.rms, recorded.trimmed_rms, noise, (), recorded)
    fitted = [*outlier_alternative(data, recorded), *change_alternatives(data, recorded, named)]
    fitted += scale_alternative(data, named.nouns)
    if result.scatter_mm > _NOISY * result.expected_mm:
        fitted += permutation_alternatives(data, recorded, named)
        fitted += reading_alternatives(data, readings, named.kind)
        fitted += lag_alternatives(data, recorded, named)
        fitted += further_alternatives(data) if further_alternatives is not None else ()
    best, others = _best_alternative(result, fitted, _arm(data, recorded))
    if best is not None and best.cause == OUTLIERS:  # the adjustment names them one by one
        return replace(result, outliers=tuple(np.flatnonzero(outlying(recorded)).tolist()))
    arm = _arm(data, recorded)
    if best is None:
        finding = _unexplained(result, data, arm, named.nouns)
    else:
        finding = _finding(result, best, others, arm, named.nouns)
    return result if finding is None else replace(result, findings=(finding,))


def _arm(data, fit) -> float:
    """mm by which a plausible arm scatters the board: its lever is the distance from flange to board."""
    local = data.seen[0][:, :3, :3] @ data.corners.mean(1) + data.seen[0][:, :3, 3]
    lever = np.linalg.norm(local @ fit.sensor[0][:3, :3].T + fit.sensor[0][:3, 3], axis=1)
    return _ARM_MM + _ARM_SHARE * min(float(np.median(lever)), 3000.0)


def _best_alternative(reviewed: Review, fitted: list[Alternative], arm: float):
    """The accepted alternative that explains the data best, None where none does, and what explains them as well."""
    accepted = [
        alternative
        for alternative in fitted
        if _is_better(reviewed, alternative, len(fitted)) and _is_named(reviewed, alternative, arm)
    ]
    if not accepted:
        return None, []
    smallest_misfit = min(alternative.misfit for alternative in accepted)
    close = [
        alternative for alternative in accepted if alternative.misfit <= _CLOSE * smallest_misfit
    ]
    best = min(close, key=lambda alternative: (alternative.rank, alternative.misfit))
    others = {
        alternative.symptom
        for alternative in close
        if alternative.cause != best.cause and alternative.rank <= best.rank
    }
    return best, sorted(others)


def _finding(
    reviewed: Review, best: Alternative, others: Sequence[str], arm: float, nouns: Nouns
) -> Finding:
    is_explained = _is_near(reviewed, best, arm)
    certain = is_explained and best.recorded(reviewed) > max(arm, _CERTAIN * best.misfit)
    sentence = _sentence(reviewed, best, others, is_explained, nouns)
    return Finding(best.cause, sentence, certain, best.misfit)


def _is_near(reviewed, alternative: Alternative, arm: float) -> bool:
    """Whether an alternative leaves no more than the corner noise or a plausible arm."""
    return alternative.misfit <= max(_NOISY * reviewed.expected_mm, arm * alternative.grows)


def _is_named(reviewed, alternative: Alternative, arm: float) -> bool:
    """A mistake undone may leave a rest; added parameters, which fit a part of anything, may not.

    Where the data as recorded scatter no more than a plausible arm, replacing them names the arm's own errors. Rows
    left out may leave a scatter that would not be reported by itself.
    """
    if alternative.extra == 0:
        return alternative.recorded(reviewed) > arm
    if alternative.cause == OUTLIERS:
        return alternative.misfit <= max(_NOISY * reviewed.expected_mm, _UNEXPLAINED * arm)
    return _is_near(reviewed, alternative, arm)


def _is_better(reviewed, alternative: Alternative, tried: int) -> bool:
    """Likelihood ratio with variances unknown, corrected for the number tried and for the parameters added."""
    before = max(alternative.recorded(reviewed), 1e-12)
    after = max(alternative.misfit, 1e-12)
    if not np.isfinite(after):
        return False
    numbers = 6 * len(reviewed.fit.distance)
    gain = max(numbers - 12 - alternative.extra, 1) * np.log(before / after)
    needed = np.log(max(tried, 1) / _CHANCE) + 0.5 * alternative.extra * np.log(numbers)
    return bool(before > alternative.falls * after and gain > needed)


def _sentence(reviewed, best: Alternative, others, is_explained, nouns: Nouns) -> str:
    """State what happened, why it matters, what to do."""
    other_causes = f" (explained as well: {'; '.join(others[:2])})" if others else ""
    remaining_error = "" if is_explained else "; a part of the error remains unexplained"
    return (
        f"{best.symptom}{other_causes}: the {nouns.target}, which never moves, scatters by "
        f"{best.recorded(reviewed):.3g} mm as recorded and by {best.misfit:.2g} mm with "
        f"this corrected{_noise_words(reviewed, ' (', ')')}{remaining_error}; {best.do}"
    )


def _noise_words(reviewed, before: str, after: str) -> str:
    """What the corner noise makes of the scatter; empty where it is unknown."""
    if not reviewed.expected_mm:
        return ""
    return f"{before}the corner noise makes {reviewed.expected_mm:.2g} mm{after}"


def _unexplained(reviewed: Review, data: PoseData, arm: float, nouns: Nouns) -> Finding | None:
    """Only say that the poses do not fit what was measured, where the error is more than any arm's."""
    if reviewed.trimmed_mm <= max(_UNEXPLAINED * arm, _NOISY * reviewed.expected_mm):
        return None
    disagreement = rotation_disagreement(data, reviewed.fit.labels)
    where = (
        f"flange and camera rotated by different angles between the same two poses, by "
        f"{disagreement:.1f} deg in the median: "
        f"check the order and the unit of the angles, and which pose belongs to which {nouns.sample}"
        if disagreement > 1
        else "the rotations agree and the positions do not: check the position columns, the unit of lengths and "
        f"{nouns.size}"
    )
    sentence = (
        f"the flange poses do not fit the {nouns.measured}: the {nouns.target}, which never moves, scatters by "
        f"{reviewed.scatter_mm:.3g} mm{_noise_words(reviewed, ', where ', '')}; {where}"
    )
    impossible = disagreement > _IMPOSSIBLE_DEG or reviewed.trimmed_mm > _IMPOSSIBLE * arm
    return Finding(UNEXPLAINED, sentence, impossible)


def rotation_disagreement(data: PoseData, labels: np.ndarray) -> float:
    """deg, median difference between the angles by which flange and camera rotated (Chen, CVPR 1991)."""
    seen = data.seen[labels, np.arange(data.count)]
    i, j = np.triu_indices(data.count, 1)
    flange = inverse(data.moved[j]) @ data.moved[i]
    camera = seen[j] @ inverse(seen[i])
    alpha, beta = (
        np.linalg.norm(rotation_vector(motions[:, :3, :3]), axis=1) for motions in (flange, camera)
    )
    return float(np.degrees(np.median(np.abs(alpha - beta))))
