"""Random displacement of whole stripes from image to image: a random effect, judged by its held-out likelihood.

Jitter of a mirror, vibration faster than the images and irregular timing move a stripe as a whole, by another amount in
each image. Nothing that was recorded predicts the amount, so that no held-out RMS error falls when it is in the model.
What the model does predict is the spread: the score of a held-out board pose is the log density of its stripes
(logarithmic score: Gneiting & Raftery, J. Am. Stat. Assoc. 102 (2007) 359) with the variance v + t^2 that the other
board poses show, v the variance of the mean of a stripe's centres, against v alone.

A board pose that is held by its corners errs, which moves its stripes smoothly with the mirror's angle. Only contrasts
of the stripes of one board pose count that are orthogonal to a parabola in that angle: the likelihood of contrasts is
the restricted one (Patterson & Thompson, Biometrika 58 (1971) 545), so that t has no bias from what they leave out.

Jitter displaces a stripe as a whole. What a model of the lens, the board or the light plane leaves varies along stripes
as much as between them: such stripes are displaced, but not at random. Neither are stripes whose centres depend on the
brightness of the line, as by blooming: brightness differs from image to image, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtrc, fdtrc

from sensors.light.grouping import groups
from workbench.core.effect import Effect
from workbench.core.least_squares.adjustment_tests import neighbour_test
from workbench.diagnosis.levels import (
    CRITICAL_T,
    DATA_FAULT_LEVEL,
    LEAST_NUMBER,
    MAJORITY,
    NEGLIGIBLE_SHARE,
    UNMODELLED_LEVEL,
)
from workbench.diagnosis.linear.problem import Finding, Problem
from workbench.diagnosis.scanner.sensor_linear import residual_of_stripes
from workbench.diagnosis.validation.folds import schemes

EFFECT, WHERE = "mirror-jitter", "mirror"
_FEWEST_POSES = 3
"""Board poses of which two predict the third."""
_DEGREE = 2
"""Of the polynomial in the mirror's angle that the error of a board pose makes."""


@dataclass(frozen=True)
class ImageJitter:
    """`sigma_px` 1 sigma (px) by which whole stripes are displaced, `std_px` its standard error; `p_value` of a
    chi-square test that their noise does as much; `gain` in log density of held-out board poses, with its paired `t`;
    `stripes` their number."""

    sigma_px: float
    std_px: float
    p_value: float
    gain: float
    t: float
    stripes: int

    @property
    def finding(self) -> Finding:
        """As a finding on the data: there is no effect to be fitted."""
        return Finding(EFFECT, WHERE, "", (), self.p_value, 1.0, 0.0, self.gain)

    @property
    def parameters(self) -> tuple[dict, ...]:
        """The spread as a row of parameters."""
        row = {
            "key": f"{WHERE}.{EFFECT}.sigma",
            "name": "sigma",
            "where": WHERE,
            "label": "1 sigma of the displacement of whole stripes",
            "effect": EFFECT,
            "value": self.sigma_px,
            "std": self.std_px,
            "unit": "px",
            "typical": 0.1,
            "size_px": self.sigma_px,
        }
        return (row,)


