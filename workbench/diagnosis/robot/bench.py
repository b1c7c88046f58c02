"""The bench of a robot with samples: solves baseline and effects, and makes the problem of a diagnosis there."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.effects.curve import JointCurve
from robot_model.effects.elastic import JointCompliance
from robot_model.state import moved
from robot_model.system import RobotChain, bind
from workbench.core.covariates import clock
from workbench.core.effect import Effect, Variant
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import covariance_of, root_between, thin_svd
from workbench.core.least_squares.solver import Fit, solve
from workbench.core.model import NOISE, STATE_PORTS, Model
from workbench.core.parameters import Parameters
from workbench.diagnosis.linear.problem import Candidate, Problem, Site
from workbench.diagnosis.linear.smooth_alternatives import Smooth
from workbench.diagnosis.noise.outliers import robust_weights
from workbench.diagnosis.robot import loose
from workbench.diagnosis.robot.derived import linear_values, mass_rows, spectrum
from workbench.diagnosis.robot.library import compliances, names, variants
from workbench.diagnosis.robot.places import lengths, scans, sites
from workbench.fitting.checked_samples import check_samples
from workbench.fitting.cross_validation import cross_validate
from workbench.fitting.plans import geometry, stage_mask
from workbench.fitting.shrinkage import settled

_FAINT = 1e-4  # knows a parameter to a hundred typical sizes: its variance where the data do not determine it
BASELINES = ("geometry", JointCompliance.effect)
# a direction that moves all measurements together by less than this many sigmas for one typical size of
# the geometry can neither hide nor imitate anything
_SEEN = 1e-2
_PLAUSIBLE = {"mm": 1.0, "rad": 0.01}  # by how much base, tool and links may be off together
_LOOSE_MASS = 0.5  # a variant with masses found is half as likely as one that trusts them
_LEAST_POSES = 4
_STEPS = 50  # of a solve
_KEPT = 4  # parts of the samples whose bases are kept


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
    _check_enough(moving)
    chain = bind(checked.robot, moving)
    chain = replace(
        chain, state=replace(chain.state, covariates=covariates_of(chain, moving.poses))
    )
    effects = ()
    if baseline == JointCompliance.effect:
        effects = tuple(one.effect for one in JointCompliance.candidates(chain))
    return RobotBench(chain, moving.poses, effects, moving, checked.warnings)


def _check_enough(moving) -> None:
    """InputError where the kind or the number of poses of a recording's samples leaves nothing to diagnose."""
    if moving.measures == "distance":
        raise InputError(
            f"recording '{moving.name}', key measures: a diagnosis needs one pose of the arm a sample, "
            "found lengths between two; use `workbench calibrate`, `compare` or `identifiability`"
        )
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


def covariates_of(chain: RobotChain, pose: np.ndarray) -> dict[str, np.ndarray]:
    """Recorded covariates, and what follows from the readings: q, move, tau, payload; pose (n,): labels of repeats.

    Angles rad, slides mm, torques N m. `move<k>` needs the rows in the order in which they were measured.
    """
    recorded = dict(chain.state.covariates)
    made = {f"q{k}": q for k, q in enumerate(chain.variables, 1)}
    made |= moved(chain.robot, chain.variables, clock(chain.state), pose)
    made |= {f"tau{k}": torque for k, torque in enumerate(chain.state.torque, 1)}
    made["time"] = clock(chain.state)
    attitude = np.einsum("cin,i->cn", chain.state.frames.link[-1], chain.state.gravity)
    made |= dict(zip(("down_x", "down_y", "down_z"), attitude))
    made |= dict(zip(("moment_x", "moment_y"), chain.state.moment[0]))
    for k, moment in enumerate(chain.state.moment[1:-1], 1):
        made |= {f"moment{k}_{c}": row for c, row in zip("xyz", moment)}
    made["payload"] = chain.state.payload
    if chain.measurement.place == "sensor":
        made |= dict(zip(("seen_x", "seen_y", "seen_z"), chain.state.measured))
    return recorded | made


