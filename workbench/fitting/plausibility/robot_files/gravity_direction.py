"""Whether the robot file states the direction of gravity in which the arm deflects: on a floor, a wall or a ceiling.

Torques of gravity are linear in its direction, so that one linearisation of the fitted arm predicts the deflections
under every direction. Geometry, tool, base and the first two harmonics of each joint are estimated with them: what
these explain is no evidence of a load. A compliance cannot be negative, which distinguishes a direction from its
opposite.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import minimize

from robot_model.effects.elastic import BearingCompliance
from robot_model.effects.transmission import TransmissionHarmonic
from robot_model.effects.unknown_masses import GravityBearing, bar_torque
from workbench.core.distributions import signed_rank_sf
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.fitting.cross_validation import blocks
from workbench.fitting.plausibility.fitting import (
    CAUCHY,
    LEAST_SCALE,
    MEDIAN_CHI2,
    POSITION,
    Fit,
    geometry_prior,
    lever_of,
    model_at,
)
from workbench.fitting.plausibility.sampling import even_rows
from workbench.fitting.plausibility.suspicion import Suspicion

CAUSE = "gravity"
_ROWS, _FOLDS = 400, 10
_HARMONIC_RAD = 3e-3  # prior standard deviation of an amplitude: ten times that of a usual gear
_LOWER = (
    0.8  # ratio of held-out RMS errors: another direction changes the loads of all joints at once
)
_LEVEL = 0.01  # of the signed-rank test over the folds
_SAME_DEG = 10.0  # from the stated direction, below which a mount is tilted and not another one
_OFF_AXIS_DEG = 10.0  # from an axis of the base, up to which wrong masses may be the reason
_TWO_SIGNS = (
    1.1  # ratio of held-out RMS errors, from which some compliances would have to be negative
)
_LEAST_LOAD = 1e-6  # of the largest square of a column, below which a joint is not loaded


@dataclass(frozen=True)
class GravityDirection:
    """A direction of gravity, (3,) unit vector in the root frame, that predicts held-out samples better.

    `held_out_mm`: RMS position error of held-out samples with it; `stated_mm`: with that of the robot file.
    `sigma_deg`: standard deviation of an estimated direction; None for an axis of the base.
    """

    direction: np.ndarray
    held_out_mm: float
    stated_mm: float
    sigma_deg: float | None = None


def gravity_suspicion(robot, found: GravityDirection) -> Suspicion:
    """The sentence on a direction of gravity that is not that of the robot file."""
    direction = tuple(round(float(c), 3) + 0.0 for c in found.direction)
    key = ", ".join(f"{c:g}" for c in direction)
    estimated = ""
    if found.sigma_deg is not None:
        estimated = f" (estimated to {found.sigma_deg:.1g} deg; a direction measured on the mount is better)"
    sentence = (
        f"robot file of '{robot.name}', key gravity: the arm deflects as under gravity along "
        f"{direction_name(found.direction)} of its base, as if {_mount(found.direction)}: held-out samples are "
        f"predicted to {found.held_out_mm:.2g} mm, and to {found.stated_mm:.2g} mm with gravity along "
        f"{direction_name(robot.gravity)}, which the file states or leaves to the default; write gravity = [{key}]"
        f"{estimated} into the robot file, or check mass_kg and com_mm."
    )
    use = f"gravity along {direction_name(found.direction)}"
    return Suspicion(sentence, False, CAUSE, robot_keys={"gravity": list(direction)}, use=use)


def direction_name(direction: np.ndarray) -> str:
    """'-z' of an axis of the base, else '[0.5, 0, -0.87]'."""
    axis = _axis_of(direction)
    if axis is None:
        return "[" + ", ".join(f"{round(float(c), 2):g}" for c in direction) + "]"
    return f"{'+' if direction[axis] > 0 else '-'}{'xyz'[axis]}"


def _axis_of(direction: np.ndarray) -> int | None:
    """Number of the axis of the base along which a direction is, either way; None between the axes."""
    axis = int(np.argmax(np.abs(direction)))
    if abs(direction[axis]) > 1 - 1e-9:
        return axis
    return None


def _mount(direction: np.ndarray) -> str:
    axis = _axis_of(direction)
    if axis is None:
        return "its mount were inclined"
    if axis == 2:
        return f"it were mounted on a {'ceiling' if direction[2] > 0 else 'floor'}"
    return "it were mounted on a wall"


def find_gravity(robot, recording, fit: Fit) -> GravityDirection | None:
    """The direction by which held-out samples are predicted significantly better than by the stated one; else None.

    fit: of some rows of the recording, geometry estimated. Raises numpy.linalg.LinAlgError where it does not suit the
    recording.
    """
    deflections = _deflections(robot, recording, fit)
    if deflections is None:
        return None
    best = _best_direction(deflections)
    if _angle_deg(best, robot.gravity) < _SAME_DEG:
        return None
    errors = deflections.held_out(best)
    stated = deflections.held_out(robot.gravity)
    rigid = deflections.held_out(np.zeros(3))
    if not (_is_better(errors, stated) and _is_better(errors, rigid)):
        return None
    if not _is_better(errors, _with_tilting_bearings(robot, recording, fit)):
        return None
    if _rms(errors) > _TWO_SIGNS * _rms(deflections.held_out(best, is_signed=True)):
        return None  # springs or masses differ from the file: no direction makes all compliances positive
    if _axis_of(best) is not None:
        return GravityDirection(best, _rms(errors), _rms(stated))
    # any direction may be chosen, and the best for all samples has seen the held-out ones: each fold estimates its own
    of_folds = [_estimated(form) for form in deflections.trained]
    nested = deflections.held_out(of_folds)
    if not (_is_better(nested, stated) and _is_better(nested, rigid)):
        return None
    return GravityDirection(best, _rms(nested), _rms(stated), _jackknife_deg(best, of_folds))


def _with_tilting_bearings(robot, recording, fit: Fit) -> np.ndarray:
    """(F,) mm^2 of each fold under the stated direction, where bearings deflect, too.

    Where gravity has little torque about the axes, as in a SCARA, it is the bearings that deflect. Joints under another
    direction may imitate them.
    """
    return _deflections(robot, recording, fit, with_bearings=True).held_out(robot.gravity)


def _jackknife_deg(direction: np.ndarray, of_folds: list[np.ndarray]) -> float:
    """Standard deviation (deg) of a direction by the jackknife: `of_folds` are estimated without each fold."""
    angles = np.array([_angle_deg(direction, other) for other in of_folds])
    return float(np.sqrt((len(angles) - 1) / len(angles) * (angles**2).sum()))


def _best_direction(deflections: "_Deflections") -> np.ndarray:
    """The best axis of the base, as of most mounts, or the direction of the least squares if significantly better."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    held_out = [deflections.held_out(axis) for axis in axes]
    best = int(np.argmin([_rms(errors) for errors in held_out]))
    estimated = _estimated(deflections.complete)
    is_off = _angle_deg(estimated, axes[best]) > _OFF_AXIS_DEG
    if is_off and _is_significant(deflections.held_out(estimated), held_out[best]):
        return estimated
    return axes[best]


