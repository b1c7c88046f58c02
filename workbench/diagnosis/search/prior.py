"""Prior of sets of terms, and what is known of elastic terms: their sizes, and the masses that deflect them.

A robot whose parts deflect under gravity seldom deflects at one place alone: once one elastic term is in a set, each
further one is likely (`Effect.compliance_prior`). Its size follows the robot's: joints of industrial arms have 5 to 50
times the compliance of the link behind them, and parts that carry more are stiffer (Dumas et al., Robot.
Comput.-Integr. Manuf. 27 (2011) 881; Abele et al., CIRP Ann. 56 (2007) 387; Klimchik et al., Mech. Mach. Theory 107
(2017)). The scale common
to a robot is the one at which all its joints together have the highest marginal likelihood.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from robot_model.effects import CATALOGUE
from robot_model.effects.elastic import JointCompliance
from robot_model.effects.transmission import TransmissionHarmonic
from robot_model.effects.unknown_masses import TYPICAL_RAD, GravityCompliance
from workbench.core.least_squares.linear_algebra import pseudo_inverse, symmetric_eigen
from workbench.diagnosis.levels import ROUNDING, SIGNIFICANT_SIGMAS
from workbench.diagnosis.linear.candidates import Candidate, Scan
from workbench.diagnosis.linear.evidence import Projected, log_evidence_by_size
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.linear.problem import Problem
from workbench.diagnosis.search.common_orders import LOG_ODDS_OF_COMMON, is_curve, order_group

CURVE = -1.0
"""In the place of an order: the error curve of a joint."""
SECOND = float(np.log(0.2))
"""Log prior odds of one more term, in addition to its own prior."""
DEFLECTS = tuple({kind.effect for kind in CATALOGUE.values() if kind.compliance_prior})
_SCALES = np.geomspace(1e-7, 1e-2, 31)
"""Compliances of a joint under 1 N m, rad/(N m), of which the most probable is the robot's."""
_SIZE_BY_LOAD = -0.5
"""Exponent of the load (N m) that compliances scale with: stronger gears are stiffer, yet deflect more."""
_MOST_OF_USUAL = 3.0
"""Compliance of a joint over the usual one of its robot, both for the same load, that is plausible at most.

Any first harmonic of a joint that carries next to nothing looks like a large compliance. The joints with load say what
is usual.
"""
LAW_ERROR = 0.01
"""Relative error of every law that is computed: joint angles are off by tenths of a degree, lengths by a millimetre."""


