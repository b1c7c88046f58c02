"""Whether the drive of a joint moves the joints that are coupled to its reading, or only the controller counts so.

A parallelogram and the gears of a wrist carry the errors and the compliance of one drive to several joints. A reading
that is counted from the horizontal looks the same in the robot file, but each drive stands on the link before its
joint. Where the file does not say which, both are compared by the evidence of the same effects at the drives.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from robot_model.effects.elastic import JointCompliance
from robot_model.effects.transmission import Backlash, TransmissionHarmonic
from robot_model.effects.unknown_masses import GravityCompliance
from robot_model.files.loading import load_robot, whole_keys
from workbench.core.effect import Effect
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.fitting.plausibility.fitting import (
    CAUCHY,
    LEAST_SCALE,
    POSITION,
    Fit,
    geometry_prior,
    lever_of,
    model_at,
)
from workbench.fitting.plausibility.sampling import even_rows
from workbench.fitting.plausibility.suspicion import Suspicion

CAUSE = "coupled-drives"
_ROWS = 400
_LOG_ODDS = 5.0  # 150 to 1, from which on a drive moves the joints that are coupled to it
_SIZES = (0.001, 0.1, 0.3, 1.0, 3.0)  # of the effects, relative to their usual size
_MOST_PARAMETERS = 0.75  # of the coordinates; more leave the noise open, and nothing is decided
_MOST_COUPLINGS = 3  # all of whose combinations are compared


def coupled_drives(robot, recording, fit: Fit) -> Suspicion | None:
    """Suspicions about couplings of the robot file for which it is not stated whether they are mechanical.

    fit: of some rows of the recording, geometry estimated. None where nothing is open, or where the evidence is not
    clear: each drive then moves its own joint alone.
    """
    keys = whole_keys(recording.robot)
    open_joints = [
        k for k, joint in enumerate(keys.get("joint", ())) if _is_open(joint.get("coupled"))
    ]
    if not open_joints or robot.mixing.shape != (robot.joints,) * 2:
        return None
    chosen = recording.select(even_rows(recording, _ROWS))
    involved = {
        number for k in open_joints for number in (k + 1, keys["joint"][k]["coupled"]["joint"])
    }
    data = _Data.of(robot, chosen, fit, frozenset(f"joint-{number}" for number in involved))
    alone = data.evidence(robot)
    others = [
        (data.evidence(load_robot(_with(keys, combination))), combination)
        for combination in _combinations(open_joints)
    ]
    evidence, combination = max(others, key=lambda pair: pair[0])
    if not np.isfinite(alone) or evidence < alone + _LOG_ODDS:
        return None
    return _suspicion(keys, combination, evidence - alone)


def _is_open(coupled: Mapping | None) -> bool:
    return coupled is not None and coupled.get("mechanical") is None


def _combinations(joints: list[int]) -> Iterator[tuple[int, ...]]:
    """Sets of joints whose couplings are mechanical; of many couplings only all of them."""
    if len(joints) > _MOST_COUPLINGS:
        yield tuple(joints)
        return
    for chosen in product((True, False), repeat=len(joints)):
        if any(chosen):
            yield tuple(joint for joint, is_in in zip(joints, chosen) if is_in)


def _with(keys: Mapping, joints: tuple[int, ...]) -> dict:
    """Keys of robot.toml in which the open couplings say whether they are mechanical: those of some joints are."""
    changed = []
    for k, joint in enumerate(keys["joint"]):
        if _is_open(joint.get("coupled")):
            joint = {**joint, "coupled": {**joint["coupled"], "mechanical": k in joints}}
        changed.append(joint)
    return {**keys, "joint": changed}


def _suspicion(keys: Mapping, joints: tuple[int, ...], log_odds: float) -> Suspicion:
    pairs = [(k + 1, keys["joint"][k]["coupled"]["joint"]) for k in joints]
    moves = " and ".join(
        f"the drive of joint {other} moves joint {joint}" for joint, other in pairs
    )
    sentence = (
        f"robot file of '{keys.get('name', 'the arm')}', key coupled: it does not say whether a coupling is "
        f"mechanical. Errors of the drives and their compliance show that {moves}, as through a linkage or gears "
        f"(log Bayes factor {log_odds:.0f}); write mechanical = true into the braces of coupled there, or "
        "mechanical = false where only the controller counts so."
    )
    use = "drives that move the coupled joints"
    return Suspicion(sentence, False, CAUSE, robot_keys=_with(keys, joints), use=use)


@dataclass(frozen=True)
class _Data:
    """Rows of a recording at a fit: values of the parameters, which of them are free, and weights of the residual.

    `involved`: places of the joints whose couplings are open.
    """

    recording: object
    parameters: Parameters
    weights: np.ndarray
    prior: np.ndarray
    involved: frozenset[str]

    @classmethod
    def of(cls, robot, recording, fit: Fit, involved: frozenset[str]) -> "_Data":
        model, parameters = model_at(robot, recording, fit.parameters.values)
        parameters = parameters.only(fit.parameters.mask)
        residual = model.residual(parameters)
        lever = np.ones((len(residual), 1))
        lever[POSITION:] = lever_of(robot, recording)
        squares = ((residual * lever) ** 2).mean(0)
        size = max(float(np.sqrt(np.median(squares))), LEAST_SCALE)
        weights = lever / np.sqrt(1 + squares / (size * CAUCHY) ** 2)
        prior = geometry_prior(robot, recording, parameters)[parameters.mask]
        return cls(recording, parameters, weights, prior, involved)

    def evidence(self, robot) -> float:
        """Log evidence of the usual effects at the drives of an arm, up to a constant; -inf for too few coordinates.

        Normal priors of the parameters, and the noise variance integrated out with Jeffreys' prior: Bishop, Pattern
        Recognition and Machine Learning, sect. 3.5, with the marginal of Student's t distribution. The common size of
        the effects is that of the greatest evidence, for an arm may have none, which decides nothing. Those of the
        involved joints have a size of their own: a large error elsewhere makes none here.
        """
        model, parameters = model_at(robot, self.recording, self.parameters.values)
        wider = model.with_effects(*_effects(model))
        free = wider.parameters.take_over(parameters)
        extra = np.arange(len(free)) >= len(parameters)
        mask = np.concatenate([self.parameters.mask, extra[len(parameters) :]])
        residual, rows = wider.linearise(free.only(mask))
        y = (residual * self.weights).ravel()
        columns = (rows * self.weights).reshape(len(rows), -1)
        if len(columns) > _MOST_PARAMETERS * len(y):
            return -np.inf
        added = [p for p, is_extra in zip(free.table, extra) if is_extra]
        typical = np.array([p.typical for p in added])
        is_here = np.isin([p.key.partition(".")[0] for p in added], list(self.involved))

        def of_sizes(other_size: float, local_size: float) -> float:
            sizes = np.where(is_here, local_size, other_size) * typical
            return _log_evidence(y, columns, np.concatenate([self.prior, sizes]))

        best = max(_SIZES, key=lambda size: of_sizes(size, size))
        return max(of_sizes(best, local_size) for local_size in _SIZES)


def _effects(model: Model) -> list[Effect]:
    """Harmonics of low order, deflection under gravity, and backlash, at all drives."""
    chain = model.chain
    loads = JointCompliance if chain.robot.mass.any() else GravityCompliance
    harmonics = [
        TransmissionHarmonic(where, **o) for where, o in TransmissionHarmonic.planned(chain)
    ]
    springs = [loads(where, **options) for where, options in loads.planned(chain)]
    gaps = [v.effect for v in Backlash.candidates(chain) if v.effect.seat != "gravity"]
    return [*harmonics, *springs, *gaps]


def _log_evidence(y: np.ndarray, columns: np.ndarray, prior: np.ndarray) -> float:
    """y (N,), columns (P, N), prior standard deviations (P,), inf for none.

    The prior is that of parameters in units of the noise: its size relative to the noise is that of the residual.
    """
    noise = _noise_of(y, columns)
    known = np.isfinite(prior)
    scale = np.where(known, prior, 1 / np.maximum(np.linalg.norm(columns, axis=1), 1e-300))
    scaled = columns * scale[:, None]
    precision = np.diag(np.where(known, noise**2, 0.0))
    normal = scaled @ scaled.T + precision
    inner = np.linalg.lstsq(normal, scaled @ y, rcond=1e-12)[0]
    remaining = float(y @ y - inner @ (scaled @ y))
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    log_normal = np.linalg.slogdet(normal / np.outer(size, size) + 1e-12 * np.eye(len(size)))[1]
    volume = log_normal + 2 * np.log(size).sum() - 2 * known.sum() * np.log(noise)
    degrees = len(y) - (~known).sum()
    return float(-0.5 * volume - 0.5 * degrees * np.log(max(remaining, 1e-300)))


def _noise_of(y: np.ndarray, columns: np.ndarray) -> float:
    """Standard deviation of what no combination of the columns explains."""
    unit = columns / np.maximum(np.linalg.norm(columns, axis=1), 1e-300)[:, None]
    inner = np.linalg.lstsq(unit @ unit.T, unit @ y, rcond=1e-10)[0]
    degrees = max(len(y) - len(unit), 1)
    return max(float(np.sqrt(((y - inner @ unit) ** 2).sum() / degrees)), LEAST_SCALE)
