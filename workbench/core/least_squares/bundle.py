"""Least squares over several models with shared parameters and with unknowns of groups of samples.

Board poses are numerous, and each affects only its own samples. They are eliminated by a Schur complement; the cost
grows linearly with their number (Brown 1958; Triggs et al., Bundle Adjustment, 1999, sec. 6). Other families of
unknowns may be kept.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from workbench.core.errors import InputError
from workbench.core.least_squares.bundle_blocks import Blocks, Family, Layout, Part
from workbench.core.least_squares.identifiability import Identifiability, identifiability
from workbench.core.least_squares.linear_algebra import (
    all_finite,
    covariance_of,
    inverse_positive,
    solve_positive,
)
from workbench.core.least_squares.noise import noise_mask
from workbench.core.least_squares.solver import CONVERGED, LOSSES, SETTLED, STALLED
from workbench.core.model import Model
from workbench.core.parameters import Parameters

OUT_OF_STEPS = (
    "did not converge: the cost was still falling at the last step; allow more steps, check units and the start, "
    "or fix parameters that are undetermined"
)
NOT_FINITE = "did not converge: the model or its derivative is not finite; check the start and the measurements"
# As in workbench.core.least_squares.solver: least damping per squared typical size, squared sigmas that end the solve.
# They are those of all unknowns together, which are many here: a last step without a new derivative may be longer.
_FLOOR, _DONE, _NEARLY = 1e-4, 1e-4, 5e-2
_LAST = 6  # steps that together must have brought less than one squared sigma where damping made the last one small
_LEAP, _LEAPS = 4, 2  # full steps that may go up before the cost falls, and how often this may fail
CHI_SQUARE_MEDIAN = {1: 0.4549, 2: 1.3863, 3: 2.366}
"""By degrees of freedom: those of one sample's whitened residual."""
# As many degrees of freedom: the root of what 5 % exceed; and, with Huber's weights beyond that, what
# is left of the mean of a degree's square (by integration).
_LIMIT = {1: 1.96, 2: 2.448, 3: 2.795}
_LEFT = {1: 0.9587, 2: 0.9720, 3: 0.9781}


@dataclass(frozen=True)
class BundleFit:
    """Result of a bundle adjustment. D dense unknowns: the shared free parameters, then the kept families' groups.

    `parameters` shared; `values` of each family (G, L); of each model `residual` (m, n) in the units
    of the measurement, `weights` (n,) of the robust loss and `scales`, its residuals over its
    sigmas; `normal` (D, D) what the data know of the dense unknowns when the eliminated ones are
    free, in their own units; `sigma_scale` by which all stated sigmas have to be multiplied;
    `table` of the dense unknowns; `history`, `outcome`, `degrees` as of `solve.Fit`; `next` how far its last derivative
    would move the dense (D,) and the eliminated (G, L) unknowns, nearly nothing but where it was allowed no step.
    """

    parameters: Parameters
    values: Mapping[str, np.ndarray]
    residual: tuple[np.ndarray, ...]
    weights: tuple[np.ndarray, ...]
    scales: tuple[float, ...]
    normal: np.ndarray
    table: Parameters
    sigma_scale: float
    history: tuple[float, ...]
    outcome: str
    degrees: float
    eliminated: "Eliminated" = field(repr=False)
    next: tuple[np.ndarray, np.ndarray] = field(repr=False)

    @property
    def converged(self) -> bool:
        return self.outcome in (CONVERGED, SETTLED, STALLED)

    @cached_property
    def known(self) -> Identifiability:
        """Rank, null space in words and covariance of the dense unknowns."""
        return identifiability(self.normal, self.table, self.sigma_scale)

    @cached_property
    def covariance(self) -> np.ndarray:
        """(D, D) of the dense unknowns, in their own units, with priors and at the residuals' real size."""
        return self.known.covariance

    @cached_property
    def std(self) -> dict[str, float]:
        """1 sigma of each dense unknown by its key."""
        return dict(zip(self.table.keys, np.sqrt(np.diag(self.covariance)).tolist()))

    def group_cross(self) -> np.ndarray:
        """(G, L, D) covariance of each group's unknowns with the dense ones."""
        return -self.eliminated.mix @ self.covariance


