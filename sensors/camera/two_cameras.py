"""Whether the images are of two cameras: another camera, another focus or zoom, or mirrored images among the others.

One camera is fitted to all board poses. If that does not describe them, the board poses are divided into two groups,
each with a camera of its own, by k-means with cameras as means (Lloyd, IEEE Trans. Inf. Theory 28 (1982) 129): each
board pose goes to the camera that describes it better, and both cameras are fitted again, until nothing changes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensors.camera.checks import fit_free, group_subset, posed
from sensors.camera.corners import Corners
from sensors.camera.model import Camera
from workbench.core.distributions import fisher
from workbench.core.effect import Effect
from workbench.core.model import Model
from workbench.core.parameters import Parameters

_FEWEST = 3  # board poses that a camera needs
_ROUNDS, _STARTS = 8, 4
_LEVEL = 1e-9  # of the F-test, small because of the many divisions that are possible
_MIRROR_TOLERANCE = 0.1
"""Share of the distance of two mirrored principal points by which their middle may be off the centre of the image."""
_NAMED = 6
_EXPLAINED = (
    0.5  # share of the sum of squares that two cameras explain, below which they are no cause
)


@dataclass(frozen=True)
class TwoCameras:
    """Two groups of board poses that one camera does not describe.

    `images` names of the images of the smaller group; `cameras` of the larger and of the smaller group; `rms_px` (2-D,
    as OpenCV counts) with one camera and with two.
    """

    images: tuple[str, ...]
    cameras: tuple[Camera, Camera]
    rms_px: tuple[float, float]

    @property
    def are_mirrored(self) -> bool:
        """Whether the principal points of the two cameras are mirror images of each other in one direction."""
        first, second = self.cameras
        width, height = first.size
        return _is_mirrored(first.cx, second.cx, width) or _is_mirrored(first.cy, second.cy, height)

    @property
    def sentence(self) -> str:
        """Which images, how they differ, and what to do."""
        first, second = (_described(camera) for camera in self.cameras)
        shown = ", ".join(self.images[:_NAMED]) + " ..." * (len(self.images) > _NAMED)
        mirrored = (
            " The principal points are mirror images of each other." if self.are_mirrored else ""
        )
        return (
            f"the images are not of one camera: {len(self.images)} of them ({shown}) fit {second}, the others {first}. "
            f"The RMS reprojection error is {self.rms_px[0]:.3g} px with one camera and {self.rms_px[1]:.3g} px with "
            f"two.{mirrored} Another camera, a changed focus or zoom, or mirrored images cause this: calibrate the two "
            "groups separately"
        )


def _is_mirrored(first: float, second: float, size: int) -> bool:
    """Whether two coordinates of principal points are mirror images in the middle of an image of `size` pixels."""
    offset = abs(first + second - (size - 1))
    return offset < _MIRROR_TOLERANCE * abs(first - second)


def _described(camera: Camera) -> str:
    return f"a focal length of {camera.fx:.1f} px and a principal point of ({camera.cx:.1f}, {camera.cy:.1f}) px"


def find_two_cameras(
    chain: Corners,
    effects: Sequence[Effect],
    known: Parameters,
    changes: np.ndarray,
    names: Sequence[str],
) -> TwoCameras | None:
    """Two groups of the board poses with a camera each; None where one camera describes them about as well.

    chain: corners at the solution `known` of one camera. changes: (G,) change of each board pose by which the first
    division is made, such as that of the focal length (`FocalScatter.changes`). names: of the images, by `view`.
    """
    count = len(chain.poses)
    if count < 2 * _FEWEST:
        return None
    one_camera = _squares(chain, effects, known)
    best = None
    for start in _divisions(np.asarray(changes), count):
        found = _divided(chain, effects, known, start)
        if found is not None and (best is None or found[1].sum() < best[1].sum()):
            best = found
    if best is None or not _is_better(chain, one_camera.sum(), best[1].sum(), known):
        return None
    is_other, squares, cameras = best
    if 2 * is_other.sum() > count:
        is_other, cameras = ~is_other, cameras[::-1]
    corners = chain.pixels.shape[1]
    scale = float(np.median(chain.sigma))
    sizes = tuple(scale * float(np.sqrt(total.sum() / corners)) for total in (one_camera, squares))
    size = chain.camera.size
    numbers = len(chain.parameters)
    fitted = tuple(Camera.of(camera.values[:numbers], size) for camera in cameras)
    in_other = is_other[chain.labels["placement"]]
    images = tuple(names[k] for k in np.unique(chain.labels["view"][in_other]))
    return TwoCameras(images, fitted, sizes)


def _divisions(changes: np.ndarray, count: int):
    """First divisions (G,) bool: by the changes, and at random."""
    if len(changes) == count:
        yield changes > np.median(changes)
    rng = np.random.default_rng(0)
    for _ in range(_STARTS):
        yield rng.permutation(count) < count // 2


def _divided(chain, effects, known, is_other):
    """(division, sums of squares (G,), the two cameras) that k-means finds from a division; None without two groups."""
    for _ in range(_ROUNDS):
        if min(is_other.sum(), (~is_other).sum()) < _FEWEST:
            return None
        groups = [np.flatnonzero(part) for part in (~is_other, is_other)]
        cameras = [
            fit_free(group_subset(chain, group), effects, known, "huber").parameters
            for group in groups
        ]
        squares = np.stack([_squares(chain, effects, camera) for camera in cameras])
        chosen = squares[1] < squares[0]
        if (chosen == is_other).all():
            break
        is_other = chosen
    return is_other, squares.min(0), cameras


def _squares(chain: Corners, effects, known: Parameters) -> np.ndarray:
    """(G,) sum of squared residuals over sigma of each board pose, its pose fitted."""
    model = Model(posed(chain, effects, known), tuple(effects))
    residual = model.residual(known) / chain.sigma
    return np.bincount(chain.labels["placement"], (residual**2).sum(0), len(chain.poses))


def _is_better(chain: Corners, one_camera: float, two_cameras: float, known: Parameters) -> bool:
    """F-test of a second camera, which also has to explain most of what one camera leaves."""
    numbers = len(known)
    degrees = chain.pixels.size - 6 * len(chain.poses) - 2 * numbers
    if degrees < 1 or two_cameras > _EXPLAINED * one_camera:
        return False
    reduction = (one_camera - two_cameras) / numbers
    f_statistic = reduction / (two_cameras / degrees)
    p_value = fisher.sf(f_statistic, numbers, degrees)
    return float(p_value) < _LEVEL
