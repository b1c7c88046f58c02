"""Random effects of a place from sample to sample: what no recorded covariate explains still has a direction.

A joint whose cause was not recorded (its temperature, the side that it came from) and an encoder that rounds leave
no smooth function of anything, but residuals that lie along what that joint does. The test compares the direction
of each residual with the port's, given its length, so that neither heavy tails nor a wrong sigma counts.
"""

from dataclasses import dataclass, replace

import numpy as np

from workbench.core.distributions import norm, student
from workbench.core.least_squares.linear_algebra import inverse_positive, symmetric_eigen
from workbench.diagnosis.levels import MAJORITY, NEGLIGIBLE_SHARE, NOTABLE_SHARE, ROUNDING
from workbench.diagnosis.linear.candidates import Site
from workbench.diagnosis.linear.problem import Problem
from workbench.diagnosis.noise.outliers import FULL_WEIGHT, lengths
from workbench.diagnosis.noise.rounded_readings import PLACE as ROUNDING_PLACE
from workbench.diagnosis.noise.rounded_readings import rounding_site, rounding_variance

_SPREADS, _TRIED = (0.05, 50.0), 40
"""Spreads that are tried, in units of the noise: from invisible to nothing else, in steps of a fifth."""
_ROUNDS = int(np.ceil(-np.log2(ROUNDING)))
"""Iterations for a shape (Tyler 1987): each at least halves what is left."""
_MAX_LENGTH = 3.0
"""Median lengths from which on a sample counts no more: one in a hundred of Gaussian ones."""
_PERIODS, _ORDERS = 1.6, 400_000
"""How far a count may be from what its spread says, and how many counts are tried."""
_CONTRADICTED = 6.0
"""Log likelihood ratio from which on the readings' rounding is not what is seen: twice it is chi-square, p = 0.0005."""
_GRID = 20
"""Places of a grid in the shortest wave: that costs a hundredth of its power."""


@dataclass(frozen=True)
class RandomEffect:
    """A random effect at a place: it varies from sample to sample.

    `site`: the place, with `p_value` over all sites. `spread`: of its components, in typical sizes; `ratio`: of it to
    the residual noise. `kurtosis`: excess kurtosis of its movement, with standard error `error` (joints alone, else
    nan). `rounds`: p-value of a sawtooth of its reading, 1 where there is none. `gain`: log likelihood ratio to noise
    alone.
    """

    site: Site
    p_value: float
    spread: float
    ratio: float
    kurtosis: float
    error: float
    rounds: float
    gain: float


def find_random_effect(problem: Problem, level: float) -> RandomEffect | None:
    """The place with the most significant random effect; None where no p-value is below `level`.

    The score of a site is the sum over samples of z' A z over the root of the sum of its squares, with A the site's
    covariance in typical sizes without its trace and without its mean over all samples (which anisotropic noise
    causes). It is standard normal where the directions of the residuals are random: score tests of variance
    components, Lin, Biometrika 84 (1997) 309. The score is blind where a place moves all samples in nearly the same
    direction, as the last joint moves what a sensor sees. The likelihood of the directions under the random effect is
    therefore compared with that of noise of one constant shape, too: with a random effect in all samples, and with one
    in those that lie far off alone. Of the places with about the same significance the one with the highest likelihood
    is taken.
    """
    m = len(problem.residual) // problem.n
    if m < 2 or len(problem.residual) != m * problem.n or not problem.sites:
        return None
    root = problem.root_weights
    whitened = problem.orthogonalise(problem.residual) / root
    residual = whitened.reshape(m, problem.n)
    sites = [replace(site, rows=site.rows / root) for site in places(problem)]
    length = np.sqrt((residual**2).sum(0))
    longest = _MAX_LENGTH * np.median(length)
    z = residual * np.minimum(1.0, longest / np.maximum(length, 1e-300))
    _, pose = np.unique(problem.pose, return_inverse=True)
    # repeats of a pose err together: by Hoelder's inequality they count as one
    share = 1.0 / np.bincount(pose)[pose]
    scores = np.array([_score(_tensor(site, m), z, pose) for site in sites])
    gains = np.array([_direction_likelihood(site, z, share) for site in sites])
    gains -= _constant_shape_likelihood(z, share)
    occasional = _occasional_gains(sites, residual, _shape_of_noise(z, share), share)
    by_score = float(norm.sf(scores.max()))
    likelihood_ratio = float(np.exp(-max(gains.max(), 0.0)))
    by_direction = _TRIED * likelihood_ratio
    by_some = float(np.exp(-max(occasional.max(), 0.0)))
    p = 3 * len(sites) * min(by_score, by_direction, by_some)
    if p > level:
        return None
    scores_high = scores > MAJORITY * scores.max()
    gains_high = gains > max(MAJORITY * gains.max(), 0.0)
    is_significant = scores_high | gains_high
    if by_some < min(by_score, by_direction):
        is_significant = occasional == occasional.max()
    site, (log, ratio, noise) = _most_probable_site(sites, is_significant, z)
    spread = ratio * noise
    kurtosis, error = _shape(site, residual)
    p_rounding = _rounds(site, residual, spread, problem.covariates)
    return RandomEffect(
        site,
        float(np.clip(p, 1e-300, 1.0)),
        spread,
        ratio,
        kurtosis,
        error,
        p_rounding,
        log - _of_noise(z),
    )


