"""A ball from its points: robust geometric fit with a covariance that the residuals scale.

Points are (3, n) mm. The result states centre and radius without the second-order bias of the noise, their covariance,
the form error of orders two and three, and the reason of every rejected point.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sensors.ball.checks import check_options, problem_of, unit_vectors
from sensors.ball.extent import seen_extent
from sensors.ball.form import UNLIKELY, Form, low_orders, plane_gain, some_of
from sensors.ball.result import EDGE, INCIDENCE, MISSING, OUTLIER, USED, BallFit
from sensors.ball.shared import Shared, solve_shared
from sensors.ball.solve import (
    LOSSES,
    Loss,
    Problem,
    Solved,
    bias,
    covariance,
    memory,
    one_sigma,
    solve,
    step_left,
    used_part,
)
from sensors.ball.start import start as find_start
from workbench.core.text.uncertain import with_std

# At so many of its own sigmas a radius is not distinguishable from a plane's by a first-order covariance.
_KNOWN = 5
# A further step of the fit, in its own sigmas, up to which it has converged.
_SETTLED = 0.1
# Sigmas by which a free radius differs from a true one not once in a thousand times, with the tails of few stripes.
_CHANCE = 4.0
# Part of the radius by which a ball's form may be off, RMS.
_FORM = 0.01
_FLAT = "the cap is too small"
_TOO_FEW = "no ball found: too few points are left within the limits of incidence and edge"


def fit_ball(points: np.ndarray, sigma=None, radius: float | None = None, **options) -> BallFit:
    """Ball through points (3, n) mm in any frame.

    `sigma` 1-sigma mm of a point, one or (n,); `radius` mm where it is known and not fitted.
    Options, all by name:
    `covariance` (3, 3) or (3, 3, n) mm^2 of a point, instead of sigma;
    `direction` (3,) or (3, n): the errors act along these lines with `sigma`;
    `view` (3,) or (3, n): direction in which the sensor looks (the points themselves in the
    camera's frame): what faces away from it cannot have been seen, and is left out;
    `incidence` rad, points of more are left out, and `edge` mm, points nearer to the silhouette; both need `view`;
    `loss` "tukey", "huber" or "linear";
    `groups` (n,) int: errors of points of one group may depend on one another (a stripe, a step);
    `ordered`: the points follow one another along a stripe, and so may their errors; with `shared` they do unless
    it is False;
    `shared` (`Shared`, see `plane_error`): errors of known covariance that groups share, estimated with the ball;
    `at_limit` (n,) True for points at the limit of the field; `start` (4,) centre and radius, where no ball is
    found from there, the fit starts again; `seed` of that start's random draws;
    `form` share of the radius by which a surface may regularly be off and still is a ball's;
    `compare`: where the radius is known, the ball is fitted with a radius of its own too.

    Minimises geometric distances (Gander, Golub & Strebel, BIT 34, 1994), weighted by the variance
    across the surface. Raises InputError where the options are not usable.
    """
    return _fit(points, sigma, radius, **options)


def _fit(
    points,
    sigma,
    radius,
    *,
    covariance=None,
    direction=None,
    view=None,
    incidence=None,
    edge=0.0,
    loss="tukey",
    groups=None,
    ordered=None,
    shared=None,
    at_limit=None,
    start=None,
    seed=0,
    form=_FORM,
    compare=True,
):
    points = np.asarray(points, float)
    full_problem = problem_of(points, sigma, radius, covariance, direction)
    view = unit_vectors(view, points, "view")
    check_options(radius, incidence, edge, loss, view, groups, shared)
    present = (
        np.isfinite(points).all(0) & np.isfinite(full_problem.sigma) & (full_problem.sigma > 0)
    )
    problem = full_problem if present.all() else full_problem.subset(present)
    trim = _Trim(
        None if view is None else view[:, present],
        np.pi / 2 if incidence is None else incidence,
        edge,
    )
    failed = _Failure(present)
    if present.sum() < problem.size + (sigma is None):
        return failed(
            f"{present.sum()} points, fewer than the {problem.size + (sigma is None)} needed"
        )
    shared = None if shared is None else shared.subset(present)
    task = _Task(
        problem,
        LOSSES[loss],
        trim,
        failed,
        present,
        _of(groups, present),
        _ordered(ordered, shared),
        shared,
        _of(at_limit, present),
        form,
        compare,
    )
    if start is not None and (fit := task.fit(np.array(start, float))):
        return fit
    values = find_start(problem.points, radius, np.random.default_rng(seed))
    if values is None:
        return failed(
            "no ball found: the points lie on a line or a plane, or the cap is too small to curve"
        )
    return task.fit(values)


def _ordered(ordered, shared) -> bool:
    return shared is not None if ordered is None else ordered


@dataclass(frozen=True)
class _Task:
    """A problem with all that its fits need; from any start."""

    problem: Problem
    loss: Loss
    trim: "_Trim"
    failed: "_Failure"
    present: np.ndarray
    groups: np.ndarray | None
    ordered: bool
    shared: Shared | None
    at_limit: np.ndarray | None
    form: float
    compare: bool

    def fit(self, values) -> BallFit:
        """From centre and radius `values` (4,)."""
        solved = solve(self.problem, values, self.loss, self.trim)
        if not np.isfinite(solved.spread):
            return self.failed(_TOO_FEW)
        stated_covariance = None
        if self.shared is not None:
            solved, stated_covariance = solve_shared(
                self.problem, solved, self.loss, self.shared, self.ordered
            )
        part = _Part(self.problem, solved, self.loss, self.trim)
        if len(part.part.place) < self.problem.size:
            return self.failed(_TOO_FEW)
        stated_covariance = part.covariance(self.groups, self.ordered, stated_covariance)
        lasting = memory(part.part.score) if self.ordered else 1.0
        shape = part.form(lasting)
        if why := self._refused(part, stated_covariance, shape, lasting):
            return self.failed(why)
        fit = part.result(stated_covariance, self.present, self.at_limit, shape)
        if self.problem.free or not self.compare:
            return fit
        free = replace(self, problem=replace(self.problem, free=True)).fit(solved.values)
        return _compared(fit, free) if free else fit

    def _refused(self, part, stated_covariance, shape, lasting) -> str:
        """Why this is no ball, "" where it is one."""
        radius = part.values[-1]
        radius_std = float(np.sqrt(stated_covariance[-1, -1]))
        gain = part.plane_gain() / lasting
        if gain > (-(_KNOWN**2) if part.step > _SETTLED else _KNOWN**2):
            return f"no ball found: a plane fits the points as well as a ball; {_FLAT}, or another surface"
        if part.step > _SETTLED:
            return (
                f"no ball found: the fit has not converged, a further step would move it by {part.step:.2g} sigma; "
                f"the points are no ball's, or {_FLAT}"
            )
        if self.problem.free and not radius_std * _KNOWN < radius:
            return f"{_FLAT}: radius {with_std(radius, radius_std)} mm; state the radius or scan more of the ball"
        if shape.probability < UNLIKELY and shape.rms > self.form * radius:
            return (
                f"no ball found: the points are {shape.rms:.3g} mm RMS away from any ball in a regular form, more "
                f"than {100 * self.form:g} % of its radius; they lie on another surface"
            )
        return ""


def with_radius_variance(fit: BallFit, variance: float) -> BallFit:
    """The fit whose estimated radius has this variance (mm^2) in addition: errors that the fit does not know.

    With a known radius that is the one in `free`, with which it is compared again.
    """
    if fit.free is not None:
        return compared_with(fit, with_radius_variance(fit.free, variance))
    covariance = fit.covariance.copy()
    covariance[3, 3] += variance
    return replace(fit, covariance=covariance)


def compared_with(fit: BallFit, free: BallFit) -> BallFit:
    """A fit of known radius, compared with another `free` one than before."""
    warning = _radius_warning(fit)
    warnings = tuple(text for text in fit.warnings if text != warning)
    outcome = fit.outcome.removesuffix(f"; {warning}") if warning else fit.outcome
    return _compared(replace(fit, warnings=warnings, outcome=outcome), free)


def _compared(fit: BallFit, free: BallFit) -> BallFit:
    """A fit of known radius, compared with the `free` one."""
    fit = replace(fit, free=free)
    warning = _radius_warning(fit)
    if not warning:
        return fit
    return replace(fit, warnings=(*fit.warnings, warning), outcome=f"{fit.outcome}; {warning}")


def _radius_warning(fit: BallFit) -> str:
    """That the radius of `free` differs from the stated one significantly, "" where it does not."""
    if not abs(fit.radius_gap) > _CHANCE:
        return ""
    return (
        f"radius differs from the stated one by {abs(fit.radius_gap):.3g} sigma ({fit.free.radius:.4f} instead of "
        f"{fit.radius:.4f} mm); with its own the centre moves by {1000 * fit.centre_moves:.3g} um"
    )


def _of(array, chosen):
    return None if array is None else np.asarray(array)[chosen]


@dataclass(frozen=True)
class _Trim:
    """Points that are too steep or too near to the silhouette."""

    view: np.ndarray | None
    incidence: float
    edge: float

    def codes(self, values, normal, part=slice(None)):
        """(n,) reason of each point, 0 where it stays."""
        codes = np.zeros(normal.shape[1], np.uint8)
        if self.view is not None:
            cosine = -np.einsum("dn,dn->n", self.view[:, part], normal)
            codes[cosine < np.cos(self.incidence)] = INCIDENCE
            # the distance of the surface's point from the line of sight through the centre
            codes[values[-1] * (1 - np.sqrt(np.maximum(1 - cosine**2, 0))) < self.edge] = EDGE
        return codes

    def __call__(self, values, normal, part):
        return self.codes(values, normal, part) == USED


class _Failure:
    """Makes the falsy result of points that have no ball."""

    def __init__(self, present):
        self.reason = np.where(present, OUTLIER, MISSING).astype(np.uint8)

    def __call__(self, why: str) -> BallFit:
        unknown = np.full(4, np.nan)
        return BallFit(
            centre=unknown[1:],
            radius=np.nan,
            covariance=np.outer(unknown, unknown),
            bias=unknown,
            sigma_scale=np.nan,
            rms=np.nan,
            residual=np.full(len(self.reason), np.nan),
            reason=self.reason,
            cap=0.0,
            coverage=0.0,
            cut=False,
            ok=False,
            outcome=why,
        )


class _Part:
    """A solved problem, from which the result is put together."""

    def __init__(self, problem: Problem, solved: Solved, loss, trim):
        self.problem, self.values, self.linear, self.trim = (
            problem,
            solved.values,
            solved.linear,
            trim,
        )
        solved = replace(solved, spread=max(solved.spread, 1e-12 * self.values[-1]))
        self.white = solved.white
        self.used, self.part = used_part(problem, solved, loss)
        self.step = step_left(self.part, self.values[-1]) if solved.step is None else solved.step

    @cached_property
    def distance(self) -> np.ndarray:
        """(n,) mm from the surface."""
        if self.problem.direction is None:
            return self.linear.residual
        return (
            np.linalg.norm(self.problem.points - self.values[:-1, None], axis=0) - self.values[-1]
        )

    def plane_gain(self) -> float:
        """See `ball_form.plane_gain`."""
        place = self.part.place
        sigma = one_sigma(self.linear.sigma)
        sigma = sigma.take(place) if np.ndim(sigma) else sigma
        ball = float(np.square(self.distance.take(place) / sigma).sum())
        return plane_gain(
            self.problem.points, ball, self.linear.sigma, self.used, self.problem.direction
        )

    def form(self, lasting: float) -> Form:
        """See `ball_form.low_orders`; of the points' own errors."""
        sample = some_of(self.part.place)
        normal = self.linear.normal[:, sample]
        rows = self.linear.rows[:, sample]
        return low_orders(normal, self.white[sample], self.linear.sigma[sample], rows, lasting)

    def covariance(self, groups, ordered, with_shared_errors):
        """(4, 4) mm^2, of the points' errors where none is given; rows of a known radius are 0."""
        if with_shared_errors is not None:
            estimate = with_shared_errors
        else:
            estimate = covariance(self.part, _of(groups, self.used))
            if ordered and groups is None:
                estimate = estimate * memory(self.part.score)
        return np.pad(estimate, (0, len(self.values) - len(estimate)))

    def result(self, stated_covariance, present, at_limit, shape: Form) -> BallFit:
        """The fit, as statements about all points, `present` (n,) or not."""
        problem = self.problem
        used = self.used
        n = len(present)
        degrees = max(len(self.part.place) - problem.size, 1)
        sigma_scale = float(np.sqrt(self.part.white @ self.part.white / degrees))
        noise_bias = bias(problem, self.linear, self.part, self.values[-1], sigma_scale)
        noise_bias = np.pad(noise_bias, (0, len(self.values) - len(noise_bias)))
        distance = self.distance
        residual = np.full(n, np.nan)
        reason = np.full(n, MISSING, np.uint8)
        codes = self.trim.codes(self.values, self.linear.normal)
        np.copyto(codes, OUTLIER, where=(codes == USED) & ~used)
        present_columns = slice(None) if present.all() else present
        residual[present_columns], reason[present_columns] = distance, codes
        squares = float(np.square(distance.take(self.part.place)).sum())
        cap, coverage = seen_extent(self.linear.normal, self.part.place, self.trim.view)
        cut = 0 if at_limit is None else int((at_limit & used).sum())
        values = self.values - noise_bias
        shape_warnings = _misshapen(shape)
        return BallFit(
            centre=values[:-1],
            radius=float(values[-1]),
            covariance=stated_covariance,
            bias=noise_bias,
            sigma_scale=sigma_scale,
            rms=float(np.sqrt(squares / degrees)),
            residual=residual,
            reason=reason,
            cap=cap,
            coverage=coverage,
            cut=cut > 0,
            ok=True,
            outcome=_outcome(reason, cap, coverage, cut, shape_warnings),
            step=self.step,
            form=shape.rms,
            form_probability=shape.probability,
            warnings=shape_warnings,
        )


def _misshapen(shape: Form) -> tuple[str, ...]:
    if shape.probability >= UNLIKELY:
        return ()
    return (
        f"its points follow a form of {1000 * shape.rms:.2g} um RMS that is not noise: the sigmas do not hold it",
    )


def _outcome(reason, cap, coverage, cut, shape_warnings):
    n = len(reason)
    used = int((reason == USED).sum())
    words = [f"converged on {used} of {n} points, a cap of {np.rad2deg(cap):.0f} deg half angle"]
    if cut:
        words.append(
            f"cut by the field: {cut} of its points lie at the field's limit, so its centre is less certain"
        )
    elif coverage < 0.75:
        words.append(
            f"seen on {100 * coverage:.0f} % of the way round: cut by the field or something stands before it"
        )
    return "; ".join([*words, *shape_warnings])
