"""Checks of a camera: errors on held-out images, its halves compared, and its uncertainty over the image."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensors.camera.corners import Corners, placements
from sensors.camera.model import RATIONAL, Camera
from workbench.core.distributions import chi2
from workbench.core.effect import Effect
from workbench.core.least_squares.bundle import BundleFit, solve_bundle
from workbench.core.least_squares.linear_algebra import all_finite, least_squares, solve_positive
from workbench.core.model import Model
from workbench.core.parameters import Parameters

ENOUGH = 3
"""Board poses that a camera needs."""
_MAP = (21, 17)
_CELLS = (8, 6)


def group_subset(chain: Corners, groups: np.ndarray) -> Corners:
    """The chain with some of its board poses only (sorted indices), renumbered."""
    chosen = chain.at(np.isin(chain.labels["placement"], groups))
    renamed = np.searchsorted(groups, chosen.labels["placement"])
    return replace(
        chosen, poses=chain.poses[groups], labels={**chosen.labels, "placement": renamed}
    )


def rms(residual: np.ndarray) -> float:
    """px, as OpenCV counts: root of the mean squared length of residuals (2, n)."""
    return float(np.sqrt((residual**2).sum(0).mean()))


def fit_free(
    chain: Corners, effects: Sequence[Effect], start: Parameters, loss: str, steps: int = 50
) -> BundleFit:
    """Camera, effects and all poses from a start."""
    families = {"placement": placements(chain.poses)}
    return solve_bundle([Model(chain, tuple(effects))], start, families, loss=loss, steps=steps)


def posed(chain: Corners, effects: Sequence[Effect], known: Parameters) -> Corners:
    """The chain with each pose fitted to its corners, camera and effects as known."""
    fixed = known.only(np.zeros(len(known), bool))
    fit = solve_bundle(
        [Model(chain, tuple(effects))], fixed, {"placement": placements(chain.poses)}
    )
    return replace(chain, poses=fit.values["placement"])


@dataclass(frozen=True)
class HeldOut:
    """RMS (px, as OpenCV counts) on images left out, each fold's camera made from all other board poses.

    `rms_px`: after the six numbers of each left-out pose were fitted to its own corners;
    `halved_rms_px`: the pose fitted to every second corner, the error on the others, both ways; the
    same of cv2.calibrateCamera and cv2.solvePnP on the same images.
    """

    folds: int
    rms_px: float
    halved_rms_px: float
    opencv_rms_px: float
    opencv_halved_rms_px: float

    @property
    def sentence(self) -> str:
        return (
            f"held-out images, {self.folds} folds: RMS {self.rms_px:.4f} px with the pose of each image fitted "
            f"(OpenCV {self.opencv_rms_px:.4f} px); RMS {self.halved_rms_px:.4f} px with the pose fitted to every "
            f"second corner and tested on the others (OpenCV {self.opencv_halved_rms_px:.4f} px)"
        )


def held_out(
    chain: Corners, effects: Sequence[Effect], known: Parameters, loss: str, folds: int
) -> HeldOut | None:
    """Cross-validation over board poses; None where they are too few to leave any out."""
    folds = min(folds, len(chain.poses))
    if folds < 2 or len(chain.poses) - -(-len(chain.poses) // folds) < ENOUGH:
        return None
    residual_sets: list[list[np.ndarray]] = [[], [], [], []]
    for fold in range(folds):
        out = np.arange(fold, len(chain.poses), folds)
        training = group_subset(chain, np.setdiff1d(np.arange(len(chain.poses)), out))
        held_out_views = group_subset(chain, out)
        camera = fit_free(training, effects, known, loss).parameters
        camera_of_opencv = opencv_camera(training)
        for part, residual in zip(
            residual_sets,
            (
                *_full_and_halved(held_out_views, effects, camera),
                *_opencv(held_out_views, camera_of_opencv),
            ),
        ):
            part.append(residual)
    return HeldOut(folds, *(rms(np.concatenate(part, axis=1)) for part in residual_sets))


def _halves(chain):
    """Masks (n,) of every second corner of each board pose, and of the others."""
    pose = chain.labels["placement"]
    first_corners = np.searchsorted(pose, np.arange(len(chain.poses)))
    rank_in_pose = np.arange(len(pose)) - first_corners[pose]
    is_odd = rank_in_pose % 2 == 1
    return ~is_odd, is_odd


def _full_and_halved(chain, effects, known):
    """(2, n) residuals with each pose from all its corners, and with the pose from the other half of them."""
    model = Model(posed(chain, effects, known), tuple(effects))
    halved = np.empty(chain.pixels.shape)
    for half, other in (_halves(chain), _halves(chain)[::-1]):
        poses = posed(model.chain.at(half), effects, known).poses
        halved[:, other] = Model(
            replace(model.chain, poses=poses).at(other), tuple(effects)
        ).residual(known)
    return model.residual(known), halved


def residuals_of_halves(
    chain: Corners, effects: Sequence[Effect], known: Parameters
) -> tuple[np.ndarray, np.ndarray]:
    """Errors (2, n) px with each pose from every second corner and judged on the others, and the board pose (n,)."""
    return _full_and_halved(chain, effects, known)[1], chain.labels["placement"]


def opencv_camera(chain: Corners) -> Camera:
    """cv2.calibrateCamera on the same corners, Brown or rational as the chain's camera."""
    import cv2

    if chain.camera.is_fisheye:
        return _opencv_fisheye(chain)
    groups = [chain.labels["placement"] == g for g in range(len(chain.poses))]
    points = [np.ascontiguousarray(chain.points[:, g].T, np.float32) for g in groups]
    pixels = [np.ascontiguousarray(chain.pixels[:, g].T, np.float32) for g in groups]
    # neither 5 nor 8 coefficients need a flag that shares its value with another in some release of OpenCV
    flags = cv2.CALIB_RATIONAL_MODEL if len(chain.camera.values) == RATIONAL else 0
    threads = cv2.getNumThreads()
    cv2.setNumThreads(
        1
    )  # several add up the images in changing order, and round differently each time
    try:
        _, matrix, distortion, *_ = cv2.calibrateCamera(
            points, pixels, chain.camera.size, None, None, flags=flags
        )
    finally:
        cv2.setNumThreads(threads)
    lens = distortion.ravel()[: len(chain.camera.distortion)]
    return Camera.of(
        [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *lens], chain.camera.size
    )


