"""Scatter of a board that never moved: by how much its pose seems to change from picture to picture.

The pose of the board in the base (on the flange for "to-hand") is chained from one picture at a
time: flange pose, hand-eye, and the board's pose in the camera from that picture alone. Stated are
three root mean squares over pictures: of the 3-D distance of the board's origin, and of its
middle, from their mean (mm), and of the angle to the mean rotation (deg). Held out, the hand-eye
comes from the other poses, and so does the mean.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from sensors.hand_eye.result import placement
from sensors.hand_eye.start import board_poses
from workbench.core.rigid import inverse


def placed_boards(flange: np.ndarray, sensor: np.ndarray, seen: np.ndarray, kind: str) -> np.ndarray:
    """(P, 4, 4) the board as every picture has it, T_base_board, or T_flange_board for "to-hand".

    flange (P, 4, 4) T_base_flange, sensor (4, 4) hand-eye, seen (P, 4, 4) T_camera_board.
    """
    return (flange if kind == "in-hand" else inverse(flange)) @ sensor @ seen


def deviations(placed: np.ndarray, points: np.ndarray, others: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """(P,) `origin_mm`, `centre_mm`, `turn_deg` of boards (P, 4, 4) from the mean of `others` (theirs by default)."""
    others = placed if others is None else others
    found = {}
    for name, point in (("origin_mm", np.zeros(3)), ("centre_mm", points.mean(1))):
        mean = (others[:, :3, :3] @ point + others[:, :3, 3]).mean(0)
        found[name] = np.linalg.norm(placed[:, :3, :3] @ point + placed[:, :3, 3] - mean, axis=1)
    mean = Rotation.from_matrix(others[:, :3, :3]).mean()
    angle = (mean.inv() * Rotation.from_matrix(placed[:, :3, :3])).magnitude()
    return {**found, "turn_deg": np.degrees(angle)}


def board_scatter(away: dict[str, np.ndarray]) -> dict[str, float]:
    """RMS of every one of `deviations`, and its plain mean as `mean_...`."""
    square = {name: float(np.sqrt((values**2).mean())) for name, values in away.items()}
    return {**square, **{f"mean_{name}": float(values.mean()) for name, values in away.items()}}


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


def _placed(chain, values):
    seen = board_poses(chain.board_at(values), chain.pixels, chain.pose, chain.camera_at(values))
    return placed_boards(chain.flange, placement(values[:6]), seen, chain.kind)
