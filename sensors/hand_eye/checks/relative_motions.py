"""Do flange poses and board poses belong together? A test before any hand-eye transform is known.

Between two poses the flange moves by A and the camera, which sees the stationary board, by B, with A X = X B for
the unknown hand-eye transform X. A and B are the same screw motion in two frames, therefore their rotation angles are
equal, whatever X is (Chen, CVPR 1991). The angles test orientations and the assignment of images to poses; the
positions test the unit of the flange positions and the size of the board (`length_scale`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensors.hand_eye.checks.length_scale import UNKNOWN, length_scale
from workbench.core.rigid import inverse, rotation_vector

# rad: below it the axis of a rotation is uncertain; two poses that agree to this, and to this in mm, are one
_LEAST_TURN = np.deg2rad(5.0)
_SAME_RAD = np.deg2rad(0.002)
_SAME_MM = 0.002
# Displacement of a board in the image up to which it stands still before a camera that stands still: px, and a share
# of the board's extent in the image, which no arm's repeatability reaches (0.4 mm of a board of 40 mm).
_STILL_PX, _STILL_SHARE = 2.0, 0.01
_FEWEST_PAIRS = 10
# a share of a length: more than an arm or a board of any quality makes
_SCALE = 0.01


@dataclass(frozen=True)
class RelativeMotions:
    """Relative motions of flange and camera, over all pairs of poses.

    `angle_gap_deg`: median difference of the rotation angles. `scale`: lengths that the images show over those of the
    flange, with its standard deviation `scale_std`, and the interval from `scale_low` to `scale_high` (`LengthScale`);
    nan, inf, 0 and inf where the poses do not determine it.
    """

    angle_gap_deg: float
    scale: float
    scale_std: float
    scale_low: float
    scale_high: float

    def as_json(self) -> dict:
        """`hand_eye` of the answer of `check`."""
        return dict(vars(self))


def relative_motions(flange: np.ndarray, seen: np.ndarray, kind: str) -> RelativeMotions:
    """Compare flange poses (P, 4, 4) T_base_flange with board poses `seen` (P, 4, 4) T_camera_board.

    kind: "in-hand" or "to-hand". The origin of the board should be its middle, whose position is known best.
    """
    moved = flange if kind == "in-hand" else inverse(flange)
    first, second = np.triu_indices(len(flange), 1)
    arm = _angles(inverse(moved[second]) @ moved[first])
    camera = _angles(seen[second] @ inverse(seen[first]))
    gap = float(np.degrees(np.median(np.abs(arm - camera))))
    used = (arm > _LEAST_TURN) & (arm < np.pi - _LEAST_TURN) & (camera > _LEAST_TURN)
    found = UNKNOWN if used.sum() < _FEWEST_PAIRS else length_scale(moved, seen)
    return RelativeMotions(gap, found.value, found.std, found.low, found.high)


def scale_gap(motions: RelativeMotions) -> tuple[str, str] | None:
    """State what is wrong and what to do where images and flange show different lengths, as parts of a sentence."""
    if motions.scale_low <= 1 + _SCALE and motions.scale_high >= 1 - _SCALE:
        return None
    symptom = (
        f"lengths that the images show are {motions.scale:.4g} times those of the flange (standard deviation "
        f"{motions.scale_std:.1g}, from positions of flange and board): the size of the board or the unit of the "
        "flange positions is stated wrongly"
    )
    return symptom, "measure the board over many squares, and check the unit of the positions"


def _angles(motions: np.ndarray) -> np.ndarray:
    """(k,) rotation angle, rad, of motions (k, 4, 4)."""
    return np.linalg.norm(rotation_vector(motions[:, :3, :3]), axis=1)


def equal_poses(flange: np.ndarray) -> list[tuple[int, int]]:
    """Pairs (first, later) of flange poses (P, 4, 4) that are equal; each later pose stands in one pair."""
    pairs = []
    for later in range(1, len(flange)):
        gap = np.linalg.norm(flange[:later, :3, 3] - flange[later, :3, 3], axis=1)
        relative = np.swapaxes(flange[:later, :3, :3], 1, 2) @ flange[later, :3, :3]
        angle = np.linalg.norm(rotation_vector(relative), axis=1)
        same = np.flatnonzero((gap < _SAME_MM) & (angle < _SAME_RAD))
        if same.size:
            pairs.append((int(same[0]), later))
    return pairs


def displacement_px(first, second) -> float:
    """px, median displacement of the corners that two views of a board share; nan where they share none.

    A board that looks the same after a rotation may be labelled in the other order: with equal sets of corners, each
    corner is then compared with the nearest one.
    """
    shared, rows_of_first, its = np.intersect1d(first.index, second.index, return_indices=True)
    if not shared.size:
        return float("nan")
    before = first.pixels[:, rows_of_first]
    after = second.pixels[:, its]
    distance_px = float(np.median(np.linalg.norm(before - after, axis=0)))
    if len(shared) < len(first.index):
        return distance_px
    distances = np.linalg.norm(before[:, :, None] - after[:, None, :], axis=0)
    nearest = distances.argmin(1)
    if len(np.unique(nearest)) < len(nearest):
        return distance_px
    return min(distance_px, float(np.median(distances.min(1))))


def wrong_equal_poses(flange: np.ndarray, views: Sequence) -> list[tuple[int, int, float]]:
    """(first, later, px) of equal flange poses (P, 4, 4) between whose `views` (P) the board moves in the image."""
    found = [(a, b, displacement_px(views[a], views[b])) for a, b in equal_poses(flange)]
    return [(a, b, px) for a, b, px in found if px > _still_px(views[a])]


def _still_px(view) -> float:
    """px up to which the board of a view stands still."""
    extent = float(np.linalg.norm(np.ptp(view.pixels, axis=1)))
    return max(_STILL_PX, _STILL_SHARE * extent)


def equal_poses_sentence(wrong: Sequence[tuple[int, int, float]], names: Sequence[str]) -> str:
    """State the meaning of `wrong_equal_poses`, as a part of a sentence; names (P,) of the images."""
    first, later, px = wrong[0]
    count = len({row for a, b, _ in wrong for row in (a, b)})
    images = "all" if count == len(names) else f"{count} of {len(names)}"
    return (
        f"{images} images have a flange pose that another image has too, although the board moves between them, for "
        f"example by {px:.0f} px between {names[first]} and {names[later]}"
    )


EQUAL_REMEDY = (
    "write the pose of each image into its own row, or correct the link from images to rows"
)