def _opencv_fisheye(chain: Corners) -> Camera:
    """cv2.fisheye.calibrate on the same corners; all values are nan where it gives up."""
    import cv2

    groups = [chain.labels["placement"] == g for g in range(len(chain.poses))]
    points = [np.ascontiguousarray(chain.points[:, g].T)[:, None] for g in groups]
    pixels = [np.ascontiguousarray(chain.pixels[:, g].T, float)[:, None] for g in groups]
    flags = (
        cv2.fisheye.CALIB_RECOMPUTE_EXTRINSIC
        | cv2.fisheye.CALIB_FIX_SKEW
        | cv2.fisheye.CALIB_USE_INTRINSIC_GUESS  # without it, it gives up on boards far from the axis
    )
    try:
        _, matrix, distortion, *_ = cv2.fisheye.calibrate(
            points, pixels, chain.camera.size, chain.camera.matrix, np.zeros(4), flags=flags
        )
    except cv2.error:
        return Camera.of(np.full(len(chain.camera.values), np.nan), chain.camera.size)
    values = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()]
    return Camera.of(np.array(values), chain.camera.size)


def _opencv(chain, camera):
    """As `_full_and_halved`, with OpenCV's camera and poses."""
    full_error = np.empty(chain.pixels.shape)
    halved = np.empty(chain.pixels.shape)
    even, odd = _halves(chain)
    for g in range(len(chain.poses)):
        is_of_board_pose = chain.labels["placement"] == g
        full_error[:, is_of_board_pose] = _seen_by_opencv(
            chain, camera, is_of_board_pose, is_of_board_pose
        )
        for half, other in ((even, odd), (odd, even)):
            halved[:, is_of_board_pose & other] = _seen_by_opencv(
                chain, camera, is_of_board_pose & half, is_of_board_pose & other
            )
    return full_error, halved


def _seen_by_opencv(chain, camera, fitted, is_held_out):
    """(2, k) residuals of the corners asked, with the pose from those fitted."""
    import cv2

    if not np.isfinite(camera.values).all():
        return np.full((2, int(is_held_out.sum())), np.nan)
    view = camera.pnp_view(chain.pixels[:, fitted])
    _, rotation, translation = cv2.solvePnP(chain.points[:, fitted].T.copy(), *view)
    points = cv2.Rodrigues(rotation)[0] @ chain.points[:, is_held_out] + translation
    return camera.project(points) - chain.pixels[:, is_held_out]


@dataclass(frozen=True)
class FieldMap:
    """A number (px) over the image: `value` (rows, columns) at pixels `x` (columns,), `y` (rows,) and a distance."""

    x: np.ndarray
    y: np.ndarray
    value: np.ndarray
    distance_mm: float


def projection_uncertainty(camera: Camera, covariance: np.ndarray, distance: float) -> FieldMap:
    """1 sigma, px, of where points `distance` mm away project: the longer half axis of the ellipse.

    covariance: (P, P) of the camera's values. A camera that is a little turned or shifted in its
    housing is the same camera with other poses: from every change of its values the rigid motion that
    best undoes it over the whole image is taken off first, as mrcal does (Kogan,
    https://mrcal.secretsauce.net/uncertainty.html).
    """
    x, y, by_value, _ = _compensated(camera, distance)
    spread = np.einsum("pcn,pq,qdn->ncd", by_value, covariance, by_value)
    variance_u = spread[:, 0, 0]
    variance_v = spread[:, 1, 1]
    covariance_uv = spread[:, 0, 1]
    largest = (variance_u + variance_v) / 2 + np.hypot(
        (variance_u - variance_v) / 2, covariance_uv
    )  # larger eigenvalue of each 2 x 2 matrix
    return FieldMap(x, y, np.sqrt(np.maximum(largest, 0)).reshape(len(y), len(x)), distance)