def known_rounding(problem: Problem, level: float) -> RandomEffect | None:
    """The rounding errors of readings on a lattice, of known size, where they make a notable part of the residual.

    None where their likelihood ratio to noise alone is not above one over `level`. Known noise belongs to the model
    from the start: against noise of all directions, laws that follow some rounding errors by chance are significant.
    """
    site = rounding_site(problem)
    m = len(problem.residual) // problem.n
    if site is None or len(problem.residual) != m * problem.n:
        return None
    residual = problem.orthogonalise(problem.residual)
    if rounding_variance(problem).sum() < NOTABLE_SHARE * float(residual @ residual):
        return None
    root = problem.root_weights
    z = (residual / root).reshape(m, problem.n)
    spreads, variance, logs = _log_likelihoods(replace(site, rows=site.rows / root), z)
    known = _known_spread(spreads, variance)
    gain = float(logs[known]) - _of_noise(z)
    p = float(np.exp(-max(gain, 0.0)))
    if p > level:
        return None
    ratio, noise = float(spreads[known]), float(np.sqrt(variance[known]))
    return RandomEffect(site, max(p, 1e-300), ratio * noise, ratio, np.nan, np.nan, 1.0, gain)


def _known_spread(spreads: np.ndarray, variance: np.ndarray) -> int:
    """Number of the spread (S,), over noise of a variance (S,), that is nearest to the known one of rounding: 1."""
    log_sizes = np.log(spreads * np.sqrt(variance))
    return int(np.argmin(np.abs(log_sizes)))


def _most_probable_site(sites: list[Site], is_significant: np.ndarray, z: np.ndarray):
    """The significant site, or rounding, with the highest likelihood of z (m, n), and the result of `_likelihood`."""
    compared = [
        site for site, significant in zip(sites, is_significant) if significant or is_rounding(site)
    ]
    likelihoods = [
        _of_rounding(site, z) if is_rounding(site) else _likelihood(site, z) for site in compared
    ]
    best = int(np.argmax([row[0] for row in likelihoods]))
    return compared[best], likelihoods[best]


def places(problem: Problem) -> tuple[Site, ...]:
    """Every place that may have a random effect; all joints at once, too, as when readings are of another instant."""
    joints = [site for site in problem.sites if site.port == "joint"]
    # what an instrument does by chance is its noise, see `angular_noise`
    candidates = (*problem.sites, *problem.growing)
    chain_sites = [site for site in candidates if site.where != "instrument"]
    rounding = rounding_site(problem)
    if rounding is not None:
        chain_sites.append(rounding)
    if len(joints) > 1:
        rows = np.concatenate([site.rows for site in joints])
        typical = np.concatenate([site.typical for site in joints])
        chain_sites.append(_of_clock(joints[0], rows, typical))
        chain_sites.extend(_last_moves(problem, joints))
    return tuple(chain_sites)


def _of_clock(site: Site, rows: np.ndarray, typical: np.ndarray) -> Site:
    """All joints by one number: the instant of their readings."""
    return replace(site, where="time", rows=rows, typical=typical, covariates=(), pairs=())


def _last_moves(problem: Problem, joints) -> list[Site]:
    """All joints back along their last move, as when readings are taken at any moment before the arm rests."""
    columns = [problem.covariates.get(site.where.replace("joint-", "move")) for site in joints]
    if any(x is None for x in columns):
        return []
    # a slide's metre counts as a radian
    metres = np.array([[1e-3 if site.unit == "mm" else 1.0] for site in joints])
    in_metres = np.abs(columns * metres).max(0)
    moves = np.stack(columns) / np.maximum(in_metres, 1e-300)
    by_joint = (site.rows * move[problem.sample] for site, move in zip(joints, moves))
    row = sum(by_joint)
    return [_of_clock(joints[0], row, joints[0].typical)]


