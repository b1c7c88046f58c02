"""The bench of a sensor: solves camera, mirror and effects with all poses, and makes the problem of a diagnosis there.

Baseline: Brown's camera, a flat board, one mirror (axis, offset, beam) or free light planes, a ball of
its certified radius. Board poses and centres of the balls belong to the baseline too:
their columns stand in the basis, so that what any pose can make of an effect is projected out.
Coordinates: u of all corners, v of all corners, stripes on boards, stripes on balls, in pixels.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from datasets.recording import Recording
from sensors.light.mirror import NAMES
from workbench.core.effect import Effect
from workbench.core.least_squares.bundle import BundleFit, solve_bundle
from workbench.core.model import Model
from workbench.core.parameters import Parameter, Parameters
from workbench.diagnosis.levels import MAX_ROUNDS
from workbench.diagnosis.linear.candidates import Site
from workbench.diagnosis.linear.estimates import Options, parameter_row
from workbench.diagnosis.linear.problem import Bench, Found, Problem
from workbench.diagnosis.scanner.predictions import Predicted, scored_errors
from workbench.diagnosis.scanner.sensor_covariates import (
    join_covariates,
    join_described,
    kind_of_sensor,
    split_covariates,
)
from workbench.diagnosis.scanner.sensor_library import described, places, samples_described
from workbench.diagnosis.scanner.sensor_linear import (
    WIDEST,
    Linear,
    acts,
    families_of,
    host,
    models,
    with_remaining_shared_errors,
)
from workbench.diagnosis.scanner.sensor_review import reviewed
from workbench.jobs.sensor import chains as measured_chains
from workbench.jobs.sensor.chains import Chains, Progress

Measure = Callable[[np.ndarray], np.ndarray]

FREE_MIRROR = tuple(name for name in NAMES if name not in ("gain", "face_zero"))

_FREE = 30.0  # typical sizes that a solve takes for one


def bench_of(recording: Recording, progress: Progress = lambda text: None) -> "SensorBench":
    """The bench of a recording of kind board-images or scan-images. Raises InputError."""
    return SensorBench(measured_chains.read(recording, progress))


class SensorBench(Bench):
    """The bench of corners, stripes on boards and stripes on balls.

    A sample is a corner or a block of a stripe; `pose` (n,): the board pose, or the scan's ball after them; `sigma`
    (n,) px its noise. `jitter_px`: 1 sigma by which whole stripes are displaced at random from image to image; the
    linear problem is whitened by it, see `with_jitter`. `focal`: `RandomFocalLength` of the images, or None.
    """

    unit = "px"
    # a third of the board poses would show a third as much, and other balls
    needs_all_samples = True
    bends_with_effects = True

    def __init__(self, chains: Chains):
        self.jitter_px = 0.0
        self.focal = None
        self.kind = kind_of_sensor(chains)
        if not self.kind.mirror:
            middle = 0.0
        else:
            middle = float(np.mean(chains.board_stripes.angles))
        parts = chains.parts
        covariates_of_parts = {
            name: described(measured_chains.noiseless(chain), name, middle)
            for name, chain in parts.items()
        }
        self.covariates = join_covariates(covariates_of_parts, chains.counts)
        masks = {name: samples_described(chain, name) for name, chain in parts.items()}
        self.described = join_described(covariates_of_parts, masks, chains.counts)
        filled = split_covariates(self.covariates, chains.counts, parts)
        filled = {name: replace(chain, covariates=filled[name]) for name, chain in parts.items()}
        self.chains = replace(chains, **filled)
        self.n = sum(chains.counts)
        self.pose = _poses(self.chains)
        self.sigma = _sigma(self.chains)
        self.order = self.covariates.get("time_s", np.arange(self.n, dtype=float))
        self._solved: dict = {}
        self._start: tuple | None = None
        self._is_far = False

    def with_jitter(self, sigma_px: float) -> "SensorBench":
        """The bench whose problems count the points of one stripe as displaced together, by `sigma_px` (1 sigma).

        Solutions are the same: there, stripes on boards have the shared errors that the calibration found.
        """
        bench = copy(self)
        bench.jitter_px = float(sigma_px)
        return bench

    def with_random_focal_length(self, focal) -> "SensorBench":
        """The bench whose problems count each image as seen with a focal length of its own: a `RandomFocalLength`."""
        bench = copy(self)
        bench.focal = focal
        return bench

    @property
    def of_board_stripes(self) -> slice:
        """Positions of stripes on boards among the samples."""
        first = self.chains.counts[0]
        return slice(first, first + self.chains.board_stripes.n)

    @property
    def shared_px(self) -> np.ndarray:
        """(n,) px, 1 sigma of what each sample shares with all others of its image."""
        shared = np.full(self.n, self.jitter_px)
        shared[: self.chains.counts[0]] = 0.0
        if self.focal is None:
            return shared
        return np.hypot(shared, self.focal.displacement(self.chains))

    def problem(
        self,
        effects: Sequence[Effect] = (),
        samples: np.ndarray | None = None,
        hypotheses: bool = True,
    ) -> Problem:
        """Baseline and effects solved on `samples` (n,) bool (None: all), linearised there; always with hypotheses."""
        del hypotheses
        linear = Linear(self, tuple(effects), *self.solve(effects, samples), samples)
        return linear.problem()

    def solve(self, effects: Sequence[Effect] = (), samples: np.ndarray | None = None):
        """Chains on the samples, and the bundle's fit of baseline and effects there."""
        named = frozenset((e.effect, e.where, str(e.options)) for e in effects)
        part = None if samples is None else samples.tobytes()
        solved = self._solved.setdefault(part, {})
        if named not in solved:
            chains = self.chains if samples is None else _select_samples(self.chains, samples)
            fit = self._fit(chains, tuple(effects), _nearest(solved, named))
            for _ in range(MAX_ROUNDS):
                if not fit.converged:
                    break  # its residuals are not those of the effects: they tell nothing of shared errors
                still_shared = with_remaining_shared_errors(chains, tuple(effects), fit)
                if still_shared is None:
                    break
                chains = still_shared
                fit = self._fit(still_shared, tuple(effects), fit)
            solved[named] = chains, fit
        return solved[named]

    def _fit(self, chains: Chains, effects, nearest: BundleFit | None) -> BundleFit:
        """Solved from the nearest set of effects on these samples (None: from the last solution of the baseline).

        Where that does not converge, also from the calibration. A baseline that an effect contradicts may be so far
        from the truth that a solve does not find back. Once that was so, solves with effects start from the
        calibration.
        """
        all_models = models(chains, effects)
        tables = (self._table(chains, effects), families_of(chains))
        start = (nearest.parameters, nearest.values) if nearest else self._start
        if start is None or (self._is_far and effects and nearest is None):
            fit = solve_bundle(all_models, *tables, loss="huber")
            if not effects:
                self._start = fit.parameters, fit.values
            return fit
        families = {n: replace(f, values=start[1][n]) for n, f in tables[1].items()}
        fit = solve_bundle(all_models, tables[0].take_over(start[0]), families, loss="huber")
        if fit.converged:
            return fit
        second_fit = solve_bundle(all_models, *tables, loss="huber")
        self._is_far = second_fit.converged and bool(effects)
        is_better = second_fit.converged or second_fit.history[-1] < fit.history[-1]
        return second_fit if is_better else fit

    def _table(self, chains: Chains, effects) -> Parameters:
        return shared(models(chains, effects), chains.gain_free)

    def _posed(self, chains: Chains, effects, known: Parameters) -> BundleFit:
        """Poses and balls alone, with everything else as `known`."""
        start = self._table(chains, effects).take_over(known)
        families = {name: family for name, family in families_of(chains).items() if name != "step"}
        all_fixed = start.only(np.zeros(len(start), bool))
        return solve_bundle(models(chains, effects), all_fixed, families, loss="huber")

    def held_out(
        self, effects: Sequence[Effect], folds: np.ndarray, independent: bool = False
    ) -> np.ndarray:
        """(n,) px: error of each sample predicted from the other folds (n,) int; nan where fold < 0.

        Camera, light, mirror and effects are those of the other folds. A held-out board pose comes from its corners
        alone: fitted to its stripes as well, it would absorb most of what these are off by. A ball's centre is fitted
        to its own stripes, since nothing else tells it.

        independent: errors whose squares over the noise's add up to the logarithmic score of each board pose and ball
        (`predictions`): to be compared by sums of squares, not to be shown.
        """
        return self._held_out(tuple(effects), folds, _lengths, independent)

    def held_out_stripes(self, effects: Sequence[Effect], folds: np.ndarray) -> np.ndarray:
        """(k,) px: signed errors of the stripes on boards, as of `held_out`."""
        return self._held_out(tuple(effects), folds, _first_component)[self.of_board_stripes]

    def _held_out(
        self, effects, folds: np.ndarray, measure: Measure, independent: bool = False
    ) -> np.ndarray:
        """(n,) px: `measure` of the residual (m, n) of each part, predicted from the other folds."""
        error = np.full(self.n, np.nan)
        for fold in np.unique(folds[folds >= 0]):
            out = folds == fold
            touched = np.isin(self.pose, self.pose[out])
            _, fit = self.solve(effects, ~out)
            chains_of_fit = _with_planes(self.chains, fit)
            chains = _select_samples(chains_of_fit, touched)
            residuals = self._held_by_corners(chains, effects, fit, independent)
            found = np.concatenate([measure(residual) for residual in residuals])
            error[touched & out] = found[out[touched]]
        return error

    def _held_by_corners(
        self, chains: Chains, effects, known: BundleFit, independent: bool
    ) -> list[np.ndarray]:
        """(m, n) px of each part, with everything `known` but board poses, from corners, and centres of balls."""
        corner_chains = replace(chains, board_stripes=None)
        poses = self._posed(corner_chains, effects, known.parameters).values
        posed = {name: chain.with_families(poses) for name, chain in chains.parts.items()}
        part_models = dict(zip(posed, models(replace(chains, **posed), effects)))
        if not independent:
            return [model.residual(_at_fit(model, known)) for model in part_models.values()]
        found = {name: _predicted(name, model, known) for name, model in part_models.items()}
        balls = [found.pop(name) for name in ("balls",) if name in found]
        scored = [
            scored_errors(kinds, known.covariance)
            for kinds in (list(found.values()), balls)
            if kinds
        ]
        return [rows for kinds in scored for rows in kinds]

    def noise(self, inliers: np.ndarray) -> tuple[float, str]:
        """RMS error (px) that noise alone makes of the inliers (n,) bool, weighted as held-out errors are."""
        of_parts = [len(chain.sigma) for chain in self.chains.parts.values()]
        components = np.repeat(of_parts, self.chains.counts)
        weight = self.sigma[inliers] ** -2.0
        squared_shared = self.shared_px[inliers] ** 2
        shared = float(weight @ squared_shared)
        source = ["neighbouring points"]
        source += ["jitter"] * bool(self.jitter_px) + ["focal lengths"] * (self.focal is not None)
        squares = components[inliers].sum() + shared
        noise = float(np.sqrt(squares / weight.sum()))
        return noise, f"from {' and '.join(source)}"

    def ball_centres(self, effects: Sequence[Effect] = ()) -> np.ndarray | None:
        """(B, 3) mm, centres of the balls of all scans in the camera frame; None without balls.

        Without effects: as a scanner measures them that is calibrated from boards alone. A joint solve would bend it
        to fit the balls, and their centres would then be off by more than any scan is.
        """
        if self.chains.balls is None:
            return None
        if effects:
            return self.solve(tuple(effects))[1].values["ball"]
        boards = replace(self.chains, balls=None)
        fit = solve_bundle(
            models(boards, ()), self._table(boards, ()), families_of(boards), loss="huber"
        )
        return self._posed(_with_planes(self.chains, fit), (), fit.parameters).values["ball"]

    def parameters(
        self,
        effects: Sequence[Effect],
        samples: np.ndarray | None = None,
        options: Options | None = None,
    ) -> tuple[dict, ...]:
        """Every effect's parameters with value and std; `size_px` RMS of what one does to a coordinate, `size_mm` of
        the same at the middle range."""
        chains, fit = self.solve(effects, samples)
        part_models = models(chains, tuple(effects))
        scale = float(np.median(self.covariates["range"])) / chains.corners.camera.fx
        shifts = self._shifts(effects, samples, fit.parameters, options or {})
        rows = []
        for effect in effects:
            chain = host(part_models, effect).chain
            for p in effect.parameters(chain):
                value = fit.parameters[p.key]
                size = _rms_of(part_models, fit, p.key) * abs(value)
                known = fit.std.get(p.key, float("nan"))
                std = np.hypot(known, shifts.get(p.key, 0.0))
                row = parameter_row(p, effect, value, std, known)
                rows.append(row | {"size_px": size, "size_mm": size * scale})
        return tuple(rows)

    def _shifts(self, effects, samples, known: Parameters, options: Options) -> dict[str, float]:
        """Parameter -> how far it moves where the options are one standard deviation away, RMS over the options."""
        squares: dict[str, float] = {}
        for effect, option in options.items():
            if effect not in effects:
                continue
            changed = [option.changed(e, 1.0) if e is effect else e for e in effects]
            chains, fit = self.solve(changed, samples)
            part_models = models(chains, tuple(changed))
            for before, after in zip(effects, changed):
                chain = host(part_models, after).chain
                pairs = zip(before.parameters(chain), after.parameters(chain))
                for p, other in pairs:
                    move = fit.parameters[other.key] - known[p.key]
                    squares[p.key] = squares.get(p.key, 0.0) + move**2
        return {key: float(np.sqrt(square)) for key, square in squares.items()}

    def units(self, effects: Sequence[Effect]) -> list[str]:
        """Units of the parameters of some effects; the last of the chains knows light and balls, too."""
        chain = list(self.chains.parts.values())[-1]
        return [p.unit for effect in effects for p in effect.parameters(chain)]

    def reviewed(self, found: Found, samples: np.ndarray | None = None) -> Found:
        """Findings of the search and their confounded effects, each solved with the full model."""
        return reviewed(self, found, samples)

    def typical(self, effect: Effect) -> np.ndarray:
        """(P,) what sizes an effect's parameters have before measuring, in their own units."""
        chain = next(chain for name, chain in self.chains.parts.items() if acts(effect, name))
        sizes = [p.typical for p in effect.parameters(chain)]
        return np.array(sizes)

    def smooth(self, site: Site, names: tuple[str, ...]) -> Effect:
        effect = super().smooth(site, names)
        effect.components = next(
            p.port_indices
            for p in places(self.kind)
            if (p.where, p.port) == (site.where, site.port)
        )
        return effect


