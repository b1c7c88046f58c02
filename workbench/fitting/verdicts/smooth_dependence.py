"""Whether the residual of a calibration is a smooth function of one or two joint angles or recorded columns."""

from itertools import combinations

import numpy as np

from workbench.core.least_squares.adjustment_tests import regression_test
from workbench.core.least_squares.linear_algebra import thin_svd
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.fitting.verdicts.residual_structure import JOINTS, ORDER, Structure

_LEVEL = 0.001
_MOST_SAMPLES = 500
_TERMS, _PAIR_TERMS = (
    4,
    2,
)  # cosines over the visited range: as fast as two periods, one period of each of a pair
_SPARE = 4  # degrees of freedom of the residual per column of the widest test
_NOT_SMOOTH = ("row", "move", "approach")  # the order is tested by itself, and a side is no size


def smooth_dependence(model: Model, parameters: Parameters, residual: np.ndarray) -> Structure:
    """Partial F-tests for errors that are smooth in one or two variables; residual (m, n) of the fit, mm and rad.

    Variables are the joint variables and the recorded columns. The error is one of each joint in turn, or a
    displacement of the measured point along the axes of the measurement. A test with few columns sees an effect
    that is lost among all functions of all joints together. The smallest p-value counts times the number of tests
    (Bonferroni); where the samples are too few for a test, it is left out.
    """
    n = residual.shape[1]
    chosen = np.unique(np.linspace(0, n - 1, min(n, _MOST_SAMPLES)).astype(int))
    part = model.at(chosen)
    _, rows = part.linearise(parameters)
    root = 1 / part.sigma(parameters)
    white = (residual[:, chosen] * root).ravel()
    basis = _orthonormal((rows * root).reshape(len(rows), white.size).T)
    ports = _ports(part, parameters)
    degrees = white.size - basis.shape[1]
    tests = []
    for names, functions in _functions(part.chain):
        for port in ports:
            columns = _columns(part.chain, port, functions) * root
            if _SPARE * len(columns) <= degrees:
                flat = columns.reshape(len(columns), white.size).T
                tests.append((regression_test(white, basis, flat), names))
    if not tests:
        return Structure(1.0, 0.0, ())
    best, names = min(tests, key=lambda test: test[0].p_value)
    p = min(best.p_value * len(tests), 1.0)
    if p < _LEVEL:
        return Structure(p, best.share, names)
    return Structure(p, 0.0, ())


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """(N, r) orthonormal basis of the fitted parameters' columns (N, F)."""
    matrix = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    basis, values, _ = thin_svd(matrix)
    return basis[:, values > 1e-8 * values.max(initial=0)]


def _ports(model: Model, parameters: Parameters) -> list[np.ndarray]:
    """Derivatives (k, m, n) by an error of each joint, and by a displacement of the measured point."""
    chain = model.chain
    evaluation = chain.evaluate(parameters.values[: len(chain.parameters)], {})
    joints = evaluation.rows("joint", np.arange(len(chain.variables)))
    ports = [row[None] for row in joints]
    if chain.poses_per_sample == 1:
        size = joints.shape[1]
        directions = np.eye(min(3, size), size)[..., None]
        ports.append(np.broadcast_to(directions, (len(directions), size, joints.shape[2])))
    return ports


def _columns(chain, port: np.ndarray, functions: np.ndarray) -> np.ndarray:
    """(P, m, n) derivative by every function (f, n) times every component of a port."""
    columns = (port[:, None] * functions[None, :, None]).reshape(-1, *port.shape[1:])
    poses = chain.poses_per_sample
    if poses == 1:
        return columns
    return columns.reshape(*columns.shape[:-1], poses, -1).sum(-2)


def _functions(chain):
    """Names of what a test depends on, and functions (f, n): of every variable, and of every pair with a joint."""
    variables = list(_variables(chain))
    for name, cosines in variables:
        yield (name,), cosines
    for (first_name, first_columns), (second_name, second_columns) in combinations(variables, 2):
        if JOINTS not in (first_name, second_name):
            continue
        a = first_columns[:_PAIR_TERMS]
        b = second_columns[:_PAIR_TERMS]
        products = (a[:, None] * b[None]).reshape(-1, a.shape[1])
        yield tuple(dict.fromkeys((first_name, second_name))), np.concatenate([a, b, products])


def _variables(chain):
    """Name and cosines (4, n) of every joint variable and recorded column that varies."""
    for values in chain.variables:
        if np.ptp(values) > 1e-9:
            yield JOINTS, _cosines(values)
    for name, values in chain.state.covariates.items():
        if not name.startswith(_NOT_SMOOTH) and np.ptp(values) > 1e-9:
            yield ORDER if name == "time_s" else f"the recorded column {name}", _cosines(values)


def _cosines(values: np.ndarray) -> np.ndarray:
    """(4, n) cosine series over the visited range of values (n,)."""
    u = (values - values.min()) / np.ptp(values)
    return np.cos(np.pi * np.arange(1, _TERMS + 1)[:, None] * u)
