"""The bench of a robot with samples: solves baseline and effects, and makes the problem of a diagnosis there."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.effects.curve import JointCurve
from robot_model.effects.elastic import JointCompliance
from robot_model.effects.instrument import sight_covariates
from robot_model.measurements.ball_scan import FILE_KIND
from robot_model.state import State, moved
from robot_model.system import RobotChain, bind
from workbench.core.covariates import clock
from workbench.core.effect import Effect, Variant
from workbench.core.errors import InputError
from workbench.core.least_squares.identifiability import OBSERVABLE_SIGMAS
from workbench.core.least_squares.linear_algebra import covariance_of
from workbench.core.least_squares.solver import Fit, solve
from workbench.core.model import STATE_PORTS, Model
from workbench.core.parameters import Parameters
from workbench.diagnosis.levels import ROUNDING
from workbench.diagnosis.linear.estimates import Options, parameter_row
from workbench.diagnosis.linear.problem import Bench, Problem
from workbench.diagnosis.noise.outliers import robust_weights
from workbench.diagnosis.robot import mass_responses
from workbench.diagnosis.robot.derived import (
    deflection_row,
    mass_rows,
    reflector_rows,
    scale_of_reading,
    spectrum,
    variation_mm,
    with_estimated_options,
    without_shrinkage,
)
from workbench.diagnosis.robot.library import compliances, names, variants
from workbench.diagnosis.robot.linearised import solution, with_candidates, with_places
from workbench.fitting.ball_scans import scans_of
from workbench.fitting.calibration_plans.plans import geometry, stage_mask
from workbench.fitting.checked_samples import check_samples
from workbench.fitting.noise_scale import NOISE_ROUNDS, is_settled, noise_scaled
from workbench.fitting.priors.shrinkage import settled
from workbench.fitting.priors.wider_priors import widened
from workbench.fitting.scan_weights import (
    roots_next_to,
    roots_of,
    with_roots,
)

_FAINT = 1e-4  # knows a parameter to a hundred typical sizes: its variance where the data do not determine it
_GEOMETRY = 1.0
"""Precision in typical sizes (1 mm, 0.01 rad) of geometry that the data do not determine: errors of arms are smaller.

A faint one would let a gauge freedom of base and joints turn the frame in which an effect is stated by radians.
"""
BASELINES = ("geometry", JointCompliance.effect)
_PRIOR_WITH_MASSES = 0.5  # a variant with masses found is half as likely as one that trusts them
_NO_SIGHT_LINES = (
    "The origin of the measured points is among the points or at the robot, so that the place of the instrument is not "
    "known: errors of its angle encoders are not tested. To test them, record the points in the instrument's own frame."
)
_LEAST_POSES = 4
"""Distinct poses without which base and tool are not determined."""
_FEW_STEPS, _STEPS = 6, 50
"""Steps of a solve that estimates the noise or the point about which a problem is linear, and of a complete one.

A problem needs no convergence: the baseline and the effects are projected out of its residual, which is the next step
of Gauss and Newton.
"""
_LARGE = 5000  # samples from which on bases of all candidates are not kept: they take megabytes a thousand
_KEPT = 2  # parts of the samples whose bases are kept: all, and those of the fold that is searched
_SOLUTIONS = (
    8  # solutions of each part that are kept: a term's proof asks for the same few again and again
)


def bench_of(recording, baseline: str = "geometry", trust_data: bool = False) -> "RobotBench":
    """The bench of a robot's recording (its moving rows).

    trust_data: also for a recording that cannot be right. Raises InputError, also for a baseline that is not known.
    """
    if baseline not in BASELINES:
        raise InputError(
            f"option --baseline: expected one of {', '.join(BASELINES)}, found '{baseline}'; choose one"
        )
    checked = check_samples(recording, trust_data)
    moving = checked.recording
    roots = None
    if moving.measures == FILE_KIND:
        moving = scans_of(checked.robot, moving)
        roots = roots_of(moving)
    _check_enough(moving)
    chain = bind(checked.robot, moving)
    chain = replace(chain, state=with_derived(chain, moving.poses))
    effects = ()
    if baseline == JointCompliance.effect:
        effects = tuple(variant.effect for variant in JointCompliance.candidates(chain))
    warnings = (*moving.warnings, *checked.suspicions)
    if chain.places("instrument") and not chain.has_sight_lines:
        warnings = (*warnings, _NO_SIGHT_LINES)
    bench = RobotBench(chain, moving.poses, effects, moving, warnings)
    bench.roots_of_points = roots
    return bench


def _check_enough(moving) -> None:
    """InputError where the number of poses of a recording's samples leaves nothing to diagnose."""
    poses = len(np.unique(moving.poses))
    if poses < _LEAST_POSES:
        raise InputError(
            f"recording '{moving.name}': a diagnosis needs {_LEAST_POSES} or more distinct poses, found {poses} "
            f"among {moving.n} samples; measure more"
        )