def _nearest(solved: Mapping, named: frozenset) -> BundleFit | None:
    """The converged fit of the set of effects nearest to `named`; None where no set has any of them."""
    best = max(
        (others for others, (_, fit) in solved.items() if fit.converged and others & named),
        key=lambda others: (len(others & named), -len(others - named)),
        default=None,
    )
    return None if best is None else solved[best][1]


def _poses(chains: Chains) -> np.ndarray:
    labels = [chain.labels["placement"] for part, chain in chains.parts.items() if part != "balls"]
    if chains.balls is not None:
        balls = chains.balls.labels["ball"] + len(chains.corners.poses)
        labels.append(balls)
    return np.concatenate(labels)


def _sigma(chains: Chains) -> np.ndarray:
    """(n,) px, noise of a coordinate of each sample."""
    sigmas = []
    for chain, count in zip(chains.parts.values(), chains.counts):
        sigma = np.broadcast_to(chain.sigma, (len(chain.sigma), count))
        sigmas.append(np.sqrt((sigma**2).mean(0)))
    return np.concatenate(sigmas)


def _select_samples(chains: Chains, samples: np.ndarray) -> Chains:
    """The chains on some of all samples (n,) bool; a part of which nothing is left stays out."""
    edges = np.cumsum((0, *chains.counts))
    selected = {}
    for (name, chain), a, b in zip(chains.parts.items(), edges, edges[1:]):
        used = samples[a:b]
        if used.any() or name == "corners":
            selected[name] = chain.at(used)
        else:
            selected[name] = None
    return replace(chains, **selected)


