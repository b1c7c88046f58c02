"""The comparisons, one function each: check that the answers agree, then take the times."""

from functools import partial

import numpy as np
from scipy.optimize import least_squares

from benchmarks import ball, camera, poses, reconstruct, stripe
from benchmarks.peers import (
    Pybotics,
    pinocchio_forward,
    pinocchio_model,
    pinocchio_regressor,
)
from benchmarks.problem import NOISE, POINT, Problem, rms
from benchmarks.table import Disagreement, Row, agree, compare, fastest, writing_time
from robot_model.chain import forward
from workbench.core.least_squares.solver import solve
from workbench.core.rigid import rotation_matrix

FEW, MANY = 100, 7000
REPEATS = {FEW: 100, MANY: 15}
ASKED_OF_PYBOTICS = 10_000
PATIENCE = 1.25
"""How much longer than the required ratio pybotics may take before it is stopped."""
BASE_KEYS = ("x", "y", "z", "rx", "ry", "rz")
# pybotics: alpha, a, theta, d of each joint, then x, y, z, rz, ry, rx; at zero its Euler angles and
# our rotation vector have the same derivatives. Ours: base, then theta, d, a, alpha of each joint.
IN_PYBOTICS_ORDER = [6 + 4 * joint + k for joint in range(6) for k in (3, 2, 0, 1)] + [
    0,
    1,
    2,
    5,
    4,
    3,
]


def comparisons() -> list:
    """Functions that return a Row, in the order of the table."""
    fits = [fit_pybotics, fit_pybotics_vectors, fit_figaroh]
    fits += [fit_scipy_few, fit_scipy_many, fit_ceres_few, fit_ceres_many, sixty_few, sixty_many]
    parts = (poses, camera, reconstruct, stripe, ball)
    others = [row for part in parts for row in part.comparisons()]
    forwards = [forward_pybotics, forward_pinocchio]
    jacobians = [jacobian_pybotics, jacobian_pinocchio, jacobian_jax]
    return [*forwards, *jacobians, *fits, *others]


def forward_pybotics() -> Row:
    """pybotics' `fk`, a call a pose."""
    problem = Problem(MANY)
    ours, peer = partial(forward, problem.robot, problem.variables), Pybotics(problem).forward
    note = agree("flange positions in mm", abs(ours().end_origin.T - peer()).max(), 1e-9)
    return Row(f"FK of {MANY:,} poses, pybotics", *compare(ours, peer, (50, 5)), 100, note)


def forward_pinocchio() -> Row:
    """Pinocchio's forward kinematics, a call a pose."""
    problem = Problem(MANY)
    ours = partial(forward, problem.robot, problem.variables)
    peer = partial(pinocchio_forward, pinocchio_model(problem), problem.variables.T.copy())
    note = agree("flange positions in mm", abs(ours().end_origin.T - peer()).max(), 1e-9)
    return Row(
        f"FK of {MANY:,} poses, Pinocchio in a loop", *compare(ours, peer, (50, 30)), 5, note
    )


def jacobian_pybotics() -> Row:
    """Ours gives three rows a pose, pybotics' objective one: the length of the residual."""
    problem = Problem(MANY, craig=True)
    free = problem.free30(problem.model).update({f"base.{key}": 0.0 for key in BASE_KEYS})
    peer = Pybotics(problem, point=POINT).jacobian
    residual, rows = problem.model.linearise(free)
    ours = ((rows * residual).sum(1) / np.sqrt((residual**2).sum(0))).T[:, IN_PYBOTICS_ORDER]
    theirs = peer()
    difference = (abs(ours - theirs).max(0) / abs(theirs).max(0)).max()
    note = agree("columns, relative to their largest entry,", difference, 1e-4)
    times = compare(partial(problem.model.linearise, free), peer, (50, 1))
    return Row(f"30-parameter Jacobian, {MANY:,} poses, pybotics", *times, 2000, note)


