"""Robust fit of base, tool and plausible geometry errors: the yardstick of every plausibility check.

The geometry of the robot file has a normal prior of data-sheet size, so that "what plausible geometry errors
explain" is a statement of probability. The noise scale is estimated with the fit (iteratively reweighted least
squares with Cauchy weights; Huber & Ronchetti, Robust Statistics, 2nd ed., ch. 7): while the misfit is large the
prior holds the geometry, and once the misfit is small the data decide.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.recording import Recording
from datasets.samples.columns import POINT
from robot_model.chain import forward
from robot_model.measurements import measurement_of
from robot_model.measurements.multistart import MODEL_ERROR_MM, RotationSystem, quick_distances
from robot_model.poses import pose_parameters
from robot_model.robot import Robot
from robot_model.system import bind, geometry_free
from workbench.core.distributions import chi2
from workbench.core.errors import InputError
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.fitting.calibration_plans.plans import frames_of

POSITION = 3
"""Components of a residual that are lengths in mm; further ones are rotations in rad."""
CAUCHY = 2.5
LEAST_SCALE = 0.005  # mm: below it nothing depends on the ratio of prior to data any more
_KEPT = 0.9
MEDIAN_CHI2 = {m: float(chi2.ppf(0.5, m)) for m in range(1, 7)}
_LEAST_SPARE = 6.0
_BATCH_SIZE = 256
"""Hypotheses whose scales are found together: some tens of megabytes."""
FAILURES = (np.linalg.LinAlgError, InputError, ValueError)
"""What a hypothesis about which nothing can be said raises."""
EXPLAINED = 0.05
"""Share of the scatter of the points that a model which explains them leaves as misfit at most.

