"""A measuring chain with effects: prediction, linearisation, simulation.

The chain provides the derivative of its residual with respect to each of its ports; an effect provides
the change of its components of one port. The derivative with respect to an effect's parameters is the
product of the two, for robots and scanners alike.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from workbench.core.effect import Effect, numeric_derivative
from workbench.core.parameters import Parameters

NOISE = "noise"
STATE_PORTS = ("gravity", "mass")
"""Ports that reach the measurement only through the effects that carry load (`elastic`)."""
Deltas = Mapping[str, tuple[np.ndarray, np.ndarray]]
"""port -> (components (k,), change of those components (k, n))"""


class Evaluation(Protocol):
    """The chain at one set of values; rows are derivatives of the residual."""

    residual: np.ndarray  # (m, n) predicted minus measured

    def own_rows(
        self, indices: np.ndarray
    ) -> np.ndarray: ...  # (k, m, n) for the chain's parameters
    def rows(self, port: str, port_indices: np.ndarray) -> np.ndarray: ...  # (k, m, n)


class Chain(Protocol):
    """Interface of a robot or scanner chain: parameters, state, sigma and evaluation."""

    parameters: Parameters
    state: object
    sigma: np.ndarray  # (m, n) or (m, 1), 1 sigma of each component of the residual

    def evaluate(self, values: np.ndarray, deltas: Deltas) -> Evaluation: ...
    def at(self, samples: np.ndarray) -> "Chain": ...
    def port_indices(
        self, port: str, where: str, components: tuple[int, ...]
    ) -> tuple[int, ...]: ...
    def numbers(
        self, place: str
    ) -> tuple[int, ...]: ...  # what K may be in `joint-K`, `ball-K`, ...
    def slides(self, joint: int) -> bool: ...  # whether joint K is prismatic


@dataclass(frozen=True)
class Model:
    """A chain bound to n samples, with the modelled effects.

    Attributes:
        chain: Robot or scanner: its own parameters, the state at n samples, and the residual.
        effects: Modelled effects; each perturbs one port of the chain.

    Examples:
        >>> from robot_model.files.loading import load_robot
        >>> from robot_model.system import bind
        >>> recording = wb.load_example("elastic-arm")
        >>> model = wb.Model(bind(load_robot(recording.robot), recording))
        >>> model.residual(model.parameters).shape  # (m, n), mm, predicted minus measured
        (3, 300)
    """

    chain: Chain
    effects: tuple[Effect, ...] = ()
    _bases: dict = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def parameters(self) -> Parameters:
        """The chain's own parameters, then those of each effect; none free."""
        extra = [p for effect in self.effects for p in effect.parameters(self.chain)]
        joined = Parameters.of([*self.chain.parameters.table, *extra])
        return joined.take_over(self.chain.parameters)

    @cached_property
    def spans(self) -> tuple[slice, ...]:
        """Slices of the parameters of each effect."""
        start = len(self.chain.parameters)
        spans = []
        for effect in self.effects:
            spans.append(slice(start, start + len(effect.parameters(self.chain))))
            start = spans[-1].stop
        return tuple(spans)

    @cached_property
    def shrunk(self) -> np.ndarray:
        """(P,) True for terms of series, whose common prior decides how many of them the data determine."""
        mask = np.zeros(len(self.parameters), bool)
        for effect, span in zip(self.effects, self.spans):
            mask[span] = bool(effect.shrinkage_groups())
        return mask

    def at(self, samples: np.ndarray) -> "Model":
        """The same model on some of the samples (indices or mask)."""
        return Model(self.chain.at(samples), self.effects)

    def part(self, samples: np.ndarray) -> "Model":
        """The same as `at`, with bases that are slices of those of this model; samples (n,) bool.

        For folds, which together see most samples: the basis of a linear effect is made once for all of them.
        """
        if samples.all():
            return self
        columns_of = getattr(self.chain, "columns_of", None)
        if columns_of is None:
            return self.at(samples)
        bases = _BasesOfPart(self, columns_of(np.flatnonzero(samples)))
        return self._same_effects(Model(self.chain.at(samples), self.effects, bases))

    def with_effects(self, *effects: Effect) -> "Model":
        """The same model with more effects."""
        return replace(self, effects=self.effects + effects, _bases=dict(self._bases))

    def with_chain(self, chain: Chain) -> "Model":
        """The same effects on `chain`: the same samples with the same state, other values of what they own."""
        model = self._same_effects(replace(self, chain=chain))
        model.__dict__["_stacks"] = self._stacks
        return model

    def _same_effects(self, other: "Model") -> "Model":
        """Another model of the same effects with what does not depend on the samples."""
        shared_properties = ("parameters", "spans", "_port_indices", "_indices_by_port")
        other.__dict__.update({name: getattr(self, name) for name in shared_properties})
        return other

    def residual(self, parameters: Parameters) -> np.ndarray:
        """(m, n) predicted minus measured, in the units of the measurement (mm, rad)."""
        return self.joined(self.evaluate(parameters).residual)

    def sigma(self, parameters: Parameters) -> np.ndarray:
        """(m, n) 1 sigma of each component, with the effects that act on the noise."""
        effects = [(e, s) for e, s in zip(self.effects, self.spans) if e.port == NOISE]
        delta = self._deltas_of(effects, parameters.values).get(NOISE)
        if delta is None:
            return self.chain.sigma
        return self.chain.sigma * np.exp(delta[1].sum(0))

    def linearise(self, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
        """Residual (m, n) and its derivative (F, m, n) with respect to the F free parameters."""
        residual, rows = self.residual_and_derivative(parameters)
        return residual, rows()

    def residual_and_derivative(
        self, parameters: Parameters
    ) -> tuple[np.ndarray, Callable[[], np.ndarray]]:
        """Residual (m, n), and a function that computes its derivative (F, m, n) from the same evaluation."""
        evaluation = self.evaluate(parameters)

        def rows() -> np.ndarray:
            return self.joined(self._free_rows(evaluation, parameters))

        return self.joined(evaluation.residual), rows

    def _free_rows(self, evaluation, parameters: Parameters) -> np.ndarray:
        """(F, m, n) derivative of the residual by the free parameters."""
        count = parameters.mask.sum()
        chain_columns = np.flatnonzero(parameters.mask[: len(self.chain.parameters)])
        if len(chain_columns) == count:  # no effect is free: the rows need not be copied
            return evaluation.own_rows(chain_columns)
        rows = np.empty((count, *evaluation.residual.shape))
        return self.fill_rows(evaluation, parameters, rows)

    def joined(self, columns: np.ndarray) -> np.ndarray:
        """(..., n) sums of (..., poses n): where several arm poses make one sample, their contributions add up."""
        poses = getattr(self.chain, "poses_per_sample", 1)
        if poses == 1:
            return columns
        return columns.reshape(*columns.shape[:-1], poses, columns.shape[-1] // poses).sum(-2)

    def fill_rows(
        self, evaluation: Evaluation, parameters: Parameters, rows: np.ndarray
    ) -> np.ndarray:
        """Into `rows` (F, m, n) the derivative of the residual of `evaluation`, made at `parameters`."""
        chain_size = len(self.chain.parameters)
        values = parameters.values
        filled = parameters.mask[:chain_size].sum()
        indices = np.flatnonzero(parameters.mask[:chain_size])
        rows[:filled] = evaluation.own_rows(indices)
        evaluation = _CachedEvaluation(evaluation, self._indices_by_port)
        loads = self._load_rows(parameters, evaluation)
        for effect, span in zip(self.effects, self.spans):
            free = parameters.mask[span]
            if free.any():
                end = filled + free.sum()
                out = rows[filled:end]
                if effect in loads:
                    out[:] = loads[effect][free]
                else:
                    self._effect_rows(effect, span, values, evaluation, free, out)
                filled = end
        return rows

    @cached_property
    def _port_indices(self) -> dict[Effect, np.ndarray]:
        """Components of each effect."""
        return {effect: np.asarray(effect.port_indices(self.chain)) for effect in self.effects}

    @cached_property
    def _indices_by_port(self) -> dict[str, np.ndarray]:
        """Sorted components that any effect changes, for each port that acts on the residual directly."""
        indices: dict[str, set] = {}
        for effect in self.effects:
            if effect.port not in (NOISE, *STATE_PORTS):
                indices.setdefault(effect.port, set()).update(self._port_indices[effect].tolist())
        return {port: np.array(sorted(port_indices)) for port, port_indices in indices.items()}

    def jacobian(self, parameters: Parameters) -> np.ndarray:
        """(m n, F) derivative of the stacked residual with respect to the free parameters."""
        residual, rows = self.linearise(parameters)
        return rows.reshape(len(rows), residual.size).T

    def _effect_rows(self, effect, span, values, evaluation, free, out):
        """Into `out` (free, m, n): port derivative times the effect's own small factor."""
        if effect.port == NOISE:
            out[:] = 0
        else:
            _contract(
                self._derivative(effect, span, values)[free],
                self._port_rows(effect, evaluation),
                out,
            )

    def _port_rows(self, effect, evaluation):
        return evaluation.rows(effect.port, self._port_indices[effect])

    def _load_rows(self, parameters, evaluation) -> dict[Effect, np.ndarray]:
        """Effect -> (P, m, n) of each effect on a state port that is free, by way of every effect that carries load."""
        pairs = zip(self.effects, self.spans)
        causes = []
        for e, s in pairs:
            if e.port in STATE_PORTS and parameters.mask[s].any():
                causes.append((e, s))
        if not causes:
            return {}
        values = parameters.values
        edges = np.cumsum([0, *(span.stop - span.start for _, span in causes)])
        total = np.zeros((edges[-1], *evaluation.residual.shape))
        for effect, effect_span in zip(self.effects, self.spans):
            if not effect.elastic:
                continue
            rows = self._port_rows(effect, evaluation)
            if effect.linear:
                changes = self._stacked(effect, tuple(cause for cause, _ in causes))
                for number, value in enumerate(values[effect_span]):
                    total += _contract(changes[:, number], value * rows)
            else:
                row_blocks = [
                    self._numeric_by_load(effect, effect_span, span, values) for _, span in causes
                ]
                total += _contract(np.concatenate(row_blocks), rows)
        found = {}
        for (cause, _), a, b in zip(causes, edges, edges[1:]):
            found[cause] = total[a:b]
        return found

    def _numeric_by_load(self, effect, effect_span, span, values):
        def moved(p):
            changed = values.copy()
            changed[span] = p
            return effect.delta(values[effect_span], self._state(changed))

        return numeric_derivative(moved, values[span], 1e-3 * self.parameters.typical[span])

    def evaluate(self, parameters: Parameters) -> Evaluation:
        """The chain at these parameters, its ports moved by the effects."""
        values = parameters.values
        return self.chain.evaluate(values[: len(self.chain.parameters)], self._deltas(values))

    def deltas(self, parameters: Parameters) -> Deltas:
        """Changes of every port's components that the effects make at these parameters."""
        return self._deltas(parameters.values)

    def _loads(self, values):
        """The effects on gravity and masses that are not at their null, with their spans."""
        pairs = zip(self.effects, self.spans)
        return [
            (e, s)
            for e, s in pairs
            if e.port in STATE_PORTS and (values[s] != self.parameters.nulls[s]).any()
        ]

    def _state(self, values):
        """The state under what the effects on gravity and masses make of it."""
        state = self.chain.state
        changes = [
            (e.port, self._port_indices[e], e.delta(values[s], state))
            for e, s in self._loads(values)
        ]
        return state.altered(changes) if changes else state

    def _deltas(self, values) -> Deltas:
        """Changes of every port's components; effects on the same component add up."""
        return self._deltas_of(zip(self.effects, self.spans), values)

    def _deltas_of(self, effects: Iterable[tuple[Effect, slice]], values) -> Deltas:
        """The same of some effects with their spans."""
        by_port: dict[str, list] = {}
        for effect, span in effects:
            if effect.port not in STATE_PORTS and self._is_changed(span, values):
                piece = self._port_indices[effect], self._delta(effect, span, values)
                by_port.setdefault(effect.port, []).append(piece)
        return {port: _add_up(pieces) for port, pieces in by_port.items()}

    def _is_changed(self, span: slice, values) -> bool:
        """Whether some parameter of an effect is not at its null."""
        return (values[span] != self.parameters.nulls[span]).any()

    def _delta(self, effect, span, values):
        if effect.linear:
            return _combined(values[span], self._derivative(effect, span, values))
        return effect.delta(values[span], self._state(values))

    def _derivative(self, effect, span, values):
        """(P, k, n) the small factor; that of a linear effect is computed once for these samples."""
        if not effect.linear:
            return effect.derivative(values[span], self._state(values))
        basis = self.basis(effect)
        if not effect.elastic:
            return basis
        loads = self._loads(values)
        if not loads:
            return basis
        sizes = np.concatenate([values[cause_span] for _, cause_span in loads])
        causes = tuple(cause for cause, _ in loads)
        key = causes, sizes.tobytes()
        if self._loaded.get(effect, (None,))[0] != key:
            changes = self._stacked(effect, causes)
            self._loaded[effect] = key, basis + _combined(sizes, changes)
        return self._loaded[effect][1]

    def _stacked(self, effect: Effect, causes: tuple[Effect, ...]) -> np.ndarray:
        """(C, P, k, n) changes of an elastic effect's factor per unit of each of the C parameters of some causes."""
        key = effect, causes
        if key not in self._stacks:
            self._stacks[key] = np.concatenate([self.basis(effect, cause) for cause in causes])
        return self._stacks[key]

    @cached_property
    def _loaded(self) -> dict:
        """Elastic effect -> loads, and its factor under them: the last that was computed."""
        return {}

    @cached_property
    def _stacks(self) -> dict:
        """(effect, causes) -> what `_stacked` made."""
        return {}

    def basis(self, effect: Effect, cause: Effect | None = None) -> np.ndarray:
        """(P, k, n) the small factor of a linear effect, in the model or not, with gravity and masses as they stand.

        cause: an effect on gravity or masses with C parameters; then (C, P, k, n), the change of an elastic effect's
        factor per unit of each. Torque is linear in both; their product is of second order and left out.
        """
        if cause is None:
            return self._own_basis(effect)
        try:
            return self._bases[effect, cause]
        except KeyError:
            elastic_effects = [
                effect for effect in self.effects if effect.elastic and effect.linear
            ]
            others = [
                other
                for other in elastic_effects
                if other is not effect and (other, cause) not in self._bases
            ]
            self._keep_changes(cause, [effect, *others])
            return self._bases[effect, cause]

    def _keep_changes(self, cause: Effect, effects: list[Effect]) -> None:
        """Keep the changes of the factors of elastic effects per unit of a cause: one altered state serves them all."""
        state = self.chain.state
        port_indices = cause.port_indices(self.chain)
        sizes = [p.typical for p in cause.parameters(self.chain)]
        changes = {effect: [] for effect in effects}
        for move in np.diag(sizes):
            altered = state.altered([(cause.port, port_indices, cause.delta(move, state))])
            for effect in effects:
                change = effect.basis(altered) - self.basis(effect)
                changes[effect].append(change / move.sum())
        for effect, changes_of_effect in changes.items():
            self._bases[effect, cause] = np.stack(changes_of_effect)

    def _own_basis(self, effect: Effect) -> np.ndarray:
        key = effect, None  # effects are compared by identity
        try:
            return self._bases[key]
        except KeyError:
            basis = self._bases[key] = effect.basis(self.chain.state)
            return basis


class _BasesOfPart(dict):
    """(effect, cause) -> basis on some samples, from that of a model on all of them; see `Model.basis`."""

    def __init__(self, model: Model, columns: np.ndarray):
        super().__init__()
        self._whole, self._columns = model, columns

    def __missing__(self, key):
        basis = self._whole.basis(*key)
        if basis.shape[-1] > 1:  # a basis of one column holds for every sample
            basis = np.take(basis, self._columns, axis=-1)
        self[key] = basis
        return basis


class _CachedEvaluation:
    """An evaluation that makes the rows of a port once, for all the effects on it together."""

    def __init__(self, evaluation, indices_by_port):
        self.residual, self._evaluation, self._port_indices, self._rows = (
            evaluation.residual,
            evaluation,
            indices_by_port,
            {},
        )

    def rows(self, port, port_indices):
        if port not in self._rows:
            self._rows[port] = self._evaluation.rows(port, self._port_indices[port])
        rows = self._rows[port]
        first = np.searchsorted(self._port_indices[port], port_indices)
        if len(first) == 1:
            return rows[first[0], None]
        return rows[first]


def _combined(sizes: np.ndarray, components: np.ndarray) -> np.ndarray:
    """(...) sum of parts (P, ...) times their sizes (P,)."""
    return (sizes @ components.reshape(len(components), -1)).reshape(components.shape[1:])


def _contract(small: np.ndarray, rows: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """(P, k, n) times (k, m, n), summed over the k components."""
    out = np.multiply(small[:, 0, None, :], rows[0], out=out)
    for port_index in range(1, len(rows)):
        out += small[:, port_index, None, :] * rows[port_index]
    return out


def _add_up(pieces) -> tuple[np.ndarray, np.ndarray]:
    port_indices = np.unique(np.concatenate([np.asarray(s) for s, _ in pieces]))
    total = np.zeros((len(port_indices), max(d.shape[-1] for _, d in pieces)))
    for port_indices_of_piece, delta in pieces:
        # An effect names each of its components once.
        total[np.searchsorted(port_indices, port_indices_of_piece)] += delta
    return port_indices, total