def _estimated(form: np.ndarray) -> np.ndarray:
    """(3,) unit vector of the least squares, from the best of 26 directions; form: as of `_Deflections.complete`."""
    grid = [np.array(v, float) for v in product((-1, 0, 1), repeat=3) if any(v)]
    starts = [v / np.linalg.norm(v) for v in grid]
    start = min(starts, key=lambda direction: _squares(form, direction))
    perpendicular = np.linalg.svd(start[None])[2][1:]

    def at(tilt):
        rotated = start + tilt @ perpendicular
        return rotated / np.linalg.norm(rotated)

    found = minimize(lambda tilt: _squares(form, at(tilt)), np.zeros(2), method="Nelder-Mead")
    return at(found.x)


def _angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b, -1, 1))))


def _rms(errors: np.ndarray) -> float:
    return float(np.sqrt(errors.mean()))


def _is_better(errors: np.ndarray, others: np.ndarray) -> bool:
    """Whether the mean squares of the folds, (F,) mm^2, are lower by far and in more than luck."""
    return _rms(errors) < _LOWER * _rms(others) and _is_significant(errors, others)


def _is_significant(errors: np.ndarray, others: np.ndarray) -> bool:
    """Whether the mean squares of the folds, (F,) mm^2, are lower in more than luck."""
    return signed_rank_sf(others - errors) < _LEVEL


