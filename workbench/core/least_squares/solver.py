"""Whitened, damped least squares (Levenberg-Marquardt) for a model and its free parameters."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from workbench.core.least_squares.linear_algebra import all_finite, covariance_of, solve_positive
from workbench.core.least_squares.noise import fit_noise, information, noise_mask
from workbench.core.model import Model
from workbench.core.parameters import Parameters

CONVERGED = "converged: another step would move nothing by more than a hundredth of its sigma"
SETTLED = (
    "converged: the last step lowered chi-square by less than 0.02, or a hundred-thousandth of it"
)
STALLED = "converged to rounding: no step lowers the cost any further"
OUT_OF_STEPS = (
    "did not converge: the cost was still falling at the last step; allow more steps, check units "
    "and the nominal robot, or fix parameters that are undetermined"
)
NOT_FINITE = (
    "did not converge: the model or its derivative is not finite; check the recording for impossible "
    "joint angles and the robot's geometry"
)
# A step is damped by at least this much per squared typical size: it keeps null directions still,
# and slows only directions that the data know a hundred times less than one knew before measuring.
_FLOOR = 1e-4
# Squared sigmas that a step moves: below the first it need not be taken, and after one below the
# second the next would be far below the first, since the steps shrink quadratically.
_DONE, _NEARLY = 1e-4, 1e-2
_LEAST_FACTOR = 1 / 8
"""Of the damping after a step that lowers the cost as predicted."""
_STRAIGHT = 10
"""Steps of a solve before damped ones follow the curvature of the residual."""
_CURVED_DAMPING, _LEAST_CURVED, _LEAST_CURVED_FACTOR = 1e-3, 1e-6, 1 / 3
"""Damping of such steps, of each parameter's own information: the first, the least but none, and its least factor."""
_PROBE = 0.1
"""Part of a step over which the curvature of the residual is measured."""
_MOST_BEND = 0.75
"""Twice the acceleration over the step, above which the second-order path is not to be trusted."""
_NOISE_ROUNDS = 3
# Times the stated sigma: a residual of this size is rounding, and its square may be zero in floating point.
_NO_RESIDUAL = 1e-100
# Relative difference between ratios of sigmas that is rounding.
_SAME_RATIO = 1e-9


@dataclass(frozen=True)
class Fit:
    """Result of a least-squares fit.

    Attributes:
        parameters: At the minimum, with the free mask of the solve (F parameters free).
        residual: (m, n) predicted minus measured, in the units of the measurement (mm, rad).
        weights: (n,) of the robust loss, 1 where there is none.
        normal: (F, F) whitened normal matrix of the data, in the units of the free parameters.
        sigma_scale: Factor of the stated sigmas with which they agree with the residuals.
        history: Cost after each step.
        outcome: Why the solve ended, as a sentence.
        degrees: Degrees of freedom of the residual.
        gradient: (F,) of half the whitened sum of squares at `parameters`, in the units of the free parameters; None
            with a robust loss and where `normal` has other sigmas.
        shares: (m,) share of its residuals that each component keeps as degrees of freedom, where poses are measured
            (m > 3), the solve still has the derivative and was asked for them; else None.

    Examples:
        >>> from workbench.core.parameters import Parameter
        >>> parameters = wb.Parameters.of([Parameter("tool.x", "mm")]).free("*")
        >>> residual = np.zeros((3, 10))
        >>> fit = wb.Fit(parameters, residual, np.ones(10), normal=np.eye(1), sigma_scale=1.0)
        >>> fit.converged
        True
    """

    parameters: Parameters
    residual: np.ndarray
    weights: np.ndarray
    normal: np.ndarray
    sigma_scale: float
    history: tuple[float, ...] = field(default_factory=tuple)
    outcome: str = CONVERGED
    degrees: float = 1.0
    gradient: np.ndarray | None = None
    shares: np.ndarray | None = None

    @property
    def converged(self) -> bool:
        """Whether the solve reached a minimum."""
        return self.outcome in (CONVERGED, SETTLED, STALLED)

    def with_sigma(self, before: np.ndarray, after: np.ndarray) -> "Fit":
        """The same fit with the normal equations that other sigmas give.

        before, after: 1 sigma (m, n) of the residuals. Where their ratio differs between residuals, the fit has no
        gradient.
        """
        ratio = after / before
        if self.gradient is None or np.ptp(ratio) > _SAME_RATIO * ratio.max():
            return replace(self, gradient=None)
        information = float(ratio.mean()) ** -2
        return replace(self, normal=self.normal * information, gradient=self.gradient * information)


