"""Least squares of a ball: geometric distances, robust weights, covariance and bias.

The parameters are the coordinates of the centre and the radius, mm. A residual is positive outside the ball; `rows`
(4, n) are its negative derivatives with respect to centre and radius.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from workbench.core.least_squares.linear_algebra import inverse_positive, solve_positive

# Tukey's and Huber's constants for 95 % efficiency on normal residuals.
_TUKEY, _HUBER = 4.685, 1.345
# median of |z| of a standard normal, and of one cut off at three sigma
_MEDIAN, _MEDIAN_CUT = 0.67449, 0.67221
_ROUNDS = 8
_STEPS = 40
_SUBSET = 5000
# Sigmas: a fit is settled where a step is shorter.
_SETTLED = 3e-3
# Newton steps on all points after a fit of a part of them: so many, of at most so many sigmas.
_REFINEMENTS, _LONGEST_STEP = 4, 30.0
# A Newton step of L sigmas leaves about 0.02 L^2 / sqrt(n) sigmas: up to this L^2 / sqrt(n) it is the last.
_LAST = 0.3
# Points of which a spread or a cap is taken: it is then good to half a per cent.
_ENOUGH = 20_000
BLOCK = 8192
# Below this cosine a line of error only grazes the ball: where it meets it is no smooth function any more.
_GRAZING = 0.1


@dataclass(frozen=True)
class Problem:
    """Points (3, n) and how each of them errs.

    `sigma` (n,) 1-sigma of the distance from the surface or, with `direction` (3, n), unit vectors,
    of the error along that line; `covariance` (3, 3, n) of each point instead of both. `free`: whether
    the radius is fitted.
    """

    points: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray | None = None
    direction: np.ndarray | None = None
    free: bool = True

    @property
    def size(self) -> int:
        """Parameters that are fitted."""
        return len(self.points) + self.free

    def subset(self, chosen: np.ndarray | slice) -> "Problem":
        """The same of the chosen points."""
        pick = (
            None if part is None else part[..., chosen]
            for part in (self.points, self.sigma, self.covariance, self.direction)
        )
        return Problem(*pick, self.free)


@dataclass(frozen=True)
class Linear:
    """A problem at one place: residual, sigma (n,), rows (4, n) and outward unit normals (3, n)."""

    residual: np.ndarray
    sigma: np.ndarray
    rows: np.ndarray
    normal: np.ndarray


def linearise(problem: Problem, values: np.ndarray) -> Linear:
    """Residuals of the centre and radius `values` (4,) and their derivative."""
    displacement = problem.points - values[:-1, None]
    if problem.direction is not None:
        return _along_lines(problem, displacement, values[-1])
    distance = np.sqrt((displacement * displacement).sum(0))
    rows = np.empty((len(values), len(distance)))
    normal = np.divide(displacement, np.maximum(distance, 1e-300), out=rows[:-1])
    rows[-1] = 1
    sigma = problem.sigma
    if problem.covariance is not None:
        sigma = np.sqrt(np.einsum("dn,den,en->n", normal, problem.covariance, normal))
    return Linear(distance - values[-1], sigma, rows, normal)


def _along_lines(problem, displacement, radius) -> Linear:
    """Residuals along the lines of error.

    The line does not depend on the error, so neither do the rows: unlike the distance from the
    surface, weighted by the cosine, this leaves no bias of the order of sigma^2 / radius.
    """
    axial = np.einsum("dn,dn->n", displacement, problem.direction)
    side = np.where(axial < 0, -1.0, 1.0)
    squared_half_chord = radius**2 - np.einsum("dn,dn->n", displacement, displacement) + axial**2
    cosine = np.sqrt(np.maximum(squared_half_chord, 0)) / radius
    hit = cosine > _GRAZING
    distance_to_surface = axial - side * radius * cosine
    normal = (displacement - distance_to_surface * problem.direction) / radius
    rows = np.concatenate([normal, np.ones((1, len(axial)))]) / np.where(hit, cosine, 1)
    return Linear(np.where(hit, side * distance_to_surface, np.inf), problem.sigma, rows, normal)


def huber(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weight psi(z) / z and slope psi'(z) of Huber's loss (Ann. Math. Stat. 35, 1964)."""
    size = np.abs(z)
    return np.minimum(1, _HUBER / np.maximum(size, 1e-300)), (size < _HUBER).astype(float)


