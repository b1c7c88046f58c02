"""A robot bound to measured samples: the chain that `workbench.core` solves."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from robot_model import chain as kinematics
from robot_model.chain import BETA, D, forward
from robot_model.measurements import end_recordings, measurement_of
from robot_model.measurements.ball_scan import FILE_KIND, KIND
from robot_model.poses import pose_parameters
from robot_model.robot import Robot
from robot_model.state import State, moved
from workbench.core.effect import NUMBERED
from workbench.core.errors import InputError
from workbench.core.parameters import Parameter, Parameters
from workbench.core.rigid import left_jacobian, rotation_matrix
from workbench.core.vocabulary import Place

_GEOMETRY = (
    ("theta", "rad", 0.01, "zero offset (theta)"),
    ("d", "mm", 1.0, "offset (d)"),
    ("a", "mm", 1.0, "length (a)"),
    ("alpha", "rad", 0.01, "twist (alpha)"),
    ("beta", "rad", 0.01, "parallelism (beta)"),
)
_BASE = 6


@dataclass(frozen=True)
class RobotChain:
    """Robot, measurement and n samples; implements `workbench.core.model.Chain`.

    A kind of measurement that is `grounded` knows no world but the robot's root, and so no base pose.

    `variables` (J, n) joint variables (rad, mm) after sign and coupling; `sigma` (m, n);
    `start` (6 + t,) closed-form base pose and tool, which also place the load. `stated_sigma` is
    what the recording says, 1 where `sigma_unknown`; a calibration widens `sigma` by what its
    model does not explain.
    """

    robot: Robot
    measurement: object
    variables: np.ndarray
    sigma: np.ndarray
    state: State
    start: np.ndarray
    stated_sigma: np.ndarray
    sigma_unknown: bool = False

    @cached_property
    def parameters(self) -> Parameters:
        """base (6), geometry (5 J) and the measurement's own, started in closed form."""
        base = pose_parameters("base", "base") if self.base_size else []
        parameters = Parameters.of(
            [*base, *_geometry_parameters(self.robot), *self.measurement.parameters()]
        )
        values = parameters.values.copy()
        size = self.base_size
        values[:size] = self.start[:size]
        values[size + 5 * self.robot.joints :] = self.start[size:]
        return replace(parameters, values=values)

    @property
    def base_size(self) -> int:
        """Number of parameters that say where the base stands: 6, or 0 where the base is the world."""
        return 0 if self.measurement.grounded else _BASE

    @property
    def n(self) -> int:
        return self.variables.shape[1]

    @property
    def poses_per_sample(self) -> int:
        """Number of columns of `variables` and `state` for one sample: all first ends before all second ones."""
        return getattr(self.measurement, "poses_per_sample", 1)

    @cached_property
    def cosines_and_sines(self) -> tuple[np.ndarray, np.ndarray]:
        """(J, n) cosines and sines of the joint variables, which every evaluation needs."""
        return np.cos(self.variables), np.sin(self.variables)

    def columns_of(self, samples: np.ndarray) -> np.ndarray:
        """Return the index of the columns of `variables` and `state` that make some samples."""
        return _columns_of(samples, self.poses_per_sample, self.n)

    def at(self, samples: np.ndarray) -> "RobotChain":
        """The same robot and start on some of the samples."""
        seen = self.columns_of(samples)
        covariates = {k: v[seen] for k, v in self.state.covariates.items()}
        state = replace(
            self.state,
            variables=self.state.variables[:, seen],
            covariates=covariates,
            payload=self.state.payload[seen],
            measured=self.state.measured[:, seen],
            index=self.state.index[seen],
            target=self.state.target[:, seen],
            history=self.state.history and self.state.history.at(seen),
        )
        measurement = self.measurement.at(samples)
        return replace(
            self,
            measurement=measurement,
            variables=self.variables[:, seen],
            sigma=self.sigma[:, samples],
            state=state,
            stated_sigma=self.stated_sigma[:, samples],
        )

    def evaluate(self, values: np.ndarray, deltas: dict) -> "Evaluation":
        """Residual and port derivatives at the chain's own `values` and the effects' `deltas`."""
        return Evaluation(self, values, deltas)

    def numbers(self, place: str) -> tuple[int, ...]:
        """The numbers that `joint-K`, `link-K`, `ball-K` or `reflector-K` may have here."""
        if place in ("ball", "reflector"):
            return tuple(getattr(self.measurement, "ids", (1,)))
        return tuple(range(1, self.robot.joints + 1))

    def slides(self, joint: int) -> bool:
        """Whether joint K (from 1) is prismatic."""
        return bool(self.robot.prismatic[joint - 1])

    def places(self, kind: str) -> tuple[str, ...]:
        """List the places that an effect may name here: joint-1 to joint-J, or base; () where there is none."""
        if kind in ("sensor", "artefact", "ball") and self.measurement.place != "sensor":
            return ()
        if kind in ("instrument", "reflector") and (
            self.measurement.place != "tool" or self.measurement.grounded
        ):
            return ()
        if kind in NUMBERED:
            return tuple(f"{kind}-{number}" for number in self.numbers(kind))
        return (kind,)

    @cached_property
    def has_sight_lines(self) -> bool:
        """Whether an instrument can stand at the origin of the measured points: outside the space in which they lie.

        Where the points were transformed, to the frame of the robot say, its place is not known.
        """
        if not self.places("instrument"):
            return False
        points = self.state.measured
        root = self.start[:3]
        from_root = np.linalg.norm(points - root[:, None], axis=0)
        is_outside = np.linalg.norm(root) > 0.5 * np.median(from_root)
        return bool(is_outside and (points.mean(1) @ points).min() > 0)

    def varies(self, covariate: str) -> bool:
        """Whether a covariate is known for the samples and is not constant."""
        values = self.state.covariates.get(covariate)
        return values is not None and bool(np.ptp(values) > 0)

    def port_indices(
        self, port: str, where: str, components: tuple[int, ...] = ()
    ) -> tuple[int, ...]:
        """Row numbers of a port at a place of the vocabulary; all components where none are named."""
        place = Place.of(where)
        width = {"joint": 1, "geometry": 5, "frame": 6, "mass": 3}.get(port)
        if width is None or where == "time":
            return components or tuple(range(self.robot.joints if port == "joint" else 3))
        first = {"geometry": 0, "joint": 0, "mass": 0, "frame": 1}[port]
        end = {"base": 0, "tool": self.robot.joints + first}
        if place.number is not None and place.number > self.robot.joints:
            raise InputError(
                f"there is no '{where}': {self.robot.name} has {self.robot.joints} joints; correct it"
            )
        if place.number is None:
            row = end[where]
        else:
            row = place.number - 1 + first
        return tuple(width * row + c for c in components or range(width))

    def split(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Base pose (6,), geometry (J, 5) and the measurement's own values."""
        base = self.base_size
        end = self.base_size + 5 * self.robot.joints
        return (
            values[:base] if base else np.zeros(_BASE),
            values[base:end].reshape(-1, 5),
            values[end:],
        )

    def to_root(
        self, values: np.ndarray, evaluation: "Evaluation", residual: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The measured points and residuals (3, n) mm, as arrows, in the robot's root frame."""
        pose = self.split(values)[0]
        turn = rotation_matrix(pose[3:])
        arrows = evaluation.closure.to_world(residual[: len(evaluation.residual)])
        points = evaluation.closure.point[:, : residual.shape[1]]  # of a length, its first end
        return turn.T @ (points - pose[:3, None]), turn.T @ arrows

    def moved_variables(self, deltas: dict) -> np.ndarray:
        """(J, n) joint variables with the deltas of the joints, which go through what their drives move."""
        if "joint" not in deltas:
            return self.variables
        drives, change = deltas["joint"]
        if self.robot.coupling is not None:
            return self.variables + self.robot.coupling[:, drives] @ change
        variables = self.variables.copy()
        variables[drives] += change
        return variables

    def frames(self, values: np.ndarray, deltas: dict) -> tuple[kinematics.Frames, dict]:
        """Frames in the world with all deltas of joints, geometry and frames; and the twists."""
        pose, geometry, _ = self.split(values)
        variables = self.moved_variables(deltas)
        twists = _twists(deltas)
        trigonometry = None if "joint" in deltas else self.cosines_and_sines
        if "geometry" in deltas:
            port_indices, change = deltas["geometry"]
            geometry = np.repeat(geometry.reshape(-1, 1), self.n, 1)
            geometry[port_indices] += change
            geometry = geometry.reshape(self.robot.joints, 5, self.n)
        base = rotation_matrix(pose[3:]), pose[:3]
        frames = forward(self.robot, variables, geometry, base, twists, bool(twists), trigonometry)
        return frames, twists


class Evaluation:
    """The chain at one set of values; rows are made on demand, only those that are asked for."""

    def __init__(self, chain: RobotChain, values: np.ndarray, deltas: dict):
        self.chain, self.values, self.deltas = chain, values, deltas
        self.frames, self.twists = chain.frames(values, deltas)
        self.closure = chain.measurement.close(self.frames, chain.split(values)[2], deltas)
        self.residual = self.closure.residual

    def own_rows(self, indices: np.ndarray) -> np.ndarray:
        """(k, m, n) derivative of the residual with respect to the chain's own parameters."""
        base = self.chain.base_size
        end = base + 5 * self.chain.robot.joints
        rows = np.empty((len(indices), *self.residual.shape))
        is_base, is_tool = indices < base, indices >= end
        is_geometry = ~(is_base | is_tool)
        first = is_base.sum()
        last = len(indices) - is_tool.sum()
        if is_base.any():
            rows[:first] = self._base_rows()[indices[is_base]]
        if is_geometry.any():
            rows[first:last] = self.rows("geometry", indices[is_geometry] - base)
        if is_tool.any():
            rows[last:] = self.closure.tool_rows[indices[is_tool] - end]
        return rows

    def rows(self, port: str, port_indices: np.ndarray) -> np.ndarray:
        """(k, m, n) derivative of the residual with respect to components of a port."""
        port_indices = np.asarray(port_indices)
        if port in self.closure.port_rows:
            return self.closure.port_rows[port][port_indices]
        robot, frames, point = self.chain.robot, self.frames, self.closure.point
        if port == "joint" and robot.coupling is not None:
            by_joint = self.joint_rows()
            return np.tensordot(robot.coupling[:, port_indices].T, by_joint, 1)
        if port == "joint":
            port_indices = 5 * port_indices + np.where(robot.prismatic[port_indices], D, 0)
        if port in ("joint", "geometry"):
            moved = kinematics.geometry_rows(robot, frames, point, port_indices)
            rotations = kinematics.geometry_rotations
            return self._mapped(moved, lambda: rotations(frames, port_indices))
        frames = self._with_links()
        moved = kinematics.frame_rows(frames, point, port_indices, self.twists)
        return self._mapped(
            moved, lambda: kinematics.frame_rotations(frames, port_indices, self.twists)
        )

    def joint_rows(self) -> np.ndarray:
        """(J, m, n) derivative of the residual with respect to every joint variable, whatever its drive moves."""
        robot = self.chain.robot
        return self.rows("geometry", 5 * np.arange(robot.joints) + np.where(robot.prismatic, D, 0))

    def _with_links(self):
        """Frames that also keep the links; made again only when no twist needed them before."""
        if self.frames.link is None:
            pose, geometry, _ = self.chain.split(self.values)
            frames = self.chain.frames(
                self.values, self.deltas | {"frame": (np.array([0]), np.zeros((1, self.chain.n)))}
            )
            self.frames = frames[0]
        return self.frames

    def _base_rows(self):
        pose = self.chain.split(self.values)[0]
        rotation_rows = left_jacobian(pose[3:]).T[:, :, None]
        shifts = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, self.chain.n))
        rotated = kinematics.cross(
            np.broadcast_to(rotation_rows, (3, 3, self.chain.n)),
            self.closure.point - pose[:3, None],
        )
        moved = np.concatenate([shifts, rotated])
        return self._mapped(
            moved,
            lambda: np.concatenate([shifts * 0, np.broadcast_to(rotation_rows, shifts.shape)]),
        )

    def _mapped(self, moved, rotations: Callable):
        """Derivatives of the residual from those of the point and, if the measurement needs them, its rotations."""
        rows = self.closure.map_rows(moved)
        if self.closure.map_rotations is None:
            return rows
        return rows + self.closure.map_rotations(rotations())