@dataclass(frozen=True)
class Equations:
    """Whitened normal matrix (F, F) and gradient (F,) of the free parameters, in their own units.

    A model that never holds all rows of its derivative at once hands these on from `linearise` instead (no robust
    loss then, whose weights need all residuals first).
    """

    normal: np.ndarray
    gradient: np.ndarray


@dataclass(frozen=True)
class _WhitenedRows:
    """Rows (F, m n) of the derivative; times `factor` they are whitened."""

    flat: np.ndarray
    factor: float

    @classmethod
    def of(cls, rows, residual, root) -> "_WhitenedRows":
        """Of rows (F, m, n), which may be whitened in place by `root` (m, n)."""
        flat = rows.reshape(len(rows), residual.size)
        if root.size and root.min() == root.max():  # one factor of the products instead of all rows
            return cls(flat, float(root.flat[0]))
        rows *= root
        return cls(flat, 1.0)

    def change(self, move: np.ndarray) -> np.ndarray:
        """(m n,) of the whitened residual for a move (F,) of the parameters, to first order."""
        return self.factor * (move @ self.flat)

    def gradient(self, white: np.ndarray) -> np.ndarray:
        """(F,) of half the sum of squares of a whitened residual (m n,)."""
        return self.factor * (self.flat @ white)

    def equations(self, white: np.ndarray) -> Equations:
        """With the whitened residual (m n,)."""
        normal = self.factor**2 * (self.flat @ self.flat.T)
        return Equations(normal, self.gradient(white))


def huber(z: np.ndarray, limit: float) -> np.ndarray:
    """Weights of squared whitened distances z (n,): 1 inside `limit`, limit / distance outside.

    Huber, Ann. Math. Stat. 35 (1964).
    """
    return np.minimum(1, limit / np.sqrt(np.maximum(z, 1e-300)))


def cauchy(z: np.ndarray, limit: float) -> np.ndarray:
    """Weights 1 / (1 + z / limit^2) of squared whitened distances z (n,)."""
    return 1 / (1 + z / limit**2)


LOSSES = {"linear": None, "huber": huber, "cauchy": cauchy}
# distances of a 3-D residual that 5 % of clean samples exceed (chi with 3 degrees of freedom)
_LIMIT = 2.8


def solve(
    model: Model,
    parameters: Parameters,
    loss: str = "linear",
    steps: int = 50,
    linearised: Fit | None = None,
    with_shares: bool = True,
) -> Fit:
    """Fit the free parameters of `parameters` to the samples of `model`.

    Levenberg-Marquardt on residuals whitened by their own sigma, columns scaled by the parameters' typical sizes
    (Nocedal & Wright, Numerical Optimization, 2nd ed., ch. 10). Where a full step fails, damped steps follow the
    curvature of the residual (geodesic acceleration: Transtrum & Sethna, arXiv:1201.5885): a compliance and the mass
    that loads it enter as a product, so that a straight step leaves the narrow valley of the cost at once.
    A robust loss reweights samples, with the noise's scale from their median. Effects on the noise that are free are
    fitted between solves of the mean.

    linearised: a fit of the same samples with the same sigma. Where it ended at `parameters`, with the same ones free,
    its normal equations replace the first linearisation. Priors may differ. with_shares: False leaves `Fit.shares` out,
    which takes as long as a step and which only an estimate of the noise reads.
    """
    spread = noise_mask(model, parameters)
    mean = parameters.only(parameters.mask & ~spread)
    fit = _solve_mean(model, mean, loss, steps, linearised, with_shares)
    if not spread.any():
        return fit
    for _ in range(_NOISE_ROUNDS):
        found = fit_noise(model, fit.parameters.only(parameters.mask), fit.residual, fit.weights)
        mean = found.only(parameters.mask & ~spread)
        fit = _solve_mean(model, mean, loss, steps, with_shares=with_shares)
    return _with_noise(model, fit, parameters.mask, spread)