@dataclass(frozen=True)
class Priors:
    """Of K terms: `log_prior` (K,), `elastic` (K,), and `log_odds` (K,) of the elastic ones where something deflects.

    `deflects`: log prior that something does, in addition to the odds of what; so that all sets of one elastic term
    together are as likely as their families of candidates.
    `scale` (K,): prior size over the typical one; `positive` (K,): how many first coefficients cannot be negative;
    `reference`: (effect, where, compliance) of all joints, at their maximum; `joints` (N, J): their contributions to
    the measurements, the baseline projected out; `residual` (N,): residual of the other accepted laws, if known.
    `order` (K,): as of `order_group`, `CURVE` of error curves, with the places `where` (K,).
    """

    log_prior: np.ndarray
    log_odds: np.ndarray
    elastic: np.ndarray
    scale: np.ndarray
    positive: np.ndarray
    order: np.ndarray
    where: np.ndarray
    deflects: float = 0.0
    reference: tuple[tuple[str, str, float], ...] = ()
    joints: np.ndarray | None = None
    residual: np.ndarray | None = None

    @property
    def is_usual(self) -> np.ndarray:
        """(K,) bool: at least as likely as not where something deflects, as the compliance of a joint."""
        return self.elastic & (self.log_odds >= 0)

    def of(self, members: Sequence[int]) -> float:
        """Log prior of a set; the set of no term has 0."""
        members = list(members)
        if not members:
            return 0.0
        of_terms = np.where(self.elastic, self.log_odds, self.log_prior)[members]
        first = self.deflects if self.elastic[members].any() else 0.0
        common = self._common_orders(members)
        return float(of_terms.sum()) + first + common + (len(members) - 1) * SECOND

    def _common_orders(self, members: Sequence[int]) -> float:
        """What terms gain by having the order of others at other joints, in log prior odds.

        The order itself has the highest prior of these joints once; see `is_curve` for joints with an error curve.
        """
        harmonics = [i for i in members if self.order[i] > 0]
        if len(harmonics) < 2:
            return 0.0
        with_curve = {self.where[i] for i in members if self.order[i] == CURVE}
        priors: dict[float, dict[str, float]] = {}
        for i in harmonics:
            if self.where[i] not in with_curve:
                joints = priors.setdefault(self.order[i], {})
                joints.setdefault(self.where[i], float(self.log_prior[i]))
        return sum(_gain_of_common(list(joints.values())) for joints in priors.values())

    def select_terms(self, rows: np.ndarray) -> "Priors":
        """Of some of the terms, by their numbers (k,)."""
        names = ("log_prior", "log_odds", "elastic", "scale", "positive", "order", "where")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def conditional(self, members: Sequence[int]) -> np.ndarray:
        """(K,) log prior odds of each term conditional on a set."""
        first = 0.0 if self.elastic[list(members)].any() else self.deflects
        step = np.where(self.elastic, self.log_odds + first, self.log_prior)
        step = step + self._further_common_orders(list(members))
        return step + SECOND if len(members) else step

    def _further_common_orders(self, members: list[int]) -> np.ndarray:
        """(K,) change of `_common_orders` of a set by each further term."""
        change = np.zeros(len(self.order))
        if (self.order[members] > 0).any():
            present = self._common_orders(members)
            for number in np.flatnonzero(np.isfinite(self.order)):
                change[number] = self._common_orders([*members, int(number)]) - present
        return change


def _gain_of_common(log_priors: Sequence[float]) -> float:
    """What harmonics of one order at several joints gain in log prior odds; log_priors: of each alone."""
    further = sorted(log_priors)[:-1]
    return sum(max(LOG_ODDS_OF_COMMON - prior, 0.0) for prior in further)


def elastic_prior(
    problem: Problem,
    projected: Projected,
    terms: Sequence[Hypothesis],
    others: np.ndarray | None = None,
) -> Priors:
    """The priors of some terms in a problem that keeps none of them.

    others (N, P): columns of accepted laws that are not elastic. The robot's compliance is estimated conditional on
    these: what they make would else make it far too large, or with the opposite sign zero.
    """
    known = [h.effects[0].compliance_prior if h.effects else None for h in terms]
    elastic = np.array([prior is not None for prior in known])
    log_prior = np.array([h.log_prior for h in terms])
    positive = np.array([h.source.positive for h in terms], int)
    robot = _ComplianceScale.of(problem, projected, others)
    log_odds = log_prior.copy()
    scale = np.ones(len(terms))
    for i in np.flatnonzero(elastic):
        chance, relative = known[i]
        source = terms[i].source
        log_odds[i] = np.log(chance / (1 - chance)) + np.log(source.prior_weight)
        if terms[i].effects[0].estimates_moments and not source.load:
            scale[i] = relative * TYPICAL_RAD / float(source.typical[0])
        elif robot is not None:
            scale[i] = relative * robot.size(source.load) / float(source.typical[0])
    if elastic.any():
        all_elastic = logsumexp(log_prior[elastic])
        deflects = float(all_elastic - logsumexp(log_odds[elastic]))
    else:
        deflects = 0.0
    deflects -= problem.moments_cost
    order = np.array([CURVE if is_curve(h) else order_group(h) for h in terms])
    where = np.array([h.where for h in terms])
    priors = Priors(log_prior, log_odds, elastic, scale, positive, order, where, deflects)
    if robot is None:
        return priors
    of_joints = {name: getattr(robot, name) for name in ("reference", "joints", "residual")}
    return replace(priors, **of_joints)


