"""A sensor's fit, linearised: residual, baseline, candidates and places, as whitened coordinates."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from sensors.camera.corners import placements
from sensors.effects import CATALOGUE
from sensors.light.ball_stripes import centres_family
from sensors.light.planes import steps_family
from sensors.light.together import Step, Together, decorrelated
from sensors.scanner.adjustment import ON_BOTH
from workbench.core.effect import Effect
from workbench.core.least_squares.bundle import BundleFit, Family
from workbench.core.least_squares.linear_algebra import symmetric_eigenvalues
from workbench.core.model import Model
from workbench.diagnosis.linear.problem import Candidate, Problem, Scan, Site, seen_basis
from workbench.diagnosis.noise.outliers import robust_weights
from workbench.diagnosis.robot.library import candidate_of, grids, scan_of, variants
from workbench.diagnosis.scanner.sensor_library import places
from workbench.jobs.sensor import chains as measured_chains
from workbench.jobs.sensor.chains import Chains

_VISIBLE, WIDEST = (
    5.0,
    300.0,
)  # sigmas that are just visible; times a typical size beyond which nothing is asked for
_BOARD_ONLY = "artefact"


def models(chains: Chains, effects: tuple[Effect, ...]) -> tuple[Model, ...]:
    """A model for each part, with the effects that can act on it."""
    return tuple(
        Model(chain, tuple(e for e in effects if acts(e, name)))
        for name, chain in chains.parts.items()
    )


def acts(effect: Effect, part: str) -> bool:
    """Whether an effect acts on a part: light not on corners, balls' not on boards, nor the reverse."""
    if effect.where.startswith("ball-"):
        return part == "balls"
    if effect.where == _BOARD_ONLY and part == "balls":
        return False
    return part != "corners" or effect.port in ON_BOTH


def host(every: Sequence[Model], effect: Effect) -> Model:
    """The first model that holds an effect."""
    return next(model for model in every if effect in model.effects)


def families_of(chains: Chains) -> dict[str, Family]:
    """Unknowns that groups of samples have of their own: poses, balls, free light planes."""
    made = {"placement": placements(chains.corners.poses)}
    if chains.balls is not None:
        made["ball"] = centres_family(chains.balls.centres)
    if chains.board_stripes is not None and chains.board_stripes.mirror is None:
        made["step"] = steps_family(chains.board_stripes.planes)
    return made


def _evaluated(chains: Chains, effects, values: Mapping[str, float]):
    """(model, its parameters, evaluation) of each part with effects at `values` (by key)."""
    made = []
    for model in models(chains, effects):
        table = model.parameters
        table = table.update({key: value for key, value in values.items() if key in table.index})
        made.append((model, table, model.evaluate(table)))
    return made


