"""Sub-pixel places of corners and discs: the grey values of many small patches fitted at once.

Each patch is one least-squares fit of a blurred edge model to the pixels around a mark, so its
residual tells the noise and its normal matrix the σ of the place: what the image allows, and
nothing about how well the board was printed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

STEPS = 40
SETTLED = 2e-4
"""px: a fit ends when no patch moves farther than this in a step."""
_AT_REST, _NOTHING = 1e-9, 1e-12
"""px, and share of the cost: a step that changes less is lost in rounding."""
REACH = 10.0
"""px: corners use pixels up to this far; beyond it edges are no longer straight behind a real lens."""
CLEAR = 4.0
"""A mark counts where its contrast is this many times what the fit leaves of it."""
FINEST = 1e-3
"""px: no pixel is a point and no edge a Gaussian to better than this, however little noise there is."""
CHUNK = 4_000_000
"""Numbers in one Jacobian: patches are fitted in groups so that memory stays small."""

Model = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


SADDLE_LOG_BLUR, DISC_LOG_BLUR = 4, 5
"""Columns of `Fit.values` with the logarithm of the blur, px."""


@dataclass(frozen=True)
class Fit:
    """n fitted marks: `centre` (2, n) px, `sigma` (n,) px of one coordinate, `values` (n, P), `good` (n,) bool."""

    centre: np.ndarray
    sigma: np.ndarray
    values: np.ndarray
    good: np.ndarray


def fit_saddles(
    image: np.ndarray,
    centres: np.ndarray,
    row_step: np.ndarray,
    down: np.ndarray,
    clear: float = 1.0,
    steps: int = STEPS,
) -> Fit:
    """Corners where four squares meet, from starts (2, n) px within a fifth of a square, in at most so many steps.

    row_step, down: (2, n) px, from a corner to its next one in the row and in the column. clear: share of a
    square next to each edge that shows nothing else, such as the rim around a marker. `values` are
    x, y, the two edges' angles (rad), log blur (px), grey level, half the contrast (negative where the
    square between `row_step` and `down` is dark), and the slope of the light (a px, across and down).
    """
    reach = np.clip(0.45 * np.minimum(np.hypot(*row_step), np.hypot(*down)), 2.5, REACH)
    spots, grey, weight = _patches(image, centres, reach)
    weight = weight * (np.hypot(*spots - centres[:, :, None]) <= reach[:, None])
    weight = (
        weight * _near_edges(spots - centres[:, :, None], row_step, down, clear)
        if clear < 0.5
        else weight
    )
    middle, spread = _level(grey, weight)
    start = np.stack(
        [
            *centres,
            np.arctan2(row_step[1], row_step[0]),
            np.arctan2(down[1], down[0]),
            np.zeros_like(reach),
            middle,
            spread,
            0 * reach,
            0 * reach,
        ],
        1,
    )
    start[:, 6] *= np.sign(_side(start, spots, grey, weight))
    fit = _fit(_saddle, start, spots, grey, weight, steps)
    return _checked(fit, centres, reach, fit.values[:, 6])


def _near_edges(
    distance_from_edge: np.ndarray, row_step: np.ndarray, down: np.ndarray, margin: float
) -> np.ndarray:
    """(n, m) bool: pixels less than a pixel's blur short of `clear` squares from one of the two edges."""
    area = np.abs(row_step[0] * down[1] - row_step[1] * down[0])
    is_near_edge = np.zeros(distance_from_edge.shape[1:], bool)
    for edge in (row_step, down):
        distance = (
            np.abs(
                edge[0][:, None] * distance_from_edge[1] - edge[1][:, None] * distance_from_edge[0]
            )
            / np.hypot(*edge)[:, None]
        )
        rim = margin * area / np.hypot(*edge)
        is_near_edge |= distance <= np.maximum(rim - 1, 1.5)[:, None]
    return is_near_edge


