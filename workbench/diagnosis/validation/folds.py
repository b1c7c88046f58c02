"""Ways to leave samples out: blocks of time, blocks of the workspace, and placements of a sensor in turn.

Folds never part what was measured at one pose. There are two schemes for an arm, because they ask different things:
a slow drift is not predicted across blocks of time, and a wrong law is not predicted across blocks of the workspace.
"""

from dataclasses import dataclass

import numpy as np

from workbench.diagnosis.linear.problem import Problem
from workbench.fitting.cross_validation import blocks

TIME, SPACE, ROUND_ROBIN = (
    "blocks of time",
    "blocks of the workspace",
    "placements and balls in turn",
)
LEAST_FOLDS = 5
"""Folds in which a validation repeats the search at least: the blocks of time."""
_HALVINGS = 2
"""Of the workspace: three quarters of the poses determine the geometry, as four fifths do without a block of time."""
_MIN_POSES_OF_FIFTHS = 50
"""Poses below which a fold leaves out half as many: the other four fifths would not determine the geometry."""
_SEARCHED = 900  # samples that a search inside a fold sees at most; what it finds is fitted on all of the fold
MAX_TESTED_SAMPLES = 3000
"""Samples on which the terms of a fold, their controls and the remainder are tested at most: a large recording is no
better known by a test on all of it, and each takes as much longer."""


@dataclass(frozen=True, eq=False)
class Scheme:
    """`name` of a way to part the samples and the `fold` (n,) int of each; equal only to itself."""

    name: str
    fold: np.ndarray

    @property
    def folds(self) -> range:
        """Numbers of its folds."""
        return range(int(self.fold.max()) + 1)

    def at(self, samples: np.ndarray | None) -> "Scheme":
        """The same scheme on some of its samples (n,) bool (None: all)."""
        if samples is None:
            return self
        return Scheme(self.name, self.fold[samples])


def schemes(pose: np.ndarray, problem: Problem) -> list[Scheme]:
    """Blocks of time and, for an arm, blocks of the workspace; for images, every fifth placement and ball."""
    if "u" in problem.covariates:
        return [Scheme(ROUND_ROBIN, _round_robin_folds(pose, problem))]
    by_order = np.argsort(problem.order, kind="stable")
    time = np.empty(problem.n, int)
    has_few_poses = len(np.unique(pose)) < _MIN_POSES_OF_FIFTHS
    count = LEAST_FOLDS * (1 + has_few_poses)
    time[by_order] = blocks(pose[by_order], count)
    space = _workspace_folds(pose, problem)
    return [Scheme(TIME, time)] + ([] if space is None else [Scheme(SPACE, space)])


def _round_robin_folds(pose: np.ndarray, problem: Problem) -> np.ndarray:
    """(n,) block of each sample: placements of boards and balls dealt out in turn, so that no block lacks a kind."""
    poses, group = np.unique(pose, return_inverse=True)
    board = np.zeros(len(poses), bool)  # a corner has two coordinates, a stripe one
    board[group[np.bincount(problem.sample, minlength=problem.n) > 1]] = True
    number_of_board = np.cumsum(board) - 1
    number_of_stripe = np.cumsum(~board) - 1
    rank = np.where(board, number_of_board, number_of_stripe)
    boards = max(int(board.sum()), 2)
    return (rank % min(LEAST_FOLDS, boards))[group]


def _workspace_folds(pose: np.ndarray, problem: Problem) -> np.ndarray | None:
    """(n,) block of each sample: poses halved at the median of what spreads most, and each half again."""
    known = problem.sample_covariates
    names = [c for c in ("q1", "q2", "q3") if np.ptp(known.get(c, np.zeros(1))) > 0]
    if not names:
        return None
    poses, group = np.unique(pose, return_inverse=True)
    if len(poses) < 2 ** (_HALVINGS + 1):
        return None
    count = np.bincount(group)
    place = np.stack([np.bincount(group, known[c]) / count for c in names])
    times = _HALVINGS + (len(poses) < _MIN_POSES_OF_FIFTHS)
    return _halves(
        place / np.maximum(place.std(1, keepdims=True), 1e-12), np.arange(len(poses)), times
    )[group]


def _halves(place, rows, times) -> np.ndarray:
    """(len(rows),) block of each row."""
    if times == 0:
        return np.zeros(len(rows), int)
    widest = int(np.argmax(place[:, rows].std(1)))
    coordinate = place[widest, rows]
    in_order = np.argsort(coordinate, kind="stable")
    rank = np.argsort(in_order, kind="stable")
    upper = rank >= len(rows) / 2
    out = np.empty(len(rows), int)
    for half, first in ((~upper, 0), (upper, 2 ** (times - 1))):
        out[half] = first + _halves(place, rows[half], times - 1)
    return out


def thinned(pose: np.ndarray, samples: np.ndarray, max_samples: int = _SEARCHED) -> np.ndarray:
    """(n,) bool: at most so many of the samples (n,) bool: every second, third ... pose.

    Where the poses are few, as of a recording with many repeats, each keeps some of its rows instead.
    """
    step = int(np.ceil(samples.sum() / max_samples))
    chosen, place = np.unique(pose[samples], return_inverse=True)
    if step > 1 and len(chosen) < 2 * step * _MIN_POSES_OF_FIFTHS:
        keep = _some_rows_of_each_pose(place, step)
    else:
        keep = place % step == 0
    out = np.zeros(len(samples), bool)
    out[np.flatnonzero(samples)[keep]] = True
    return out


def _some_rows_of_each_pose(place: np.ndarray, step: int) -> np.ndarray:
    """(n,) bool: one in `step` rows, at random but always the same, of every pose; place (n,): number of the pose."""
    mixed = np.random.default_rng(0).permutation(len(place))
    by_pose = np.argsort(place[mixed], kind="stable")
    order = mixed[by_pose]
    keep = np.zeros(len(place), bool)
    keep[order[::step]] = True
    return keep


def tested_samples(bench) -> np.ndarray | None:
    """(n,) bool: the samples of a large recording on which its terms are tested; None for all."""
    if bench.chain is None or len(bench.pose) <= MAX_TESTED_SAMPLES:
        return None
    return thinned(bench.pose, np.ones(len(bench.pose), bool), MAX_TESTED_SAMPLES)
