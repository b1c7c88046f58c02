"""Touched points as Gubankov & Yukhimets solve them: Sensors 2022, 22, 3376, eq. 7-17.

22 of 24 Denavit-Hartenberg parameters and the tip, from the distances between all pairs of touches of one
point. Kept for comparison: the arm may shrink under it, see `workbench.fitting.gauge` for what does not.
"""

from dataclasses import dataclass

import numpy as np

from robot_model.chain import Frames, forward, geometry_rows
from robot_model.measurements.closure import flange_matrices
from robot_model.robot import Robot

# theta, d, a, alpha of each joint but theta1 and d1, which the paper prints as they were
_SLOTS = np.array([5 * k + c for k in range(6) for c in range(4)][2:])
# The paper says that mu, eta and delta exist, not what they are. With these it takes five iterations where the paper
# took nine without driving errors and four with them. A smaller LEAST_FALL lets the arm shrink further, see the tests.
DAMPING, ADAPTATION, LEAST_FALL = 1e3, 0.1, 0.1


@dataclass(frozen=True)
class PairFit:
    """`geometry` (6, 5) theta, d, a, alpha, beta; `tip` (3,) on the flange, mm; `objective` (k,) J of eq. 7 before
    and after each iteration, mm^2, over the pairs kept; `kept` (L,) bool which pairs."""

    geometry: np.ndarray
    tip: np.ndarray
    objective: np.ndarray
    kept: np.ndarray

    @property
    def iterations(self) -> int:
        return len(self.objective) - 1


def pairs_of(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices j < s of all pairs of touches of one point; point (n,) labels (eq. 9)."""
    first, second = np.triu_indices(len(point), 1)
    same = point[first] == point[second]
    return first[same], second[same]


def start_tip(frames: Frames, point: np.ndarray) -> np.ndarray:
    """(3,) the tip by least squares in each series, then averaged (eq. 12-16), mm."""
    rotations = flange_matrices(frames)
    origins = frames.end_origin.T
    found = []
    for k in np.unique(point):
        rows = rotations[point == k]
        system = np.concatenate([rows, np.broadcast_to(-np.eye(3), rows.shape)], axis=2).reshape(
            -1, 6
        )
        found.append(np.linalg.lstsq(system, -origins[point == k].ravel(), rcond=None)[0][:3])
    return np.mean(found, axis=0)


def calibrate_pairs(
    robot: Robot,
    joints: np.ndarray,
    point: np.ndarray,
    radius: float | None = None,
    steps: int = 100,
    least_fall: float = LEAST_FALL,
    damping: float = DAMPING,
) -> PairFit:
    """Minimise J of eq. 7 from the nominal arm by eq. 17.

    joints (n, 6) rad; point (n,) labels; radius: pairs farther apart than this (mm) do not count.
    The paper rejects "after the initial reduction" of J: all pairs are solved for first, then those
    within the radius. steps, least_fall: the end, by number or by how little J fell (delta of the paper).
    """
    variables = joints.T
    start = np.concatenate(
        [robot.geometry.ravel()[_SLOTS], start_tip(forward(robot, variables), point)]
    )
    first, second = pairs_of(point)
    all_pairs = np.ones(len(first), bool)
    values, history = _marquardt(
        robot, variables, (first, second), start, steps, least_fall, damping
    )
    if radius is not None:
        gaps = _gaps(robot, variables, (first, second), values)[0]
        all_pairs = np.linalg.norm(gaps, axis=0) <= radius
        near = first[all_pairs], second[all_pairs]
        values, history = _marquardt(robot, variables, near, values, steps, least_fall, damping)
    return PairFit(_geometry(robot, values), values[22:], np.array(history), all_pairs)


def _geometry(robot, values):
    flat = robot.geometry.ravel().copy()
    flat[_SLOTS] = values[:22]
    return flat.reshape(6, 5)


def _gaps(robot, variables, pairs, values):
    """(3, L) differences r of eq. 9 and (25, 3, L) their derivative G."""
    frames = forward(robot, variables, _geometry(robot, values))
    tips = frames.point(values[22:])
    rows = np.concatenate([geometry_rows(robot, frames, tips, _SLOTS), np.stack(frames.end)])
    first, second = pairs
    return tips[:, first] - tips[:, second], rows[..., first] - rows[..., second]


def _marquardt(robot, variables, pairs, values, steps, least_fall, damping):
    """Eq. 17: the damping shrinks where J falls and grows where it does not."""
    gaps, rows = _gaps(robot, variables, pairs, values)
    history = [float((gaps**2).sum())]
    for _ in range(steps):
        flat = rows.reshape(25, -1)
        move = -np.linalg.solve(flat @ flat.T + damping * np.eye(25), flat @ gaps.ravel())
        there = _gaps(robot, variables, pairs, values + move)
        fallen = history[-1] - float((there[0] ** 2).sum())
        if not fallen > 0:
            damping /= ADAPTATION
            if damping > 1e12:
                break
            continue
        values, damping, (gaps, rows) = values + move, damping * ADAPTATION, there
        history.append(history[-1] - fallen)
        if fallen < least_fall:
            break
    return values, history
