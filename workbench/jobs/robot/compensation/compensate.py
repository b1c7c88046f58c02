"""Using a calibration: joint readings that bring the real arm where the nominal one was sent.

The full non-linear model is inverted, for all targets at once: geometry, transmission, compliance
under the load that each target carries, and whatever else was calibrated. An arm that cannot move its flange in all six
directions reaches the position first, and the orientation as far as its joints allow.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import forward
from robot_model.measurements.closure import flange_matrices
from robot_model.measurements.external_pose import ExternalPose
from robot_model.postures import task_priority
from robot_model.postures.task_priority import LEVER_MM, Task, pose_sizes
from robot_model.robot import Robot
from robot_model.state import State, approaches_read, reading_names, sliding, with_history
from robot_model.system import RobotChain
from workbench.core.least_squares.linear_algebra import least_squares, solve_positive
from workbench.core.model import Model
from workbench.core.rigid import transform
from workbench.files.considered import considered_arms, is_evaluable
from workbench.files.solution_file import CalibratedArm
from workbench.jobs.robot.compensation.extrapolation import extrapolation_mm
from workbench.jobs.robot.compensation.model_error import remaining_error_mm
from workbench.jobs.robot.compensation.point_uncertainty import point_uncertainty
from workbench.jobs.robot.compensation.revolutions import nearest_revolutions, recorded_middle

COVERAGE_FACTOR = 2
"""Expanded uncertainty over standard uncertainty (GUM, JCGM 100:2008, 6.2)."""
_STEPS = 40
# starts of the search for a posture, and where a joint without limits may start
_TRIES = 20
_OPEN = (-np.pi, np.pi)
# a target counts as reached within a hundredth of a micrometre, and as much a lever's length away
_REACHED_MM = 1e-5
# What is left of the error is negligible up to this share of the standard uncertainty: both together are then 4 % more.
_NEGLIGIBLE, _LEAST_MM = 0.3, 1e-3
# a joint that stood still in the recording has an unknown axis: of a redundant arm the others are moved instead
_STILL_RAD, _STILL_MM, _STILL_WEIGHT = 1e-3, 0.1, 1e-3


@dataclass(frozen=True)
class Compensated:
    """Corrected targets.

    `readings` (n, R) rad, mm, nan where not `reached`; `poses` (n, 4, 4) T_root_flange that were asked
    for; `correction_mm` (n,) how far the real flange is from them at the nominal arm's readings, the larger of its
    position and of its orientation at a lever of 200 mm; `position_mm` and `rotation_deg` (n,) the two by themselves;
    `left_mm` (n,) what is left of it; `sigma_mm` (n,) 1 sigma of the 3-D place that the parameters'
    uncertainty, considered terms and the extrapolation of empirical functions make; `uncertainty_mm` (n,) that combined
    with the error of the model on unseen poses (`model_error.remaining_error_mm`; GUM, JCGM 100:2008, 5.1.2);
    `expanded_uncertainty_mm` is that times the coverage factor 2 (6.2 there);
    `reached` (n,) False where no reading within the joint limits reaches the target to `negligible_mm`: the search
    found none, or where `beyond_limits` (n,) is True, only one outside the limits.

    An arm that cannot move its flange in all six directions (`is_deficient`) has reached a target where nothing is left
    in the directions that its joints move; `position_left_mm` and `rotation_left_deg` (n,) are then what is left in
    the other ones. All its distances are those of the first calibrated point on the tool, not of the flange.
    """

    readings: np.ndarray
    poses: np.ndarray
    correction_mm: np.ndarray
    position_mm: np.ndarray
    rotation_deg: np.ndarray
    left_mm: np.ndarray
    sigma_mm: np.ndarray
    uncertainty_mm: np.ndarray
    reached: np.ndarray
    beyond_limits: np.ndarray
    position_left_mm: np.ndarray
    rotation_left_deg: np.ndarray
    is_deficient: bool

    @property
    def expanded_uncertainty_mm(self) -> np.ndarray:
        """(n,) mm: uncertainty of the 3-D place with the coverage factor; it holds 95 % of the errors or more."""
        return COVERAGE_FACTOR * self.uncertainty_mm


def compensate(
    arm: CalibratedArm,
    readings: np.ndarray,
    poses: np.ndarray | None = None,
    covariates=None,
    anywhere: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Compensated:
    """Readings with which the calibrated arm puts its flange where the nominal arm would have put it.

    readings (n, R): rad, mm, as programmed, or where to start looking when `poses` (n, 4, 4),
    T_root_flange in mm, are the targets; anywhere: in any posture. covariates: name -> (n,) in file units, `payload_kg`
    among them; what an effect needs and is not given raises InputError. progress: called with the number of Newton
    steps so far and at most.
    """
    nominal = nominal_poses(arm.robot, readings)
    target = nominal if poses is None else np.asarray(poses, float)
    found = np.array(readings, float)
    task = Task.of(arm.robot, arm.values, arm.fitted_range)
    if poses is not None:
        found = _nominal_readings(arm.robot, found, target, anywhere, task)
        if anywhere:
            found = nearest_revolutions(arm.robot, found, _turn_reference(arm, readings))
    error = _deviation(model_at(arm, found, target, covariates), arm, task)
    position, rotation = pose_sizes(error)
    best = found
    smallest = np.full(len(found), np.inf)
    for done in range(_STEPS):
        progress(done, _STEPS)
        step, movable = _reading_step(model_at(arm, found, target, covariates), arm, task)
        # a step next to a singular posture may lead away: the nearest readings are kept
        best = np.where((movable < smallest)[:, None], found, best)
        smallest = np.fmin(movable, smallest)
        if movable.max(initial=0) < _REACHED_MM:
            break
        found = found - np.clip(step, -_reach(arm.robot), _reach(arm.robot))
    found = best
    model = model_at(arm, found, target, covariates)
    position_left, rotation_left = pose_sizes(_deviation(model, arm, task))
    sigma = _sigma(arm, found, target, covariates)
    uncertainty = np.hypot(sigma, remaining_error_mm(arm))
    is_solved = _reading_step(model, arm, task)[1] < negligible_mm(uncertainty)
    outside_limits = is_solved & ~_is_within_limits(arm.robot, found)
    reached = is_solved & ~outside_limits
    # what an inversion that failed ends with is no place to send an arm to
    readings = np.where(reached[:, None], found, np.nan)
    return Compensated(
        readings,
        target,
        _larger(position, rotation),
        position,
        rotation,
        _larger(position_left, rotation_left),
        sigma,
        uncertainty,
        reached,
        outside_limits,
        position_left,
        rotation_left,
        task.is_deficient,
    )


def negligible_mm(uncertainty: np.ndarray) -> np.ndarray:
    """(n,) mm: what may be left of the error of a target whose standard uncertainty is `uncertainty` (n,) mm."""
    return np.fmax(_NEGLIGIBLE * uncertainty, _LEAST_MM)


def _larger(position, rotation) -> np.ndarray:
    """(n,) mm: the larger of a distance (mm) and of a rotation (deg) at a lever's length."""
    return np.maximum(position, LEVER_MM * np.deg2rad(rotation))


