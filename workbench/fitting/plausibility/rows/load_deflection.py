"""Deflection of the joints by a load of unknown weight and centre that the tool carries in a part of a recording.

Each joint deflects by its compliance times the torque of the load about it. The residual of a linearised fit is linear
in the products of compliances and weight for a given centre, and in the centre for given products; both are
estimated in turn (variable projection: Golub & Pereyra, Inverse Problems 19 (2003) R1).
"""

from dataclasses import dataclass

import numpy as np

from workbench.fitting.plausibility.fitting import POSITION

_LEAST_TORQUE_M = 0.02
"""Lever of a load that must vary, for a joint to show its deflection."""
CENTRE_MM = 200.0
"""Prior standard deviation of the centre of a load, from the measured point or the tool's centre of mass."""
ROUNDS = 5


@dataclass(frozen=True)
class LoadDeflection:
    """Derivatives (J, m, n) of the residual by the joints `moved`, and torques of one newton about these.

    `unit` (J, n), m: at the assumed centre; `moments` (3, J, n): per metre of a centre beyond it, along the axes of the
    flange.
    """

    moved: np.ndarray
    unit: np.ndarray
    moments: np.ndarray

    @classmethod
    def of(cls, model, parameters, lever: float) -> "LoadDeflection":
        """Of a model at some parameters, without joints that a load has no torque about; lever: mm per rad."""
        state = model.chain.state
        unit = state.unit_load_torque
        moved = model.evaluate(parameters).joint_rows()
        moved[:, POSITION:] *= lever
        chosen = np.ptp(unit, axis=1) > _LEAST_TORQUE_M
        return cls(moved[chosen], unit[chosen], state.load_moment_torque[:, chosen])

    def rows(self, centre: np.ndarray) -> np.ndarray:
        """(J, m, n) derivative by the compliances times the weight, for a centre (3,) mm from the assumed one."""
        torque = self.unit + np.tensordot(1e-3 * centre, self.moments, 1)
        return self.moved * torque[:, None]

    def rows_by_centre(self, products: np.ndarray) -> np.ndarray:
        """(3, m, n) derivative by the centre (mm) for products (J,) of compliances and weight."""
        return 1e-3 * np.einsum("j,jmn,ajn->amn", products, self.moved, self.moments)


def of_one_sign(matrix: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """(P,) solution of normal equations whose components have one sign, the better of both; others are zero.

    All joints deflect along the torque of a load that was added, or against it where it was taken off.
    """
    from scipy.optimize import nnls  # takes a tenth of a second to load

    root = np.linalg.cholesky(matrix)
    right = np.linalg.solve(root, gradient)
    best, reduction = np.zeros(len(gradient)), 0.0
    for sign in (1.0, -1.0):
        found = sign * nnls(root.T, sign * right)[0]
        fall = float(2 * found @ gradient - found @ matrix @ found)
        if fall > reduction:
            best, reduction = found, fall
    return best
