"""The problem that every library is given: a FANUC LR Mate 200iD, poses, and points with noise."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from datasets.recording import Recording
from robot_model import Robot, load_robot
from robot_model.chain import ALPHA, THETA, A, D, forward
from robot_model.effects.transmission import TransmissionHarmonic
from robot_model.system import RobotChain, bind, geometry_free
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.rigid import rotation_matrix

NOISE = 0.02
"""mm, 1 sigma of a coordinate."""
POINT = np.array([30.0, 20.0, 100.0])
"""mm, the measured point in the flange frame."""
BASE = np.array([5.0, -3.0, 2.0, 0.01, -0.02, 0.015])
"""mm and rotation vector in rad: where the robot stands. Near zero, because figaroh's solve starts there."""


@dataclass(frozen=True)
class Problem:
    """n poses of an arm whose geometry differs from the nominal one, its point measured with noise.

    craig: the arm in Craig's convention with 24 numbers and no beta, which is all that pybotics knows.
    """

    n: int
    craig: bool = False

    @cached_property
    def robot(self) -> Robot:
        robot = load_robot("fanuc_lr_mate_200id")
        return in_craig_order(robot) if self.craig else robot

    @cached_property
    def recording(self) -> Recording:
        """Readings within 85 deg of zero; errors of 2 mrad and 0.3 mm (1 sigma) in every number of a joint."""
        random = np.random.default_rng(self.n)
        readings = random.uniform(-1.5, 1.5, (self.n, 6))
        error = np.zeros((6, 5))
        error[:, [THETA, ALPHA]] = random.normal(0, 2e-3, (6, 2))
        error[:, [D, A]] = random.normal(0, 0.3, (6, 2))
        base = rotation_matrix(BASE[3:]), BASE[:3]
        frames = forward(
            self.robot, self.robot.mixing @ readings.T, self.robot.geometry + error, base
        )
        points = frames.point(POINT).T + random.normal(0, NOISE, (self.n, 3))
        columns = {f"q{k + 1}_deg": np.rad2deg(column) for k, column in enumerate(readings.T)}
        columns |= {f"{axis}_mm": column for axis, column in zip("xyz", points.T)}
        arm = {"builtin": "fanuc_lr_mate_200id"}
        return Recording("external-point", columns, arm, sigma_mm=NOISE, name="benchmark")

    @cached_property
    def chain(self) -> RobotChain:
        return bind(self.robot, self.recording)

    @cached_property
    def model(self) -> Model:
        return Model(self.chain)

    @property
    def variables(self) -> np.ndarray:
        """(6, n) joint variables, rad: the coupling of joints 2 and 3 is resolved."""
        return self.chain.variables

    @property
    def points(self) -> np.ndarray:
        """(n, 3) measured, mm."""
        return self.recording.points

    def free30(self, model: Model) -> Parameters:
        """Base (6) and four numbers a joint (24); the measured point is known."""
        known = {f"tool.reflector1_{axis}": value for axis, value in zip("xyz", POINT.tolist())}
        return model.parameters.update(known).free("base.*", *geometry_free(self.robot))

    def model60(self) -> Model:
        """With cos and sin of 1 and 2 cycles per revolution at every joint, of 3 cycles at three: 30 more."""
        places = [(k, order) for order in (1, 2) for k in range(1, 7)] + [(k, 3) for k in (1, 2, 3)]
        return self.model.with_effects(
            *(TransmissionHarmonic(f"joint-{k}", order) for k, order in places)
        )

    def free60(self, model: Model) -> Parameters:
        return self.free30(model).free("*.transmission-harmonic.*")


def modified_rows(robot: Robot) -> np.ndarray:
    """(6, 4) alpha, a, theta, d in Craig's order: each joint begins with the twist and length of the one before."""
    if robot.convention == "craig":
        return robot.geometry[:, [ALPHA, A, THETA, D]]
    rows = np.zeros((robot.joints, 4))
    rows[1:, 0], rows[1:, 1] = robot.geometry[:-1, ALPHA], robot.geometry[:-1, A]
    rows[:, 2], rows[:, 3] = robot.geometry[:, THETA], robot.geometry[:, D]
    return rows


def last_twist(robot: Robot) -> np.ndarray:
    """(4, 4) what Craig's order leaves for after the last joint: its length and twist, mm."""
    if robot.convention == "craig":
        return robot.flange.copy()
    alpha = robot.geometry[-1, ALPHA]
    after = np.eye(4)
    after[1:3, 1:3] = [[np.cos(alpha), -np.sin(alpha)], [np.sin(alpha), np.cos(alpha)]]
    after[0, 3] = robot.geometry[-1, A]
    return after


def in_craig_order(robot: Robot) -> Robot:
    """The same arm in Craig's convention."""
    geometry = np.zeros((robot.joints, 5))
    geometry[:, [ALPHA, A, THETA, D]] = modified_rows(robot)
    parallel = np.zeros(robot.joints, bool)
    return replace(
        robot, convention="craig", geometry=geometry, hayati=parallel, flange=last_twist(robot)
    )


def rms(residual: np.ndarray) -> float:
    """3-D RMS, mm, of residuals (3, n)."""
    return float(np.sqrt((residual**2).sum(0).mean()))
