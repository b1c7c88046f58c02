"""Whether what a final model leaves is alike at neighbouring poses, which noise of any size is not.

A residual above the stated noise is larger noise only where it is white. Smooth functions of one or two covariates miss
a foot that rocks over an edge or a part that snaps over. Residuals of neighbours are alike all the same: the sum of
their products, weighted by a kernel of their distance (Moran's I: Cliff & Ord, Spatial Processes (1981), ch. 7), is
compared with that of permuted residuals, from which the fitted directions are taken as well.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from workbench.core.distributions import chi2
from workbench.diagnosis.levels import DATA_FAULT_LEVEL
from workbench.diagnosis.linear.problem import Finding, Problem
from workbench.explanation.sentences.statements import NEIGHBOURS

_NEIGHBOURS, _TRIALS, _MOST_SAMPLES = 6, 200, 500
"""Neighbours within the width of the kernel, permutations, and samples that are compared with one another."""
_GRAVITY = ("down_x", "down_y", "down_z")
_LEAST_SKEWNESS = (
    0.1  # of a sum of squares of many samples, which so few permutations hardly tell from 0
)


def local_structure(problem: Problem, before: Problem, points: np.ndarray) -> Finding | None:
    """The unknown at the base or the tool that makes neighbours alike; None where permuted residuals are as alike.

    problem: of the final model, conditional on its terms; before: of the baseline, with its places; points (3, n) mm:
    measured points. Coordinates in the frame of the measurement show what acts at the base, those in the frame of the
    tool what acts there.
    """
    n = problem.n
    m = len(problem.residual) // problem.n
    if len(problem.residual) != m * n or problem.ends.count > 1:
        return None
    found, count = None, 0
    of_frames = {"base": None, "tool": _tool_axes(before, m)}
    residual = problem.orthogonalise(problem.residual)
    rng = np.random.default_rng(0)
    permuted = [residual.reshape(m, n)[:, rng.permutation(n)].ravel() for _ in range(_TRIALS)]
    columns = np.column_stack([residual, problem.orthogonalise(np.stack(permuted, 1))])
    used = np.arange(0, n, -(-n // _MOST_SAMPLES))
    for names, values in _spaces(problem, points):
        kernel = _kernel(values[:, used], problem.pose[used])
        for where, axes in of_frames.items():
            if where != "base" and axes is None:
                continue
            count += 1
            p = _p_value(_in_frame(columns.reshape(m, n, -1), axes)[:, used], kernel)
            if found is None or p < found[0]:
                found = p, where, names
    if found is None or found[0] * count > DATA_FAULT_LEVEL:
        return None
    p, where, names = found
    return Finding("unknown", where, NEIGHBOURS + names, (), p * count, 1.0 - p * count, 0.0, 0.0)


def _tool_axes(before: Problem, components: int) -> np.ndarray | None:
    """(3, m, n) unit vectors of the tool in the measured components; None where these are no three coordinates."""
    tool = [s for s in before.sites if (s.where, s.port) == ("tool", "frame")]
    if not tool or components != 3:
        return None
    axes = tool[0].rows[:3].reshape(3, components, before.n)
    return axes / np.maximum(np.sqrt((axes**2).sum(1, keepdims=True)), 1e-300)


def _in_frame(values: np.ndarray, axes: np.ndarray | None) -> np.ndarray:
    """(m, n, T) values of samples along other axes (k, m, n)."""
    if axes is None:
        return values
    return np.einsum("kmn,mnt->knt", axes, values)


def _spaces(problem: Problem, points: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """(names, (C, n) standardised values) of covariates in which poses are neighbours."""
    known = {name: x for name, x in problem.sample_covariates.items() if np.ptp(x) > 0}
    joints = sorted(name for name in known if name[:1] == "q" and name[1:].isdigit())
    groups = {"all joint positions": joints}
    groups |= {f"the position of joint {name[1:]}": [name] for name in joints}
    for names in combinations(joints, 3):
        groups["the positions of joints {}, {} and {}".format(*(name[1:] for name in names))] = (
            names
        )
    groups["the direction of gravity in the tool"] = [name for name in _GRAVITY if name in known]
    for label, names in groups.items():
        if names:
            yield label, np.stack([known[name] / known[name].std() for name in names])
    yield "the order of the samples", np.argsort(np.argsort(problem.order))[None].astype(float)
    yield "the measured position", points / max(float(points.std(1).max()), 1e-300)


def _kernel(values: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """(n, n) weights of pairs of samples by the distance of their values (C, n); 0 of one pose, which errs as one."""
    squares = (values**2).sum(0)
    distance = np.maximum(squares[:, None] + squares - 2 * values.T @ values, 0.0)
    is_same = pose[:, None] == pose
    distance[is_same] = np.inf
    number = min(_NEIGHBOURS, len(pose) - 1) - 1
    width = np.sqrt(np.partition(distance, number, axis=1)[:, number])
    product = np.outer(width, width)
    ratio = np.divide(distance, product, out=np.full_like(distance, np.inf), where=product > 0)
    return np.where(is_same, 0.0, np.exp(-ratio))


def _p_value(values: np.ndarray, kernel: np.ndarray) -> float:
    """p-value that neighbours are no more alike in the first of values (m, n, T) than in the others, permuted.

    By a scaled chi-square distribution with the mean, variance and skewness of the permuted ones.
    """
    similarity = sum((part * (kernel @ part)).sum(0) for part in values) / (values**2).sum((0, 1))
    mean = similarity[1:].mean()
    std = max(float(similarity[1:].std()), 1e-300)
    skewness = max(float((((similarity[1:] - mean) / std) ** 3).mean()), _LEAST_SKEWNESS)
    degrees = 8 / skewness**2
    z = float((similarity[0] - mean) / std)
    return float(chi2.sf(degrees + z * np.sqrt(2 * degrees), degrees))


__all__ = ["local_structure"]