def jacobian_pinocchio() -> Row:
    """Pinocchio's kinematic regressor: analytic, in C++, a call a pose; its columns are twists of joint placements.

    Along and about z of a joint's frame these are d and theta, on which the two are compared. An expert maps the other
    columns to the numbers of a joint by constant factors, for which no time is counted.
    """
    problem = Problem(MANY, craig=True)
    free = problem.free30(problem.model)
    keys = [f"joint-{k}.{name}{k}" for k in range(1, 7) for name in ("d", "theta")]
    compared = free.only(np.isin(free.keys, keys))
    order = [np.array(compared.keys)[compared.mask].tolist().index(key) for key in keys]
    base = problem.chain.start[:6]
    ours = partial(problem.model.linearise, free)
    model = pinocchio_model(problem, point=POINT)
    peer = partial(pinocchio_regressor, model, problem.variables.T.copy())
    turned = np.einsum("ij,kjn->kin", rotation_matrix(base[3:]), peer())
    columns = problem.model.linearise(compared)[1][order]
    difference = abs(columns - turned).max() / abs(columns).max()
    note = agree("columns of d and theta, relative to the largest entry,", difference, 1e-9)
    times = compare(ours, peer, (50, 5))
    return Row(f"30-parameter Jacobian, {MANY:,} poses, Pinocchio", *times, None, note)


def jacobian_jax() -> Row:
    """jax: forward-mode derivative of the same chain, vectorised and compiled; compilation is not counted."""
    from benchmarks.jax_peer import jacobian

    problem = Problem(MANY, craig=True)
    free = problem.free30(problem.model).update({f"base.{key}": 0.0 for key in BASE_KEYS})
    ours, peer = partial(problem.model.linearise, free), jacobian(problem, POINT)
    columns, theirs = ours()[1], peer().transpose(2, 0, 1)
    difference = abs(columns - theirs).max(axis=(1, 2)) / abs(columns).max(axis=(1, 2))
    note = agree("columns, relative to their largest entry,", difference.max(), 1e-9)
    note += f"; limit: {1e3 * writing_time(columns):.2g} ms to write the matrix once"
    times = compare(ours, peer, (50, 20))
    return Row(f"30-parameter Jacobian, {MANY:,} poses, jax", *times, None, note)


def fit_pybotics() -> Row:
    """pybotics' own objective, the length of each residual, on which Gauss-Newton steps creep."""
    problem, enough, seconds = _ours(FEW, craig=True)
    patience = ASKED_OF_PYBOTICS * seconds * PATIENCE
    taken, reached = _pybotics(problem, "distances", patience, enough)
    seconds = (seconds + _seconds_of_ours(problem)) / 2
    note, short = (
        f"3-D RMS: ours {enough:.4f} mm, pybotics' {reached:.4f} mm",
        reached > 1.01 * enough,
    )
    if short and taken < patience:
        raise Disagreement(f"scipy ended after {taken:.3g} s without the answer; {note}")
    if short:
        note += " where it was stopped"
    return Row(
        f"30-parameter fit, {FEW} points, pybotics",
        seconds,
        taken,
        ASKED_OF_PYBOTICS,
        note,
        at_least=short,
    )


def fit_pybotics_vectors() -> Row:
    """For information: who writes the vector residual himself gets far more out of pybotics."""
    problem, enough, seconds = _ours(FEW, craig=True)
    taken, reached = _pybotics(problem, "vectors", np.inf, enough)
    seconds = (seconds + _seconds_of_ours(problem)) / 2
    note = agree("3-D RMS in mm", max(reached - enough, 0.0), 0.01 * enough)
    note += "; for information: only the poses are pybotics', the objective is written for it here"
    return Row(f"30-parameter fit, {FEW} points, vectors from pybotics", seconds, taken, None, note)


def _ours(n, craig=False):
    """The problem, the 3-D RMS of our fit (mm) and its seconds."""
    problem = Problem(n, craig)
    fit = solve(problem.model, problem.free30(problem.model))
    if not fit.converged or rms(fit.residual) > 1.05 * np.sqrt(3) * NOISE:
        raise Disagreement(f"our own fit ended at {rms(fit.residual):.4f} mm: {fit.outcome}")
    return problem, rms(fit.residual), _seconds_of_ours(problem)


def _seconds_of_ours(problem):
    return fastest(REPEATS[problem.n], partial(solve, problem.model, problem.free30(problem.model)))


def _pybotics(problem, objective, seconds, enough):
    peer = Pybotics(problem, problem.chain.start[:6], POINT)
    return peer.fit(getattr(peer, objective), seconds, 1.01 * enough)