def _solve_mean(model, parameters, loss, steps, linearised=None, with_shares=True) -> Fit:
    problem = _Problem(model, parameters, LOSSES[loss])
    problem.start(linearised)
    for _ in range(steps):
        if problem.outcome:
            break
        problem.step()
    return problem.finish(with_shares)


def _with_noise(model, fit: Fit, mask, spread) -> Fit:
    """The fit with the noise parameters free again and their information in the normal matrix."""
    parameters = fit.parameters.only(mask)
    normal = np.zeros((mask.sum(),) * 2)
    mean = ~spread[mask]
    normal[np.ix_(mean, mean)] = fit.normal
    # information is free of the scale of sigma, by which `normal` is divided later
    normal[np.ix_(~mean, ~mean)] = information(model, parameters, fit.weights) * fit.sigma_scale**2
    return replace(fit, parameters=parameters, normal=normal, gradient=None)


class _Problem:
    """State of a running solver: current parameters, residual, normal equations and damping."""

    def __init__(self, model, parameters, weigh):
        self.model, self.parameters, self.weigh = model, parameters, weigh
        self.scale = parameters.typical[parameters.mask]
        self.precision = parameters.precision[parameters.mask]
        self.nulls = parameters.nulls[parameters.mask]
        self.damping, self.outcome, self.history = 0.0, "", []
        self.is_curved = self.is_settled = False

    def start(self, linearised=None):
        self.inverse_sigma = 1 / self.model.sigma(self.parameters)
        if self.is_here(linearised):
            equations = Equations(linearised.normal, linearised.gradient)
            self.take(self.parameters, linearised.residual, equations, linearised.weights)
        else:
            self.take(self.parameters, *self.linearise(self.parameters))
        self.check()

    def is_here(self, linearised: Fit | None) -> bool:
        """Whether a fit has the normal equations at the present parameters."""
        if linearised is None or linearised.gradient is None or self.weigh:
            return False
        linearised_parameters = linearised.parameters
        same_mask = np.array_equal(linearised_parameters.mask, self.parameters.mask)
        return same_mask and np.array_equal(linearised_parameters.values, self.parameters.values)

    def linearise(self, parameters):
        """Residual at `parameters`, rows of the derivative, and weights."""
        residual, rows = self.model.linearise(parameters)
        return residual, rows, self.robust_weights(residual * self.inverse_sigma)

    def take(self, parameters, residual, rows, weights):
        """Set the current point and compute its whitened and scaled normal equations and gradient."""
        self.parameters, self.residual, self.weights = parameters, residual, weights
        if self.weigh is None:
            root = self.inverse_sigma
        else:
            root = self.inverse_sigma * np.sqrt(weights)
        self.root, self.rows, equations = root, None, rows
        if not isinstance(rows, Equations):
            self.rows = _WhitenedRows.of(rows, residual, np.broadcast_to(root, residual.shape))
            equations = self.rows.equations((residual * root).ravel())
        self.normal = equations.normal * np.outer(self.scale, self.scale)
        self.data_gradient = equations.gradient * self.scale
        self.trust = self.trust_in_priors(residual)
        self.prior = self.trust * self.scale**2
        self.data_normal = self.normal
        self.normal = self.normal + np.diag(self.prior)
        pull = self.trust * self.scale * (parameters.pack() - self.nulls)
        self.gradient = self.data_gradient + pull
        self.cost = self.cost_of(parameters, residual)
        self.history.append(self.cost)

    def check(self) -> bool:
        """True if cost and equations are finite; otherwise the solver stops without a result."""
        if all_finite(self.cost, self.normal, self.gradient):
            return True
        self.outcome = NOT_FINITE
        size = len(self.scale)
        self.trust, self.gradient = self.precision, np.zeros(size)
        self.data_gradient = np.zeros(size)
        self.prior = self.trust * self.scale**2
        self.data_normal = np.zeros((size, size))
        return False

    def trust_in_priors(self, residual):
        """Scale of the priors' precision if the residuals exceed their stated sigma.

        Model discrepancy makes every sample less informative than its sigma states; the weight of the
        priors is scaled accordingly.
        """
        square = float((self.weights * (residual * self.inverse_sigma) ** 2).sum())
        return self.precision * max(1.0, square / residual.size)

    def robust_weights(self, white):
        if self.weigh is None or not white.size:
            return np.ones(white.shape[1])
        z = (white**2).sum(0) * 3 / len(white)
        spread = np.median(z) / 2.366  # the median of chi-square with 3 degrees of freedom
        return self.weigh(z / max(spread, 1e-300), _LIMIT)

    def cost_of(self, parameters, residual):
        """Weighted sum of squares of whitened residuals and of priors."""
        prior = self.trust @ (parameters.pack() - self.nulls) ** 2
        return float((self.weights * (residual * self.inverse_sigma) ** 2).sum() + prior)

    def step(self):
        """One step; the damping is increased until the cost decreases."""
        if not self.check():
            return
        before, self.held, self.is_settled = self.cost, False, False
        if self.damping and not self.is_curved and len(self.history) > _STRAIGHT:
            self.is_curved, self.damping = self.rows is not None, _CURVED_DAMPING
        if self.is_curved:
            metric = np.diag(self.normal)
        else:
            metric = np.ones(len(self.gradient))
        for _ in range(20):
            damped = self.normal + np.diag(_FLOOR + self.damping * metric)
            move = _newton(damped, self.gradient)
            decrement = -float(self.gradient @ move)
            unit = max(1.0, self.cost / max(self.residual.size, 1))
            if (
                self.damping == 0
                and decrement <= _NEARLY * unit
                and self.finished(move, decrement, unit)
            ):
                return
            predicted = decrement + self.damping * float(move @ (metric * move))
            if self.is_curved and self.damping:
                bend = self.bend(damped, move)
            else:
                bend = 0.0
            if bend is not None and self.accept(move + bend, predicted):
                if abs(before - self.cost) < max(
                    1e-5 * before, 0.02 * max(1.0, self.cost / self.residual.size)
                ):
                    self.settle(unit)
                return
            self.increase_damping()
        if decrement < 1e-3 * max(1.0, self.cost):
            self.outcome = STALLED
        else:
            self.outcome = OUT_OF_STEPS

    def settle(self, unit):
        """End after a step that lowered the cost by next to nothing, unless only the damping made it so short.

        In the narrow curved valley of a product, such as that of a compliance and its load, damped steps creep far from
        the minimum, while the step without damping still promises more than a sigma.
        """
        self.is_settled = True
        undamped = self.normal + np.diag(np.full(len(self.gradient), _FLOOR))
        promised = -float(self.gradient @ _newton(undamped, self.gradient))
        if promised < unit:
            self.outcome = SETTLED

    def increase_damping(self):
        """After a step that failed."""
        self.held = self.is_curved
        if self.is_curved:
            self.damping = 4 * self.damping or _CURVED_DAMPING
        else:
            self.damping = max(4 * self.damping, 1e-9 * self.normal.max())

    def bend(self, damped, move):
        """(F,) second-order correction of a damped move; None where it is too large for the second order to hold.

        Half the acceleration along the move: the damped step for the second derivative of the residual along it.
        """
        free_values = self.parameters.pack() + _PROBE * move * self.scale
        ahead = self.parameters.unpack(free_values)
        change = ((self.model.residual(ahead) - self.residual) * self.root).ravel() / _PROBE
        curvature = 2 / _PROBE * (change - self.rows.change(move * self.scale))
        if not all_finite(curvature):
            return None
        acceleration = _newton(damped, self.rows.gradient(curvature) * self.scale)
        metric = np.diag(damped)
        ratio = 2 * np.sqrt((acceleration**2 @ metric) / (move**2 @ metric))
        return acceleration / 2 if ratio <= _MOST_BEND else None

    def finished(self, move, decrement, unit):
        """True if converged; a negligible last step needs no new derivative."""
        if decrement > _DONE * unit:
            free_values = self.parameters.pack() + move * self.scale
            candidate = self.parameters.unpack(free_values)
            residual = self.model.residual(candidate)
            cost = self.cost_of(candidate, residual)
            if not cost < self.cost:
                return False
            self.parameters, self.residual, self.cost = candidate, residual, cost
            self.data_gradient = self.data_gradient + self.data_normal @ move
            self.history.append(cost)
        self.outcome = CONVERGED
        return True

    def accept(self, move, predicted):
        """Move there if that lowers the cost; the derivative is computed only then.

        The damping falls by as much as the cost falls as `predicted`, and stays after it had to rise: Madsen, Nielsen &
        Tingleff, Methods for Non-Linear Least Squares Problems (2004), eq. 2.21.
        """
        free_values = self.parameters.pack() + move * self.scale
        candidate = self.parameters.unpack(free_values)
        residual, derivative = self.model.residual_and_derivative(candidate)
        cost = self.cost_of(candidate, residual)
        if not cost < self.cost:
            return False
        gain = (self.cost - cost) / max(predicted, 1e-300)
        min_factor = _LEAST_CURVED_FACTOR if self.is_curved else _LEAST_FACTOR
        factor = max(1.0 if self.held else min_factor, 1 - (2 * gain - 1) ** 3)
        smallest = _LEAST_CURVED if self.is_curved else 1e-10 * self.normal.max()
        self.damping = self.damping * factor if self.damping > smallest else 0.0
        weights = self.robust_weights(residual * self.inverse_sigma)
        self.rows = None  # before there are new ones
        self.take(candidate, residual, derivative(), weights)
        return True

    def degrees(self, covariance):
        """Residuals less the parameters that the data, and not the priors, have spent on them."""
        determined_by_prior = float(np.diag(covariance) @ (self.prior + _FLOOR))
        return max(self.residual.size - len(self.scale) + determined_by_prior, 1.0)

    def shares_of_components(self, covariance):
        """(m,) share of degrees of freedom in the residuals of each component, as of `Fit.shares`.

        Parameters spend those of positions and of orientations unequally: what the orientations do not depend on,
        positions alone pay for.
        """
        if len(self.residual) <= 3 or self.rows is None or not len(self.scale):
            return None
        rows = self.rows.flat * (self.rows.factor * self.scale[:, None])
        # not by inner products of the rows: undetermined directions have large variances, which cancel in them
        leverage = (rows * (covariance @ rows)).sum(0).reshape(self.residual.shape)
        return np.clip(1 - leverage.mean(1), 0.0, 1.0)

    def finish(self, with_shares=True):
        covariance = covariance_of(self.data_normal, self.prior + _FLOOR)
        degrees = self.degrees(covariance)
        data = float((self.weights * (self.residual * self.inverse_sigma) ** 2).sum())
        return Fit(
            self.parameters,
            self.residual,
            self.weights,
            self.data_normal / np.outer(self.scale, self.scale),
            float(np.sqrt(data / degrees)),
            tuple(self.history),
            self.outcome or (SETTLED if self.is_settled else OUT_OF_STEPS),
            degrees,
            self.data_gradient / self.scale if self.weigh is None else None,
            self.shares_of_components(covariance) if with_shares else None,
        )


