"""Which joints have an error curve, and at which resolution: decided by the marginal likelihood of all joints together.

One joint's curve hides another's as long as either is missing from the model, so that all curves are estimated at
once, linearised at a fit. Each octave of a joint's curve has its own prior scale (MacKay, Neural Computation 4 (1992)
415, eq. 3.9). An octave is retained where the marginal likelihood falls clearly without it.
"""

from dataclasses import dataclass

import numpy as np

from robot_model.effects.curve import JointCurve, curve_candidates
from workbench.core.least_squares.linear_algebra import covariance_of, symmetric_eigen
from workbench.core.model import Model
from workbench.core.parameters import Parameters

_MOST_SAMPLES = 3000
_ROUNDS, _SETTLED = 30, 0.02
_LEAST_SCALE, _MOST_SCALE = 1e-3, 3.0  # of the typical size
_CLEAR = 3.0  # fall of the log marginal likelihood that retains an octave
_WEAK = 1e-4  # precision of the baseline's parameters, per squared typical size


@dataclass(frozen=True)
class _Linear:
    """Normal equations of baseline and curves: `gram` (C, C), `right` (C,), `square` the residual's, `count` numbers.

    `group` (C,) number of the prior scale of each column, -1 for the baseline's.
    """

    gram: np.ndarray
    right: np.ndarray
    square: float
    count: int
    group: np.ndarray


def choose_joint_curves(model: Model, parameters: Parameters) -> tuple[tuple[str, str, dict], ...]:
    """(effect, where, options) rows of the joint curves that the samples of a fitted model support.

    parameters: the fit at which the model is linearised, with the free mask of the baseline.
    """
    if model.chain.poses_per_sample > 1:
        return ()  # a length between two poses adds two values of a curve, which are not separated here
    curves = [c for c in curve_candidates(model.chain) if not _is_held(c, model)]
    if not curves:
        return ()
    linear = _linearised(model, parameters, curves)
    if linear.square < np.finfo(float).tiny:  # the samples fit exactly: nothing is left for a curve
        return ()
    precision, variance = _scaled(linear)
    retained = _retained_octaves(linear, precision, variance, curves)
    rows = []
    for curve, octaves in zip(curves, retained):
        if octaves:
            options = dict(curve.options) | {"terms": min(2**octaves - 1, curve.terms)}
            rows.append((curve.effect, curve.where, options))
    return tuple(rows)


def _is_held(curve: JointCurve, model: Model) -> bool:
    return any((e.effect, e.where) == (curve.effect, curve.where) for e in model.effects)


def _linearised(model: Model, parameters: Parameters, curves) -> _Linear:
    step = -(-model.chain.n // _MOST_SAMPLES)
    part = model.at(np.arange(0, model.chain.n, step))
    residual, rows = part.linearise(parameters)
    sigma = np.broadcast_to(part.sigma(parameters), residual.shape)
    baseline = rows * parameters.typical[parameters.mask][:, None, None]
    evaluation = part.evaluate(parameters)
    columns = [baseline]
    group = [np.full(len(baseline), -1)]
    names: dict[str, int] = {}
    for curve in curves:
        typical = np.array([p.typical for p in curve.parameters(part.chain)])
        joint = evaluation.rows("joint", np.asarray(curve.port_indices(part.chain)))[0]
        waves = curve.basis(part.chain.state) * typical[:, None, None]
        columns.append(waves * joint[None])
        group.append(np.array([names.setdefault(g, len(names)) for g in curve.shrinkage_groups()]))
    flat = (np.concatenate(columns) / sigma).reshape(-1, residual.size)
    white = (residual / sigma).ravel()
    # the residual is predicted minus measured: a column times its coefficient is added to it
    return _Linear(
        flat @ flat.T, -flat @ white, float(white @ white), white.size, np.concatenate(group)
    )


def _scaled(linear: _Linear) -> tuple[np.ndarray, float]:
    """(C,) prior precisions and the noise variance that maximise the marginal likelihood."""
    precision = np.where(linear.group < 0, _WEAK, 1.0)
    variance = linear.square / linear.count
    for _ in range(_ROUNDS):
        covariance = covariance_of(linear.gram / variance, precision)
        mean = covariance @ linear.right / variance
        determined = 1 - precision * np.diag(covariance)
        before = precision.copy()
        for g in range(linear.group.max() + 1):
            is_of_group = linear.group == g
            scale = (mean[is_of_group] ** 2).sum() / max(determined[is_of_group].sum(), 1e-3)
            precision[is_of_group] = 1 / np.clip(scale, _LEAST_SCALE**2, _MOST_SCALE**2)
        residual_squares = linear.square - 2 * mean @ linear.right + mean @ linear.gram @ mean
        variance = max(residual_squares, 1e-12 * linear.square) / max(
            linear.count - determined.sum(), 1.0
        )
        if np.allclose(np.log(precision), np.log(before), atol=_SETTLED):
            break
    return precision, variance


def _log_evidence(linear: _Linear, precision, variance, retained) -> float:
    """Log marginal likelihood of the columns `kept` (C,) bool, up to a constant."""
    scale = 1 / np.sqrt(precision[retained])
    matrix = linear.gram[np.ix_(retained, retained)] * np.outer(scale, scale) / variance
    matrix[np.diag_indices_from(matrix)] += 1.0
    right = linear.right[retained] * scale / variance
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        # hardly any noise: rounding of the data is more than their priors' unit
        values, vectors = symmetric_eigen(matrix)
        values = np.maximum(values, 1.0)  # no eigenvalue is below that of the priors
        gained = (vectors.T @ right) / np.sqrt(values)
        return float(0.5 * gained @ gained - 0.5 * np.log(values).sum())
    gained = np.linalg.solve(factor, right)
    return float(0.5 * gained @ gained - np.log(np.diag(factor)).sum())


def _retained_octaves(linear: _Linear, precision, variance, curves) -> list[int]:
    """Number of octaves of each curve, 0 where the joint has none.

    The highest octave goes first, as long as the marginal likelihood does not fall clearly.
    """
    octaves = [curve.terms.bit_length() for curve in curves]
    retained = np.ones(len(linear.group), bool)
    now = _log_evidence(linear, precision, variance, retained)
    members = _members(linear, curves)
    changed = True
    while changed:
        changed = False
        for k in range(len(curves)):
            while octaves[k]:
                fewer = retained.copy()
                fewer[members[k][octaves[k] - 1]] = False
                evidence_without = _log_evidence(linear, precision, variance, fewer)
                if now - evidence_without > _CLEAR:
                    break
                retained, now, changed = fewer, evidence_without, True
                octaves[k] -= 1
    return octaves


def _members(linear: _Linear, curves) -> list[list[np.ndarray]]:
    """Columns of each octave of each curve."""
    first = int((linear.group < 0).sum())
    members = []
    for curve in curves:
        octave = np.array([j.bit_length() for j in range(1, curve.terms + 1)])
        columns = first + np.arange(curve.terms)
        members.append([columns[octave == o] for o in range(1, octave.max() + 1)])
        first += curve.terms
    return members


__all__ = ["choose_joint_curves"]
