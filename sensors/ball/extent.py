"""How much of a ball was seen, and how thin the shell is that holds its points."""

import numpy as np

_SECTORS = 24
# Points enough for the extent of a cap.
_ENOUGH = 20_000


def seen_extent(normal, view):
    """Half angle (rad) of the cone about the mean direction with 99 % of the points, and the share seen all round."""
    axis = normal.mean(1) if view is None else -view.mean(1)
    mean, axis = (one / max(np.linalg.norm(one), 1e-300) for one in (normal.mean(1), axis))
    some = normal[:, :: normal.shape[1] // _ENOUGH + 1]
    cap = float(np.quantile(np.arccos(np.clip(mean @ some, -1, 1)), 0.99))
    angle = np.arccos(np.clip(axis @ some, -1, 1))
    across = np.linalg.svd(axis[None])[2][1:] @ some
    turn = np.arctan2(across[1], across[0]) if len(some) == 3 else np.pi * (across[0] < 0)
    sectors = _SECTORS if len(some) == 3 else 2
    reach = np.zeros(sectors)
    np.maximum.at(reach, (turn / (2 * np.pi) % 1 * sectors).astype(int) % sectors, angle)
    return cap, float((reach > 0.7 * np.quantile(reach, 0.8)).mean())


def shell(residual: np.ndarray, share: float) -> float:
    """Width, mm, of the thinnest shell that holds a share of distances (n,) from the surface."""
    ordered = np.sort(residual)
    held = max(int(np.ceil(share * len(ordered))), 1)
    return float((ordered[held - 1 :] - ordered[: len(ordered) - held + 1]).min())