def nominal_poses(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """(n, 4, 4) T_root_flange of the nominal arm at readings (n, R)."""
    variables = robot.mixing @ np.asarray(readings, float).T
    frames = forward(robot, variables)
    return transform(flange_matrices(frames), frames.end_origin.T)


def actual_poses(arm: CalibratedArm, readings: np.ndarray, covariates=None) -> np.ndarray:
    """(n, 4, 4) T_root_flange where the calibrated arm really is at readings (n, R)."""
    model = model_at(arm, readings, nominal_poses(arm.robot, readings), covariates)
    frames = model.evaluate(_parameters(model, arm)).frames
    return transform(flange_matrices(frames), frames.end_origin.T)


def covariates_read(arm: CalibratedArm) -> frozenset[str]:
    """The recorded columns that the correction depends on, apart from joint readings and load."""
    if arm.fitted_range is None:
        return frozenset()
    model, columns = _watched(arm)
    model.residual(_parameters(model, arm))
    return frozenset(columns.read & set(arm.fitted_range))


def considered_covariates(arm: CalibratedArm) -> frozenset[str]:
    """The recorded columns that only considered terms read: they change the uncertainty and not the correction."""
    if arm.considered is None or arm.fitted_range is None:
        return frozenset()
    others = [covariates_read(other) for other, _ in considered_arms(arm)]
    return frozenset().union(*others) - covariates_read(arm)


def _watched(arm: CalibratedArm) -> tuple[Model, "_Recorder"]:
    """The arm at one pose, each recorded column in the middle of its range, and the columns, which note their use."""
    middle = {}
    for name, (low, high) in arm.fitted_range.items():
        middle[name] = np.array([(low + high) / 2])
    model = model_at(arm, np.zeros((1, arm.robot.mixing.shape[1])), np.eye(4)[None], middle)
    columns = _Recorder(model.chain.state.covariates)
    state = replace(model.chain.state, covariates=columns)
    return replace(model, chain=replace(model.chain, state=state), _bases={}), columns


class _Recorder(dict):
    """Covariates that note which of them are read."""

    def __init__(self, columns):
        super().__init__(columns)
        self.read: set[str] = set()

    def __contains__(self, name):
        found = super().__contains__(name)
        self.read.update([name] if found else [])
        return found

    def __getitem__(self, name):
        self.read.add(name)
        return super().__getitem__(name)

    def get(self, name, default=None):
        """The column, noted; `default` where there is none."""
        return self[name] if name in self else default


def model_at(arm, readings, target, covariates) -> Model:
    """The calibrated arm at readings (n, R) rad, mm, measured from its own root against the wanted poses (n, 4, 4)."""
    variables = arm.robot.mixing @ np.asarray(readings, float).T
    n = variables.shape[1]
    covariates = {
        name: np.broadcast_to(np.asarray(v, float), (n,)) for name, v in (covariates or {}).items()
    }
    covariates.setdefault("row", np.full(n, float(arm.rows)))  # after the recording
    covariates = with_history(covariates, arm.robot.joints, n)
    payload = arm.robot.payload_mass + covariates.get("payload_kg", np.zeros(n))
    measurement = ExternalPose(target[:, :3, 3].T.copy(), target[:, :3, :3])
    blank = np.zeros((3, n))
    state = State(
        arm.robot,
        variables,
        covariates,
        arm.robot.gravity,
        payload,
        arm.load_centre,
        blank,
        np.ones(n, int),
        blank,
    )
    unit_sigma = np.ones((6, n))
    return Model(
        RobotChain(arm.robot, measurement, variables, unit_sigma, state, np.zeros(12), unit_sigma),
        arm.acting_effects,
    )


def _parameters(model: Model, arm: CalibratedArm):
    """The calibrated geometry and effects; base and tool are left out, since the flange is asked for in the root."""
    keys = [k for k in model.parameters.keys if k in arm.values and not _is_frame(k)]
    return model.parameters.update({key: arm.values[key] for key in keys})


def _is_frame(key: str) -> bool:
    place, _, name = key.partition(".")
    return place in ("base", "tool", "sensor") and "." not in name


def _pose_deviation(model, arm):
    """(6, n) actual minus wanted pose, and (n,) mm: its largest of place and of turn at a lever's length."""
    residual = model.residual(_parameters(model, arm))
    place = np.linalg.norm(residual[:3], axis=0)
    turn = np.linalg.norm(residual[3:], axis=0)
    return residual, np.maximum(place, LEVER_MM * turn)


def _deviation(model, arm, task) -> np.ndarray:
    """(6, n) mm and rad: actual minus wanted pose, of a deficient arm at the point whose position comes first."""
    if not task.is_deficient:
        return _pose_deviation(model, arm)[0]
    frames = model.evaluate(_parameters(model, arm)).frames
    actual = transform(flange_matrices(frames), frames.end_origin.T)
    measured = model.chain.measurement
    wanted = transform(measured.rotations, measured.measured.T)
    return task_priority.pose_difference(actual, wanted, task.point)


def _reading_step(model, arm, task) -> tuple[np.ndarray, np.ndarray]:
    """(n, R) change of the readings that makes the deviation, and (n,) mm: what of it the joints can move."""
    if not task.is_deficient:
        residual, distance = _pose_deviation(model, arm)
        step = least_squares(arm.robot.mixing, _step(model, arm, residual)).T
        return step, distance
    frames = model.evaluate(_parameters(model, arm)).frames
    deviation = _deviation(model, arm, task)
    return task_priority.joint_part(arm.robot, frames, deviation, task, _reading_weights(arm))


def _step(model, arm, residual):
    """(J, n) change of the joint variables that undoes the residual; effects hardly change over it."""
    rows = model.evaluate(_parameters(model, arm)).joint_rows()
    scale = np.array([1.0, 1, 1, LEVER_MM, LEVER_MM, LEVER_MM])[:, None]
    weight = _joint_weights(arm)
    jacobian = np.transpose(rows * scale, (2, 1, 0)) * weight
    right = (residual * scale).T[..., None]
    # damped: near a singular posture a plain inverse would leap
    damping = 1e-6 * LEVER_MM**2 * 1e-3 * np.eye(arm.robot.joints)
    normal = np.swapaxes(jacobian, 1, 2) @ jacobian + damping
    return (solve_positive(normal, np.swapaxes(jacobian, 1, 2) @ right)[..., 0] * weight).T


def _joint_weights(arm) -> np.ndarray:
    """(J,) how readily a joint variable takes part in a correction: little where it stood still in the recording.

    A slide of a lever's length counts as much as a radian: an arm on a track would else rotate rather than slide.
    """
    has_moved = (np.abs(arm.robot.mixing) @ _moved(arm)) > 0
    comparable = np.where(arm.robot.prismatic, LEVER_MM, 1.0)
    return comparable * np.where(has_moved, 1.0, _STILL_WEIGHT)


def _reading_weights(arm) -> np.ndarray:
    """(R,) how readily a reading takes part in a correction: little where it stood still in the recording."""
    return np.where(_moved(arm), 1.0, _STILL_WEIGHT)


def _moved(arm) -> np.ndarray:
    """(R,) bool: readings that changed in the recording; True where its ranges are unknown."""
    moved = np.ones(arm.robot.mixing.shape[1], bool)
    if arm.fitted_range is None:
        return moved
    for k, name in enumerate(reading_names(arm.robot)):
        low, high = arm.fitted_range.get(name, (-np.inf, np.inf))
        moved[k] = high - low > (_STILL_MM if name.endswith("mm") else np.rad2deg(_STILL_RAD))
    return moved


def _nominal_readings(robot, start, target, anywhere, task):
    """Readings (n, R) of the nominal arm at the wanted poses, from `start`; where that leads beyond limits and any
    posture will do, from other places within them."""
    found, is_reached = search_readings(robot, start, target, task)
    rng = np.random.default_rng(0)
    low, high = np.where(np.isnan(robot.limits), _OPEN, robot.limits).T
    for _ in range(_TRIES if anywhere else 0):
        rows = np.flatnonzero(~is_reached)
        if not rows.size:
            break
        found[rows], is_reached[rows] = search_readings(
            robot, rng.uniform(low, high, (len(rows), len(low))), target[rows], task
        )
    return found


def _turn_reference(arm: CalibratedArm, start: np.ndarray) -> np.ndarray:
    """(n, R) readings whose revolutions count: those to start from, or recorded ones where nobody states a start."""
    is_stated = (start != np.nan_to_num(arm.robot.limits.mean(1))).any(1)
    return np.where(is_stated[:, None], start, recorded_middle(arm))


def search_readings(robot, start, target, task):
    """Readings (n, R) of the nominal arm nearest to the wanted poses, and (n,) whether it may and does get there."""
    bare = CalibratedArm(robot, (), {}, (), np.zeros((0, 0)), np.zeros(3), 0.0, True, "", {})
    found = best = start
    smallest = np.full(len(start), np.inf)
    for _ in range(3 * _STEPS):
        step, movable = _reading_step(model_at(bare, found, target, None), bare, task)
        best = np.where((movable < smallest)[:, None], found, best)
        smallest = np.fmin(movable, smallest)
        if movable.max(initial=0) < 1e-3:
            break
        found = found - np.clip(step, -0.3 * _reach(robot), 0.3 * _reach(robot))
    found = _turned_back(robot, best)
    movable = _reading_step(model_at(bare, found, target, None), bare, task)[1]
    is_reached = (movable < 1e-2) & _is_within_limits(robot, found)
    return found, is_reached


def _turned_back(robot, readings):
    """The readings (n, R) less whole turns where that brings a joint within its limits."""
    low, high = robot.limits.T
    turns = np.round((readings - np.nan_to_num((low + high) / 2)) / (2 * np.pi))
    is_outside = ~sliding(robot) & ((readings < low) | (readings > high))
    return np.where(is_outside, readings - 2 * np.pi * turns, readings)


def _reach(robot):
    """(R,) what a step of one is: a radian, or a hundred mm where the joint slides."""
    return np.where(sliding(robot), 100.0, 1.0)


def _is_within_limits(robot, readings):
    low, high = robot.limits.T
    return (
        (readings >= np.where(np.isnan(low), -np.inf, low))
        & (readings <= np.where(np.isnan(high), np.inf, high))
    ).all(1)


def _sigma(arm, readings, target, covariates) -> np.ndarray:
    """(n,) mm: 1 sigma of the measured point's 3-D place in the world, from the covariance of all parameters.

    Those of considered terms are among them, at the worst value of a column that is missing. And from what empirical
    functions leave open beyond the range that they were fitted on, and from loops of hysteresis whose side is unknown.
    """
    worst = _with_worst_covariates(arm, readings, target, covariates)
    loops = half_loops_mm(arm, readings, covariates)
    return np.hypot(_sigma_at(arm, readings, target, worst), loops)


def half_loops_mm(arm: CalibratedArm, readings: np.ndarray, covariates=None) -> np.ndarray:
    """(n,) mm: half the width of the loops of hysteresis and backlash at the flange, where nobody states the side.

    The joints come from either side independently of one another, so that squares add up.
    """
    squares = np.zeros(len(readings))
    for name in sorted(set(approaches_read(arm.acting_effects)) - set(covariates or {})):
        squares += _squared_loop(arm, readings, covariates or {}, name) / 4
    return np.sqrt(squares)


def _squared_loop(arm: CalibratedArm, readings: np.ndarray, covariates, name: str) -> np.ndarray:
    """(n,) mm^2: squared distance of the flange between both sides of the covariate `name`, an approach."""
    low, high = (
        actual_poses(arm, readings, {**covariates, name: side})[:, :3, 3] for side in (-1.0, 1.0)
    )
    return ((high - low) ** 2).sum(1)


def _sigma_at(arm, readings, target, covariates) -> np.ndarray:
    """(n,) mm: of the mixture of the model and of those with a considered term, see `considered_terms`."""
    model = model_at(arm, readings, target, covariates)
    point = point_uncertainty(model, arm, _recorded_model(arm))
    alone = point.variance
    squares = alone + extrapolation_mm(model, point.parameters, arm) ** 2
    for other, chance in considered_arms(arm):
        wider = model_at(other, readings, target, covariates)
        if is_evaluable(wider.effects, wider.chain.state):
            moved = point_uncertainty(wider, other, _recorded_model(other))
            distance = (point.change_to(moved) ** 2).sum(0)
            squares = squares + chance * (np.maximum(moved.variance - alone, 0.0) + distance)
    return np.sqrt(squares)


def _recorded_model(arm: CalibratedArm) -> Model | None:
    """The arm at recorded readings, other recorded columns in the middle of their range; None where none are stored."""
    if arm.recorded_readings is None or arm.fitted_range is None:
        return None
    middle = {name: sum(ends) / 2 for name, ends in arm.fitted_range.items()}
    considered = () if arm.considered is None else arm.considered.effects
    history = dict.fromkeys(approaches_read((*arm.acting_effects, *considered)), 1.0)
    readings = arm.recorded_readings
    return model_at(arm, readings, nominal_poses(arm.robot, readings), history | middle)


def _with_worst_covariates(arm, readings, target, covariates) -> dict:
    """The covariates with those that considered terms read and nobody states, at the worst end of their ranges.

    The worst is that with the largest sigma, target by target and one column after the other.
    """
    found = dict(covariates or {})
    missing = sorted(considered_covariates(arm) - set(found))
    ends = {
        name: [np.full(len(readings), end) for end in arm.fitted_range[name]] for name in missing
    }
    considered = () if arm.considered is None else arm.considered.effects
    history = set(approaches_read((*arm.acting_effects, *considered))) - set(found) - set(missing)
    found |= {name: low for name, (low, _) in ends.items()} | dict.fromkeys(history, 1.0)
    for name, (low, high) in ends.items():
        at_low = _sigma_at(arm, readings, target, found | {name: low})
        at_high = _sigma_at(arm, readings, target, found | {name: high})
        found[name] = np.where(at_high > at_low, high, low)
    return found
