"""Permutation and circular-shift controls: a permuted cause explains nothing, and noise makes no such change in time.

Permutation: the derivative of the measurement stays as it is; only what the effect reads of its samples (angles,
torques, sides of approach, temperatures) is given to other poses. A gain that remains was not due to the
cause. A permuted cause with many coefficients makes a part of any effect, the fitted one included. Its gain is
therefore that in the residual of the full model (ter Braak, in: Jöckel et al., Bootstrapping and Related Techniques
(1992) 79; Anderson & Legendre, J. Stat. Comput. Simul. 62 (1999) 271).

Circular shift, for what reads the clock. Its instant (or time constant) was selected, and a step shifted by a part of
the recording overlaps with itself. What is shifted is therefore the residual that remains next to it against the time,
which keeps its autocorrelation, and its largest gain over all instants is compared with that of the effect: the null
distribution of a maximum (Davies, Biometrika 74 (1987) 33; Westfall & Young, Resampling-Based Multiple Testing (1993)).
Twice: with the clock shifted each pose keeps its residual, what changes slowly at a joint included; with the residuals
shifted, what changes slowly in space.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from workbench.core.covariates import clock
from workbench.core.effect import Effect
from workbench.core.least_squares.linear_algebra import solve_positive, symmetric_eigen
from workbench.core.model import NOISE, STATE_PORTS
from workbench.diagnosis.levels import MAJORITY, NEGLIGIBLE_SHARE, ROUNDING
from workbench.diagnosis.linear.problem import Bench
from workbench.diagnosis.validation.folds import tested_samples
from workbench.diagnosis.validation.held_out import name_of
from workbench.diagnosis.validation.left_out_blocks import fitted_residual
from workbench.diagnosis.validation.terms import Control

_LEVEL, _LEFT, _QUANTILE = 0.01, 0.2, 0.75
"""A control is passed up to this p-value, where less than this share of the gain is left in this share of shifts."""
_TRIALS, _SHIFTS = round(2 / _LEVEL) - 1, 39
"""Permutations, which distinguish a p-value of this level from half of it, and circular shifts."""
_INSTANTS, _FEW_INSTANTS = 60, 12
"""Instants (or time constants) of an effect that are compared at most, evenly taken from all; fewer with each clock."""
PERMUTED, ROTATED = "permuted", "circular shift"
_CLOCKS = ("time_s", "time", "row", "order")


def controls(
    bench: Bench,
    others: Sequence[Effect],
    tested: Sequence[Effect],
    solved: Sequence[Effect] = (),
) -> tuple[Control, ...]:
    """The controls that can be made of the effects `tested` conditional on a model that holds `others`.

    solved: all of these effects, the same objects, in an order in which the bench has solved them already.
    A linearised gain: the fall of the whitened sum of squares when the effects' columns join, all effects with their
    priors as in the fit: without them others with many parameters would make most of any effect. Permuted: 199 times
    over poses. Passed where fewer than one in a hundred gains as much, and the median trial gains, beyond what as
    many columns gain by chance, less than a fifth. Not applicable where a permutation changes less than half of the
    effect, which then gains as much whether its cause is right or not. For what reads the clock, that is shifted
    circularly 39 times against what the effect leaves, and the reverse: passed where none gains as much at any
    instant, and three of four gain less than a fifth of it beyond chance.
    """
    if any(e.port in (*STATE_PORTS, NOISE) for e in tested):
        why = "it acts through other effects or on the noise alone"
        return (Control(PERMUTED, None, None, None, why=why),)
    trial = _Trial(bench, others, tested, solved)
    rng = np.random.default_rng(0)
    if trial.permuted_change(np.random.default_rng(0)) < MAJORITY:
        why = "its cause is nearly the same at every pose, so that permuted poses hardly change it"
        return (Control(PERMUTED, None, None, None, why=why), *_of_time(trial, rng))
    residual = trial.y - trial.fitted
    gains = np.array([trial.gain(trial.permuted(rng), residual) for _ in range(_TRIALS)])
    p = float((1 + (gains >= trial.own).sum()) / (1 + _TRIALS))
    share = trial.share_beyond_chance(float(np.median(gains)))
    passed = p <= _LEVEL and share < _LEFT
    permutation = [Control(PERMUTED, share, p, passed, _TRIALS)]
    return (*permutation, *_of_time(trial, rng))


def _of_time(trial: "_Trial", rng) -> tuple[Control, ...]:
    """Circular shifts of the time against what an effect leaves that reads it, at the best of all instants."""
    chain = trial.chain
    shifts = np.linspace(0.05, 0.95, _SHIFTS)
    if chain is None or not any(_changes_with_clock(e, chain) for e in trial.effects):
        return ()
    residual = trial.y - trial.fitted
    few_variants = trial.other_instants(_FEW_INSTANTS)
    many_variants = trial.other_instants(_INSTANTS)
    of_clock = [
        trial.best_gains(few_variants, _shifted_state(chain, part), residual) for part in shifts
    ]
    of_space = trial.best_gains(
        many_variants, chain.state, trial.shifted_residuals(residual, shifts)
    )
    chance = float(
        np.median(
            trial.best_gains(many_variants, chain.state, trial.permuted_residuals(residual, rng))
        )
    )
    excess = max(float(np.quantile(gains, _QUANTILE)) for gains in (of_clock, of_space)) - chance
    share = float(np.clip(excess / max(trial.own - chance, 1e-300), 0.0, 1.0))
    as_much = int(max((np.array(gains) >= trial.own).sum() for gains in (of_clock, of_space)))
    p = float((1 + as_much) / (1 + len(shifts)))
    return (Control(ROTATED, share, p, share < _LEFT and not as_much, len(shifts)),)


def of_order(bench: Bench, effects: Sequence[Effect]) -> bool:
    """Whether an effect reads the time or the order of the rows, so that it says nothing of times not measured."""
    if bench.chain is None or not effects:
        return any("time" in getattr(e, "names", ()) for e in effects)
    return any(_changes_with_clock(e, bench.chain) for e in effects)


def _changes_with_clock(effect: Effect, chain) -> bool:
    """Whether an effect does anything else where the clock is moved round by half of the recording."""
    moves = any(name.startswith("move") for name in getattr(effect, "names", ()))
    if moves or effect.by_moves or effect.port == NOISE:
        return False
    # a law that is not linear has no columns where all its parameters are 0
    typical = np.array([p.typical for p in effect.parameters(chain)])
    states = chain.state, _shifted_state(chain, 0.5)
    basis, shifted = (effect.derivative(typical, state) for state in states)
    return not np.allclose(basis, shifted, rtol=0, atol=NEGLIGIBLE_SHARE * np.abs(basis).max())


def _shifted_state(chain, part: float):
    """The state with its time circularly shifted by a part (0-1) of the recording."""
    covariates = dict(chain.state.covariates)
    order = np.argsort(clock(chain.state), kind="stable")
    for name in set(_CLOCKS) & set(covariates):
        turned = covariates[name].copy()
        turned[order] = np.roll(turned[order], int(round(part * len(order))))
        covariates[name] = turned
    return replace(chain.state, covariates=covariates)


class _Trial:
    """Whitened residual conditional on `others`, and what the effects' columns gain when they read other samples.

    `small` (P, k, n): change of the components by the effects; `rows` (k, m, n) whitened derivatives by them. A bench
    that knows no robot gives the columns themselves, (P, 1, N), whose coordinates are then exchanged. `count`:
    effective number of coefficients, those that the data and not their priors determine.
    """

    def __init__(self, bench, others, tested, solved: Sequence[Effect] = ()):
        part = tested_samples(bench)
        if part is None:
            self.chain = bench.chain
        else:
            self.chain = bench.chain.at(part)
        self.effects = tuple(tested)
        if self.chain is None:
            self.problem = bench.problem(others, samples=part, hypotheses=False).conditional_on()
            self.small, self.rows = _columns(bench, self.problem, others, tested), None
            self._precision = np.zeros(len(self.small))
        else:
            self._linearise(bench, tuple(solved) or (*others, *tested), part)
        self.y = fitted_residual(self.problem)
        basis = np.hstack(self.problem.fit_columns)
        self._basis = basis @ self.problem.hat_mixing
        self.noise = float(self.y @ self.y) / max(self.problem.degrees, 1)
        self.own = float(self.gain(self.small, self.y))
        columns = self.columns(self.small)
        gram = columns.T @ self._left(columns)
        posterior = gram + np.diag(self._precision)
        self.count = float(np.trace(solve_positive(posterior, gram)))
        self.coefficients = solve_positive(posterior, columns.T @ self.y)
        self.fitted = self._left(columns @ self.coefficients)

    def _linearise(self, bench, effects: tuple[Effect, ...], part) -> None:
        """The problem next to the other effects, to first order about the solution with all of them, `effects`.

        A nonlinear law is linearised about its values there.
        """
        numbers = [next(i for i, e in enumerate(effects) if e is tested) for tested in self.effects]
        full_problem = bench.problem(effects, samples=part, hypotheses=False)
        self.problem = full_problem.conditional_on(
            [i for i in range(len(effects)) if i not in numbers]
        )
        model, fit, _ = bench.solve(effects, part, is_complete=False)
        spans = model.spans[-len(effects) :]
        self._values = [fit.parameters.values[spans[i]] for i in numbers]
        self.small = self.basis(self.chain.state)
        self.rows = self._rows(model, fit)
        none = [np.zeros(len(values)) for values in self._values]
        if full_problem.precisions:
            known = [full_problem.precisions[i] for i in numbers]
        else:
            known = none
        self._precision = np.concatenate(known)

    def basis(self, state, effects: Sequence[Effect] = ()):
        """(P, K, n) the effects side by side, each on components of its own: one row a parameter, as the fit has them.

        effects: others of the same kinds at the same places; the own ones where not given.
        """
        bases = [e.derivative(p, state) for e, p in zip(effects or self.effects, self._values)]
        width = sum(b.shape[1] for b in bases)
        rows = []
        first = 0
        for b in bases:
            after = width - first - b.shape[1]
            rows.append(np.pad(b, ((0, 0), (first, after), (0, 0))))
            first += b.shape[1]
        return np.concatenate(rows)

    def other_instants(self, max_count: int) -> list[tuple[Effect, ...]]:
        """The effects, and up to `max_count` variants: another instant or time constant of one that reads the clock."""
        variants = [self.effects]
        for i, effect in enumerate(self.effects):
            if _changes_with_clock(effect, self.chain):
                before = self.effects[:i]
                after = self.effects[i + 1 :]
                others = _variants(effect, self.chain, max_count)
                variants += [(*before, other, *after) for other in others]
        return variants

    def shifted_residuals(self, residual: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        """(N, S) residuals (N,) circularly shifted in time by shares (S,) of the recording."""
        order = np.argsort(self.problem.order, kind="stable")
        residual = residual.reshape(-1, self.problem.n)
        out = np.empty((*residual.shape, len(shifts)))
        for i, part in enumerate(shifts):
            shift = round(part * self.problem.n)
            out[:, order, i] = np.roll(residual[:, order], shift, axis=1)
        flat = out.reshape(-1, len(shifts))
        return self._left(flat)

    def permuted_residuals(self, residual: np.ndarray, rng) -> np.ndarray:
        """(N, S) residuals (N,) exchanged between samples at random, `_SHIFTS` times."""
        residual = residual.reshape(-1, self.problem.n)
        permuted = [residual[:, rng.permutation(self.problem.n)].ravel() for _ in range(_SHIFTS)]
        columns = np.stack(permuted, axis=1)
        return self._left(columns)

    def best_gains(self, variants, state, y: np.ndarray) -> np.ndarray:
        """() or (S,) largest gain of any of some tuples of effects in a state, for y (N,) or (N, S)."""
        return np.max([self.gain(self.basis(state, e), y) for e in variants], axis=0)

    def _rows(self, model, fit) -> np.ndarray:
        """(k, m, n) whitened derivatives by the components of the effects at a solution."""
        evaluation = model.evaluate(fit.parameters)
        rows = np.concatenate(
            [evaluation.rows(e.port, np.asarray(e.port_indices(model.chain))) for e in self.effects]
        )
        root_weights = np.sqrt(self.problem.weights)[self.problem.sample]
        root = root_weights / self.problem.sigma
        by_pose = root.reshape(rows.shape[1], -1)
        return rows * np.tile(by_pose, self.problem.ends.count)

    def _left(self, columns: np.ndarray) -> np.ndarray:
        """(N,) or (N, P) what the baseline and the other effects, with their priors, do not fit of it."""
        return columns - self._basis @ (self._basis.T @ columns)

    def columns(self, small):
        """(N, P) whitened columns."""
        if self.rows is not None:
            moved = np.einsum("pkn,kmn->pmn", small, self.rows, optimize=True)
            flat = moved.reshape(len(moved), -1)
            small = self.problem.ends.joined(flat)
        return small.reshape(len(small), -1).T

    def gain(self, small, y: np.ndarray) -> np.ndarray:
        """Fall () or (S,) of the sums of squares of y (N,) or (N, S), of which the others are fitted, with the columns.

        With the priors of the others, whose hat matrix is B B', and the columns' own, of precisions L:
        y'X (X'(I - B B')X + L)^-1 X'y.
        """
        raw, projections, scores = self._moments(small, y)
        remaining = raw - projections.T @ projections
        gram = remaining + np.diag(self._precision)
        diagonal = np.maximum(np.diagonal(gram), 0.0)
        length = np.sqrt(diagonal)
        seen = length**2 > ROUNDING * np.diagonal(raw)
        unit = 1 / length[seen]
        matrix = gram[np.ix_(seen, seen)] * np.outer(unit, unit)
        values, vectors = symmetric_eigen(matrix)
        significant = values > ROUNDING
        score = (scores[seen].T * unit).T
        coordinates = vectors[:, significant].T @ score
        return ((coordinates**2).T / values[significant]).sum(-1)

    def _moments(self, small, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Inner products of the columns: (P, P), (R, P) with the basis of the others, and (P,) or (P, S) with y."""
        if self._sums is None:
            columns = self.columns(small)
            return columns.T @ columns, self._basis.T @ columns, columns.T @ y
        of_rows, of_basis = self._sums
        flat = small.reshape(len(small), -1)
        sums = np.einsum("pkn,kln->pln", small, of_rows)
        weighted = sums.reshape(flat.shape)
        scores = flat @ self._sums_with(y)
        return weighted @ flat.T, (flat @ of_basis).T, scores

    @cached_property
    def _sums(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Sums over the measured components of each sample: (K, K, n) of the rows, (K n, R) with the basis.

        None where an effect has no fewer components than were measured: its columns are then as quick.
        """
        if self.rows is None or self.problem.ends.count > 1 or len(self.rows) >= self.rows.shape[1]:
            return None
        by_rows = np.einsum("kmn,lmn->kln", self.rows, self.rows)
        return by_rows, self._sums_with(self._basis)

    def _sums_with(self, y: np.ndarray) -> np.ndarray:
        """(K n,) or (K n, S) sums over the measured components of each sample of the rows times y (N,) or (N, S)."""
        by_sample = y.reshape(*self.rows.shape[1:], -1).swapaxes(0, 1)
        by_component = self.rows.transpose(2, 0, 1)
        sums = (by_component @ by_sample).swapaxes(0, 1)
        return sums.reshape(-1, *y.shape[1:])

    def share_beyond_chance(self, gain: float) -> float:
        """A gain as a share of the effects' own, both beyond what as many columns gain by chance."""
        chance = self.count * self.noise
        return max(gain - chance, 0.0) / max(self.own - chance, 1e-300)

    def permuted_change(self, rng) -> float:
        """Median share of the fitted effect (of its sum of squares, 0 to about 2) that a permutation changes."""
        changes = []
        for _ in range(_SHIFTS):
            changes.append(self._squared_change(self.permuted(rng)))
        return float(np.median(changes)) / max(float(self.fitted @ self.fitted), 1e-300)

    def _squared_change(self, responses: np.ndarray) -> float:
        """Sum of squares by which other responses of the effects change the fitted effect."""
        difference = self.columns(responses - self.small)
        change = self._left(difference @ self.coefficients)
        return float(change @ change)

    def permuted(self, rng):
        """Responses of the effects with permuted poses."""
        if self.chain is None:
            return self.small[:, :, rng.permutation(self.small.shape[2])]
        rows = self.chain.columns_of(_permuted_rows(self.problem.pose, rng))
        return self.small[:, :, rows]


def _variants(effect: Effect, chain, max_count: int) -> list[Effect]:
    """The same law at the same place with other instants or time constants, `max_count` of them."""
    kind, where = type(effect), effect.where
    scans = [grid for grid in kind.grids(chain) if grid.where == where]
    found = [grid.make(value) for grid in scans for value in grid.values]
    found += [v.effect for v in kind.candidates(chain) if v.effect.where == where]
    numbers = len(effect.parameters(chain))
    like = [
        e for e in found if len(e.parameters(chain)) == numbers and _changes_with_clock(e, chain)
    ]
    chosen = np.linspace(0, len(like) - 1, min(len(like), max_count)).astype(int)
    return [like[i] for i in chosen]


def _columns(bench, problem, others, tested):
    """(P, 1, N) columns of the effects: candidates', or as solved where a scan found them (an order, an instant)."""
    keys = {name_of(e) for e in tested}
    found = [c.columns for c in problem.candidates if any(name_of(e) in keys for e in c.effects)]
    found = found or bench.problem((*others, *tested)).added[-len(tested) :]
    return np.concatenate(found, axis=1).T[:, None]


def _permuted_rows(pose: np.ndarray, rng) -> np.ndarray:
    """(n,) row that each row reads: rows of one pose (n,) read those of one other, repeatedly if these are fewer."""
    _, group, count = np.unique(pose, return_inverse=True, return_counts=True)
    order = np.argsort(group, kind="stable")
    start = np.cumsum(count) - count
    rank = np.empty(len(pose), int)
    rank[order] = np.arange(len(pose)) - start[group[order]]
    other = rng.permutation(len(count))[group]
    return order[start[other] + rank % count[other]]