@dataclass(frozen=True)
class Eliminated:
    """Schur complement of G eliminated groups: `inverse` (G, L, L) and `mix` (G, L, D), their own units."""

    inverse: np.ndarray
    mix: np.ndarray


def solve_bundle(
    models: Sequence[Model],
    parameters: Parameters,
    families: Mapping[str, Family] = MappingProxyType({}),
    eliminate: str | None = "placement",
    loss: str = "linear",
    steps: int = 50,
    progress: Callable[[int, float], None] | None = None,
) -> BundleFit:
    """Fit the free ones of `parameters`, and all values of `families`, to the samples of all models.

    parameters: one table that holds every key of every model. A chain with families offers, in
    addition to `model.Chain`, `labels` (family -> (n,) int group of each sample), `with_families`
    (mapping family -> values) and, in its evaluation, `family_rows(name)` (L, m, n). One whose samples
    share errors offers `decorrelated(rows, between_groups=True)` (..., m, n), which makes residuals and derivatives
    independent ones of its `sigma`; between_groups=False within each combination of groups alone, with
    `between_groups` then the shape (n,) and the variance of what all samples of a group that is eliminated share beyond
    that (m = 1), None for nothing. The state that its effects read stays that of the start. loss: "linear", "huber"
    or "cauchy", a model's samples reweighted with the noise's scale from their own median. progress is
    called with each step's number and cost. Damping and stopping are those of `solve.solve`.
    InputError where a model has a parameter that the table lacks, or a group without a start.
    """
    problem = _Problem(models, parameters, families, eliminate, LOSSES[loss])
    for step in range(steps):
        if problem.outcome:
            break
        problem.step()
        if progress is not None:
            progress(step + 1, problem.cost)
    return problem.finish()


@dataclass
class _Point:
    """State of a solve: values, and of each part residual (m, N), its whitened square (N,) and weights (N,)."""

    parameters: Parameters
    values: dict[str, np.ndarray]
    residuals: list[np.ndarray] = field(default_factory=list)
    squares: list[np.ndarray] = field(default_factory=list)
    weights: list[np.ndarray] = field(default_factory=list)


