"""The bundle of a camera's corners: first goes what is no image of the board, last what the others contradict."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sensors.camera.board_orientation import (
    distinguishes_rotations,
    needs_quarter_rotation,
    rotate_views,
)
from sensors.camera.checks import fit_free, group_subset
from sensors.camera.corners import Corners
from sensors.camera.model import Camera
from sensors.camera.start import (
    START_CORNERS,
    check_views,
    corner_chain,
    first_poses,
    homographies,
    placement_groups,
    spread,
    started,
    thinned,
    usual_focal,
)
from sensors.camera.suspect_views import (
    BLUNDER_RATIO,
    find_blunders,
    is_behind_board,
    is_collinear,
    repeated_views,
    smoothness_misfit,
)
from workbench.core.effect import Effect
from workbench.core.errors import InputError
from workbench.core.least_squares.bundle import CHI_SQUARE_MEDIAN, BundleFit
from workbench.core.model import Model
from workbench.core.rigid import rotation_matrix

if TYPE_CHECKING:
    from sensors.boards.board import Board
    from sensors.boards.detection import Rejected, View

FEWEST = 3
"""Board poses: fewer do not determine a camera's focal lengths, principal point and distortion."""
MIN_CORNERS = 4
"""Corners, not on one line, that a board pose needs."""
PARALLEL = np.deg2rad(10)
"""Boards that are tilted against each other by less tell little of a focal length."""
# As long as the camera is not known: corners that no pose and no smooth warp of the board explain to this share of
# its image. A wide lens bends a board's image by more than a pinhole allows, but as a whole.
_NO_PLANE = 0.15
_TURNINGS = 4
_CIRCLE_FITS = 3  # of boards of circles: what the lens does to a circle is constant within a fit
_FIRST_STEPS = 2  # of a first fit, which only has to come near
_MAX_COST_RATIO = 1.2  # costs' ratio from step to step above which it has not come near


@dataclass(frozen=True)
class Adjusted:
    """Fit of a camera: the `chain` at its solution, with the sigmas found, `views` in it and those `rejected`;
    `left_out`: blunders among the corners of each view that was kept, by image.
    """

    chain: Corners
    fit: BundleFit
    views: tuple["View", ...]
    rejected: tuple["Rejected", ...]
    left_out: dict[str, int]


def adjusted(
    views: Sequence["View"],
    board: "Board",
    size: tuple[int, int],
    model: str,
    effects: Sequence[Effect],
    loss: str,
) -> Adjusted:
    """Start, bundle, and bundle again without the blunders. InputError where three board poses do not remain."""
    _enough(views, (), board)
    check_views(views, board, size)
    usable, without_pose = _usable(views, board)
    usable, without_pose = _unique_views(usable, without_pose)
    _enough(usable, without_pose, board)
    chain, usable_views, wrong = _started(usable, without_pose, board, size, model)
    if distinguishes_rotations(board, effects):
        chain, usable_views = _with_rotated_boards(chain, usable_views, board, model, effects, loss)
    rejected = [*without_pose, *wrong]
    left_out = dict.fromkeys((view.image for view in usable_views), 0)
    while True:
        stated = chain.sigma
        chain, fit = _best(chain, effects, loss)
        is_blunder = find_blunders(chain, fit.residual[0])
        if not is_blunder.any():
            return Adjusted(
                chain,
                fit,
                tuple(usable_views),
                tuple(rejected),
                {k: n for k, n in left_out.items() if n},
            )
        counts = np.bincount(chain.labels["view"], is_blunder, len(usable_views))
        bad = counts > np.bincount(chain.labels["view"], minlength=len(usable_views)) / 2
        rejected += [
            _rejected(
                usable_views[k],
                f"most of its corners are more than {BLUNDER_RATIO:g} times as far off as half of all "
                "corners are",
            )
            for k in np.flatnonzero(bad)
        ]
        if not bad.any():  # single corners are judged where no whole image spoils the fit any more
            for view, count in zip(usable_views, counts):
                left_out[view.image] += int(count)
        chain, usable_views = _without_views_and_corners(
            replace(chain, sigma=stated),
            usable_views,
            bad,
            is_blunder if not bad.any() else np.zeros_like(is_blunder),
        )
        _enough(usable_views, rejected, board)


