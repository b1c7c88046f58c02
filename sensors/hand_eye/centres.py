"""Hand-eye from centres of balls that stand still, as a 3-D camera or a scanner on the flange measures them.

With T_base_flange = (R_i, p_i) and the centre c_i in the sensor frame, ball k stands at

    b_k = R_i (X c_i + t) + p_i

in the base. For a rotation X the rest is linear; the rotation is found from a grid over SO(3) and then by Gauss-Newton.
A stationary instrument that measures points on the flange is the same problem with T_flange_base: b_k is then the place
of point k on the flange, and X, t take points from the frame of the instrument to that of the base.
"""

from dataclasses import dataclass

import numpy as np

from sensors.hand_eye.poses import checked_flange
from sensors.hand_eye.result import HandEye, PoseRow, placement
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import symmetric_eigen
from workbench.core.parameters import Parameter, Parameters
from workbench.core.profiler_start import start_rotations
from workbench.core.rigid import (
    inverse,
    nearest_rotation,
    rotation_matrix,
    rotation_vector,
    skew,
)

_MIN_POSES = 4
_STARTS = 12
_FIRST_STEPS = 6
_RETAINED = 3
_STEPS = 50
_SETTLED = 1e-10
_UNDETERMINED = 1e-9  # eigenvalue of the scaled normal matrix, relative to the largest
_LEVER = 100.0  # mm: a rotation by 1 rad counts as much as a shift by this
_NAMES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class Centres:
    """n centres: `points` (3, n) mm in the sensor frame; `flange` (n, 4, 4) T_base_flange; `ball` (n,) its label from
    0; `sigma` mm of one coordinate, as each measurement by itself shows it, nan where unknown. `is_stationary`: the
    sensor stands still and the balls are on the flange."""

    points: np.ndarray
    flange: np.ndarray
    ball: np.ndarray
    sigma: float = float("nan")
    is_stationary: bool = False


def hand_eye_from_centres(
    centres: Centres, radius: float, residual_mm: np.ndarray | None = None
) -> HandEye:
    """Hand-eye and the balls' places, without a guess.

    radius: mm, of the first ball, handed on. residual_mm (n,): RMS distance of each cloud from its own ball, handed on
    as noise. Sigmas come from the residuals of the centres, so that they hold errors of the robot too. InputError for
    fewer than four poses.
    """
    flange = checked_flange(centres.flange, "ball centres")
    if centres.is_stationary:
        flange = inverse(flange)
    _check_pose_count(centres.points.shape[1])
    solution = _solve(centres.points, flange, centres.ball)
    return _result(centres, solution, radius, residual_mm)


def _check_pose_count(count: int) -> None:
    if count < _MIN_POSES:
        raise InputError(
            f"ball centres: expected at least {_MIN_POSES} poses, found {count}; take more, with "
            "rotations about two axes"
        )


@dataclass(frozen=True)
class _Solution:
    """`rotation` (3, 3), `shift` (3,) and `places` (K, 3) mm; residual (3, n) and rows (3 n, 6 + 3 K) there."""

    rotation: np.ndarray
    shift: np.ndarray
    places: np.ndarray
    residual: np.ndarray
    rows: np.ndarray
    converged: bool


def _solve(points, flange, ball) -> _Solution:
    rotations = start_rotations()
    costs = _start_costs(rotations, points, flange, ball)
    best = rotations[np.argsort(costs)[:_STARTS]]
    candidates = [_descend(rotation, points, flange, ball, _FIRST_STEPS) for rotation in best]
    candidates.sort(key=_squares)
    solutions = [
        _descend(solution.rotation, points, flange, ball, _STEPS)
        for solution in candidates[:_RETAINED]
    ]
    return min(solutions, key=_squares)


def _squares(solution: _Solution) -> float:
    return float((solution.residual**2).sum())


def _start_costs(rotations, points, flange, ball) -> np.ndarray:
    """(S,) sum of squares at each of S rotations, the shift and the places estimated."""
    basis = np.linalg.svd(_design(flange, ball), full_matrices=False)
    basis = basis.U[:, basis.S > 1e-10 * basis.S[0]]
    rotated = np.stack([rotation @ points for rotation in rotations])
    moved = np.einsum("nij,sjn->sni", flange[:, :3, :3], rotated) + flange[:, :3, 3]
    moved = moved.reshape(len(rotations), -1)
    return (moved**2).sum(1) - ((moved @ basis) ** 2).sum(1)


def _design(flange, ball) -> np.ndarray:
    """(3 n, 3 + 3 K) derivative of the residual by shift and places."""
    n = len(flange)
    count = int(ball.max()) + 1
    rows = np.zeros((n, 3, 3 + 3 * count))
    rows[:, :, :3] = flange[:, :3, :3]
    for axis in range(3):
        rows[np.arange(n), axis, 3 + 3 * ball + axis] = -1
    return rows.reshape(3 * n, -1)


def _linear(rotation, points, flange, ball):
    """Shift (3,), places (K, 3) and sum of squares for one rotation; least length where they are not determined."""
    moved = np.einsum("nij,jn->ni", flange[:, :3, :3] @ rotation, points) + flange[:, :3, 3]
    design = _design(flange, ball)
    found = np.linalg.lstsq(design, -moved.ravel(), rcond=1e-10)[0]
    residual = moved.ravel() + design @ found
    return found[:3], found[3:].reshape(-1, 3), float(residual @ residual)


