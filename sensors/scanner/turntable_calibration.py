"""Axis and angle law of a turntable, from images of a board that stands on it.

First every angle is estimated by itself, with the axis and the board, from the corners; then the law of the angles
is chosen by F-tests. What no law explains is the random error of a position ("step irregularity").
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from sensors.boards.detection import View
from sensors.camera.model import Camera
from sensors.scanner.turntable import ORDERS, STEP_ERROR, Turntable
from workbench.core.distributions import fisher
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, rotation_matrix, rotation_vector, transform

FEWEST = 4
_FEWEST_FREE = 4  # degrees of freedom below which a law is not tested
_SIGNIFICANT = 0.001  # of an F-test; several are made
_LARGEST_RMS_PX = 2.0
_SPAN = np.deg2rad(300)  # of the angles, above which the table makes about a full turn


@dataclass(frozen=True)
class Term:
    """A tested part of the angle law: `name`, order (0: scale), (cosine, sine) rad or (scale, 0), p of its F-test,
    and whether it is `retained`."""

    name: str
    order: int
    values: tuple[float, float]
    probability: float
    retained: bool


@dataclass(frozen=True)
class TurntableCalibration:
    """`table`; `commanded`, `measured` and `sigma` (G,) rad of each position; `terms` that were tested; `rms_px` of
    one corner coordinate; `images` (G,) their names; `residual` (G,) rad that the law leaves; `sigma_std` of
    `table.sigma`; `before` and `after`: leave-one-out RMS (rad) of the commanded angles and of the law."""

    table: Turntable
    commanded: np.ndarray
    measured: np.ndarray
    sigma: np.ndarray
    terms: tuple[Term, ...]
    rms_px: float
    images: tuple[str, ...]
    residual: np.ndarray
    sigma_std: float
    before: float
    after: float

    @property
    def has_step_error(self) -> bool:
        """Whether the angle law has a term, or the random error of a position exceeds what its noise explains."""
        return any(term.retained for term in self.terms) or self._is_random

    @property
    def _is_random(self) -> bool:
        return self.table.sigma > 2 * self.sigma_std

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences on what was found."""
        sentences = [
            f"turntable: axis from {len(self.commanded)} positions, corners {self.rms_px:.3f} px RMS; leave-one-out "
            f"error of a position {np.rad2deg(self.before):.4f} deg as commanded, {np.rad2deg(self.after):.4f} deg "
            "with the angle law"
        ]
        for term in self.terms:
            if term.retained:
                sentences.append(f"{STEP_ERROR}: {term.name} (F-test p = {term.probability:.2g})")
        noise = float(np.sqrt(np.mean(self.sigma**2)))
        if self._is_random:
            sentences.append(
                f"{STEP_ERROR}: random error of a position {np.rad2deg(self.table.sigma):.4f} deg, 1 sigma; "
                f"the corners alone explain {np.rad2deg(noise):.4f} deg"
            )
        return tuple(sentences)


def calibrate_turntable(
    views: Sequence[View],
    board_points: np.ndarray,
    camera: Camera,
    poses: np.ndarray,
    commanded: np.ndarray,
    camera_covariance: np.ndarray | None = None,
) -> TurntableCalibration:
    """The turntable from views (G) of a board that stands on it.

    board_points (3, N) mm; poses (G, 4, 4) T_camera_board to start from; commanded (G,) rad; camera_covariance
    (V, V) of the camera's values, which makes part of the axis' uncertainty. Raises InputError for
    too few positions, or a board that does not turn with the table.
    """
    if len(views) < FEWEST or np.ptp(commanded) < np.deg2rad(10):
        raise InputError(
            f"images.csv, column table_deg: expected a board on the turntable at {FEWEST} angles or more over 10 deg "
            f"or more, found {len(views)} images over {np.rad2deg(np.ptp(commanded)):.3g} deg; take more images"
        )
    order = np.argsort(commanded, kind="stable")
    views = [views[k] for k in order]
    poses = poses[order]
    commanded = commanded[order]
    problem = _Corners(tuple(views), board_points, camera, commanded)
    start = _start(poses, commanded)
    found = least_squares(problem.residual, start, x_scale=problem.scale, method="trf")
    count = found.fun.size - found.x.size
    rms = float(np.sqrt(2 * found.cost / max(count, 1)))
    if rms > _LARGEST_RMS_PX:
        raise InputError(
            f"images.csv, column table_deg: expected a board that turns with the table, found corners {rms:.1f} px off "
            "any rotation about one axis; leave table_deg empty for images of a board that does not stand on the table"
        )
    inner = np.linalg.inv(found.jac.T @ found.jac)
    covariance = rms**2 * inner
    if camera_covariance is not None:
        gain = inner @ found.jac.T @ problem.by_camera(found.x)
        covariance = covariance + gain @ camera_covariance @ gain.T
    return _result(problem, found.x, covariance, rms)