def _enough(views, rejected, board):
    found = len(placement_groups(views)[1])
    if found >= FEWEST:
        return
    if len(rejected) > found:
        raise InputError(
            f"camera: expected images of a {board.title}, in one pose for each value of `placement`, found "
            f"{len(rejected)} of {len(rejected) + len(views)} that are none ({rejected[0]}); correct the "
            "board's columns and rows, or the board poses"
        )
    raise InputError(
        f"camera: expected the board in {FEWEST} or more board poses, found {found}; take 15 to 20 "
        "images, the board tilted by 20 to 45 degrees, out to every corner"
    )


def _rejected(view, why):
    from sensors.boards.detection import Rejected

    return Rejected(view.image, why, view.placement)


def _unique_views(views, rejected):
    """Views without those whose corners another has: counted twice, one image would pass for two."""
    unique = []
    duplicates = []
    for view, earlier in zip(views, repeated_views(views)):
        if earlier is None:
            unique.append(view)
        else:
            reason = f"the same corners as {views[earlier].image}, which would count twice"
            duplicates.append(_rejected(view, reason))
    return unique, [*rejected, *duplicates]


def _usable(views, board):
    """Views with corners enough for a pose, and those without."""
    usable = []
    rejected = []
    for view, flat in zip(views, is_collinear(views, board)):
        if len(view.index) < MIN_CORNERS:
            rejected.append(
                _rejected(view, f"{len(view.index)} corners: a pose needs {MIN_CORNERS} or more")
            )
        elif flat:
            rejected.append(_rejected(view, "its corners lie on one line: they do not tell a pose"))
        else:
            usable.append(view)
    return usable, rejected


def _started(views, rejected_before, board, size, model):
    """The chain at its start, the views in it, and those whose corners are no image of this board."""
    usable = list(views)
    rejected = []
    while True:
        chain = started(corner_chain(usable, board, size, model))
        share = _misfit(chain)
        is_behind = is_behind_board(chain.poses)
        bad = share > _NO_PLANE
        if bad.any():
            share = np.minimum(share, smoothness_misfit(chain))
            bad = share > max(_NO_PLANE, share.max() / 2)
        if not (bad | is_behind).any():
            return chain, usable, rejected
        group = placement_groups(usable)[0]
        rejected += [
            _rejected(
                view,
                f"no pose of the {board.title} explains these corners: they are off by "
                f"{100 * share[k]:.0f} % of the size of its image"
                if bad[k]
                else "its corners are those of a board seen from behind, unlike the others'",
            )
            for view, k in zip(usable, group)
            if bad[k] or is_behind[k]
        ]
        usable = [view for view, k in zip(usable, group) if not bad[k] and not is_behind[k]]
        _enough(usable, [*rejected_before, *rejected], board)


def _misfit(chain):
    """(G,) RMS of some residuals at the start over the board's extent in the image."""
    chain = chain.at(thinned(chain))
    group = chain.labels["placement"]
    group_count = len(chain.poses)
    residual = chain.evaluate(chain.camera.values, {}).residual
    counts = np.bincount(group, minlength=group_count)
    middle = np.stack([np.bincount(group, row, group_count) / counts for row in chain.pixels])
    extent = np.bincount(group, ((chain.pixels - middle[:, group]) ** 2).sum(0), group_count)
    return np.sqrt(
        np.bincount(group, (residual**2).sum(0), group_count) / np.maximum(extent, 1e-300)
    )


