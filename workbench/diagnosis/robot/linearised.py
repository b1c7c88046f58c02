"""A robot's fitted model as the arrays of a diagnosis: its solution, and all that a search compares with it."""

from dataclasses import replace
from functools import partial

import numpy as np

from robot_model.effects.elastic import SHIFTS, TURNS
from workbench.core.covariates import clock
from workbench.core.effect import Effect
from workbench.core.least_squares.linear_algebra import least_squares, thin_svd
from workbench.core.least_squares.solver import Fit
from workbench.core.model import NOISE, STATE_PORTS, Model
from workbench.diagnosis.levels import ROUNDING
from workbench.diagnosis.linear.candidates import Candidate
from workbench.diagnosis.linear.ends import Ends
from workbench.diagnosis.linear.problem import Problem, observable_basis
from workbench.diagnosis.robot.derived import linear_values
from workbench.diagnosis.robot.library import candidate_of
from workbench.diagnosis.robot.places import lengths, scans, sites

_PLAUSIBLE = {"mm": 1.0, "rad": 0.01}
"""By how much base, tool and links may be off together."""


def solution(model: Model, fit: Fit, weights, pose, effects) -> Problem:
    """The problem at a fit, without anything to compare with it."""
    evaluation = model.evaluate(fit.parameters)
    residual = model.joined(evaluation.residual)
    sigma = np.broadcast_to(model.sigma(fit.parameters), fit.residual.shape)
    white = np.sqrt(weights) / sigma
    rows = _Rows(model, evaluation, white)
    first = len(model.effects) - len(effects)
    bare = replace(model, effects=model.effects[:first])
    spans = model.spans[first:]
    state = model.chain.state
    added = _derivatives(model, fit, white, spans)
    basis = _baseline(bare, fit, white)
    values = tuple(
        linear_values(effect, fit.parameters.values[span], columns, state, rows, model.chain)
        for effect, span, columns in zip(model.effects[first:], spans, added)
    )
    added, values = _beyond_carriers(model, fit, white, effects, added, values, basis)
    ends = Ends(model.chain.poses_per_sample, residual.shape[1])
    covariates = {k: v for k, v in state.covariates.items() if k != "row"}
    sample = np.tile(np.arange(residual.shape[1]), len(sigma))
    return Problem(
        residual=(residual * white).ravel(),
        basis=basis,
        sample=sample,
        weights=weights,
        sigma=sigma.ravel().copy(),
        pose=pose,
        order=ends.mean(clock(state)),
        covariates=covariates,
        sites=(),
        candidates=(),
        effects=effects,
        widened=float(np.median(sigma / model.chain.stated_sigma)),
        added=added,
        values=values,
        precisions=tuple(fit.parameters.precision[span] for span in spans),
        ends=ends,
    )


def _beyond_carriers(model: Model, fit: Fit, white, effects, added, values, basis):
    """Columns (N, P) and values (P,) of all effects, those of loads orthogonal to the compliances' own columns.

    A load acts through every compliance. Its effect through one compliance is mostly proportional to the column of that
    compliance, which then has no gain conditional on the load. This part is removed from the load's columns and added
    to the value of the compliance, so that the sum of all effects does not change. A compliance that carries no load
    receives nothing.
    """
    carriers = [i for i, effect in enumerate(effects) if effect.carries_load]
    loads = [i for i, effect in enumerate(effects) if effect.port in STATE_PORTS]
    first = len(model.effects) - len(effects)
    plain, added, values = added, list(added), list(values)

    def clear(columns):
        return columns - basis @ (basis.T @ columns)

    for load in loads:
        for carrier in carriers:
            others = _columns_without(model, fit, white, first + load, first + carrier)
            carried = clear(plain[load] - others)
            orthogonal = clear(plain[carrier])
            mixing = least_squares(orthogonal, carried, ROUNDING)
            added[load] = added[load] - plain[carrier] @ mixing
            values[carrier] = values[carrier] + mixing @ values[load]
    return tuple(added), tuple(values)


def _columns_without(model: Model, fit: Fit, white, number: int, left_out: int) -> np.ndarray:
    """(N, P) whitened derivative by the parameters of one effect in a model without another; numbers from 0."""
    effects = tuple(e for i, e in enumerate(model.effects) if i != left_out)
    smaller = replace(model, effects=effects)
    span = smaller.spans[number - (number > left_out)]
    return _derivatives(smaller, fit, white, [span])[0]


