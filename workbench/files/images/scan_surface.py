"""Surface normals that a scanner's effects need: from the balls in the scan, found once without those effects."""

from dataclasses import replace

import numpy as np

from sensors.ball.result import NOT_ON_BALL
from sensors.ball.search import find_balls
from sensors.scanner.model import Scanner


def reconstructed(scanner: Scanner, pixels, steps, covariates, radii) -> tuple[np.ndarray, str]:
    """Points (3, n) mm of a scan, as `Scanner.reconstruct`, and what is to be said of them, "" for nothing.

    Where effects ask for the surface's normals or the ball, both come from balls of `radii` mm (None:
    not known) that are found in the points without those effects: a shift of 0.1 mm turns the
    normal of a ball of 10 mm by 0.6 degrees. Points that lie on no ball stay as they were.
    """
    asking = [effect.title for effect, _ in scanner.effects if effect.surface]
    if not asking:
        local = scanner.reconstruct(pixels, steps, covariates)
        return local, ""
    scanner_without_effects = replace(
        scanner, effects=tuple(row for row in scanner.effects if not row[0].surface)
    )
    points = scanner_without_effects.reconstruct(pixels, steps, covariates)
    normals, ball = on_balls(points, radii, steps)
    message = f"{', '.join(asking)} taken off the {np.count_nonzero(ball)} of {len(ball)} points that lie on balls"
    local = scanner.reconstruct(pixels, steps, covariates, normals, ball)
    return local, message


def on_balls(points: np.ndarray, radii, steps=None) -> tuple[np.ndarray, np.ndarray]:
    """Outward unit normals (3, n), nan off the balls, and the number (n,) of the ball, 0 for none.

    steps (n,): light plane of each point.
    """
    normals = np.full(points.shape, np.nan)
    ball = np.zeros(points.shape[1], int)
    seen = np.flatnonzero(np.isfinite(points).all(0))
    steps_of_points = None if steps is None else np.asarray(steps)[seen]
    if len(seen):
        found = find_balls(points[:, seen], radii, free=True, stripe=steps_of_points)
    else:
        found = []
    for number, fit in enumerate(found, start=1):
        is_on_ball = seen[fit.reason != NOT_ON_BALL]
        outward = points[:, is_on_ball] - fit.centre[:, None]
        normals[:, is_on_ball] = outward / np.linalg.norm(outward, axis=0)
        ball[is_on_ball] = number
    return normals, ball
