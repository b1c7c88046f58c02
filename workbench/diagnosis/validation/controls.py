"""Permutation, reversal and circular-shift controls: a permuted cause explains nothing, an ordered one only in order.

The derivative of the measurement stays as it is; only what the effect reads of its samples (angles, torques, sides of
approach, temperatures, time) is given to other poses, taken from the rows in reverse, or from a clock that is moved
round. A gain that survives this was never owed to the cause. What a permuted cause can make of the fitted effect
itself it gains in any case (a step in the middle is the same step backwards): that is taken off, and where it is
nearly all, the control says that it cannot tell.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.core.covariates import clock
from workbench.core.effect import Effect
from workbench.core.least_squares.linear_algebra import least_squares, symmetric_eigen, thin_svd
from workbench.core.model import NOISE, STATE_PORTS
from workbench.diagnosis.linear.problem import Bench
from workbench.diagnosis.validation.heldout import name_of
from workbench.diagnosis.validation.terms import Control

_TRIALS, _TURNS = 199, 39
_LEVEL, _LEFT, _HALF, _MOST = 0.01, 0.2, 0.5, 0.75
_MOST_BY_CHANCE = (
    0.5  # share that unrelated causes explain of each other, beyond which nothing more is taken off
)
_MADE = 0.8  # share of the fitted effect that a permuted cause makes, from which on it cannot tell
_SAME = (
    1e-3  # of a column's length, by which two that mean the same differ from rounding and refitting
)
PERMUTED, REVERSED, ROTATED = "permuted", "reversed", "circular shift"
_CLOCKS = ("time_s", "time", "row", "order")


def controls(
    bench: Bench, others: Sequence[Effect], own: Sequence[Effect], seed: int = 0
) -> tuple[Control, ...]:
    """The controls that can be made of the effects `own` conditional on a model that holds `others`.

    A linearised gain: the fall of the whitened sum of squares when the effects' columns join. Permuted: 199 times
    over poses. Passed where fewer than one in a hundred gains as much, and the median trial gains, beyond what as
    many columns gain by chance, less than a fifth. Reversed, and 39 times, for what reads the clock, with that moved
    round: passed where this gains less than a half, or three of four of them less than a fifth, of the own gain, both
    without what it makes by being like the effect itself.
    """
    if any(e.port in (*STATE_PORTS, NOISE) for e in own):
        return (
            Control(
                PERMUTED,
                None,
                None,
                None,
                why="it acts through other effects or on the noise alone",
            ),
        )
    trial = _Trial(bench, others, own)
    rng = np.random.default_rng(seed)
    gains = np.array([trial.gain(trial.permuted(rng)) for _ in range(_TRIALS)])
    p = float((1 + (gains >= trial.own).sum()) / (1 + _TRIALS))
    by_chance = trial.by_chance(rng)
    share = max(trial.beyond(float(np.median(gains))) - by_chance, 0.0) / (1 - by_chance)
    made = [Control(PERMUTED, share, p, p <= _LEVEL and share < _LEFT, _TRIALS)]
    return (*made, *_of_time(trial, rng))


def _of_time(trial: "_Trial", rng) -> tuple[Control, ...]:
    """Backwards, where that changes what the effect does; and a circular shift of its time, where it reads one."""
    if trial.chain is None or not trial.changes(
        backwards := _backwards_state(trial.chain, trial.problem.pose)
    ):
        return ()
    made = [_control_of(REVERSED, trial, [backwards], "backwards in time it does nearly the same")]
    if any(_clocked(e, trial.chain.state, backwards) for e in trial.effects):
        turned = [_turned_state(trial.chain, part) for part in rng.uniform(0.05, 0.95, _TURNS)]
        made.append(
            _control_of(
                ROTATED, trial, turned, "with its time circularly shifted it does nearly the same"
            )
        )
    return tuple(made)


def _control_of(kind: str, trial: "_Trial", states, why: str) -> Control:
    """The control of one kind from the altered states; those that do nearly the same say nothing."""
    altered = [trial.basis(state) for state in states]
    made = np.array([trial.made_by(small) for small in altered])
    telling = np.flatnonzero(made < _MADE)
    if len(telling) < max(1, len(states) // 4):
        return Control(kind, None, None, None, len(states), f"{why}, so that this cannot tell")
    gains = np.array([trial.gain(altered[k]) for k in telling])
    left = np.array([(trial.beyond(g) - m) / (1 - m) for g, m in zip(gains, made[telling])])
    share = float(np.clip(np.quantile(left, _MOST), 0.0, None))
    p = float((1 + (gains >= trial.own).sum()) / (1 + len(gains))) if len(states) > 1 else None
    limit = (
        _LEFT if len(states) > 1 else _HALF
    )  # one trial by itself is less sure than most of many
    return Control(kind, share, p, share < limit, len(telling))


def of_order(bench: Bench, effects: Sequence[Effect]) -> bool:
    """Whether an effect reads the time or the order of the rows, so that it says nothing of times not measured."""
    chain = bench.chain
    if chain is None or not effects:
        return any("time" in getattr(e, "names", ()) for e in effects)
    backwards = _backwards_state(chain, bench.pose)
    return any(_clocked(e, chain.state, backwards) for e in effects)


def _clocked(effect, state, backwards) -> bool:
    moves = any(name.startswith("move") for name in getattr(effect, "names", ()))
    if moves or effect.by_moves or effect.port in (*STATE_PORTS, NOISE):
        return False
    here, there = effect.basis(state), effect.basis(backwards)
    return not np.allclose(here, there, rtol=0, atol=_SAME * np.abs(here).max())


def _backwards_state(chain, pose):
    """The state with its clock running backwards, and the last moves taken from the rows after."""
    from workbench.diagnosis.robot.bench import covariates_of

    held = dict(chain.state.covariates)
    turned = {name: x.max() + x.min() - x for name, x in held.items() if name in _CLOCKS}
    state = replace(chain.state, covariates=held | turned)
    return replace(state, covariates=covariates_of(replace(chain, state=state), pose))


def _turned_state(chain, part: float):
    """The state with its time circularly shifted by a part (0-1) of the recording."""
    held = dict(chain.state.covariates)
    order = np.argsort(clock(chain.state), kind="stable")
    turned = {}
    for name in (n for n in _CLOCKS if n in held):
        turned[name] = held[name].copy()
        turned[name][order] = np.roll(held[name][order], int(round(part * chain.n)))
    return replace(chain.state, covariates=held | turned)


class _Trial:
    """Whitened residual conditional on `others`, and what the effects' columns gain when they read other samples.

    `small` (P, k, n): what the effects do to their slots; `rows` (k, m, n) whitened derivatives by the slots. A bench
    that knows no robot gives the columns themselves, (P, 1, N), whose coordinates are then exchanged.
    """

    def __init__(self, bench, others, own):
        self.problem = bench.problem(others, hypotheses=False).keeping()
        self.y = self.problem.clear(self.problem.residual)
        self.noise = float(self.y @ self.y) / max(self.problem.degrees, 1)
        self.chain, self.effects = bench.chain, tuple(own)
        self.starts = _starts(self.problem.pose)
        if self.chain is None:
            self.small, self.rows = _columns(bench, self.problem, others, own), None
        else:
            self.small, self.rows = self.basis(self.chain.state), self._rows(bench, others)
        self.own = self.gain(self.small)
        columns = self.problem.clear(self.columns(self.small))
        self.coefficients = least_squares(columns, self.y)

    def basis(self, state):
        """(P, K, n) the effects side by side, each on slots of its own."""
        made = [e.basis(state) for e in self.effects]
        whole = np.zeros(
            (sum(len(b) for b in made), sum(b.shape[1] for b in made), made[0].shape[2])
        )
        p = k = 0
        for b in made:
            whole[p : p + len(b), k : k + b.shape[1]] = b
            p, k = p + len(b), k + b.shape[1]
        return whole

    def _rows(self, bench, others):
        model, fit, _ = bench.solve(others)
        here = model.evaluate(fit.parameters)
        rows = np.concatenate(
            [here.rows(e.port, np.asarray(e.slots(model.chain))) for e in self.effects]
        )
        root = np.sqrt(self.problem.weights)[self.problem.sample] / self.problem.sigma
        return rows * root.reshape(rows.shape[1:])

    def columns(self, small):
        """(N, P) whitened columns."""
        made = (
            small
            if self.rows is None
            else np.einsum("pkn,kmn->pmn", small, self.rows, optimize=True)
        )
        return made.reshape(len(small), -1).T

    def gain(self, small) -> float:
        """Fall of the whitened sum of squares."""
        clear = self.problem.clear(self.columns(small))
        length = np.sqrt((clear**2).sum(0))
        seen = length > 1e-9 * length.max(initial=1e-300)
        clear = clear[:, seen] / length[seen]
        values, vectors = symmetric_eigen(clear.T @ clear)
        kept = values > 1e-9
        along = (vectors[:, kept].T @ (clear.T @ self.y)) / np.sqrt(values[kept])
        return float(along @ along)

    def beyond(self, gain: float) -> float:
        """A gain as a share of the effects' own, both beyond what as many columns gain by chance."""
        chance = len(self.small) * self.noise
        return max(gain - chance, 0.0) / max(self.own - chance, 1e-300)

    def by_chance(self, rng) -> float:
        """Share (0-1) of what the effects make at other poses that they make from yet others, at most a half.

        As many functions of poses explain that much of each other, whatever they depend on: a lot where poses are few.
        """
        shares = []
        for _ in range(_TURNS):
            made = self.problem.clear(self.columns(self.permuted(rng)))
            signal = made @ self.coefficients
            plane = _plane(self.problem.clear(self.columns(self.permuted(rng))))
            length = float(signal @ signal)
            shares.append(float(((plane.T @ signal) ** 2).sum()) / max(length, 1e-300))
        return min(float(np.median(shares)), _MOST_BY_CHANCE)

    def permuted(self, rng):
        """What the effects would do if every pose were another."""
        if self.chain is None:
            return self.small[:, :, rng.permutation(self.small.shape[2])]
        return self.small[:, :, _other_poses(self.problem.pose, self.starts, rng)]

    def changes(self, state) -> bool:
        """Whether the effects do anything else in another state."""
        there = self.basis(state)
        return not np.allclose(there, self.small, rtol=0, atol=_SAME * np.abs(self.small).max())

    def made_by(self, small) -> float:
        """Share (0-1) of the fitted effect, but for what the baseline makes, that permuted causes make."""
        here, there = (_plane(self.problem.clear(self.columns(s))) for s in (self.small, small))
        fitted = here @ (here.T @ self.y)
        return float(((there.T @ fitted) ** 2).sum() / max(fitted @ fitted, 1e-300))


