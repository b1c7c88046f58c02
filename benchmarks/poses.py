"""The choice of 40 of 300 poses against figaroh's cone programme: time, and volume of what is known by both sets."""

import logging
from functools import partial

import numpy as np

from benchmarks.problem import Problem
from benchmarks.table import Row, fastest
from workbench.core.least_squares.design import choose
from workbench.core.least_squares.linear_algebra import symmetric_eigen

CANDIDATES, CHOSEN = 300, 40
_IDENTIFIABLE = 1e-9
"""Of the largest eigenvalue of the normal matrix at unit diagonal."""


def comparisons():
    """The rows' functions."""
    return [poses_figaroh]


def poses_figaroh() -> Row:
    """`SOCPOptimizer`: the continuous D-optimal design of all candidates, of which the largest weights are taken.

    Its optimum is an upper bound for every set: no 40 poses have a larger volume than 40 times its own.
    """
    rows = candidates()
    ours = partial(choose, rows, CHOSEN)
    weights, best = figaroh_weights(rows)
    theirs = np.argsort(-weights)[:CHOSEN]
    volumes = [_volume(rows[some]) for some in (ours().chosen, theirs)]
    note = (
        f"det^(1/F) of the normal matrix over that of the continuous design: ours {volumes[0] / CHOSEN / best:.4f}, "
        f"figaroh's {volumes[1] / CHOSEN / best:.4f} (limit 1); {rows.shape[2]} parameters"
    )
    seconds = fastest(5, ours), fastest(1, partial(figaroh_weights, rows))
    return Row(f"{CHOSEN} of {CANDIDATES} poses, figaroh's SOCP", *seconds, None, note)


def candidates() -> np.ndarray:
    """(N, 3, F) rows of the Jacobian at random poses, in the directions of the parameters that they identify."""
    problem = Problem(CANDIDATES)
    free = problem.free30(problem.model)
    made = problem.model.linearise(free)[1] * free.typical[free.mask][:, None, None]
    flat = made.reshape(len(made), -1)
    flat = flat / np.linalg.norm(flat, axis=1)[:, None]
    values, vectors = symmetric_eigen(flat @ flat.T)
    kept = vectors[:, values > _IDENTIFIABLE * values[-1]]
    return np.einsum("fmn,fk->nmk", flat.reshape(made.shape), kept)


def figaroh_weights(rows: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights (N,) of the candidates, in sum 1, and det^(1/F) of the weighted normal matrix."""
    from figaroh.optimal.base_optimal_calibration import SOCPOptimizer

    logging.disable(logging.WARNING)
    pool = dict(enumerate(np.swapaxes(rows, 1, 2) @ rows))
    weights, _ = SOCPOptimizer(pool, {"NbSample": len(rows)}).solve()
    weights = np.array(weights)
    return weights, _volume(np.sqrt(weights)[:, None, None] * rows)


def _volume(rows):
    flat = rows.reshape(-1, rows.shape[2])
    sign, log = np.linalg.slogdet(flat.T @ flat)
    return float(np.exp(log / flat.shape[1])) if sign > 0 else 0.0