def directions(site: Site, m: int) -> np.ndarray:
    """(k, m, n) what each component does, in typical sizes."""
    scaled = site.rows * site.typical[:, None]
    return scaled.reshape(len(site.rows), m, -1)


def _tensor(site, m):
    d = directions(site, m)
    tensor = np.einsum("kan,kbn->abn", d, d)
    traces = np.einsum("aan->n", tensor)
    isotropic = np.eye(m)[:, :, None] * traces
    anisotropy = tensor - isotropic / m
    # every direction alike
    anisotropic_squares = (anisotropy**2).sum()
    is_round = anisotropic_squares <= NEGLIGIBLE_SHARE * (tensor**2).sum()
    return np.zeros_like(anisotropy) if is_round else anisotropy


def _likelihood(site, z) -> tuple[float, float, float]:
    """Log likelihood of residuals z (m, n) in noise and what a site does by chance; its most probable spread over the
    noise, and that noise."""
    spreads, level, logs = _log_likelihoods(site, z)
    best = int(np.argmax(logs))
    log = float(logs[best])
    ratio = float(spreads[best])
    noise = float(np.sqrt(level[best]))
    return log, ratio, noise


def _log_likelihoods(site, z) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Spreads (S,) of a site over the noise, the variance (S,) of the noise and the log likelihood (S,) with each."""
    spreads, widths, squares = _widths(site, z)
    level = np.maximum((squares / widths).mean((1, 2)), 1e-300)
    logs_of_widths = np.log(widths).sum((1, 2))
    logs = -0.5 * (logs_of_widths + z.size * np.log(level))
    return spreads, level, logs


def _of_rounding(site, z) -> tuple[float, float, float]:
    """As `_likelihood`, of rounding errors, whose spread is known: 1. No likelihood where another spread explains more.

    A spread that is known costs no parameter, half of log N by Schwarz (1978).
    """
    spreads, level, logs = _log_likelihoods(site, z)
    known = _known_spread(spreads, level)
    if logs[known] < logs.max() - _CONTRADICTED:
        ratio = float(spreads[known])
        return -np.inf, ratio, float(np.sqrt(level[known]))
    log = float(logs[known]) + 0.5 * np.log(z.size)
    return log, float(spreads[known]), float(np.sqrt(level[known]))


def is_rounding(site: Site) -> bool:
    """Whether a place is that of the rounding errors of all readings."""
    return (site.where, site.port) == (ROUNDING_PLACE, "joint")


def _widths(site, z) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Spreads (S,) of a site over the noise, the variances (S, m, n) that each makes along the principal directions of
    every sample, and the squares (m, n) of residuals z (m, n) along these."""
    d = directions(site, len(z))
    tensors = np.einsum("kan,kbn->nab", d, d)
    values, vectors = symmetric_eigen(tensors)
    along_principal = np.einsum("nab,an->bn", vectors, z)
    squares = along_principal**2
    mean_value = np.maximum(values.mean(), 1e-300)
    spreads = np.geomspace(*_SPREADS, _TRIED) / np.sqrt(mean_value)
    widths = 1 + spreads[:, None, None] ** 2 * values.T
    return spreads, widths, squares


def _unit(z: np.ndarray) -> np.ndarray:
    """Directions (m, n) of residuals (m, n)."""
    return z / np.maximum(np.sqrt((z**2).sum(0)), 1e-300)


def _direction_likelihood(site, z, share) -> float:
    """Log likelihood of the directions of residuals z (m, n) with a random effect at a site in isotropic noise.

    Against directions that are all as likely; the angular central Gaussian: Tyler, Biometrika 74 (1987) 579.
    share (n,): what each sample counts.
    """
    _, widths, squares = _widths(site, _unit(z))
    by_sample = (squares / widths).sum(1)
    length = np.maximum(by_sample, 1e-300)
    log_widths = np.log(widths).sum(1)
    logs = log_widths + len(z) * np.log(length)
    return float((-0.5 * logs @ share).max())


