"""Does the hand-eye model fit the data as recorded, and if not, which single mistake explains it?

The scatter of the estimated board pose is compared with what the corner noise alone makes of it. Where it is larger,
alternatives are fitted: every frequent mistake undone, images assigned to other poses, a free scale of the flange
positions, and a sensor or a board that moved between two images. A cause is named only where its alternative fits
near the noise, several times better than the recorded data, and better than the number of alternatives tried makes
likely by chance.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensors.hand_eye.alternatives import (
    OUTLIERS,
    Alternative,
    change_alternatives,
    outlier_alternative,
    outlying,
    permutation_alternatives,
    reading_alternatives,
    scale_alternative,
)
from sensors.hand_eye.corner_noise import CornerNoise
from sensors.hand_eye.mistakes import Reading
from sensors.hand_eye.pose_data import PoseData, PoseFit
from sensors.hand_eye.pose_fit import fit_poses
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
    """What looks wrong: `cause` a short name, `sentence` for people; `certain`: the recorded data cannot be right.

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
        """mm, the scatter of the corners that the corner noise makes."""
        return self.noise.corners_mm

    @property
    def noise_px(self) -> float:
        """1 sigma of a coordinate of a corner."""
        return self.noise.sigma_px

    @property
    def certain(self) -> bool:
        """Whether one mistake explains what the recorded data cannot."""
        return any(finding.certain for finding in self.findings)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What to say."""
        return tuple(finding.sentence for finding in self.findings)


@dataclass(frozen=True)
class Named:
    """How the images are called in sentences, and where the sensor is: kind "in-hand" or "to-hand"."""

    images: Sequence[str]
    kind: str


def review(
    data: PoseData, noise: CornerNoise, named: Named, readings: Iterable[Reading], starts=()
) -> Review:
    """Test the recorded data and, where they fail, every alternative.

    noise: of the corners, from each image alone. readings: flange poses with one mistake undone each. starts: (4, 4)
    sensor poses to start from.
    """
    recorded = fit_poses(data, starts=starts)
    made = Review(recorded.rms, recorded.trimmed_rms, noise, (), recorded)
    fitted = [*outlier_alternative(data, recorded), *change_alternatives(data, recorded, named)]
    fitted += scale_alternative(data)
    if made.scatter_mm > _NOISY * made.expected_mm:
        fitted += permutation_alternatives(data, recorded, named)
        fitted += reading_alternatives(data, readings, named.kind)
    best, others = _best_alternative(made, fitted, _arm(data, recorded))
    if best is not None and best.cause == OUTLIERS:  # the adjustment names them one by one
        made = replace(made, outliers=tuple(np.flatnonzero(outlying(recorded)).tolist()))
        best = None
    finding = None if best is None else _finding(made, best, others, _arm(data, recorded))
    finding = finding or _unexplained(made, data, _arm(data, recorded))
    return made if finding is None else replace(made, findings=(finding,))


def _arm(data, fit) -> float:
    """mm by which a plausible arm scatters the board: its lever is the distance from flange to board."""
    local = data.seen[0][:, :3, :3] @ data.corners.mean(1) + data.seen[0][:, :3, 3]
    lever = np.linalg.norm(local @ fit.sensor[0][:3, :3].T + fit.sensor[0][:3, 3], axis=1)
    return _ARM_MM + _ARM_SHARE * min(float(np.median(lever)), 3000.0)


def _best_alternative(made: Review, fitted: list[Alternative], arm: float):
    """The accepted alternative that explains the data best, None where none does, and what explains them as well."""
    accepted = [
        one for one in fitted if _is_better(made, one, len(fitted)) and _is_named(made, one, arm)
    ]
    if not accepted:
        return None, []
    least = min(one.misfit for one in accepted)
    close = [one for one in accepted if one.misfit <= _CLOSE * least]
    best = min(close, key=lambda one: (one.rank, one.misfit))
    others = {one.seems for one in close if one.cause != best.cause and one.rank <= best.rank}
    return best, sorted(others)


def _finding(made: Review, best: Alternative, others: Sequence[str], arm: float) -> Finding:
    near = _is_near(made, best, arm)
    certain = near and best.recorded(made) > max(arm, _CERTAIN * best.misfit)
    return Finding(best.cause, _sentence(made, best, others, near), certain, best.misfit)


def _is_near(made, one: Alternative, arm: float) -> bool:
    """Whether an alternative leaves no more than the corner noise or a plausible arm."""
    return one.misfit <= max(_NOISY * made.expected_mm, arm * one.grows)


def _is_named(made, one: Alternative, arm: float) -> bool:
    """A mistake undone may leave a rest; added parameters, which fit a part of anything, may not.

    Where the data as recorded scatter no more than a plausible arm, replacing them names the arm's own errors.
    """
    if one.extra == 0:
        return one.recorded(made) > arm
    return _is_near(made, one, arm)


def _is_better(made, one: Alternative, tried: int) -> bool:
    """Likelihood ratio with variances unknown, corrected for the number tried and for the parameters added."""
    before, after = max(one.recorded(made), 1e-12), max(one.misfit, 1e-12)
    if not np.isfinite(after):
        return False
    numbers = 6 * len(made.fit.distance)
    gain = max(numbers - 12 - one.extra, 1) * np.log(before / after)
    needed = np.log(max(tried, 1) / _CHANCE) + 0.5 * one.extra * np.log(numbers)
    return bool(before > one.falls * after and gain > needed)


def _sentence(made, best: Alternative, others, near) -> str:
    """What happened, why it matters, what to do."""
    also = f" (explained as well: {'; '.join(others[:2])})" if others else ""
    rest = "" if near else "; a part of the error remains unexplained"
    return (
        f"{best.seems}{also}: the board, which never moves, scatters by {best.recorded(made):.3g} mm as recorded and "
        f"by {best.misfit:.2g} mm with this corrected (the corner noise makes {made.expected_mm:.2g} mm){rest}; "
        f"{best.do}"
    )


def _unexplained(made: Review, data: PoseData, arm: float) -> Finding | None:
    """Only say that the poses do not fit the images, where the error is more than any arm's."""
    if made.trimmed_mm <= max(_UNEXPLAINED * arm, _NOISY * made.expected_mm):
        return None
    apart = rotation_disagreement(data, made.fit.labels)
    where = (
        f"flange and camera rotated by different angles between the same two poses, by {apart:.1f} deg in the median: "
        "check the order and the unit of the angles, and which pose belongs to which image"
        if apart > 1
        else "the rotations agree and the positions do not: check the position columns, the unit of lengths and the "
        "board's square"
    )
    sentence = (
        f"the flange poses do not fit the images: the board, which never moves, scatters by {made.scatter_mm:.3g} mm, "
        f"where the corner noise makes {made.expected_mm:.2g} mm; {where}"
    )
    impossible = apart > _IMPOSSIBLE_DEG or made.trimmed_mm > _IMPOSSIBLE * arm
    return Finding(UNEXPLAINED, sentence, impossible)


def rotation_disagreement(data: PoseData, labels: np.ndarray) -> float:
    """deg, median difference between the angles by which flange and camera rotated (Chen, CVPR 1991)."""
    seen = data.seen[labels, np.arange(data.count)]
    i, j = np.triu_indices(data.count, 1)
    flange, camera = inverse(data.moved[j]) @ data.moved[i], seen[j] @ inverse(seen[i])
    alpha, beta = (
        np.linalg.norm(rotation_vector(one[:, :3, :3]), axis=1) for one in (flange, camera)
    )
    return float(np.degrees(np.median(np.abs(alpha - beta))))