def tukey(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weight and slope of Tukey's biweight (Beaton & Tukey, Technometrics 16, 1974)."""
    complement = z * (1 / _TUKEY)
    np.square(complement, out=complement)
    np.minimum(complement, 1, out=complement)
    np.subtract(1, complement, out=complement)
    slope = 5 * complement
    slope -= 4
    slope *= complement
    return np.square(complement, out=complement), slope


def linear(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weight and slope of least squares."""
    return np.isfinite(z).astype(float), np.isfinite(z).astype(float)


LOSSES = {"linear": linear, "huber": huber, "tukey": tukey}
Loss = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def spread(white: np.ndarray, size: int) -> float:
    """Robust sigma of whitened residuals (n,), up to half of which may be outliers, from medians of their sizes.

    The median of all of them, then of those within three such sigmas, until it no longer changes.
    """
    size_of = np.abs(white[:: len(white) // _ENOUGH + 1])
    size_of = np.sort(size_of[np.isfinite(size_of)])
    if not len(size_of):
        return np.nan
    scale = _middle(size_of) / _MEDIAN
    for _ in range(20):
        core = size_of[: np.searchsorted(size_of, 3 * scale, "right")]
        smaller = _middle(core) / _MEDIAN_CUT if len(core) > size else scale
        if smaller >= 0.999 * scale:
            break
        scale = smaller
    return float(scale * np.sqrt(len(size_of) / max(len(size_of) - size, 1)))


def median(values: np.ndarray) -> np.ndarray:
    """(...,) of finite numbers (..., n), by sorting, which takes half the time of `np.median`."""
    return _middle(np.sort(values))


def _middle(ordered):
    """(...,) median of (..., n) ascending numbers."""
    half, odd = divmod(ordered.shape[-1], 2)
    return ordered[..., half] if odd else (ordered[..., half - 1] + ordered[..., half]) / 2


@dataclass(frozen=True)
class Solved:
    """Centre and radius `values` (4,), `spread` (nan where nothing is left), `keep` (n,), the problem there, the
    points' own whitened errors `white` (n,), and the last `step` in sigmas of what was fitted (None: `step_left`)."""

    values: np.ndarray
    spread: float
    keep: np.ndarray
    linear: Linear
    white: np.ndarray
    step: float | None = None


def solve(problem: Problem, values: np.ndarray, loss: Loss, trim: Callable) -> "Solved":
    """Centre and radius, the spread of the whitened residuals, and which points were not trimmed.

    trim(values, normal (3, n), slice) -> (n,) True for the points to keep. Reweighted Gauss-Newton;
    what is trimmed and the spread are settled between rounds. A sparse part of a large cloud comes first, and
    leaves so little that one or two Newton steps on all points are enough.
    """
    n = problem.points.shape[1]
    if n > 4 * _SUBSET:
        part = slice(None, None, n // _SUBSET)
        first = _rounds(problem.subset(part), values, loss, _trim_of_part(trim, part))
        values = first.values
        if np.isfinite(first.spread) and (refined := _refined(problem, values, loss, trim)):
            return refined
    return _rounds(problem, values, loss, _trim_of_part(trim, slice(None)))


def _trim_of_part(trim, part):
    return lambda values, normal: trim(values, normal, part)


def _refined(problem, values, loss, trim) -> "Solved | None":
    """Newton steps on all points from values next to the minimum; None where they do not settle at once."""
    scale = np.nan
    for _ in range(_REFINEMENTS):
        now = _spread_of_some(problem, values, trim)
        scale = scale if abs(now - scale) <= 0.01 * scale else now
        move, length = _newton(problem, values, loss, scale, trim)
        if not length < _LONGEST_STEP:
            return None
        values = values.copy()
        values[: problem.size] += move
        if length**2 < _LAST * np.sqrt(problem.points.shape[1]):
            linear = linearise(problem, values)
            keep = trim(values, linear.normal, slice(None))
            return Solved(values, scale, keep, linear, linear.residual / linear.sigma)
    return None


def _spread_of_some(problem, values, trim):
    part = slice(None, None, problem.points.shape[1] // _ENOUGH + 1)
    linear = linearise(problem.subset(part), values)
    return spread((linear.residual / linear.sigma)[trim(values, linear.normal, part)], problem.size)


def _newton(problem, values, loss, scale, trim):
    """A Newton step (size,) of the robust cost, and its length in sigmas; inf where the cost is not convex.

    Block by block, so that everything stays in the processor's cache.
    """
    size = problem.size
    slopes = 0.0
    weights = 0.0
    normal = np.zeros((size, size))
    pull = np.zeros(size)
    for block in blocks(problem.points.shape[1]):
        linear = linearise(problem.subset(block), values)
        keep = trim(values, linear.normal, block) & np.isfinite(linear.residual)
        sigma = one_sigma(linear.sigma)
        white = linear.residual / sigma
        if not keep.all():
            white[~keep] = 0
        weight, slope = loss(white * (1 / max(scale, 1e-300)))
        if not keep.all():
            weight, slope = weight * keep, slope * keep
        slopes = slopes + slope.sum()
        weights = weights + weight.sum()
        rows = linear.rows[:size]
        slope /= sigma**2
        normal += (rows * slope) @ rows.T
        weight *= white
        weight /= sigma
        pull += rows @ weight
    if not slopes > 0.5 * weights:
        return pull, np.inf
    move = solve_positive(normal, pull)
    return move, float(np.sqrt(max(move @ normal @ move, 0.0))) / max(scale, 1e-300)


def one_sigma(sigma: np.ndarray) -> np.ndarray | float:
    """Sigma (n,) of the points, or one number where it is one that was broadcast."""
    return float(sigma[0]) if len(sigma) and sigma.strides == (0,) else sigma


def blocks(n: int) -> Iterator[slice]:
    """Slices of n points, each small enough for the processor's cache."""
    return (slice(first, first + BLOCK) for first in range(0, n, BLOCK))


def _rounds(problem, values, loss, trim):
    """Spread and trimming, then a descent, until neither changes by more than the descent would notice."""
    linear = linearise(problem, values)
    scale = np.nan
    keep = np.zeros(problem.points.shape[1], bool)
    before = keep
    for _ in range(_ROUNDS):
        inliers = trim(values, linear.normal)
        if inliers.sum() < problem.size:
            return Solved(values, np.nan, inliers, linear, linear.residual)
        now = spread((linear.residual / linear.sigma)[inliers], problem.size)
        if not np.isfinite(now):  # no line of error meets the ball
            return Solved(values, np.nan, inliers, linear, linear.residual)
        if abs(now - scale) <= 0.01 * scale and (inliers != before).sum() <= 1e-3 * len(keep):
            break
        scale = now
        before = inliers
        values, linear, keep = _descend(problem, values, linear, loss, scale, inliers)
        if not np.isfinite(values).all():
            return Solved(values, np.nan, keep, linear, linear.residual)
    return Solved(values, scale, keep, linear, linear.residual / linear.sigma)


def _descend(problem, values, linear, loss, scale, keep):
    """Gauss-Newton steps at one spread: the values reached, the problem there, and what of `keep` still counts.

    A point whose line of error comes to graze the ball is left out from there on: in and out, it
    would have the fit go to and fro.

    The matrix of reweighting, sum of psi / z, is brought to the size of the true one, of psi', by one
    factor: the steps are then neither short nor, where psi' is negative, astray.
    """
    floor = max(scale, 1e-12 * values[-1])
    for _ in range(_STEPS):
        weight, slope = loss(linear.residual / (linear.sigma * floor))
        weight = keep * weight
        factor = np.clip((keep * slope).sum() / max(weight.sum(), 1e-300), 0.5, 1)
        rows = linear.rows[: problem.size]
        weight /= linear.sigma**2
        weighted = rows * weight
        normal = weighted @ rows.T * factor
        move = solve_positive(normal, weighted @ np.where(weight > 0, linear.residual, 0))
        length = float(np.sqrt(move @ normal @ move)) / max(scale, 1e-300)
        values = values.copy()
        values[: problem.size] += move * min(1, 0.5 * values[-1] / max(np.abs(move).max(), 1e-300))
        linear = linearise(problem, values)
        keep = keep & np.isfinite(linear.residual)
        if length < _SETTLED or np.abs(move).max() < 1e-12 * values[-1] or not np.isfinite(length):
            break
    return values, linear, keep


@dataclass(frozen=True)
class Used:
    """The points that count: their numbers `place` (m,), whitened rows (size, m), scores psi, slopes psi' and residuals
    (m,), and the normal matrix."""

    place: np.ndarray
    rows: np.ndarray
    score: np.ndarray
    slope: np.ndarray
    white: np.ndarray
    normal: np.ndarray


def used_part(problem: Problem, solved: Solved, loss: Loss) -> tuple[np.ndarray, Used]:
    """Points that have a weight, (n,) bool, and the sums that make the covariances of an M-estimate."""
    weight, slope = loss(solved.white / solved.spread)
    used = solved.keep & (weight > 0)
    place = np.flatnonzero(used)
    sigma = one_sigma(solved.linear.sigma)
    rows = solved.linear.rows[: problem.size].take(place, 1)
    rows /= sigma.take(place) if np.ndim(sigma) else sigma
    white = solved.white.take(place)
    slope = slope.take(place)
    return used, Used(place, rows, weight.take(place) * white, slope, white, rows @ rows.T)


def step_left(part: Used, radius: float) -> float:
    """Length of a further Newton step in sigmas of what is fitted: the score statistic of an M-estimate (Rao,
    Proc. Cambridge Phil. Soc. 44, 1948). 0 where it is less than rounding of the radius."""
    pull = part.rows @ part.score
    move = solve_positive(part.normal, pull)
    power = part.score @ part.score / max(part.score.size - len(part.rows), 1)
    if np.abs(move).max() < 1e-9 * radius:
        return 0.0
    return float(np.sqrt(max(pull @ move, 0.0) / max(power, 1e-300)))


def covariance(part: Used, groups: np.ndarray | None = None) -> np.ndarray:
    """(size, size) covariance of what was fitted.

    Of an M-estimate, with the spread that the residuals show (Huber, Robust Statistics, 1981,
    eq. 7.6.6). With `groups` (m,) int the errors within a group may depend on one another: see `_grouped`.
    """
    if groups is not None:
        return _grouped(part.rows, part.score, part.slope, groups)
    size, count = part.rows.shape
    spread = part.score @ part.score / max(count - size, 1) / part.slope.mean() ** 2
    return inverse_positive(part.normal) * spread


def _grouped(rows, score, slope, groups):
    """(size, size) covariance from leaving out one group after the other.

    The jackknife form of the cluster-robust covariance (MacKinnon & White, J. Econometrics 29, 1985;
    Bell & McCaffrey, Survey Methodology 28, 2002), which few groups of much leverage do not make too small.
    """
    label = np.unique(groups, return_inverse=True)[1]
    size = len(rows)
    count = label.max() + 1
    sums = np.stack([np.bincount(label, row * score) for row in rows], axis=1)
    blocks = np.array(
        [[np.bincount(label, row * other * slope) for other in rows] for row in rows]
    ).transpose(2, 0, 1)
    others_normal = blocks.sum(0) - blocks
    if count <= size:
        return np.full((size, size), np.inf)
    moved = (inverse_positive(others_normal) @ sums[..., None])[..., 0]
    return moved.T @ moved * (count - 1) / count


def memory(white: np.ndarray) -> float:
    """Ratio of the variance of a mean to that of independent residuals, (n,) in their order.

    1 + 2 times the sum of the autocorrelations up to the first that is not positive
    (Geyer, Statistical Science 7, 1992).
    """
    n = len(white)
    if n < 4:
        return 1.0
    power = np.abs(np.fft.rfft(white - white.mean(), 2 * n)) ** 2
    correlation = np.fft.irfft(power)[:n]
    correlation = correlation / max(correlation[0], 1e-300)
    end = np.argmax(correlation <= 0) or n
    return float(max(1.0, 1 + 2 * correlation[1:end].sum()))


def bias(problem: Problem, linear: Linear, part: Used, radius: float, scale: float) -> np.ndarray:
    """(size,) bias of second order in the noise, mm: take it off the estimate.

    Noise across the normal lengthens the distance from the centre by (tr S - u'Su) / 2r, S the
    covariance of a point and u its normal: sigma^2 / R in the radius of a whole ball. Where S
    is not isotropic, the normal also turns with the same error, which moves the centre. Errors along
    known lines leave none (expansion as in Kanatani, Statistical Optimization, 1996, ch. 9).
    """
    bias_of_points = np.zeros(problem.size)
    if problem.direction is not None:
        return bias_of_points
    sigma = one_sigma(linear.sigma)
    sigma = sigma.take(part.place) if np.ndim(sigma) else sigma
    if problem.covariance is None:
        pull = (part.rows * sigma).sum(1) * (len(linear.normal) - 1) / 2
    else:
        u = linear.normal.take(part.place, 1)
        full_covariance = problem.covariance.take(part.place, 2)
        covariance_normal = np.einsum("den,en->dn", full_covariance, u)
        tangential = covariance_normal - u * sigma**2
        total = np.einsum("ddn->n", full_covariance)
        bent = (total - sigma**2) / 2 - 2 * (covariance_normal * tangential).sum(0) / sigma**2
        pull = part.rows @ (bent / sigma)
        pull[: len(u)] += tangential @ sigma**-2
    return solve_positive(part.normal, pull / radius) * scale**2