def _occasional_gains(sites, residual, shape, share) -> np.ndarray:
    """(S,) log likelihood ratio of the directions of residuals (m, n), some of which contain a site's movement.

    Against noise of the shape (m, m), which is made isotropic. A sample that lies farther off than noise is as likely
    one of them as not, and then far off along what the site does there, by its own length; the others have any
    direction. Which samples lie far off says nothing of their directions, so that the ratio of these alone is a valid
    one over a p-value, but for the estimate of the shape, which is the likelier for what is far off.
    """
    m = len(residual)
    values, vectors = symmetric_eigen(shape)
    white = vectors / np.sqrt(values) @ vectors.T
    residual = white @ residual
    length = lengths(residual)
    far_samples = np.flatnonzero(length > FULL_WEIGHT)
    excess = np.maximum(length[far_samples] ** 2 - m, 0.0)
    unit = _unit(residual[:, far_samples])
    logs = [
        _moved_likelihood(_relative_covariance(site, white)[far_samples], unit, excess)
        for site in sites
    ]
    return np.logaddexp(np.log(0.5), np.log(0.5) + np.array(logs)) @ share[far_samples]


def _moved_likelihood(covariance, unit, excess) -> np.ndarray:
    """(n,) log likelihood of directions (m, n) of noise and of `excess` (n,) variances along covariances (n, m, m).

    The covariances have trace 1. Against directions that are all as likely (Tyler 1987).
    """
    values, vectors = symmetric_eigen(covariance)
    widths = 1 + np.maximum(values, 0.0) * excess[:, None]
    squares = np.einsum("nab,an->nb", vectors, unit) ** 2
    return -0.5 * (np.log(widths).sum(1) + len(unit) * np.log((squares / widths).sum(1)))


def _relative_covariance(site, white: np.ndarray) -> np.ndarray:
    """(n, m, m) covariance over its trace of a site's movement at each sample, multiplied by `white` (m, m)."""
    d = np.einsum("ab,kbn->kan", white, directions(site, len(white)))
    covariance = np.einsum("kan,kbn->nab", d, d)
    return covariance / np.maximum(np.einsum("naa->n", covariance), 1e-300)[:, None, None]


def _constant_shape_likelihood(z, share) -> float:
    """As `_direction_likelihood`, for noise of one shape, at its maximum-likelihood estimate (Tyler 1987).

    One over the ratio of a place's likelihood to this is a valid p-value: the estimated shape is no less likely than
    the true one, whose ratio is more than k by chance at most once in k times. However far each sample lies off.
    """
    unit = _unit(z)
    shape = _shape_of_noise(z, share)
    volume = share.sum() * float(np.linalg.slogdet(shape)[1])
    return -0.5 * (volume + len(unit) * float(np.log(_squares_of(unit, shape)) @ share))


def _shape_of_noise(z, share) -> np.ndarray:
    """(m, m) shape of the noise of residuals (m, n), of trace m, however far each lies off (Tyler 1987)."""
    unit = _unit(z)
    m = len(unit)
    shape = np.eye(m)
    for _ in range(_ROUNDS):
        shape = m / share.sum() * (unit * share / _squares_of(unit, shape)) @ unit.T
        shape += ROUNDING * np.eye(m)
        shape *= m / np.trace(shape)
    return shape


def _squares_of(unit, shape) -> np.ndarray:
    """(n,) squared lengths of directions (m, n) by the inverse of a shape (m, m)."""
    return np.maximum(np.einsum("an,ab,bn->n", unit, inverse_positive(shape), unit), 1e-300)


def _of_noise(z) -> float:
    """Log likelihood of residuals z (m, n) without a random effect, on the scale of `_likelihood`."""
    mean_square = max((z**2).mean(), 1e-300)
    return -0.5 * z.size * float(np.log(mean_square))


def _score(tensor, z, pose):
    total = (tensor**2).sum()
    unit = _unit(z)
    tensor = tensor - tensor.mean(-1, keepdims=True)
    # the same for all samples, as of a frame that the instrument moves with
    if (tensor**2).sum() <= NEGLIGIBLE_SHARE * total:
        return 0.0
    by_sample = np.einsum("an,abn,bn->n", unit, tensor, unit)
    by_pose = np.bincount(pose, by_sample)
    squares = (by_pose**2).sum()
    score = float(by_pose.sum() / max(np.sqrt(squares), 1e-300))
    # of so many samples the sum is as good as made
    number = (by_pose**2).sum() ** 2 / max((by_pose**4).sum(), 1e-300)
    p = max(student.sf(score, number), 1e-300)
    return float(norm.isf(p))


