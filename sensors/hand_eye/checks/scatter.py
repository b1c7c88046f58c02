"""Scatter of a board that never moved: by how much its pose seems to change from image to image.

The pose of the board in the base (on the flange for "to-hand") is chained from one image at a
time: flange pose, hand-eye, and the board's pose in the camera from that image alone. Stated are
three root mean squares over images: of the 3-D distance of the board's origin, and of its
middle, from their mean (mm), and of the angle to the mean rotation (deg). Held out, the hand-eye
comes from the other poses, and so does the mean.

The most likely hand-eye is not the one of least scatter: it weighs rotations and places by what each of
them errs by. `least_scatter` is that of the hand-eye which makes the squares of both least, with a
radian counted as `LEVER` mm; it says what other programmes' figures are to be compared with.
"""

import numpy as np

from sensors.hand_eye.result import placement
from sensors.hand_eye.start import board_poses
from workbench.core.rigid import (
    inverse,
    left_jacobian,
    nearest_rotation,
    rotation_vector,
    skew,
)

LEVER = 300.0
"""mm of the board's origin that count as much as one radian of its rotation."""


def placed_boards(
    flange: np.ndarray, sensor: np.ndarray, seen: np.ndarray, kind: str
) -> np.ndarray:
    """(P, 4, 4) the board as every image has it, T_base_board, or T_flange_board for "to-hand".

    flange (P, 4, 4) T_base_flange, sensor (4, 4) hand-eye, seen (P, 4, 4) T_camera_board.
    """
    return (flange if kind == "in-hand" else inverse(flange)) @ sensor @ seen


