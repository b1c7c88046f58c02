"""The bundle of a camera's corners: first goes what is no picture of the board, last what the others contradict."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sensors.camera import Camera
from sensors.camera_checks import fit_free, group_subset
from sensors.camera_start import FEW, check_views, corner_chain, placement_groups, started, thinned
from sensors.corners import Corners
from workbench.core.bundle import CHI_SQUARE_MEDIAN, BundleFit
from workbench.core.effect import Effect
from workbench.core.errors import InputError
from workbench.core.model import Model
from workbench.core.rigid import rotation_matrix

if TYPE_CHECKING:
    from sensors.boards import Board, Rejected, View

FEWEST = 3
"""Placements: fewer do not determine a camera's focal lengths, principal point and distortion."""
LEAST = 4
"""Corners, not on one line, that a placement's pose needs."""
FAR = 6.0
"""A corner is a blunder where it is more than this many times as far off as half of all corners are, about 7 sigmas."""
# As long as the camera is not known, where no pose explains the corners to this share of the board's image: no lens
# bends a board's image by as much.
_NO_PLANE = 0.15
_FLAT = 1e-3  # of the board's extent along its corners: they lie on a line where across they extend less
_WITHIN = 0.05
_FIRST_STEPS = 2  # of a first fit, which only has to come near
_STILL = 1.2  # costs' ratio from step to step above which it has not come near


@dataclass(frozen=True)
class Adjusted:
    """Fit of a camera: the `chain` at its solution, with the sigmas found, `views` in it and those `rejected`;
    `left_out`: blunders among the corners of each view that was kept, by picture.
    """

    chain: Corners
    fit: BundleFit
    views: tuple["View", ...]
    rejected: tuple["Rejected", ...]
    left_out: dict[str, int]


def adjusted(views: Sequence["View"], board: "Board", size: tuple[int, int], model: str, effects: Sequence[Effect],
             loss: str) -> Adjusted:  # fmt: skip
    """Start, bundle, and bundle again without the blunders. InputError where three placements do not remain."""
    _enough(views, (), board)
    check_views(views, board, size)
    usable, few = _usable(views, board)
    _enough(usable, few, board)
    chain, kept, wrong = _started(usable, few, board, size, model)
    rejected, left_out = [*few, *wrong], dict.fromkeys((view.image for view in kept), 0)
    while True:
        stated = chain.sigma
        chain, fit = adjust(chain, effects, loss)
        far = _far_off(chain, fit.residual[0])
        if not far.any():
            return Adjusted(chain, fit, tuple(kept), tuple(rejected), {k: n for k, n in left_out.items() if n})
        counts = np.bincount(chain.labels["view"], far, len(kept))
        bad = counts > np.bincount(chain.labels["view"], minlength=len(kept)) / 2
        rejected += [_rejected(kept[k], f"most of its corners are more than {FAR:g} times as far off as half of all "
                                        "corners are") for k in np.flatnonzero(bad)]
        if not bad.any():  # single corners are judged where no whole picture spoils the fit any more
            for view, count in zip(kept, counts):
                left_out[view.image] += int(count)
        chain, kept = _less(replace(chain, sigma=stated), kept, bad, far if not bad.any() else np.zeros_like(far))
        _enough(kept, rejected, board)


def _enough(views, rejected, board):
    found = len(placement_groups(views)[1])
    if found >= FEWEST:
        return
    if len(rejected) > found:
        raise InputError(f"camera: expected pictures of a {board.title}, each placement with one pose of it, found "
                         f"{len(rejected)} of {len(rejected) + len(views)} that are none ({rejected[0]}); correct the "
                         "board's columns and rows, or the placements")
    raise InputError(f"camera: expected the board at {FEWEST} or more placements, found {found}; take 15 to 20 "
                     "pictures, the board tilted by 20 to 45 degrees, out to every corner")


def _rejected(view, why):
    from sensors.boards import Rejected

    return Rejected(view.image, why, view.placement)


def _usable(views, board):
    """Views with corners enough for a pose, and those without."""
    kept, few = [], []
    for view, flat in zip(views, _on_a_line(views, board)):
        if len(view.index) < LEAST:
            few.append(_rejected(view, f"{len(view.index)} corners: a pose needs {LEAST} or more"))
        elif flat:
            few.append(_rejected(view, "its corners lie on one line: they do not tell a pose"))
        else:
            kept.append(view)
    return kept, few


def _on_a_line(views, board):
    """(V,) True for views whose corners lie on one line of the board."""
    count = np.array([len(view.index) for view in views])
    view = np.repeat(np.arange(len(views)), count)
    places = board.points[:2, np.concatenate([view.index for view in views])]
    middle = np.stack([np.bincount(view, row, len(views)) for row in places]) / np.maximum(count, 1)
    x, y = places - middle[:, view]
    xx, yy, xy = (np.bincount(view, row, len(views)) for row in (x * x, y * y, x * y))
    # the product of the two variances along and across the corners, over the square of the first, which is the larger
    return xx * yy - xy * xy < _FLAT**2 * (xx + yy) ** 2


