"""How much of a ball was seen, and how thin the shell is that holds its points."""

import numpy as np

_SECTORS = 24
# Points enough for the extent of a cap.
_ENOUGH = 20_000


def seen_extent(normal, used, view):
    """Half angle (rad) of the cone about the mean direction with 99 % of the points, and the share seen all round.

    normal (d, n) outward unit normals, of points that are `used` (n,); view: directions of sight or None.
    """
    mean = _unit(normal @ used.astype(float))
    axis = mean if view is None else _unit(-view.mean(1))
    place = np.flatnonzero(used)
    some = normal[:, place[:: len(place) // _ENOUGH + 1]]
    from_mean = np.arccos(np.clip(mean @ some, -1, 1))
    half_angle = float(np.quantile(from_mean, 0.99))
    # the farthest point from the axis in every sector about it
    from_axis = np.arccos(np.clip(axis @ some, -1, 1))
    sectors, sector = _sectors_about(axis, some)
    reach = np.zeros(sectors)
    np.maximum.at(reach, sector, from_axis)
    is_seen = reach > 0.7 * np.quantile(reach, 0.8)
    return half_angle, float(is_seen.mean())


def _unit(direction):
    """The vector with length 1."""
    return direction / max(np.linalg.norm(direction), 1e-300)


def _sectors_about(axis, directions):
    """Number of sectors about an axis, and the sector (n,) of each direction; in a plane the two sides."""
    across = np.linalg.svd(axis[None])[2][1:] @ directions
    if len(directions) == 3:
        sectors, turn = _SECTORS, np.arctan2(across[1], across[0])
    else:
        sectors, turn = 2, np.pi * (across[0] < 0)
    share = turn / (2 * np.pi) % 1
    return sectors, (share * sectors).astype(int) % sectors


def shell(residual: np.ndarray, share: float) -> float:
    """Width, mm, of the thinnest shell that holds a share of distances (n,) from the surface."""
    ordered = np.sort(residual)
    held = max(int(np.ceil(share * len(ordered))), 1)
    return float((ordered[held - 1 :] - ordered[: len(ordered) - held + 1]).min())