def _check_redundancy(problem: Problem, recording) -> None:
    """InputError where the baseline spends every measured number."""
    if problem.degrees < 1:
        raise InputError(
            f"recording '{recording.name if recording else ''}': the baseline spends all {problem.residual.size} "
            f"measured numbers of {len(np.unique(problem.pose))} poses, so that nothing is left from which a missing "
            "effect could be found; measure more poses"
        )


def with_derived(chain: RobotChain, pose: np.ndarray) -> State:
    """The state with covariates that follow from the readings: q, move, tau, payload; pose (n,): labels of repeats.

    Angles rad, slides mm, torques N m. `move<k>` needs the rows in the order in which they were measured.
    """
    recorded = dict(chain.state.covariates)
    drive_angles = chain.state.drive_angles
    derived = {f"q{k}": q for k, q in enumerate(drive_angles, 1)}
    history = None
    if chain.poses_per_sample == 1:  # the two ends of a length have no order
        moves, history = moved(chain.robot, drive_angles, clock(chain.state), pose)
        derived |= moves
    torques = _without_rounding(chain.state.torque)
    moments = _without_rounding(chain.state.moment)
    derived |= {f"tau{k}": torque for k, torque in enumerate(torques, 1)}
    derived["time"] = clock(chain.state)
    attitude = np.einsum("cin,i->cn", chain.state.frames.link[-1], chain.state.gravity)
    derived |= dict(zip(("down_x", "down_y", "down_z"), attitude))
    derived |= dict(zip(("moment_x", "moment_y"), moments[0]))
    for k, moment in enumerate(moments[1:-1], 1):
        derived |= {f"moment{k}_{c}": row for c, row in zip("xyz", moment)}
    derived["payload"] = chain.state.payload
    if chain.measurement.place == "sensor":
        derived |= dict(zip(("seen_x", "seen_y", "seen_z"), chain.state.measured))
    if chain.has_sight_lines:
        derived |= sight_covariates(chain.state.measured)
    return replace(chain.state, covariates=recorded | derived, history=history)


def _without_rounding(vectors: np.ndarray) -> np.ndarray:
    """(..., n) the same with 0 for components that vary by rounding alone: nothing depends on such a covariate."""
    size = np.ptp(vectors, axis=-1, keepdims=True)
    return np.where(size > ROUNDING * np.abs(vectors).max(initial=0.0), vectors, 0.0)


class SlicedBases(dict):
    """Cached bases of `Model.basis` on `samples` (n,) bool: (effect, cause) -> basis there.

    whole: a model of all samples. names: description of an effect -> the effect by which `whole` knows it; shared by
    all parts, whose libraries make equal effects of their own.
    """

    def __init__(self, model: Model, samples: np.ndarray, names: dict[tuple, Effect]):
        super().__init__()
        self._columns = model.chain.columns_of(np.flatnonzero(samples))
        self._whole, self._names = model, names

    def __missing__(self, key: tuple[Effect, Effect | None]) -> np.ndarray:
        basis = self._whole.basis(*map(self._known, key))
        if basis.shape[-1] > 1:
            basis = np.take(basis, self._columns, axis=-1)
        self[key] = basis
        return basis

    def _known(self, effect: Effect | None) -> Effect | None:
        """The effect of the whole model that is equal to one of a part."""
        if effect is None:
            return None
        return self._names.setdefault(describe(effect), effect)


def describe(effect: Effect) -> tuple:
    """Class, place and options of an effect: equal for effects that do the same."""
    return type(effect), effect.where, *map(repr, effect.options.values())


