"""The comparisons, one function each: check that the answers agree, then take the times."""

from functools import partial

import numpy as np

from benchmarks.peers import Pybotics, pinocchio_forward, pinocchio_model
from benchmarks.problem import NOISE, POINT, Problem, rms
from benchmarks.table import Disagreement, Row, agree, best_of, timed
from robot_model.chain import forward
from workbench.core.solve import solve

FEW, MANY = 100, 7000
BASE_KEYS = ("x", "y", "z", "rx", "ry", "rz")
# pybotics: alpha, a, theta, d of each joint, then x, y, z, rz, ry, rx; at zero its Euler angles and
# our rotation vector have the same derivatives. Ours: base, then theta, d, a, alpha of each joint.
IN_PYBOTICS_ORDER = [6 + 4 * joint + k for joint in range(6) for k in (3, 2, 0, 1)] + [0, 1, 2, 5, 4, 3]
PATIENCE = 1.05
"""How much longer than the required ratio a peer may take before it is stopped."""


def comparisons(full: bool) -> list:
    """Functions that return a Row, in the order of the table."""
    figaroh = partial(fit_figaroh, full)
    figaroh.__name__ = "fit_figaroh"
    return [forward_pybotics, forward_pinocchio, jacobian_pybotics, fit_pybotics, fit_pybotics_vectors, figaroh, sixty_few, sixty_many]


def forward_pybotics() -> Row:
    problem = Problem(MANY)
    peer = Pybotics(problem)
    ours = partial(forward, problem.robot, problem.variables)
    note = agree("flange positions in mm", abs(ours().end_origin.T - peer.forward()).max(), 1e-9)
    return Row(f"FK of {MANY:,} poses, pybotics", best_of(50, ours), best_of(3, peer.forward), 100, note)


def forward_pinocchio() -> Row:
    problem = Problem(MANY)
    model, q = pinocchio_model(problem), problem.variables.T.copy()
    ours = partial(forward, problem.robot, problem.variables)
    note = agree("flange positions in mm", abs(ours().end_origin.T - pinocchio_forward(model, q)).max(), 1e-9)
    peer = best_of(20, lambda: pinocchio_forward(model, q))
    return Row(f"FK of {MANY:,} poses, Pinocchio in a loop", best_of(50, ours), peer, 5, note)


def jacobian_pybotics() -> Row:
    """Ours gives three rows a pose, pybotics' objective one: the length of the residual."""
    problem = Problem(MANY, craig=True)
    free = problem.free30(problem.model).update({f"base.{key}": 0.0 for key in BASE_KEYS})
    peer = Pybotics(problem, point=POINT)
    residual, rows = problem.model.linearise(free)
    ours = ((rows * residual).sum(1) / np.sqrt((residual**2).sum(0))).T
    seconds, theirs = timed(peer.jacobian)
    difference = abs(ours[:, IN_PYBOTICS_ORDER] - theirs).max(0) / abs(theirs).max(0)
    note = agree("columns, relative to their largest entry,", difference.max(), 1e-4)
    again = best_of(30, partial(problem.model.linearise, free))
    return Row(f"30-parameter Jacobian, {MANY:,} poses, pybotics", again, seconds, 2000, note)


def fit_pybotics() -> Row:
    """pybotics' objective is the length of each residual: scipy creeps, and is stopped at the ratio."""
    problem, ours, seconds = _ours(FEW, craig=True)
    taken, reached = _patient(problem, "distances", 10_000 * seconds * PATIENCE, ours)
    note = f"3-D RMS: ours {ours:.4f} mm, pybotics' {reached:.4f} mm"
    short = reached > 1.01 * ours
    if short and taken < 10_000 * seconds:
        note += " where scipy ended by itself, without the answer"
    elif short:
        note += " when it was stopped, still falling"
    return Row(f"30-parameter fit, {FEW} points, pybotics' objective", seconds, taken, 10_000, note, at_least=short)


def fit_pybotics_vectors() -> Row:
    """For information: a user who writes the vector residual himself gets far more out of pybotics."""
    problem, ours, seconds = _ours(FEW, craig=True)
    taken, reached = _patient(problem, "vectors", np.inf, ours)
    note = agree("3-D RMS in mm", max(reached - ours, 0.0), 0.01 * ours) + "; the objective is ours, only the poses are pybotics'"
    return Row(f"30-parameter fit, {FEW} points, vectors from pybotics", seconds, taken, None, note)


def _ours(n, craig=False):
    """The problem, the 3-D RMS of our fit (mm) and its seconds."""
    problem = Problem(n, craig)
    free = problem.free30(problem.model)
    fit = solve(problem.model, free)
    if not fit.converged or rms(fit.residual) > 1.05 * np.sqrt(3) * NOISE:
        raise Disagreement(f"our own fit ended at {rms(fit.residual):.4f} mm: {fit.outcome}")
    return problem, rms(fit.residual), best_of(50 if n == FEW else 10, partial(solve, problem.model, free))


def _patient(problem, objective, seconds, enough):
    peer = Pybotics(problem, problem.chain.start[:6], POINT)
    return peer.fit(getattr(peer, objective), seconds, 1.01 * enough)


def fit_figaroh(full: bool) -> Row:
    """figaroh's solve; unless `full`, evaluations as on 700 points at the time of one on 7,000."""
    from benchmarks import figaroh_peer

    problem, ours, seconds = _ours(MANY)
    measured = problem if full else Problem(MANY // 10)
    calibration = figaroh_peer.prepared(measured)
    taken, reached = figaroh_peer.solved(calibration)
    ours_there = ours if full else _ours(measured.n)[1]
    note = agree("3-D RMS in mm", abs(reached - ours_there), 1e-3 * ours_there)
    note += f"; figaroh chose {len(calibration.calib_config['param_name'])} identifiable parameters of the same arm"
    if not full:
        taken *= MANY / measured.n
        note += f"; extrapolated from {measured.n} points, linear in the points (its loop is over them; --full runs all)"
    return Row(f"30-parameter fit, {MANY:,} points, figaroh", seconds, taken, 2000, note)


def sixty_few() -> Row:
    return _sixty(FEW)


def sixty_many() -> Row:
    return _sixty(MANY)


def _sixty(n) -> Row:
    """The peer is our own fit of 30: a ratio of 0.5 means twice its time."""
    problem, ours, thirty = _ours(n)
    model = problem.model60()
    free = problem.free60(model)
    fit = solve(model, free)
    note = f"{free.mask.sum()} parameters, {len(fit.history) - 1} steps, 3-D RMS {rms(fit.residual):.4f} mm (30: {ours:.4f} mm)"
    if not fit.converged:
        raise Disagreement(f"our fit of 60 ended with: {fit.outcome}")
    sixty = best_of(50 if n == FEW else 10, partial(solve, model, free))
    return Row(f"60 parameters (ours) against 30 (peer), {n:,} points", sixty, thirty, 0.5 if n == MANY else None, note)
