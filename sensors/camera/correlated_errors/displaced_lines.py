"""Displaced rows or columns of a board: forward selection on the residuals of all board poses.

Each line that is selected is tested on board poses that were left out. Camera and displacements come from the other
poses, the pose itself from its own corners; the sum of squares of these corners must fall. The same errors compare the
line with every other line in its place, and with none: their likelihoods make its probability.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensors.camera.correlated_errors.random_effects import Reduced
from sensors.camera.correlated_errors.shared_effects import BoardLine
from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.text.uncertain import with_std

_MAX_LINES = 3  # lines: more are uneven printing, which the variance component states
_SHARE = 0.8  # of the squares beyond noise that these lines explain; else other errors are as large
_SURE = 6.0  # standard uncertainties
_FEWEST_POSES = 3  # of which two predict the third


@dataclass(frozen=True)
class HeldOut:
    """Test of a line on board poses that were left out: `t` of the paired falls of the sum of squares, `probability`
    of the line among all lines and none, `rms` error (px) of a coordinate without and with it, `reselected`
    in so many of `poses` folds."""

    t: float
    probability: float
    rms: tuple[float, float]
    reselected: int
    poses: int


@dataclass(frozen=True)
class DisplacedLine:
    """A `line` of the board whose points are all displaced by `shift` (2,) mm in x and y of the board, with standard
    uncertainties `std` (2,) mm; `held_out` None where there are too few board poses for a test."""

    line: BoardLine
    shift: np.ndarray
    std: np.ndarray
    held_out: HeldOut | None = None

    @property
    def is_significant(self) -> bool:
        return bool((np.abs(self.shift) > _SURE * self.std).any())

    @property
    def sentence(self) -> str:
        """Place and displacement, in words."""
        kind, coordinate = ("column", "x") if self.line.axis == 0 else ("row", "y")
        sizes = [
            f"{with_std(value, std)} mm in {axis}"
            for axis, value, std in zip("xy", self.shift, self.std)
            if abs(value) > _SURE * std
        ]
        place = f"{kind} {self.line.number} of its points ({coordinate} = {self.line.at_mm:g} mm)"
        return f"{place} by {' and '.join(sizes)}"


def displaced_lines(
    data: Reduced, lines: Sequence[BoardLine], noise: float
) -> tuple[DisplacedLine, ...]:
    """Lines that explain most of what all effects of `data` do, the largest displacement first; () where few do not.

    noise: variance of the independent errors. Each step takes the line whose displacement, with those chosen before,
    reduces the sum of squares most.
    """
    excess = data.squares - data.degrees * noise
    if not len(lines) or not excess > 0:
        return ()
    sums = sums_of_lines(lines, len(data.pull))
    gram = sums.T @ data.gram @ sums
    pull = sums.T @ data.pull
    chosen: list[int] = []
    while len(chosen) < min(_MAX_LINES, len(lines)):
        trials = [chosen + [k] for k in range(len(lines)) if k not in chosen]
        chosen = max(trials, key=lambda trial: _explained(gram, pull, trial))
        if _explained(gram, pull, chosen) > _SHARE * excess:
            found = _described(gram, pull, lines, chosen, noise)
            return tuple(sorted(found, key=lambda line: -np.linalg.norm(line.shift)))
    return ()


def sums_of_lines(lines: Sequence[BoardLine], count: int) -> np.ndarray:
    """(count, 2 L) effects of points summed to those of lines, in x and in y."""
    sums = np.zeros((count, 2 * len(lines)))
    for k, line in enumerate(lines):
        for axis in (0, 1):
            sums[line.members[axis], 2 * k + axis] = 1.0
    return sums


def _columns(chosen: Sequence[int]) -> np.ndarray:
    return np.array([2 * k + axis for k in chosen for axis in (0, 1)], int)


def _explained(gram, pull, chosen) -> float:
    columns = _columns(chosen)
    shifts = np.linalg.lstsq(gram[np.ix_(columns, columns)], pull[columns], rcond=None)[0]
    return float(pull[columns] @ shifts)


def _described(gram, pull, lines, chosen, noise) -> list[DisplacedLine]:
    columns = _columns(chosen)
    inverse = np.linalg.pinv(gram[np.ix_(columns, columns)])
    # residuals are of the model less the image: a point that stands farther out makes them smaller
    shift = -inverse @ pull[columns]
    std = np.sqrt(noise * np.diag(inverse))
    estimates = zip(chosen, shift.reshape(-1, 2), std.reshape(-1, 2))
    found = [DisplacedLine(lines[k], shift, std) for k, shift, std in estimates]
    return [line for line in found if line.is_significant]


@dataclass(frozen=True)
class PoseTables:
    """Gram matrices (P, C, C) of each board pose's corners with the pose projected out, and their `degrees` (P,) of
    freedom. Columns: `shared` parameters with `precision`, two of each line (x, y), the residual last. `sigma` px: unit
    of the residual."""

    gram: np.ndarray
    degrees: np.ndarray
    shared: int
    precision: np.ndarray
    sigma: float = 1.0

    def held_out(self, chosen: Sequence[int]) -> np.ndarray:
        """(P,) sums of squares of each pose, with camera and the chosen lines' displacements from all others."""
        total = self.gram.sum(0)
        weights = (self._weights(total - block_gram, chosen) for block_gram in self.gram)
        return np.array([w @ block_gram @ w for w, block_gram in zip(weights, self.gram)])

    def reselected(self, chosen: Sequence[int], line: int, others: Sequence[int]) -> int:
        """Number of folds in which `line`, next to the other `chosen` lines, fits best of it and `others`."""
        retained = [k for k in chosen if k != line]
        total = self.gram.sum(0)
        trials = [[*retained, k] for k in (line, *others)]
        fits = np.array(
            [[self._fit(total - block_gram, trial) for trial in trials] for block_gram in self.gram]
        )
        return int((fits.argmin(1) == 0).sum())

    def _fit(self, gram: np.ndarray, chosen: Sequence[int]) -> float:
        """Sum of squares of poses with this Gram matrix, fitted to them."""
        weights = self._weights(gram, chosen)
        return float(weights @ gram @ weights)

    def _weights(self, gram: np.ndarray, chosen: Sequence[int]) -> np.ndarray:
        """(C,) factors of the columns whose sum is the residual of a fit to a Gram matrix (C, C)."""
        used = np.r_[np.arange(self.shared), self.shared + _columns(chosen)].astype(int)
        prior = np.diag(np.r_[self.precision, np.zeros(2 * len(chosen))])
        weights = np.zeros(len(gram))
        weights[used] = -solve_positive(gram[np.ix_(used, used)] + prior, gram[used, -1])
        weights[-1] = 1.0
        return weights


