"""Maximum-likelihood values of options that are real numbers: a grid finds a frequency, the data determine it.

What an accepted effect leaves because its option is that of a grid is fitted by other effects, which are then named
falsely. So the option of each accepted effect is estimated before the search goes on (variable projection: Golub &
Pereyra, SIAM J. Numer. Anal. 10 (1973) 413). The effect with that value is a further variant of its family: a
`Candidate`, or a `Scan` with this one option.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander
from scipy.optimize import minimize_scalar

from workbench.core.least_squares.linear_algebra import least_squares, pseudo_inverse
from workbench.diagnosis.levels import MAX_ROUNDS, ROUNDING, SIGNIFICANT_SIGMAS
from workbench.diagnosis.linear.candidates import Candidate, Scan
from workbench.diagnosis.linear.estimates import RealOption
from workbench.diagnosis.linear.evidence import Projected
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.linear.problem import Problem

_CLOSE = 0.1  # standard deviations of an option that are worth no other solution
_CLEAR = 100.0
"""Fall of the sum of squares over the variance that is left: a grid leaves a hundredth of it, which is then a sigma."""
_RESOLUTION = 1e-5  # of the distance between neighbours of a grid
_NODES = 9
"""Values between two neighbours of a grid at which columns are computed: a wave turns by a few radians there."""
_STEP = 1e-4  # of the same, half-step of a derivative


@dataclass(frozen=True)
class RealFamily:
    """The variants of an accepted hypothesis in a problem: `name` of their option and its `grid` (V,), ascending."""

    problem: Problem
    hypothesis: Hypothesis
    name: str
    grid: np.ndarray

    @classmethod
    def of(cls, problem: Problem, hypothesis: Hypothesis) -> "RealFamily | None":
        """None where its option is no real number, or has a single value."""
        source = hypothesis.source
        name = source.option
        if not name:
            return None
        if isinstance(source, Scan):
            base = _base_of(source, problem)
            values = [] if base is None else base.options.tolist()
        else:
            variants = [c for c in problem.candidates if c.word == source.word != ""]
            same_law = [
                c for c in variants if (c.effect, c.where) == hypothesis.key and not c.is_exact
            ]
            values = [getattr(c.effects[0], name) for c in same_law]
        if len(values) > 1:
            return cls(problem, hypothesis, name, np.unique(values))
        return None

    @property
    def value(self) -> float:
        """The present value."""
        return float(getattr(self.hypothesis.effects[0], self.name))

    @property
    def bracket(self) -> tuple[float, float]:
        """The neighbours of the present value on the grid; at an end of the grid as far away as the next value is.

        A few variants span what is plausible, and no option is more than one step, as a factor, beyond them. A fine
        grid of orders or frequencies ends anywhere, so that its step counts from the present value.
        """
        grid, value = self.grid, self.value
        if isinstance(self.hypothesis.source, Candidate):
            outer_bounds = grid[0] ** 2 / grid[1], grid[-1] ** 2 / grid[-2]
        else:
            gaps = np.diff(grid)
            first, last = gaps[[0, -1]]
            outer_bounds = max(value - first, value / 2), value + last
        lower = grid[grid < value]
        upper = grid[grid > value]
        low = lower.max() if len(lower) else outer_bounds[0]
        return float(low), float(upper.min() if len(upper) else outer_bounds[1])

    def columns(self, value: float) -> np.ndarray:
        """(N, P) whitened columns in typical sizes at a value."""
        source = self.hypothesis.source
        if isinstance(source, Candidate):
            return self.problem.columns_of(self._effects(value)[0]) * source.typical
        return source.columns_at(self.problem, value)

    def at(self, value: float) -> Hypothesis:
        """The hypothesis with another value."""
        source = self.hypothesis.source
        effects = self._effects(value)
        label = source.word.format(value)
        if isinstance(source, Candidate):
            columns = self.problem.columns_of(effects[0])
            made = {"label": label, "effects": effects, "columns": columns, "is_exact": True}
            source = replace(source, **made)
            value = None
        else:
            source = _base_of(source, self.problem).with_exact_option(value)
        return replace(self.hypothesis, label=label, effects=effects, source=source, value=value)

    def _effects(self, value: float) -> tuple:
        if not isinstance(self.hypothesis.source, Candidate):
            return self.hypothesis.source.make(value)
        effect = self.hypothesis.effects[0]
        options = effect.options | {self.name: value}
        return (type(effect)(effect.where, **options),)


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


def refine_options(search, is_first: bool = False, rounds: int = MAX_ROUNDS) -> None:
    """Give the options of all accepted hypotheses the values that the data determine, and solve with them.

    Conditional on all others. is_first: on those before it alone, in the order in which they explain most. What
    explains less may be what an option that is not known yet leaves, and would keep it from its value. A value that
    the solution with another one leads back to is as good as that. rounds: solutions at most; a search that goes on
    needs one.
    """
    tried = []
    for _ in range(rounds):
        refined = []
        for i, h in enumerate(search.accepted):
            others = tuple(range(i)) if is_first else search.other_indices(i)
            refined.append(_refined(_Profile.of(search, i, others), h))
        tried.append(_names(search.accepted))
        if _names(refined) in tried or not accept_refined(search, refined):
            return


def _names(terms: Sequence[Hypothesis]) -> set[tuple]:
    return {(h.key, h.label) for h in terms}


def with_estimated_options(
    search, pool: Sequence[Hypothesis], conditions: tuple[int, ...]
) -> list[Hypothesis]:
    """Terms for a search, with one more variant of each clearly present effect: that with the most probable option.

    Conditional on the accepted terms numbered `conditions`. Without this variant a search would prefer two neighbouring
    options of the grid to a wave between them, or add a smooth function to a warm-up with an option of the grid.
    """
    seen, refinements = set(), []
    projected = Projected(search.problem.conditional_on(conditions))
    total = float(projected.y @ projected.y)
    for h in pool:
        if (
            h.smooth_covariates
            or h.key in seen
            or not h.gain > _CLEAR * (total - h.gain) / projected.degrees
        ):
            continue
        seen.add(h.key)
        for law in (h, *_other_laws(projected, h)):
            family = RealFamily.of(search.problem, law)
            refined = law if family is None else _refined(_Profile(family, projected), law)
            refinements += [refined] if refined is not law else []
    return [*pool, *refinements]


def _other_laws(projected: Projected, h: Hypothesis) -> list[Hypothesis]:
    """Of each further law of an effect at its place, whose labels have another `word`, the likeliest variant.

    Variants of a few values each do not decide between two laws with an option: the values of one are nearer by chance.
    """
    laws: dict[str, list[Candidate]] = {}
    for candidate in projected.problem.candidates if isinstance(h.source, Candidate) else ():
        is_other = candidate.option and candidate.word != h.source.word
        if is_other and (candidate.effect, candidate.where) == h.key:
            laws.setdefault(candidate.word, []).append(candidate)

    def gain(candidate: Candidate) -> float:
        signature = candidate.columns_at(projected.problem)
        columns = projected.problem.orthogonalise(signature)
        coefficients = least_squares(columns, projected.y, ROUNDING)
        return float(projected.y @ columns @ coefficients)

    best = [max(variants, key=gain) for variants in laws.values()]
    return [replace(h, label=c.label, effects=c.effects, source=c) for c in best]


def accept_refined(search, refined: list[Hypothesis]) -> bool:
    """Accept other values of options, and whether there are any.

    Two neighbours of a grid may be one wave between them: once their options agree they are one term.
    """
    if all(term is accepted for term, accepted in zip(refined, search.accepted)):
        return False
    distinct = {}
    for term in refined:
        distinct.setdefault((term.key, term.label), term)
    search.accepted = tuple(distinct.values())
    search.solve_feasible()
    return True


def option_of(search, i: int) -> RealOption | None:
    """The option of an accepted hypothesis with its standard deviation; None where it is no real number."""
    likelihood = _Profile.of(search, i, search.other_indices(i))
    if likelihood is None:
        return None
    family = likelihood.family
    unit = family.hypothesis.effects[0].option_unit(search.bench.chain, family.name)
    return RealOption(
        family.name, family.value, likelihood.std(family.value), unit, family.hypothesis.source.word
    )


def _refined(likelihood: "_Profile | None", hypothesis: Hypothesis) -> Hypothesis:
    """An accepted hypothesis, with another value of its option where that is likelier."""
    if likelihood is None:
        return hypothesis
    family = likelihood.family
    lower, upper = family.bracket
    resolution = _RESOLUTION * (upper - lower)
    value = likelihood.maximum(lower, upper, resolution)
    std = likelihood.std(value)
    if not std < upper - lower:  # the grid is as fine as the data are
        return hypothesis
    integer = float(np.round(value))
    if abs(value - integer) < SIGNIFICANT_SIGMAS * std and integer in family.grid:
        value = integer
    value = round(value, 1 - int(np.floor(np.log10(max(std, resolution)))))
    if abs(value - family.value) < _CLOSE * std:
        return hypothesis
    return family.at(value)


class _Profile:
    """Profile likelihood of one option, conditional on accepted hypotheses."""

    def __init__(self, family: RealFamily, projected: Projected):
        self.family, self.projected = family, projected

    @classmethod
    def of(cls, search, i: int, others: tuple[int, ...]) -> "_Profile | None":
        """Conditional on some others; None where the option is no real number."""
        family = RealFamily.of(search.problem, search.accepted[i])
        if family is None:
            return None
        return cls(family, Projected(search.problem.conditional_on(others)))

    def maximum(self, lower: float, upper: float, resolution: float) -> float:
        """The value between two others at which the sum of squares falls most, to a resolution.

        Columns are orthogonalised at Chebyshev's nodes alone, all at once, and interpolated between these.
        """
        nodes = chebpts1(_NODES)
        blocks = [self.family.columns(lower + (upper - lower) * (t + 1) / 2) for t in nodes]
        block_columns = np.concatenate(blocks, 1)
        columns = self.projected.problem.orthogonalise(block_columns)
        gram, score = columns.T @ columns, columns.T @ self.projected.y
        of_nodes = np.linalg.inv(chebvander(nodes, _NODES - 1))
        width = blocks[0].shape[1]
        unit = np.eye(width)

        def minus_gain(value: float) -> float:
            position = 2 * (value - lower) / (upper - lower) - 1
            polynomials = chebvander(position, _NODES - 1)
            mixing = np.kron((polynomials @ of_nodes).T, unit)
            projected = mixing.T @ score
            inverse_gram = pseudo_inverse(mixing.T @ gram @ mixing, ROUNDING)
            return -float(projected @ inverse_gram @ projected)

        options = {"xatol": resolution}
        best = minimize_scalar(minus_gain, bounds=(lower, upper), method="bounded", options=options)
        return float(best.x)

    def std(self, value: float) -> float:
        """Standard deviation of the option at a value: as of a further parameter of the linearised model."""
        columns, coefficients = self._solved(value)
        finest = float(np.diff(self.family.grid).min())
        step = _STEP * finest
        either = [self.family.columns(value + h) @ coefficients for h in (step, -step)]
        difference = (either[0] - either[1]) / (2 * step)
        slope = self.projected.problem.orthogonalise(difference)
        explained = columns @ least_squares(columns, slope, ROUNDING)
        slope = slope - explained
        residual = self.projected.y - columns @ coefficients
        degrees = max(self.projected.problem.degrees, 1)
        variance = float(residual @ residual) / degrees
        squares = float(slope @ slope) / self.projected.design_effect
        return float(np.sqrt(variance / max(squares, 1e-300)))

    def _solved(self, value: float) -> tuple[np.ndarray, np.ndarray]:
        """Columns (N, P) at a value, the baseline projected out, and their coefficients (P,)."""
        columns = self.projected.problem.orthogonalise(self.family.columns(value))
        coefficients = least_squares(columns, self.projected.y, ROUNDING)
        return columns, coefficients
