"""Hand-eye from poses of a board or marker that another program measured: A X = X B and A X = Y B.

With M_i = T_base_flange ("in-hand") or T_flange_base ("to-hand"), the sensor X, the target Z and the measured poses
B_i = T_sensor_target, every pose states M_i X B_i = Z. OpenCV's closed forms and a robust fit give the start, and the
result is a weighted least-squares adjustment of all poses. Positions and rotations have one standard deviation each,
variance components that are estimated from the residuals (Helmert; Koch, Parameter Estimation and Hypothesis Testing,
1999): they hold errors of the flange poses and of the measured poses, as they act at the target.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensors.hand_eye.chain import pose_table
from sensors.hand_eye.checks.alternatives import moved_of
from sensors.hand_eye.checks.pose_data import PoseData
from sensors.hand_eye.checks.pose_fit import fit_poses, robust_starts
from sensors.hand_eye.checks.review import Review
from sensors.hand_eye.motion import motion
from sensors.hand_eye.poses import checked_flange
from sensors.hand_eye.result import HandEye, PoseRow, of_block, placement
from sensors.hand_eye.start import closed_forms
from sensors.hand_eye.uncertainty.parameter_covariance import parameter_covariance
from workbench.core.distributions import fisher
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import covariance_of, least_squares
from workbench.core.parameters import Parameters
from workbench.core.rigid import left_jacobian, rotation_vector, skew

KINDS = ("in-hand", "to-hand")
FEWEST = 3
_ROUNDS, _STEPS = 30, 30
_SETTLED = 1e-5  # of a standard deviation
_STEADY = 1e-4  # relative change of a standard deviation below which the variance components stay
_MIN_SIGMA = np.array([1e-6, 1e-9])  # mm and rad: no measured pose is better
_LEAST_REDUNDANCY = 0.5  # of a group of residuals, below which they do not show their own variance
_LEVEL = 1e-3  # how often a set without a gross error has a pose called one (Baarda, 1968)
_MOST_LEFT_OUT = 0.25
_HALF_TARGET = (
    0.1  # of the distance to the sensor: half the side of the square that stands for the target
)


@dataclass(frozen=True)
class TargetPoses:
    """P poses: `flange` (P, 4, 4) T_base_flange and `seen` (P, 4, 4) T_sensor_target, mm; `kind` "in-hand" (sensor on
    the flange, target fixed in the base) or "to-hand" (target on the flange, sensor fixed); `names` of the poses."""

    flange: np.ndarray
    seen: np.ndarray
    kind: str
    names: Sequence[str]

    @property
    def data(self) -> PoseData:
        """The same for the robust fit of board poses, with the corners of a square that stands for the target."""
        half = _HALF_TARGET * float(np.median(np.linalg.norm(self.seen[:, :3, 3], axis=1)))
        x, y = half * np.array([[-1, -1, 1, 1], [-1, 1, -1, 1]])
        return PoseData(
            moved_of(self.flange, self.kind), self.seen[None], np.stack([x, y, np.zeros(4)])
        )


def hand_eye_from_target_poses(poses: TargetPoses, reviewed: Review | None = None) -> HandEye:
    """Hand-eye transform, pose of the target, and their covariance.

    reviewed: what the comparison of flange poses and target poses found (`checks.target_review`). While it suspects
    a mistake in the flange poses, no pose is left out as a gross error. Raises InputError for fewer than three poses,
    an unknown kind, or matrices that are no poses.
    """
    poses = _checked(poses)
    start = _start(poses)
    sentences = () if reviewed is None else reviewed.sentences
    max_blunders = 0 if sentences else int(_MOST_LEFT_OUT * len(poses.flange))
    solution, left_out = _without_gross_errors(poses, start, max_blunders)
    return _result(poses, solution, left_out, sentences)


def _checked(poses: TargetPoses) -> TargetPoses:
    if poses.kind not in KINDS:
        raise InputError(
            f"hand-eye: expected kind in-hand or to-hand, found '{poses.kind}'; write one of them"
        )
    flange = checked_flange(poses.flange, "hand-eye")
    seen = checked_flange(poses.seen, "hand-eye, measured poses of the target")
    if len(flange) != len(seen):
        raise InputError(
            f"hand-eye: expected one pose of the target for each flange pose, found {len(seen)} and {len(flange)}; "
            "take out what has no partner"
        )
    if len(flange) < FEWEST:
        raise InputError(
            f"hand-eye: expected at least {FEWEST} poses, found {len(flange)}; take more, with rotations about two axes"
        )
    return replace(poses, flange=flange, seen=seen)


def _start(poses: TargetPoses) -> np.ndarray:
    """Twelve values: x y z and rotation vector of sensor and target."""
    data = poses.data
    forms = closed_forms(poses.flange, poses.seen, poses.kind)
    fit = fit_poses(data, starts=[*robust_starts(data), *forms.values()])
    return np.concatenate([_values(fit.sensor[0]), _values(fit.board[0])])


def _values(matrix) -> np.ndarray:
    return np.concatenate([matrix[:3, 3], rotation_vector(matrix[:3, :3])])


@dataclass(frozen=True)
class _Solution:
    """`values` (12,); `residual` (P, 6) mm and rad; `rows` (P, 6, 12) derivatives; `sigma` (2,) mm and rad;
    `used` (P,) bool; `converged`."""

    values: np.ndarray
    residual: np.ndarray
    rows: np.ndarray
    sigma: np.ndarray
    used: np.ndarray
    converged: bool

    @property
    def whitened(self) -> tuple[np.ndarray, np.ndarray]:
        """Residual (P, 6) and rows (P, 6, 12) in standard deviations."""
        sigma = np.repeat(self.sigma, 3)
        return self.residual / sigma, self.rows / sigma[:, None]

    @property
    def normal(self) -> np.ndarray:
        """(12, 12) normal matrix of the poses used."""
        rows = self.whitened[1][self.used].reshape(-1, 12)
        return rows.T @ rows


def _linearised(poses: TargetPoses, values):
    """Residual (P, 6), predicted minus measured pose of the target in the sensor frame, and rows (P, 6, 12)."""
    sensor, target = placement(values[:6]), placement(values[6:])
    moved = moved_of(poses.flange, poses.kind)
    to_mount = moved[:, :3, :3].transpose(0, 2, 1)
    in_mount = np.einsum("pij,pj->pi", to_mount, target[:3, 3] - moved[:, :3, 3]) - sensor[:3, 3]
    to_sensor = sensor[:3, :3].T
    from_target = to_sensor @ to_mount  # from the target's mount to the sensor
    shift = in_mount @ to_sensor.T - poses.seen[:, :3, 3]
    predicted = from_target @ target[:3, :3]
    spin = rotation_vector(predicted @ poses.seen[:, :3, :3].transpose(0, 2, 1))

    rows = np.zeros((len(moved), 6, 12))
    rows[:, :3, :3] = -to_sensor
    rows[:, :3, 3:6] = to_sensor @ skew(in_mount)
    rows[:, 3:, 3:6] = -to_sensor
    rows[:, :3, 6:9] = from_target
    rows[:, 3:, 9:] = from_target
    for part in (slice(3, 6), slice(9, 12)):
        rows[:, :, part] = rows[:, :, part] @ left_jacobian(values[part])
    return np.concatenate([shift, spin], axis=1), rows


def _solve(poses: TargetPoses, start, used) -> _Solution:
    """Weighted adjustment with estimated variance components."""
    values = start
    residual, rows = _linearised(poses, values)
    sigma = np.maximum(_group_rms(residual[used]), _MIN_SIGMA)
    for _ in range(_ROUNDS):
        values, converged = _descended(poses, values, sigma, used)
        residual, rows = _linearised(poses, values)
        solution = _Solution(values, residual, rows, sigma, used, converged)
        after = _variance_components(solution)
        steady = np.abs(np.log(after / sigma)).max() < _STEADY
        sigma = after
        if steady:
            break
    return replace(solution, sigma=sigma)


def _descended(poses, values, sigma, used) -> tuple[np.ndarray, bool]:
    """Gauss-Newton with fixed standard deviations."""
    weights = 1 / np.repeat(sigma, 3)
    for _ in range(_STEPS):
        residual, rows = _linearised(poses, values)
        design = (rows[used] * weights[:, None]).reshape(-1, 12)
        scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        step = -least_squares(design / scale, (residual[used] * weights).ravel(), 1e-10) / scale
        values = values + step
        if np.abs(step * scale).max() < _SETTLED:
            return values, True
    return values, False


def _group_rms(residual) -> np.ndarray:
    """(2,) RMS of a component of position (mm) and of rotation (rad)."""
    return np.sqrt((residual.reshape(-1, 2, 3) ** 2).mean((0, 2)))


def _variance_components(solution: _Solution) -> np.ndarray:
    """(2,) standard deviations of position and rotation: squares of the residuals over their redundancy."""
    residual = solution.residual[solution.used].reshape(-1, 2, 3)
    hat = _hat_blocks(solution)[solution.used]
    used_up = np.einsum("pkk->pk", hat).reshape(-1, 2, 3).sum((0, 2))
    redundancy = np.maximum(3 * len(residual) - used_up, _LEAST_REDUNDANCY)
    return np.maximum(np.sqrt((residual**2).sum((0, 2)) / redundancy), _MIN_SIGMA)


def _hat_blocks(solution: _Solution) -> np.ndarray:
    """(P, 6, 6) blocks of the hat matrix of the whitened adjustment, one for each pose."""
    rows = solution.whitened[1]
    covariance = _inverse(solution.normal)
    return rows @ covariance @ rows.transpose(0, 2, 1)


def _inverse(normal) -> np.ndarray:
    """Inverse of a normal matrix in scaled parameters; what nothing determines is held."""
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * np.outer(scale, scale)
    return covariance_of(scaled, np.full(len(scaled), 1e-12)) * np.outer(scale, scale)


def _without_gross_errors(poses, start, max_blunders: int) -> tuple[_Solution, np.ndarray]:
    """The adjustment without gross errors, and the probability (P,) of a larger deviation of each pose.

    One pose at a time is left out, the one that the others find least likely, tested with the variance of the others
    (externally studentised; Cook & Weisberg, Residuals and Influence in Regression, 1982).
    """
    used = np.ones(len(poses.flange), bool)
    while True:
        solution = _solve(poses, start, used)
        chance = _chances(solution)
        chance_of_used = np.where(used, chance, np.inf)
        worst = int(np.argmin(chance_of_used))
        if chance_of_used[worst] > _LEVEL / used.sum() or (~used).sum() >= max_blunders:
            return solution, chance
        used = used.copy()
        used[worst] = False
        start = solution.values


def _chances(solution: _Solution) -> np.ndarray:
    residual, _ = solution.whitened
    hat = _hat_blocks(solution)
    count = int(solution.used.sum())
    total = float((residual[solution.used] ** 2).sum())
    chances = np.ones(len(residual))
    for k, pose_residual in enumerate(residual):
        if solution.used[k]:
            squared = float(pose_residual @ least_squares(np.eye(6) - hat[k], pose_residual, 1e-9))
            others_squared, degrees = total - squared, 6 * count - 12 - 6
        else:
            squared = float(pose_residual @ least_squares(np.eye(6) + hat[k], pose_residual, 1e-9))
            others_squared, degrees = total, 6 * count - 12
        if degrees > 0:
            ratio = squared / 6 / max(others_squared / degrees, 1e-300)
            chances[k] = float(fisher.sf(ratio, 6, degrees))
    return chances


def _predictions(solution: _Solution) -> np.ndarray:
    """(P, 6) mm and rad: each pose against the prediction of the others, (1 - H)^-1 e; those left out as they are."""
    residual, _ = solution.whitened
    hat = _hat_blocks(solution)
    predicted = residual.copy()
    for k in np.flatnonzero(solution.used):
        predicted[k] = least_squares(np.eye(6) - hat[k], residual[k], 1e-9)
    return predicted * np.repeat(solution.sigma, 3)


@dataclass(frozen=True)
class _Linear:
    normal: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class _Adjusted:
    """What `parameter_covariance` reads of an adjustment."""

    parameters: Parameters
    linear: _Linear


def _result(poses: TargetPoses, solution: _Solution, chance, sentences) -> HandEye:
    table = Parameters.of(
        [*pose_table("sensor", "the sensor"), *pose_table("target", "the target")]
    )
    table = replace(table, values=solution.values).free("*")
    adjusted = _Adjusted(table, _Linear(solution.normal, _inverse(solution.normal)))
    shift, spin = (0.0, 0.0) if sentences else solution.sigma
    known = parameter_covariance(
        adjusted, motion(poses.flange[solution.used], poses.kind, spin, shift)
    )
    predicted = _predictions(solution)
    position, rotation = (float(value) for value in solution.sigma)
    return HandEye(
        kind=poses.kind,
        sensor=placement(solution.values[:6]),
        covariance=of_block(adjusted, known, "sensor"),
        target=placement(solution.values[6:]),
        target_covariance=of_block(adjusted, known, "target"),
        parameters=table,
        std=known.std(),
        noise=position,
        unit="mm",
        robot_sigma={"position_mm": position, "rotation_deg": float(np.degrees(rotation))},
        fit=_errors(solution.residual[solution.used]),
        held_out={**_errors(predicted[solution.used]), "folds": int(solution.used.sum())},
        poses=tuple(_row(k, solution, predicted, chance) for k in range(len(predicted))),
        undetermined=known.sentences,
        suspicions=sentences,
        outcome="converged" if solution.converged else "not converged",
        converged=solution.converged,
    )


def _errors(residual) -> dict[str, float]:
    """RMS 3-D distance of the target's origin (mm) and RMS angle of its rotation (deg)."""
    rms = np.sqrt(3) * _group_rms(residual)
    return {"origin_mm": float(rms[0]), "turn_deg": float(np.degrees(rms[1]))}


def _row(k: int, solution: _Solution, predicted, chance) -> PoseRow:
    is_left_out = not solution.used[k]
    moved, turned = _length(predicted[k, :3]), float(np.degrees(_length(predicted[k, 3:])))
    usual = _errors(predicted[solution.used])
    why = (
        f"{moved:.3g} mm and {turned:.2g} deg from the prediction of the other poses, which are "
        f"{usual['origin_mm']:.3g} mm and {usual['turn_deg']:.2g} deg off; left out: check the flange pose and the "
        "pose of the target in this row"
    )
    residual = solution.residual[k]
    return PoseRow(
        k,
        _length(residual[:3]),
        moved,
        moved,
        float(np.degrees(_length(residual[3:]))),
        float(chance[k]),
        bool(is_left_out),
        why if is_left_out else "",
    )


def _length(vector) -> float:
    return float(np.linalg.norm(vector))
