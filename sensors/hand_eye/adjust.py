"""Adjustment of a hand-eye chain in which the robot's poses are measured with error as well.

Every pose has an error of its own, normal with one sigma a group (position, rotation): variance
components, estimated together with the sensor's noise by restricted maximum likelihood, so that the
stated sigmas hold for a robot that is a hundred times worse than the camera, or as good as it.
"""

from dataclasses import dataclass, replace

import numpy as np

from workbench.core.least_squares.bundle import Family, solve_bundle
from workbench.core.least_squares.bundle_blocks import tiles_of
from workbench.core.least_squares.linear_algebra import (
    covariance_of,
    solve_positive,
    symmetric_eigen,
)
from workbench.core.model import Model
from workbench.core.parameters import Parameters

POSE = "pose"
LEAST_NOISE = 1e-6
"""px or mm: no sensor is better, and residuals of exactly zero are those of made-up data."""
_ROUNDS = 6
_INNER = 100
_CONVERGED = 0.01  # of a sigma: far below what a few poses know a sigma to
_LEVEL = 1e-3  # how often a set without a blunder has a pose called one (Baarda's choice): poses are dear
_LARGEST_SPREAD = 1e3  # typical sizes of a pose's error: beyond it the poses are nonsense, and no number says more
_LONGEST_STEP = 10.0  # typical sizes that a step without a pose may move
_ROUNDING = 1e-13  # of a sum of squares that is a difference of large ones
_FLOOR = 1e-4  # squared, of a typical size: keeps what is undetermined where it is (`hand_eye_known` takes it out)


@dataclass(frozen=True)
class Variances:
    """Sigma of the sensor's `noise` (px or mm) and of each group of the pose error, `spread` (C,)."""

    noise: float
    spread: np.ndarray


@dataclass(frozen=True)
class Linear:
    """The linear model at its best: change of the shared (F,), pose errors (P, L) with their
    covariances (P, L, L), `normal` (F, F) what the data know of the shared with the pose errors
    free, `covariance` (F, F), squares that are left and degrees of freedom."""

    change: np.ndarray
    errors: np.ndarray
    blocks: np.ndarray
    normal: np.ndarray
    covariance: np.ndarray
    squares: float
    degrees: float


@dataclass(frozen=True)
class Adjusted:
    """A chain at its best: shared `parameters`, pose `errors` (P, L), variances, knowledge, outcome."""

    chain: object
    parameters: Parameters
    errors: np.ndarray
    variances: Variances
    linear: Linear
    outcome: str
    history: tuple[float, ...]
    converged: bool
    equal: bool

    @property
    def residual(self) -> np.ndarray:
        """(m, n) with every pose moved by its error: what the sensor alone has left."""
        return (
            self.chain.with_families({POSE: self.errors}).evaluate(self.parameters.values).residual
        )


@dataclass(frozen=True)
class LeftOut:
    """One pose, seen from the others: shared `values` (A,) without it, `squared` distance of what it
    says from what they predict, in sigmas, with `numbers` degrees, and `chance` of more than that."""

    values: np.ndarray
    squared: float
    numbers: int
    chance: float


def adjust(chain, parameters: Parameters, variances: Variances, equal: bool = False) -> Adjusted:
    """Best shared parameters and pose errors, with variances by restricted maximum likelihood, from a start.

    Harville, J. Am. Stat. Assoc. 72 (1977): with u the errors of one group, C their posterior
    covariance and s^2 its variance, s^2 = u'u / (count - tr C / s^2), to a fixed point on the
    linear model; then the chain is solved again with these variances, until they stay. equal: the
    shared parameters are those of plain least squares, every sample with the same weight, and only
    their covariance is that of the variances (`solve_equal`).
    """
    for _ in range(_ROUNDS):
        fit = _solved(chain, parameters, variances, equal)
        parameters = fit.parameters
        before = variances
        errors = fit.values.get(POSE, np.zeros_like(chain.errors))
        model_grams = grams(chain.with_families({POSE: errors}), parameters)
        variances = restricted_likelihood(chain, model_grams, parameters, variances)
        moved = np.abs(
            np.log([variances.noise / before.noise, *(variances.spread / before.spread)])
        ).max()
        if moved < _CONVERGED or equal:
            break
    linear = _linear(chain, model_grams, parameters, variances, equal)
    errors = linear.errors if equal else errors
    return Adjusted(
        chain, parameters, errors, variances, linear, fit.outcome, fit.history, fit.converged, equal
    )