def with_held_out(
    displaced_lines: Sequence[DisplacedLine], lines: Sequence[BoardLine], tables: PoseTables
) -> tuple[DisplacedLine, ...]:
    """The displaced lines, all of `lines`, with their tests on left-out board poses."""
    if len(tables.gram) < _FEWEST_POSES:
        return tuple(displaced_lines)
    numbers = [_number_of(displaced.line, lines) for displaced in displaced_lines]
    tested = []
    for displaced, number in zip(displaced_lines, numbers):
        held_out = _held_out(tables, numbers, number, len(lines))
        tested.append(replace(displaced, held_out=held_out))
    return tuple(tested)


def _number_of(line: BoardLine, lines: Sequence[BoardLine]) -> int:
    """Position of the very object `line` in `lines`: lines hold arrays, which do not compare as a whole."""
    return next(number for number, other in enumerate(lines) if other is line)


def _held_out(tables: PoseTables, chosen: list[int], line: int, count: int) -> HeldOut:
    retained = [k for k in chosen if k != line]
    others = [k for k in range(count) if k not in chosen]
    without_line = tables.held_out(retained)
    with_it = tables.held_out(chosen)
    with_other_line = np.array([tables.held_out([*retained, k]).sum() for k in others])
    degrees = max(float(tables.degrees.sum()), 1.0)
    falls = (without_line - with_it) / np.maximum(tables.degrees, 1.0)
    spread = falls.std(ddof=1) / np.sqrt(len(falls))
    # the variance is that of the errors with the line: what other shared errors add to them counts as noise
    variance = with_it.sum() / degrees
    scores = (
        -0.5 * np.r_[with_it.sum(), without_line.sum(), with_other_line] / max(variance, 1e-300)
    )
    probability = float(np.exp(scores[0] - np.logaddexp.reduce(scores)))
    rms = tuple(
        tables.sigma * float(np.sqrt(squares.sum() / degrees))
        for squares in (without_line, with_it)
    )
    t = float(falls.mean() / spread) if spread > 0 else 0.0
    return HeldOut(t, probability, rms, tables.reselected(chosen, line, others), len(falls))