@dataclass(frozen=True)
class _Stripes:
    """Stripes of one set of effects: contrasts `z` (k,) px of held-out board poses with their `variance` (k,) px^2 of
    noise and their board `pose` (k,); by how much each stripe is `displaced` (s,) px in the fit of all, with its `step`
    (s,) and its place `order` (s,) in time; `bent_px` RMS of what varies smoothly along stripes there."""

    z: np.ndarray
    variance: np.ndarray
    pose: np.ndarray
    displaced: np.ndarray
    step: np.ndarray
    order: np.ndarray
    bent_px: float

    @property
    def sigma(self) -> float:
        """px, most probable spread."""
        return _likeliest(self.z, self.variance)

    @property
    def is_systematic(self) -> bool:
        """Whether it is no chance: stripes are bent, or those of one step or one after another displaced alike."""
        if self.bent_px > MAJORITY * self.sigma or self._by_step() < DATA_FAULT_LEVEL:
            return True
        ordered = np.argsort(self.order, kind="stable")
        previous = np.empty(len(ordered), int)
        previous[ordered] = np.r_[ordered[1], ordered[:-1]]
        return neighbour_test(self.displaced[None], previous).p_value < DATA_FAULT_LEVEL

    def _by_step(self) -> float:
        """p-value of a one-way analysis of variance, with the degrees of freedom that the contrasts leave."""
        _, step = np.unique(self.step, return_inverse=True)
        means = np.bincount(step, self.displaced) / np.bincount(step)
        between_steps = float((means[step] ** 2).sum())
        within_steps = float(((self.displaced - means[step]) ** 2).sum())
        degrees = step.max() - _DEGREE
        remaining_degrees = len(self.z) - degrees
        if degrees < 1 or remaining_degrees < 1 or within_steps <= 0:
            return 1.0
        return float(
            fdtrc(
                degrees,
                remaining_degrees,
                between_steps / degrees / (within_steps / remaining_degrees),
            )
        )

    def scores(self, random: bool) -> np.ndarray:
        """(G,) log density of each board pose's contrasts, with the spread of all others, or with noise alone."""
        poses, group = np.unique(self.pose, return_inverse=True)
        scores = np.empty(len(poses))
        for k in range(len(poses)):
            of_pose, others = group == k, group != k
            if random:
                sigma = _likeliest(self.z[others], self.variance[others])
            else:
                sigma = 0.0
            deviance = _deviance(sigma**2, self.z[of_pose], self.variance[of_pose])
            scores[k] = -deviance
        return scores


def find_image_jitter(bench, effects: Sequence[Effect], problem: Problem) -> ImageJitter | None:
    """Random displacement of whole stripes next to some effects; None where there is none, or where it is no chance.

    bench: a `SensorBench`; problem: of all its samples, whose folds are taken.
    """
    found = _stripes(bench, tuple(effects), problem)
    return None if found is None else _image_jitter(bench, found)


def jitter_before_proof(bench, effects: Sequence[Effect], problem: Problem) -> ImageJitter | None:
    """As `find_image_jitter`, next to the effects where they raise the held-out likelihood with jitter, else without.

    effects: that a search accepted against noise alone. On the samples that it saw some of them imitate jitter.
    """
    plain = _stripes(bench, (), problem)
    if plain is None or not effects:
        return None if plain is None else _image_jitter(bench, plain)
    fitted = _stripes(bench, tuple(effects), problem)
    gains = fitted.scores(True) - plain.scores(True)
    is_real = _paired_t(gains) > CRITICAL_T
    return _image_jitter(bench, fitted if is_real else plain)


def _image_jitter(bench, found: _Stripes) -> ImageJitter | None:
    sigma = found.sigma
    count = len(found.displaced)
    # a displacement matters from the noise of one averaged point of a stripe on
    noise = float(np.median(bench.chains.board_stripes.sigma))
    if count < LEAST_NUMBER or not sigma > noise:
        return None
    p_value = float(chdtrc(len(found.z), (found.z**2 / found.variance).sum()))
    gains = found.scores(True) - found.scores(False)
    t = _paired_t(gains)
    if p_value > UNMODELLED_LEVEL or not t > CRITICAL_T or found.is_systematic:
        return None
    dependence = bench.chains.dependence
    if dependence is not None and dependence.is_relevant:
        return None
    information = (sigma**2 / (found.variance + sigma**2)) ** 2
    std = sigma / np.sqrt(2 * information.sum())
    return ImageJitter(sigma, float(std), max(p_value, 1e-300), float(gains.sum()), t, count)


def _stripes(bench, effects, problem: Problem) -> _Stripes | None:
    """None where there are too few stripes or board poses."""
    chain = bench.chains.board_stripes
    if chain is None:
        return None
    fold = schemes(bench.pose, problem)[0].fold
    pose = chain.labels["placement"]
    step = chain.labels["step"]
    stripe, count = groups(pose, step)
    _, first = np.unique(stripe, return_index=True)
    weight = np.broadcast_to(chain.sigma, (1, chain.n))[0] ** -2.0
    total = np.bincount(stripe, weight, count)
    fitted = _fitted(bench, effects)
    means = np.stack(
        [
            np.bincount(stripe, weight * residual, count) / total
            for residual in (bench.held_out_stripes(effects, fold), fitted)
        ]
    )
    bent = _smooth_rms(fitted - means[1, stripe], stripe, chain.state.stripe_place)
    order = bench.order[bench.of_board_stripes][first]
    variance = 1 / total
    if bench.focal is not None:  # stripes are displaced by the focal length of their image, too
        variance += (
            np.bincount(stripe, weight * bench.focal.of_stripes(chain), count) / total
        ) ** 2
    found = _contrasts(
        means, variance, pose[first], step[first], _angles(chain, step[first]), order
    )
    return None if found is None else replace(found, bent_px=bent)


