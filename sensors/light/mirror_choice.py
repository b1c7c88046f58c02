"""Whether one mirror makes all light planes: fitted next to the free planes, tested, and the better one chosen."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from sensors.light.mirror import NAMES, Mirror, on_one_branch, start_mirror
from sensors.light.planes import plane_variance
from sensors.scanner.adjustment import Adjustment, fresh_start, solve_once
from sensors.scanner.errors import field_points, laid_over
from workbench.core.effect import Effect
from workbench.core.least_squares.identifiability import independent

FEWEST = 5
"""Steps: 15 numbers of free planes against the mirror's seven."""
_MIN_PROBABILITY = 1e-3
"""Probability below which the stripes contradict the mirror."""
_AS_WELL = 5.0
"""Times the usual sigma of a plane over the working volume, beyond which it does not count for the mirror's start."""
_FIRST = (
    "tilt_face",
    "tilt_across",
    "shift_face",
    "shift_across",
    "beam_cone",
    "beam_turn",
    "beam_shift",
)
# `independent` keeps what is known to ten typical sizes; here to one, and the face's distance is not guessed at.
_STRICT = 10.0


@dataclass(frozen=True)
class MirrorCheck:
    """The mirror compared with the free planes.

    `fitted` names of the parameters that the stripes determine, with `std` in their units (rad, mm);
    `gain` rotation of the mirror per commanded rotation, or rad a step where angles were not commanded;
    `excess` of chi-square over that of the free planes, on `degrees` of freedom, and its
    probability where the mirror is true; `difference_mm` RMS distance of the two kinds of planes
    over the working volume and `expected_mm`, what it should be by their sigmas. `sentences` says
    what is confounded. `supported`: whether it goes into the scanner: where the stripes agree
    with it, or where they do not, but its planes are farther from the truth by less than the free ones' own noise.
    """

    mirror: Mirror
    angles: np.ndarray
    fitted: tuple[str, ...]
    std: dict[str, float]
    gain: float
    excess: float
    degrees: int
    probability: float
    difference_mm: float
    expected_mm: float
    difference_of_step_mm: np.ndarray
    sentences: tuple[str, ...]

    @property
    def agrees(self) -> bool:
        """Whether the stripes agree with one mirror: the test by chi-square alone."""
        return self.probability > _MIN_PROBABILITY

    @property
    def supported(self) -> bool:
        return self.agrees or self.difference_mm < self.expected_mm

    @property
    def verdict(self) -> str:
        """State what is done with the mirror, and why."""
        if self.agrees:
            return "the stripes agree with one mirror; it is used"
        if not self.supported:
            return "the stripes contradict it; it is refused and the free planes are used"
        return (
            "the stripes contradict one perfect mirror, yet its planes differ from the free ones by less than those "
            "err by themselves; it is used as the nearer to the truth, and its sigmas do not hold what it is off"
        )