def with_places(problem: Problem, model: Model, fit: Fit) -> Problem:
    """The problem with scans and places, of which a search compares functions with the residual."""
    rows = _rows_at(problem, model, fit)
    elastic = any(effect.elastic for effect in model.effects)
    return replace(
        problem,
        sites=sites(model.chain, rows),
        scans=scans(model.chain, rows, partial(_columns, model, fit, rows), elastic),
        growing=lengths(model.chain, rows),
    )


def with_candidates(problem: Problem, model: Model, fit: Fit, library, variants) -> Problem:
    """The problem with the columns of the library and of its variants with masses: most of a large recording."""
    rows = _rows_at(problem, model, fit)
    first = len(model.effects) - len(problem.effects)
    bare = replace(model, effects=model.effects[:first])
    values = {
        (e.effect, e.where): fit.parameters.values[span]
        for e, span in zip(bare.effects, bare.spans)
        if e.elastic
    }
    elastic = any(effect.elastic for effect in model.effects)
    with_masses, mass_laws = variants
    return replace(
        problem,
        candidates=_candidates(model, fit, rows, library(elastic)),
        with_masses=_candidates(model, fit, rows, with_masses),
        given=_given(bare, fit, rows.white),
        mass_responses=_candidates(model, fit, rows, mass_laws),
        given_values=values,
        columns_of=partial(_columns, model, fit, rows),
    )


def _rows_at(problem: Problem, model: Model, fit: Fit) -> "_Rows":
    sigma = np.broadcast_to(model.sigma(fit.parameters), fit.residual.shape)
    roots = np.sqrt(problem.weights)
    evaluation = model.evaluate(fit.parameters)
    return _Rows(model, evaluation, roots / sigma)


def _baseline(model: Model, fit: Fit, white) -> np.ndarray:
    """(N, R) basis of the baseline's Jacobian, linearised without further effects.

    An effect in the model lifts degeneracies of the geometry by its own small size. In these directions the geometry
    would have to change by centimetres to compensate a micrometre, which no prior permits.
    """
    start = model.parameters.take_over(fit.parameters)
    free = start.only(start.mask & ~_noise(model))
    table = [p for p, is_free in zip(free.table, free.mask) if is_free]
    sizes = np.array([min(p.typical, _PLAUSIBLE.get(p.unit, np.inf)) for p in table])
    residual, derivative = model.linearise(free)
    rows = (derivative * white).reshape(len(sizes), -1)
    columns = rows.T * sizes
    is_length = np.array([p.unit == "mm" for p in table])
    length_values = np.where(is_length, free.values[free.mask], 0.0)
    lengths = length_values / sizes
    white_residual = (residual * white).ravel()
    return observable_basis(_at_fixed_scale(columns, white_residual, lengths))