@dataclass(frozen=True)
class _Solution:
    """A fitted model, robust weights (n,), and whether the fit is complete."""

    model: Model
    fit: Fit
    weights: np.ndarray
    is_complete: bool


class _Part:
    """Some of the samples: their chain, and what is made once for them however often they are solved.

    `bases`: of effects, as a model keeps them; `known`: the library by whether something is compliant; `made`:
    functions of its covariates; `solved`: fits by their effects; `last`: values and sigmas of the last fit, where the
    next starts; `names`: as of `SlicedBases`.
    """

    def __init__(self, chain: RobotChain, baseline: tuple[Effect, ...]):
        self.chain, self.baseline, self.bases = chain, baseline, {}
        self.known, self.function_cache, self.solved, self.names = {}, {}, {}, {}
        self.last = None

    def library(self, elastic: bool) -> list[Variant]:
        if elastic not in self.known:
            known = variants(CATALOGUE, self.chain, elastic)
            self.known[elastic] = [
                variant for variant in known if not _is_in_baseline(variant, self.baseline)
            ]
        return self.known[elastic]

    def model(self, effects) -> Model:
        return Model(self.chain, tuple(effects), self.bases)


class RobotBench(Bench):
    """The bench of a chain bound to n samples; `pose` (n,) labels of repeats.

    `roots_of_points`: (n, 3, 3) of scans of balls, whose weights without errors of poses; None of all else.
    """

    roots_of_points: np.ndarray | None = None

    def __init__(
        self,
        chain: RobotChain,
        pose: np.ndarray,
        baseline: tuple[Effect, ...],
        recording=None,
        warnings: tuple[str, ...] = (),
    ):
        self.chain, self.pose, self.baseline, self.recording = chain, pose, baseline, recording
        self.warnings, self.covariates = warnings, chain.state.covariates
        self._parts: dict = {}
        self._start = None

    def __getstate__(self) -> dict:
        """State for another process, without cached solutions."""
        return self.__dict__ | {"_parts": {}}

    def weighed_next_to(self, effects: Sequence[Effect]) -> "RobotBench | None":
        """The bench whose scans have the weights that their residuals with these effects show; None for the same."""
        if self.roots_of_points is None:
            return None
        model, fit, weights = self.solve(effects)
        roots = roots_next_to(model, fit.parameters, self.roots_of_points, weights)
        if np.allclose(roots, self.chain.measurement.root):
            return None
        chain = replace(self.chain, measurement=replace(self.chain.measurement, root=roots))
        recording = with_roots(self.recording, roots)
        bench = RobotBench(chain, self.pose, self.baseline, recording, self.warnings)
        bench.roots_of_points = self.roots_of_points
        return bench

    def problem(
        self,
        effects: Sequence[Effect] = (),
        samples: np.ndarray | None = None,
        hypotheses: bool = True,
    ) -> Problem:
        """Baseline and effects solved on `samples` (n,) bool (None: all), linearised there; see `Bench`."""
        model, fit, weights = self.solve(effects, samples, is_complete=False)
        if samples is None:
            used = np.ones(len(self.pose), bool)
        else:
            used = samples
        part = self._part(samples)
        problem = solution(model, fit, weights, self.pose[used], tuple(effects))
        problem = with_places(problem, model, fit)
        if hypotheses:
            problem = with_candidates(
                problem, model, fit, part.library, (self.with_masses, self.mass_laws)
            )
            if problem.n > _LARGE:
                part.bases.clear()
        if samples is None and not effects:
            _check_redundancy(problem, self.recording)
        if len(fit.residual) > 3:
            rotation = np.repeat(np.arange(len(fit.residual)) >= 3, problem.n)
        else:
            rotation = None
        return replace(problem, function_cache=part.function_cache, rotation=rotation)

    def _part(self, samples) -> _Part:
        """Cached results of some samples; the last few requests are kept."""
        key = _key(samples)
        part = self._parts.pop(key, None)
        if part is None:
            part = _Part(self.chain if samples is None else self.chain.at(samples), self.baseline)
            if samples is not None and len(self.pose) <= min(_LARGE, 2 * samples.sum()):
                all_samples = self._part(None)
                part.bases = SlicedBases(all_samples.model(()), samples, all_samples.names)
        self._parts[key] = part
        if len(self._parts) > _KEPT:
            del self._parts[next(key for key in self._parts if key is not None)]
        return part

    @cached_property
    def with_masses(self) -> tuple[Variant, ...]:
        """Elastic laws that the baseline does not hold, with the masses of links as further unknowns."""
        wanted = names(compliances(CATALOGUE))
        known = [
            variant
            for variant in variants(CATALOGUE, self.chain)
            if variant.effect.effect in wanted and not _is_in_baseline(variant, self.baseline)
        ]
        # a law's few combinations of masses are those of any thousands of poses
        step = int(np.ceil(len(self.pose) / _LARGE))
        state = self.chain.at(np.arange(0, len(self.pose), step)).state
        laws = [(o, mass_responses.with_estimated_masses(o.effect, state)) for o in known]
        return tuple(
            replace(o, effect=law, label=mass_responses.LABEL, prior_weight=_PRIOR_WITH_MASSES)
            for o, law in laws
            if law
        )

    @cached_property
    def mass_laws(self) -> tuple[Variant, ...]:
        """Response of each elastic law to uncertain first mass moments; none without masses."""
        known = [
            variant for variant in variants(CATALOGUE, self.chain) if variant.effect.mass_dependent
        ]
        return tuple(
            replace(o, effect=mass_responses.MassResponse(o.effect.where, o.effect)) for o in known
        )

    @cached_property
    def constant_loads(self) -> tuple[Variant, ...]:
        """Loads and tilts that act all the time through what deflects."""
        known = variants(CATALOGUE, self.chain, elastic=True)
        return tuple(o for o in known if o.effect.needs_compliance and o.effect.port in STATE_PORTS)

    def solve(
        self,
        effects: Sequence[Effect] = (),
        samples: np.ndarray | None = None,
        is_complete: bool = True,
    ):
        """Model on the samples with sigmas widened to what is left unexplained, fit, robust weights (n,).

        is_complete: until it converges; else a few steps, enough to start another solve or to be linear about.
        """
        key = tuple(map(describe, effects))
        part = self._part(samples)
        found = part.solved.get(key)
        if found is None or is_complete and not found.is_complete:
            found = part.solved[key] = self._solve(effects, part, is_complete, found)
        if len(part.solved) > _SOLUTIONS:
            del part.solved[next(old for old in part.solved if old not in ((), key))]
        return found.model, found.fit, found.weights

    def _solve(self, effects, part: "_Part", is_complete: bool, known: "_Solution | None"):
        """The solution, from a known one of the same effects that is not complete, or from the last one."""
        if known is None:
            model, start = self._with_noise(part, effects)
        else:
            model, start = known.model, known.fit.parameters
        steps = _STEPS if is_complete else _FEW_STEPS
        fit = solve(model, start, "huber", steps, with_shares=False)
        if model.shrunk.any():  # each octave of a curve has the prior scale that the data give it
            fit = settled(model, fit, "huber", steps, only=model.shrunk, with_shares=False)
        white = fit.residual / model.sigma(fit.parameters)
        if self._start is None:
            self._start = fit.parameters
        part.last = fit.parameters, model.chain.sigma
        return _Solution(model, fit, robust_weights(white), is_complete or fit.converged)

    def _with_noise(self, part: "_Part", effects) -> tuple[Model, Parameters]:
        """The model with the sigmas that its residuals have, and where its solve starts."""
        model = part.model((*self.baseline, *effects))
        start = self.free(model)
        if part.last is not None:  # the noise, too, may be nearly that of the last solution
            start = start.take_over(part.last[0])
            sigma = part.last[1]
            model = replace(model, chain=replace(model.chain, sigma=sigma))
        # a sigma that is still too large shrinks the effects towards zero, and what they leave keeps it large
        for _ in range(NOISE_ROUNDS):
            fit = solve(model, start, "huber", _FEW_STEPS)
            before = model.chain
            model = replace(model, chain=noise_scaled(model.chain, fit))
            start = widened(model, fit)
            if is_settled(before, model.chain) and start is fit.parameters:
                break
        return model, start

    def free(self, model: Model) -> Parameters:
        """Base, geometry, tool and all that the effects bring, free; from the last solution of the baseline."""
        stage = geometry(model.chain.robot)
        start = model.parameters
        mask = stage_mask(start, stage, (), model.chain)
        mask[len(model.chain.parameters) :] = True
        if self._start is not None:
            start = start.take_over(self._start)
        return start.only(mask)

    def parameters(
        self,
        effects: Sequence[Effect],
        samples: np.ndarray | None = None,
        options: Options | None = None,
    ) -> tuple[dict, ...]:
        """Every effect's parameters with value and std; `size_mm` RMS of what one does to a measured coordinate.

        `acts`: whether one of typical size moves any. The weight deflects no joint about a vertical axis.
        """
        model, fit, weights = self.solve(effects, samples)
        estimates = _estimates(model, fit, weights, options or {})
        masses = mass_rows(model, estimates.values, estimates.covariance)
        rows = []
        first = len(self.baseline)
        for effect, span in zip(model.effects[first:], model.spans[first:]):
            rows += _effect_rows(model, fit, effect, span, estimates, self.chain)
            if span.start in masses:
                rows.append(masses[span.start])
            values = estimates.values[span]
            covariance = estimates.covariance[span, span]
            rows += reflector_rows(effect, values, covariance, self.chain)
            deflected = deflection_row(effect, values, covariance, self.chain)
            if deflected:
                size = variation_mm(model, fit, effect, values)
                rows.append(deflected | {"size_mm": size})
        return tuple(rows)