class _Part:
    """Some of the samples: their chain, and what is made once for them however often they are solved.

    `bases`: of effects, as a model keeps them; `known`: the library by whether something yields; `made`: functions of
    its covariates; `solved`: fits by their effects.
    """

    def __init__(self, chain: RobotChain, baseline: tuple[Effect, ...]):
        self.chain, self.baseline, self.bases = chain, baseline, {}
        self.known, self.made, self.solved = {}, {}, {}

    def library(self, elastic: bool) -> list[Variant]:
        if elastic not in self.known:
            every = variants(CATALOGUE, self.chain, elastic)
            self.known[elastic] = [one for one in every if not _held(one, self.baseline)]
        return self.known[elastic]

    def model(self, effects) -> Model:
        return Model(self.chain, tuple(effects), self.bases)


class RobotBench:
    """Implements `workbench.diagnosis.linear.problem.Bench` for a chain bound to n samples.

    `pose` (n,) labels of repeats; `baseline` the effects that the baseline holds; `warnings` on the recording.
    """

    unit = "mm"
    whole = False  # a part of many poses finds the same terms
    sigma = None

    def __init__(
        self,
        chain: RobotChain,
        pose: np.ndarray,
        baseline: tuple[Effect, ...],
        recording=None,
        warnings: tuple[str, ...] = (),
    ):
        self.chain, self.pose, self.baseline, self.recording = chain, pose, baseline, recording
        self.warnings = warnings
        self._parts: dict = {}
        self._start = None

    def __getstate__(self) -> dict:
        """What another process needs: not what was solved before."""
        return self.__dict__ | {"_parts": {}}

    def problem(self, effects: Sequence[Effect] = (), samples: np.ndarray | None = None) -> Problem:
        """Baseline and effects solved on `samples` (n,) bool (None: all), linearised there."""
        model, fit, weights = self.solve(effects, samples)
        every = np.ones(self.chain.n, bool) if samples is None else samples
        part = self._part(samples)
        variants = self.loose, self.mass_laws
        made = _problem(
            model, fit, weights, self.pose[every], tuple(effects), variants, part.library
        )
        if samples is None and not effects:
            _check_redundancy(made, self.recording)
        rotation = (
            np.repeat(np.arange(len(fit.residual)) >= 3, made.n) if len(fit.residual) > 3 else None
        )
        return replace(made, made=part.made, rotation=rotation)

    def _part(self, samples) -> _Part:
        """What is kept of some samples, of the last few that were asked for."""
        key = _key(samples)
        made = self._parts.pop(key, None)
        if made is None:
            made = _Part(self.chain if samples is None else self.chain.at(samples), self.baseline)
        self._parts[key] = made
        if len(self._parts) > _KEPT:
            del self._parts[next(key for key in self._parts if key is not None)]
        return made

    @cached_property
    def loose(self) -> tuple[Variant, ...]:
        """Elastic laws that the baseline does not hold, with the masses of links as further unknowns."""
        wanted = names(compliances(CATALOGUE))
        known = [
            one
            for one in variants(CATALOGUE, self.chain)
            if one.effect.effect in wanted and not _held(one, self.baseline)
        ]
        laws = [(o, loose.loosened(o.effect, self.chain.state)) for o in known]
        return tuple(
            replace(o, effect=law, label=loose.LABEL, mass=_LOOSE_MASS) for o, law in laws if law
        )

    @cached_property
    def mass_laws(self) -> tuple[Variant, ...]:
        """What first moments that are only nearly known change in each elastic law; none without masses."""
        known = [one for one in variants(CATALOGUE, self.chain) if one.effect.mass_dependent]
        return tuple(replace(o, effect=loose.MassResponse(o.effect.where, o.effect)) for o in known)

    def solve(self, effects: Sequence[Effect] = (), samples: np.ndarray | None = None):
        """Model on the samples with sigmas widened to what is left unexplained, fit, robust weights (n,)."""
        key = tuple((type(e), e.where, *map(repr, e.options.values())) for e in effects)
        solved = self._part(samples).solved
        if key not in solved:
            solved[key] = self._solve(effects, samples)
        return solved[key]

    def _solve(self, effects, samples):
        model = self._part(samples).model((*self.baseline, *effects))
        chain = model.chain
        free = self.free(model)
        fit = solve(model, free, "huber")
        for _ in range(2):
            widened = _widened(chain, fit)
            model = replace(model, chain=widened)
            fit = solve(model, fit.parameters, "huber")
        if model.shrunk.any():  # each octave of a curve has the prior scale that the data give it
            fit = settled(model, fit, "huber", _STEPS, only=model.shrunk)
        white = fit.residual / model.sigma(fit.parameters)
        if self._start is None:
            self._start = fit.parameters
        return model, fit, robust_weights(white)

    def free(self, model: Model) -> Parameters:
        """Base, geometry, tool and all that the effects bring, free; from the last solution of the baseline."""
        stage = geometry(model.chain.robot)
        start = model.parameters
        mask = stage_mask(start, stage, (), model.chain)
        mask[len(model.chain.parameters) :] = True
        if self._start is not None:
            start = start.take_over(self._start)
        return start.only(mask)

    def held_out(self, effects: Sequence[Effect], folds: np.ndarray) -> np.ndarray:
        """(n,) mm: 3-D error of each sample, predicted from the other folds (n,) int; nan where fold < 0."""
        model, fit, _ = self.solve(effects)
        return np.sqrt(cross_validate(model, fit.parameters, folds, "huber").squares)

    def parameters(
        self, effects: Sequence[Effect], samples: np.ndarray | None = None
    ) -> tuple[dict, ...]:
        """Every effect's parameters with value and std; `size_mm` RMS of what one does to a measured coordinate."""
        model, fit, _ = self.solve(effects, samples)
        typical = fit.parameters.typical[fit.parameters.mask]
        scaled = fit.normal * np.outer(typical, typical)
        covariance = covariance_of(scaled, np.full(len(typical), _FAINT)) * np.outer(
            typical, typical
        )
        covariance *= fit.sigma_scale**2
        whole = np.zeros((len(fit.parameters),) * 2)
        whole[np.ix_(fit.parameters.mask, fit.parameters.mask)] = covariance
        std = np.sqrt(np.maximum(np.diag(whole), 0))
        masses = mass_rows(model, fit.parameters.values, whole)
        rows = []
        first = len(self.baseline)
        for effect, span in zip(model.effects[first:], model.spans[first:]):
            own = np.isin(np.arange(len(std)), range(span.start, span.stop))
            columns = model.linearise(fit.parameters.only(own))[1]
            for row, k in zip(columns, range(span.start, span.stop)):
                p, value = fit.parameters.table[k], float(fit.parameters.values[k])
                rows.append(
                    {
                        "key": p.key,
                        "name": p.key.rpartition(".")[2],
                        "where": effect.where,
                        "label": p.label,
                        "effect": effect.effect,
                        "value": value,
                        "std": float(std[k]),
                        "unit": p.unit,
                        "typical": p.typical,
                        "size_mm": float(np.sqrt(((row[:3] * value) ** 2).mean())),
                    }
                )
            if span.start in masses:
                rows.append(masses[span.start])
            if isinstance(effect, JointCurve):
                rows[-effect.terms] |= spectrum(effect, fit.parameters.values[span], self.chain)
        return tuple(rows)

    def units(self, effects: Sequence[Effect]) -> list[str]:
        """Units of the parameters of some effects."""
        return [p.unit for effect in effects for p in effect.parameters(self.chain)]

    def reviewed(self, found, samples: np.ndarray | None):
        """What a search found, as it is."""
        return found

    def smooth(self, site: Site, names: tuple[str, ...]) -> Effect:
        """A smooth function of the covariates at a site, as an effect that can join the model."""
        held = [self.chain.state.covariates[name] for name in names]
        spans = [(float(x.min()), float(x.max())) for x in held]
        return Smooth(
            site.where,
            site.port,
            names,
            tuple(spans),
            site.unit,
            tuple(site.typical.tolist()),
            site.sharp,
        )


