"""Flange poses that were recorded at another moment than the images: they lie on the way to a neighbouring pose.

A pose stream that lags, or is read while the arm still moves, gives poses (1 - f) T_i + f T_j, with j the pose before
or after. All errors are then the share f of the motion between consecutive poses: one number explains them.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sensors.hand_eye.checks.alternatives import Alternative, moved_of
from sensors.hand_eye.checks.pose_data import Freedom, PoseData, PoseFit
from sensors.hand_eye.checks.pose_fit import refit
from workbench.core.rigid import rotation_matrix, rotation_vector

_LARGEST = 0.5
"""Share of a motion from which on a pose is nearer to that of its neighbour, as with shifted rows."""
_TOLERANCE = 1e-4
_NEIGHBOURS = ((1, "next", "recorded after"), (-1, "previous", "recorded before"))


def lag_alternatives(data: PoseData, recorded: PoseFit, named) -> Iterator[Alternative]:
    """Poses that lie a share of the way to those of the next, or of the previous, image; the share is estimated."""
    from scipy.optimize import minimize_scalar

    kind, nouns = named.kind, named.nouns
    flange = moved_of(data.moved, kind)  # its own inverse
    for step, neighbour, moment in _NEIGHBOURS:

        def fit(share, step=step):
            return refit(_undone(data, flange, step, share, kind), recorded, Freedom())

        found = minimize_scalar(
            lambda share, fit=fit: fit(share).trimmed_rms,
            bounds=(0.0, _LARGEST),
            method="bounded",
            options={"xatol": _TOLERANCE},
        )
        share = float(found.x)
        yield Alternative(
            "lag",
            f"poses and {nouns.measured} look taken at different moments: each recorded pose lies "
            f"{100 * share:.1f} % of the motion on the way to the {neighbour} pose, as if it was {moment} "
            f"the {nouns.moment}",
            f"record pose and {nouns.moment} while the arm stands still, or correct the delay between them",
            fit(share).trimmed_rms,
            1,
            1,
            falls=2.0,
        )


def without_lag(flange: np.ndarray, step: int, share: float) -> np.ndarray:
    """True poses T of recorded ones (P, 4, 4) that lie a share f < 1 of the way from T_i to T_j, j = i + step.

    Positions are interpolated linearly, rotations about a fixed axis. T_i follows from T_j, and lies f / (1 - f) of the
    way from T_j to the recorded pose beyond it. The row at the end, which has no neighbour, stays: its error reaches
    the k-th row from it with the power k of f / (1 - f).
    """
    extrapolation = share / (1 - share)
    found = flange.copy()
    order = range(len(flange) - 2, -1, -1) if step == 1 else range(1, len(flange))
    for row in order:
        recorded, other = flange[row], found[row + step]
        turn = rotation_vector(recorded[:3, :3].T @ other[:3, :3])
        found[row, :3, :3] = recorded[:3, :3] @ rotation_matrix(-extrapolation * turn)
        found[row, :3, 3] = recorded[:3, 3] - extrapolation * (other[:3, 3] - recorded[:3, 3])
    return found


def _undone(data: PoseData, flange, step, share, kind) -> PoseData:
    return replace(data, moved=moved_of(without_lag(flange, step, share), kind))
