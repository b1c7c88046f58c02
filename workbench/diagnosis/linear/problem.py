"""Input of a diagnosis as arrays: residual of a fitted baseline and all candidate explanations.

Robot samples and the sensor chain's own residuals become the same `Problem`; all that follows
(evidence, smooth alternatives, selection, place) knows no robot and no camera. A `Bench` makes problems: it can
put effects into the model, solve it again non-linearly and linearise it there.

Coordinates: a recording of n samples with m measured components has N = m n whitened coordinates,
component by component as `residual.ravel()` of an (m, n) array leaves them; `Problem.sample` says
which sample each belongs to. Everything in a problem is already whitened by the stated sigma and by
the square root of the sample's robust weight.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from robot_model.effects.nonparametric import SmoothFunction, functions
from workbench.core.effect import Effect, Variant
from workbench.core.least_squares.identifiability import OBSERVABLE_SIGMAS
from workbench.core.least_squares.linear_algebra import thin_svd
from workbench.diagnosis.levels import ROUNDING
from workbench.diagnosis.linear.candidates import Candidate, Scan, Site, Source
from workbench.diagnosis.linear.ends import Ends
from workbench.diagnosis.linear.estimates import Instant, Options, RealOption
from workbench.diagnosis.linear.retained_subspace import AddedEffects, RetainedSubspace

BLOCK, POSE_MEANS = "block", "pose means"
"""First word of the names of cached products that depend on the order of the added effects."""


@dataclass(frozen=True)
class Problem:
    """A fitted baseline, linearised. n samples, N coordinates, R the baseline's rank.

    `residual` (N,): whitened, predicted minus measured. `basis` (N, R): orthonormal basis of the
    baseline's Jacobian; `retained`: of the effects that are kept, see `conditional_on`.
    `sample` (N,): which sample each coordinate
    is of. `ends`: the E arm poses that make one sample; rows of places and scans have E N columns, covariates E n
    numbers. `weights` (n,): robust weight of each sample, already in all columns; 0 is a sample left
    out as an outlier. `sigma` (N,): what one whitened unit is, in the coordinate's own unit (mm, rad,
    px); `widened`: by how much it exceeds the stated sigma. `pose` (n,): labels; repeats share one.
    `order` (n,): time or row. `covariates` name -> (n,). `effects`: those in the model in addition to the
    baseline's. `added`, `values`: columns (N, P) and fitted values
    (P,) of each of them, which are not in the basis; `conditional_on` puts them there, or back into the
    residual. `with_masses`: variants of candidates with additional parameters for the masses of the data sheet.
    `growing`: places that are tested only for random effects (the length of a link).
    `given`: whitened sum of squares that elastic laws of the baseline explain beyond its geometry.
    `mass_responses`: of every elastic law, what first moments that are off by one sigma change in its columns;
    `given_values`: (effect, where) -> fitted values (P,) of the elastic laws that the baseline holds.
    `columns_of`: makes the columns (N, P) of an effect at its null, of one that is no candidate; with an effect on
    gravity or masses of C parameters as its second argument their change (C, N, P) per unit of each.
    """

    residual: np.ndarray
    basis: np.ndarray
    sample: np.ndarray
    weights: np.ndarray
    sigma: np.ndarray
    pose: np.ndarray
    order: np.ndarray
    covariates: Mapping[str, np.ndarray]
    sites: tuple[Site, ...]
    candidates: tuple[Candidate, ...]
    scans: tuple[Scan, ...] = ()
    effects: tuple[Effect, ...] = ()
    widened: float = 1.0
    added: tuple[np.ndarray, ...] = ()
    values: tuple[np.ndarray, ...] = ()
    with_masses: tuple[Candidate, ...] = ()
    growing: tuple[Site, ...] = ()
    given: float = 0.0
    mass_responses: tuple[Candidate, ...] = ()
    given_values: Mapping[tuple[str, str], np.ndarray] = field(default_factory=dict)
    precisions: tuple[np.ndarray, ...] = ()  # of the prior of each added parameter, in its own unit
    function_cache: dict = field(
        default_factory=dict, compare=False, repr=False
    )  # functions of the covariates, computed once
    # inner products of the columns of all hypotheses, computed once
    cache: dict = field(default_factory=dict, compare=False, repr=False)
    retained: RetainedSubspace | None = (
        None  # column space of the effects that `conditional_on` retains
    )
    columns_of: Callable[..., np.ndarray] | None = None
    rotation: np.ndarray | None = (
        None  # (N,) True for coordinates of an orientation, in rad; None: there are none
    )
    moments_cost: float = (
        0.0  # log evidence that a set of laws which share first moments pays for these
    )
    serial_effect: float = 1.0  # design effect of noise that is correlated from pose to pose
    ends: Ends = Ends()

    def conditional_on(self, kept: Sequence[int] | None = None) -> "Problem":
        """The problem with some of the effects (None: all) in the basis and the others back in the residual.

        To first order, about the solution with all of them; so each can be questioned without a new solve.
        """
        if not self.added:
            return self
        kept = range(len(self.added)) if kept is None else kept
        contributions = [
            self.added[i] @ self.values[i] for i in range(len(self.added)) if i not in kept
        ]
        return replace(
            self,
            residual=self.residual - sum(contributions) if contributions else self.residual,
            effects=tuple(self.effects[i] for i in kept),
            added=(),
            values=(),
            precisions=(),
            retained=self.added_effects.subspace(kept),
        )

    @property
    def added_effects(self) -> AddedEffects:
        """Inner products of all added effects, computed once."""
        if "added" not in self.cache:
            self.cache["added"] = AddedEffects.of(self)
        return self.cache["added"]

    def reordered(self, order: Sequence[int]) -> "Problem":
        """The problem with its effects in another order; cached inner products with the space of all remain valid."""
        of_columns = (BLOCK, POSE_MEANS)
        cache = {key: value for key, value in self.cache.items() if key[0] not in of_columns}
        if "added" in cache:
            cache["added"] = self.added_effects.reordered(order)
        effects, added, values, precisions = (
            tuple(values_of_effects[i] for i in order) if values_of_effects else ()
            for values_of_effects in (self.effects, self.added, self.values, self.precisions)
        )
        return replace(
            self, effects=effects, added=added, values=values, precisions=precisions, cache=cache
        )

    @cached_property
    def sources(self) -> dict[tuple, Source]:
        """All that is compared with the residual, by `key`."""
        return {
            source.key: source
            for group in (self.candidates, self.with_masses, self.scans, self.sites)
            for source in group
        }

    def functions_of(
        self, names: tuple[str, ...], resolution: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """(V, E n) smooth functions of some covariates at all samples, and their prior sizes (V,); computed once."""
        key = names, resolution
        if key not in self.function_cache:
            values = [self.covariates[name] for name in names]
            made = functions(names, values, _ranges(values), resolution)
            self.function_cache[key] = made
        return self.function_cache[key]

    @property
    def fit_columns(self) -> tuple[np.ndarray, ...]:
        """Baseline's basis (N, R) and, where effects are kept, the columns (N, A) of all that are added."""
        if self.retained is None:
            return (self.basis,)
        return self.basis, self.retained.added.columns

    @property
    def hat_mixing(self) -> np.ndarray:
        """(R + A, P) T: with B = `fit_columns` T, B B' y is the fitted part of y where parameters have their priors.

        Without priors B is orthonormal. A direction that the data hardly determine is shorter than 1.
        """
        if self.retained is None:
            return np.eye(self.basis.shape[1])
        return block_diag(np.eye(self.basis.shape[1]), self.retained.hat_mixing)

    @cached_property
    def information_of_blocks(self) -> dict:
        """What `validation.left_out_blocks` keeps of this problem alone; empty at first."""
        return {}

    def transformed(
        self, white: Callable[[np.ndarray], np.ndarray], weights: np.ndarray | None = None
    ) -> "Problem":
        """The problem with residual, basis and all that is compared with them mapped by `white`, rows (k, N) to (k, N).

        weights (n,): those of the samples, where the map changes them.
        """

        def columns(original: np.ndarray) -> np.ndarray:
            return white(np.ascontiguousarray(original.T)).T

        def candidates(original):
            return tuple(replace(c, columns=columns(c.columns)) for c in original)

        def places(original):
            return tuple(replace(s, rows=self.ends.mapped(white, s.rows)) for s in original)

        def columns_of(effect, cause=None):
            if cause is None:  # a sensor has no causes
                return columns(self.columns_of(effect))
            return np.stack([columns(change) for change in self.columns_of(effect, cause)])

        return replace(
            self,
            residual=white(self.residual),
            basis=np.linalg.qr(columns(self.full_basis))[0],
            weights=self.weights if weights is None else weights,
            added=tuple(map(columns, self.added)),
            sites=places(self.sites),
            growing=places(self.growing),
            scans=places(self.scans),
            candidates=candidates(self.candidates),
            with_masses=candidates(self.with_masses),
            cache={},
            retained=None,
            mass_responses=candidates(self.mass_responses),
            columns_of=columns_of,
        )

    @property
    def sample_covariates(self) -> dict[str, np.ndarray]:
        """Covariates name -> (n,), one number a sample: the mean over its arm poses where it has several."""
        return {name: self.ends.mean(x) for name, x in self.covariates.items()}

    def orthogonal_basis(self, columns: np.ndarray) -> np.ndarray:
        """(N, R) orthonormal basis of the component of columns (N, P) that is orthogonal to the baseline.

        Directions below `ROUNDING` are omitted: a column inside the baseline leaves 1e-13 of its length as rounding.
        """
        length = np.sqrt((columns**2).sum(0))
        unit = columns / np.maximum(length, 1e-300)
        orthogonal_unit = self.orthogonalise(unit)
        u, s, _ = thin_svd(orthogonal_unit)
        directions = u[:, s > ROUNDING]
        cleared = self.orthogonalise(directions)
        return np.linalg.qr(cleared)[0]

    def orthogonalise(self, columns: np.ndarray) -> np.ndarray:
        """(N,) or (N, P) component orthogonal to the baseline and to the retained effects: x - Q Q' x."""
        projection = self.basis @ (self.basis.T @ columns)
        if self.retained is not None and self.retained.mixing.shape[1]:
            added = self.retained.added.columns
            mixing = self.retained.mixing
            conditional = mixing @ (mixing.T @ (added.T @ columns))
            projection += added @ conditional
        return np.subtract(columns, projection, out=projection)

    @property
    def full_basis(self) -> np.ndarray:
        """(N, R) orthonormal basis of the column space of baseline and retained effects."""
        if self.retained is None:
            return self.basis
        return np.hstack([self.basis, self.retained.basis])

    @property
    def rank(self) -> int:
        """Dimension of the column space of baseline and retained effects."""
        added = 0 if self.retained is None else self.retained.mixing.shape[1]
        return self.basis.shape[1] + added

    @property
    def root_weights(self) -> np.ndarray:
        """(N,) roots of the samples' robust weights, by which all columns are multiplied; never 0."""
        return np.sqrt(np.maximum(self.weights, 1e-12))[self.sample]

    @property
    def units(self) -> np.ndarray:
        """(N,) what one whitened unit is where no sample is down-weighted, in the coordinate's own unit."""
        return self.sigma / self.root_weights

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.pose)

    @property
    def degrees(self) -> int:
        """Degrees of freedom of the residual: coordinates in use less the rank of the fit."""
        return int((self.weights[self.sample] > 0).sum()) - self.rank


