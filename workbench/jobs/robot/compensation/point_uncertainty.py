"""The place of the measured point at targets, and its variance from the covariance of a calibration.

A sensor on the flange measures a ball some 200 mm in front of it. What the rotation of the hand-eye and the last links
share cancels at the ball, and not at the origin of the sensor. The world of such a calibration is the artefact, of
which few balls are seen: its rotation about them moves every other place of this world, and is no error of the arm.
"""

from dataclasses import dataclass

import numpy as np

from robot_model.measurements.closure import flange_matrices
from workbench.core.least_squares.linear_algebra import least_squares, solve_positive
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.rigid import left_jacobian, rotation_matrix, skew
from workbench.files.solution_file import CalibratedArm

_ROOT = ("joint-1.theta1", "joint-1.d1")
_HAND_EYE = tuple(f"sensor.{name}" for name in ("x", "y", "z", "rx", "ry", "rz"))


@dataclass(frozen=True)
class PointUncertainty:
    """The measured point at n targets: `offset` (3, n) mm from the target, `variance` (n,) mm^2, all `parameters`.

    `places` (3, n) mm in the world; `recorded`: the same at recorded readings, for a sensor on the flange, else None.
    """

    offset: np.ndarray
    variance: np.ndarray
    parameters: Parameters
    places: np.ndarray
    recorded: tuple[np.ndarray, np.ndarray] | None = None

    def change_to(self, other: "PointUncertainty") -> np.ndarray:
        """(3, n) mm: offset of another model less this one, apart from the rigid motion of the world between them."""
        change = other.offset - self.offset
        if self.recorded is None or other.recorded is None:
            return change
        places, offset = self.recorded
        recorded_change = other.recorded[1] - offset
        return without_common_motion(self.places, change[None], places, recorded_change[None])[0]


def point_uncertainty(model: Model, arm: CalibratedArm, recorded: Model | None) -> PointUncertainty:
    """The measured point in a model of the arm at targets; recorded: the model at recorded readings, if they are known.

    Of a sensor on the flange, the variance is that apart from the pose of the artefact, at the origin of the sensor or
    at the measured point, whichever is larger: which of the two a target is about is not known.
    """
    point = seen_point(arm)
    rows, covariance, parameters = position_derivative(model, arm, point)
    places = _places(model, parameters)
    offset = model.residual(parameters)[:3]
    if point is None or recorded is None:
        return PointUncertainty(offset, _variances(rows, covariance), parameters, places)
    # two points show the rotation of the tool, too: the balls are all at one place
    ends = [_point(recorded, arm, end) for end in (np.zeros(3), point)]
    recorded_places, recorded_offset, recorded_rows = (
        np.concatenate(columns, axis=-1) for columns in zip(*ends)
    )
    origin_places, _, origin_rows = _point(model, arm, np.zeros(3))
    variances = [
        _variances(
            without_common_motion(point_places, point_rows, recorded_places, recorded_rows),
            covariance,
        )
        for point_places, point_rows in ((places, rows), (origin_places, origin_rows))
    ]
    reference = recorded_places, recorded_offset
    return PointUncertainty(offset, np.maximum(*variances), parameters, places, reference)