def _started(views, few, board, size, model):
    """The chain at its start, the views in it, and those whose corners are no picture of this board."""
    kept, rejected = list(views), []
    while True:
        chain = started(corner_chain(kept, board, size, model))
        share, behind = _misfit(chain), _from_behind(chain.poses)
        bad = share > max(_NO_PLANE, share.max() / 2)
        if not (bad | behind).any():
            return chain, kept, rejected
        group = placement_groups(kept)[0]
        rejected += [_rejected(view, f"no pose of the {board.title} explains these corners: they are off by "
                                     f"{100 * share[k]:.0f} % of the size of its image" if bad[k] else
                                     "its corners are those of a board seen from behind, unlike the others'")
                     for view, k in zip(kept, group) if bad[k] or behind[k]]  # fmt: skip
        kept = [view for view, k in zip(kept, group) if not bad[k] and not behind[k]]
        _enough(kept, [*few, *rejected], board)


def _misfit(chain):
    """(G,) RMS of some residuals at the start over the board's extent in the picture."""
    chain = chain.at(thinned(chain))
    group, few = chain.labels["placement"], len(chain.poses)
    residual = chain.evaluate(chain.camera.values, {}).residual
    counts = np.bincount(group, minlength=few)
    middle = np.stack([np.bincount(group, row, few) / counts for row in chain.pixels])
    extent = np.bincount(group, ((chain.pixels - middle[:, group]) ** 2).sum(0), few)
    return np.sqrt(np.bincount(group, (residual**2).sum(0), few) / np.maximum(extent, 1e-300))


def _from_behind(poses):
    """(G,) True where the board shows another side than in most pictures: corners numbered in mirror image."""
    away = (rotation_matrix(poses[:, 3:])[:, :, 2] * poses[:, :3]).sum(1) > 0
    return away != (2 * away.sum() > len(away))


def _far_off(chain, residual):
    """(n,) True for blunders; what is well within its stated sigma is none, however good the others are."""
    distance = np.sqrt(((residual / chain.sigma) ** 2).sum(0))
    return distance > FAR * max(np.median(distance), _WITHIN)


def _less(chain, kept, bad, far):
    """Chain and views without the views `bad` (V,) and the corners `far` (n,), numbered anew."""
    names = placement_groups(kept)[1]
    chain = chain.at(~(bad[chain.labels["view"]] | far))
    chain = replace(chain, labels={**chain.labels, "view": (np.cumsum(~bad) - 1)[chain.labels["view"]]})
    kept = [view for view, out in zip(kept, bad) if not out]
    still = set(placement_groups(kept)[1])
    return group_subset(chain, np.array([k for k, name in enumerate(names) if name in still], int)), kept


def adjust(chain: Corners, effects: Sequence[Effect], loss: str = "huber") -> tuple[Corners, BundleFit]:
    """Bundle over camera, effects and poses from the chain's start; the chain at the solution, and the fit.

    A first fit, to a few corners of each placement where they are many, weighs all corners alike. What
    its residuals exceed the corners' stated sigmas by (print, blur, lens) is the same for all corners
    and is added to their variances for the last fit: a corner of high contrast is not to be believed
    to a hundredth of a pixel because noise alone would allow it.
    """
    many = chain.pixels.shape[1] > 3 * FEW * len(chain.poses)
    first = replace(chain.at(thinned(chain)) if many else chain, sigma=np.full((2, 1), np.median(chain.sigma)))
    table = Model(first, tuple(effects)).parameters
    fit = fit_free(first, effects, table.only(np.ones(len(table), bool)), loss, _FIRST_STEPS)
    if not fit.converged and fit.history[-2] > _STILL * fit.history[-1]:
        fit = fit_free(replace(first, poses=fit.values["placement"]), effects, fit.parameters, loss)
    chain = replace(chain, poses=fit.values["placement"], sigma=np.hypot(chain.sigma, _excess(fit, chain.sigma)))
    fit = fit_free(chain, effects, fit.parameters, loss)
    camera = Camera.of(fit.parameters.values[: len(chain.parameters)], chain.camera.size)
    return chain.moved(camera, fit.values["placement"]), fit


def _excess(fit, stated):
    """px of each coordinate beyond the stated sigmas, from medians: blunders do not raise it."""
    squares = (fit.residual[0] ** 2).sum(0)
    variance = np.median(squares) / CHI_SQUARE_MEDIAN[2] * fit.residual[0].size / fit.degrees
    return np.sqrt(max(variance - np.median(stated) ** 2, 0.0))