@dataclass(frozen=True)
class _Corners:
    """Parameters: two tilts and two shifts of the axis, T_camera_board at the first position (6), and the angles (rad)
    of all other positions relative to it. The axis is stated about `_start`'s, which the parameters carry."""

    views: tuple[View, ...]
    board: np.ndarray
    camera: Camera
    commanded: np.ndarray

    @property
    def scale(self) -> np.ndarray:
        sizes = [1e-2] * 3 + [1.0] * 3 + [1.0] * 3 + [1e-2] * 3
        return np.array(sizes + [1e-2] * (len(self.views) - 1))

    def residual(self, values: np.ndarray) -> np.ndarray:
        """(2 n + 2,) px; the last two hold the length of the axis and the place of the point along it."""
        axis = values[:3]
        point = values[3:6]
        unit = axis / np.linalg.norm(axis)
        rotation = rotation_matrix(values[9:12])
        place = values[6:9]
        angles = np.concatenate([[0.0], values[12:]])
        residuals = []
        for view, angle in zip(self.views, angles):
            standing = rotation @ self.board[:, view.index] + place[:, None]
            rotated = rotation_matrix(angle * unit) @ (standing - point[:, None]) + point[:, None]
            residuals.append((self.camera.project(rotated) - view.pixels).ravel())
        gauge = [1e3 * (np.linalg.norm(axis) - 1), (point - place) @ unit]
        return np.concatenate([*residuals, gauge])

    def by_camera(self, values: np.ndarray) -> np.ndarray:
        """(2 n + 2, V) derivative of the residual by the camera's values."""
        steps = 1e-6 * np.maximum(np.abs(self.camera.values), 1.0)
        columns = []
        for k, step in enumerate(steps):
            moved = self.camera.values + step * (np.arange(len(steps)) == k)
            other = replace(self, camera=Camera.of(moved, self.camera.size))
            columns.append((other.residual(values) - self.residual(values)) / step)
        return np.stack(columns, axis=1)


def _start(poses: np.ndarray, commanded: np.ndarray) -> np.ndarray:
    """Axis and point from rotations between neighbouring positions, in closed form."""
    change = poses[1:] @ inverse(poses[:-1])
    step = np.diff(commanded)
    rotation_vectors = rotation_vector(change[:, :3, :3])
    axis = (rotation_vectors * step[:, None]).sum(0)
    axis = axis / np.linalg.norm(axis)
    rows = (np.eye(3) - change[:, :3, :3]).reshape(-1, 3)
    rows = np.concatenate([rows, axis[None]])
    right = np.concatenate([change[:, :3, 3].ravel(), [axis @ poses[0, :3, 3]]])
    point = np.linalg.lstsq(rows, right, rcond=None)[0]
    first = np.concatenate([poses[0, :3, 3], rotation_vector(poses[0, :3, :3])])
    return np.concatenate([axis, point, first, np.cumsum(rotation_vectors @ axis)])


def _result(problem: _Corners, values, covariance, rms) -> TurntableCalibration:
    axis = values[:3] / np.linalg.norm(values[:3])
    point = values[3:6]
    angles = np.concatenate([[0.0], values[12:]])
    variance = np.concatenate([[0.0], np.diag(covariance)[12:]])
    angle_change = angles - (problem.commanded - problem.commanded[0])
    sigma = np.sqrt(variance + np.median(variance[1:]) * (np.arange(len(angles)) == 0))
    terms, chosen = _law(problem.commanded, angle_change)
    design = _design(problem.commanded, chosen)
    solution = np.linalg.lstsq(design, angle_change, rcond=None)[0]
    residual = angle_change - design @ solution
    free = len(angle_change) - design.shape[1]
    spread = float(residual @ residual) / free
    jitter = float(np.sqrt(max(spread - np.mean(sigma**2), 0.0)))
    harmonics = {n: tuple(_pair(solution, chosen, n)) for n in chosen if n}
    gain = 1.0 + (solution[1] if 0 in chosen else 0.0)
    bare = Turntable(axis, point, float(gain), harmonics, jitter)
    of_law = np.linalg.inv(design.T @ design) * spread
    bare = Turntable(
        axis, point, float(gain), harmonics, jitter, _covariance(bare, covariance, of_law, chosen)
    )
    return TurntableCalibration(
        bare,
        problem.commanded,
        problem.commanded + angle_change - solution[0],
        sigma,
        terms,
        rms,
        tuple(view.image for view in problem.views),
        residual,
        float(np.sqrt(spread / (2 * free))),
        _left_out(_design(problem.commanded, ()), angle_change),
        _left_out(design, angle_change),
    )


