"""Pooled statistics of all balls of all scans: residuals, lack of fit, radii and distances between balls."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sensors.scanner.residuals.misfit import Misfit

POOR = 5.0
"""Multiple of the stated noise from which the distances of points from their balls are no noise."""
_MATERIAL = (
    0.1  # of the stated uncertainty of a centre, below which a displacement of it does not matter
)
_CHANCE = 4.0  # sigmas by which a radius of its own differs from a true one by chance, see `sensors.ball.fit`
# Sigmas from which the distance of two balls is no measurement error: they are not the balls of the certificate.
_GROSS = 10.0


@dataclass
class Largest:
    """The largest of `count` differences: its `size` (sigmas) and the sentence on it."""

    count: int = 0
    size: float = 0.0
    text: str = ""

    def add(self, size: float, text: str) -> None:
        """With one more difference."""
        self.count += 1
        if size > self.size:
            self.size, self.text = size, text

    @property
    def sentence(self) -> str:
        """The largest, and how many more there are."""
        if self.count > 1:
            return f"{self.text}; and {self.count - 1} more"
        return self.text


@dataclass
class BallSums:
    """Over the points of all fitted balls: `squares` of distances (mm^2), what the stated noise (`stated_squares`) and
    that of neighbouring centres (`noise_squares`) make of them, and number of `points`; number of balls `tested` for
    lack of fit, of those with too few stripes for it (`untested`), and of those where it is significant and moves the
    centre (`doubtful`), with the `worst` of these; number of points `overexposed`; the largest differences of `radii`
    and `distances` from the certificate."""

    squares: float = 0.0
    stated_squares: float = 0.0
    noise_squares: float = 0.0
    points: float = 0.0
    tested: int = 0
    untested: int = 0
    doubtful: int = 0
    worst: Misfit | None = None
    overexposed: int = 0
    radii: Largest = field(default_factory=Largest)
    distances: Largest = field(default_factory=Largest)

    def add_scan(self, scan, known: Mapping[int, tuple], scanner) -> None:
        """The sums with the balls of one more scan; known: balls of the certificate, x y z and radius in mm."""
        for ball in scan.balls:
            if ball.fit and ball.fit.sigma_scale > 0 and math.isfinite(ball.fit.rms):
                spread = _spread(ball, scanner)
                self._add(ball.fit, ball.misfit, spread)
                self._add_radius(scan.name, ball, spread)
                self.overexposed += ball.overexposed
        self._add_distances(scan, known)

    def _add(self, fit, misfit: Misfit | None, spread: float) -> None:
        number = float(fit.inliers.sum())
        stated = (fit.rms / fit.sigma_scale) ** 2
        self.squares += number * fit.rms**2
        self.stated_squares += number * stated
        self.points += number
        if misfit is None:
            self.noise_squares += number * stated
            self.untested += 1
            return
        share = misfit.noise_px**2 / (misfit.noise_px**2 + misfit.total_px**2)
        self.noise_squares += number * fit.rms**2 * share
        self.tested += 1
        if not misfit.is_relevant or not _displacement(fit, misfit) > _MATERIAL * spread:
            return
        self.doubtful += 1
        if self.worst is None or _ratio(misfit) > _ratio(self.worst):
            self.worst = misfit

    def _add_radius(self, name: str, ball, spread: float) -> None:
        """A radius of its own that differs from the stated one significantly, and moves the centre."""
        fit = ball.fit
        if abs(fit.radius_gap) > _CHANCE and fit.centre_moves > _MATERIAL * spread:
            text = (
                f"scan {name}, ball {ball.number or 'unnamed'}: {fit.free.radius:.4f} mm instead of "
                f"{fit.radius:.4f} mm, {abs(fit.radius_gap):.2g} sigma; with its own radius the centre moves by "
                f"{1000 * fit.centre_moves:.2g} um"
            )
            self.radii.add(abs(fit.radius_gap), text)

    def _add_distances(self, scan, known: Mapping[int, tuple]) -> None:
        """Distances between named balls of a scan that are not those of the certificate."""
        balls = [ball for ball in scan.balls if ball.fit and ball.number in known]
        for k, second in enumerate(balls):
            for other in balls[:k]:
                self._add_distance(scan.name, (other, second), known)

    def _add_distance(self, name: str, pair, known) -> None:
        ball, other = pair
        stated = np.subtract(known[ball.number][:3], known[other.number][:3])
        line = ball.fit.centre - other.fit.centre
        measured = float(np.linalg.norm(line))
        certified = float(np.linalg.norm(stated))
        covariance = ball.fit.covariance[:3, :3] + other.fit.covariance[:3, :3]
        sigma = float(np.sqrt(line @ covariance @ line)) / measured
        if abs(measured - certified) > _GROSS * sigma:
            text = (
                f"scan {name}, balls {ball.number} and {other.number}: {certified:.3f} mm stated, {measured:.3f} mm "
                f"measured with a standard uncertainty of {sigma:.2g} mm"
            )
            self.distances.add(abs(measured - certified) / sigma, text)

    @property
    def over_stated(self) -> float:
        """Residual over the noise that the stated sigmas make."""
        return math.sqrt(self.squares / max(self.stated_squares, 1e-300))

    @property
    def is_poor(self) -> bool:
        """Whether points lie far from their balls."""
        return self.over_stated > POOR


def _spread(ball, scanner) -> float:
    """mm, 1 sigma of a centre as stated, in the frame of the scan: root of the sum of the variances."""
    covariance = np.array(ball.fit.covariance[:3, :3])
    if ball.common is not None:
        covariance += ball.common
    elif scanner is not None:
        covariance += scanner.frame_covariance(ball.fit.centre[:, None])[..., 0]
    return float(np.sqrt(np.trace(covariance)))


def _displacement(fit, misfit: Misfit) -> float:
    """mm by which a centre moves, 1 sigma, where each of its stripes is displaced by the lack of fit."""
    mm_per_px = fit.rms / math.hypot(misfit.noise_px, misfit.total_px)
    return misfit.total_px * mm_per_px / math.sqrt(misfit.stripes)


def _ratio(misfit: Misfit) -> float:
    return misfit.total_px / misfit.noise_px
