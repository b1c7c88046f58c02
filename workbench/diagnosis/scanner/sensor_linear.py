"""A sensor's fit, linearised: residual, baseline, candidates and places, as whitened coordinates."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sensors.camera.corners import placements
from sensors.camera.focal_scatter import by_focal_length
from sensors.effects import CATALOGUE
from sensors.light.ball_stripes import centres_family
from sensors.light.grouping import groups
from sensors.light.planes import steps_family
from sensors.light.shared_errors import SharedStripeErrors, Step, decorrelated, random_effect
from sensors.scanner.adjustment import ON_BOTH
from workbench.core.effect import Effect
from workbench.core.least_squares.bundle import BundleFit, Family
from workbench.core.least_squares.linear_algebra import symmetric_eigenvalues
from workbench.core.model import Evaluation, Model
from workbench.core.parameters import Parameters
from workbench.diagnosis.levels import ANGLE_DECIMALS, NEGLIGIBLE_SHARE
from workbench.diagnosis.linear.candidates import Candidate, Scan, Site
from workbench.diagnosis.linear.problem import Problem, observable_basis
from workbench.diagnosis.noise.outliers import robust_weights
from workbench.diagnosis.robot.library import candidate_of, grids, scan_of, variants
from workbench.diagnosis.scanner.sensor_library import places
from workbench.jobs.sensor import chains as measured_chains
from workbench.jobs.sensor.chains import Chains

_VISIBLE_SIGMAS, WIDEST = 5.0, 300.0
"""Sigmas that are just visible, and multiples of a typical size beyond which nothing is asked for."""
_SAME_SPREAD = 0.9
"""Share of shared errors that remain from which on an effect leaves them as they are: a spread is known to a tenth."""
_BOARD_ONLY = "artefact"
_FAMILIES = {
    "corners": ("placement",),
    "board_stripes": ("placement", "step"),
    "balls": ("ball", "step"),
}


def models(chains: Chains, effects: tuple[Effect, ...]) -> tuple[Model, ...]:
    """A model for each part, with the effects that can act on it."""
    return tuple(
        Model(chain, tuple(e for e in effects if acts(e, name)))
        for name, chain in chains.parts.items()
    )


def acts(effect: Effect, part: str) -> bool:
    """Whether an effect acts on a part: light not on corners, balls' not on boards, nor the reverse."""
    if effect.where.startswith("ball-") or "ball" in getattr(effect, "surface", ()):
        return part == "balls"
    if effect.where == _BOARD_ONLY and part == "balls":
        return False
    return part != "corners" or effect.port in ON_BOTH


def residual_of_stripes(chains: Chains, effects: Sequence[Effect], fit: BundleFit) -> np.ndarray:
    """(n,) px, residuals of stripes on boards in a fit, with the errors that points of a stripe share."""
    stripes = replace(measured_chains.at_solution(chains, fit).board_stripes, shared_errors=None)
    model = Model(stripes, tuple(effect for effect in effects if acts(effect, "board_stripes")))
    keys = set(model.parameters.keys)
    found = {p.key: fit.parameters[p.key] for p in fit.parameters.table if p.key.count(".") > 1}
    values = {key: value for key, value in found.items() if key in keys}
    return model.evaluate(model.parameters.update(values)).residual[0]


