"""Whether points lie on a ball at all: what a plane would leave, and what low orders of the direction explain."""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from sensors.ball.solve import BLOCK, blocks, one_sigma
from workbench.core.least_squares.linear_algebra import symmetric_eigen

UNLIKELY = 1e-3
"""Probability below which a form is not put down to chance."""
_ENOUGH = 5000  # points
_RANK = 1e-8
_MAX_SINE = 1e-3  # sine of the angle between a plane and lines in it


@dataclass(frozen=True)
class Form:
    """Low-order form of the distances: `rms` mm above the noise, and the probability that a ball
    with noise alone shows as much; nan and 1 where the points are too few to tell."""

    rms: float
    probability: float


def plane_gain(
    points: np.ndarray, ball: float, sigma: np.ndarray, used: np.ndarray, direction=None
) -> float:
    """By how much a plane fits points (3, n) better than the ball, whose chi-square over them is
    `ball`, as a difference of chi-square; the noise is that of the better of both. Of points that are `used` (n,).

    direction (3, n): lines along which the points err. A plane that holds these lines, as the light plane of a single
    stripe does, holds the points of any surface: the next best one counts then.
    """
    first = points[:, used.argmax()][:, None]
    d = len(points)
    moments = np.zeros((d + 1, d + 1))
    sigma = one_sigma(sigma)
    plane_rows = np.ones((d + 1, min(BLOCK, points.shape[1])))
    for block in blocks(points.shape[1]):
        block_sigma = sigma[block] if np.ndim(sigma) else sigma
        weight = used[block] / block_sigma**2
        part = plane_rows[:, : len(weight)]
        np.subtract(points[:, block], first, out=part[:-1])
        moments += (part * weight) @ part.T
    mean = moments[:-1, -1]
    total = moments[-1, -1]
    scatter = moments[:-1, :-1] - np.outer(mean, mean) / total
    values, normals = symmetric_eigen(scatter)
    place = 0
    if direction is not None and np.abs(normals[:, 0] @ direction[:, used]).max() < _MAX_SINE:
        place = 1
    plane = float(values[place])
    noise = max(min(plane, ball) / max(int(used.sum()) - d, 1), 1e-300)
    return (ball - plane) / noise


def some_of(place: np.ndarray) -> np.ndarray:
    """Every so-manieth of the numbers (m,) of points, enough to test their form."""
    return place[:: -(-len(place) // _ENOUGH)]


def low_orders(
    normal: np.ndarray, white: np.ndarray, sigma: np.ndarray, rows: np.ndarray, memory: float
) -> Form:
    """Form of orders two and three of the direction `normal` (3, n) in whitened residuals (n,).

    rows (4, n): derivatives by centre and radius, which are left free. memory: times that the errors of neighbours
    make a mean vary more. The F test of a linear model; `some_of` the points are enough for it.
    """
    rows = rows / sigma
    basis = np.linalg.qr(rows.T)[0]
    shape = _shapes(normal) / sigma
    shape = shape - (shape @ basis) @ basis.T
    white = white - basis @ (basis.T @ white)
    values, vectors = symmetric_eigen(shape @ shape.T)
    is_retained = values > _RANK * max(values[-1], 1e-300)
    count = int(is_retained.sum())
    degrees = len(white) - len(rows) - int(is_retained.sum())
    if degrees < 2 * (count + len(rows)):
        return Form(float("nan"), 1.0)
    modes = (vectors[:, is_retained] / np.sqrt(values[is_retained])).T @ shape
    share = modes @ white
    explained = float(share @ share)
    noise = max(float(white @ white) - explained, 1e-300) / degrees
    fitted = share @ modes / rows[-1]  # back to mm across the surface
    real = max(1 - memory * count * noise / max(explained, 1e-300), 0.0)
    probability = float(fdtrc(count, degrees, explained / count / noise / memory))
    return Form(float(np.sqrt(real * (fitted**2).mean())), probability)


def _shapes(normal: np.ndarray) -> np.ndarray:
    """(k, n) products of two and of three components of the direction, without those that follow from the others."""
    two = [a * b for i, a in enumerate(normal) for b in normal[i:]][:-1]
    last = normal[-1]
    three = [product * last for product in two] + [normal[0] ** 3, normal[0] ** 2 * normal[1]][
        : 2 * len(normal) - 4
    ]
    return np.stack(two + three)
