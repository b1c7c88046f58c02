"""Forward and inverse correction of a calibrated arm from plain data; every exported module contains this code.

Readings are in degrees (mm for a joint that slides), poses are 4 x 4 transforms in mm from the flange to the robot's
root frame. Covariates are recorded columns by name in file units, such as `payload_kg` or `temperature_c`.
"""

from dataclasses import dataclass

import numpy as np

from robot_model.chain import forward
from robot_model.postures.task_priority import (
    Task,
    joint_part,
    pose_difference,
    pose_sizes,
)
from robot_model.robot import Robot
from robot_model.state import State, sliding, with_history
from robot_model.system import RobotChain
from robot_model.tool_points import calibrated_points
from workbench.core.model import Model
from workbench.core.rigid import rotation_matrix

_STEPS = 40
_SOLVED_MM = 1e-3
# outside the recorded range by more than this many of its extents a correction is not supported by the data
_MAX_EXTENTS = 1.0
# extent of a joint that hardly moved in the recording: the correction itself moves it by part of a degree
_LEAST_TURN_DEG, _LEAST_SLIDE_MM = 10.0, 100.0
_POSE = ("x", "y", "z", "rx", "ry", "rz")
_LEVER_MM = 200.0
_REACHED_MM = 1e-5
_DAMPING = 1e-6 * _LEVER_MM**2 * 1e-3
_ARRAYS = (
    "geometry",
    "hayati",
    "prismatic",
    "mixing",
    "limits",
    "gear_ratio",
    "gravity",
    "mass",
    "com",
    "payload_com",
    "base",
    "flange",
)


@dataclass(frozen=True)
class Flange:
    """Empty measurement of a chain that ends at the flange, in the robot's root frame."""

    place = "tool"
    grounded = True

    def parameters(self) -> list:
        """No parameters of its own."""
        return []