def with_remaining_shared_errors(
    chains: Chains, effects: Sequence[Effect], fit: BundleFit
) -> Chains | None:
    """The chains with what points of stripes err together next to some effects; None where that is as before.

    The calibration estimates these errors without effects, so that they hold what an effect makes: a vibration
    displaces whole stripes. Weighted by them, a fit with the effect would leave a part of it.
    """
    stripes = chains.board_stripes
    if not effects or stripes is None or stripes.shared_errors is None:
        return None
    shared = stripes.shared_errors
    remainder = residual_of_stripes(chains, effects, fit)
    sigma = np.zeros(len(shared.sigma))
    for kind in (2, 0, 1):  # board poses, stripes, tilts of stripes
        shape = shared.shapes[kind]
        label = shared.labels[kind]
        squares = np.bincount(label, shape**2)
        size = np.bincount(label, shape * remainder) / np.maximum(squares, 1e-12)
        remainder = remainder - shape * size[label]
        sigma[kind] = np.sqrt((size[squares > 0] ** 2).mean())
    if sigma.max() > _SAME_SPREAD * shared.sigma.max():
        return None
    remaining = replace(shared, sigma=np.minimum(shared.sigma, sigma))
    return replace(chains, board_stripes=replace(stripes, shared_errors=remaining))


def host(part_models: Sequence[Model], effect: Effect) -> Model:
    """The first model that holds an effect."""
    return next(model for model in part_models if effect in model.effects)


def families_of(chains: Chains) -> dict[str, Family]:
    """Unknowns that groups of samples have of their own: poses, balls, free light planes."""
    families = {"placement": placements(chains.corners.poses)}
    if chains.balls is not None:
        families["ball"] = centres_family(chains.balls.centres)
    if chains.board_stripes is not None and chains.board_stripes.mirror is None:
        families["step"] = steps_family(chains.board_stripes.planes)
    return families


@dataclass(frozen=True)
class _Part:
    """One of the chains at a fit: its model, whose table has the fitted values, evaluated there without noise.

    `residual` (m, n) whitened; `weights` (n,) robust; `steps`: factors that make points of stripes independent.
    """

    name: str
    model: Model
    table: Parameters
    evaluation: Evaluation
    residual: np.ndarray
    weights: np.ndarray
    steps: list[Step]

    @cached_property
    def root(self) -> np.ndarray:
        """(m, n) what whitens a coordinate, with its robust weight."""
        return np.sqrt(self.weights) / self.sigma

    @property
    def sigma(self) -> np.ndarray:
        """(m, n) px."""
        return np.broadcast_to(self.model.chain.sigma, self.evaluation.residual.shape)

    def white(self, rows: np.ndarray) -> np.ndarray:
        """(k, m n) whitened rows (k, m, n)."""
        return (decorrelated(self.steps, rows) * self.root).reshape(len(rows), -1)


def _evaluated(chains: Chains, effects, values: Mapping[str, float]):
    """(model, its parameters, evaluation) of each part with effects at `values` (by key)."""
    evaluated = []
    for model in models(chains, effects):
        table = model.parameters
        table = table.update({key: value for key, value in values.items() if key in table.index})
        evaluated.append((model, table, model.evaluate(table)))
    return evaluated


def _without_noise(chains: Chains, effects, values: Mapping[str, float]) -> Chains:
    """The chains as measured without noise, effects at `values`."""
    noiseless = {}
    for name, chain in chains.parts.items():
        acting = tuple(effect for effect in effects if acts(effect, name))
        noiseless[name] = measured_chains.measured(chain, acting, values, 0.0)
    return replace(chains, **noiseless)