def observable_basis(columns: np.ndarray) -> np.ndarray:
    """(N, R) orthonormal basis of columns (N, F) in sigmas for a typical size, without unobservable directions."""
    q, r = np.linalg.qr(columns)
    u, s, _ = thin_svd(r)
    largest = s[:1].max(initial=0.0)
    is_observable = s > max(OBSERVABLE_SIGMAS, ROUNDING * largest)
    return q @ u[:, is_observable]


class Bench:
    """Bench: makes linear problems from a robot with samples or from a sensor chain; common part of all benches.

    `baseline`: effects that the baseline already holds; `unit` of a measured point, mm or px; `needs_all_samples`:
    whether a search needs all samples, however many; `bends_with_effects`: whether its baseline follows a large effect
    (camera and board poses of a bundle do), so that it is not linear there; `pose` (n,) labels of repeats; `sigma` (n,)
    noise of each sample, None where all are of one kind; `covariates` name -> (n,); `warnings` on the recording;
    `chain`: that of the arm, None where no arm is measured. `constant_loads`: variants of effects that act all the
    time, and only through what deflects.
    """

    baseline: tuple[Effect, ...] = ()
    unit = "mm"
    needs_all_samples = False
    bends_with_effects = False
    pose: np.ndarray
    sigma: np.ndarray | None = None
    covariates: Mapping[str, np.ndarray]
    warnings: tuple[str, ...] = ()
    chain = None
    constant_loads: tuple[Variant, ...] = ()

    def problem(
        self,
        effects: Sequence[Effect] = (),
        samples: np.ndarray | None = None,
        hypotheses: bool = True,
    ) -> Problem:
        """Baseline and effects solved non-linearly on `samples` (n,) bool (None: all), linearised there.

        hypotheses: with the columns of all candidates; a proof does without.
        """
        raise NotImplementedError

    def solve(self, effects: Sequence[Effect] = (), samples: np.ndarray | None = None) -> tuple:
        """The fit of baseline and effects until it converges; a problem made after it is linear about it."""
        raise NotImplementedError

    def parameters(
        self,
        effects: Sequence[Effect],
        samples: np.ndarray | None = None,
        options: Options | None = None,
    ) -> tuple[dict, ...]:
        """Of every effect's parameters: key, name, where, effect, value, std, unit, typical, size_mm.

        options: of these effects, whose standard deviations those of the parameters contain.
        """
        raise NotImplementedError

    def units(self, effects: Sequence[Effect]) -> list[str]:
        """Units of the parameters of some effects."""
        return [p.unit for effect in effects for p in effect.parameters(self.chain)]

    def reviewed(self, found: "Found", samples: np.ndarray | None) -> "Found":
        """Findings of a search, completed by the statements that are specific to this bench."""
        return found

    def smooth(self, site: Site, names: tuple[str, ...]) -> SmoothFunction:
        """A smooth function of the covariates `names` at a site, as an effect that can join the model."""
        columns = [self.covariates[name] for name in names]
        spans = tuple(_ranges(columns))
        sizes = tuple(site.typical.tolist())
        return SmoothFunction(site.where, site.port, names, spans, site.unit, sizes)