def _held(option: Variant, baseline) -> bool:
    """Whether the baseline holds an option's law at its place."""
    return any((e.effect, e.where) == (option.effect.effect, option.effect.where) for e in baseline)


def _key(samples):
    return None if samples is None else samples.tobytes()


def _widened(chain: RobotChain, fit: Fit) -> RobotChain:
    """Sigmas widened by one variance until robustly weighted residuals agree (Paule & Mandel 1982)."""
    stated = 0 * chain.stated_sigma if chain.sigma_unknown else chain.stated_sigma
    widened = chain.sigma.copy()
    spent = fit.residual.size / fit.degrees
    weights = fit.weights / fit.weights.mean()
    for rows in (slice(0, 3), slice(3, 6)):
        squares = fit.residual[rows] ** 2 * weights * spent
        if squares.size:
            widened[rows] = np.sqrt(stated[rows] ** 2 + _extra(squares, stated[rows]))
    return replace(chain, sigma=widened)


def _extra(squares, sigma):
    """The variance v, at least 0, with mean(squares / (sigma^2 + v)) = 1; floor: a nanometre."""

    def excess(v):
        return float((squares / (sigma**2 + v)).mean() - 1)

    high, least = 2 * float(squares.mean()) + 1e-12, 1e-12
    return root_between(excess, least, high) if excess(least) > 0 else least * (not sigma.any())


