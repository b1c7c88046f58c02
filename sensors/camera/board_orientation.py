"""Orientation of a square board in each image, where only its bow distinguishes rotations by 90 deg."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sensors.boards.detection import relabelled
from sensors.camera.corners import Corners
from sensors.camera.start import corner_chain, placement_groups
from sensors.effects.artefact import BoardBow
from workbench.core.effect import Effect
from workbench.core.least_squares.bundle import BundleFit
from workbench.core.least_squares.linear_algebra import solve_positive, symmetric_eigen
from workbench.core.model import Model
from workbench.core.rigid import rotation_matrix, rotation_vector

if TYPE_CHECKING:
    from sensors.boards.board import Board
    from sensors.boards.detection import View

_BOW = tuple(f"artefact.{BoardBow.effect}.{name}" for name in ("xx", "yy", "xy"))
_SIGNIFICANT = (
    9.0  # chi-square between the two ways round that half of the board poses must exceed: 3 sigmas
)
_ROUNDS = 20


def distinguishes_rotations(board: "Board", effects: Sequence[Effect]) -> bool:
    """Whether the bow distinguishes rotations of this board: a rotation by 180 deg leaves a quadratic bow as it is."""
    return board.rotational_symmetry == 4 and any(
        isinstance(effect, BoardBow) for effect in effects
    )


def needs_quarter_rotation(chain: Corners, fit: BundleFit, effects: Sequence[Effect]) -> np.ndarray:
    """(G,) True for board poses whose corners fit a common bow better after a rotation of the board by 90 deg.

    A rotation of the board by 90 deg changes the sign of the two numbers of its bow that are not round. Of
    each board pose they are found by themselves, camera held; their common size and each one's sign are
    then chosen in turn until nothing changes. All False where the bow is too small to decide.
    """
    bows, known = _own_bows(chain, fit, effects)
    sign = np.sign(bows @ symmetric_eigen(np.einsum("gi,gj->ij", bows, bows))[1][:, -1])
    for _ in range(_ROUNDS):
        common = solve_positive(known.sum(0), np.einsum("g,gij,gj->i", sign, known, bows))
        projection = np.einsum("gi,gij,j->g", bows, known, common)
        if (np.sign(projection) == sign).all():
            break
        sign = np.where(projection < 0, -1.0, 1.0)
    is_significant = np.median(np.abs(4 * projection)) > _SIGNIFICANT * fit.sigma_scale**2
    fewer = sign != (1.0 if (sign > 0).sum() * 2 >= len(sign) else -1.0)
    return fewer & is_significant


def _own_bows(chain, fit, effects):
    """((xx - yy) / 2, xy) mm of each board pose (G, 2), and their information (G, 2, 2), pose free."""
    evaluation = Model(chain, tuple(effects)).evaluate(fit.parameters)
    x, y = chain.place
    shapes = np.stack([x * x - y * y, x * y])
    bow = shapes[:, None] * evaluation.rows("target", np.array([2]))
    pose = evaluation.family_rows("placement")
    rows = np.concatenate([pose, bow, evaluation.residual[None]])
    rows = rows * (np.sqrt(fit.weights[0]) / chain.sigma)
    # normal matrix of six of the pose, two of the bow and the residual, one for each board pose
    start = np.flatnonzero(np.diff(chain.labels["placement"], prepend=-1))
    gram = np.add.reduceat(np.einsum("amn,bmn->nab", rows, rows), start, axis=0)
    poses = gram[:, :6, :6]
    mixed = gram[:, :6, 6:]
    reduced = gram[:, 6:, 6:] - gram[:, 6:, :6] @ solve_positive(poses, mixed)
    information = reduced[:, :2, :2]
    gradient = reduced[:, :2, 2:]
    change = solve_positive(information, gradient)[..., 0]
    xx, yy, xy = (fit.parameters[key] for key in _BOW)
    return np.array([(xx - yy) / 2, xy]) - change, information


def rotate_views(
    chain: Corners, views: Sequence["View"], board: "Board", is_rotated: np.ndarray, model: str
):
    """Chain and views with the board in the poses `is_rotated` (G,) laid on itself by a rotation by 90 deg."""
    group = placement_groups(views)[0]
    views = [relabelled(view, board, 1) if is_rotated[k] else view for view, k in zip(views, group)]
    quarter_inverse = _quarter(board).T
    middle = board.middle
    matrix = rotation_matrix(chain.poses[:, 3:])
    translation = chain.poses[:, :3] + (matrix @ (middle - quarter_inverse @ middle))
    poses = np.where(
        is_rotated[:, None],
        np.c_[translation, rotation_vector(matrix @ quarter_inverse)],
        chain.poses,
    )
    fresh = corner_chain(views, board, chain.camera.size, model)
    return replace(fresh.moved(chain.camera, poses), sigma=fresh.sigma), views


def _quarter(board):
    """(3, 3) that takes each corner, from the board's middle, to where its new number lies."""
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    rotated = np.rot90(np.arange(board.count).reshape(board.rows, board.columns)).ravel()
    displacement = board.points - board.middle[:, None]
    renumbered = displacement[:, np.argsort(rotated)]
    return (
        quarter
        if np.abs(quarter @ displacement - renumbered).max()
        < np.abs(quarter.T @ displacement - renumbered).max()
        else quarter.T
    )