@dataclass(frozen=True)
class _Estimates:
    """Of all P parameters: `values` (P,) without shrinkage by their priors, `covariance` (P, P), `std` (P,) with the
    uncertainty of stated masses, and `conditional_std` (P,) with options such as frequencies held."""

    values: np.ndarray
    covariance: np.ndarray
    std: np.ndarray
    conditional_std: np.ndarray


def _estimates(model, fit, weights, options: Options) -> _Estimates:
    free, typical = fit.parameters.mask, fit.parameters.typical
    units = np.outer(typical[free], typical[free])
    precision = np.full(len(free), _GEOMETRY)
    for span in model.spans:
        precision[span] = _FAINT
    in_typical_sizes = covariance_of(fit.normal * units, precision[free])
    values = without_shrinkage(model, fit, in_typical_sizes, precision)
    covariance = np.zeros((len(values), len(values)))
    covariance[np.ix_(free, free)] = in_typical_sizes * units * fit.sigma_scale**2
    conditional_std = np.sqrt(np.maximum(np.diag(covariance), 0))
    covariance = with_estimated_options(model, fit, weights, covariance, options)
    by_masses = mass_responses.std_by_masses(model, fit, weights, in_typical_sizes)
    std = np.hypot(np.sqrt(np.maximum(np.diag(covariance), 0)), by_masses)
    return _Estimates(values, covariance, std, conditional_std)


