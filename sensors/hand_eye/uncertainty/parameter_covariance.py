"""Covariance of the parameters of a hand-eye adjustment: infinite along directions that nothing determines.

The adjustment holds undetermined directions with a weak prior, to stay where it is. Its covariance
there would be that prior's, a number that no datum stands behind; here it becomes infinite.
"""

from dataclasses import dataclass

import numpy as np

from sensors.hand_eye.motion import Motion
from workbench.core.least_squares.identifiability import identifiability
from workbench.core.least_squares.linear_algebra import least_squares, solve_positive, thin_svd
from workbench.core.rigid import left_jacobian

_UNDETERMINED_SQUARED = 1e4
"""Squared, in typical sizes: how far what is not determined may be off, of a place a metre."""
_SAME = 1e-6  # relative: a direction that others make but for this is no direction of its own
_MIN_INDEPENDENT_PART = (
    0.5  # a direction that lies half in the others is one of them, blurred by errors
)


@dataclass(frozen=True)
class ParameterCovariance:
    """Of the F free parameters `keys`: `covariance` (F, F) in their units, what is not determined held;
    `open` (F, K) directions that are not determined, one typical size long; `sentences` on them; `typical`
    (F,) sizes."""

    keys: tuple[str, ...]
    covariance: np.ndarray
    open: np.ndarray
    sentences: tuple[str, ...]
    typical: np.ndarray

    def of(self, rows: np.ndarray) -> np.ndarray:
        """(R, R) covariance of rows @ parameters, rows (R, F): diagonal inf, other elements nan, where
        they move by more than their sigma along what is not determined."""
        covariance = rows @ self.covariance @ rows.T
        is_undetermined = _UNDETERMINED_SQUARED * ((rows @ self.open) ** 2).sum(1) > np.diag(
            covariance
        )
        is_undetermined |= np.diag(covariance) > _UNDETERMINED_SQUARED * (
            (rows * self.typical) ** 2
        ).sum(1)  # less known than before measuring
        covariance[is_undetermined] = covariance[:, is_undetermined] = np.nan
        covariance[is_undetermined, is_undetermined] = np.inf
        return covariance

    def std(self) -> dict[str, float]:
        """1 sigma by key, inf where it is not determined."""
        return dict(zip(self.keys, np.sqrt(np.diag(self.of(np.eye(len(self.keys))))).tolist()))


def parameter_covariance(adjusted, motion: Motion) -> ParameterCovariance:
    """Covariance of the parameters of an `Adjusted`, for the motions that the flange made.

    Only parameters without a prior are judged; those with a prior (a camera) are adjusted with
    them. A direction is open where the data know less of it than a typical size, or where the flange's
    motions leave it open: there an adjustment that lets the robot be off finds a little knowledge in
    the robot's own errors, which is none.
    """
    table = adjusted.parameters
    free = adjusted.parameters.mask
    keys = tuple(key for key, is_free in zip(table.keys, free) if is_free)
    has_no_prior = table.precision[free] == 0
    found = identifiability(
        _reduced_normal(adjusted.linear.normal, table.precision[free], has_no_prior),
        table.only(free & (table.precision == 0)),
    )
    typical = table.typical[free]
    null = np.zeros((len(keys), found.null.shape[1]))
    null[has_no_prior] = found.null
    known = _orthonormal(_directions(motion, adjusted.parameters, keys) / typical[:, None])
    null = _with(known, null)
    has_further_directions = null.shape[1] > known.shape[1]  # the motions' own words say it best
    covariance = adjusted.linear.covariance / np.outer(typical, typical)
    if null.shape[1]:
        cross = covariance @ null
        # what is left when the open directions are held: an oblique projection on both sides keeps it non-negative
        project = np.eye(len(covariance)) - cross @ solve_positive(null.T @ cross, null.T)
        covariance = project @ covariance @ project.T
    return ParameterCovariance(
        keys,
        covariance * np.outer(typical, typical),
        null * typical[:, None],
        (*motion.sentences, *(found.sentences() if has_further_directions else ())),
        typical,
    )


def _reduced_normal(normal, precision, has_no_prior):
    """(A, A) normal matrix of those without a prior, the others adjusted to whatever these are (Schur)."""
    other = normal[np.ix_(~has_no_prior, ~has_no_prior)] + np.diag(precision[~has_no_prior])
    cross = normal[np.ix_(has_no_prior, ~has_no_prior)]
    return normal[np.ix_(has_no_prior, has_no_prior)] - cross @ solve_positive(other, cross.T)


def _directions(motion, parameters, keys):
    """(F, M) mm and rad: change of the free parameters when sensor and target move by each small motion."""
    rows = np.zeros((len(keys), motion.sensor.shape[1]))
    for where, twists in (("sensor", motion.sensor), ("target", motion.target)):
        place = np.array([parameters[f"{where}.{name}"] for name in "xyz"])
        change = twists[:3] + np.cross(twists[3:].T, place).T
        if f"{where}.rx" in keys:
            vector = np.array([parameters[f"{where}.{name}"] for name in ("rx", "ry", "rz")])
            change = np.concatenate([change, least_squares(left_jacobian(vector), twists[3:])])
        for name, row in zip(("x", "y", "z", "rx", "ry", "rz"), change):
            rows[keys.index(f"{where}.{name}")] = row
    return rows


def _orthonormal(columns):
    """(F, R) orthonormal basis of columns (F, M)."""
    if not columns.shape[1]:
        return columns
    u, values, _ = thin_svd(columns / np.linalg.norm(columns, axis=0))
    return u[:, values > _SAME * values[0]]


def _with(null, directions):
    """Orthonormal columns of null and of those of `directions` that are not in it."""
    for column in directions.T:
        independent_part = column / np.linalg.norm(column)
        independent_part = independent_part - null @ (null.T @ independent_part)
        if np.linalg.norm(independent_part) > _MIN_INDEPENDENT_PART:
            null = np.concatenate(
                [null, independent_part[:, None] / np.linalg.norm(independent_part)], 1
            )
    return null