def fit_figaroh() -> Row:
    """figaroh's solve, with the parameters that it chose itself."""
    from benchmarks import figaroh_peer

    problem, ours, seconds = _ours(MANY)
    calibration = figaroh_peer.prepared(problem)
    taken, reached = figaroh_peer.solved(calibration)
    seconds = (seconds + _seconds_of_ours(problem)) / 2
    note = agree("3-D RMS in mm", abs(reached - ours), 1e-3 * ours)
    note += f"; figaroh chose {len(calibration.calib_config['param_name'])} identifiable parameters of the same arm"
    return Row(f"30-parameter fit, {MANY:,} points, figaroh", seconds, taken, 2000, note)


def fit_scipy_few() -> Row:
    """scipy with the analytic Jacobian of our model: only the solvers differ."""
    return _fit_scipy(FEW)


def fit_scipy_many() -> Row:
    """The same with many points."""
    return _fit_scipy(MANY)


def _fit_scipy(n) -> Row:
    problem, enough, seconds = _ours(n)
    free = problem.free30(problem.model)
    sigma = problem.model.sigma(free)

    def residual(x):
        return (problem.model.residual(free.unpack(x)) / sigma).ravel()

    def jacobian(x):
        rows = problem.model.linearise(free.unpack(x))[1] / sigma
        return rows.reshape(len(rows), -1).T

    def peer():
        return least_squares(residual, free.pack(), jacobian, x_scale="jac")

    reached = rms(problem.model.residual(free.unpack(peer().x)))
    note = agree("3-D RMS in mm", abs(reached - enough), 1e-3 * enough)
    note += f"; trust region, the same analytic Jacobian and start; {_least_rms(n)}"
    taken = fastest(REPEATS[n], peer)
    seconds = min(seconds, _seconds_of_ours(problem))
    return Row(f"30-parameter fit, {n:,} points, scipy", seconds, taken, None, note)


def fit_ceres_few() -> Row:
    """Ceres (pyceres) with the analytic Jacobian of our model, all residuals in one block."""
    return _fit_ceres(FEW)


def fit_ceres_many() -> Row:
    """The same with many points."""
    return _fit_ceres(MANY)


def _fit_ceres(n) -> Row:
    from benchmarks.ceres_peer import fit

    problem, enough, seconds = _ours(n)
    peer = partial(fit, problem.model, problem.free30(problem.model))
    reached = rms(problem.model.residual(peer()))
    note = agree("3-D RMS in mm", abs(reached - enough), 1e-3 * enough)
    note += f"; the same analytic Jacobian and start; {_least_rms(n)}"
    taken = fastest(REPEATS[n], peer)
    seconds = min(seconds, _seconds_of_ours(problem))
    return Row(f"30-parameter fit, {n:,} points, Ceres", seconds, taken, None, note)


def _least_rms(n) -> str:
    """What noise leaves after a fit of the 27 identifiable parameters."""
    return f"limit: RMS {NOISE * np.sqrt(3 - 27 / n):.4f} mm by noise"


def sixty_few() -> Row:
    """For information: with few points the number of calls counts, not that of parameters."""
    return _sixty(FEW, None)


def sixty_many() -> Row:
    """Twice the parameters in at most twice the time."""
    return _sixty(MANY, 0.5)


def _sixty(n, required) -> Row:
    """The peer is our own fit of 30: a ratio of 0.5 means twice its time."""
    problem = Problem(n)
    model, thirty = problem.model60(), partial(solve, problem.model, problem.free30(problem.model))
    sixty = partial(solve, model, problem.free60(model))
    fit = sixty()
    if not fit.converged:
        raise Disagreement(f"our fit of 60 ended with: {fit.outcome}")
    steps = f"{len(fit.history) - 1} steps, those of 30 {len(thirty().history) - 1}"
    note = f"{fit.parameters.mask.sum()} parameters in {steps}; 3-D RMS {rms(fit.residual):.4f} mm"
    times = compare(sixty, thirty, (REPEATS[n], REPEATS[n]))
    return Row(f"60 parameters (ours) against 30 (peer), {n:,} points", *times, required, note)