def _compensated(camera, distance):
    """Grid of the map, pixels' derivative by the camera's values (P, 2, n) less rigid motion, and the points."""
    x, y = (np.linspace(0, size - 1, count) for size, count in zip(camera.size, _MAP))
    pixels = np.stack([grid.ravel() for grid in np.meshgrid(x, y)])
    points = distance * camera.rays(pixels)
    is_usable = np.isfinite(points).all(0)
    _, by_point, by_value = camera.project_rows(np.where(is_usable, points, 1.0))
    return (
        x,
        y,
        np.where(
            is_usable, _without_motions(by_value, motion_rows(by_point, points), is_usable), np.nan
        ),
        points,
    )


def motion_rows(by_point: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(6, 2, n) by a shift (mm) and a rotation (rad) of points (3, n), from the derivative by the point (3, 2, n)."""
    by_rotation = np.cross(np.eye(3)[:, None], points.T[None], axis=-1)  # (3, n, 3)
    return np.concatenate([by_point, np.einsum("knj,jcn->kcn", by_rotation, by_point)])


def _without_motions(rows, motion, is_usable):
    """rows (P, 2, n) minus their projection onto the motions (6, 2, n), fitted where `is_usable`."""
    design = motion[:, :, is_usable].reshape(len(motion), -1).T
    targets = rows[:, :, is_usable].reshape(len(rows), -1).T
    coefficients = least_squares(design, targets)
    return rows - np.tensordot(coefficients.T, motion, 1)


@dataclass(frozen=True)
class Halves:
    """Two cameras, each from every second board pose.

    `difference`: px by which they project points at the working distance differently, after the best
    rigid motion; `sigma`: 1 sigma of it, from both covariances; `chi_square` of the `numbers` of the
    camera's values that differ: about `numbers` where the stated sigmas hold.
    """

    difference: FieldMap
    sigma: FieldMap
    chi_square: float
    numbers: int

    @property
    def ratio(self) -> float:
        """Difference over its stated sigma: about 1 where the sigmas hold."""
        return float(np.sqrt(self.chi_square / self.numbers))

    @property
    def p_value(self) -> float:
        """Probability of at least this difference, were the sigmas right."""
        return float(chi2.sf(self.chi_square, self.numbers))

    @property
    def sentence(self) -> str:
        middle = np.nanmedian(self.difference.value)
        worst = np.nanmax(self.difference.value)
        return (
            f"cameras from two halves of the board poses project {middle:.3f} px apart in the median of the image "
            f"and {worst:.3f} px at most, {self.ratio:.2f} times what their sigmas say"
        )


def compare_halves(
    chain: Corners, effects, known: Parameters, loss: str, distance: float
) -> Halves | None:
    """Cross-validation between halves; None where a half would have too few board poses."""
    placements = np.arange(len(chain.poses))
    if len(placements) < 2 * ENOUGH:
        return None
    fits = [
        fit_free(group_subset(chain, placements[part::2]), effects, known, loss) for part in (0, 1)
    ]
    size = len(chain.parameters)
    first, second = (Camera.of(fit.parameters.values[:size], chain.camera.size) for fit in fits)
    spread = sum(fit.covariance[:size, :size] for fit in fits)
    gap = second.values - first.values
    typical = chain.parameters.typical
    if not all_finite(
        spread
    ):  # a half that leaves a number of its camera undetermined says nothing of the other
        return None
    scaled = solve_positive(spread / np.outer(typical, typical), gap / typical)
    difference = projection_difference(first, second, distance)
    sigma = projection_uncertainty(first, spread, distance)
    return Halves(difference, sigma, float(gap / typical @ scaled), size)


def projection_difference(first: Camera, second: Camera, distance: float) -> FieldMap:
    """px by which the second projects what the first sees `distance` mm away elsewhere, after the best rigid motion."""
    x, y = (np.linspace(0, size - 1, count) for size, count in zip(first.size, _MAP))
    pixels = np.stack([grid.ravel() for grid in np.meshgrid(x, y)])
    points = distance * first.rays(pixels)
    is_usable = np.isfinite(points).all(0)
    points = np.where(is_usable, points, 1.0)
    for _ in range(4):
        seen, by_point, _ = second.project_rows(points)
        motion = motion_rows(by_point, points)
        move = least_squares(
            motion[:, :, is_usable].reshape(6, -1).T, (pixels - seen)[:, is_usable].ravel()
        )
        points = points + move[:3, None] + np.cross(move[3:], points.T).T
    gap = np.where(is_usable, np.hypot(*(second.project(points) - pixels)), np.nan)
    return FieldMap(x, y, gap.reshape(len(y), len(x)), distance)


def coverage(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(6, 8) how many corners, pixels (2, n), lie in each cell of the image."""
    x_edges, y_edges = (
        np.linspace(-0.5, extent - 0.5, count + 1) for extent, count in zip(size, _CELLS)
    )
    counts, _, _ = np.histogram2d(pixels[1], pixels[0], bins=[y_edges, x_edges])
    return counts.astype(int)