@dataclass(frozen=True)
class _ComplianceScale:
    """`common`: compliance of a joint under 1 N m (rad/(N m)); `reference`, `joints`, `residual` as of `Priors`."""

    common: float
    reference: tuple
    joints: np.ndarray
    residual: np.ndarray

    @classmethod
    def of(
        cls, problem: Problem, projected: Projected, others: np.ndarray | None
    ) -> "_ComplianceScale | None":
        """From all joints of a robot together, conditional on the columns `others` (N, P); None: nothing deflects."""
        joints = [
            c for c in problem.candidates if c.effect == JointCompliance.effect and c.load > 0
        ]
        if not joints:
            return None
        sizes = np.array([c.load**_SIZE_BY_LOAD for c in joints])
        orthogonal = problem.orthogonalise(
            np.concatenate([c.columns[:, :1] for c in joints], 1) * sizes
        )
        residual = _Residual.of(problem, projected, others)
        cleared = residual.orthogonalise(orthogonal)
        matrix = cleared.T @ cleared / projected.design_effect
        values, vectors = symmetric_eigen(matrix)
        values = np.maximum(values, 0.0)
        projections = vectors.T @ (cleared.T @ residual.y) / projected.design_effect
        spread = _SCALES[:, None] ** 2
        log_determinant = np.log1p(spread * values).sum(1)
        gain = (projections**2 * spread / (1 + spread * values)).sum(1)
        best = int(np.argmax(log_evidence_by_size(log_determinant, gain, residual)))
        inverse = 1 / (values + _SCALES[best] ** -2)
        found = np.maximum(-vectors @ (projections * inverse), 0.0)
        variance = max(residual.yy - gain[best], 0.0) / residual.degrees
        std = np.sqrt(variance * (vectors**2 @ inverse))
        load = np.array([c.load for c in joints])
        inliers = _median_compliance(found, std, load)
        if inliers > 0:
            max_size = _MOST_OF_USUAL * inliers
        else:
            max_size = float(_SCALES[best])
        reference = []
        for candidate, value, size in zip(joints, np.minimum(found, max_size), sizes):
            reference.append((candidate.effect, candidate.where, float(value * size)))
        return cls(min(float(_SCALES[best]), max_size), tuple(reference), orthogonal, residual.y)

    def size(self, load: float) -> float:
        """Prior size of the compliance of a joint under a load (N m), rad/(N m)."""
        return self.common * max(load, 1e-3) ** _SIZE_BY_LOAD


@dataclass(frozen=True)
class _Residual:
    """Residual `y` (N,) orthogonal to an orthonormal `basis` (N, R), its `yy` and `degrees`, as of `Projected`."""

    basis: np.ndarray
    y: np.ndarray
    yy: float
    degrees: float

    @classmethod
    def of(cls, problem: Problem, projected: Projected, columns: np.ndarray | None) -> "_Residual":
        """Of the columns (N, P) that are fitted as well; None: none."""
        if columns is None or not columns.shape[1]:
            none = np.zeros((len(projected.y), 0))
            return cls(none, projected.y, projected.yy, projected.degrees)
        basis = problem.orthogonal_basis(columns)
        y = projected.y - basis @ (basis.T @ projected.y)
        effect = projected.design_effect
        degrees = max(projected.degrees - basis.shape[1] / effect, 1.0)
        return cls(basis, y, float(y @ y) / effect, degrees)

    def orthogonalise(self, columns: np.ndarray) -> np.ndarray:
        """(N, P) columns without what the basis makes of them."""
        return columns - self.basis @ (self.basis.T @ columns)