def deviations(
    placed: np.ndarray, points: np.ndarray, others: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """(P,) `origin_mm`, `centre_mm`, `turn_deg` of boards (P, 4, 4) from the mean of `others` (theirs by default)."""
    from scipy.spatial.transform import Rotation

    others = placed if others is None else others
    found = {}
    for name, point in (("origin_mm", np.zeros(3)), ("centre_mm", points.mean(1))):
        mean = (others[:, :3, :3] @ point + others[:, :3, 3]).mean(0)
        found[name] = np.linalg.norm(placed[:, :3, :3] @ point + placed[:, :3, 3] - mean, axis=1)
    mean = Rotation.from_matrix(others[:, :3, :3]).mean()
    angle = (mean.inv() * Rotation.from_matrix(placed[:, :3, :3])).magnitude()
    return {**found, "turn_deg": np.degrees(angle)}


def board_scatter(deviations_of_board: dict[str, np.ndarray]) -> dict[str, float]:
    """RMS of every one of `deviations`, and its plain mean as `mean_...`."""
    square = {
        name: float(np.sqrt((values**2).mean())) for name, values in deviations_of_board.items()
    }
    return {
        **square,
        **{f"mean_{name}": float(values.mean()) for name, values in deviations_of_board.items()},
    }


def scatter(chain, points, values, used) -> dict[str, float]:
    """`board_scatter` of the used poses at shared values, of a board with corners (3, N)."""
    return board_scatter(deviations(_placed(chain, values)[used], points * (1 + values[12])))


def held_scatter(chain, points, left_out, used) -> dict[str, float]:
    """The same with every used pose predicted from the others alone."""
    rows = []
    for k in np.flatnonzero(used):
        placed = _placed(chain, left_out[k].values)
        shown = points * (1 + left_out[k].values[12])
        rows.append(deviations(placed[[k]], shown, placed[used & (np.arange(len(used)) != k)]))
    return board_scatter({name: np.concatenate([row[name] for row in rows]) for name in rows[0]})


def least_scatter(chain, points, values, used) -> dict[str, float]:
    """`least_origin_mm` and `least_turn_deg`, RMS of the used poses with the hand-eye that makes both least together.

    Each board's pose from its image alone, camera as found; started at the hand-eye of `values`.
    """
    seen = _seen(chain, values)[used]
    flange = chain.flange[used]
    deviations_of_board = deviations(
        placed_boards(
            flange, _least_scatter_pose(flange, seen, chain.kind, values[:6]), seen, chain.kind
        ),
        points,
    )
    return _named(deviations_of_board)


def held_least(chain, points, values, used) -> dict[str, float]:
    """The same with every used pose's hand-eye and mean from the others alone."""
    seen = _seen(chain, values)[used]
    flange = chain.flange[used]
    rows = []
    for k in range(len(flange)):
        others = np.arange(len(flange)) != k
        placed = placed_boards(
            flange,
            _least_scatter_pose(flange[others], seen[others], chain.kind, values[:6]),
            seen,
            chain.kind,
        )
        rows.append(deviations(placed[[k]], points, placed[others]))
    return _named({name: np.concatenate([row[name] for row in rows]) for name in rows[0]})


def _named(deviations_of_board):
    found = board_scatter(deviations_of_board)
    return {"least_origin_mm": found["origin_mm"], "least_turn_deg": found["turn_deg"]}


def _least_scatter_pose(flange, seen, kind, start):
    """(4, 4) hand-eye of least scatter."""
    from scipy.optimize import least_squares

    flange = flange if kind == "in-hand" else inverse(flange)
    scale = np.array([1, 1, 1, 1 / LEVER, 1 / LEVER, 1 / LEVER])
    found = least_squares(
        scattered, start, scattered_derivative, x_scale=scale, method="lm", args=(flange, seen)
    )
    return placement(found.x)


def scattered(values: np.ndarray, flange: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(6 P,) mm: of every board its origin from the mean, and its rotation from the mean rotation times `LEVER`.

    values (6,) x y z (mm) and rotation vector (rad) of the hand-eye, flange (P, 4, 4) T_base_flange, or T_flange_base
    for "to-hand", seen (P, 4, 4) T_camera_board.
    """
    placed = flange @ placement(values) @ seen
    _, rotations_from_mean = _from_mean(placed[:, :3, :3])
    by_rotation = LEVER * rotation_vector(rotations_from_mean)
    by_origin = _centred(placed[:, :3, 3])
    return np.hstack([by_origin, by_rotation]).ravel()


def scattered_derivative(values: np.ndarray, flange: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(6 P, 6) derivative of `scattered` with respect to the values."""
    sensor = placement(values)
    rotation = flange[:, :3, :3]
    arm = (sensor[:3, :3] @ seen[:, :3, 3, None])[..., 0]
    moved = [_centred(rotation), -_centred(rotation @ skew(arm))]
    mean, deviations_of_board = _from_mean((flange @ sensor @ seen)[:, :3, :3])
    rotated = (
        mean.T @ rotation
    )  # a small rotation of the hand-eye, about the axes of the mean board
    with_mean = _free_trace(deviations_of_board.sum(0))
    of_mean = np.linalg.pinv(with_mean) @ (_free_trace(deviations_of_board) @ rotated).sum(0)
    rotated = LEVER * np.linalg.solve(
        left_jacobian(rotation_vector(deviations_of_board)), rotated - of_mean
    )
    rows = np.concatenate([np.dstack(moved), np.dstack([0 * rotated, rotated])], 1)
    rows[..., 3:] = rows[..., 3:] @ left_jacobian(values[3:6])
    return rows.reshape(-1, 6)


def _from_mean(rotations):
    """(3, 3) mean rotation in the Frobenius norm, and rotations (P, 3, 3) seen from it."""
    mean = nearest_rotation(rotations.sum(0))
    return mean, mean.T @ rotations


def _free_trace(matrix):
    """(..., 3, 3) tr(M) I - M, for which [v]x M + M' [v]x = [(tr(M) I - M) v]x."""
    return np.trace(matrix, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - matrix


def _centred(values):
    return values - values.mean(0)


def _placed(chain, values):
    return placed_boards(chain.flange, placement(values[:6]), _seen(chain, values), chain.kind)


def _seen(chain, values):
    """(P, 4, 4) T_camera_board, each from its image alone."""
    return board_poses(chain.board_at(values), chain.pixels, chain.pose, chain.camera_at(values))