def try_mirror(
    free: Adjustment,
    commanded: np.ndarray,
    by_step: bool,
    volume: tuple[float, float],
    effects: Sequence[Effect],
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[Adjustment, MirrorCheck]:
    """The adjustment with a mirror instead of free planes, weighted alike, and how it compares.

    commanded: (S,) rad, or numbers of the steps where by_step; at least `FEWEST`. effects: also those of the mirror.
    """
    known = _well_known(free, volume)
    commanded, branches = _on_one_branch(free, commanded, by_step)
    start, gain = start_mirror(free.board_stripes.planes[:, known], commanded[known], by_step)
    refusal = _odd_gain(gain, by_step)
    if refusal:  # what was commanded is no angle of the mirror: only its steps count
        by_step = True
        (start, gain) = start_mirror(free.board_stripes.planes[:, known], commanded[known], True)
    angles = commanded * gain if by_step else commanded
    board_stripes = fresh_start(free, start.planes(angles), start, angles)
    names = (*_FIRST, "gain") if by_step else _FIRST
    progress("one mirror for all planes")
    adjustment = solve_once(free.corners, board_stripes, effects, free.parameters, names)
    names, tied = _determined(adjustment, by_step)
    if len(names) > len(adjustment.free):
        adjustment = solve_once(
            free.corners, adjustment.board_stripes, effects, adjustment.parameters, names
        )
    if by_step:
        gain = gain * adjustment.board_stripes.angles[-1] / angles[-1] if angles[-1] else gain
    return adjustment, _compared(free, adjustment, gain, volume, (*branches, *refusal, *tied))


def _on_one_branch(free: Adjustment, commanded, by_step: bool):
    """The commanded angles on one branch, and sentences on those that were on another."""
    if by_step:
        return commanded, []
    angles = on_one_branch(free.board_stripes.planes, commanded)
    moved = int((angles != commanded).sum())
    if not moved:
        return commanded, []
    return angles, [
        f"mirror_deg of {moved} of {len(angles)} steps is on another branch: a mirror that is turned by 90 deg sends "
        "the light into the same plane; whole quarter turns are taken off"
    ]


def _well_known(free: Adjustment, volume) -> np.ndarray:
    """(k,) steps whose planes are known nearly as well as most: at the sweep's ends few boards are in the light."""
    planes = free.board_stripes.planes
    points, step = field_points(free.camera, planes, *volume)
    variance = plane_variance(planes, points, step, free.best_frame(volume).planes)
    count = np.bincount(step, minlength=planes.shape[1])
    with np.errstate(invalid="ignore"):
        mean = np.bincount(step, variance, planes.shape[1]) / count
    usual = np.nanmedian(mean)
    known = np.flatnonzero(mean <= _AS_WELL**2 * usual)
    return known if len(known) >= FEWEST else np.arange(planes.shape[1])


def _determined(adjustment: Adjustment, by_step):
    """Names of the parameters that the data determine better than was known before, and sentences on the others."""
    names = tuple(name for name in NAMES if by_step or name != "gain")
    full = solve_once(
        adjustment.corners,
        adjustment.board_stripes,
        adjustment.effects,
        adjustment.parameters,
        names,
    )
    _, tied = independent(full.fit.normal, full.fit.table, _STRICT * full.fit.sigma_scale)
    left_out = {key.removeprefix("mirror.") for key in tied if key.startswith("mirror.")} | {
        "face_zero"
    }
    labels = {p.key: p.label for p in full.fit.table.table}
    reasons = [
        f"{labels[f'mirror.{name}']} is not identifiable from these images: it keeps its start value"
        for name in names
        if name in left_out
    ]
    determined = tuple(name for name in names if name in adjustment.free or name not in left_out)
    return determined, reasons


def _odd_gain(gain, by_step):
    if by_step or abs(gain - 1) < 0.05:
        return []
    alternative_gain = (
        ", as if mirror_deg were the angle of the light and not of the mirror"
        if abs(gain - 0.5) < 0.03
        else ""
    )
    return [
        f"the free planes turn by {2 * gain:.3g} of the commanded angle, expected 2{alternative_gain}; "
        "correct mirror_deg; here the mirror's turn per commanded turn was fitted instead"
    ]


def _compared(free, with_mirror, gain, volume, sentences):
    mirror_parameters = len(with_mirror.fit.parameters.pack()) - len(
        free.fit.parameters.pack()
    )  # the mirror's and its effects'
    degrees = max(3 * free.board_stripes.planes.shape[1] - mirror_parameters, 1)
    excess = max(with_mirror.chi2 - free.chi2, 0.0)
    probability = float(
        fdtrc(degrees, free.fit.degrees, excess / degrees / free.fit.sigma_scale**2)
    )
    by_step, overall, expected = plane_differences(free, with_mirror, volume)
    std = {
        name: free_std
        for name in with_mirror.free
        if (free_std := with_mirror.fit.std.get(f"mirror.{name}")) is not None
    }
    return MirrorCheck(
        with_mirror.board_stripes.mirror,
        with_mirror.board_stripes.angles,
        with_mirror.free,
        std,
        float(gain),
        float(excess),
        degrees,
        probability,
        overall,
        expected,
        by_step,
        tuple(sentences),
    )


def plane_differences(free: Adjustment, with_mirror: Adjustment, volume: tuple[float, float]):
    """RMS distance (mm) between the planes of two nested adjustments, a step (S,) and in all, and that expected.

    One laid over the other, see `scanner_errors.laid_over`. The covariance of the difference is the
    difference of the covariances (Hausman, Econometrica 46 (1978)).
    """
    planes = free.board_stripes.planes
    points, step, distance, _ = laid_over(
        free.camera, planes, with_mirror.camera, with_mirror.board_stripes.planes, volume
    )
    count = np.maximum(np.bincount(step, minlength=planes.shape[1]), 1)
    by_step = np.sqrt(np.bincount(step, distance**2, planes.shape[1]) / count)
    variance = plane_variance(
        planes, points, step, free.best_frame(volume).planes - with_mirror.best_frame(volume).planes
    )
    return by_step, float(np.sqrt((distance**2).mean())), float(np.sqrt(max(variance.mean(), 0.0)))
