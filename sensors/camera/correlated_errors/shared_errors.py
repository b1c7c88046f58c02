"""Errors that the corners of many images share: their variances, and what they add to a covariance.

Least squares takes the errors of corners as independent. A board whose lines are displaced, or a lens that the camera
model does not describe, displaces corners by the same in all images. Errors of independent corners average out, these
do not. Their variance components are estimated from the images alone, with every board pose free, and propagated
through the estimator: its covariance under the true covariance of the data ("sandwich", White, Econometrica 48 (1980)),
with random effects in place of clusters.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from sensors.camera.correlated_errors.displaced_lines import (
    DisplacedLine,
    PoseTables,
    displaced_lines,
    sums_of_lines,
    with_held_out,
)
from sensors.camera.correlated_errors.random_effects import Reduced, Variances, restricted_variances
from sensors.camera.correlated_errors.shared_effects import SharedEffects
from workbench.core.least_squares.linear_algebra import solve_positive

UNLIKELY = 0.01
"""Probability of a likelihood ratio under independent errors below which shared errors are taken for real."""
_MOST_POINTS, _MOST_POSES = 120, 40  # of which the variances are estimated
_POSE = 6
_LARGE = 0.3  # of the largest RMS displacement: smaller components are not named


@dataclass(frozen=True)
class CornerRows:
    """n corners, divided by their standard deviations (1 px where these are unknown).

    `shared` (F, 2, n) derivatives by the parameters of all images, `by_pose` (6, 2, n) by the board pose of the
    corner's own image, `residual` (2, n), `pose` (n,) label, `effects` the random effects, `point` (n,) label of the
    board point.
    """

    shared: np.ndarray
    by_pose: np.ndarray
    residual: np.ndarray
    pose: np.ndarray
    point: np.ndarray
    effects: SharedEffects

    def pull(self, rows: np.ndarray) -> np.ndarray:
        """(F, q) products of rows (F, 2, n) with the effects."""
        return rows.reshape(len(rows), -1) @ self.effects.rows


@dataclass(frozen=True)
class SharedErrors:
    """`noise` standard deviation of the independent errors, in that of the rows; `effects` (name, 1 sigma, unit, RMS
    displacement) by component; `variances` (q,) of the effects; `p_value` of independent errors alone; `lines` of the
    board that explain most of the errors, where few do."""

    noise: float
    effects: tuple[tuple[str, float, str, float], ...]
    variances: np.ndarray
    p_value: float
    lines: tuple[DisplacedLine, ...] = ()

    @property
    def significant(self) -> bool:
        return self.p_value < UNLIKELY and bool(self.variances.any())

    @property
    def largest(self) -> float:
        """RMS displacement by the largest component, in standard deviations of the rows."""
        return max(size for *_, size in self.effects)

    @property
    def names(self) -> str:
        """The largest components with their standard deviations, and lines of the board that are displaced."""
        largest = self.largest
        large = {}
        for name, sigma, unit, size in self.effects:
            if size > _LARGE * largest:
                large[name] = np.hypot(large.get(name, (0.0, unit))[0], sigma), unit
        words = [f"{name} {value:.2g} {unit}" for name, (value, unit) in large.items()]
        return ", ".join(words + [line.sentence for line in self.lines])

    def covariance(self, influence: np.ndarray) -> np.ndarray:
        """(F, F) of estimates that the effects change by `influence` (F, q)."""
        return (influence * self.variances) @ influence.T


def shared_errors(rows: CornerRows, precision: np.ndarray, sigma_px: float = 1.0) -> SharedErrors:
    """Variance components; precision (F,): of the priors of `rows.shared`, 0 without; sigma_px: unit of the rows."""
    effects = rows.effects
    reduced, tables = _reduced(rows, precision)
    variances = restricted_variances(reduced)
    lines = displaced_lines(reduced, effects.lines, variances.noise)
    tested_lines = with_held_out(lines, effects.lines, replace(tables, sigma=sigma_px))
    return SharedErrors(
        float(np.sqrt(variances.noise)),
        tuple(_sizes(effects, variances)),
        variances.effects[effects.component],
        variances.p_value,
        tested_lines,
    )


def without_poses(rows: CornerRows, precision: np.ndarray) -> np.ndarray:
    """(F, 2, n) derivatives less what the poses, with a prior of this precision (6,), absorb of them."""
    reduced = np.array(rows.shared)
    for k in np.unique(rows.pose):
        is_of_pose = rows.pose == k
        by_pose = rows.by_pose[:, :, is_of_pose].reshape(_POSE, -1)
        shared = rows.shared[:, :, is_of_pose].reshape(len(reduced), by_pose.shape[1])
        mix = solve_positive(by_pose @ by_pose.T + np.diag(precision), by_pose @ shared.T)
        reduced[:, :, is_of_pose] = (shared - mix.T @ by_pose).reshape(len(reduced), 2, -1)
    return reduced


def _sizes(effects: SharedEffects, variances: Variances):
    """Name, 1 sigma, unit and RMS displacement (in sigmas of a corner) of each component."""
    squares = np.asarray(effects.rows.power(2).sum(0)).ravel()
    corners = effects.rows.shape[0] / 2
    for k, (name, unit) in enumerate(zip(effects.names, effects.units)):
        sigma = float(np.sqrt(variances.effects[k]))
        size = sigma * float(np.sqrt(squares[effects.component == k].sum() / corners))
        yield name, sigma, unit, size


def _reduced(rows: CornerRows, precision) -> tuple[Reduced, PoseTables]:
    """Data of the variances: all board poses free, the shared parameters with their priors; and tables by pose."""
    count = len(rows.shared)
    gram = 0.0
    of_poses = []
    freedom = []
    chosen = _thinned(rows)
    columns = _columns_of_lines(rows)
    for k in np.unique(rows.pose[chosen]):
        table = _projected(rows, np.flatnonzero(chosen & (rows.pose == k)))
        gram = gram + table.T @ table
        of_lines = table @ columns
        of_poses.append(of_lines.T @ of_lines)
        freedom.append(max(len(table) - _POSE, 0))
    reduced_gram = gram[count:, count:]
    degrees = sum(freedom)
    noise = gram[-1, -1] / max(degrees, 1)
    if count:
        cross = gram[:count, count:]
        reduced_gram = reduced_gram - cross.T @ solve_positive(
            gram[:count, :count] + np.diag(precision) * noise, cross
        )
    effects = rows.effects
    reduced = Reduced(
        reduced_gram[:-1, :-1],
        reduced_gram[:-1, -1],
        max(float(reduced_gram[-1, -1]), 1e-300),
        max(degrees - count, 1),
        effects.component,
        len(effects.names),
    )
    return reduced, PoseTables(np.stack(of_poses), np.array(freedom), count, precision * noise)


def _columns_of_lines(rows: CornerRows) -> np.ndarray:
    """(F + q + 1, F + 2 L + 1) sums the effects of the points of each line; all else stays as it is."""
    sums = sums_of_lines(rows.effects.lines, len(rows.effects.component))
    return block_diag(np.eye(len(rows.shared)), sums, 1.0)


def _projected(rows: CornerRows, corners) -> np.ndarray:
    """(2 k, F + q + 1) shared derivatives, effects and residual of one image's corners, the pose projected out."""
    n = rows.pose.size
    shared = rows.shared[:, :, corners].reshape(len(rows.shared), 2 * len(corners)).T
    effects = rows.effects.rows[np.r_[corners, n + corners]].toarray()
    table = np.concatenate([shared, effects, rows.residual[:, corners].reshape(-1, 1)], axis=1)
    pose = rows.by_pose[:, :, corners].reshape(_POSE, -1).T
    basis = np.linalg.qr(pose / np.maximum(np.linalg.norm(pose, axis=0), 1e-300))[0]
    return table - basis @ (basis.T @ table)


def _thinned(rows: CornerRows) -> np.ndarray:
    """(n,) corners of at most so many points of the board in so many images."""
    is_selected = np.ones(rows.pose.size, bool)
    for labels, max_count in ((rows.point, _MOST_POINTS), (rows.pose, _MOST_POSES)):
        is_selected &= np.isin(labels, _evenly_spaced(np.unique(labels), max_count))
    return is_selected


def _evenly_spaced(labels: np.ndarray, max_count: int) -> np.ndarray:
    """At most `max_count` of the distinct labels (k,), at even steps from the first to the last."""
    steps = np.linspace(0, len(labels) - 1, max_count).astype(int)
    return labels[np.unique(steps)]


def scaled(rows: CornerRows, root: np.ndarray) -> CornerRows:
    """All rows times `root` (2, n) or (1, n): square roots of weights over standard deviations."""
    from scipy.sparse import diags

    root = np.broadcast_to(root, rows.residual.shape)
    effects = replace(rows.effects, rows=diags(root.ravel()).tocsr() @ rows.effects.rows)
    return replace(
        rows,
        shared=rows.shared * root,
        by_pose=rows.by_pose * root,
        residual=rows.residual * root,
        effects=effects,
    )
