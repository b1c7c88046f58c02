"""Options that are real numbers (an order, a frequency, a time constant), off the grid on which they are searched.

Of a family the search knows its variants on a grid. One that is accepted gets the value that the data determine, and is
then a further variant of its family: a `Candidate`, or a `Scan` with this one option.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from workbench.diagnosis.linear.candidates import Candidate, Scan
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.linear.problem import Problem


@dataclass(frozen=True)
class RealFamily:
    """The variants of an accepted hypothesis in a problem: `name` of their option and its `grid` (V,), ascending."""

    problem: Problem
    own: Hypothesis
    name: str
    grid: np.ndarray

    @classmethod
    def of(cls, problem: Problem, own: Hypothesis) -> "RealFamily | None":
        """None where its option is no real number, or has a single value."""
        source = own.source
        name = source.option
        if not name:
            return None
        if isinstance(source, Scan):
            base = _base_of(source, problem)
            values = [] if base is None else base.options.tolist()
        else:
            variants = [c for c in problem.candidates if c.word == source.word != ""]
            alike = [c for c in variants if (c.effect, c.where) == own.key and c.key != source.key]
            values = [getattr(c.effects[0], name) for c in alike]
        return cls(problem, own, name, np.unique(values)) if len(values) > 1 else None

    @property
    def value(self) -> float:
        """The present value."""
        return float(getattr(self.own.effects[0], self.name))

    @property
    def bracket(self) -> tuple[float, float]:
        """The neighbours of the present value on the grid; at an end of the grid as far away as the next value is.

        A few variants span what is plausible, and no option is more than one step, as a factor, beyond them. A fine
        grid of orders or frequencies ends anywhere, so that its step counts from the present value.
        """
        grid, value = self.grid, self.value
        if isinstance(self.own.source, Candidate):
            beyond = grid[0] ** 2 / grid[1], grid[-1] ** 2 / grid[-2]
        else:
            first, last = np.diff(grid)[[0, -1]]
            beyond = max(value - first, value / 2), value + last
        lower, upper = grid[grid < value], grid[grid > value]
        low = lower.max() if len(lower) else beyond[0]
        return float(low), float(upper.min() if len(upper) else beyond[1])

    def columns(self, value: float) -> np.ndarray:
        """(N, P) whitened columns in typical sizes at a value."""
        source = self.own.source
        if isinstance(source, Candidate):
            return self.problem.columns_of(self._effects(value)[0]) * source.typical
        return source.columns_at(self.problem, value)

    def at(self, value: float) -> Hypothesis:
        """The hypothesis with another value."""
        source, effects = self.own.source, self._effects(value)
        label = source.word.format(value)
        if isinstance(source, Candidate):
            columns = self.problem.columns_of(effects[0])
            source, value = replace(source, label=label, effects=effects, columns=columns), None
        else:
            source = _base_of(source, self.problem).with_exact_option(value)
        return replace(self.own, label=label, effects=effects, source=source, value=value)

    def _effects(self, value: float) -> tuple:
        if not isinstance(self.own.source, Candidate):
            return self.own.source.make(value)
        effect = self.own.effects[0]
        return (type(effect)(effect.where, **effect.options | {self.name: value}),)


def with_exact_options(problem: Problem, hypotheses: Sequence[Hypothesis]) -> Problem:
    """The problem with a variant more for each hypothesis whose option is off the grid."""
    scans, candidates = [], []
    for h in hypotheses:
        source = h.source
        if source is None or source.key in problem.sources:
            continue
        if isinstance(source, Candidate) and source.option:
            candidates.append(replace(source, columns=problem.columns_of(source.effects[0])))
        elif isinstance(source, Scan) and (base := _base_of(source, problem)) is not None:
            scans.append(base.with_exact_option(h.value))
    if not scans and not candidates:
        return problem
    # what is known of the candidates is known by their number
    return replace(
        problem,
        candidates=(*problem.candidates, *candidates),
        scans=(*problem.scans, *scans),
        cache={},
    )


def _base_of(scan: Scan, problem: Problem) -> Scan | None:
    """The scan over the whole grid; None where the problem does not hold it."""
    return problem.sources.get(scan.key[:-1] if scan.is_exact else scan.key)