def _median_compliance(found: np.ndarray, std: np.ndarray, load: np.ndarray) -> float:
    """Weighted median of compliances (K,) with standard deviations (K,) and loads (K,) as weights; 0 where none is
    significant.

    A compliance that is not significant counts as zero. Where that makes the median zero, the weighted mean takes its
    place: a joint with next to no load has next to no share in it.
    """
    deflecting = np.where(found > SIGNIFICANT_SIGMAS * std, found, 0.0)
    median = _weighted_median(deflecting, load)
    if median > 0:
        return median
    return float(deflecting @ load / load.sum())


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    """The value (K,) up to which half of the weight (K,) lies."""
    order = np.argsort(values)
    cumulated = np.cumsum(weights[order])
    reached = cumulated >= 0.5 * weights.sum()
    middle = int(np.argmax(reached))
    return float(values[order][middle])


@dataclass(frozen=True)
class MassUncertainty:
    """Responses to a change of each first mass moment by one standard deviation: columns (N, M), cleared.

    `basis` (N, R): of the baseline.
    """

    columns: np.ndarray
    basis: np.ndarray
    design_effect: float

    @classmethod
    def of(cls, problem: Problem, projected: Projected, priors: Priors) -> "MassUncertainty":
        """Of the deflection that the baseline holds, and of that of all joints at their most probable."""
        responses = {(c.effect, c.where): c.columns for c in problem.mass_responses}
        known = [(key, values) for key, values in problem.given_values.items()]
        known += [((effect, where), np.array([value])) for effect, where, value in priors.reference]
        total = np.zeros((len(problem.sample), 0))
        for key, values in known:
            if key not in responses or responses[key].shape[1] % len(values):
                continue
            response = responses[key].reshape(len(total), len(values), -1)
            change = np.einsum("npm,p->nm", response, values)
            if total.shape[1] != change.shape[1]:
                total = change
            else:
                total = total + change
        return cls(problem.orthogonalise(total), problem.full_basis, projected.design_effect)

    def marginalised(
        self, columns: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Inner products (T, T), scores (T,) and y'y of columns (N, T), S^-1 between them (Woodbury).

        The baseline is projected out: of the columns by way of what it makes of them, as y (N,) is free of it.
        """
        by_masses = self._half.T @ columns
        by_baseline = self.basis.T @ columns
        y_by_masses = self._half.T @ y
        projections = np.concatenate([by_masses, by_baseline])
        gram = columns.T @ columns - projections.T @ projections
        score = columns.T @ y - by_masses.T @ y_by_masses
        return gram, score, float(y @ y - y_by_masses @ y_by_masses)

    def law_error(self, priors: Priors) -> float:
        """Sum of squares that errors of the elastic laws leave: a share of what all joints explain."""
        if priors.joints is None or priors.residual is None:
            return 0.0
        gram, score, _ = self.marginalised(priors.joints, priors.residual)
        return LAW_ERROR**2 * float(score @ pseudo_inverse(gram, ROUNDING) @ score)

    @cached_property
    def _half(self) -> np.ndarray:
        """(N, M) H with S^-1 = I - H H'."""
        inner = self.columns.T @ self.columns / self.design_effect
        values, vectors = symmetric_eigen(inner)
        scale = np.sqrt(self.design_effect * (1 + np.maximum(values, 0.0)))
        return self.columns @ (vectors / scale)


def may_be_elastic(law: Candidate | Scan) -> bool:
    """Whether some variant of a law is elastic, as of `is_elastic`."""
    return law.effect in (*DEFLECTS, GravityCompliance.effect, TransmissionHarmonic.effect)


def is_elastic(h: Hypothesis) -> bool:
    """Whether a term deflects under gravity, or is the harmonic that is most like it."""
    if h.smooth_covariates:
        return False
    order = getattr(h.effects[0], "order", None) if h.effects else None
    deflects = h.effect in (*DEFLECTS, GravityCompliance.effect)
    return deflects or (h.effect == TransmissionHarmonic.effect and order == 1.0)