def _newton(matrix, gradient):
    """-matrix^-1 gradient; of least norm where rounding has left the matrix indefinite."""
    try:
        return cho_solve(cho_factor(matrix, check_finite=False), -gradient, check_finite=False)
    except LinAlgError:
        return -solve_positive(matrix, gradient)


def normal_matrix(model: Model, parameters: Parameters) -> np.ndarray:
    """(F, F) whitened normal matrix of the data in the free parameters' own units."""
    residual, rows = model.linearise(parameters)
    flat = (rows / model.sigma(parameters)).reshape(len(rows), residual.size)
    return flat @ flat.T


def pose_scores(model: Model, fit: Fit, poses: np.ndarray) -> np.ndarray | None:
    """(F, F) sum over poses of the outer product of their whitened gradients; poses (n,) labels.

    None where every pose has one sample, or where no residual is left. In units of the residuals' real size,
    `fit.sigma_scale`.
    """
    _, group = np.unique(poses, return_inverse=True)
    if len(group) == group.max() + 1 or fit.sigma_scale < _NO_RESIDUAL:
        return None
    residual, rows = model.linearise(fit.parameters)
    white = 1 / (model.sigma(fit.parameters) * fit.sigma_scale) ** 2
    gradient = (rows * (residual * white * fit.weights)).sum(1)
    sums = np.zeros((len(rows), group.max() + 1))
    np.add.at(sums.T, group, gradient.T)
    return sums @ sums.T