def _pair(solution, chosen, order) -> np.ndarray:
    first = 1 + (0 in chosen) + 2 * [n for n in chosen if n].index(order)
    return solution[first : first + 2]


def _covariance(table: Turntable, covariance, of_law, chosen) -> np.ndarray:
    """(P, P) of tilts, shifts, gain and harmonics."""
    count = 5 + 2 * len(table.harmonics)
    joined = np.zeros((count, count))
    perpendicular = table.perpendicular
    tilt = np.stack([np.cross(direction, table.axis) for direction in perpendicular])
    by_axis = np.zeros((4, 6))
    by_axis[:2, :3], by_axis[2:, 3:] = tilt, perpendicular
    joined[:4, :4] = by_axis @ covariance[:6, :6] @ by_axis.T
    law = of_law[1:, 1:]
    rows = [4] * (0 in chosen) + list(range(5, count))
    joined[np.ix_(rows, rows)] = law
    return joined


def _design(commanded, orders) -> np.ndarray:
    """(G, 1 + ...) constant, scale (order 0), cosine and sine of each other order."""
    columns = [np.ones_like(commanded)]
    if 0 in orders:
        columns.append(commanded)
    for order in (n for n in orders if n):
        columns += [np.cos(order * commanded), np.sin(order * commanded)]
    return np.stack(columns, axis=1)


def _law(commanded, angle_change) -> tuple[tuple[Term, ...], tuple[int, ...]]:
    """Forward selection of the scale and of the harmonics by F-tests."""
    chosen: tuple[int, ...] = ()
    tested: dict[int, Term] = {}
    candidates = (0, *(ORDERS if np.ptp(commanded) > _SPAN else ORDERS[:1]))
    while True:
        trials = [
            _test(commanded, angle_change, chosen, order)
            for order in candidates
            if order not in chosen
        ]
        trials = [term for term in trials if term is not None]
        tested |= {term.order: term for term in trials}
        best = min(trials, key=lambda term: term.probability, default=None)
        if best is None or not best.retained:
            return tuple(tested.values()), tuple(sorted(chosen))
        chosen = (*chosen, best.order)


def _test(commanded, angle_change, chosen, order) -> Term | None:
    """F-test of one more term; None where too few positions are left to test it."""
    before = _design(commanded, chosen)
    after = _design(commanded, (*chosen, order))
    free = len(angle_change) - after.shape[1]
    if free < _FEWEST_FREE or np.linalg.cond(after / np.linalg.norm(after, axis=0)) > 1e4:
        return None
    first = _squares(before, angle_change)
    second = _squares(after, angle_change)
    added_terms = after.shape[1] - before.shape[1]
    statistic = (first - second) / added_terms / max(second / free, 1e-300)
    probability = float(fisher.sf(statistic, added_terms, free))
    solution = np.linalg.lstsq(after, angle_change, rcond=None)[0][before.shape[1] :]
    if order == 0:
        name = f"scale {solution[0]:+.3g}"
        values = (float(solution[0]), 0.0)
    else:
        size = np.rad2deg(np.hypot(*solution))
        name = f"{size:.4f} deg, {order} cycle{'s' * (order > 1)} per revolution"
        values = (float(solution[0]), float(solution[1]))
    retained = probability < _SIGNIFICANT
    return Term(name, order, values, probability, retained)


def _squares(design, values) -> float:
    remainder = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return float(remainder @ remainder)


def _left_out(design, values) -> float:
    """RMS error of each value predicted from the others (PRESS: Allen, Technometrics 16, 1974)."""
    basis = np.linalg.qr(design)[0]
    remainder = values - basis @ (basis.T @ values)
    leverage = np.clip((basis**2).sum(1), 0.0, 1.0 - 1e-9)
    return float(np.sqrt(np.mean((remainder / (1 - leverage)) ** 2)))


def pose_matrices(poses: np.ndarray) -> np.ndarray:
    """(G, 4, 4) of poses (G, 6), mm and rotation vectors."""
    return transform(rotation_matrix(poses[:, 3:]), poses[:, :3])
