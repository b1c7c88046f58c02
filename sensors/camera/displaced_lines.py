"""Which rows or columns of a board are displaced: forward selection on what the images leave of all board poses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sensors.camera.random_effects import Reduced
from sensors.camera.shared_effects import BoardLine
from workbench.core.text.uncertain import with_std

_MOST = 3  # lines: more are uneven printing, which the variance component states
_SHARE = 0.8  # of the squares beyond noise that these lines explain; else other errors are as large
_SURE = 6.0  # standard uncertainties


@dataclass(frozen=True)
class DisplacedLine:
    """A `line` of the board whose points are all displaced by `shift` (2,) mm in x and y of the board, with standard
    uncertainties `std` (2,) mm."""

    line: BoardLine
    shift: np.ndarray
    std: np.ndarray

    @property
    def is_sure(self) -> bool:
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
    beyond = data.squares - data.degrees * noise
    if not len(lines) or not beyond > 0:
        return ()
    sums = _sums(lines, len(data.pull))
    gram, pull = sums.T @ data.gram @ sums, sums.T @ data.pull
    chosen: list[int] = []
    while len(chosen) < min(_MOST, len(lines)):
        trials = [chosen + [k] for k in range(len(lines)) if k not in chosen]
        chosen = max(trials, key=lambda trial: _explained(gram, pull, trial))
        if _explained(gram, pull, chosen) > _SHARE * beyond:
            found = _described(gram, pull, lines, chosen, noise)
            return tuple(sorted(found, key=lambda one: -np.linalg.norm(one.shift)))
    return ()


def _sums(lines, count) -> np.ndarray:
    """(count, 2 L) effects of points summed to those of lines, in x and in y."""
    made = np.zeros((count, 2 * len(lines)))
    for k, line in enumerate(lines):
        for axis in (0, 1):
            made[line.members[axis], 2 * k + axis] = 1.0
    return made


def _columns(chosen: list[int]) -> np.ndarray:
    return np.array([2 * k + axis for k in chosen for axis in (0, 1)])


def _explained(gram, pull, chosen) -> float:
    columns = _columns(chosen)
    own = np.linalg.lstsq(gram[np.ix_(columns, columns)], pull[columns], rcond=None)[0]
    return float(pull[columns] @ own)


def _described(gram, pull, lines, chosen, noise) -> list[DisplacedLine]:
    columns = _columns(chosen)
    inverse = np.linalg.pinv(gram[np.ix_(columns, columns)])
    # residuals are of the model less the image: a point that stands farther out makes them smaller
    shift, std = -inverse @ pull[columns], np.sqrt(noise * np.diag(inverse))
    parts = zip(chosen, shift.reshape(-1, 2), std.reshape(-1, 2))
    found = [DisplacedLine(lines[k], own, doubt) for k, own, doubt in parts]
    return [one for one in found if one.is_sure]
