"""Seen part of a ball, and thickness of the shell that holds its points."""

import numpy as np

_SECTORS = 24
# Points enough for the extent of a cap.
_ENOUGH = 20_000


def seen_extent(normal, place, view):
    """Half angle (rad) of the cone about the mean direction with 99 % of the points, and the share seen all round.

    normal (3, n) outward unit normals, `place` (m,) numbers of the points used; view: directions of sight or None.
    """
    mean = _unit(normal.take(place, 1).sum(1))
    axis = mean if view is None else _unit(-view.mean(1))
    sample = normal.take(place[:: len(place) // _ENOUGH + 1], 1)
    half_angle = _angle_of_share(mean @ sample, 0.99)
    # the farthest point from the axis in every sector about it
    sectors, sector = _sectors_about(axis, sample)
    smallest_cosine = np.ones(sectors)
    np.minimum.at(smallest_cosine, sector, np.clip(axis @ sample, -1, 1))
    reach = np.arccos(smallest_cosine)
    is_seen = reach > 0.7 * np.quantile(reach, 0.8)
    return half_angle, float(is_seen.mean())


def _angle_of_share(cosine: np.ndarray, share: float) -> float:
    """Angle, rad, within which a share of those with a cosine (n,) lie; their quantile, linear between two of them."""
    place = (1 - share) * (len(cosine) - 1)
    last = len(cosine) - 1
    low = int(place)
    ordered = np.partition(cosine, (low, min(low + 1, last)))
    lower_angle, upper_angle = np.arccos(np.clip(ordered[[min(low + 1, last), low]], -1, 1))
    return float(upper_angle + (place - low) * (lower_angle - upper_angle))


def _unit(direction):
    """The vector with length 1."""
    return direction / max(np.linalg.norm(direction), 1e-300)


def _sectors_about(axis, directions):
    """Number of sectors about an axis, and the sector (n,) of each direction; in a plane the two sides."""
    perpendicular = np.linalg.svd(axis[None])[2][1:] @ directions
    if len(directions) == 3:
        sectors = _SECTORS
        azimuth = np.arctan2(perpendicular[1], perpendicular[0])
    else:
        sectors = 2
        azimuth = np.pi * (perpendicular[0] < 0)
    sector = np.floor(azimuth * (sectors / (2 * np.pi))).astype(int)
    sector[sector < 0] += sectors
    return sectors, sector


def shell(residual: np.ndarray, share: float) -> float:
    """Width, mm, of the thinnest shell that holds a share of distances (n,) from the surface."""
    ordered = np.sort(residual)
    count = max(int(np.ceil(share * len(ordered))), 1)
    return float((ordered[count - 1 :] - ordered[: len(ordered) - count + 1]).min())