class Linear:
    """A fit, linearised: residual, basis, candidates and sites of all parts as whitened coordinates."""

    def __init__(self, bench, effects, chains: Chains, fit: BundleFit, samples):
        self.bench, self.effects, self.fit, self.samples = bench, effects, fit, samples
        there = measured_chains.at_solution(chains, fit)
        values = {
            p.key: fit.parameters[p.key] for p in fit.parameters.table if p.key.count(".") > 1
        }
        shared = [_shared_errors(name, part, bench.jitter_px) for name, part in there.parts.items()]
        self.shared = shared
        white = [
            decorrelated(steps, here.residual) / model.chain.sigma
            for steps, (model, _, here) in zip(shared, _evaluated(there, effects, values))
        ]
        self.residuals, self.weights = white, [robust_weights(w) for w in white]
        # derivatives where nothing is noise: else the noise of a place would fit itself
        still = {
            name: measured_chains.measured(
                chain, tuple(e for e in effects if acts(e, name)), values, 0.0
            )
            for name, chain in there.parts.items()
        }
        self.chains = replace(there, **still)
        self.models, self.tables, self.points = zip(*_evaluated(self.chains, effects, values))
        self.names = tuple(self.chains.parts)
        self.root = [
            np.sqrt(w) / np.broadcast_to(m.chain.sigma, here.residual.shape)
            for w, m, here in zip(self.weights, self.models, self.points)
        ]
        self._ports: dict = {}

    def flat(self, parts) -> np.ndarray:
        """(k, N) of rows (k, m, n) a part, None for nothing; not whitened before."""
        count = next(len(rows) for rows in parts if rows is not None)
        made = [
            np.zeros((count, root.size))
            if rows is None
            else (decorrelated(steps, rows) * root).reshape(count, -1)
            for rows, root, steps in zip(parts, self.root, self.shared)
        ]
        return np.concatenate(made, axis=1)

    def problem(self) -> Problem:
        """What the engine looks at."""
        every = slice(None) if self.samples is None else self.samples
        sigma = [
            np.broadcast_to(m.chain.sigma, h.residual.shape).ravel()
            for m, h in zip(self.models, self.points)
        ]
        first = np.cumsum([0, *self.chains.counts])
        added, values = self.added()
        sample = [
            np.tile(np.arange(n) + a, len(here.residual))
            for n, a, here in zip(self.chains.counts, first, self.points)
        ]
        return Problem(
            residual=np.concatenate(
                [(w * np.sqrt(a)).ravel() for w, a in zip(self.residuals, self.weights)]
            ),
            basis=self.basis,
            sample=np.concatenate(sample),
            weights=np.concatenate(self.weights),
            sigma=np.concatenate(sigma),
            pose=self.bench.pose[every],
            order=self.bench.order[every],
            covariates={name: column[every] for name, column in self.bench.covariates.items()},
            sites=self.sites(),
            candidates=self.candidates(),
            scans=self.scans(),
            effects=self.effects,
            added=added,
            values=values,
        )

    @cached_property
    def basis(self) -> np.ndarray:
        """(N, R) of the shared parameters, every pose, every ball and free planes, each over its typical size."""
        table = self.fit.parameters
        keys = [key for key, free in zip(table.keys, table.mask) if free and key.count(".") == 1]
        dense = np.zeros((len(keys), sum(root.size for root in self.root)))
        edges = np.cumsum([0, *(root.size for root in self.root)])
        every = zip(self.models, self.tables, self.root, self.shared, edges, edges[1:])
        for model, table, root, steps, a, b in every:
            own = table.only(np.isin(table.keys, keys))
            rows = decorrelated(steps, model.linearise(own)[1]) * root
            place = [keys.index(k) for k, free in zip(own.keys, own.mask) if free]
            dense[place, a:b] = rows.reshape(len(rows), -1) * own.typical[own.mask][:, None]
        families = [self.family(name, family) for name, family in families_of(self.chains).items()]
        return seen_basis(np.concatenate([dense, *families]).T)

    def family(self, name: str, family: Family) -> np.ndarray:
        """(G L, N) whitened columns of a family's groups that have samples."""
        parts, groups = [], len(family.values)
        every = zip(self.names, self.points, self.models, self.root, self.shared)
        for part, here, model, root, steps in every:
            whole = np.zeros((groups, family.length, root.size))
            if _has(part, name):
                rows = decorrelated(steps, here.family_rows(name)) * root
                rows = rows * np.asarray(family.typical)[:, None, None]
                label = np.tile(model.chain.labels[name], len(root))
                whole[label, :, np.arange(root.size)] = rows.reshape(family.length, -1).T
            parts.append(whole.reshape(groups * family.length, -1))
        made = np.concatenate(parts, axis=1)
        return made[np.any(made != 0, axis=1)]

    def port(self, port: str, slots: tuple[int, ...], where: str) -> list:
        """Rows (k, m, n) of each part by the slots of a port, None where the place is no part of it."""
        probe = _At(where, port)
        made = []
        for name, here in zip(self.names, self.points):
            if not acts(probe, name):
                made.append(None)
                continue
            key = name, port, slots
            if key not in self._ports:
                self._ports[key] = here.rows(port, np.asarray(slots))
            made.append(self._ports[key])
        return made

    def candidates(self) -> tuple[Candidate, ...]:
        made = []
        for option in variants(CATALOGUE, self.bench.kind):
            effect = option.effect
            if not self.present(effect):
                continue
            columns, typical = self.columns(effect)
            typical = typical * self.widened(columns * typical)
            made.append(candidate_of(option, columns, typical))
        return tuple(made)

    def added(self) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        """Columns (N, P) and fitted values (P,) of each effect in the model."""
        columns, values = [], []
        for effect in self.effects:
            columns.append(self.columns(effect)[0])
            table = effect.parameters(host(self.models, effect).chain)
            values.append(np.array([self.fit.parameters[p.key] for p in table]))
        return tuple(columns), tuple(values)

    def widened(self, columns: np.ndarray) -> float:
        """By how much typical sizes grow until the best direction of columns (N, P) would be just visible.

        A mirror that turns a few degrees hides nearly all of a wobble: whatever of it can be seen at all is large.
        """
        left = self.cleared(columns)
        best = np.sqrt(max(symmetric_eigenvalues(left.T @ left)[-1], 0.0))
        return float(np.clip(_VISIBLE / max(best, 1e-300), 1.0, WIDEST))

    def cleared(self, columns: np.ndarray) -> np.ndarray:
        """Columns (N, P) without what the baseline makes."""
        return columns - self.basis @ (self.basis.T @ columns)

    def present(self, effect) -> bool:
        """Whether an effect acts on anything here."""
        return any(acts(effect, name) for name in self.names)

    def columns(self, effect: Effect) -> tuple[np.ndarray, np.ndarray]:
        """(N, P) whitened derivative by an effect's parameters at its null, and (P,) typical sizes."""
        parts, chain = [], None
        for name, model, here in zip(self.names, self.models, self.points):
            if not acts(effect, name):
                parts.append(None)
                continue
            chain = model.chain
            rows = here.rows(effect.port, np.asarray(effect.slots(chain)))
            parts.append(np.einsum("pkn,kmn->pmn", effect.basis(chain.state), rows))
        return self.flat(parts).T, np.array([p.typical for p in effect.parameters(chain)])

    def scans(self) -> tuple[Scan, ...]:
        """Effects with one option on a fine grid, as far as the steps of the mirror can show it."""
        if not self.bench.kind.mirror or self.chains.board_stripes is None:
            return ()
        angles = tuple(np.unique(self.chains.board_stripes.angles).tolist())
        every = slice(None) if self.samples is None else self.samples
        made = []
        for grid in grids(CATALOGUE, replace(self.bench.kind, mirror_angles=angles)):
            effect = grid.make(grid.values[0])
            slots = effect.slots(self.chains.board_stripes)
            rows = self.flat(self.port(effect.port, slots, effect.where))
            made.append(scan_of(grid, rows, self.bench.covariates[grid.covariate][every]))
        return tuple(made)

    def sites(self) -> tuple[Site, ...]:
        made = []
        for place in places(self.bench.kind):
            parts = self.port(place.port, place.slots, place.where)
            if any(rows is not None for rows in parts):
                typical = np.full(len(place.slots), place.typical)
                made.append(
                    Site(
                        place.where,
                        place.port,
                        self.flat(parts),
                        place.unit,
                        typical,
                        place.covariates,
                        place.pairs,
                    )
                )
        return tuple(made)


def _shared_errors(name: str, chain, sigma_px: float) -> list[Step]:
    """Factors that make points of stripes independent which are displaced together by `sigma_px` (1 sigma)."""
    if not sigma_px or name == "corners":
        return []
    group = chain.labels["placement" if name == "board_stripes" else "ball"]
    labels = {"placement": group, "step": chain.labels["step"]}
    along = (chain.pixels[::-1] * chain.scan).sum(0)
    together = replace(Together.of(labels, along), sigma=np.array([sigma_px, 0.0, 0.0]))
    return together.steps(np.broadcast_to(chain.sigma, (1, chain.n))[0])


class _At:
    """A place and a port, for `acts`."""

    def __init__(self, where, port):
        self.where, self.port = where, port


def _has(part: str, family: str) -> bool:
    return (
        family
        in {
            "corners": ("placement",),
            "board_stripes": ("placement", "step"),
            "balls": ("ball", "step"),
        }[part]
    )
