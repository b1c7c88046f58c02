"""A first camera and first poses of boards from corners alone, and the corner chain of a set of images."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sensors.camera.corners import Corners
from sensors.camera.model import BROWN, FISHEYE, RATIONAL, Camera
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.rigid import rotation_vector

if TYPE_CHECKING:
    from sensors.boards.board import Board
    from sensors.boards.detection import View

MODELS = {"brown": BROWN, "rational": RATIONAL, "fisheye": FISHEYE}
START_CORNERS = 16
"""Corners of a board pose that a start needs: its homography takes four."""
_CAMERA_GROUPS = 20
_FISHEYE_VIEWS = np.deg2rad(
    [60, 80, 100, 120, 140, 160, 180, 200]
)  # of the longer side of the image
_WIDEST, _NARROWEST = 0.2, 50.0  # focal lengths over the image's width: 136 and 1 degrees of view


def placement_groups(views: Sequence["View"]) -> tuple[np.ndarray, list[str]]:
    """(V,) group of each view, in order of appearance, and the groups' names: board poses, else images."""
    names = [view.placement or view.image for view in views]
    order = {name: k for k, name in enumerate(dict.fromkeys(names))}
    return np.array([order[name] for name in names], int), list(order)


def corner_chain(
    views: Sequence["View"], board: "Board", size: tuple[int, int], model: str = "brown"
) -> Corners:
    """All corners of the views, sorted by board pose, before a camera and poses are known (zeros)."""
    group, names = placement_groups(views)
    order = np.argsort(group, kind="stable")
    counts = np.array([len(views[k].index) for k in order])
    index = np.concatenate([views[k].index for k in order])
    place = (board.points - board.middle[:, None])[:2] / board.half_diagonal
    camera = Camera.of(
        np.r_[1.0, 1.0, (size[0] - 1) / 2, (size[1] - 1) / 2, np.zeros(MODELS[model] - 4)], size
    )
    return Corners(
        camera,
        board.points[:, index],
        place[:, index],
        np.concatenate([views[k].pixels for k in order], axis=1),
        {
            "placement": np.repeat(group[order], counts),
            "view": np.repeat(order, counts),
            "corner": index,
        },
        np.zeros((len(names), 6)),
        np.tile(np.concatenate([views[k].sigma for k in order]), (2, 1)),
        float(np.median([view.radius_mm for view in views])),
        _covariates(views, order, counts),
    )


def check_views(views: Sequence["View"], board: "Board", size: tuple[int, int]) -> None:
    """InputError where a view is not of this board, of another size of image, or holds no numbers."""
    if not np.isfinite(np.concatenate([view.pixels for view in views], axis=1)).all():
        wrong = next(view for view in views if not np.isfinite(view.pixels).all())
        raise InputError(
            f"{wrong.image}: expected a place in px of every corner, found nan; detect the corners again"
        )
    last = board.points.shape[1] - 1
    if np.max(np.concatenate([view.index for view in views]), initial=0) > last:
        wrong = next(view for view in views if np.max(view.index, initial=0) > last)
        raise InputError(
            f"{wrong.image}: expected corners 0 to {last} of the board, found {np.max(wrong.index)}; "
            "detect the corners with this board"
        )
    other = next((view for view in views if tuple(view.size) != tuple(size)), None)
    if other is not None:
        raise InputError(
            f"{other.image}: expected a image of {size[0]} x {size[1]} pixels as the others, found "
            f"{other.size[0]} x {other.size[1]}; calibrate each size by itself"
        )


def _covariates(views, order, counts):
    """Columns of numbers that every image has."""
    columns = {}
    for name in _number_columns(views):
        value_by_image = np.array([views[k].row[name] for k in order], float)
        columns[name] = np.repeat(value_by_image, counts)
    return columns


def _number_columns(views):
    """Sorted names of the columns in which every image has a number."""
    shared = set.intersection(*(set(view.row) for view in views))
    return sorted(
        name for name in shared if all(isinstance(view.row[name], (int, float)) for view in views)
    )


def thinned(chain: Corners) -> np.ndarray:
    """(t,) indices of at most `START_CORNERS` corners of each board pose."""
    chosen, new = spread(chain)
    return chosen[new]


def spread(chain: Corners) -> tuple[np.ndarray, np.ndarray]:
    """(G, START_CORNERS) corners of each board pose, spread over it and not periodic; which are no repeats."""
    bounds = np.searchsorted(chain.labels["placement"], np.arange(len(chain.poses) + 1))
    share = (
        np.arange(START_CORNERS) + np.random.default_rng(0).random(START_CORNERS)
    ) / START_CORNERS
    chosen = bounds[:-1, None] + (share * np.diff(bounds)[:, None]).astype(int)
    return chosen, np.diff(chosen, axis=1, prepend=-1) > 0


def started(chain: Corners) -> Corners:
    """The chain at a first camera without distortion and first poses; four corners or more of every board pose.

    Camera: cv2.initCameraMatrix2D, the linear solution of Zhang, PAMI 22 (2000) 1330, with the principal
    point in the middle. A focal length that the boards do not tell is started as a usual lens's, 1.2
    widths of the image.
    """
    chosen, new = spread(chain)
    if chain.camera.is_fisheye:
        return _started_fisheye(chain, chosen, new)
    camera = _first_camera(chain, chosen, new)
    return chain.moved(camera, first_poses(homographies(chain, chosen, new), camera.matrix))