class _Problem:
    """State of a running bundle adjustment: current point, normal equations and damping."""

    def __init__(self, models, parameters, families, eliminate, weigh):
        for model in models:
            parameters = parameters.only(parameters.mask & ~_noise(model, parameters))
        self.families = {
            name: families[name] for name in sorted(families, key=lambda name: name != eliminate)
        }
        self.layout = _layout(parameters, self.families, eliminate)
        self.parts = [Part(model, parameters, self.layout) for model in models]
        self.weigh, self.damping, self.outcome, self.history = weigh, 0.0, "", []
        self.leaps = _LEAPS
        self.scales(parameters)
        start = _Point(
            parameters, {name: np.array(f.values, float) for name, f in self.families.items()}
        )
        self.check_groups(start.values)
        self.inverse_sigma = [part.inverse_sigma(parameters) for part in self.parts]
        self.measured = sum(
            part.tiles.live.sum() * len(s) for part, s in zip(self.parts, self.inverse_sigma)
        )
        self.take(start, self.linearise(start))
        self.check()

    def check_groups(self, values):
        for part in self.parts:
            for name in part.families:
                last = int(part.tiles.groups[name].max(initial=0))
                if last >= len(values[name]):
                    raise InputError(
                        f"bundle: expected a start for {name} {last}, found {len(values[name])} of them; "
                        "give one for every group"
                    )

    def scales(self, parameters):
        """Typical sizes, precisions of priors and their centres, of the dense and the eliminated unknowns."""
        eliminated = self.families.get(self.layout.eliminate)
        dense_families = [
            family for name, family in self.families.items() if name != self.layout.eliminate
        ]
        free = parameters.mask
        repeat = [np.tile(np.asarray(f.typical, float), len(f.values)) for f in dense_families]
        self.scale = np.concatenate([parameters.typical[free], *repeat])
        trust = [np.tile(f.precision, len(f.values)) for f in dense_families]
        self.precision = np.concatenate([parameters.precision[free], *trust])
        self.centre = np.concatenate(
            [parameters.nulls[free], *(np.ravel(f.values) for f in dense_families)]
        )
        if eliminated is None:
            self.own_scale = np.ones(0)
        else:
            self.own_scale = np.asarray(eliminated.typical, float)
        self.own_precision = np.zeros(0) if eliminated is None else eliminated.precision
        if eliminated is None:
            self.own_centre = np.zeros((0, 0))
        else:
            self.own_centre = np.array(eliminated.values, float)

    def dense(self, point):
        """(D,) dense unknowns of a point."""
        dense_values = [
            np.ravel(v) for name, v in point.values.items() if name != self.layout.eliminate
        ]
        return np.concatenate([point.parameters.pack(), *dense_values])

    def eliminated(self, point):
        """(G, L) eliminated unknowns of a point."""
        return point.values.get(self.layout.eliminate, self.own_centre)

    def moved(self, move, own_move):
        """The present point, moved by typical sizes."""
        moved_dense = self.dense(self.point) + move * self.scale
        values = dict(self.point.values)
        for name, offset in self.layout.offset.items():
            values[name] = moved_dense[offset : offset + values[name].size].reshape(
                values[name].shape
            )
        if self.layout.eliminate in values:
            values[self.layout.eliminate] = self.eliminated(self.point) + own_move * self.own_scale
        return _Point(self.point.parameters.unpack(moved_dense[: self.layout.shared]), values)

    def linearise(self, point):
        """Rows of each part; the point is given its residuals and weights."""
        part_rows = [part.linearise(point.parameters, point.values) for part in self.parts]
        self.whiten(point, [residual for residual, _ in part_rows])
        rows = zip(self.parts, point.squares, point.residuals)
        point.weights = [self.weights(part, z, len(residual)) for part, z, residual in rows]
        return [rows for _, rows in part_rows]

    def whiten(self, point, residuals):
        """Compute the residuals of a point and their whitened squares."""
        point.residuals = residuals
        point.squares = [
            np.einsum("mn,mn->n", w, w)
            for w in (r * s for r, s in zip(residuals, self.inverse_sigma))
        ]

    def weights(self, part, z, m):
        """(N,) robust weights of squares z of m numbers each, 0 for padding."""
        live = part.tiles.live
        if self.weigh is None:
            return live.astype(float)
        spread = np.median(z if live.all() else z[live]) / CHI_SQUARE_MEDIAN[m]
        return np.where(live, self.weigh(z / max(spread, 1e-300), _LIMIT[m]), 0)

    def take(self, point, rows):
        """Set the current point and compute its whitened and scaled normal equations with priors."""
        self.point = point
        blocks = Blocks.empty(len(self.scale), len(self.own_centre), len(self.own_scale))
        roots = (s * np.sqrt(weights) for s, weights in zip(self.inverse_sigma, point.weights))
        for part, part_unknowns, root in zip(self.parts, rows, roots):
            part.add_to(blocks, part_unknowns, root)
        self.data = blocks.scaled(self.scale, self.own_scale)
        squares = sum(float(w @ z) for w, z in zip(point.weights, point.squares))
        excess = max(
            1.0, squares / max(self.measured, 1)
        )  # as in solve: priors do not drown poor data
        self.trust, self.own_trust = self.precision * excess, self.own_precision * excess
        self.gradient = self.data.gradient + self.trust * self.scale * (
            self.dense(point) - self.centre
        )
        pull = self.own_trust * self.own_scale * (self.eliminated(point) - self.own_centre)
        self.own_gradient = self.data.own_gradient + pull
        self.cost = self.cost_of(point)
        self.history = [*self.history, self.cost]

    def check(self) -> bool:
        """True if cost and equations are finite; otherwise the solver stops without a result."""
        if all_finite(
            self.cost, self.data.dense, self.data.cross, self.data.eliminated, self.gradient
        ):
            return True
        self.outcome = NOT_FINITE
        self.data = Blocks.empty(len(self.scale), len(self.own_centre), len(self.own_scale))
        self.gradient, self.own_gradient = self.data.gradient, self.data.own_gradient
        self.trust, self.own_trust = self.precision, self.own_precision
        return False

    def cost_of(self, point, weights=None):
        """The squares under some weights, the present ones by default, and those of the priors."""
        weights = self.point.weights if weights is None else weights
        squares = sum(float(w @ z) for w, z in zip(weights, point.squares))
        return squares + self._prior_cost(point)

    def _prior_cost(self, point) -> float:
        """The squares of the distances to the priors."""
        dense = self.trust @ (self.dense(point) - self.centre) ** 2
        eliminated = (self.eliminated(point) - self.own_centre) ** 2 @ self.own_trust
        return float(dense + eliminated.sum())

    def reduced(self, damping):
        """Schur complement (D, D) of the damped normal matrix, and own^-1 [cross, gradient] (G, L, D + 1)."""
        cross = self.data.cross
        damped = self.data.eliminated + np.diag(self.own_trust * self.own_scale**2 + damping)
        shared = self.data.dense + np.diag(self.trust * self.scale**2 + damping)
        right = np.concatenate([cross, self.own_gradient[..., None]], -1)
        solved = solve_positive(damped, right)
        # all groups' own unknowns one below the other: (G L, D)
        shape = damped.shape[0] * damped.shape[1], len(self.scale)
        flat_cross = cross.reshape(shape)
        flat_solved = solved[..., :-1].reshape(shape)
        return shared - flat_cross.T @ flat_solved, solved

    def newton(self, damping):
        """Moves of the dense (D,) and the eliminated unknowns (G, L), in typical sizes."""
        schur, mix = self.reduced(damping)
        pull = self.gradient - np.tensordot(self.data.cross, mix[..., -1], ((0, 1), (0, 1)))
        move = -solve_positive(schur, pull)
        return move, -(mix[..., -1] + mix[..., :-1] @ move)

    def step(self):
        """One step; the damping is increased until the cost decreases."""
        if not self.check():
            return
        before = self.cost
        for _ in range(20):
            move = self.newton(_FLOOR + self.damping)
            decrement = -float(self.gradient @ move[0] + (self.own_gradient * move[1]).sum())
            unit = max(1.0, self.cost / max(self.measured, 1))
            if (
                self.damping == 0
                and decrement <= _NEARLY * unit
                and self.finished(move, decrement, unit)
            ):
                return
            if self.accept(move) or self.leap(move):
                if abs(before - self.cost) < max(
                    1e-5 * before, 0.02 * unit
                ) and self.is_nearly_stationary(unit):
                    self.outcome = SETTLED
                return
            self.damping = max(4 * self.damping, 1e-9 * self.largest)
        if decrement < 1e-3 * max(1.0, self.cost):
            self.outcome = STALLED
        else:
            self.outcome = OUT_OF_STEPS

    def is_nearly_stationary(self, unit):
        """Whether it is not damping that makes a step small in a long valley: the last ones together were small too."""
        return self.damping == 0 or (
            len(self.history) > _LAST and self.history[-_LAST] - self.cost < unit
        )

    @property
    def largest(self):
        """The largest entry of the normal matrix."""
        return max(self.data.dense.max(initial=0), self.data.eliminated.max(initial=0))

    def finished(self, move, decrement, unit):
        """True if converged; a negligible last step needs no new derivative."""
        if decrement > _DONE * unit:
            trial = self.moved(*move)
            self.whiten(
                trial, [part.residual(trial.parameters, trial.values) for part in self.parts]
            )
            trial.weights = self.point.weights
            cost = self.cost_of(trial)
            if not cost < self.cost:
                return False
            self.point, self.cost = trial, cost
            self.history.append(cost)
        self.outcome = CONVERGED
        return True

    def accept(self, move):
        """Accept the step if it lowers the cost under the current weights."""
        trial = self.moved(*move)
        rows = self.linearise(trial)
        if not self.cost_of(trial) < self.cost:
            return False
        if self.damping > 1e-10 * self.largest:
            self.damping = self.damping / 8
        else:
            self.damping = 0.0
        self.take(trial, rows)
        return True

    def leap(self, move):
        """Accept a full step that raises the cost where a few more full steps bring it below where it was.

        Along a curved valley a straight step goes up its side, and damped steps are very many: the watchdog technique
        (Chamberlain et al., Math. Program. Study 16 (1982) 1).
        """
        if self.damping > 0 or self.leaps == 0:
            return False
        before = dict(self.__dict__)
        start = self.point
        for _ in range(_LEAP):
            trial = self.moved(*move)
            self.take(trial, self.linearise(trial))
            if not self.check():
                break
            if self.cost_of(self.point, start.weights) < before["cost"]:
                self.history = [*before["history"], self.cost]
                return True
            move = self.newton(_FLOOR)
        self.__dict__.update(before | {"leaps": self.leaps - 1})
        return False

    def degrees(self, schur, mix):
        """Residuals less the unknowns that the data, and not the priors, have spent on them."""
        prior = self.trust * self.scale**2 + _FLOOR
        inverse = covariance_of(schur - np.diag(prior), prior)
        determined_by_prior = np.diag(inverse) @ prior
        regularisation = np.diag(self.own_trust * self.own_scale**2 + _FLOOR)
        if len(regularisation):
            determined_by_prior += (self.inverse_own() * regularisation).sum() + (
                (mix @ inverse * mix).sum((0, 2)) * np.diag(regularisation)
            ).sum()
        return max(
            self.measured - len(self.scale) - self.own_centre.size + float(determined_by_prior), 1.0
        )

    def inverse_own(self):
        return inverse_positive(
            self.data.eliminated + np.diag(self.own_trust * self.own_scale**2 + _FLOOR)
        )

    def finish(self):
        schur, mix = self.reduced(_FLOOR)
        mix = mix[..., :-1]
        degrees = self.degrees(schur, mix)
        normal = schur - np.diag(self.trust * self.scale**2 + _FLOOR)
        scale = self.own_scale[:, None]
        if len(scale):
            inverse = self.inverse_own() * scale * scale.T
        else:
            inverse = self.data.eliminated
        variance_left = [1.0 if self.weigh is None else _LEFT[len(r)] for r in self.point.residuals]
        squares = [
            float(w @ z) / share
            for w, z, share in zip(self.point.weights, self.point.squares, variance_left)
        ]
        counts = [part.tiles.live.sum() * len(s) for part, s in zip(self.parts, self.inverse_sigma)]
        degrees_used = degrees / max(self.measured, 1)
        place = [part.tiles.place for part in self.parts]
        move, own_move = self.newton(_FLOOR)
        return BundleFit(
            self.point.parameters,
            self.point.values,
            tuple(r[:, p] for r, p in zip(self.point.residuals, place)),
            tuple(w[p] for w, p in zip(self.point.weights, place)),
            tuple(float(np.sqrt(q / max(c * degrees_used, 1))) for q, c in zip(squares, counts)),
            normal / np.outer(self.scale, self.scale),
            self.table(),
            float(np.sqrt(sum(squares) / degrees)),
            tuple(self.history),
            self.outcome or OUT_OF_STEPS,
            degrees,
            Eliminated(inverse, mix * scale / self.scale),
            (move * self.scale, own_move * self.own_scale),
        )

    def table(self):
        """The dense unknowns as parameters, all free, at their present values."""
        table = Parameters.of([*self._free_parameters(), *self._family_parameters()])
        return replace(table, values=self.dense(self.point), mask=np.ones(len(table), bool))

    def _free_parameters(self):
        """The shared parameters that are free."""
        parameters = self.point.parameters
        return [p for p, free in zip(parameters.table, parameters.mask) if free]

    def _family_parameters(self):
        """The parameters of all families that are not eliminated, one family after the other."""
        for name, family in self.families.items():
            if name != self.layout.eliminate:
                yield from family.table()


def _layout(parameters, families, eliminate):
    offset = {}
    start = int(parameters.mask.sum())
    for name, family in families.items():
        if name != eliminate:
            offset[name] = start
            start = start + np.size(family.values)
    lengths = {name: family.length for name, family in families.items()}
    return Layout(
        int(parameters.mask.sum()), eliminate if eliminate in families else None, offset, lengths
    )


def _noise(model, parameters):
    """(P,) True for parameters of the shared table that act on the noise of a model: they are not fitted here."""
    table = model.parameters
    all_free = table.only(np.ones(len(table), bool))
    acts = {key for key, noisy in zip(table.keys, noise_mask(model, all_free)) if noisy}
    return np.array([key in acts for key in parameters.keys], bool)