def _descend(rotation, points, flange, ball, steps: int) -> _Solution:
    """Gauss-Newton from one rotation."""
    shift, places, _ = _linear(rotation, points, flange, ball)
    converged = False
    for _ in range(steps):
        residual, rows = _linearised(rotation, shift, places, points, flange, ball)
        step = np.linalg.lstsq(rows / _scale(rows), -residual.T.ravel(), rcond=1e-10)[0]
        step = step / _scale(rows)
        rotation = nearest_rotation(rotation_matrix(step[:3]) @ rotation)
        shift = shift + step[3:6]
        places = places + step[6:].reshape(-1, 3)
        converged = bool(np.abs(step).max() < _SETTLED * _LEVER)
        if converged:
            break
    residual, rows = _linearised(rotation, shift, places, points, flange, ball)
    return _Solution(rotation, shift, places, residual, rows, converged)


def _scale(rows) -> np.ndarray:
    return np.where(np.arange(rows.shape[1]) < 3, _LEVER, 1.0)


def _linearised(rotation, shift, places, points, flange, ball):
    """Residual (3, n) mm and its derivative (3 n, 6 + 3 K) by a small rotation, the shift and the places."""
    rotated = rotation @ points
    seen = np.einsum("nij,jn->in", flange[:, :3, :3], rotated + shift[:, None]) + flange[:, :3, 3].T
    residual = seen - places[ball].T
    by_rotation = -np.einsum("nij,njk->nik", flange[:, :3, :3], skew(rotated.T))
    rows = np.concatenate([by_rotation.reshape(-1, 3), _design(flange, ball)], axis=1)
    return residual, rows


def _result(centres, solution: _Solution, radius, residual_mm) -> HandEye:
    rows = solution.rows
    n = centres.points.shape[1]
    degrees = max(3 * n - rows.shape[1], 1)
    variance = float((solution.residual**2).sum()) / degrees
    covariance, undetermined = _covariance(rows, variance)
    held_out = _held_out(solution.residual, rows)
    keys = [f"sensor.{name}" for name in _NAMES] + [f"target.{name}" for name in "xyz"]
    values = np.concatenate(
        [solution.shift, rotation_vector(solution.rotation), solution.places[0]]
    )
    units = ("mm",) * 3 + ("rad",) * 3 + ("mm",) * 3
    sensor = np.r_[3:6, 0:3]  # x y z before the rotation
    std = np.sqrt(np.diag(covariance))
    order = np.r_[sensor, 6:9]
    table = Parameters.of(
        [
            Parameter(key, unit, float(value), 1.0, key)
            for key, unit, value in zip(keys, units, values)
        ]
    )
    residual_norm = np.sqrt((solution.residual**2).sum(0))
    noise = float("nan") if residual_mm is None else float(np.sqrt(np.mean(residual_mm**2)))
    robot = np.sqrt(max(variance - np.nan_to_num(centres.sigma) ** 2, 0.0))
    return HandEye(
        kind="to-hand" if centres.is_stationary else "clouds",
        sensor=_matrix(solution.rotation, solution.shift),
        covariance=covariance[np.ix_(sensor, sensor)],
        target=placement(solution.places[0]),
        target_covariance=covariance[6:9, 6:9],
        parameters=table,
        std=dict(zip(keys, std[order].tolist())) | {"target.radius": None},
        noise=noise,
        unit="mm",
        robot_sigma={"position_mm": float(robot)},
        fit={"rms_mm": _rms(residual_norm), "pose_rms_mm": _rms(residual_norm), "points": n},
        held_out={"rms_mm": _rms(held_out), "pose_rms_mm": _rms(held_out), "folds": n},
        poses=tuple(
            PoseRow(k, float(residual_norm[k]), float(held_out[k]), 0.0, 0.0, float("nan"), False)
            for k in range(n)
        ),
        undetermined=undetermined,
        suspicions=(),
        outcome="converged" if solution.converged else "not converged",
        converged=solution.converged,
        radius=radius,
    )


def _matrix(rotation, shift) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, shift
    return matrix


def _rms(lengths) -> float:
    return float(np.sqrt(np.mean(np.square(lengths))))


def _covariance(rows, variance) -> tuple[np.ndarray, tuple[str, ...]]:
    """Covariance of rotation (rad), shift and places (mm); inf with a sentence for what is not determined."""
    scale = _scale(rows)
    values, vectors = symmetric_eigen((rows / scale).T @ (rows / scale))
    is_undetermined = values < _UNDETERMINED * values.max()
    inverse = np.where(is_undetermined, 0.0, 1 / np.where(is_undetermined, 1.0, values))
    covariance = (vectors * inverse) @ vectors.T * variance / np.outer(scale, scale)
    hidden = (
        ((vectors[:, is_undetermined] ** 2).sum(1) > 1e-6)
        if is_undetermined.any()
        else np.zeros(len(scale), bool)
    )
    covariance[hidden, hidden] = np.inf
    if not hidden.any():
        return covariance, ()
    names = [("rotation", "shift")[k] for k in range(2) if hidden[3 * k : 3 * k + 3].any()]
    subject = " and ".join(names) if names else "place of the ball"
    return covariance, (
        f"{subject} of the sensor: not determined in {int(is_undetermined.sum())} directions, because the flange "
        "rotates too little or about one axis only; add poses with rotations about two axes",
    )


def _held_out(residual, rows) -> np.ndarray:
    """(n,) mm: distance of each centre from the prediction of all others, (1 - H)^-1 e (Cook & Weisberg, 1982)."""
    basis, sizes, _ = np.linalg.svd(rows / _scale(rows), full_matrices=False)
    basis = basis[:, sizes > 1e-8 * sizes.max()]
    held_out = np.empty(residual.shape[1])
    for k in range(len(held_out)):
        row_basis = basis[3 * k : 3 * k + 3]
        remainder = np.eye(3) - row_basis @ row_basis.T
        held_out[k] = np.linalg.norm(np.linalg.lstsq(remainder, residual[:, k], rcond=1e-6)[0])
    return held_out