class Linear:
    """A fit, linearised: residual, basis, candidates and sites of all parts as whitened coordinates."""

    def __init__(self, bench, effects, chains: Chains, fit: BundleFit, samples):
        self.bench, self.effects, self.fit = bench, effects, fit
        self.every = slice(None) if samples is None else samples
        solved = measured_chains.at_solution(chains, fit)
        table = fit.parameters.table
        values = {p.key: fit.parameters[p.key] for p in table if p.key.count(".") > 1}
        # derivatives where nothing is noise: else the noise of a place would fit itself
        self.chains = _without_noise(solved, effects, values)
        seen = _evaluated(solved, effects, values)
        noiseless_evaluations = _evaluated(self.chains, effects, values)
        self.parts = []
        for name, (model, _, noisy), noiseless in zip(solved.parts, seen, noiseless_evaluations):
            steps = _shared_errors(name, model.chain, bench.jitter_px)
            if bench.focal is not None:
                steps += _focal_lengths(
                    name, noiseless[0].chain, noiseless[2], bench.focal.scatter, steps
                )
            steps += _rounding(name, noiseless[0].chain, noiseless[2], steps)
            white = decorrelated(steps, noisy.residual) / model.chain.sigma
            self.parts.append(_Part(name, *noiseless, white, robust_weights(white), steps))
        self._ports: dict = {}

    def flat(self, rows_of_parts: Sequence[np.ndarray | None]) -> np.ndarray:
        """(k, N) whitened, of rows (k, m, n) of each part, None where they are zero."""
        count = next(len(rows) for rows in rows_of_parts if rows is not None)
        whitened = []
        for part, rows in zip(self.parts, rows_of_parts):
            whitened.append(np.zeros((count, part.root.size)) if rows is None else part.white(rows))
        return np.concatenate(whitened, axis=1)

    def problem(self) -> Problem:
        """The linear problem of the search."""
        used, all_parts = self.every, self.parts
        added, values = self.added()
        sample, first = [], 0
        for part in all_parts:
            count = len(part.weights)
            sample.append(np.tile(np.arange(first, first + count), len(part.residual)))
            first += count
        residuals = [(part.residual * np.sqrt(part.weights)).ravel() for part in all_parts]
        covariates = {name: column[used] for name, column in self.bench.covariates.items()}
        return Problem(
            residual=np.concatenate(residuals),
            basis=self.basis,
            sample=np.concatenate(sample),
            weights=np.concatenate([part.weights for part in all_parts]),
            sigma=np.concatenate([part.sigma.ravel() for part in all_parts]),
            pose=self.bench.pose[used],
            order=self.bench.order[used],
            covariates=covariates,
            sites=self.sites(),
            candidates=self.candidates(),
            scans=self.scans(),
            effects=self.effects,
            added=added,
            values=values,
            columns_of=lambda effect: self.columns(effect)[0],
        )

    @cached_property
    def basis(self) -> np.ndarray:
        """(N, R) of the shared parameters, every pose, every ball and free planes, each over its typical size."""
        table = self.fit.parameters
        keys = [key for key, free in zip(table.keys, table.mask) if free and key.count(".") == 1]
        shared = []
        for part in self.parts:
            free_table = part.table.only(np.isin(part.table.keys, keys))
            rows = part.white(part.model.linearise(free_table)[1])
            place = [keys.index(key) for key, free in zip(free_table.keys, free_table.mask) if free]
            columns_of_part = np.zeros((len(keys), part.root.size))
            columns_of_part[place] = rows * free_table.typical[free_table.mask][:, None]
            shared.append(columns_of_part)
        columns = [self.family(name, family) for name, family in families_of(self.chains).items()]
        if self.bench.focal is not None:
            columns.append(self.bench.focal.scatter.share * self.focal_lengths().T)
        return observable_basis(np.concatenate([np.concatenate(shared, axis=1), *columns]).T)

    def family(self, name: str, family: Family) -> np.ndarray:
        """(G L, N) whitened columns of a family's groups that have samples."""
        blocks = []
        groups = len(family.values)
        for part in self.parts:
            columns_of_groups = np.zeros((groups, family.length, part.root.size))
            if name in _FAMILIES[part.name]:
                rows = part.white(part.evaluation.family_rows(name))
                rows = rows * np.asarray(family.typical)[:, None]
                label = np.tile(part.model.chain.labels[name], len(part.root))
                columns_of_groups[label, :, np.arange(part.root.size)] = rows.T
            blocks.append(columns_of_groups.reshape(groups * family.length, -1))
        columns = np.concatenate(blocks, axis=1)
        return columns[np.any(columns != 0, axis=1)]

    def focal_lengths(self) -> np.ndarray:
        """(N, G) whitened columns of a relative focal length of the camera for each board pose."""
        blocks = []
        for part in self.parts:
            columns = np.zeros((len(self.chains.corners.poses), part.root.size))
            if part.name != "balls":
                rows = part.white(by_focal_length(part.model.chain.camera, part.evaluation)[None])[
                    0
                ]
                label = np.tile(part.model.chain.labels["placement"], len(part.root))
                columns[label, np.arange(rows.size)] = rows
            blocks.append(columns)
        columns = np.concatenate(blocks, axis=1)
        return columns[np.any(columns != 0, axis=1)].T

    def port(self, port: str, port_indices: tuple[int, ...], where: str) -> list:
        """Rows (k, m, n) of each part by the components of a port, None where the place is no part of it."""
        probe = _PlaceAndPort(where, port)
        found = []
        for part in self.parts:
            key = part.name, port, port_indices
            if acts(probe, part.name) and key not in self._ports:
                self._ports[key] = part.evaluation.rows(port, np.asarray(port_indices))
            found.append(self._ports[key] if acts(probe, part.name) else None)
        return found

    def candidates(self) -> tuple[Candidate, ...]:
        found = []
        for option in variants(CATALOGUE, self.bench.kind):
            effect = option.effect
            if not self.present(effect):
                continue
            columns, typical = self.columns(effect)
            typical = typical * self.widened(columns * typical)
            found.append(candidate_of(option, columns, typical))
        return tuple(found)

    def added(self) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        """Columns (N, P) and fitted values (P,) of each effect in the model."""
        columns, values = [], []
        models_here = [part.model for part in self.parts]
        for effect in self.effects:
            columns.append(self.columns(effect)[0])
            table = effect.parameters(host(models_here, effect).chain)
            values.append(np.array([self.fit.parameters[p.key] for p in table]))
        return tuple(columns), tuple(values)

    def widened(self, columns: np.ndarray) -> float:
        """By how much typical sizes grow until the best direction of columns (N, P) would be just visible.

        A mirror that turns a few degrees hides nearly all of a wobble: whatever of it can be seen at all is large.
        """
        orthogonal = self.cleared(columns)
        best = np.sqrt(max(symmetric_eigenvalues(orthogonal.T @ orthogonal)[-1], 0.0))
        return float(np.clip(_VISIBLE_SIGMAS / max(best, 1e-300), 1.0, WIDEST))

    def cleared(self, columns: np.ndarray) -> np.ndarray:
        """Columns (N, P) without what the baseline makes."""
        return columns - self.basis @ (self.basis.T @ columns)

    def present(self, effect) -> bool:
        """Whether an effect acts on anything here."""
        return any(acts(effect, part.name) for part in self.parts)

    def columns(self, effect: Effect) -> tuple[np.ndarray, np.ndarray]:
        """(N, P) whitened derivative by an effect's parameters at its null, and (P,) typical sizes."""
        blocks, chain = [], None
        for part in self.parts:
            if not acts(effect, part.name):
                blocks.append(None)
                continue
            chain = part.model.chain
            rows = part.evaluation.rows(effect.port, np.asarray(effect.port_indices(chain)))
            blocks.append(np.einsum("pkn,kmn->pmn", effect.basis(chain.state), rows))
        typical = np.array([p.typical for p in effect.parameters(chain)])
        return self.flat(blocks).T, typical

    def scans(self) -> tuple[Scan, ...]:
        """Effects with one option on a fine grid, as far as the steps of the mirror can show it."""
        if not self.bench.kind.mirror or self.chains.board_stripes is None:
            return ()
        angles = tuple(np.unique(self.chains.board_stripes.angles).tolist())
        found = []
        for grid in grids(CATALOGUE, replace(self.bench.kind, mirror_angles=angles)):
            effect = grid.make(grid.values[0])
            port_indices = effect.port_indices(self.chains.board_stripes)
            rows = self.flat(self.port(effect.port, port_indices, effect.where))
            found.append(scan_of(grid, rows, self.bench.covariates[grid.covariate][self.every]))
        return tuple(found)

    def sites(self) -> tuple[Site, ...]:
        found = []
        for place in places(self.bench.kind):
            rows = self.port(place.port, place.port_indices, place.where)
            if all(part_rows is None for part_rows in rows):
                continue
            typical = np.full(len(place.port_indices), place.typical)
            description = (place.unit, typical, place.covariates, place.pairs)
            found.append(Site(place.where, place.port, self.flat(rows), *description))
        return tuple(found)