class CorrectedArm:
    """A calibrated arm.

    data: keys `robot` (fields of a Robot), `values` (parameters by key; mm, rad), `load_centre` (3,) mm, `ranges`
    (recorded column -> lowest and highest value, of joint readings and of covariates that a term uses; empty where
    unknown), `largest_correction` (mm and deg), `rows` of the recording, after which the arm is asked for.
    effects: those that move the flange. observed: these and the drift of the base in the instrument's frame.
    control: those on joints that are no springs, which change the targets of servos.
    """

    def __init__(self, data, effects, observed, control=()):
        self.data = data
        fields = dict(data["robot"])
        for name in _ARRAYS:
            fields[name] = np.array(fields[name])
        for name in ("limits", "gear_ratio"):
            fields[name] = np.array(fields[name], float)  # None is nan: unknown
        coupling = fields["coupling"]  # None is nan: every drive moves its own joint alone
        fields["coupling"] = np.array(coupling) if isinstance(coupling, list) else None
        self.robot = Robot(**fields)
        self.values = data["values"]
        self.load_centre = np.array(data["load_centre"], float)
        self.ranges, self.largest = data["ranges"], data["largest_correction"]
        self.rows = float(data["rows"])
        self.task = Task.of(self.robot, self.values, self.ranges)
        self.effects, self.observed, self.control = tuple(effects), tuple(observed), tuple(control)

    def nominal_poses(self, readings) -> np.ndarray:
        """(n, 4, 4) T_root_flange of the nominal arm at readings (n, R) in degrees, mm of a slide."""
        return _poses(forward(self.robot, self._variables(self._radians(readings))))

    def flange_poses(self, readings, covariates=None) -> np.ndarray:
        """(n, 4, 4) T_root_flange where the real flange is at readings (n, R) in degrees, mm of a slide."""
        return _poses(self._frames(self._radians(readings), covariates, self.effects))

    def measured_points(self, readings, tool_point=None, covariates=None, reflector=None):
        """(n, 3) mm: a point of the tool in the frame of the external instrument.

        tool_point: (3,) or (n, 3) mm in the flange frame. None takes a calibrated point: that of number `reflector`,
        by default the one with the lowest number, or the origin of the calibrated tool frame. A calibration without a
        frame of an instrument gives points in the robot's root frame. Raises ValueError where the calibration has no
        such point.
        """
        if tool_point is None:
            tool_point = self._calibrated_point(reflector)
        frames = self._frames(self._radians(readings), covariates, self.observed)
        point = frames.point(np.atleast_2d(np.asarray(tool_point, float)).T)
        base = np.array([self.values.get(f"base.{c}", 0.0) for c in _POSE])
        return (rotation_matrix(base[3:]) @ point).T + base[:3]

    def _calibrated_point(self, reflector) -> list:
        """Three coordinates (mm, flange frame) of a calibrated point; ValueError where there is none."""
        points = calibrated_points(self.values)
        name = next(iter(points), None) if reflector is None else f"reflector{reflector}"
        if name in points:
            return points[name]
        found = ", ".join(points) or "none"
        raise ValueError(
            f"expected a calibrated point {name or 'of the tool'}, found {found}; "
            "give tool_point, three coordinates in mm in the flange frame"
        )

    def servo_targets(self, readings, covariates=None) -> np.ndarray:
        """(n, J) rad, m of a slide: targets of the servos of the exported MJCF model at readings (n, R).

        Terms on joints that are no springs are in them: transmission errors, backlash, couplings, curves.
        """
        chain, model, parameters = self._model(self._radians(readings), covariates, self.control)
        targets = chain.moved_variables(model.deltas(parameters))
        if len(self.robot.mixing) == self.robot.mixing.shape[1]:
            mixing_diagonal = np.diag(self.robot.mixing)
        else:
            mixing_diagonal = 1.0
        is_coupled = np.count_nonzero(self.robot.mixing) > self.robot.joints
        signs = np.ones(self.robot.joints) if is_coupled else mixing_diagonal
        return (signs[:, None] * targets * np.where(self.robot.prismatic, 1e-3, 1.0)[:, None]).T

    def corrected_readings(self, readings, poses=None, covariates=None, force=False) -> tuple:
        """Readings (n, R) that bring the real flange to where it shall be, and what is left of the error (n,) mm.

        readings (n, R): as programmed; the target is where the nominal arm would stand. poses (n, 4, 4): targets
        instead, and readings are where the search starts. The error left is the larger of the distance and of the
        rotation at a lever of 200 mm; a target is reached where it is below 0.001 mm.

        Readings are nan where the target is not reached or they exceed the limits of the joints. They are also nan
        where the correction, or what is left of it, is above `largest_correction` (10 mm and 1 deg, or more where the
        measured error of the nominal arm confirms it), or where joint readings or covariates are outside their
        recorded range by more than its extent; force=True accepts these.

        An arm that cannot move its tool in all six directions corrects the position of the first calibrated point,
        then the orientation as far as its joints allow. The error left is then that of this point and of the
        orientation; `errors_left` has both by themselves.
        """
        if poses is None:
            wanted = self.nominal_poses(readings)
            found = self._radians(readings)
        else:
            wanted = np.asarray(poses, float)
            found = self._nominal_readings(readings, wanted)
        before = self._error(found, wanted, covariates)
        found, movable, remaining_error = self._solved(found, wanted, covariates)
        is_good = (movable < _SOLVED_MM) & self._is_within_limits(found)
        shown = np.where(sliding(self.robot), found, np.rad2deg(found))
        if not force:
            after = self._error(found, wanted, covariates)
            is_good &= self._is_plausible(before) & self._is_plausible(after)
            is_good &= self._is_covered(shown, covariates)
        return np.where(is_good[:, None], shown, np.nan), remaining_error

    def _nominal_readings(self, readings, wanted) -> np.ndarray:
        """(n, R) rad, mm: readings of the nominal arm at the wanted poses, from where the search starts."""
        nominal = CorrectedArm({**self.data, "values": {}}, (), ())
        nominal.task = self.task
        return nominal._solved(self._radians(readings), wanted, None)[0]

    def _solved(self, found, wanted, covariates) -> tuple:
        """Readings (n, R) rad, mm after the search, what the joints can move of the error, and all of it (n,) mm."""
        inverse_mixing = np.linalg.pinv(self.robot.mixing)
        for _ in range(_STEPS):
            frames = self._frames(found, covariates, self.effects)
            error = pose_difference(_poses(frames), wanted, self._point())
            step, movable = self._step(frames, error, inverse_mixing)
            if movable.max(initial=0) < _REACHED_MM:
                break
            found = found - np.clip(step, -self._largest_step(), self._largest_step())
        frames = self._frames(found, covariates, self.effects)
        error = pose_difference(_poses(frames), wanted, self._point())
        return found, self._step(frames, error, inverse_mixing)[1], _size(error)

    def _error(self, found, wanted, covariates) -> np.ndarray:
        """(6, n) mm and rad between the real and the wanted poses at readings (n, R) in rad, mm."""
        actual = _poses(self._frames(found, covariates, self.effects))
        return pose_difference(actual, wanted, self._point())

    def _is_within_limits(self, found) -> np.ndarray:
        """(n,) bool: whether readings (n, R) in rad, mm are within the joint limits; nan is no limit."""
        low, high = self.robot.limits.T
        return (~(found < low) & ~(found > high)).all(1)

    def _is_plausible(self, error) -> np.ndarray:
        """(n,) bool: whether an error (6, n) is small enough to be a correction."""
        position, rotation = pose_sizes(error)
        return (position <= self.largest[0]) & (rotation <= self.largest[1])

    def _is_covered(self, shown, covariates) -> np.ndarray:
        """(n,) bool: whether readings (n, R) in deg, mm and covariates are in or near what was recorded."""
        covered = np.ones(len(shown), bool)
        min_extent = np.where(sliding(self.robot), _LEAST_SLIDE_MM, _LEAST_TURN_DEG)
        for k, slides in enumerate(sliding(self.robot)):
            ends = self.ranges.get(f"q{k + 1}_{'mm' if slides else 'deg'}")
            covered &= _is_near(shown[:, k], ends, min_extent[k])
        load = self.robot.payload_mass
        given = {"payload_kg": 0.0, **(covariates or {})}
        for name, values in given.items():
            ends = self.ranges.get(name)
            values = np.asarray(values, float)
            if name == "payload_kg" and ends is not None:
                ends = [end + load for end in ends]
                values = values + load
            covered &= _is_near(values, ends, ends[1] if name == "payload_kg" and ends else 0.0)
        return covered

    def errors_left(self, corrected, readings, poses=None, covariates=None) -> tuple:
        """(n,) mm and (n,) deg: position and orientation that corrected readings leave to the targets.

        corrected (n, R): of `corrected_readings`; readings, poses and covariates as there. The position is that of the
        flange or, of an arm that cannot move it in all six directions, of the first calibrated point on the tool.
        """
        if poses is None:
            wanted = self.nominal_poses(readings)
        else:
            wanted = np.asarray(poses, float)
        actual = self.flange_poses(corrected, covariates)
        return pose_sizes(pose_difference(actual, wanted, self._point()))

    def _point(self):
        if self.task.is_deficient:
            return self.task.point
        return np.zeros(3)

    def _largest_step(self) -> np.ndarray:
        """(R,) largest change of a reading in one step: a radian, 100 mm of a slide."""
        return np.where(sliding(self.robot), 100.0, 1.0)

    def _step(self, frames, error, inverse_mixing) -> tuple:
        if self.task.is_deficient:
            return joint_part(self.robot, frames, error, self.task)
        return (inverse_mixing @ _joint_step(self.robot, frames, error)).T, _size(error)

    def _radians(self, readings) -> np.ndarray:
        given = np.atleast_2d(np.asarray(readings, float))
        return np.where(sliding(self.robot), given, np.deg2rad(given))

    def _variables(self, readings) -> np.ndarray:
        return self.robot.mixing @ readings.T

    def _frames(self, readings, covariates, effects):
        chain, model, parameters = self._model(readings, covariates, effects)
        chain_values = parameters.values[: len(chain.parameters)]
        return chain.frames(chain_values, model.deltas(parameters))[0]

    def _model(self, readings, covariates, effects):
        variables = self._variables(readings)
        n = variables.shape[1]
        columns = {
            k: np.broadcast_to(np.asarray(v, float), (n,)) for k, v in (covariates or {}).items()
        }
        columns.setdefault("row", np.full(n, self.rows))
        columns = with_history(columns, self.robot.joints, n)
        payload = self.robot.payload_mass + columns.get("payload_kg", np.zeros(n))
        blank = np.zeros((3, n))
        unit_sigma = np.ones((1, n))
        state = State(
            self.robot,
            variables,
            columns,
            self.robot.gravity,
            payload,
            self.load_centre,
            blank,
            np.ones(n, int),
            blank,
        )
        chain = RobotChain(
            self.robot, Flange(), variables, unit_sigma, state, np.zeros(0), unit_sigma
        )
        model = Model(chain, effects)
        known = {k: self.values[k] for k in model.parameters.keys if k in self.values}
        return chain, model, model.parameters.update(known)


