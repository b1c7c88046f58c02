"""A load that acts all the time, searched together with the compliances that it deflects.

Without a compliance such a load moves nothing. Conditional on compliances that were estimated without it, it explains
little: they have absorbed its effect, with masses that differ from the data sheet. The deflection is bilinear in
compliances and load. So for a given load the most probable set of laws is searched, and for a given set the load is
estimated, in turn (variable projection: Golub & Pereyra, Inverse Problems 19 (2003) R1). The result is solved, and kept
where it is clearly more probable than what is accepted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from robot_model.effects.load import Payload
from workbench.core.distributions import chi2
from workbench.core.effect import Effect
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.diagnosis.levels import (
    CONFOUNDED_SHARE,
    LEAST_LOG_ODDS,
    MAX_ROUNDS,
    NEGLIGIBLE_SHARE,
    ROUNDING,
    UNDETERMINED_STD,
    UNMODELLED_LEVEL,
)
from workbench.diagnosis.linear.candidates import Candidate
from workbench.diagnosis.linear.evidence import Projected, log_null
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.linear.problem import Alternative, Problem
from workbench.diagnosis.robot.mass_responses import LABEL
from workbench.diagnosis.search.compatible import compatible
from workbench.diagnosis.search.load_range import mass_range
from workbench.diagnosis.search.most_probable_set import as_solved, order_by_gain
from workbench.diagnosis.search.objective import Accepted, LogPosterior, Members, columns_of_terms
from workbench.diagnosis.search.prior import DEFLECTS
from workbench.diagnosis.search.state import Search, name_of
from workbench.diagnosis.search.stepwise import Stepwise

UNSTATED_LOAD = (
    "a smaller compliance that carries a load not recorded deflects alike in these poses; weigh the load, or measure "
    "some poses again with a known additional load"
)


def accept_constant_loads(search: Search) -> None:
    """Accept each constant load that, with compliances of its own, is clearly more probable than what is accepted.

    Not next to a random effect, by which two solutions are whitened differently, nor where the baseline holds
    compliances: a load is then found among the other effects that act through them.
    """
    if search.random_effect is not None or any(e.carries_load for e in search.bench.baseline):
        return
    for load in search.bench.constant_loads:
        name = (load.effect.effect, load.effect.where)
        accepted_loads = {h.key for h in search.accepted if h.needs_compliance}
        if not search.accepted or name in accepted_loads:
            continue
        laws = _LoadedLaws.of(search, load.effect)
        likeliest = laws.most_probable_set() if laws is not None else None
        if likeliest is None:
            continue
        trial = _solved_with(search, likeliest, load)
        if trial is not None and _gain(search, trial) > LEAST_LOG_ODDS:
            _take_over(search, trial)


def prefer_stated_masses(search: Search) -> None:
    """Exchange each law whose masses are estimated for that with the stated ones, where this is clearly more probable.

    What was accepted after it, a load above all, may explain what the masses were estimated for. Not next to a random
    effect, as above.
    """
    for i in search.accepted_indices if search.random_effect is None else ():
        accepted = search.accepted[i]
        if not accepted.label.startswith(LABEL):
            continue
        table = search.full_table(search.other_indices(i))
        stated = next((h for h in table if h.key == accepted.key and _deflects(h)), None)
        if stated is None:
            continue
        terms = (*search.accepted[:i], stated, *search.accepted[i + 1 :])
        trial = Search(search.bench, search.samples, search.level, lambda line: None, terms)
        trial.noise_factors, trial.infeasible = search.noise_factors, search.infeasible
        trial.solve_feasible()
        if len(trial.accepted) == len(terms) and _gain(search, trial) > LEAST_LOG_ODDS:
            _take_over(search, trial)


def unstated_load(search: Search, i: int) -> Alternative | None:
    """A constant load of the tool through which an accepted compliance makes what it makes without it; None where not.

    A smaller compliance that carries such a load then measures the same as a larger one without it. The two do not
    exclude one another: the probability is that of a load in addition to all that is accepted.
    """
    accepted = search.accepted[i]
    loads = [o.effect for o in search.bench.constant_loads if o.effect.effect == Payload.effect]
    has_load = any(h.effect == Payload.effect for h in search.accepted)
    if not loads or has_load or not any(effect.mass_dependent for effect in accepted.effects):
        return None
    problem = search.problem.conditional_on(search.other_indices(i))
    compliance = search.problem.values[i]
    by_load = problem.columns_of(accepted.effects[0], loads[0]) @ compliance  # (C, N)
    basis = problem.orthogonal_basis(by_load.T)
    signature = problem.orthogonalise(search.problem.added[i] @ compliance)
    shared = ((basis.T @ signature) ** 2).sum()
    likeness = float(shared / max(signature @ signature, 1e-300))
    if likeness < CONFOUNDED_SHARE:
        return None
    table = search.table(search.accepted_indices)
    constant = (h for h in table if h.effect == Payload.effect and h.effects[0].after is None)
    log_odds = max((h.log_weight for h in constant), default=-np.inf)
    place = loads[0].effect, loads[0].where, "constant"
    y = problem.orthogonalise(problem.residual)
    masses = mass_range(signature, problem.orthogonalise(by_load.T).T, y, search.variance())
    detail = masses.words
    return Alternative(*place, float(expit(log_odds)), likeness, UNSTATED_LOAD, detail=detail)


def _take_over(search: Search, trial: Search) -> None:
    """Accept what a trial has accepted."""
    search.accepted, search.infeasible = trial.accepted, trial.infeasible
    search.record_terms(search.accepted)
    search.solve()
    order_by_gain(search)


def _solved_with(search: Search, laws: Sequence[Hypothesis], load) -> Search | None:
    """A search that has accepted the laws and the load, next to other accepted loads; None where its mass is negative.

    Next to the compliances that were accepted before, the mass may have been impossible.
    """
    # an accepted function without a law is solved with its effect, which its row in a table does not have
    accepted = {name_of(h): h for h in search.accepted}
    terms = tuple(accepted.get(name_of(h), h) for h in laws)
    name = (load.effect.effect, load.effect.where, load.label)
    trial = Search(search.bench, search.samples, search.level, lambda line: None, terms)
    trial.noise_factors, trial.infeasible = search.noise_factors, search.infeasible - {name}
    trial.solve()
    table = trial.full_table(trial.accepted_indices)
    judged_loads = [h for h in table if name_of(h) == name]
    if not judged_loads:
        return None
    loads = [h for h in search.accepted if h.needs_compliance and compatible(h, judged_loads[0])]
    trial.accepted = (*trial.accepted, *loads, judged_loads[0])
    trial.solve_feasible()
    if any(name_of(h) == name for h in trial.accepted):
        return trial
    return None


def _gain(search: Search, trial: Search) -> float:
    """By how much the log posterior of what the trial has accepted exceeds that of the search.

    Repeats of a pose count for as many independent numbers as the remainder says; the same for both solutions, once by
    the remainder of each, of which the smaller gain counts.
    """
    remainders = [solution.problem.conditional_on() for solution in (search, trial)]
    gains = [
        _log_posterior(trial, solution) - _log_posterior(search, solution)
        for solution in remainders
    ]
    return min(gains)


def _log_posterior(search: Search, remainder: Problem) -> float:
    """Log posterior of what is accepted, which is comparable with that about another solution.

    Each solution widens the sigmas, and weights the samples, by what it leaves, so that both belong to the density.
    """
    problem = search.problem.conditional_on(())
    terms = [h.at(problem) for h in search.accepted]
    if None in terms:  # a load without a compliance
        return -np.inf
    solved = as_solved(search, terms)
    objective = LogPosterior.of(problem, terms, remainder, solved)
    every_term = tuple(range(len(terms)))
    value = objective.value(every_term) + log_null(objective)
    log_unit = float(np.log(problem.units).mean())
    return value - objective.degrees * log_unit


@dataclass(frozen=True)
class _LoadedLaws:
    """Terms in a problem that keeps none of them, and what a load of C parameters makes of their columns.

    `columns` (N, T) of all terms and `changes` (C, N, T) by each parameter of the load, in typical sizes, the baseline
    projected out; `start` (K + 1,) of each term; `y` (N,) the residual without any of them;
    `remainder`: the problem with those accepted; `variance` of a whitened coordinate; `first`: sets to start from;
    `accepted`: how many terms come first that are accepted and not elastic.
    """

    problem: Problem
    terms: tuple[Hypothesis, ...]
    columns: np.ndarray
    changes: np.ndarray
    start: np.ndarray
    y: np.ndarray
    remainder: Problem
    variance: float
    first: tuple[Members, ...]
    accepted: int

    @classmethod
    def of(cls, search: Search, load: Effect) -> "_LoadedLaws | None":
        """Of what is accepted and all elastic laws, at the present solution; None where nothing deflects."""
        problem = search.problem.conditional_on(())
        table = [h for h in search.full_table(()) if _deflects(h)]
        others = [h for h in search.current_terms() if not _is_elastic(h)]
        lawful = (h for h in others if not h.needs_compliance)
        terms = (*lawful, *table)
        if not table:
            return None
        blocks = [h.columns(problem) for h in terms]
        widths = [part.shape[1] for part in blocks]
        start = np.concatenate([[0], np.cumsum(widths)]).astype(int)
        sizes = np.array([p.typical for p in load.table(search.bench.chain)])
        changes = [_change(problem, h, load, sizes, part.shape) for h, part in zip(terms, blocks)]
        changes_of_all = np.concatenate(changes, 2)
        first_terms = tuple(range(len(terms) - len(table)))
        numbers = range(len(first_terms), len(terms))
        found = {h.key for h in search.accepted}
        joints = tuple(k for k in numbers if terms[k].where.startswith("joint-"))
        present = tuple(k for k in numbers if terms[k].key in found)
        columns = np.concatenate(blocks, 1)
        return cls(
            problem,
            terms,
            problem.orthogonalise(columns),
            np.stack([problem.orthogonalise(change) for change in changes_of_all]),
            start,
            Projected(problem).y,
            search.problem.conditional_on(),
            search.variance(),
            (first_terms + joints, first_terms + present),
            len(first_terms),
        )

    def most_probable_set(self) -> list[Hypothesis] | None:
        """The most probable terms conditional on a load; None where the load hardly raises their probability."""
        starts = [members for members in dict.fromkeys(self.first) if self._needs_load(members)]
        if not starts:
            return None
        unloaded = self._objective(np.zeros(len(self.changes)))
        unloaded_value = max(
            unloaded.value(Stepwise(unloaded).most_probable_set(members)) for members in starts
        )
        value, members = max(map(self._climb, starts), key=lambda reached: reached[0])
        if value <= unloaded_value + LEAST_LOG_ODDS:
            return None
        return [self.terms[i] for i in members]

    def _needs_load(self, members: Members) -> bool:
        """Whether a load is significant next to a set of laws, by the likelihood ratio."""
        none = np.zeros(len(self.changes))
        estimated = self._load(members, none)
        squares = [self._left(members, load) for load in (none, estimated)]
        degrees = Projected(self.problem, self.remainder).degrees
        free = degrees - len(self._index(members))
        fall = squares[0] / max(squares[1], 1e-300)
        ratio = max(free, 1.0) * np.log(fall)
        p = float(chi2.sf(ratio, len(none)))
        return p < UNMODELLED_LEVEL

    def _left(self, members: Members, load: np.ndarray) -> float:
        """Sum of squares that a set of laws leaves under a load."""
        columns = self._columns_under_load(load)[:, self._index(members)]
        y = self.y
        fitted = columns @ least_squares(columns, y, ROUNDING)
        return float(((y - fitted) ** 2).sum())

    def _columns_under_load(self, load: np.ndarray) -> np.ndarray:
        """(N, T) columns of all terms under a load."""
        return self.columns + np.tensordot(load, self.changes, 1)

    def _index(self, members: Members) -> np.ndarray:
        """Columns of a set."""
        return columns_of_terms(self.start, members)

    def _climb(self, members: Members) -> tuple[float, Members]:
        """The log posterior and members of the set that laws and load in turn lead to from a given one."""
        load = np.zeros(len(self.changes))
        best = (-np.inf, members)
        for _ in range(MAX_ROUNDS):
            load = self._load(members, load)
            objective = self._objective(load)
            members = tuple(sorted(Stepwise(objective).most_probable_set(members)))
            reached = objective.value(members)
            if reached <= best[0] + LEAST_LOG_ODDS:
                break
            best = (reached, members)
        return best

    def _load(self, members: Members, load: np.ndarray) -> np.ndarray:
        """(C,) the load that a set of laws has under its most probable coefficients, from a given one."""
        index = self._index(members)
        columns = self.columns[:, index]
        changes = self.changes[:, :, index]
        y = self.y
        prior = np.sqrt(self.variance) / UNDETERMINED_STD
        count = len(load)
        for _ in range(MAX_ROUNDS):
            present = columns + np.tensordot(load, changes, 1)
            coefficients = least_squares(present, y, ROUNDING)
            by_load = np.einsum("cnt,t->nc", changes, coefficients)
            jacobian = np.hstack([present, by_load])
            priors = np.hstack([np.zeros((count, len(index))), prior * np.eye(count)])
            right = np.concatenate([y, -prior * load])
            step = least_squares(np.vstack([jacobian, priors]), right, ROUNDING)[len(index) :]
            load = load + step
            if np.abs(step).max(initial=0.0) < NEGLIGIBLE_SHARE:
                break
        return load

    def _objective(self, load: np.ndarray) -> LogPosterior:
        """The objective of all sets of terms under a load."""
        columns = self._columns_under_load(load)
        terms = []
        for h, first, end in zip(self.terms, self.start, self.start[1:]):
            if _deflects(h):
                loaded = columns[:, first:end] / h.source.typical
                h = replace(h, source=replace(h.source, columns=loaded))
            terms.append(h)
        accepted = Accepted(self.accepted)
        return LogPosterior.of(self.problem, terms, self.remainder, accepted)


def _change(problem: Problem, h: Hypothesis, load: Effect, sizes: np.ndarray, shape) -> np.ndarray:
    """(C, N, P) change of a term's columns by each parameter of a load, in typical sizes."""
    if not _deflects(h):
        return np.zeros((len(sizes), *shape))
    columns = problem.columns_of(h.effects[0], load)
    typical_columns = columns * h.source.typical
    return typical_columns * sizes[:, None, None]


def _is_elastic(h: Hypothesis) -> bool:
    return not h.smooth_covariates and h.effect in DEFLECTS


def _deflects(h: Hypothesis) -> bool:
    """Whether a term is a law of the catalogue by which something deflects under gravity, its masses as stated."""
    return isinstance(h.source, Candidate) and any(effect.mass_dependent for effect in h.effects)