def _shared_errors(name: str, chain, sigma_px: float) -> list[Step]:
    """Factors that make points of stripes independent which are displaced together by `sigma_px` (1 sigma)."""
    if not sigma_px or name == "corners":
        return []
    group = chain.labels["placement" if name == "board_stripes" else "ball"]
    labels = {"placement": group, "step": chain.labels["step"]}
    position = (chain.pixels[::-1] * chain.scan).sum(0)
    shared = replace(SharedStripeErrors.of(labels, position), sigma=np.array([sigma_px, 0.0, 0.0]))
    return shared.steps(np.broadcast_to(chain.sigma, (1, chain.n))[0])


def _focal_lengths(
    name: str, chain, evaluation: Evaluation, scatter, before: list[Step]
) -> list[Step]:
    """Factors that make points of stripes independent which a focal length of their image displaces together."""
    if name == "corners":
        return []
    of_image = chain.labels["placement" if name == "board_stripes" else "ball"]
    label = groups(of_image, chain.labels["step"])[0]
    sigma = np.broadcast_to(chain.sigma, (1, chain.n))[0]
    shape = decorrelated(before, by_focal_length(chain.camera, evaluation)[0])
    return [random_effect(scatter.share, label, shape, sigma**-2.0)]


def _rounding(name: str, chain, evaluation: Evaluation, before: list[Step]) -> list[Step]:
    """Factors that make points independent which the rounding of a commanded mirror angle displaces together."""
    if name == "corners" or chain.mirror is None or chain.angles is None:
        return []
    by_angle = evaluation.rows("mirror", np.array([0]))[0, 0]
    sigma = np.broadcast_to(chain.sigma, (1, chain.n))[0]
    return rounding_steps(chain.commanded_angles, by_angle, sigma, before)