def _moved(site, z):
    """(n,) movement of one component at each sample in typical sizes, (n,) its variance, (n,) its observability."""
    way = directions(site, len(z))[0]
    squared_length = (way**2).sum(0)
    divisor = np.maximum(squared_length, 1e-300)
    parallel = (way * z).sum(0)
    squares = (z**2).sum(0)
    perpendicular = squares - parallel**2 / divisor
    noise = max(float(perpendicular.mean() / (len(z) - 1)), 1e-300)
    return parallel / divisor, noise / divisor, squared_length


def _shape(site, z):
    """Excess kurtosis of one component's movement less noise, and its standard error; nan of several components."""
    if len(site.rows) > 1:
        return np.nan, np.nan
    movement_of_sample, error, squared_length = _moved(site, z)
    clear = squared_length > np.median(squared_length)
    mean = movement_of_sample[clear].mean()
    movement_of_sample = movement_of_sample[clear] - mean
    error = error[clear]
    second = float((movement_of_sample**2 - error).mean())
    if second <= 0:
        return np.nan, np.nan
    noise_part = 6 * error * second
    fourth = float((movement_of_sample**4 - noise_part - 3 * error**2).mean())
    ratio = float((movement_of_sample**2).mean()) / second
    excess = fourth / second**2 - 3
    excess_std = np.sqrt(24 / clear.sum())
    return excess, float(excess_std * ratio**2)


def _rounds(site, z, spread, covariates) -> float:
    """Chance, over all tried, of so clear a wave of the joint's reading with the period of rounding of this spread.

    A rounded reading errs by a sawtooth of one count, whose root mean square is the count over the root of twelve.
    """
    name = site.where.replace("joint-", "q")
    reading = covariates.get(name)
    is_joint = len(site.rows) == 1 and site.where.startswith("joint")
    if not is_joint or reading is None or not np.ptp(reading):
        return 1.0
    movement_of_sample, error, _ = _moved(site, z)
    weight = movement_of_sample / (error + spread**2)
    count = spread * float(site.typical[0]) * np.sqrt(12)
    reading, same = np.unique(reading, return_inverse=True)  # samples of one pose move together
    weight = np.bincount(same, weight)
    power, tried = _waves(reading, weight, count)
    if tried:
        squares = (weight**2).sum()
        return float(min(1.0, tried * np.exp(-power / squares)))
    return 1.0


def _waves(reading, weight, count) -> tuple[float, int]:
    """The highest power of a wave of the reading whose period is about a count, and how many were tried.

    Readings are laid on a grid of a twentieth of the shortest wave, which costs a hundredth of its power.
    """
    span = np.ptp(reading)
    shortest = max(count / _PERIODS, 4 * span / _ORDERS)
    finest = shortest / _GRID
    size = int(2 ** np.ceil(np.log2(4 * span / finest)))
    cell = ((reading - reading.min()) / shortest * _GRID).astype(int)
    laid = np.bincount(cell, weight, size)
    power = np.abs(np.fft.rfft(laid)) ** 2
    order = np.arange(len(power)) * (_GRID / (size * shortest))  # waves a radian
    is_long = order >= 1 / (_PERIODS * count)
    tried = is_long & (order <= 1 / shortest)
    highest = float(power[tried].max(initial=0.0))
    return highest, int(tried.sum())


def whitened_by(problem: Problem, random_effect: RandomEffect) -> Problem:
    """The problem with residuals, and all that is compared with them, also whitened by a site's random effect."""
    m = len(problem.residual) // problem.n
    identity = _place_key(random_effect.site)
    known_places = places(problem)
    site = next(s for s in known_places if _place_key(s) == identity)
    d = directions(site, m)
    tensors = np.einsum("kan,kbn->abn", d, d)
    covariance = np.eye(m)[:, :, None] + random_effect.ratio**2 * tensors
    values, vectors = symmetric_eigen(covariance.transpose(2, 0, 1))
    relative_spread = random_effect.ratio / random_effect.spread
    scale = relative_spread / np.sqrt(values)
    root = np.einsum("nab,nb,ncb->acn", vectors, scale, vectors)

    def white(rows):
        blocks = rows.reshape(-1, m, problem.n)
        return np.einsum("abn,kbn->kan", root, blocks).reshape(rows.shape)

    return problem.transformed(white)


def _place_key(site: Site) -> tuple:
    """Key of a place: all joints, and all along their last moves, share that of the clock."""
    return site.where, site.port, len(site.rows)