def fit_discs(
    image: np.ndarray, centres: np.ndarray, spread: np.ndarray, margin: np.ndarray
) -> Fit:
    """Ellipses of even grey from starts (2, n) px.

    spread: (2, 2, n) px^2, second moments of each filled ellipse (a quarter of its squared half axes);
    margin: (n,) px outside of the edge that belong to this disc alone. `values` are x, y, B11, B12,
    B22 with |B (pixel - centre)| = 1 on the edge, log blur (px), grey level, half the contrast
    (positive where the disc is dark), and the slope of the light.
    """
    axes, eigenvectors = np.linalg.eigh(np.moveaxis(spread, 2, 0))
    half = 2 * np.sqrt(axes)
    bend = np.einsum("nij,nj,nkj->nik", eigenvectors, 1 / half, eigenvectors)
    width = np.clip(np.minimum(margin, 0.6 * half[:, 0]), 1.5, REACH)
    spots, grey, weight = _patches(image, centres, half[:, 1] + width, half[:, 0] - width)
    u = spots - centres[:, :, None]
    scaled = np.sqrt(np.square(np.einsum("nij,jnm->inm", bend, u)).sum(0))
    weight = weight * (np.abs(scaled - 1) * np.sqrt(half.prod(1))[:, None] <= width[:, None])
    middle, contrast = _level(grey, weight)
    inner = (grey * weight * (scaled < 1)).sum(1) / np.maximum((weight * (scaled < 1)).sum(1), 1)
    start = np.stack(
        [
            *centres,
            bend[:, 0, 0],
            bend[:, 0, 1],
            bend[:, 1, 1],
            0 * width,
            middle,
            np.where(inner < middle, contrast, -contrast),
            0 * width,
            0 * width,
        ],
        1,
    )
    fit = _fit(_disc, start, spots, grey, weight)
    return _checked(fit, centres, half[:, 0], fit.values[:, 7])


def disc_area(fit: Fit) -> np.ndarray:
    """(n,) px^2 of the ellipses that `fit_discs` found."""
    b = fit.values[:, 2:5]
    return np.pi / np.abs(b[:, 0] * b[:, 2] - b[:, 1] ** 2)


def _checked(fit: Fit, start: np.ndarray, reach: np.ndarray, contrast: np.ndarray) -> Fit:
    """`good` only where the place stayed near its start and the mark stands out of what is left."""
    rms = fit.values[:, -1]
    is_near_start = np.hypot(*(fit.centre - start)) < 0.5 * reach
    has_contrast = np.abs(contrast) > CLEAR * rms
    good = is_near_start & has_contrast & _is_determined(fit.sigma)
    return Fit(fit.centre, fit.sigma, fit.values[:, :-1], good)


def _is_determined(sigma: np.ndarray) -> np.ndarray:
    """Whether standard deviations in px are finite and below half a pixel."""
    return np.isfinite(sigma) & (sigma < 0.5)


def _patches(image, centres, reach, inner_radius=None):
    """Pixels (2, n, m) around each centre, their grey values (n, m), and 1 where they are used (n, m)."""
    half = int(np.ceil(reach.max())) + 1
    side = np.arange(-half, half + 1)
    offsets = np.stack([a.ravel() for a in np.meshgrid(side, side)])
    middle = np.rint(centres).astype(int)
    from_centre = offsets[:, None] + (middle - centres)[:, :, None]
    distance = np.hypot(*from_centre)
    used = distance <= reach[:, None] + 1
    if inner_radius is not None:
        used &= distance >= inner_radius[:, None] - 1
    # used pixels first, as many columns as the largest patch needs
    order = np.argsort(~used, axis=1, kind="stable")[:, : used.sum(1).max()]
    spots = middle[:, :, None] + offsets[:, order]
    u, v = spots
    height, width = image.shape
    is_in_image = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    weight = np.take_along_axis(used, order, 1) & is_in_image
    grey = image[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]
    return spots.astype(float), grey.astype(float), weight.astype(float)


def _level(grey, weight):
    """(n,) middle grey and half the contrast of each patch."""
    masked = np.where(weight > 0, grey, np.nan)
    with np.errstate(all="ignore"):
        low, high = np.nanpercentile(masked, (10, 90), axis=1)
    return np.nan_to_num((low + high) / 2), np.nan_to_num((high - low) / 2) + 1e-6


def _side(start, spots, grey, weight):
    """(n,) positive where the quarter between the two edges is bright."""
    value = np.copy(start)
    value[:, 5], value[:, 6] = 0, 1
    pattern, _ = _saddle(value, spots)
    return (pattern * weight * (grey - start[:, 5:6])).sum(1)


