"""Grids of circles: candidates for discs, the grid among them, and what perspective does to a disc's centre."""

import numpy as np

from sensors.boards.homography import area_scale, project
from sensors.boards.patches import Fit, disc_area, fit_discs

ELLIPSE = 0.07
"""How far the area of a disc may be from that of an ellipse of the same second moments."""
FLATTEST = 0.2
"""Short over long axis of the flattest disc: a board seen at 78 degrees."""
LEAST_AREA = 20
"""px^2 of the smallest disc: 5 px across."""
BLOCKS = (6, 16, 40)
"""Local thresholds: the image's shorter side over these."""


def candidates(image: np.ndarray, light: bool) -> np.ndarray:
    """(6, n) x, y (px), area (px^2) and second moments xx, xy, yy (px^2) of what looks like a disc.

    image: (H, W) uint8; light: discs brighter than what surrounds them.
    """
    import cv2

    kind = cv2.THRESH_BINARY if light else cv2.THRESH_BINARY_INV
    found = []
    for share in BLOCKS:
        block = max(7, min(image.shape) // share) | 1
        marked = cv2.adaptiveThreshold(
            image, 255, cv2.ADAPTIVE_THRESH_MEAN_C, kind, block, -4 if light else 4
        )
        contours = cv2.findContours(marked, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
        found += [_moments(cv2.moments(contour)) for contour in contours if len(contour) >= 12]
    rows = np.array([row for row in found if row is not None]).reshape(-1, 7)
    return _of_one_family(_distinct_discs(rows[rows[:, 2] < image.size / 20]))


def _moments(m: dict) -> tuple | None:
    """x, y, area, second moments and how far from an ellipse; None where it cannot be a disc."""
    area = m["m00"]
    if area < LEAST_AREA:
        return None
    xx = m["mu20"] / area
    xy = m["mu11"] / area
    yy = m["mu02"] / area
    product = xx * yy - xy * xy
    longer = (xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)
    if product <= (FLATTEST * longer) ** 2:
        return None
    misfit = abs(area / (4 * np.pi * np.sqrt(product)) - 1)
    return (
        None if misfit > ELLIPSE else (m["m10"] / area, m["m01"] / area, area, xx, xy, yy, misfit)
    )


def _distinct_discs(rows: np.ndarray) -> np.ndarray:
    """One row a disc, where several thresholds found it: the best ellipse."""
    from scipy.spatial import cKDTree

    rows = rows[np.argsort(rows[:, 6], kind="stable")] if len(rows) else rows
    if len(rows) < 2:
        return rows[:, :6].T
    neighbours = cKDTree(rows[:, :2]).query_ball_point(
        rows[:, :2], 0.5 * np.sqrt(rows[:, 2] / np.pi)
    )
    is_assigned = np.zeros(len(rows), bool)
    keep = []
    for k, others in enumerate(neighbours):
        if not is_assigned[k]:
            keep.append(k)
            is_assigned[others] = True
    return rows[keep, :6].T


def _of_one_family(rows: np.ndarray) -> np.ndarray:
    """Only discs that have two or more of about their size within eight radii: a grid, and little else."""
    area = rows[2]
    radius = np.sqrt(area / np.pi)[:, None]
    distance = _pairwise_distances(rows[:2])
    is_near = (distance > 1.5 * radius) & (distance < 8 * radius)
    ratio = area[:, None] / area
    is_alike = np.abs(np.log(ratio)) < np.log(2)
    neighbours = (is_alike & is_near).sum(1)
    return rows[:, neighbours >= 2]


def _pairwise_distances(points: np.ndarray) -> np.ndarray:
    """(n, n) distances between the points (2, n)."""
    return np.hypot(*(points[:, :, None] - points[:, None]))


def _neighbour_distances(points: np.ndarray) -> np.ndarray:
    """(n,) distance from each of the points (2, n) to its nearest neighbour."""
    distance = _pairwise_distances(points)
    np.fill_diagonal(distance, np.inf)
    return distance.min(1)


def grid_among(found: np.ndarray, columns: int, rows: int, asymmetric: bool) -> np.ndarray | None:
    """(rows * columns,) which candidates are the grid, in order of rows; None where there is no such grid."""
    import cv2

    if found.shape[1] < columns * rows:
        return None
    places = np.ascontiguousarray(found[:2].T, np.float32).reshape(-1, 1, 2)
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    for flags in (kind, kind | cv2.CALIB_CB_CLUSTERING):
        cv2.setRNGSeed(0)  # the finder draws lots: the same image shall always give the same answer
        try:
            is_complete, centres = cv2.findCirclesGrid(
                places,
                (columns, rows),
                flags=flags,
                blobDetector=None,
                parameters=cv2.CirclesGridFinderParameters(),
            )
        except cv2.error:
            continue
        if not is_complete:
            continue
        chosen = np.argmin(
            np.hypot(*(centres.reshape(-1, 2).T[:, :, None] - found[:2, None])), axis=1
        )
        if len(np.unique(chosen)) == len(chosen) and is_flat(
            _lattice(columns, rows, asymmetric), found[:2, chosen]
        ):
            return chosen
    return None


def _lattice(columns: int, rows: int, asymmetric: bool) -> np.ndarray:
    """(2, N) places of a grid with steps of 1."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    return np.stack([2 * column + row % 2 if asymmetric else column, row]).astype(float)


def is_flat(points: np.ndarray, pixels: np.ndarray) -> bool:
    """Whether marks (2, k) lie in the image (2, k) as on a plane: nine in ten of them within 15 % of a step.

    A lens bends a board by less; marks that were taken for their neighbours lie a whole step off.
    """
    import cv2

    if points.shape[1] < 4:
        return False
    h, _ = cv2.findHomography(points.T, pixels.T, cv2.RANSAC, 3.0)
    if h is None:
        return False
    residual = np.hypot(*(project(h, points) - pixels))
    step = np.median(_neighbour_distances(pixels))
    return bool(np.mean(residual < 0.15 * step + 2) > 0.9)


def refine(image: np.ndarray, discs: np.ndarray) -> Fit:
    """Centres and axes of chosen candidates (6, n) to a small part of a pixel."""
    centre = discs[:2]
    area, xx, xy, yy = discs[2:]
    gap = _neighbour_distances(centre) / 2 - np.sqrt(area / np.pi)
    spread = np.array([[xx, xy], [xy, yy]])
    return fit_discs(image, centre, spread, gap)


def radius_mm(fit: Fit, points: np.ndarray) -> float:
    """Radius of the board's discs: median over the image of the ellipses' size relative to the grid's own.

    points: (2, n) mm on the board. An ellipse's area over pi r^2 is the determinant of the map from board
    to image at its place; the map is the homography through all centres.
    """
    import cv2

    is_usable = fit.good
    h = cv2.findHomography(points.T[is_usable], fit.centre.T[is_usable], 0)[0]
    scale = area_scale(h, points)
    radius = np.sqrt(disc_area(fit) / np.pi / scale)
    return float(np.median(radius[is_usable]))


def centre_shift(points: np.ndarray, normal: np.ndarray, radius: float) -> np.ndarray:
    """(3, n) mm to add to the centres of discs so that they project where their ellipses' centres are.

    points: (3, n) mm, centres in the camera frame; normal: (3,) or (3, n) unit normal of the board there;
    radius in mm. From the dual conic of the disc's image, q q' - r^2 (I - n n') for a centre q: the
    ellipse's centre is its third column over its last number (the bias is that of Heikkilä, PAMI 22
    (2000) 1066). Exact for an ideal camera; a lens that bends over one disc adds `lens_shift`.
    """
    normal = np.reshape(normal, (3, -1))
    in_plane = -normal * normal[2]
    in_plane[2] += 1
    return -(radius**2) / points[2] * in_plane


def lens_shift(camera, points: np.ndarray, normals: np.ndarray, radius: float) -> np.ndarray:
    """(2, n) px by which the middle of a disc's image is off because the lens distorts the disc itself.

    camera: `Camera`; points (3, n) mm that project onto the ellipses' centres without the lens, and unit normals
    (3, n) of the board, camera frame; radius in mm. Of the distortion D with derivative J and an ellipse of the
    conjugate half axes d_k about c, to second order: the mean of D over the distorted disc is
    D(c) + sum_k (D''(d_k, d_k) / 8 + J d_k (d_k . grad ln det J) / 4). A circle that is fitted to the disc's edge
    moves by the same.
    """
    flat = points[:2] / points[2]
    depth = points[2]
    middle = camera.distort(flat)
    total = np.zeros_like(flat)
    for axis in _tangents(normals):
        half = radius / depth * (axis[:2] - flat * axis[2])
        outer, area_above = _bent(camera, flat + half)
        inner, area_below = _bent(camera, flat - half)
        curvature = (outer + inner - 2 * middle) / 8
        growth = (outer - inner) * np.log(area_above / area_below) / 16
        total += curvature + growth
    focal = np.array([[camera.fx], [camera.fy]])
    return focal * total


def _tangents(normals):
    """Two unit vectors (3, n) across unit normals (3, n) and one another."""
    helper_axis = np.where(np.abs(normals[:1]) < 0.7, [[1.0], [0.0], [0.0]], [[0.0], [1.0], [0.0]])
    first = np.cross(normals, helper_axis, axis=0)
    first /= np.linalg.norm(first, axis=0)
    return first, np.cross(normals, first, axis=0)


def _bent(camera, flat):
    """Distorted points (2, n) and the determinant (n,) of the distortion there."""
    bent, slope, _ = camera.distort_rows(flat)
    return bent, slope[0, 0] * slope[1, 1] - slope[0, 1] * slope[1, 0]