def _plane(columns: np.ndarray) -> np.ndarray:
    """(N, R) orthonormal basis of columns (N, P), without those that the baseline makes."""
    length = np.sqrt((columns**2).sum(0))
    seen = length > 1e-9 * length.max(initial=1e-300)
    u, s, _ = thin_svd(columns[:, seen] / length[seen])
    return u[:, s > 1e-6]


def _columns(bench, problem, others, own):
    """(P, 1, N) columns of the effects: candidates', or as solved where a scan found them (an order, an instant)."""
    keys = {name_of(e) for e in own}
    found = [c.columns for c in problem.candidates if any(name_of(e) in keys for e in c.effects)]
    found = found or bench.problem((*others, *own)).added[-len(own) :]
    return np.concatenate(found, axis=1).T[:, None]


def _starts(pose):
    """Rows of each pose, in order."""
    order = np.argsort(pose, kind="stable")
    edges = np.flatnonzero(np.diff(pose[order])) + 1
    return np.split(order, edges)


def _other_poses(pose, rows, rng) -> np.ndarray:
    """(n,) row that each row reads: the rows of one pose read those of one other, again and again if need be."""
    out = np.empty(len(pose), int)
    for mine, theirs in zip(rows, rng.permutation(len(rows))):
        out[mine] = np.resize(rows[theirs], len(mine))
    return out