def _twists(deltas) -> dict[int, np.ndarray]:
    """place -> (6, n) from the frame port's components."""
    if "frame" not in deltas:
        return {}
    port_indices, change = deltas["frame"]
    twists: dict[int, np.ndarray] = {}
    for port_index, row in zip(port_indices, change):
        twists.setdefault(port_index // 6, np.zeros((6, change.shape[1])))[port_index % 6] = row
    return twists


def _geometry_parameters(robot: Robot) -> list[Parameter]:
    return [
        Parameter(
            f"joint-{k + 1}.{name}{k + 1}",
            unit,
            float(robot.geometry[k, c]),
            size,
            f"joint {k + 1}'s {words}",
            3 * size,
        )
        for k in range(robot.joints)
        for c, (name, unit, size, words) in enumerate(_GEOMETRY)
    ]


def geometry_priors(robot: Robot) -> dict[str, tuple[float, float]]:
    """Nominal value and prior standard deviation (rad, mm) of every geometric parameter, by key."""
    return {
        parameter.key: (parameter.null, parameter.prior)
        for parameter in _geometry_parameters(robot)
    }


def geometry_free(robot: Robot) -> list[str]:
    """Keys of the geometry that can be free: theta, d, a, alpha; beta instead of d where Hayati's."""
    left_out = [D if hayati else BETA for hayati in robot.hayati]
    return [
        f"joint-{k + 1}.{row[0]}{k + 1}"
        for k in range(robot.joints)
        for c, row in enumerate(_GEOMETRY)
        if c != left_out[k]
    ]


def redundant_geometry(robot: Robot) -> list[str]:
    """Keys of the geometry that the convention replaces by others: beta, or d where the next axis is parallel.

    Three rotations and two lengths place a joint axis only up to a slide along it and a rotation about it, so
    that four of a joint's five numbers suffice (Hayati & Mirmirani 1985).
    """
    free = set(geometry_free(robot))
    all_keys = (f"joint-{k + 1}.{row[0]}{k + 1}" for k in range(robot.joints) for row in _GEOMETRY)
    return [key for key in all_keys if key not in free]


def held_by_convention(robot: Robot) -> list[str]:
    """Keys of the offsets d that Hayati's beta stands in for: along parallel axes only their sum shows, in the next d.

    They are not free. In null-space queries together with the free ones they give the explanation in words.
    """
    return [
        f"joint-{k + 1}.d{k + 1}"
        for k in range(robot.joints)
        if robot.hayati[k] and not robot.prismatic[k]
    ]


def bind(
    robot: Robot,
    recording,
    start: np.ndarray | None = None,
    start_on: np.ndarray | slice = slice(None),
) -> RobotChain:
    """The chain for the moving rows of a recording.

    start: base pose (6,) and the measurement's own values; found in closed form at the nominal
    geometry, from the samples `start_on` (n,) alone, where it is not given.
    Raises InputError where readings do not fit the robot.
    """
    measurement = measurement_of(recording)
    if recording.joints.shape[1] != robot.mixing.shape[1]:
        raise InputError(
            f"recording '{recording.name}': {recording.joints.shape[1]} joint readings a sample, but robot "
            f"'{robot.name}' has {robot.mixing.shape[1]} joints; correct samples.csv or robot.toml"
        )
    ends = end_recordings(recording)
    variables = np.concatenate([robot.mixing @ end.joints.T for end in ends], 1)
    if start is None:
        frames = forward(robot, variables[:, _columns_of(start_on, len(ends), variables.shape[1])])
        if hasattr(measurement, "oriented"):
            measurement = replace(
                measurement, facing=measurement.at(start_on).oriented(frames).facing
            )
        start = np.concatenate(measurement.at(start_on).start(frames))
    tool = start if measurement.grounded else start[_BASE:]
    state = _state(robot, ends, variables, measurement, tool)
    state = replace(state, root_rotation=root_rotation(measurement, start))
    sigma = _checked_sigma(measurement.sigma(recording), recording.name)
    return RobotChain(
        robot, measurement, variables, sigma, state, start, sigma, recording.sigma is None
    )


def root_rotation(measurement, start: np.ndarray) -> np.ndarray:
    """(3, 3) rotation from the robot's root frame to the external one, as the start has placed the base."""
    if measurement.grounded:
        return np.eye(3)
    return rotation_matrix(start[3:_BASE])


def _checked_sigma(sigma: np.ndarray, name: str) -> np.ndarray:
    """sigma (m, n) where every entry is a positive number; InputError otherwise, since residuals are divided by it."""
    wrong = ~(np.isfinite(sigma) & (sigma > 0)).all(0)
    if wrong.any():
        row = int(np.argmax(wrong))
        found = sigma[:, row][~(np.isfinite(sigma[:, row]) & (sigma[:, row] > 0))][0]
        raise InputError(
            f"recording '{name}', sample row {row + 1}: expected a standard deviation of the measurement above 0, "
            f"found {found:g}; correct sigma_mm or sigma_deg, or leave it out where it is unknown"
        )
    return sigma


def _columns_of(samples, poses_per_sample: int, columns: int):
    """Return the column index of some samples, given as a mask, indices or a slice."""
    if poses_per_sample == 1:
        return samples
    return np.arange(columns).reshape(poses_per_sample, -1)[:, samples].ravel()


def row_instants(poses: np.ndarray) -> np.ndarray:
    """(n,) clock of the points of scans without a recorded time: the number of the row, from 0, that begins a pose.

    poses (n,): labels. The points of a scan are simultaneous: nothing moves between two of them.
    """
    is_first = np.append(True, poses[1:] != poses[:-1])[: len(poses)]
    return np.maximum.accumulate(np.where(is_first, np.arange(len(poses)), 0)).astype(float)


def _state(robot, ends, variables, measurement, tool) -> State:
    """Build the state that effects read; a load without a known centre acts at the measured point."""
    covariates_of_ends = [end.covariates for end in ends]
    covariates = {
        name: np.concatenate([columns[name] for columns in covariates_of_ends])
        for name in covariates_of_ends[-1]
    }
    rows = np.arange(ends[0].n, dtype=float)
    if ends[0].measures in (FILE_KIND, KIND):
        rows = row_instants(ends[0].poses)
    covariates.setdefault("row", np.tile(rows, len(ends)))
    history = None
    if len(ends) == 1:  # two ends of a length have no order
        time = covariates.get("time_s", covariates["row"])
        moves, history = moved(robot, robot.drive_motion(variables), time, ends[0].poses)
        covariates |= moves
    payload = robot.payload_mass + covariates.get("payload_kg", np.zeros(variables.shape[1]))
    if robot.payload_mass > 0 or robot.payload_com.any():
        centre = robot.payload_com
    else:
        centre = tool[:3]
    seen = measurement.measured, measurement.numbers, measurement.targets(tool)
    return State(
        robot, variables, covariates, robot.gravity, payload, centre, *seen, history=history
    )
