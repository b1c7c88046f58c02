"""Laser beams as Liu, Shi & Ding solve them: IEEE CYBER 2014, 365, eq. 4-7.

22 Denavit-Hartenberg parameters (all but theta1 and d1) of an arm whose beam is known to lie along the
flange's x axis. Kept for comparison with `robot_model.measurements.laser_spot`.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from robot_model.chain import forward
from robot_model.robot import Robot

_SLOTS = np.array(
    [5 * k + c for k in range(6) for c in range(4)][2:]
)  # theta, d, a, alpha; no beta
_NOTHING, _STEPS = 1e-18, 300  # mm^2
_SIZES = np.tile([0.01, 1.0, 1.0, 0.01], 6)[2:]  # rad and mm that count alike
A2 = 4  # place of a2 among the 22


@dataclass(frozen=True)
class BeamFit:
    """`geometry` (6, 5) found; `crossings` list of (P, 3) a position; `means` (M, 3), mm; `start`, `end` the sum of
    squares before and after; `singular` (F,) values of the objective's derivative there, largest first."""

    geometry: np.ndarray
    crossings: list[np.ndarray]
    means: np.ndarray
    start: float
    end: float
    singular: np.ndarray

    @property
    def rank(self) -> int:
        """Rank of the objective in the free parameters."""
        return int(
            (self.singular > 1e-6 * self.singular[0]).sum()
        )  # central differences are no better

    @property
    def spread(self) -> float:
        """RMS distance of the crossings from the mean of their position, mm."""
        off = np.concatenate([c - m for c, m in zip(self.crossings, self.means)])
        return float(np.sqrt((off**2).sum(1).mean()))


def calibrate_beams(
    robot: Robot,
    joints: np.ndarray,
    point: np.ndarray,
    with_crossings: bool,
    held: tuple[int, ...] = (),
) -> BeamFit:
    """Minimise eq. 6, or eq. 7 where `with_crossings`, from the nominal arm by Levenberg-Marquardt.

    joints (n, 6) rad; point (n,) labels of the detector's positions, five or more; held: which of the 22
    stay nominal, such as `A2`, without which noise shrinks the arm to nothing.
    """
    free = np.setdiff1d(np.arange(22), held)

    pairs = _Pairs.of(point)

    def residual(x):
        return _residual(_beams(robot, joints, _geometry(robot, free, x)), pairs, with_crossings)

    nominal = np.zeros(len(free))
    start = residual(nominal)
    x, end, rows = _marquardt(residual, nominal)
    singular = np.linalg.svd(rows, compute_uv=False)
    geometry = _geometry(robot, free, x)
    crossings = _crossings(*_beams(robot, joints, geometry), pairs)
    means = pairs.means(crossings)
    crossings = np.split(crossings, pairs.begin[1:])
    return BeamFit(geometry, crossings, means, float(start @ start), end, singular)


def _marquardt(residual, x):
    """x, the sum of squares and the derivative where neither falls any more (Levenberg 1944, Marquardt 1963)."""
    here = residual(x)
    damping = 1.0
    for _ in range(_STEPS):
        rows = _slopes(residual, x)
        move, damping, there = _step(residual, x, here, rows, damping)
        fallen = here @ here - there @ there
        x, here = x + move, there
        if fallen <= 1e-12 * (here @ here) + _NOTHING:
            break
    return x, float(here @ here), _slopes(residual, x)


def _step(residual, x, here, rows, damping):
    """A move that lowers the cost, or none; the damping, ten times less than the one that did it."""
    for _ in range(40):
        move = -np.linalg.solve(rows.T @ rows + damping * np.eye(len(x)), rows.T @ here)
        there = residual(x + move)
        if there @ there < here @ here:
            return move, damping / 10, there
        damping *= 10
    return 0 * x, damping, here


def _slopes(residual, x, h=1e-4):
    """(R, F) derivative by central differences."""
    return np.stack(
        [(residual(x + h * e) - residual(x - h * e)) / (2 * h) for e in np.eye(len(x))], 1
    )


def _geometry(robot, free, x):
    flat = robot.geometry.ravel().copy()
    flat[_SLOTS[free]] += x * _SIZES[free]
    return flat.reshape(6, 5)


def _beams(robot, joints, geometry):
    """Origins and directions (n, 3) of the beams, the flange's x axis (eq. 4)."""
    frames = forward(robot, joints.T, geometry)
    return frames.end_origin.T, frames.end[0].T


@dataclass(frozen=True)
class _Pairs:
    """Pairs of beams of one position, position after position: beams `first`, `second` (P,); `begin` (M,) of each."""

    first: np.ndarray
    second: np.ndarray
    begin: np.ndarray

    @classmethod
    def of(cls, point: np.ndarray) -> "_Pairs":
        """All pairs of beams with the same label of `point` (n,)."""
        beams = [np.flatnonzero(point == k) for k in np.unique(point)]
        pairs = [mine[np.stack(np.triu_indices(len(mine), 1))] for mine in beams]
        counts = [pair.shape[1] for pair in pairs]
        return cls(*np.concatenate(pairs, 1), np.cumsum([0, *counts[:-1]]))

    @property
    def counts(self) -> np.ndarray:
        """(M,) pairs of each position."""
        return np.diff(self.begin, append=len(self.first))

    def means(self, values: np.ndarray) -> np.ndarray:
        """(M, 3) mean of values (P, 3) over the pairs of each position."""
        return np.add.reduceat(values, self.begin) / self.counts[:, None]


def _crossings(origins, directions, pairs: _Pairs) -> np.ndarray:
    """The middles (P, 3) of the common perpendiculars of all pairs of beams."""
    i = pairs.first
    j = pairs.second
    u = directions[i]
    v = directions[j]
    between = origins[j] - origins[i]
    c = (u * v).sum(1)
    a = (u * between).sum(1)
    b = (v * between).sum(1)
    s = (a - c * b) / (1 - c**2)
    t = (c * a - b) / (1 - c**2)
    return (origins[i] + s[:, None] * u + origins[j] + t[:, None] * v) / 2


def sphere_centres(means: np.ndarray) -> np.ndarray:
    """(K, 3) centres of the spheres through any four of the means (M, 3), eq. 5."""
    four = means[np.array(list(combinations(range(len(means)), 4)))]
    edges = 2 * (four[:, 1:] - four[:, :1])
    squares = (four**2).sum(2)
    return np.linalg.solve(edges, (squares[:, 1:] - squares[:, :1])[..., None])[..., 0]


def _residual(beams, pairs: _Pairs, with_crossings):
    """Coordinate errors of the centres (eq. 6), and of the crossings relative to their means (eq. 7)."""
    crossings = _crossings(*beams, pairs)
    means = pairs.means(crossings)
    centres = sphere_centres(means)
    errors = (centres - centres.mean(0)).ravel()
    if not with_crossings:
        return errors
    return np.concatenate([errors, (crossings - np.repeat(means, pairs.counts, 0)).ravel()])