def _problem(model: Model, fit: Fit, weights, pose, effects, variants, library) -> Problem:
    evaluation = model.evaluate(fit.parameters)
    sigma = np.broadcast_to(model.sigma(fit.parameters), fit.residual.shape)
    white = np.sqrt(weights) / sigma
    rows = _Rows(model, evaluation, white)
    first = len(model.effects) - len(effects)
    bare = replace(model, effects=model.effects[:first])
    added = tuple(_derivative(model, fit, white, span) for span in model.spans[first:])
    state = model.chain.state
    elastic = any(effect.elastic for effect in model.effects)
    return Problem(
        (evaluation.residual * white).ravel(),
        _baseline(bare, fit, white),
        np.tile(np.arange(model.chain.n), len(sigma)),
        weights,
        sigma.ravel().copy(),
        pose,
        clock(state),
        {k: v for k, v in state.covariates.items() if k != "row"},
        sites(model.chain, rows),
        _candidates(model, fit, rows, white, library(elastic)),
        scans(model.chain, rows),
        effects,
        float(np.median(sigma / model.chain.stated_sigma)),
        added,
        tuple(
            linear_values(effect, fit.parameters.values[span], columns, state, rows, model.chain)
            for effect, span, columns in zip(model.effects[first:], model.spans[first:], added)
        ),
        _candidates(model, fit, rows, white, variants[0]),
        lengths(model.chain, rows),
        _given(bare, fit, white),
        _candidates(model, fit, rows, white, variants[1]),
        {
            (e.effect, e.where): fit.parameters.values[span]
            for e, span in zip(bare.effects, bare.spans)
            if e.elastic
        },
        tuple(fit.parameters.precision[span] for span in model.spans[first:]),
    )


def _baseline(model: Model, fit: Fit, white) -> np.ndarray:
    """(N, R) basis of what the baseline can make, with no effect but its own in the model.

    An effect at work lifts degeneracies of the geometry by its own small size: directions in which
    the arm could only move by centimetres to hide a micrometre, which no prior allows.
    """
    start = model.parameters.take_over(fit.parameters)
    own = start.only(start.mask & ~_noise(model))
    sizes = np.array([min(p.typical, _PLAUSIBLE.get(p.unit, np.inf)) for p in own.table])[own.mask]
    jacobian = (model.linearise(own)[1] * white).reshape(len(sizes), -1)
    return _basis(jacobian.T * sizes)


