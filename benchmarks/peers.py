"""The other libraries, given the same arm and the same points: pybotics and Pinocchio."""

import time

import numpy as np
import pinocchio as pin
from pybotics.optimization import OptimizationHandler, optimize_accuracy
from pybotics.robot import Robot as PyboticsRobot
from scipy.optimize import least_squares
from scipy.optimize._numdiff import approx_derivative
from scipy.spatial.transform import Rotation

from benchmarks.problem import Problem, last_twist, modified_rows


class Pybotics:
    """pybotics with 24 numbers of the arm and 6 of its base free, and the start of ours.

    base: mm and rotation vector in rad; the arm is nominal. point: mm, flange frame.
    """

    def __init__(
        self, problem: Problem, base: np.ndarray | None = None, point: np.ndarray | None = None
    ):
        base = np.zeros(6) if base is None else base
        point = np.zeros(3) if point is None else point
        self.q, self.points = problem.variables.T.copy(), problem.points
        robot = PyboticsRobot.from_parameters(modified_rows(problem.robot))
        robot.tool.matrix, robot.world_frame = last_twist(problem.robot), _world(base)
        robot.tool.matrix[:3, 3] += robot.tool.matrix[:3, :3] @ point
        self.handler = OptimizationHandler(robot, kinematic_chain_mask=True, world_mask=True)
        self.start = self.handler.generate_optimization_vector()

    def forward(self) -> np.ndarray:
        """(n, 3) end of the arm, one call a pose: pybotics has no other way."""
        return np.array([self.handler.robot.fk(q)[:3, 3] for q in self.q])

    def distances(self, x: np.ndarray) -> np.ndarray:
        """(n,) its own objective: the length of each residual."""
        return optimize_accuracy(x, self.handler, self.q, self.points)

    def vectors(self, x: np.ndarray) -> np.ndarray:
        """(3 n,) what its objective should have been: the residual itself, from its own poses."""
        self.handler.apply_optimization_vector(x)
        fk = self.handler.robot.fk
        return np.concatenate([fk(q)[:3, 3] - point for q, point in zip(self.q, self.points)])

    def jacobian(self) -> np.ndarray:
        """(n, 30) as scipy's least_squares makes it from pybotics' objective: 2-point differences."""
        return approx_derivative(self.distances, self.start, method="2-point")

    def fit(self, objective, seconds: float = np.inf, enough: float = 0.0) -> tuple[float, float]:
        """Processor seconds until the 3-D RMS (mm) falls to `enough`, or until scipy or the time ends; and that RMS."""
        watch = _Watch(objective, len(self.points), seconds, enough)
        try:
            least_squares(watch, self.start, x_scale="jac")
        except _Enough:
            pass
        return time.process_time() - watch.began, watch.least


class _Enough(Exception):
    """The answer is good enough, or it takes too long."""


class _Watch:
    """An objective that remembers its least RMS and ends the solve."""

    def __init__(self, objective, n, seconds, enough):
        self.objective, self.n, self.seconds, self.enough = objective, n, seconds, enough
        self.least, self.began = np.inf, time.process_time()

    def __call__(self, x):
        residual = self.objective(x)
        self.least = min(self.least, float(np.sqrt((residual**2).sum() / self.n)))
        if self.least <= self.enough or time.process_time() - self.began > self.seconds:
            raise _Enough
        return residual


def _world(start):
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = Rotation.from_rotvec(start[3:6]).as_matrix(), start[:3]
    return frame


def pinocchio_model(
    problem: Problem, millimetre: float = 1.0, point: np.ndarray | None = None
) -> pin.Model:
    """The arm with a frame `tool` at `point` (mm, flange frame); lengths in units of `millimetre`."""
    model, parent = pin.Model(), 0
    for k, (alpha, a, theta, d) in enumerate(modified_rows(problem.robot), start=1):
        before = pin.SE3(pin.utils.rotate("x", alpha), np.array([a * millimetre, 0, 0]))
        place = before * pin.SE3(pin.utils.rotate("z", theta), np.array([0, 0, d * millimetre]))
        # the limits are those between which figaroh draws poses
        limits = np.full(1, 1e3), np.full(1, 1e3), np.full(1, -3.0), np.full(1, 3.0)
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"j{k}", *limits)
        model.addJointFrame(parent)
    after = last_twist(problem.robot)
    reach = after @ np.append(np.zeros(3) if point is None else point, 1)
    tool = pin.SE3(after[:3, :3].copy(), reach[:3] * millimetre)
    model.addFrame(pin.Frame("tool", parent, tool, pin.FrameType.OP_FRAME))
    return model


def pinocchio_forward(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """(n, 3) tool of poses q (n, 6), in a loop: Pinocchio's Python takes one pose a call."""
    data, tool = model.createData(), model.getFrameId("tool")
    points = np.empty((len(q), 3))
    for k, pose in enumerate(q):
        pin.framesForwardKinematics(model, data, pose)
        points[k] = data.oMf[tool].translation
    return points


def pinocchio_regressor(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """(12, 3, n) derivative of the tool's position, base frame: of d and theta of joints 1 to 6 in turn.

    Pinocchio's frame kinematic regressor holds, for every joint, the motion of the tool by a small twist of the
    joint's placement; the third and the sixth column are along and about its own z.
    """
    data, tool = model.createData(), model.getFrameId("tool")
    reference = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    rows = np.empty((len(q), 6 * model.nq, 3))
    for k, pose in enumerate(q):
        pin.framesForwardKinematics(model, data, pose)
        rows[k] = pin.computeFrameKinematicRegressor(model, data, tool, reference)[:3].T
    along_and_about_z = np.arange(model.nq)[:, None] * 6 + [2, 5]
    return rows[:, along_and_about_z.ravel()].transpose(1, 2, 0)