def _variances(rows: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(n,) mm^2 of the places with rows (F, 3, n)."""
    return np.maximum(np.einsum("fmn,fg,gmn->n", rows, covariance, rows), 0.0)


def position_derivative(
    model: Model, arm: CalibratedArm, point: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, Parameters]:
    """Derivative (F, 3, n) of the measured point's place with respect to the F estimated parameters, their covariance.

    And all parameters at their values. Base and tool are in it: they were found together with the arm, and what they
    share with it cancels. A beam is known across itself and not along, so that there the flange's own place is taken.
    point: (3,) mm in the frame of a sensor on the flange, whose rotation is then among the parameters.
    """
    of_a_beam = arm.keys.get("measures") == "laser-spot"
    known = {
        _called(key): key
        for key in arm.free
        if _called(key) in model.parameters.index and not (of_a_beam and key.startswith("tool."))
    }
    values = {
        k: arm.values[key] for key in arm.values if (k := _called(key)) in model.parameters.index
    }
    if point is not None:
        values |= _point_on_flange(arm, point)
    parameters = model.parameters.update(values)
    parameters = parameters.only(np.isin(parameters.keys, list(known)))
    keys = [known[key] for key, free in zip(parameters.keys, parameters.mask) if free]
    rows = model.linearise(parameters)[1][:, :3]
    if point is not None:
        turned = _hand_eye_rotation_rows(arm, model.evaluate(parameters).frames, point)
        keys += turned
        rows = np.concatenate([rows, np.array([*turned.values()]).reshape(-1, *rows.shape[1:])])
    order = [arm.free.index(key) for key in keys]
    covariance = _covariance_given_frame(arm)[np.ix_(order, order)]
    return rows, covariance, parameters


def seen_point(arm: CalibratedArm) -> np.ndarray | None:
    """(3,) mm: mean of the measured points in the frame of a sensor on the flange; None for other measurements."""
    point = arm.keys.get("measured_point_mm")
    return None if point is None else np.array(point, float)


def without_common_motion(
    places: np.ndarray, rows: np.ndarray, recorded_places: np.ndarray, recorded_rows: np.ndarray
) -> np.ndarray:
    """Rows (F, 3, n) of places (3, n) mm, less the rigid motion of the world that each of them makes.

    The motion is that which fits the rows (F, 3, m) of the same parameters at the recorded places (3, m) mm best. What
    is left does not depend on the pose of the artefact, nor on what moves the arm as a whole.
    """
    motion = _rigid_motions(recorded_places)
    right = recorded_rows.transpose(2, 1, 0).reshape(len(motion), -1)
    fitted = least_squares(motion, right)
    common = (_rigid_motions(places) @ fitted).reshape(places.shape[1], 3, -1)
    return rows - common.transpose(2, 1, 0)


def _point(model: Model, arm: CalibratedArm, point: np.ndarray):
    """Places (3, m) mm of a point in the sensor, their offsets (3, m) from the nominal flange, and rows (F, 3, m)."""
    rows, _, parameters = position_derivative(model, arm, point)
    return _places(model, parameters), model.residual(parameters)[:3], rows


def _places(model: Model, parameters: Parameters) -> np.ndarray:
    """(3, n) mm of the measured point in the world."""
    return model.residual(parameters)[:3] + model.chain.measurement.measured


def _rigid_motions(places: np.ndarray) -> np.ndarray:
    """(3 n, 6): motion of places (3, n) mm by a unit translation (mm) and rotation (rad) about the origin."""
    return np.concatenate([np.hstack([np.eye(3), -skew(place)]) for place in places.T])


def _point_on_flange(arm: CalibratedArm, point: np.ndarray) -> dict[str, float]:
    """Values of `tool.x`, `tool.y` and `tool.z` (mm, flange frame) at a point (3,) mm in the frame of the sensor."""
    origin, rotation = _hand_eye(arm)
    return dict(zip(("tool.x", "tool.y", "tool.z"), origin + rotation @ point))


def _hand_eye_rotation_rows(arm, frames, point: np.ndarray) -> dict[str, np.ndarray]:
    """Key of a free hand-eye rotation -> (3, n) mm/rad: derivative of the place of a point (3,) mm in the sensor."""
    turned = _hand_eye(arm)[1] @ point
    vector = np.array([arm.values[key] for key in _HAND_EYE[3:]])
    by_rotation = flange_matrices(frames) @ -skew(turned) @ left_jacobian(vector)
    rows = {}
    for k, key in enumerate(_HAND_EYE[3:]):
        if key in arm.free:
            rows[key] = by_rotation[:, :, k].T
    return rows


def _hand_eye(arm: CalibratedArm) -> tuple[np.ndarray, np.ndarray]:
    """(3,) mm origin and (3, 3) rotation T_flange_sensor."""
    values = np.array([arm.values[key] for key in _HAND_EYE])
    return values[:3], rotation_matrix(values[3:])


def _covariance_given_frame(arm) -> np.ndarray:
    """(F, F) covariance, conditional on the root's rotation and height where nothing but the arm determines them.

    Touches, beams and lengths tell nothing of theta1 and d1: they say which frame targets are in, and are no
    error of the arm in it.
    """
    frame = [k for k, key in enumerate(arm.free) if key in _ROOT]
    if not frame or any(key.startswith("base.") and "-" not in key for key in arm.values):
        return arm.covariance
    shared = arm.covariance[:, frame]
    return arm.covariance - shared @ solve_positive(shared[frame], shared.T)


def _called(key: str) -> str:
    """Key of a parameter of a calibration in the model of a flange and one point on it."""
    place, _, name = key.partition(".")
    if (
        (place in ("tool", "sensor"))
        and name[-1:] in "xyz"
        and name[:-1] in ("", "reflector1_", "tip_")
    ):
        return f"tool.{name[-1]}"
    return key


__all__ = ["PointUncertainty", "point_uncertainty", "position_derivative", "seen_point"]
