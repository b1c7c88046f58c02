"""A robust fit, linearised, for the regression of what it leaves on errors of the readings."""

from dataclasses import dataclass

import numpy as np

from workbench.fitting.plausibility.fitting import POSITION, Fit, geometry_prior, lever_of

_CAUCHY = 2.5
_LEAST_MM = 1e-6
_UNDETERMINED = 1e-9  # share of a column that is independent of base, tool and geometry


@dataclass(frozen=True)
class LinearisedFit:
    """A robust fit, linearised: weighted columns of its parameters, residual, and derivatives by joints and readings.

    `joints` (J, m, n) and `readings` (R, m, n): by each joint variable, and by each reading with what it is coupled to.
    `matrix` (F, F) and `gradient` (F,): normal equations of the F parameters with their prior, in units (F,) in which
    the diagonal is 1. `root` (n,): of the weight of each sample, per mm.
    """

    baseline: np.ndarray
    residual: np.ndarray
    joints: np.ndarray
    readings: np.ndarray
    matrix: np.ndarray
    gradient: np.ndarray
    unit: np.ndarray
    root: np.ndarray

    @classmethod
    def at(cls, robot, recording, fit: Fit) -> "LinearisedFit":
        parameters, lever = fit.parameters, lever_of(robot, recording)
        _, rows = fit.model.linearise(parameters)
        joints = fit.model.evaluate(parameters).joint_rows()
        size = max(fit.scale, _LEAST_MM)
        root = 1 / np.sqrt(1 + (fit.mismatch / (_CAUCHY * size)) ** 2)
        root *= np.sqrt(len(fit.residual)) / size

        def white(values):
            rotations = lever * values[..., POSITION:, :]
            return np.concatenate([values[..., :POSITION, :], rotations], -2) * root

        prior = geometry_prior(robot, recording, parameters)[parameters.mask]
        baseline = white(rows).reshape(len(rows), -1)
        residual = white(fit.residual).ravel()
        matrix = baseline @ baseline.T + np.diag(1 / prior**2)
        unit = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        pull = (parameters.pack() - parameters.nulls[parameters.mask]) / prior**2
        gradient = unit * (baseline @ residual + pull)
        by_joint = white(joints)
        by_reading = np.tensordot(robot.mixing.T, by_joint, 1)
        normal = matrix * np.outer(unit, unit)
        return cls(baseline, residual, by_joint, by_reading, normal, gradient, unit, root)

    def solved(self, moved: np.ndarray, laws: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Coefficients (c,) of laws (c, n) of the error of a joint or reading, and their precision (c, c).

        moved (m, n): the derivative by that joint or reading, of `joints` or `readings`.

        None where base, tool and geometry make the same errors.
        """
        columns = (moved * laws[:, None, :]).reshape(len(laws), -1)
        shared = self.unit[:, None] * (self.baseline @ columns.T)
        right = np.column_stack([shared, self.gradient])
        solutions = np.linalg.lstsq(self.matrix, right, rcond=1e-12)[0]
        full_gram = columns @ columns.T
        reduced_gram = full_gram - shared.T @ solutions[:, :-1]
        if not np.linalg.eigvalsh(reduced_gram)[0] > _UNDETERMINED * np.trace(full_gram):
            return None
        coefficients = -np.linalg.solve(
            reduced_gram, columns @ self.residual - shared.T @ solutions[:, -1]
        )
        return coefficients, reduced_gram