It holds whatever the accuracy of the arm: errors of 5 to 30 mm leave 0.5 to 4 %, and mistakes in columns or in lengths
of the robot file more than 7 %.
"""
_HOPELESS = 0.5  # of the RMS distance of the tool from its mean place
_TOOL_MM = 200.0
_LENGTH_ERROR = 0.001  # of the reach
_LEAST_LENGTH_ERROR, _ZERO_OFFSET, _TWIST = 1.0, np.deg2rad(1.0), np.deg2rad(0.4)


@dataclass(frozen=True)
class Fit:
    """Base, tool and geometry of one recording under one hypothesis, n samples, m residual components.

    `mismatch` (n,) mm: length of a sample's residual, rotations times `lever` mm. `scale` mm: RMS of the best 90 %
    of `mismatch`, corrected for the degrees of freedom; inf where too few are left. `core` mm: the same from the
    median, so that up to half of the rows may be wrong. `position_mm`, `rotation_deg`: RMS of the same best rows,
    `rotation_deg` nan where orientation is not measured. `deviations` (F,): free parameters less their prior mean,
    in prior standard deviations, 0 where there is no prior. `degrees`: of freedom that are left.
    """

    model: Model
    parameters: Parameters
    residual: np.ndarray
    mismatch: np.ndarray
    scale: float
    core: float
    position_mm: float
    rotation_deg: float
    deviations: np.ndarray
    degrees: float

    @property
    def improbability(self) -> float:
        """Negative log posterior up to a constant, the noise scale at its estimate."""
        return self.degrees * np.log(max(self.scale, LEAST_SCALE)) + (self.deviations**2).sum() / 2


def reach_of(robot: Robot, recording) -> float:
    """Sum of the nominal lengths and offsets, with the longest travel of sliding joints, mm."""
    travel = np.abs(robot.mixing @ recording.joints.T).max(1)[robot.prismatic]
    return float(np.abs(robot.geometry[:, 1:3]).sum() + travel.sum())


def scatter_of_points(recording) -> float:
    """RMS distance of the best 90 % of the measured points from their median, mm, at least 1e-9.

    nan where no coordinates are measured.
    """
    if not set(POINT) <= set(recording.columns):
        return np.nan
    points = np.stack([recording.columns[name] for name in POINT])
    squares = np.sort(((points - np.median(points, axis=1, keepdims=True)) ** 2).sum(0))
    nearest = squares[: max(int(np.ceil(_KEPT * len(squares))), 1)]
    return max(float(np.sqrt(nearest.mean())), 1e-9)


def flange_scatter(robot: Robot, recording) -> float:
    """RMS distance of the flange of the nominal arm from its mean place, mm."""
    places = forward(robot, robot.mixing @ recording.joints.T).end_origin
    return float(np.sqrt(((places - places.mean(1, keepdims=True)) ** 2).sum(0).mean()))


def unexplainable_misfit_mm(robot: Robot, recording) -> float:
    """mm of misfit with the nominal geometry above which plausible geometry errors cannot be the reason.

    Errors of the size of `geometry_prior`, base and tool fitted, displace a tool by a few percent of the RMS distance
    from its mean place; rows that do not belong together leave more than that distance. The tool is as long as
    `_TOOL_MM`, so that rotations of the flange alone count, too.
    """
    frames = forward(robot, robot.mixing @ recording.joints.T)
    vectors = [frames.end_origin, *(_TOOL_MM * axis for axis in frames.end)]
    variance = sum(np.var(vector, axis=1).sum() for vector in vectors)
    return _HOPELESS * float(np.sqrt(variance))


def lever_of(robot: Robot, recording) -> float:
    """Length by which a rotation (rad) is made comparable with a position error, mm: a quarter of the reach."""
    return max(reach_of(robot, recording) / 4, 50.0)


def geometry_prior(robot: Robot, recording, parameters: Parameters) -> np.ndarray:
    """(P,) prior standard deviation of the geometry parameters, mm or rad; inf for all others."""
    length = max(_LEAST_LENGTH_ERROR, _LENGTH_ERROR * reach_of(robot, recording))
    sizes = np.full(len(parameters), np.inf)
    for k, p in enumerate(parameters.table):
        if p.key.startswith("joint-"):
            angle = _ZERO_OFFSET if ".theta" in p.key else _TWIST
            sizes[k] = angle if p.unit == "rad" else length
    return sizes


def fit_recording(robot, recording, start=None, free=None, widen=(), steps=14) -> Fit:
    """The robust fit of a recording.

    start: values (P,) of all parameters, for example of another fit; None: in closed form. free: shell
    patterns of the parameters to estimate; None: base, tool and geometry. widen: patterns of geometry
    parameters that are estimated without a prior.
    Raises numpy.linalg.LinAlgError where a start cannot be computed.
    """
    model, parameters = model_at(robot, recording, start)
    if free is None:
        patterns = (*frames_of(parameters), *geometry_free(robot))
    else:
        patterns = free
    mask = parameters.matching(*patterns, *widen)
    prior = geometry_prior(robot, recording, parameters)
    if widen:
        prior = np.where(parameters.matching(*widen), np.inf, prior)
    problem = _Problem(
        model, parameters.only(mask), 1 / prior[mask] ** 2, lever_of(robot, recording)
    )
    return problem.solve(steps)


def model_at(robot, recording, values=None) -> tuple[Model, Parameters]:
    """The model of a recording and its parameters, with `values` (P,) where given.

    Raises numpy.linalg.LinAlgError where the values belong to a recording with other targets.
    """
    if values is None:
        model = Model(bind(robot, recording))
        return model, model.parameters
    measurement = measurement_of(recording)
    base = 0 if measurement.grounded else 6
    if len(values) != base + 5 * robot.joints + len(measurement.parameters()):
        raise np.linalg.LinAlgError("values of a recording with other reflectors or balls")
    start = np.concatenate([values[:base], values[base + 5 * robot.joints :]])
    chain = bind(robot, recording, start)
    model = Model(chain)
    parameters = replace(model.parameters, values=np.array(values, float))
    return model, parameters


def nominal_scale(robot, recording) -> float:
    """RMS mm of the best 90 % of the samples with base and tool fitted at the nominal geometry; inf for too few.

    Rotations count by the lever of `robot_model.measurements.multistart`. Fast: one linear system, few starts.
    """
    system = _nominal_system(robot, recording)
    if system is None:
        return fit_recording(robot, recording, free=base_and_tool(recording), steps=3).scale
    if _is_spare(system):
        return _scale_of(system, system.quick_distances())
    return np.inf


def nominal_scales(cases: Sequence[tuple[Robot, Recording]]) -> list[float]:
    """`nominal_scale` of many hypotheses about robot and recording, in less time; inf where it cannot be had."""
    scales: list[float] = []
    for first in range(0, len(cases), _BATCH_SIZE):
        scales += _scales_of_some(cases[first : first + _BATCH_SIZE])
    return scales


def _scales_of_some(cases: Sequence[tuple[Robot, Recording]]) -> list[float]:
    scales = [np.inf] * len(cases)
    systems = {}
    for k, case in enumerate(cases):
        try:
            system = _nominal_system(*case)
            if system is None:
                scales[k] = nominal_scale(*case)
            elif _is_spare(system):
                systems[k] = system
        except FAILURES:
            continue
    for k, distances in zip(systems, _distances_of(list(systems.values()))):
        scales[k] = _scale_of(systems[k], distances)
    return scales


def _distances_of(systems: list[RotationSystem]) -> list[np.ndarray]:
    """Distances (n,) of the samples of each system; inf where they cannot be had."""
    try:
        return quick_distances(systems)
    except FAILURES:  # of one of them: each by itself
        if len(systems) == 1:
            return [np.full(len(systems[0].right), np.inf)]
        return [distances for system in systems for distances in _distances_of([system])]


def _nominal_system(robot, recording) -> RotationSystem | None:
    """The equations of base and tool at the nominal geometry; None for measurements that have none."""
    measurement = measurement_of(recording)
    if not hasattr(measurement, "system"):
        return None
    frames = forward(robot, robot.mixing @ recording.joints.T)
    return measurement.system(frames)


def _is_spare(system: RotationSystem) -> bool:
    """Whether there are enough rows for a scale."""
    return _spare_rows(system) >= _LEAST_SPARE


def _spare_rows(system: RotationSystem) -> int:
    return system.right.size - 3 * system.count - len(system.prior)


def _scale_of(system: RotationSystem, distances: np.ndarray) -> float:
    """RMS mm of the best 90 % of the samples at distances (n,) in units of the rows."""
    smallest = np.sort(distances)[: int(np.ceil(_KEPT * len(distances)))]
    share = system.right.size / _spare_rows(system)
    return float(np.sqrt((smallest**2).mean() * share)) * MODEL_ERROR_MM


def row_residual(robot, recording, fit: Fit) -> np.ndarray:
    """(m, n) mm of all rows of a recording under the values of a fit of some rows; rotations times the lever."""
    model, parameters = model_at(robot, recording, fit.parameters.values)
    residual = model.residual(parameters)
    residual[POSITION:] *= lever_of(robot, recording)
    return residual


def row_mismatch(robot, recording, fit: Fit) -> np.ndarray:
    """(n,) mm: lengths of `row_residual`."""
    return np.sqrt((row_residual(robot, recording, fit) ** 2).sum(0))


def tool_patterns(recording) -> tuple[str, ...]:
    """Keys of the measurement's own parameters: tool or sensor, and points that nobody measured.

    Those of effects at the tool begin alike and are not among them.
    """
    return tuple(p.key for p in measurement_of(recording).parameters())


def base_patterns(recording) -> tuple[str, ...]:
    """Keys of the pose of the base; none where the base is the world."""
    if measurement_of(recording).grounded:
        return ()
    return tuple(p.key for p in pose_parameters("base", "base"))


def base_and_tool(recording) -> tuple[str, ...]:
    """Keys of everything but the geometry and effects."""
    return (*base_patterns(recording), *tool_patterns(recording))


class _Problem:
    """Levenberg-Marquardt under Cauchy weights; the noise scale is the robust scale of the present residual."""

    def __init__(self, model, parameters, precision, lever):
        self.model, self.parameters, self.precision, self.lever = (
            model,
            parameters,
            precision,
            lever,
        )
        self.nulls = parameters.nulls[parameters.mask]

    def solve(self, steps) -> Fit:
        damping = 1e-6
        self.take(self.parameters)
        for _ in range(steps):
            before = self.cost(self.residual, self.parameters)
            for _ in range(6):
                candidate = self.moved(damping)
                residual = self.whiten(self.model.residual(candidate))
                after = self.cost(residual, candidate)
                if after < before:
                    break
                damping *= 30
            else:
                break
            damping = max(damping / 10, 1e-9)
            self.take(candidate)
            if before - after < 1e-3 + 1e-4 * before:
                break
        return self.finish()

    def whiten(self, residual):
        """(m, n) mm: rotations times the lever."""
        return np.concatenate([residual[:POSITION], residual[POSITION:] * self.lever])

    def take(self, parameters):
        residual, rows = self.model.linearise(parameters)
        self.parameters, self.residual = parameters, self.whiten(residual)
        rows[:, POSITION:] *= self.lever
        squares = (self.residual**2).sum(0)
        self.size = max(float(np.median(squares)) / MEDIAN_CHI2[len(residual)], LEAST_SCALE**2)
        self.weights = 1 / (1 + squares / (len(residual) * self.size * CAUCHY**2))
        root = np.sqrt(self.weights / self.size)
        flat = (rows * root).reshape(len(rows), residual.size)
        self.data = flat @ flat.T
        deviation = parameters.pack() - self.nulls
        self.gradient = flat @ (self.residual * root).ravel() + self.precision * deviation

    def cost(self, residual, parameters):
        """Cauchy cost of the present noise scale, and the prior."""
        limit = len(residual) * CAUCHY**2
        data = limit * np.log1p((residual**2).sum(0) / (limit * self.size)).sum()
        return float(data + self.precision @ (parameters.pack() - self.nulls) ** 2)

    def moved(self, damping):
        matrix = self.data + np.diag(self.precision)
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-12))
        scaled = matrix * np.outer(scale, scale) + damping * np.eye(len(scale))
        move = np.linalg.lstsq(scaled, -self.gradient * scale, rcond=1e-12)[0] * scale
        return self.parameters.unpack(self.parameters.pack() + move)

    def finish(self) -> Fit:
        m, n = self.residual.shape
        matrix = self.data + np.diag(self.precision)
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-12))
        degrees_used = np.trace(
            np.linalg.lstsq(
                matrix * np.outer(scale, scale), self.data * np.outer(scale, scale), rcond=1e-10
            )[0]
        )
        degrees = m * n - float(degrees_used)
        mismatch = np.sqrt((self.residual**2).sum(0))
        best_rows = np.argsort(mismatch)[: max(int(np.ceil(_KEPT * n)), 1)]
        if degrees >= _LEAST_SPARE:
            inflation = np.sqrt(m * n / degrees)
        else:
            inflation = np.inf
        position = float(np.sqrt((self.residual[:POSITION, best_rows] ** 2).sum(0).mean()))
        rotations = self.residual[POSITION:, best_rows] / self.lever
        if len(rotations):
            rotation = float(np.rad2deg(np.sqrt((rotations**2).sum(0).mean())))
        else:
            rotation = np.nan
        core = float(np.median(mismatch) / np.sqrt(MEDIAN_CHI2[m] / m))
        deviations = (self.parameters.pack() - self.nulls) * np.sqrt(self.precision)
        residual = np.concatenate([self.residual[:POSITION], self.residual[POSITION:] / self.lever])
        scale_of_best = float(np.sqrt((mismatch[best_rows] ** 2).mean())) * inflation
        return Fit(
            self.model,
            self.parameters,
            residual,
            mismatch,
            scale_of_best,
            core * inflation,
            position,
            rotation,
            deviations,
            degrees,
        )