def _started_fisheye(chain, chosen, new):
    """The chain at the equidistant lens, r = f theta, whose angle of view leaves the least of the boards."""
    found = []
    width = max(chain.camera.size)
    for view in _FISHEYE_VIEWS:
        camera = Camera.of(
            np.r_[width / view, width / view, chain.camera.values[2:]], chain.camera.size
        )
        flat = camera.normalised(chain.pixels)
        is_seen = np.isfinite(flat).all(0)
        usable = new & is_seen[chosen]
        if (usable.sum(1) < 6).any():
            continue
        ideal = replace(chain, pixels=np.where(is_seen, flat, 0.0))
        poses = first_poses(homographies(ideal, chosen, usable), np.eye(3))
        moved = chain.moved(camera, poses)
        misfit = np.abs(camera.project(moved.state.points) - chain.pixels)[:, is_seen]
        found.append((float(np.median(misfit)), len(found), moved))
    if not found:
        raise InputError(
            "camera: expected boards within 88 degrees of the optical axis for the fisheye model, found corners "
            "farther out in every image; take images with the board nearer to the middle"
        )
    return min(found, key=lambda row: row[:2])[2]


def _first_camera(chain, chosen, new):
    import cv2

    camera = chain.camera
    chosen_groups = np.unique(np.linspace(0, len(chosen) - 1, _CAMERA_GROUPS).astype(int))
    points, pixels = (
        [np.ascontiguousarray(of[:, chosen[g, new[g]]].T, np.float32) for g in chosen_groups]
        for of in (chain.points, chain.pixels)
    )
    try:
        found = cv2.initCameraMatrix2D(points, pixels, camera.size)
    except cv2.error:
        found = np.full((3, 3), np.nan)
    width = max(camera.size)
    focal = [
        f if _WIDEST < f / width < _NARROWEST else usual_focal(camera)
        for f in (found[0, 0], found[1, 1])
    ]
    return Camera.of(np.r_[focal, camera.values[2:]], camera.size)


def usual_focal(camera: Camera) -> float:
    """px, the focal length of a usual lens."""
    return 1.2 * max(camera.size)


def homographies(chain: Corners, chosen: np.ndarray, new: np.ndarray) -> np.ndarray:
    """(G, 3, 3) from board (mm) to image (px), by least squares over `chosen` corners (G, k) where `new`.

    Direct linear transform in normalised coordinates (Hartley & Zisserman, Multiple View Geometry, 2nd
    ed., alg. 4.2), with the last number 1 there: the middle of a board's corners is never at infinity.
    """
    weight = new.astype(float)
    places, board = _normalised(chain.points[:2, chosen], weight)
    pixels, image = _normalised(chain.pixels[:, chosen], weight)
    normal = _transform_normal(places, pixels, weight)
    gram = normal[:, :8, :8]
    right = normal[:, :8, 8:]
    small = 1e-12 * np.trace(gram, axis1=1, axis2=2)
    found = solve_positive(gram + small[:, None, None] * np.eye(8), right)[..., 0]
    with_last = np.concatenate([found, np.ones((len(found), 1))], axis=1)
    normalised = with_last.reshape(-1, 3, 3)
    return np.linalg.solve(image, normalised @ board)


def _transform_normal(places, pixels, weight):
    """(G, 9, 9) normal matrices of the direct linear transform, from (2, G, k) places and pixels, weights (G, k)."""
    (x, y), (u, v) = places, pixels
    ones = np.ones_like(x)
    zero = np.zeros_like(x)
    along_u = np.stack([x, y, ones, zero, zero, zero, -u * x, -u * y, u])
    along_v = np.stack([zero, zero, zero, x, y, ones, -v * x, -v * y, v])
    # (2, 9, G, k) -> (G, 9, 2 k): both equations of all corners of a board
    equations = np.stack([along_u, along_v]) * weight
    rows = np.moveaxis(equations, 2, 0).transpose(0, 2, 1, 3).reshape(len(weight), 9, -1)
    return rows @ rows.transpose(0, 2, 1)


def _normalised(places, weight):
    """Places (2, G, k) moved and scaled to about 1, and the matrices (G, 3, 3) that do so."""
    total = weight.sum(1)
    middle = (places * weight).sum(2) / total
    deviation = places - middle[..., None]
    size = np.sqrt(((deviation**2).sum(0) * weight).sum(1) / total)
    transforms = np.zeros((len(total), 3, 3))
    transforms[:, 0, 0] = transforms[:, 1, 1] = 1 / size
    transforms[:, :2, 2], transforms[:, 2, 2] = -(middle / size).T, 1
    return deviation / size[:, None], transforms


def first_poses(maps: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(G, 6) poses of planar boards from homographies (G, 3, 3) and the camera matrix (Zhang 2000, sec. 3.1).

    The two axes that the homography gives are made unit and orthogonal, both turned by the same amount.
    """
    columns = np.linalg.solve(matrix, maps)
    columns *= (2 * np.sign(columns[:, 2, 2]) / np.linalg.norm(columns[..., :2], axis=1).sum(1))[
        :, None, None
    ]
    sums = columns[..., 0] + columns[..., 1], columns[..., 0] - columns[..., 1]
    diagonal, antidiagonal = (
        part / np.linalg.norm(part, axis=1, keepdims=True) / np.sqrt(2) for part in sums
    )
    x = diagonal + antidiagonal
    y = diagonal - antidiagonal
    return np.c_[columns[..., 2], rotation_vector(np.stack([x, y, np.cross(x, y)], axis=-1))]