def _given(bare: Model, fit: Fit, white) -> float:
    """Whitened sum of squares of what the baseline's elastic laws make and its geometry does not."""
    own = [
        span
        for effect, span in zip(bare.effects, bare.spans)
        if effect.elastic and effect.port not in STATE_PORTS
    ]
    if not own:
        return 0.0
    made = sum(_derivative(bare, fit, white, span) @ fit.parameters.values[span] for span in own)
    plain = _baseline(replace(bare, effects=()), fit, white)
    return float(((made - plain @ (plain.T @ made)) ** 2).sum())


def _derivative(model, fit, white, span):
    """(N, P) whitened derivative of the residual by the parameters of a span."""
    own = np.isin(np.arange(len(model.parameters)), range(span.start, span.stop))
    start = model.parameters.take_over(fit.parameters)
    return (model.linearise(start.only(own))[1] * white).reshape(own.sum(), -1).T


def _noise(model):
    mask = np.zeros(len(model.parameters), bool)
    for effect, span in zip(model.effects, model.spans):
        mask[span] = effect.port == NOISE
    return mask


def _basis(columns: np.ndarray) -> np.ndarray:
    """(N, R) orthonormal basis of columns (N, F) in sigmas for a typical size; directions unseen are left out."""
    q, r = np.linalg.qr(columns)
    u, s, _ = thin_svd(r)
    return q @ u[:, s > max(_SEEN, 1e-11 * s[:1].max(initial=0.0))]


class _Rows:
    """Whitened derivatives of the residual by the slots of a port, made once a port."""

    def __init__(self, model, evaluation, white):
        joints = model.chain.robot.joints
        sizes = {
            "joint": joints,
            "frame": 6 * (joints + 2),
            "geometry": 5 * joints,
            "target": 3,
            "sensor": 3,
        }
        self._made, self._sizes, self._evaluation, self._white = {}, sizes, evaluation, white

    def __call__(self, port, slots):
        """(k, m, n)."""
        if port not in self._made:
            made = self._evaluation.rows(port, np.arange(self._sizes[port]))
            self._made[port] = made * self._white
        return self._made[port][np.asarray(slots)]


def _candidates(model: Model, fit: Fit, rows: _Rows, white, library) -> tuple[Candidate, ...]:
    made = []
    for option in library:
        effect = option.effect
        columns = _columns(model, fit, rows, white, effect)
        typical = np.array([p.typical for p in effect.parameters(model.chain)])
        kind = effect.coexists, effect.nonnegative
        load = _load(model, effect) if effect.elastic and effect.nonnegative else 0.0
        made.append(
            Candidate(
                effect.effect,
                effect.where,
                option.label,
                (effect,),
                columns,
                typical,
                option.family,
                option.mass,
                option.missing,
                *kind,
                load,
            )
        )
    return tuple(made)


def _load(model: Model, effect: Effect) -> float:
    """RMS over the samples of the torque or moment (N m) that an elastic law's first parameter multiplies."""
    return float(np.sqrt((model.basis(effect)[0] ** 2).sum(0).mean()))


def _columns(model, fit, rows, white, effect):
    """(N, P) whitened derivative of the residual by an effect's parameters at its null."""
    if effect.port in STATE_PORTS:
        present = tuple(
            e for e in model.effects if (type(e), e.where) != (type(effect), effect.where)
        )
        wider = replace(model, effects=(*present, effect))
        start = wider.parameters.take_over(fit.parameters)
        own = np.arange(len(start)) >= wider.spans[-1].start
        derivative = wider.linearise(start.only(own))[1] * white
    else:
        basis = model.basis(effect)
        derivative = np.einsum("pkn,kmn->pmn", basis, rows(effect.port, effect.slots(model.chain)))
    return derivative.reshape(len(derivative), -1).T