def _saddle(p: np.ndarray, spots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Grey (n, m) and derivative (P, n, m): a + b erf(d1 / s sqrt 2) erf(d2 / s sqrt 2) + slope.

    d1, d2: distances from the two edges, positive between them; a corner blurred by a Gaussian of width s.
    """
    cx, cy, first, second, blur, level, half, horizontal_slope, vertical_slope = p.T[:, :, None]
    ux = spots[0] - cx
    uy = spots[1] - cy
    size = _size(blur)
    (e1, slope1, d1) = _edge(first, ux, uy, size, 1)
    (e2, slope2, d2) = _edge(second, ux, uy, size, -1)
    by1 = half * e2 * slope1
    by2 = half * e1 * slope2
    jacobian = np.stack(
        [
            by1 * np.sin(first) - by2 * np.sin(second) - horizontal_slope,
            by2 * np.cos(second) - by1 * np.cos(first) - vertical_slope,
            -by1 * (np.cos(first) * ux + np.sin(first) * uy),
            by2 * (np.cos(second) * ux + np.sin(second) * uy),
            -by1 * d1 - by2 * d2,
            np.ones_like(ux),
            e1 * e2,
            ux,
            uy,
        ]
    )
    return level + half * e1 * e2 + horizontal_slope * ux + vertical_slope * uy, jacobian


def _size(blur):
    """px, kept where squares of distances over it stay finite."""
    return np.exp(np.clip(blur, -6, 6))


def _edge(angle, ux, uy, size, sign):
    from scipy.special import erf

    distance = sign * (np.cos(angle) * uy - np.sin(angle) * ux)
    height = erf(distance / (np.sqrt(2) * size))
    slope = np.sqrt(2 / np.pi) / size * np.exp(-0.5 * (distance / size) ** 2)
    return height, slope, distance


def _disc(p: np.ndarray, spots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Grey (n, m) and derivative (P, n, m): a + b erf(d / s sqrt 2) + slope, d the distance outside of the ellipse.

    d = (|B u| - 1) / |grad|: Sampson's first-order distance, exact on the edge, where alone it matters.
    """
    from scipy.special import erf

    cx, cy, b11, b12, b22, blur, level, half, horizontal_slope, vertical_slope = p.T[:, :, None]
    ux = spots[0] - cx
    uy = spots[1] - cy
    size = _size(blur)
    vx = b11 * ux + b12 * uy
    vy = b12 * ux + b22 * uy
    m = np.sqrt(vx * vx + vy * vy) + 1e-9
    gx = (b11 * vx + b12 * vy) / m
    gy = (b12 * vx + b22 * vy) / m
    steep = np.sqrt(gx * gx + gy * gy) + 1e-12
    d = (m - 1) / steep
    edge = erf(d / (np.sqrt(2) * size))
    by = half * np.sqrt(2 / np.pi) / size * np.exp(-0.5 * (d / size) ** 2)
    by_m = by / steep
    jacobian = np.stack(
        [
            -by_m * gx - horizontal_slope,
            -by_m * gy - vertical_slope,
            by_m * vx * ux / m,
            by_m * (vx * uy + vy * ux) / m,
            by_m * vy * uy / m,
            -by * d,
            np.ones_like(ux),
            edge,
            ux,
            uy,
        ]
    )
    return level + half * edge + horizontal_slope * ux + vertical_slope * uy, jacobian


def _fit(model: Model, start, spots, grey, weight, steps: int = STEPS) -> Fit:
    """All patches, in groups of a size that memory bears; the last of `values` is the noise of a patch."""
    values_an_evaluation = spots.shape[2] * start.shape[1]
    at_once = max(1, CHUNK // values_an_evaluation)
    values = []
    sigma = []
    for first in range(0, len(start), at_once):
        group = slice(first, first + at_once)
        seen = spots[:, group], grey[group], weight[group]
        found = _levenberg(model, start[group], seen, steps)
        values.append(found[0])
        sigma.append(found[1])
    values, sigma = np.concatenate(values), np.concatenate(sigma)
    place = values[:, :2].T
    return Fit(place, sigma, values, np.isfinite(sigma))


@dataclass(frozen=True)
class _MovingPatches:
    """Patches that still move: their `index` among all, values, cost, normal equations and damping of each."""

    index: np.ndarray
    values: np.ndarray
    cost: np.ndarray
    normal: np.ndarray
    slope: np.ndarray
    damping: np.ndarray

    def step(self) -> np.ndarray:
        """(n, P) step of the damped normal equations."""
        damped = self.normal + self.damping[:, None, None] * _diagonal(self.normal)
        return _solved(damped, self.slope)

    def after(self, values, cost, normal, slope) -> "_MovingPatches":
        """Each patch at its new values where these do not raise its cost, otherwise with more damping."""
        better = cost <= self.cost
        return _MovingPatches(
            self.index,
            np.where(better[:, None], values, self.values),
            np.where(better, cost, self.cost),
            np.where(better[:, None, None], normal, self.normal),
            np.where(better[:, None], slope, self.slope),
            np.where(better, self.damping / 8, self.damping * 6),
        )

    def subset(self, chosen: np.ndarray) -> "_MovingPatches":
        """The chosen ones of these patches."""
        return _MovingPatches(
            self.index[chosen],
            self.values[chosen],
            self.cost[chosen],
            self.normal[chosen],
            self.slope[chosen],
            self.damping[chosen],
        )


def _levenberg(model, p, seen, steps):
    """Damped Gauss-Newton, one damping a patch: values (n, P + 1) and σ of the place (n,).

    A patch rests once its steps are lost in rounding; all end when none moves farther than `SETTLED`.
    """
    spots, grey, weight = seen
    values = np.copy(p)
    cost, normal, slope = _normal(model, p, spots, grey, weight)
    patches = _MovingPatches(np.arange(len(p)), p, cost, normal, slope, np.full(len(p), 1e-3))
    for _ in range(steps):
        step = patches.step()
        moved = patches.values + step
        moved_cost, moved_normal, moved_slope = _normal(model, moved, *seen)
        falls = moved_cost < (1 - _NOTHING) * patches.cost
        patches = patches.after(moved, moved_cost, moved_normal, moved_slope)
        values[patches.index] = patches.values
        cost[patches.index] = patches.cost
        normal[patches.index] = patches.normal
        length = np.abs(step[:, :2]).max(1)
        if (length < SETTLED).all():
            break
        active = np.flatnonzero((length > _AT_REST) | falls)
        patches = patches.subset(active)
        seen = seen[0][:, active], seen[1][active], seen[2][active]
    return _with_sigma(model, values, spots, grey, weight, normal, cost)


def _solved(matrices, right):
    """(n, P) solutions; 0 where a patch shows nothing of one of its numbers, and its matrix is singular."""
    try:
        return np.linalg.solve(matrices, right[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        return _solved_where_regular(matrices, right)


def _solved_where_regular(matrices, right):
    is_singular = np.abs(np.linalg.slogdet(matrices)[0]) == 0
    if not is_singular.any():
        return np.zeros_like(right)
    regular = np.where(is_singular[:, None, None], np.eye(right.shape[1]), matrices)
    return np.where(is_singular[:, None], 0, _solved(regular, right))


def _normal(model, p, spots, grey, weight):
    with np.errstate(all="ignore"):
        value, jacobian = model(p, spots)
        weighted_residual = weight * (grey - value)
        jacobian = np.moveaxis(jacobian * weight, 0, 2)
        transposed = jacobian.swapaxes(1, 2)
        cost = (weighted_residual**2).sum(1)
        normal = transposed @ jacobian
        slope = (transposed @ weighted_residual[:, :, None])[:, :, 0]
    is_finite = np.isfinite(cost) & np.isfinite(normal).all((1, 2))
    return (
        np.where(is_finite, cost, np.inf),
        np.where(is_finite[:, None, None], normal, np.eye(p.shape[1])),
        np.where(is_finite[:, None], slope, 0),
    )


def _diagonal(normal):
    size = normal.shape[1]
    scale = np.einsum("nii->ni", normal)
    return np.eye(size) * (scale + 1e-9 * scale.max(1, keepdims=True) + 1e-12)[:, :, None]


def _with_sigma(model, p, spots, grey, weight, normal, cost):
    """Noise of each patch from its residual, and what it makes of the place.

    Neighbouring pixels of a compressed or interpolated image err together: with a correlation r from
    one pixel to the next, sums over a patch vary ((1 + r) / (1 - r))^2 times as much.
    """
    freedom = np.maximum(weight.sum(1) - p.shape[1], 1)
    noise = np.sqrt(cost / freedom)
    residual = weight * (grey - model(p, spots)[0])
    # pixels that follow one another in one row of the image, both of them used
    row = spots[1]
    in_one_row = row[:, 1:] == row[:, :-1]
    neighbours = weight[:, 1:] * weight[:, :-1] * in_one_row
    products = (residual[:, 1:] * residual[:, :-1] * neighbours).sum(1)
    covariance = products / np.maximum(neighbours.sum(1), 1)
    r = np.clip(covariance / np.maximum(noise**2, 1e-30), 0, 0.8)
    # RMS over both coordinates of the standard deviation for noise 1, then for the noise found
    inverse = np.linalg.inv(normal + 1e-9 * _diagonal(normal))
    variance = np.abs(inverse[:, 0, 0] + inverse[:, 1, 1]) / 2
    sigma = noise * (1 + r) / (1 - r) * np.sqrt(variance)
    whole_sigma = np.where(np.isfinite(cost), np.hypot(sigma, FINEST), np.inf)
    return np.column_stack([p, noise]), whole_sigma