@dataclass(frozen=True)
class _PlaceAndPort:
    """A place and a port, for `acts`."""

    where: str
    port: str


_COARSEST = 0.05
"""Last digit over the usual distance of two angles, above which the angles are as commanded and not rounded."""


def rounding_std(angles: np.ndarray) -> float:
    """rad, 1 sigma by which commanded angles (n,) rad are rounded; 0 where they are not.

    Angles in equal steps are taken as exact.
    """
    degrees = np.rad2deg(np.unique(angles[np.isfinite(angles)]))
    if len(degrees) < 3:
        return 0.0
    for digits in range(ANGLE_DECIMALS + 1):
        scaled = degrees * 10.0**digits
        if (np.abs(scaled - np.rint(scaled)) < NEGLIGIBLE_SHARE).all():
            gaps = np.diff(np.rint(scaled))
            is_exact = np.ptp(gaps) == 0 or 1 > _COARSEST * np.median(gaps)
            if is_exact:
                return 0.0
            return float(np.deg2rad(10.0**-digits) / np.sqrt(12))
    return 0.0


def rounding_steps(
    angles: np.ndarray, by_angle: np.ndarray, sigma: np.ndarray, before: list[Step]
) -> list[Step]:
    """Factors that make points independent which one rounded angle displaces together, after those `before`.

    angles (n,) rad as commanded, by_angle (n,) px/rad by which the mirror moves a point, sigma (n,) px.
    """
    spread = rounding_std(angles)
    if not spread:
        return []
    label = np.unique(angles, return_inverse=True)[1]
    return [random_effect(spread, label, decorrelated(before, by_angle), sigma**-2.0)]
