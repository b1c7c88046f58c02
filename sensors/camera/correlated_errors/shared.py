"""Errors that the corners of all images share: of the board's print by corner, of the lens by place.

Neither averages out with more images as noise does. Both are tested; the first goes into the
sigmas as a component of variance of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensors.camera.checks import group_subset
from sensors.camera.corners import Corners
from workbench.core.effect import Effect
from workbench.core.least_squares.bundle import BundleFit
from workbench.core.least_squares.linear_algebra import (
    inverse_positive,
    pseudo_inverse,
    solve_positive,
)
from workbench.core.model import Model

UNLIKELY = 0.01
"""Probability below which a difference is not put down to chance: one good calibration in a hundred is remarked on."""
_FIRST_POSES = (
    8  # board poses that tell well enough how many numbers the unknowns take of the corners' means
)
_CELLS = (8, 6)
_MIN_CORNERS = 4  # corners of a cell that make a mean


@dataclass(frozen=True)
class PrintErrors:
    """In-plane places of the board's corners, off by the same at all board poses.

    `sigma_mm` of one coordinate, 0 where noise explains the corners' means; `p_value` of these means
    under noise alone; `covariance` (D, D) of the bundle's dense unknowns with these errors in it,
    nowhere below that of the bundle.
    """

    sigma_mm: float
    p_value: float
    covariance: np.ndarray

    @property
    def significant(self) -> bool:
        return self.p_value < UNLIKELY

    @property
    def sentence(self) -> str:
        return (
            f"the board's corners are off by the same in all images: {1000 * self.sigma_mm:.2g} um (1 sigma of a "
            "coordinate) beyond noise, by its print or by what the lens model leaves of them; more images do not "
            "average that out, and it is in the sigmas"
        )


def print_errors(chain: Corners, fit: BundleFit, effects: Sequence[Effect]) -> PrintErrors:
    """Component of variance of the board's corners, from the bundle's residuals.

    An F test of two numbers a corner against what is left without them, by the traces of the quadratic
    form (Searle, Casella & McCulloch, Variance Components, 1992, ch. 5): q is what the corners' means
    take of the weighted squares, whose expectation is sigma^2 d + s^2 h. The errors e_c then move the
    estimate by -K sum C_c e_c (K covariance under unit noise, C_c the corner's share of the normal
    equations with poses eliminated), so its covariance is sigma^2 K + s^2 K (sum C_c C_c') K.
    """
    corner = chain.labels["corner"]
    root = np.sqrt(fit.weights[0]) / chain.sigma
    model = Model(chain, tuple(effects))
    rows = model.evaluate(fit.parameters).rows("target", np.array([0, 1])) * root
    residual = fit.residual[0] * root
    corner_blocks = _by_corner(
        np.stack([(rows[a] * rows[b]).sum(0) for a in (0, 1) for b in (0, 1)]), corner
    ).reshape(-1, 2, 2)
    pull = _by_corner((rows * residual).sum(1), corner)
    seen = np.linalg.det(corner_blocks) > 0
    reduction = float(
        (pull[seen] * solve_positive(corner_blocks[seen], pull[seen][..., None])[..., 0]).sum()
    )
    trace = float(np.trace(corner_blocks[seen], axis1=1, axis2=2).sum())
    sums = _Sums(float((residual**2).sum()), reduction, trace, int(seen.sum()))
    tested = _tested(fit, sums, _share(chain, fit, effects, _FIRST_POSES))
    return (
        _tested(fit, sums, _share(chain, fit, effects, len(chain.poses)))
        if tested.significant
        else tested
    )


@dataclass(frozen=True)
class _Sums:
    """Weighted squares of all residuals, what the corners' means take of them, the normal matrices' traces, corners."""

    squares: float
    taken: float
    trace: float
    corners: int


def _tested(fit, sums, part):
    """The component of variance, its test, and the covariance with it."""
    from scipy.special import fdtrc

    degrees = max(2 * sums.corners - part.degrees, 1.0)
    residual_degrees = max(fit.degrees - degrees, 1.0)
    noise = max(sums.squares - sums.taken, 1e-300) / residual_degrees
    variance = max(sums.taken - degrees * noise, 0.0) / max(sums.trace - part.trace, 1e-300)
    p_value = float(fdtrc(degrees, residual_degrees, sums.taken / degrees / noise))
    if p_value >= UNLIKELY:
        return PrintErrors(float(np.sqrt(variance)), p_value, fit.covariance)
    unit = fit.covariance / fit.sigma_scale**2
    tested = (
        fit.covariance * noise / (sums.squares / fit.degrees) + variance * unit @ part.spread @ unit
    )
    wider = np.sqrt(np.maximum(np.diag(fit.covariance) / np.diag(tested), 1))
    return PrintErrors(float(np.sqrt(variance)), p_value, tested * np.outer(wider, wider))


@dataclass(frozen=True)
class _Share:
    """Part of the corners' means that poses and camera absorb: `degrees`, `trace`; `spread` (D, D) is sum C_c C_c'."""

    degrees: float
    trace: float
    spread: np.ndarray


def _share(chain, fit, effects, max_poses: int) -> _Share:
    """From `max_poses` board poses where they are more: they are much alike."""
    count = len(chain.poses)
    groups = np.unique(np.linspace(0, count - 1, max_poses).astype(int))
    chosen = chain
    weights = fit.weights[0]
    if len(groups) < count:
        weights = weights[np.isin(chain.labels["placement"], groups)]
        chosen = group_subset(chain, groups)
    corner_blocks, cross, normal, corners = _blocks(
        chosen, fit, effects, np.sqrt(weights) / chosen.sigma
    )
    grow = count / len(groups)
    is_usable = np.linalg.det(corners) > 0
    inverse = inverse_positive(np.where(is_usable[:, None, None], corners, np.eye(2)))
    inverse_own = solve_positive(
        corner_blocks[0], np.broadcast_to(np.eye(6), corner_blocks[0].shape)
    )
    by_pose = (
        corner_blocks[1].transpose(0, 1, 3, 2) @ inverse_own[:, None] @ corner_blocks[1]
    ).sum(0)
    total = by_pose + cross.transpose(0, 2, 1) @ pseudo_inverse(normal) @ cross
    degrees = float(np.einsum("ctu,cut->", total[is_usable], inverse[is_usable]))
    return _Share(
        degrees,
        grow * float(np.trace(total, axis1=1, axis2=2).sum()),
        grow**2 * np.einsum("cpt,cqt->pq", cross, cross),
    )


def _blocks(chain, fit, effects, root):
    """(poses (G, 6, 6), their products with corners (G, C, 6, 2)), C_c (C, D, 2), normal (D, D), corners (C, 2, 2)."""
    model = Model(chain, tuple(effects))
    evaluation = model.evaluate(fit.parameters)
    free = fit.parameters.mask
    shared = (
        model.fill_rows(
            evaluation, fit.parameters, np.empty((free.sum(), *evaluation.residual.shape))
        )
        * root
    )
    pose = evaluation.family_rows("placement") * root
    target = evaluation.rows("target", np.array([0, 1])) * root
    group = chain.labels["placement"]
    corner = chain.labels["corner"]
    scale = fit.table.typical[: len(shared)]
    shared = shared * scale[:, None, None]
    pose_blocks = _sum(np.einsum("amn,bmn->nab", pose, pose), group)
    mix = solve_positive(pose_blocks, _sum(np.einsum("amn,bmn->nab", pose, shared), group))
    reduced = shared - np.einsum("nkp,kmn->pmn", mix[group], pose)
    count = corner.max() + 1
    at_pose = _sum(
        np.einsum("amn,bmn->nab", pose, target), group * count + corner, len(pose_blocks) * count
    )
    cross = _sum(np.einsum("amn,bmn->nab", reduced, target), corner)
    corners = _sum(np.einsum("amn,bmn->nab", target, target), corner)
    flat = reduced.reshape(len(reduced), -1)
    normal = flat @ flat.T
    return (
        (pose_blocks, at_pose.reshape(len(pose_blocks), count, 6, 2)),
        cross / scale[:, None],
        normal / np.outer(scale, scale),
        corners,
    )


def _sum(blocks, group, count=None):
    """(count, a, b) sums of blocks (n, a, b) by group (n,)."""
    if count is None:
        count = int(group.max()) + 1
    sums = np.zeros((count, *blocks.shape[1:]))
    order = np.argsort(group, kind="stable")
    sorted_group = group[order]
    start = np.flatnonzero(np.diff(sorted_group, prepend=-1))
    sums[sorted_group[start]] = np.add.reduceat(blocks[order], start, axis=0)
    return sums


def _by_corner(rows, corner):
    """(C, k) sums of rows (k, n)."""
    return np.stack([np.bincount(corner, row) for row in rows], axis=-1)


@dataclass(frozen=True)
class LensMap:
    """Mean residual by place in the image: `value` (2, rows, columns) px, nan where hardly any corner lies;
    `rms_px` of these means beyond what noise makes, and the `p_value` of all under noise.
    """

    value: np.ndarray
    rms_px: float
    p_value: float

    @property
    def significant(self) -> bool:
        return self.p_value < UNLIKELY

    @property
    def sentence(self) -> str:
        worst = np.nanmax(np.hypot(*self.value))
        return (
            f"the lens is not of the model fitted: corners at the same place of the image are off alike, by "
            f"{self.rms_px:.2g} px RMS and {worst:.2g} px at most in means over its {self.value[0].size} cells; try "
            "another model of the lens (`--model auto` compares them)"
        )


def lens_map(chain: Corners, fit: BundleFit, printed: PrintErrors) -> LensMap:
    """Errors of corners at the same place of the image; first less their own means, where these differ."""
    from scipy.special import fdtrc

    residual = fit.residual[0]
    corner = chain.labels["corner"]
    degrees_used = 0
    if printed.significant:
        count = np.maximum(np.bincount(corner), 1)
        residual = residual - np.stack(
            [(np.bincount(corner, row) / count)[corner] for row in residual]
        )
        degrees_used = 2 * len(np.unique(corner))
    place = [
        np.clip(((row + 0.5) * count / size).astype(int), 0, count - 1)
        for row, count, size in zip(chain.pixels, _CELLS, chain.camera.size)
    ]
    cell = place[1] * _CELLS[0] + place[0]
    count = np.bincount(cell, minlength=_CELLS[0] * _CELLS[1])
    has_enough = count >= _MIN_CORNERS
    weight = fit.weights[0]
    total = np.maximum(np.bincount(cell, weight, len(count)), 1e-300)
    means = np.stack([np.bincount(cell, weight * row, len(count)) for row in residual]) / total
    squares_between = float((total * (means**2).sum(0))[has_enough].sum())
    squares = float((weight * (residual**2).sum(0)).sum())
    degrees = (
        2 * int(has_enough.sum()),
        max(fit.degrees - degrees_used - 2 * int(has_enough.sum()), 1),
    )
    noise = max(squares - squares_between, 0.0) / degrees[1]
    rms = np.sqrt(
        2
        * max(squares_between - degrees[0] * noise, 0)
        / max(2 * float(total[has_enough].sum()), 1e-300)
    )
    p_value = float(fdtrc(*degrees, squares_between / max(degrees[0], 1) / max(noise, 1e-300)))
    return LensMap(
        np.where(has_enough, means, np.nan).reshape(2, *_CELLS[::-1]), float(rms), p_value
    )