def _smooth_rms(residual: np.ndarray, stripe: np.ndarray, position: np.ndarray) -> float:
    """px, RMS of the part of residuals (n,) that neighbours along a `stripe` (n,) share: noise is independent."""
    order = np.lexsort((position, stripe))
    first = order[:-1]
    second = order[1:]
    is_same_stripe = stripe[first] == stripe[second]
    products = residual[first] * residual[second]
    return float(np.sqrt(max(products[is_same_stripe].mean(), 0.0)))


def _fitted(bench, effects) -> np.ndarray:
    """(n,) px, residuals of stripes on boards in the fit of all samples, with the errors that points of a stripe share.

    Held-out stripes of one step all miss by what a mirror from few displaced stripes is off; these do not.
    """
    chains, fit = bench.solve(effects)
    return residual_of_stripes(chains, effects, fit)


def _angles(chain, step: np.ndarray) -> np.ndarray:
    """(s,) where each stripe stands in the sweep: its mirror angle, or the number of its step."""
    if chain.angles is None:
        return step.astype(float)
    return chain.angles[step]


def _contrasts(means, variance, pose, step, angle, order) -> _Stripes | None:
    """Of means (2, s) px, held out and fitted, with variances (s,) px^2, within each board pose."""
    z = []
    spread = []
    poses = []
    displaced = np.full(means.shape[1], np.nan)
    for k in np.unique(pose):
        of_pose = np.flatnonzero((pose == k) & np.isfinite(means).all(0))
        size = min(_DEGREE, len(of_pose) - 2) + 1
        if size < 1:
            continue
        place = angle[of_pose] - angle[of_pose].mean()
        place = place / max(np.abs(place).max(), 1e-300)
        orthonormal = np.linalg.qr(np.vander(place, size, increasing=True), mode="complete")[0]
        complement = orthonormal[:, size:]
        z.append(complement.T @ means[0, of_pose])
        spread.append((complement**2).T @ variance[of_pose])
        poses.append(np.full(complement.shape[1], k))
        displaced[of_pose] = complement @ (complement.T @ means[1, of_pose])
    if len(z) < _FEWEST_POSES:
        return None
    used = np.isfinite(displaced)
    return _Stripes(
        np.concatenate(z),
        np.concatenate(spread),
        np.concatenate(poses),
        displaced[used],
        step[used],
        order[used],
        0.0,
    )


def _deviance(variance: float, z: np.ndarray, noise: np.ndarray) -> float:
    """Minus the log density of contrasts (k,) with noise of variance (k,) and a further `variance`, but for a
    constant."""
    total = noise + variance
    return 0.5 * float((np.log(total) + z**2 / total).sum())


def _likeliest(z: np.ndarray, noise: np.ndarray) -> float:
    """px, the spread with the largest likelihood of contrasts (k,), 0 where noise alone is more probable."""
    scale = np.log(float(np.sqrt(np.median(noise))))
    reach = -np.log(NEGLIGIBLE_SHARE)
    best = minimize_scalar(
        lambda x: _deviance(np.exp(2 * x), z, noise),
        bounds=(scale - reach, scale + reach),
        method="bounded",
    )
    sigma = float(np.exp(best.x))
    if best.fun < _deviance(0.0, z, noise):
        return sigma
    return 0.0


def _paired_t(gains: np.ndarray) -> float:
    """t of the mean of gains (G,) of board poses."""
    spread = gains.std(ddof=1) / np.sqrt(len(gains))
    if spread > 0:
        return float(gains.mean() / spread)
    return 0.0