@dataclass(frozen=True)
class _Deflections:
    """Least squares of the deflections of K joints, which all other parameters are estimated with.

    Quadratic forms of the residual (first) and of the deflections per unit of compliance under gravity along x, y and z
    (3 K): `complete` (1 + 3K, 1 + 3K) of all samples, `trained` (F, ...) of those without each fold, `tested` (F, ...)
    of the predicted positions of each fold, as a mean over its samples, mm^2.
    """

    complete: np.ndarray
    trained: np.ndarray
    tested: np.ndarray

    def held_out(self, direction: np.ndarray, is_signed: bool = False) -> np.ndarray:
        """(F,) mm^2 mean square position error of each fold; is_signed: compliances may be negative.

        direction: (3,) of all folds, or (F, 3) of each.
        """
        directions = np.broadcast_to(direction, (len(self.trained), 3))
        moves = [_with_compliances(*pair, is_signed) for pair in zip(self.trained, directions)]
        squares = np.array([move @ form @ move for move, form in zip(moves, self.tested)])
        return np.maximum(squares, 0.0)  # of exact data, rounding may leave less than nothing


def _squares(form: np.ndarray, direction: np.ndarray) -> float:
    """Weighted sum of squares with compliances that are not negative."""
    move = _with_compliances(form, direction, False)
    return float(move @ form @ move)