def _at_fixed_scale(columns: np.ndarray, residual: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Columns (N, F) without the change of all lengths (F,) together, where no measured length holds it.

    A residual that states a contact (a tip in a plane or in one point) is then proportional to the lengths. By Euler's
    theorem its derivative along them is the residual itself: a fit could only follow it by shrinking the arm to
    nothing. At adjusted observations the column is zero (Gauss-Helmert model: Mikhail, Observations and Least Squares,
    1976, ch. 8); at measured ones it contains their errors, and a projection onto it leaves no residual at all.
    """
    missing = columns @ lengths - residual
    if missing @ missing > ROUNDING * (residual @ residual):
        return columns
    u, s, vt = thin_svd(columns)
    largest = s[:1].max(initial=0.0)
    seen = s > ROUNDING * largest
    shrunk = vt[seen].T @ (
        u[:, seen].T @ residual / s[seen]
    )  # less the origins of frames, which are free
    length = max(shrunk @ shrunk, 1e-300)
    return columns - np.outer(residual, shrunk) / length


def _given(bare: Model, fit: Fit, white) -> float:
    """Whitened sum of squares of what the baseline's elastic laws make and its geometry does not."""
    elastic = [
        span
        for effect, span in zip(bare.effects, bare.spans)
        if effect.elastic and effect.port not in STATE_PORTS
    ]
    if not elastic:
        return 0.0
    contribution = sum(
        columns @ fit.parameters.values[span]
        for columns, span in zip(_derivatives(bare, fit, white, elastic), elastic)
    )
    plain = _baseline(replace(bare, effects=()), fit, white)
    return float(((contribution - plain @ (plain.T @ contribution)) ** 2).sum())


def _derivatives(model, fit, white, spans) -> tuple[np.ndarray, ...]:
    """(N, P) whitened derivative of the residual by the parameters of each of some spans, in ascending order."""
    if not spans:
        return ()
    start = model.parameters.take_over(fit.parameters)
    mask = np.zeros(len(start), bool)
    for span in spans:
        mask[span] = True
    derivative = model.linearise(start.only(mask))[1]
    rows = derivative * white
    widths = [span.stop - span.start for span in spans]
    edges = np.cumsum(widths)[:-1]
    return tuple(part.reshape(len(part), -1).T for part in np.split(rows, edges))


def _noise(model):
    mask = np.zeros(len(model.parameters), bool)
    for effect, span in zip(model.effects, model.spans):
        mask[span] = effect.port == NOISE
    return mask


class _Rows:
    """Whitened derivatives of the residual by the components of a port, made once a port."""

    def __init__(self, model, evaluation, white):
        joints = model.chain.robot.joints
        sizes = {
            "joint": joints,
            "frame": 6 * (joints + 2),
            "geometry": 5 * joints,
            "target": 3,
            "sensor": 3,
        }
        self._made, self._sizes, self._evaluation, self.white = {}, sizes, evaluation, white
        self.white_by_end = np.tile(white, model.chain.poses_per_sample)
        self.joined = model.joined

    def __call__(self, port, port_indices):
        """(k, m, E n): of each of the E arm poses that make a sample."""
        if port not in self._made:
            every_index = np.arange(self._sizes[port])
            derivative = self._evaluation.rows(port, every_index)
            self._made[port] = derivative * self.white_by_end
        return self._made[port][np.asarray(port_indices)]


def _candidates(model: Model, fit: Fit, rows: _Rows, library) -> tuple[Candidate, ...]:
    candidates = []
    for option in library:
        effect = option.effect
        columns = _columns(model, fit, rows, effect)
        typical = np.array([p.typical for p in effect.parameters(model.chain)])
        load = _load(model, effect) if effect.elastic and effect.nonnegative else 0.0
        candidates.append(candidate_of(option, columns, typical, load))
    return tuple(candidates)


def _load(model: Model, effect: Effect) -> float:
    """RMS over the samples of the torque or moment (N m) that an elastic law's first parameter multiplies.

    A twist has shifts (mm), too, by which it rotates about an axis of its own. They are no moment.
    """
    basis = model.basis(effect)[0]
    is_twist = len(basis) == len(SHIFTS + TURNS)
    moment = basis[list(TURNS)] if is_twist else basis
    return float(np.sqrt((moment**2).sum(0).mean()))


def _columns(model, fit, rows, effect, cause=None, by_end=False):
    """(N, P) whitened derivative of the residual by an effect's parameters at its null.

    cause: an effect on gravity or masses with C parameters; then (C, N, P), their change per unit of each. by_end: of
    each arm pose of a sample, (E N, P).
    """
    joined = (lambda columns: columns) if by_end else rows.joined
    if cause is not None:
        basis = model.basis(effect, cause)
        of_port = rows(effect.port, effect.port_indices(model.chain))
        change = joined(np.einsum("cpkn,kmn->cpmn", basis, of_port))
        return change.reshape(*change.shape[:2], -1).transpose(0, 2, 1)
    if effect.port in STATE_PORTS:
        derivative = joined(_by_load(model, fit, rows, effect))
    else:
        of_port = rows(effect.port, effect.port_indices(model.chain))
        derivative = joined(np.einsum("pkn,kmn->pmn", model.basis(effect), of_port))
    return derivative.reshape(len(derivative), -1).T


def _by_load(model: Model, fit: Fit, rows: _Rows, effect: Effect) -> np.ndarray:
    """(P, m, E n) whitened derivative of the residual of each arm pose by an effect on gravity or masses, through all
    that carries load."""
    present = tuple(e for e in model.effects if (type(e), e.where) != (type(effect), effect.where))
    wider = replace(model, effects=(*present, effect))
    start = wider.parameters.take_over(fit.parameters)
    is_new = np.arange(len(start)) >= wider.spans[-1].start
    start = start.only(is_new)
    evaluation = wider.evaluate(start)
    shape = (start.mask.sum(), *evaluation.residual.shape)
    derivative = np.empty(shape)
    rows_of_load = wider.fill_rows(evaluation, start, derivative)
    return rows_of_load * rows.white_by_end