def _with_planes(chains: Chains, fit: BundleFit) -> Chains:
    """The chains with the light planes of a fit, where these were free."""
    if "step" not in fit.values:
        return chains
    changed = {
        name: replace(chain, change=fit.values["step"])
        for name, chain in chains.parts.items()
        if name != "corners"
    }
    return replace(chains, **changed)


def shared(part_models: Sequence[Model], gain_free: bool) -> Parameters:
    """One table for all parts; free but for what a mirror does not show."""
    table = Parameters.of(
        {p.key: _wide(p) for model in part_models for p in model.parameters.table}.values()
    )
    for model in part_models:
        table = table.take_over(model.parameters)
    table = table.free("*")
    fixed = [n for n in NAMES if n not in FREE_MIRROR and not (gain_free and n == "gain")]
    if "mirror.gain" in table.index:
        return table.fix(*(f"mirror.{name}" for name in fixed))
    return table


def _wide(parameter: Parameter) -> Parameter:
    """A parameter of an effect as free as an effect may be large here, see `Linear.widened`; others as they are."""
    if parameter.key.count(".") == 1:
        return parameter
    return replace(parameter, typical=_FREE * parameter.typical, prior=WIDEST * parameter.typical)


def _at_fit(model: Model, fit: BundleFit) -> Parameters:
    """The model's parameters at a fit's."""
    return model.parameters.take_over(fit.parameters)