def _with_compliances(form: np.ndarray, direction: np.ndarray, is_signed: bool) -> np.ndarray:
    """(1 + 3K,) one of the residual, and the deflections with the compliances of the least squares."""
    blocks = form[1:, 1:].reshape(3, -1, 3, (len(form) - 1) // 3)
    normal = np.einsum("i,ikjl,j->kl", direction, blocks, direction)
    right = -direction @ form[0, 1:].reshape(3, -1)
    size = np.sqrt(np.maximum(np.diag(normal), 0.0))
    active = size > np.sqrt(_LEAST_LOAD) * max(size.max(initial=0.0), 1e-300)
    compliances = np.zeros(len(size))
    while active.any():
        scaled = normal[np.ix_(active, active)] / np.outer(size[active], size[active])
        solved = np.linalg.lstsq(scaled, right[active] / size[active], rcond=1e-9)[0]
        if is_signed or (solved >= 0).all():
            compliances[active] = solved / size[active]
            break
        active[np.flatnonzero(active)[np.argmin(solved)]] = False
    return np.concatenate([[1.0], np.outer(direction, compliances).ravel()])


def _deflections(robot, recording, fit: Fit, with_bearings: bool = False) -> _Deflections | None:
    """The quadratic forms of some rows of a recording; None where no joint can deflect or folds are too few.

    with_bearings: of K joints and bearings.
    """
    chosen = recording.select(even_rows(recording, _ROWS))
    model, parameters = model_at(robot, chosen, fit.parameters.values)
    parameters = parameters.only(fit.parameters.mask)
    fold = blocks(chosen.poses, _FOLDS)
    columns = _columns(model, parameters, with_bearings)
    if fold.max() + 1 < _FOLDS or not columns.loads.any():
        return None
    others = len(columns.others)
    rows = np.concatenate([columns.others, columns.residual[None], columns.loads])
    rows[:, POSITION:] *= lever_of(robot, chosen)
    weights, variance = _robust_weights(rows[others])
    forms = np.stack([_form(rows[..., fold == k], weights[fold == k]) for k in range(_FOLDS)])
    positions = rows[:, :POSITION]
    tested = np.stack([_form(positions[..., fold == k], weights[fold == k]) for k in range(_FOLDS)])
    tested /= np.array([weights[fold == k].sum() for k in range(_FOLDS)])[:, None, None]
    prior = _prior(robot, chosen, parameters, others, len(rows)) * variance
    complete = forms.sum(0) + prior
    maps = [_eliminated(complete - form, others) for form in forms]
    return _Deflections(
        _reduced(complete, _eliminated(complete, others)),
        np.stack(
            [_reduced(complete - form, elimination) for form, elimination in zip(forms, maps)]
        ),
        np.stack([_reduced(form, elimination) for form, elimination in zip(tested, maps)]),
    )


@dataclass(frozen=True)
class _Columns:
    """Derivatives (.., m, n) of the residual (m, n): of geometry, base, tool and harmonics, and of the deflections.

    `loads` (3 K, m, n): per unit of compliance of each of K loads, under gravity along x, y and z of the base.
    """

    residual: np.ndarray
    others: np.ndarray
    loads: np.ndarray


def _columns(model: Model, parameters: Parameters, with_bearings: bool) -> _Columns:
    chain = model.chain
    harmonics = [
        TransmissionHarmonic(where, **options)
        for where, options in TransmissionHarmonic.planned(chain)
    ]
    wider = model.with_effects(*harmonics)
    free = wider.parameters.take_over(parameters)
    of_harmonics = np.arange(len(free)) >= len(parameters)
    free = free.only(np.concatenate([parameters.mask, of_harmonics[len(parameters) :]]))
    residual, others = wider.linearise(free)
    evaluation = model.evaluate(parameters)
    by_joint = evaluation.rows("joint", np.arange(chain.robot.joints))
    unit_loads = _unit_loads(chain)
    by_load = np.tile(by_joint, (unit_loads.shape[1] // len(by_joint), 1, 1))
    loads = [by_load * load[:, None] for load in unit_loads]
    if with_bearings:
        bearings = [_by_bearings(chain, evaluation, axis) for axis in np.eye(3)]
        loads = [np.concatenate(pair) for pair in zip(loads, bearings)]
    return _Columns(residual, others, np.concatenate([model.joined(load) for load in loads]))


def _by_bearings(chain, evaluation, gravity: np.ndarray) -> np.ndarray:
    """(B, m, n) derivatives by the tilting compliance of each revolute joint's bearing under a direction of gravity."""
    kind = BearingCompliance if chain.robot.mass.any() else GravityBearing
    state = replace(chain.state, gravity=gravity)
    laws = [kind(f"joint-{k + 1}") for k in np.flatnonzero(~chain.robot.prismatic)]
    rows = [evaluation.rows(law.port, np.asarray(law.port_indices(chain))) for law in laws]
    twists = [law.basis(state)[0] for law in laws]
    return np.stack([np.einsum("kmn,kn->mn", row, twist) for row, twist in zip(rows, twists)])


def _unit_loads(chain) -> np.ndarray:
    """(3, K, poses) loads of the joints under gravity along each axis of the base; 0 of joints that slide.

    Torques of the stated masses, N m; where the links have none, those of uniform bars in units of the largest one, and
    those of a load that is known.
    """
    state = chain.state
    is_revolute = ~chain.robot.prismatic[:, None]
    levers = (state.link_levers.torque + state.load_levers.torque).swapaxes(0, 1)
    levers = chain.robot.drive_torque(levers)
    stated = np.where(is_revolute, levers, 0.0)
    if chain.robot.mass.any():
        return stated
    bars = [_bar_torques(replace(state, gravity=axis)) for axis in np.eye(3)]
    return np.concatenate([np.where(is_revolute, bars, 0.0), stated], axis=1)


def _bar_torques(state) -> np.ndarray:
    """(J, poses) torques of links that are uniform bars, in units of the greatest that each joint can have."""
    return np.stack([bar_torque(state, joint) for joint in range(state.robot.joints)])


def _prior(robot, recording, parameters: Parameters, others: int, size: int) -> np.ndarray:
    """(size, size) prior precision of the first `others` columns and its gradient, as a quadratic form."""
    precision = np.full(others, 1 / _HARMONIC_RAD**2)
    geometry = 1 / geometry_prior(robot, recording, parameters)[parameters.mask] ** 2
    precision[: len(geometry)] = geometry
    deviation = np.zeros(others)
    deviation[: len(geometry)] = parameters.pack() - parameters.nulls[parameters.mask]
    form = np.zeros((size, size))
    form[:others, :others] = np.diag(precision)
    form[:others, others] = form[others, :others] = precision * deviation
    return form


def _robust_weights(residual: np.ndarray) -> tuple[np.ndarray, float]:
    """Cauchy weights (n,) of samples, and the robust variance of a component, mm^2."""
    squares = (residual**2).sum(0)
    variance = max(float(np.median(squares)) / MEDIAN_CHI2[len(residual)], LEAST_SCALE**2)
    return 1 / (1 + squares / (len(residual) * variance * CAUCHY**2)), variance


def _form(rows: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(Q, Q) weighted sums of products of columns (Q, m, n)."""
    flat = (rows * np.sqrt(weights)).reshape(len(rows), -1)
    return flat @ flat.T


def _eliminated(form: np.ndarray, others: int) -> np.ndarray:
    """(Q, Q - others) the remaining columns less what the first `others` columns explain of them, by least squares."""
    scale = 1 / np.sqrt(np.maximum(np.diag(form)[:others], 1e-300))
    normal = form[:others, :others] * np.outer(scale, scale)
    right = form[:others, others:] * scale[:, None]
    explained = np.linalg.lstsq(normal, right, rcond=1e-12)[0] * scale[:, None]
    return np.concatenate([-explained, np.eye(len(form) - others)])


def _reduced(form: np.ndarray, remaining: np.ndarray) -> np.ndarray:
    return remaining.T @ form @ remaining