def _poses(frames) -> np.ndarray:
    """(n, 4, 4) of the end of a chain."""
    rotation = np.stack(frames.end, -1).transpose(1, 0, 2)
    poses = np.zeros((len(rotation), 4, 4))
    poses[:, :3, :3], poses[:, :3, 3], poses[:, 3, 3] = rotation, frames.end_origin.T, 1
    return poses


def _is_near(values, ends, min_extent):
    """bool: whether values are outside a recorded range by at most its extent, which is at least `min_extent`."""
    if ends is None:
        return np.ones(np.shape(values), bool)
    low, high = ends
    rounding = 1e-9 * max(abs(low), abs(high))
    distance = np.maximum(np.maximum(low - values, values - high), 0.0)
    return distance <= _MAX_EXTENTS * max(high - low, min_extent) + rounding


def _size(error) -> np.ndarray:
    """(n,) mm: the larger of the shift and of the rotation at a lever's length."""
    shift = np.sqrt((error[:3] ** 2).sum(0))
    rotation = np.sqrt((error[3:] ** 2).sum(0))
    return np.maximum(shift, _LEVER_MM * rotation)


def _joint_step(robot, frames, error) -> np.ndarray:
    """(J, n) change of the joint variables that makes the error: damped least squares on the geometric Jacobian."""
    axes = frames.z
    lever = frames.end_origin - frames.z_origin
    by_rotation = np.cross(axes, lever, axis=1)
    slides = robot.prismatic[:, None, None]
    moved = np.where(slides, axes, by_rotation)
    rotated = np.where(slides, 0.0, axes) * _LEVER_MM
    jacobian = np.concatenate([moved, rotated], 1).transpose(2, 1, 0)
    scaled = error * np.array([1.0, 1, 1, _LEVER_MM, _LEVER_MM, _LEVER_MM])[:, None]
    normal = jacobian.transpose(0, 2, 1) @ jacobian + _DAMPING * np.eye(robot.joints)
    right = jacobian.transpose(0, 2, 1) @ scaled.T[..., None]
    return np.linalg.solve(normal, right)[..., 0].T