def _predicted(name: str, model: Model, fit: BundleFit) -> Predicted:
    """The samples of a part as predicted by a fit of others."""
    table = _at_fit(model, fit)
    keys = fit.table.keys
    free_table = table.only(np.isin(table.keys, keys))
    residual, rows = model.linearise(free_table)
    by_shared = np.zeros((len(keys), *residual.shape))
    by_shared[[keys.index(key) for key, free in zip(free_table.keys, free_table.mask) if free]] = (
        rows
    )
    evaluation = model.evaluate(table)
    if "step" in fit.values and name != "corners":  # free light planes are shared, too
        first = keys.index(next(key for key in keys if key.startswith("step-")))
        for port_index, row in enumerate(by_step := evaluation.family_rows("step")):
            place = first + model.chain.labels["step"] * len(by_step) + port_index
            by_shared[place, :, np.arange(residual.shape[1])] = row.T
    family = "ball" if name == "balls" else "placement"
    sigma = np.broadcast_to(model.chain.sigma, residual.shape)
    rows_of_family = evaluation.family_rows(family)
    return Predicted(residual, sigma, by_shared, rows_of_family, model.chain.labels[family])


def _lengths(residual: np.ndarray) -> np.ndarray:
    return np.sqrt((residual**2).sum(0))


def _first_component(residual: np.ndarray) -> np.ndarray:
    return residual[0]


def _rms_of(part_models, fit, key) -> float:
    """RMS over all coordinates (px) of a parameter's column."""
    squares = count = 0.0
    for model in part_models:
        count += model.chain.pixels.shape[1] * len(model.chain.sigma)
        if key in model.parameters.index:
            table = _at_fit(model, fit)
            is_key = np.array([k == key for k in table.keys])
            rows = model.linearise(table.only(is_key))[1]
            squares += float((rows**2).sum())
    return float(np.sqrt(squares / max(count, 1)))