def _solved(chain, parameters, variances, equal):
    size = np.concatenate(
        [np.full(g.components.stop - g.components.start, g.typical) for g in chain.groups]
    )
    if equal:  # noise as large as what one sample is wrong by, so that priors are not drowned
        total_sigma = float(np.hypot(variances.noise, np.sqrt((variances.spread**2).sum())))
        return solve_bundle([Model(replace(chain, noise=total_sigma))], parameters, eliminate=None)
    family = Family(
        POSE, np.zeros_like(chain.errors), size, _component_sigma(chain, variances.spread)
    )
    return solve_bundle(
        [Model(replace(chain, noise=variances.noise))], parameters, {POSE: family}, POSE
    )


def _linear(chain, model_grams, parameters, variances, equal):
    solve = solve_equal if equal else solve_linear
    return solve(
        model_grams, parameters, variances.noise, _component_sigma(chain, variances.spread)
    )


def _component_sigma(chain, spread):
    """(L,) sigma of each number of a pose's error."""
    return np.concatenate(
        [np.full(g.components.stop - g.components.start, s) for g, s in zip(chain.groups, spread)]
    )


def grams(chain, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """(P, K, K) products of the rows [shared free, pose, residual at no pose error], and numbers (P,) measured."""
    evaluation = chain.evaluate(parameters.values)
    residual_of_pose = evaluation.residual - np.einsum(
        "lmn,nl->mn", evaluation.pose, chain.errors[chain.pose]
    )
    rows = (
        np.concatenate(
            [evaluation.shared[parameters.mask], evaluation.pose, residual_of_pose[None]]
        )
        / chain.relative
    )
    tiles = tiles_of({POSE: chain.pose}, len(chain.pose))
    rows = (rows[..., tiles.index] * tiles.live).reshape(*rows.shape[:2], -1, tiles.length)
    product = sum(
        rows[:, j].transpose(1, 0, 2) @ rows[:, j].transpose(1, 2, 0) for j in range(rows.shape[1])
    )
    total = np.zeros((len(chain.flange), *product.shape[1:]))
    total[tiles.groups[POSE]] = np.add.reduceat(product, tiles.start)
    return total, np.bincount(chain.pose, minlength=len(total)) * len(residual_of_pose)


def restricted_likelihood(
    chain, model_grams, parameters: Parameters, start: Variances
) -> Variances:
    """Variances at their fixed point on the linear model with Gram matrices `model_grams`."""
    noise = start.noise
    spread = np.array(start.spread)
    for _ in range(_INNER):
        linear = solve_linear(model_grams, parameters, noise, _component_sigma(chain, spread))
        before = np.array([noise, *spread])
        noise = np.clip(
            np.sqrt(linear.squares / linear.degrees), max(noise / 3, LEAST_NOISE), 3 * noise
        )
        spread = np.array([_component(linear, group, s) for group, s in zip(chain.groups, spread)])
        if np.abs(np.log(np.array([noise, *spread]) / before)).max() < _CONVERGED / 10:
            break
    return Variances(float(noise), spread)


def _component(linear, group, sigma):
    """The next sigma of a group: Harville's step, no further than a factor of three.

    Of errors that the data say nothing of, both sums are rounding: then the plain step of
    expectation and maximisation (Dempster et al. 1977), which keeps the sigma.
    """
    square = (linear.errors[:, group.components] ** 2).sum()
    trace = np.trace(linear.blocks[:, group.components, group.components], axis1=1, axis2=2).sum()
    count = linear.errors[:, group.components].size
    known = count - trace / sigma**2
    after = square / known if known > 1e-3 * count else (square + trace) / count
    return float(
        np.clip(
            np.sqrt(after),
            max(sigma / 3, group.min_sigma),
            min(3 * sigma, _LARGEST_SPREAD * group.typical),
        )
    )


def solve_linear(model_grams, parameters: Parameters, noise: float, sigma: np.ndarray) -> Linear:
    """Best shared change and pose errors of the linear model with Gram matrices `model_grams`, sigma (L,).

    The pose errors are eliminated (Schur complement), the shared parameters solved for, the errors substituted back.
    """
    gram = model_grams[0] / noise**2
    free = parameters.mask
    size = int(free.sum())
    errors_part = slice(size, size + len(sigma))
    by_errors = gram[:, :size, errors_part]
    errors_inverse = covariance_of(gram[:, errors_part, errors_part], sigma**-2)
    mix = errors_inverse @ by_errors.transpose(0, 2, 1)
    mix_residual = errors_inverse @ gram[:, errors_part, -1:]

    typical = parameters.typical[free]
    precision = parameters.precision[free]
    regularisation = precision + _FLOOR / typical**2
    normal = (gram[:, :size, :size] - by_errors @ mix).sum(0)
    covariance = _scaled_covariance(normal, regularisation, typical)
    pull = (gram[:, :size, -1] - (by_errors @ mix_residual)[..., 0]).sum(0)
    pull = pull + precision * (parameters.pack() - parameters.nulls[free])
    change = -covariance @ pull
    errors = -(mix_residual[..., 0] + mix @ change)
    errors_covariance = errors_inverse + mix @ covariance @ mix.transpose(0, 2, 1)

    shared_used = size - np.diag(covariance) @ regularisation
    errors_variance = np.diagonal(errors_covariance, 0, 1, 2)
    errors_used = len(sigma) - (errors_variance / sigma**2).sum(1)
    degrees_used = float(shared_used + errors_used.sum())
    degrees = max(model_grams[1].sum() - degrees_used, 1.0)
    squares = _sum_of_squares(model_grams[0], change, errors)
    return Linear(change, errors, errors_covariance, normal, covariance, squares, degrees)


def solve_restricted(chain, model_grams, parameters: Parameters, variances: Variances) -> Linear:
    """`solve_linear` with the variances of the groups of a chain."""
    return solve_linear(
        model_grams, parameters, variances.noise, _component_sigma(chain, variances.spread)
    )


def _sum_of_squares(grams: np.ndarray, change: np.ndarray, errors: np.ndarray) -> float:
    """Sum of squared residuals of the linear model at its solution, not below the rounding of its terms."""
    count = len(grams)
    changes = np.tile(change, (count, 1))
    solution = np.concatenate([changes, errors, np.ones((count, 1))], 1)
    squares = np.einsum("pi,pij,pj->", solution, grams, solution)
    terms = np.einsum("pi,pii->p", solution**2, grams).sum()
    rounding = _ROUNDING * terms
    return float(max(squares, rounding))


def solve_equal(model_grams, parameters: Parameters, noise: float, sigma: np.ndarray) -> Linear:
    """Plain least squares of the linear model, its covariance that of the variances.

    With M the normal matrix of equal weights 1/v and V the covariance of what it is solved for,
    M^-1 V M^-1. v, which only weighs the data against priors, makes M know as much as maximum
    likelihood would.
    """
    best = solve_linear(model_grams, parameters, noise, sigma)
    gram = model_grams[0]
    free = parameters.mask
    size = int(free.sum())
    typical = parameters.typical[free]
    # blocks of the parameters, of these with the errors of the groups, and with the residual
    gram_of_parameters = gram[:, :size, :size]
    cross = gram[:, :size, size:-1]
    right = gram[:, :size, -1]
    total = gram_of_parameters.sum(0)
    likelihood = float(np.diag(best.normal) @ typical**2)
    equal = float(np.diag(total) @ typical**2)
    worth = max(likelihood, 1e-300) / max(equal, 1e-300)
    prior = parameters.precision[free]
    regularisation = prior + _FLOOR / typical**2
    inverse = _scaled_covariance(total * worth, regularisation, typical)
    from_null = parameters.pack() - parameters.nulls[free]
    change = -inverse @ (worth * right.sum(0) + prior * from_null)
    by_groups = ((cross * sigma**2) @ cross.transpose(0, 2, 1)).sum(0)
    middle = worth**2 * (noise**2 * total + by_groups) + np.diag(regularisation)
    errors = _group_errors(gram[:, size:-1] / noise**2, size, sigma, change)
    return replace(best, change=change, covariance=inverse @ middle @ inverse, errors=errors)


def _group_errors(group_blocks, size: int, sigma, change):
    """Errors of the groups at a change (P,) of the parameters; own: their rows of the weighted normal matrix."""
    by_parameters = group_blocks[:, :, :size]
    by_errors = group_blocks[:, :, size:-1]
    right = group_blocks[:, :, -1]
    right_side = right + by_parameters @ change
    normal = by_errors + np.diag(sigma**-2)
    return -solve_positive(normal, right_side[..., None])[..., 0]


def _scaled_covariance(normal, precision, typical):
    """(F, F) inverse of normal + diag(held), computed in units of the typical sizes (F,)."""
    size = np.outer(typical, typical)
    return covariance_of(normal * size, precision * typical**2) * size


def with_held_camera(adjusted: Adjusted, modes: np.ndarray) -> Adjusted:
    """The same adjustment with the errors of its held camera in the covariance of its shared parameters.

    modes (V, M): a square root of the covariance of the camera's values. With N_sc the normal matrix between shared
    parameters and camera modes, an error e of the modes moves a solution of covariance C by C N_sc e. The noise of
    the images adds independently, also where the camera was calibrated from the same images: a least-squares
    estimate of the camera is uncorrelated with what the images say of the board poses given the camera.
    C has to be the covariance of the adjustment alone: other contributions are added afterwards.
    """
    old = adjusted.parameters
    chain = replace(adjusted.chain, modes=modes)
    values = np.concatenate([old.values, np.zeros(modes.shape[1])])
    is_free = np.concatenate([old.mask, np.ones(modes.shape[1], bool)])
    parameters = replace(chain.parameters, values=values).only(is_free)
    errors = {POSE: adjusted.errors}
    model_grams = grams(chain.with_families(errors), parameters)
    spread = _component_sigma(chain, adjusted.variances.spread)
    normal = solve_linear(model_grams, parameters, adjusted.variances.noise, spread).normal
    linear = adjusted.linear
    size = int(old.mask.sum())
    influence = linear.covariance @ normal[:size, size:]
    covariance = linear.covariance + influence @ influence.T
    return replace(adjusted, linear=replace(linear, covariance=covariance))


def leave_out(adjusted: Adjusted, pose: int, full) -> LeftOut:
    """The same adjustment without one pose, variances and all, and how that pose then looks.

    full: `grams` at the adjustment, where the first Gauss-Newton step starts; a second is taken
    from what the first reached.
    """
    chain = adjusted.chain
    parameters = adjusted.parameters
    variances = adjusted.variances
    model_grams = full
    for _ in range(2):
        others = without_pose(model_grams, pose)
        variances = restricted_likelihood(chain, others, parameters, variances)
        linear = _linear(chain, others, parameters, variances, adjusted.equal)
        step_length = np.abs(linear.change / parameters.typical[parameters.mask]).max()
        parameters = parameters.unpack(
            parameters.pack() + linear.change * min(1, _LONGEST_STEP / max(step_length, 1e-300))
        )
        model_grams = grams(chain.with_families({POSE: linear.errors}), parameters)
    return LeftOut(parameters.values, *_distance(chain, model_grams, pose, linear, variances))


def without_pose(model_grams, pose: int):
    """`grams` without what one pose says."""
    keep = np.arange(len(model_grams[0])) != pose
    return model_grams[0] * keep[:, None, None], model_grams[1] * keep


def _distance(chain, model_grams, pose, linear, variances):
    """Squared distance of one pose from its prediction, its degrees, and the chance of a larger one.

    What the pose says of its own error, h = D'y, has covariance noise^2 D'D + D'D S D'D + D'A C A'D
    with S the robot's variances and C those of the shared parameters; F-distributed for few poses.
    """
    from workbench.core.distributions import fisher as f

    size = len(linear.change)
    gram = model_grams[0][pose]
    group_block = gram[size:-1, size:-1]
    cross = gram[size:-1, :size]
    right_side = gram[size:-1, -1]
    spread = np.diag(_component_sigma(chain, variances.spread) ** 2)
    covariance = (
        variances.noise**2 * group_block
        + group_block @ spread @ group_block
        + cross @ linear.covariance @ cross.T
    )
    scale = 1 / np.sqrt(np.maximum(np.diag(covariance), 1e-18 * np.abs(covariance).max()))
    values, vectors = symmetric_eigen(covariance * np.outer(scale, scale))
    seen = values > 1e-9 * values[-1]
    squared = float((((right_side * scale) @ vectors[:, seen]) ** 2 / values[seen]).sum())
    numbers = int(seen.sum())
    if not numbers:  # nothing measured at this pose bears on what is adjusted
        return 0.0, 0, 1.0
    others = int((model_grams[1] > 0).sum()) - 1
    degrees_of_freedom = max(numbers * others - size, 1)
    return squared, numbers, float(f.sf(squared / numbers, numbers, degrees_of_freedom))


def find_blunders(
    chain, parameters: Parameters, variances: Variances, max_count: int, equal: bool = False
):
    """Adjustment without blunders, every pose left out once, and the poses left out for good.

    One pose at a time, that which the others find least likely, while that is less likely than
    one in a thousand among as many poses (Baarda's data snooping, 1968, with the variances unknown).
    Returns Adjusted, {pose: LeftOut} of every pose, (pose, ...).
    """
    blunders: dict[int, LeftOut] = {}
    while True:
        remaining = chain.at(np.flatnonzero(~np.isin(chain.pose, list(blunders))))
        adjusted = adjust(remaining, parameters, variances, equal)
        full = grams(remaining.with_families({POSE: adjusted.errors}), adjusted.parameters)
        seen = {k: leave_out(adjusted, k, full) for k in np.unique(remaining.pose).tolist()}
        worst = min(seen, key=lambda k: seen[k].chance)
        if seen[worst].chance > _LEVEL / len(seen) or len(blunders) >= max_count:
            return (
                adjusted,
                {**seen, **_blunders_at_solution(chain, adjusted, blunders)},
                tuple(sorted(blunders)),
            )
        blunders[worst] = seen[worst]
        parameters = replace(parameters, values=seen[worst].values)


def _blunders_at_solution(chain, adjusted, blunders):
    """The poses left out for good, seen from the final adjustment."""
    model_grams = grams(chain, adjusted.parameters) if blunders else None
    return {
        k: LeftOut(
            adjusted.parameters.values,
            *_distance(chain, model_grams, k, adjusted.linear, adjusted.variances),
        )
        for k in blunders
    }
