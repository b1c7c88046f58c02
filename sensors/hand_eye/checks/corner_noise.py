"""Uncertainty of the board pose of each image from the noise of its corners alone, with no robot involved."""

from dataclasses import dataclass

import numpy as np

from sensors.camera.checks import motion_rows
from workbench.core.least_squares.linear_algebra import pseudo_inverse


@dataclass(frozen=True)
class CornerNoise:
    """`sigma_px`: 1 sigma of a coordinate of a corner, with `degrees` of freedom. RMS scatter that it makes of the
    board's pose: of its four corners (`corners_mm`), its middle (`middle_mm`), its orientation (`rotation_deg`)."""

    sigma_px: float
    degrees: int
    corners_mm: float
    middle_mm: float
    rotation_deg: float


def corner_noise(chain, seen: np.ndarray, corners: np.ndarray) -> CornerNoise:
    """Noise from the images alone.

    chain: with `board` (3, n), `pixels` (2, n), `pose` (n,) and `camera`. seen (P, 4, 4) T_camera_board, each from its
    image alone: the residual there holds no error of the robot. corners (3, 4) mm on the board.
    """
    points = (
        np.einsum("nij,jn->in", seen[chain.pose, :3, :3], chain.board) + seen[chain.pose, :3, 3].T
    )
    projected, by_point, _ = chain.camera.project_rows(points)
    residual = projected - chain.pixels
    degrees = max(residual.size - 6 * len(seen), 1)
    sigma = max(float(np.sqrt((residual**2).sum() / degrees)), 1e-6)
    rows = motion_rows(by_point, points)
    covariances = [_pose_covariance(rows[:, :, chain.pose == k]) for k in range(len(seen))]
    middle = corners.mean(1, keepdims=True)
    rotation_variance = np.mean([np.trace(covariance[3:, 3:]) for covariance in covariances])
    spread = [
        np.mean(
            [
                _position_variance(covariance, pose, where)
                for covariance, pose in zip(covariances, seen)
            ]
        )
        for where in (corners, middle)
    ]
    return CornerNoise(
        sigma,
        degrees,
        sigma * float(np.sqrt(spread[0])),
        sigma * float(np.sqrt(spread[1])),
        sigma * float(np.degrees(np.sqrt(rotation_variance))),
    )


def _pose_covariance(rows):
    """(6, 6) per px^2 of a shift (mm) and a rotation (rad) of the board about the camera's origin."""
    flat = rows.reshape(6, -1)
    return pseudo_inverse(flat @ flat.T)


def _position_variance(covariance, pose, points):
    """mm^2 per px^2, mean over points (3, k) on the board of the variance of their position."""
    placed = pose[:3, :3] @ points + pose[:3, 3:]
    by_rotation = np.cross(np.eye(3)[:, None], placed.T[None], axis=-1)
    shifts = np.broadcast_to(np.eye(3)[:, None], by_rotation.shape)
    by_motion = np.concatenate([shifts, by_rotation])  # (6, k, 3)
    return float(np.einsum("kcj,kl,lcj->", by_motion, covariance, by_motion)) / points.shape[1]


def board_corners(points: np.ndarray) -> np.ndarray:
    """(3, 4) mm, the corners of the rectangle around board points (3, N)."""
    low = points.min(1)
    high = points.max(1)
    return np.array(
        [[x, y, points[2].mean()] for x in (low[0], high[0]) for y in (low[1], high[1])]
    ).T
