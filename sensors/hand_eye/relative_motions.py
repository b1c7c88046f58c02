"""Do flange poses and board poses belong together? A test before any hand-eye transform is known.

Between two poses the flange moves by A and the camera, which sees the stationary board, by B, with A X = X B for
the unknown hand-eye transform X. A and B are the same screw motion in two frames, therefore their rotation angles are
equal and so are their translations along the screw axis, whatever X is (Chen, CVPR 1991). The angles test orientations
and the assignment of images to poses; the translations test the unit of the positions and the size of the board.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workbench.core.rigid import inverse, rotation_vector

# rad: below it the axis of a rotation is uncertain; two poses that agree to this, and to this in mm, are one
_LEAST_TURN = np.deg2rad(5.0)
_SAME_RAD, _SAME_MM = np.deg2rad(0.002), 0.002
# px by which a board that stands still, before a camera that stands still, moves in the image
_STILL_PX = 2.0
_FEWEST_PAIRS = 10
# a share of a length: more than an arm or a board of any quality makes; and standard deviations
_SCALE, _SURE = 0.01, 5.0


@dataclass(frozen=True)
class RelativeMotions:
    """Relative motions of flange and camera, over all pairs of poses.

    `angle_gap_deg`: median difference of the rotation angles. `scale`: translations along the screw axes that the
    images show, over those of the flange, with its standard deviation `scale_std`; nan where too few pairs rotate.
    """

    angle_gap_deg: float
    scale: float
    scale_std: float

    def as_json(self) -> dict:
        """`hand_eye` of the answer of `check`."""
        return dict(vars(self))


def relative_motions(flange: np.ndarray, seen: np.ndarray, kind: str) -> RelativeMotions:
    """Compare flange poses (P, 4, 4) T_base_flange with board poses `seen` (P, 4, 4) T_camera_board.

    kind: "in-hand" or "to-hand". The standard deviation is a jackknife over the poses, whose pairs are not independent.
    """
    moved = flange if kind == "in-hand" else inverse(flange)
    first, second = np.triu_indices(len(flange), 1)
    arm = _screws(inverse(moved[second]) @ moved[first])
    camera = _screws(seen[second] @ inverse(seen[first]))
    gap = float(np.degrees(np.median(np.abs(arm[0] - camera[0]))))
    used = (arm[0] > _LEAST_TURN) & (arm[0] < np.pi - _LEAST_TURN) & (camera[0] > _LEAST_TURN)
    if used.sum() < _FEWEST_PAIRS:
        return RelativeMotions(gap, np.nan, np.nan)
    along = np.stack([arm[1], camera[1]])[:, used]
    pairs = np.stack([first, second])[:, used]
    scale = _slope(along)
    count = len(flange)
    parts = [_slope(along[:, (pairs != one).all(0)]) for one in range(count)]
    spread = float(np.sqrt((count - 1) / count * np.sum((np.array(parts) - np.mean(parts)) ** 2)))
    return RelativeMotions(gap, scale, spread)


def scale_gap(motions: RelativeMotions) -> tuple[str, str] | None:
    """What is wrong and what to do where images and flange show different lengths, as parts of a sentence."""
    gap = abs(motions.scale - 1)
    if not gap > max(_SCALE, _SURE * motions.scale_std):
        return None
    what = (
        f"lengths that the images show are {motions.scale:.4g} times those of the flange (standard deviation "
        f"{motions.scale_std:.1g}, from translations along the screw axes): the size of the board or the unit of the "
        "flange positions is stated wrongly"
    )
    return what, "measure the board over many squares, and check the unit of the positions"


def _screws(motions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k,) rotation angle, rad, and (k,) translation along the axis, mm, of motions (k, 4, 4)."""
    vectors = rotation_vector(motions[:, :3, :3])
    angles = np.linalg.norm(vectors, axis=1)
    axes = vectors / np.maximum(angles, 1e-12)[:, None]
    return angles, (axes * motions[:, :3, 3]).sum(1)


def _slope(along: np.ndarray) -> float:
    """The factor by which the second row (2, k) is larger than the first: median of the ratios, weighted by the first.

    A weighted median is not moved by some wrong poses, as least squares would be.
    """
    weights = np.abs(along[0])
    ratios = along[1] / np.where(weights > 0, along[0], 1.0)
    order = np.argsort(ratios)
    half = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
    return float(ratios[order][min(half, len(order) - 1)])


def equal_poses(flange: np.ndarray) -> list[tuple[int, int]]:
    """Pairs (first, later) of flange poses (P, 4, 4) that are equal; each later pose stands in one pair."""
    pairs = []
    for later in range(1, len(flange)):
        gap = np.linalg.norm(flange[:later, :3, 3] - flange[later, :3, 3], axis=1)
        relative = np.swapaxes(flange[:later, :3, :3], 1, 2) @ flange[later, :3, :3]
        turn = np.linalg.norm(rotation_vector(relative), axis=1)
        same = np.flatnonzero((gap < _SAME_MM) & (turn < _SAME_RAD))
        if same.size:
            pairs.append((int(same[0]), later))
    return pairs


def displacement_px(first, second) -> float:
    """px, median displacement of the corners that two views of a board share; nan where they share none.

    A board that looks the same after a rotation may be labelled otherwise: its centre counts, of equal sets of corners.
    """
    shared, mine, its = np.intersect1d(first.index, second.index, return_indices=True)
    if not shared.size:
        return float("nan")
    away = np.linalg.norm(first.pixels[:, mine] - second.pixels[:, its], axis=0)
    centre = np.linalg.norm(first.pixels[:, mine].mean(1) - second.pixels[:, its].mean(1))
    return float(
        min(np.median(away), centre) if len(shared) == len(first.index) else np.median(away)
    )


def wrong_equal_poses(flange: np.ndarray, views: Sequence) -> list[tuple[int, int, float]]:
    """(first, later, px) of equal flange poses (P, 4, 4) between whose `views` (P) the board moves in the image."""
    found = [(a, b, displacement_px(views[a], views[b])) for a, b in equal_poses(flange)]
    return [one for one in found if one[2] > _STILL_PX]


def equal_poses_sentence(wrong: Sequence[tuple[int, int, float]], names: Sequence[str]) -> str:
    """What `wrong_equal_poses` means, as a part of a sentence; names (P,) of the images."""
    first, later, px = wrong[0]
    count = len({row for a, b, _ in wrong for row in (a, b)})
    whole = "all" if count == len(names) else f"{count} of {len(names)}"
    return (
        f"{whole} images have a flange pose that another image has too, although the board moves between them, for "
        f"example by {px:.0f} px between {names[first]} and {names[later]}"
    )


EQUAL_REMEDY = (
    "write the pose of each image into its own row, or correct the link from images to rows"
)
