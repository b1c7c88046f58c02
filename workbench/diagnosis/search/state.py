"""State of a search: the accepted hypotheses, the problem solved with them, the others ranked conditional on them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from workbench.diagnosis.levels import CRITICAL_T
from workbench.diagnosis.linear.evidence import Projected
from workbench.diagnosis.linear.hypotheses import Hypothesis, family_wise, ranked_hypotheses
from workbench.diagnosis.linear.problem import Bench, Problem
from workbench.diagnosis.noise.data_findings import with_equal_noise
from workbench.diagnosis.noise.random_effects import RandomEffect, whitened_by
from workbench.diagnosis.robot.derived import negative_masses
from workbench.diagnosis.robot.shared_moments import with_shared_moments
from workbench.diagnosis.search.common_orders import required_harmonics, with_common_orders
from workbench.diagnosis.search.compatible import compatible
from workbench.diagnosis.search.instants import with_numbered_steps
from workbench.diagnosis.search.options import with_exact_options
from workbench.diagnosis.search.prior import is_elastic, may_be_elastic

ALL, LAWS, ELASTIC = "all", "laws", "elastic laws"
"""Parts of a table."""
_SELECTIONS = {ALL: lambda h: True, LAWS: lambda h: not h.smooth_covariates, ELASTIC: is_elastic}


@dataclass
class Search:
    """`accepted` hypotheses and the `problem` solved with them, on `samples` (n,) bool (None: all).

    `level`: probability of a false alarm of the whole search. The noise model: `noise_factors` (n,) of the stated sigma
    of each sample, and the `random_effect` of a place; `stated_noise_problem` is the problem without it. `tables`:
    hypotheses ranked conditional on some of the accepted ones, by their numbers. `history`: a line for each step.
    `infeasible`: names of hypotheses with fitted values that no machine has. `screened`: hypotheses that are probable
    without any other term, ranked once for the noise model and compliances in `screening_conditions`.
    `always_listed`: hypotheses in every table, however improbable. `first`: called with the first terms.
    `for_prediction`: whether only predictions matter, as in a fold, and not the names of the terms. `solved_for`: what
    `problem` and `tables` were made for.
    """

    bench: Bench
    samples: np.ndarray | None
    level: float
    progress: Callable[[str], None]
    accepted: tuple[Hypothesis, ...] = ()
    history: list[str] = field(default_factory=list)
    problem: Problem | None = None
    stated_noise_problem: Problem | None = None
    tables: dict = field(default_factory=dict)
    random_effect: RandomEffect | None = None
    noise_factors: np.ndarray | None = None
    infeasible: set[tuple] = field(default_factory=set)
    screened: list[Hypothesis] = field(default_factory=list)
    screening_conditions: tuple = (None, None, False)
    always_listed: tuple[Hypothesis, ...] = ()
    first: Callable[[Sequence[Hypothesis]], None] | None = None
    for_prediction: bool = False
    solved_for: tuple = ()

    def record_terms(self, terms: Sequence[Hypothesis]) -> None:
        """A line with what is accepted now."""
        if self.first is not None:
            self.first(terms)
            self.first = None
        line = "; ".join(f"{h.effect} at {h.where} {h.label}".strip() for h in terms)
        self.log_step(line)

    def log_step(self, line: str):
        """Add a line to the history and report it as progress."""
        self.history.append(line)
        self.progress(line)

    def solve(self):
        """Solve the bench with the accepted hypotheses and discard the tables of the previous solution."""
        self.accepted = with_numbered_steps(self.accepted)
        effects = [e for h in self.accepted for e in h.effects]
        if not self._is_solved_with(effects):
            self.stated_noise_problem = self.bench.problem(effects, self.samples)
        # a compliance brings all that acts through it into the library
        conditions = (
            self.noise_factors,
            self.random_effect,
            any(h.carries_load for h in self.accepted),
        )
        if not all(now is before for now, before in zip(conditions, self.screening_conditions)):
            self.screening_conditions, self.screened = conditions, []
        if self._is_known():
            return
        problem = self.stated_noise_problem
        if self.noise_factors is not None:
            problem = with_equal_noise(problem, self.noise_factors)
        if self.random_effect is None:
            self.problem = problem
        else:
            self.problem = whitened_by(problem, self.random_effect)
        hypotheses = (*self.accepted, *self.always_listed)
        self.problem = with_exact_options(self.problem, hypotheses)
        if self.bench.chain is not None:
            self.problem = with_shared_moments(self.problem, self.bench.chain)
        self.tables = {}
        self.solved_for = self._solution()

    def _solution(self) -> tuple:
        """All that the present problem and its tables depend on; its parts are compared by identity."""
        terms = (*self.accepted, *self.always_listed)
        return self.stated_noise_problem, self.noise_factors, self.random_effect, *terms

    def _is_known(self) -> bool:
        """Whether problem and tables are those of the accepted hypotheses and of the noise model already."""
        now, before = self._solution(), self.solved_for
        return len(now) == len(before) and all(a is b for a, b in zip(now, before))

    def solve_feasible(self):
        """Solve, and exclude hypotheses with physically impossible values from the search.

        A constant load of negative mass is an error of the masses or laws of the compliances, not a load. A negative
        compliance is the effect of something else: a spring, or an error of the masses.
        """
        self.solve()
        while negative := self._negative_compliances() or self._negative_loads():
            self.infeasible |= {name_of(h) for h in negative}
            self.accepted = tuple(h for h in self.accepted if name_of(h) not in self.infeasible)
            line = "; ".join(f"{h.effect} at {h.where}: it is negative" for h in negative)
            self.log_step(line)
            self.solve()

    def _negative_loads(self) -> list[Hypothesis]:
        effects = [e for h in self.accepted for e in h.effects]
        loads = negative_masses(self.bench, effects, self.samples)
        return [h for h in self.accepted if any(e is load for e in h.effects for load in loads)]

    def _negative_compliances(self) -> list[Hypothesis]:
        """The law with the most significantly negative compliance, where another one is as significantly positive.

        Where all are negative, gravity points elsewhere than the robot file states. None of laws with several numbers.
        """
        laws = [i for i in self.accepted_indices if self.accepted[i].carries_load]
        ratios = {i: self._value_over_std(i) for i in laws if self.problem.added[i].shape[1] == 1}
        if len(laws) < 2 or not ratios:
            return []
        lowest = min(ratios, key=ratios.get)
        others = [self.problem.values[i][0] > 0 for i in laws if i != lowest]
        if ratios[lowest] < -CRITICAL_T and any(others):
            return [self.accepted[lowest]]
        return []

    def _value_over_std(self, i: int) -> float:
        """The parameter of an accepted hypothesis over its standard deviation, conditional on the others."""
        bare = self.problem.conditional_on(self.other_indices(i))
        columns = self.problem.added[i][:, 0]
        length = np.linalg.norm(bare.orthogonalise(columns))
        return float(self.problem.values[i][0] * length / np.sqrt(self.variance()))

    def converged(self) -> Problem:
        """The problem linearised at a converged solution, which judging single samples needs; the search does not."""
        effects = self.stated_noise_problem.effects
        self.bench.solve(effects, self.samples)
        return self.bench.problem(effects, self.samples, hypotheses=False)

    def _is_solved_with(self, effects) -> bool:
        """Whether `stated_noise_problem` is the problem solved with these very effects."""
        if self.stated_noise_problem is None or len(effects) != len(
            self.stated_noise_problem.effects
        ):
            return False
        return all(
            effect is solved for effect, solved in zip(effects, self.stated_noise_problem.effects)
        )

    def reorder(self, order: list[int]) -> None:
        """The accepted hypotheses in another order; the solution and the tables stay what they are."""
        if order == list(self.accepted_indices):
            return
        self.accepted = tuple(self.accepted[i] for i in order)
        self.problem, self.stated_noise_problem = (
            self.problem.reordered(order),
            self.stated_noise_problem.reordered(order),
        )
        new = {old: place for place, old in enumerate(order)}
        self.tables = {
            (tuple(sorted(new[i] for i in conditions)), part): table
            for (conditions, part), table in self.tables.items()
        }
        self.solved_for = self._solution()

    def table(self, kept: tuple[int, ...], part: str = ALL) -> list[Hypothesis]:
        """Hypotheses that are compatible with the accepted ones numbered `kept`, ranked conditional on these.

        Without hypotheses that act through an accepted compliance that is not kept: they would replace it. part: `ALL`,
        `LAWS`, or the `ELASTIC` ones of these, which take less time.
        """
        carriers = {i for i in self.accepted_indices if self.accepted[i].carries_load}
        table = self.full_table(kept, part)
        if carriers <= set(kept):
            return table
        return [h for h in table if not h.needs_compliance]

    def full_table(self, kept: tuple[int, ...], part: str = ALL) -> list[Hypothesis]:
        """As `table`, including all hypotheses that act through compliances."""
        known = next((self.tables[kept, p] for p in (part, ALL) if (kept, p) in self.tables), None)
        if known is None:
            known = self.tables[kept, part] = self._ranked(kept, part)
        return [h for h in known if _SELECTIONS[part](h)]

    def _ranked(self, kept: tuple[int, ...], part: str) -> list[Hypothesis]:
        required = [(h.family, h.label) for h in (*self.accepted, *self.always_listed)]
        conditions = [self.accepted[i] for i in kept]
        required += required_harmonics(self.problem, conditions)
        ranked = ranked_hypotheses(
            self.problem.conditional_on(kept),
            required,
            part == ALL,
            may_be_elastic if part == ELASTIC else None,
        )
        return [
            h
            for h in with_common_orders(ranked, conditions)
            if name_of(h) not in self.infeasible
            and (h.smooth_covariates or all(compatible(h, other) for other in conditions))
        ]

    @property
    def accepted_indices(self) -> tuple[int, ...]:
        """Numbers of all accepted."""
        return tuple(range(len(self.accepted)))

    def other_indices(self, i: int) -> tuple[int, ...]:
        """Numbers of all accepted but one."""
        return tuple(j for j in self.accepted_indices if j != i)

    def current_terms(self) -> list[Hypothesis]:
        """The accepted hypotheses with their columns at the present solution, as rows of a table have them."""
        return [h.at(self.problem) or h for h in self.accepted]

    def conditional_hypothesis(self, i: int, table: list[Hypothesis] | None = None) -> Hypothesis:
        """An accepted hypothesis as a table judges it; by default the one conditional on the others."""
        table = table or self.table(self.other_indices(i))
        name = name_of(self.accepted[i])
        return next((h for h in table if name_of(h) == name), table[0])

    def alternatives(self, i: int, part: str = ALL) -> list[Hypothesis]:
        """Hypotheses that may replace an accepted one, itself included, all compared at the same solution.

        part: as of `table`.

        An effect that acts through compliances is multiplied by them. In the solution with it, the compliances have
        values that require it, and every other hypothesis seems to gain its contribution. The hypotheses are therefore
        compared at the solution without it.
        """
        accepted = self.accepted[i]
        if not accepted.needs_compliance:
            return self.table(self.other_indices(i), part)
        others = tuple(self.accepted[j] for j in self.other_indices(i))
        reduced = Search(self.bench, self.samples, self.level, lambda line: None, others)
        reduced.random_effect, reduced.noise_factors = self.random_effect, self.noise_factors
        reduced.infeasible, reduced.always_listed = self.infeasible, (accepted,)
        reduced.solve()
        return reduced.table(reduced.accepted_indices, part)

    def conditional_gain(self, i: int) -> tuple[float, float]:
        """Gain of an accepted hypothesis conditional on the others, and the p-value of its F test by itself."""
        return _conditional_scores(self.problem, i, self.other_indices(i))

    def size(self, i: int) -> float:
        """RMS over all coordinates of an accepted hypothesis's part, conditional on the others, in stated sigmas."""
        return float(
            np.sqrt(
                _conditional_scores(self.stated_noise_problem, i, self.other_indices(i))[0]
                / len(self.stated_noise_problem.sample)
            )
        )

    def unexplained_gain(self) -> float:
        """Gain of the best smooth function of the remainder; 0 where it is not significant."""
        table = self.table(self.accepted_indices)
        if family_wise(table) > self.level:
            return 0.0
        return max(
            (h.gain for h in table if h.smooth_covariates and h.p / h.weight <= self.level),
            default=0.0,
        )

    def explained(self) -> float:
        """Reduction of the whitened sum of squares by all accepted hypotheses together."""
        full = self.problem.conditional_on()
        bare = self.problem.conditional_on(())
        return float(
            (bare.orthogonalise(bare.residual) ** 2).sum()
            - (full.orthogonalise(full.residual) ** 2).sum()
        )

    def variance(self) -> float:
        """Residual variance of a whitened coordinate; 1 where the stated noise is right."""
        full = self.problem.conditional_on()
        return float((full.orthogonalise(full.residual) ** 2).sum()) / max(full.degrees, 1)


def _conditional_scores(problem: Problem, i: int, others: tuple[int, ...]) -> tuple[float, float]:
    columns = problem.added[i]
    projected = Projected(problem.conditional_on(others))
    columns = columns / np.maximum(np.sqrt((columns**2).sum(0)), 1e-300)
    scores = projected.score_hypotheses(projected.column_moments(columns[None]))
    return float(scores.gain[0]), float(scores.p[0])


def name_of(h: Hypothesis) -> tuple:
    """Unique key of a hypothesis."""
    return (*h.key, h.label)