def _ranges(columns: Sequence[np.ndarray]) -> list[tuple[float, float]]:
    """Least and greatest value of each covariate (n,)."""
    return [(float(x.min()), float(x.max())) for x in columns]


@dataclass(frozen=True)
class Alternative:
    """An effect that explains a finding about as well.

    `probability`: its share of the posterior; `alike`: share of the finding's signature that it explains
    in these poses (squared canonical correlation, 0-1); `why`: a short reason; `missing`: the
    covariate that was not recorded and that it would need; `detail`: values that it may have, in words.
    """

    effect: str
    where: str
    label: str
    probability: float
    squared_correlation: float
    why: str
    missing_covariate: str = ""
    detail: str = ""


def likeness_text(likeness: float) -> str:
    """Why an effect is an alternative: its share (0-1) of the signature of a finding."""
    return f"it makes {100 * likeness:.0f} % of the same signature in these poses"


@dataclass(frozen=True)
class Finding:
    """One thing that the baseline does not hold.

    `effect` is "unknown" for a smooth nonparametric alternative; then `depends_on` names its covariates and
    `effects` is empty. `p_value`: valid under the whole search. `probability`: posterior that it is
    this effect at this place, among all laws and smooth alternatives. `size`: RMS over all coordinates of what
    remains of it orthogonal to the baseline, in sigmas. `gain`: fall of the
    whitened sum of squares. `instant`: when it begins, where it begins within the recording. `option`: of its law
    where that is a real number (a frequency, a time constant). `variation`: RMS relative difference of its first
    parameter in the other probable sets of terms.
    """

    effect: str
    where: str
    label: str
    effects: tuple[Effect, ...]
    p_value: float
    probability: float
    size: float
    gain: float
    depends_on: tuple[str, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    alarms: tuple[str, ...] = ()
    instant: Instant | None = None
    option: RealOption | None = None
    variation: float = 0.0


@dataclass(frozen=True)
class Located:
    """Share of the mismatch that a smooth function of some covariate at a place explains.

    `p_value` is family-wise over all places; `depends_on`: the covariate that does it best.
    """

    where: str
    port: str
    depends_on: tuple[str, ...]
    share: float
    p_value: float
    size: float = 0.0


@dataclass(frozen=True)
class Found:
    """Result of `select.find`, in the order of the search.

    `before`, `after`: the problems of the baseline and of the final model. `p_first`: family-wise p-value of a baseline
    without unmodelled effects; `p_remainder`: of a final model without them. `located`: places of the discrepancy
    of the baseline; `remainder`: of the final model. `outliers`: (n,) bool. `noise_findings`: findings on the variance.
    `history`: a line for each step of the search.
    """

    findings: tuple[Finding, ...]
    before: Problem
    after: Problem
    p_first: float
    p_remainder: float
    located: tuple[Located, ...]
    remainder: tuple[Located, ...]
    outliers: np.ndarray
    noise_findings: tuple[Finding, ...] = ()
    history: tuple[str, ...] = field(default_factory=tuple)


def cached(cache: dict, key, make):
    """Result of `make()`, computed once."""
    if key not in cache:
        cache[key] = make()
    return cache[key]