def _with_rotated_boards(chain, views, board, model, effects, loss):
    """Chain, near its solution, and views with the board of each pose rotated so that it fits its bow."""
    for _ in range(_TURNINGS):
        solved, fit = _best(chain, effects, loss)
        other = needs_quarter_rotation(solved, fit, effects)
        chain = replace(solved, sigma=chain.sigma)
        if not other.any():
            break
        chain, views = rotate_views(chain, views, board, other, model)
    return chain, views


def _without_views_and_corners(chain, views, bad, is_blunder):
    """Chain and views without the views `bad` (V,) and the corners `is_blunder` (n,), renumbered."""
    names = placement_groups(views)[1]
    chain = chain.at(~(bad[chain.labels["view"]] | is_blunder))
    chain = replace(
        chain, labels={**chain.labels, "view": (np.cumsum(~bad) - 1)[chain.labels["view"]]}
    )
    views = [view for view, out in zip(views, bad) if not out]
    remaining = set(placement_groups(views)[1])
    return group_subset(
        chain, np.array([k for k, name in enumerate(names) if name in remaining], int)
    ), views


def _best(chain, effects, loss):
    """As `adjust`; where boards are parallel, so that they determine no start, also from a usual lens."""
    found = adjust(chain, effects, loss)
    if tilts(found[0].poses) > PARALLEL:
        return found
    chosen, new = spread(chain)
    focal = usual_focal(chain.camera)
    usual = Camera.of(
        np.r_[focal, focal, chain.camera.values[2:4], 0 * chain.camera.values[4:]],
        chain.camera.size,
    )
    poses = first_poses(homographies(chain, chosen, new), usual.matrix)
    other = adjust(chain.moved(usual, poses), effects, loss)
    return min(
        found, other, key=lambda candidate: np.median((candidate[1].residual[0] ** 2).sum(0))
    )


def tilts(poses: np.ndarray) -> float:
    """rad, the largest angle between two board poses."""
    normals = rotation_matrix(poses[:, 3:])[:, :, 2]
    return float(np.arccos(np.clip(normals @ normals.T, -1, 1)).max())


def adjust(
    chain: Corners, effects: Sequence[Effect], loss: str = "huber"
) -> tuple[Corners, BundleFit]:
    """Bundle over camera, effects and poses from the chain's start; the chain at the solution, and the fit.

    A first fit, to a few corners of each board pose where they are many, weighs all corners alike. What
    its residuals exceed the corners' stated sigmas by (print, blur, lens) is the same for all corners
    and is added to their variances for the last fit: a corner of high contrast is not to be believed
    to a hundredth of a pixel because noise alone would allow it.
    """
    many = chain.pixels.shape[1] > 3 * START_CORNERS * len(chain.poses)
    first = replace(
        chain.at(thinned(chain)) if many else chain, sigma=np.full((2, 1), np.median(chain.sigma))
    )
    table = Model(first, tuple(effects)).parameters
    fit = fit_free(first, effects, table.only(np.ones(len(table), bool)), loss, _FIRST_STEPS)
    if not fit.converged and fit.history[-2] > _MAX_COST_RATIO * fit.history[-1]:
        fit = fit_free(replace(first, poses=fit.values["placement"]), effects, fit.parameters, loss)
    chain = replace(
        chain, poses=fit.values["placement"], sigma=np.hypot(chain.sigma, _excess(fit, chain.sigma))
    )
    for _ in range(_CIRCLE_FITS if chain.radius else 1):
        fit = fit_free(chain, effects, fit.parameters, loss)
        camera = Camera.of(fit.parameters.values[: len(chain.parameters)], chain.camera.size)
        chain = chain.moved(camera, fit.values["placement"])
    return chain, fit


def _excess(fit, stated):
    """px of each coordinate beyond the stated sigmas, from medians: blunders do not raise it."""
    squares = (fit.residual[0] ** 2).sum(0)
    variance = np.median(squares) / CHI_SQUARE_MEDIAN[2] * fit.residual[0].size / fit.degrees
    stated_variance = np.median(stated) ** 2
    return np.sqrt(max(variance - stated_variance, 0.0))