def _effect_rows(
    model, fit, effect: Effect, span: slice, estimates: _Estimates, chain
) -> list[dict]:
    """A row for each parameter of an effect; the first one of a joint curve also has its spectrum."""
    values = estimates.values
    numbers = np.arange(span.start, span.stop)
    alone = fit.parameters.only(np.isin(np.arange(len(values)), numbers))
    sigma = model.sigma(fit.parameters)
    rows = []
    for column, k in zip(model.linearise(alone)[1], numbers):
        p = fit.parameters.table[k]
        row = parameter_row(p, effect, values[k], estimates.std[k], estimates.conditional_std[k])
        size = float(np.sqrt(((column[:3] * values[k]) ** 2).mean()))
        sigmas = p.typical * np.linalg.norm(column / sigma)
        rows.append(row | {"size_mm": size, "acts": bool(sigmas > OBSERVABLE_SIGMAS)})
    if isinstance(effect, JointCurve):
        rows[-effect.terms] |= spectrum(effect, values[span], chain)
        rows[-effect.terms] |= scale_of_reading(model, values, estimates.covariance, effect)
    return rows


def _is_in_baseline(option: Variant, baseline) -> bool:
    """Whether the baseline holds an option's law at its place."""
    return any((e.effect, e.where) == (option.effect.effect, option.effect.where) for e in baseline)


def _key(samples):
    return None if samples is None else samples.tobytes()
