"""Robust weights, the Bayes factor of outliers, and noise that is not the same everywhere.

Outliers: a few samples far out, against heavier tails of all. The noise of the others is Gaussian or Student's, each
sample's or each coordinate's, of unknown spread and degrees of freedom, all of which are summed over. An outlier may
lie from five to sixty sigmas off, in any direction or along one axis. One over the Bayes factor of "some are outliers"
against "none is" is a valid p-value on average over these noises: by Markov's inequality the factor passes k by chance
at most once in k times (Vovk & Wang, Ann. Stat. 49 (2021), 1736, on e-values).
"""

from collections.abc import Mapping

import numpy as np
from scipy.ndimage import median
from scipy.special import gammaln, logsumexp

from workbench.core.distributions import chi2, fisher
from workbench.diagnosis.levels import LEAST_NUMBER, OUTLIER_WEIGHT

FULL_WEIGHT, _LITTLE = 3.4, 6.0
"""Lengths of whitened residuals up to which a sample counts in full, exceeded by one in a hundred Gaussian samples of
three coordinates, and from which on it hardly counts."""
_LEVELS = 8
"""Parts of a covariate at most, with `LEAST_NUMBER` samples in each."""


def robust_weights(white: np.ndarray) -> np.ndarray:
    """(n,) weights of samples from whitened residuals (m, n): Huber's, falling faster far out.

    The length's scale is that of the median sample, so that what is not yet explained makes no
    outliers. Huber, Ann. Math. Stat. 35 (1964); the tail after Hampel et al., Robust Statistics (1986).
    """
    length = lengths(white)
    weights = np.minimum(1.0, FULL_WEIGHT / np.maximum(length, 1e-300))
    return weights * np.minimum(1.0, _LITTLE / np.maximum(length, 1e-300)) ** 3


def robust_loss(white: np.ndarray) -> float:
    """Huber's loss of whitened residuals (m, n): half the squared lengths of samples, and linear in those far off."""
    length = lengths(white)
    is_outlying = length > FULL_WEIGHT
    return float(
        np.where(is_outlying, FULL_WEIGHT * length - FULL_WEIGHT**2 / 2, length**2 / 2).sum()
    )


def lengths(white: np.ndarray) -> np.ndarray:
    """(n,) lengths of residuals (m, n) on the scale of a unit Gaussian in three coordinates."""
    m = len(white)
    square = (white**2).sum(0)
    # most residuals may be exactly zero: the others are then compared with a millionth of the longest
    spread = max(np.median(square) / chi2.ppf(0.5, m), 1e-12 * square.max(initial=0.0), 1e-300)
    if m == 3:
        return np.sqrt(square / spread)
    quantile = chi2.logsf(square / spread, m)
    return np.sqrt(chi2.isf(np.exp(np.maximum(quantile, -650.0)), 3))


def spread_along(white: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(n,) spread of residuals (m, n) with a like covariate x (n,), 1 on average: from medians of eighths, or fewer."""
    inner = np.unique(x)
    bin_count = int(np.clip(white.shape[1] // LEAST_NUMBER, 2, _LEVELS))
    if len(inner) > bin_count:
        inner = np.quantile(x, np.arange(1, bin_count) / bin_count)
    part = np.searchsorted(inner, x)
    square = (white**2).sum(0)
    middle = median(square, part, np.arange(part.max() + 1))
    spread = np.nan_to_num(middle, nan=1.0)
    if not spread.max() > 0:
        return np.ones(len(part))
    spread_of_sample = np.sqrt(np.maximum(spread, 1e-12 * spread.max()))[part]
    return spread_of_sample / np.sqrt((spread_of_sample**2).mean())


def spread_with(
    white: np.ndarray, covariates: Mapping[str, np.ndarray]
) -> tuple[str, float] | None:
    """The covariate with which the spread of residuals (m, n) grows or falls, and its p-value over all of them.

    The score test of Breusch & Pagan (1979) as Koenker (J. Econometrics 17, 1981) made it independent
    of the noise's kurtosis; outliers left out. None where no covariate varies.
    """
    inliers = robust_weights(white) > OUTLIER_WEIGHT
    squares = (white[:, inliers] ** 2).sum(0)
    if not np.ptp(squares) > 0:
        return None
    scores = {}
    for name, x in covariates.items():
        x = x[inliers]
        if np.ptp(x) > 0 and np.isfinite(x).all():
            correlation = np.corrcoef(squares, x)[0, 1]
            scores[name] = len(x) * correlation**2
    if not scores:
        return None
    highest = max(scores.values())
    # of covariates that say the same, the first, as it was recorded
    name = next(name for name, score in scores.items() if score > highest * (1 - 1e-6))
    p = chi2.sf(scores[name], 1)
    return name, float(min(1.0, p * len(scores)))


def spread_in_blocks(squares: np.ndarray, order: np.ndarray, pose: np.ndarray) -> float:
    """p-value that squared lengths (n,) of residuals are as large in all of eight blocks of their order (n,).

    By ranks, which no tail of the noise changes (Kruskal & Wallis, J. Am. Stat. Assoc. 47 (1952) 583). Samples of one
    pose (n,) may err together, and count as one.
    """
    _, group = np.unique(pose, return_inverse=True)
    count = np.bincount(group)
    mean, position = (np.bincount(group, x) / count for x in (squares, order))
    if len(count) < 2 * _LEVELS or np.ptp(mean) == 0:
        return 1.0
    from scipy.stats import kruskal

    in_order = mean[np.argsort(position, kind="stable")]
    return float(kruskal(*np.array_split(in_order, _LEVELS)).pvalue)


_DEGREES = np.array([1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 11, 16, 25, 50])
"""Of freedom of Student's noises, from Cauchy's to one that no sample tells from a Gaussian."""
_SCALES = np.geomspace(0.75, 1.35, 13)
"""Spreads over what the median sample says, which of thirty samples is known to a third."""
_SHARES, _MAX_SHARE = 5, 0.1
"""Shares of outliers that are tried, from half a sample to a tenth of all: more of them are a noise of their own."""
_NEAREST, _FARTHEST = 5.0, 60.0
"""Sigmas: nearer ones do no harm, farther ones are as certain."""
_MIN_GROUPED_SAMPLES = 2000
"""Samples beyond which those within `FULL_WEIGHT` sigmas stand for one another: none of them is an outlier."""


def contaminated(white: np.ndarray) -> tuple[float, np.ndarray]:
    """Log Bayes factor that some of the residuals (m, n) are outliers, and the probability (n,) of each then."""
    x = _on_scale_of_median(white)
    if x is None:
        return -np.inf, np.zeros(white.shape[1])
    chosen, counts = _thinned(x)
    shares = np.geomspace(0.5 / x.shape[1], _MAX_SHARE, _SHARES)
    outlier_density = _log_outlier_density(x)
    noises = list(_noises(len(x)))
    without_outliers, with_outliers = [], []
    for prior, density, _ in noises:
        core_density = density(x[:, chosen])
        without_outliers.append(prior + counts @ core_density)
        mixed = np.array(
            [
                counts @ _log_mixture_density(core_density, outlier_density[chosen], share)
                for share in shares
            ]
        )
        with_outliers.append(prior - np.log(_SHARES) + mixed)
    total = logsumexp(with_outliers)
    likely = []
    for weights, (_, density, _) in zip(np.exp(np.array(with_outliers) - total), noises):
        relevant = np.flatnonzero(weights > 1e-4)
        likely += [(weights[i], shares[i], density) for i in relevant]
    probability = np.zeros(x.shape[1])
    for weight, share, density in likely:
        probability += weight * np.exp(
            outlier_density
            + np.log(share)
            - _log_mixture_density(density(x), outlier_density, share)
        )
    return float(total - logsumexp(without_outliers)), probability / sum(
        weight for weight, *_ in likely
    )


def tails(white: np.ndarray) -> tuple[float, float, float]:
    """Log Bayes factor of Student's noises against a Gaussian, of residuals (m, n) without outliers.

    Then the degrees of freedom of Student's, posterior mean and standard deviation.
    """
    x = _on_scale_of_median(white)
    if x is None:
        return -np.inf, np.inf, np.inf
    chosen, counts = _thinned(x)
    noises = list(_noises(len(x)))
    logs = np.array([prior + counts @ density(x[:, chosen]) for prior, density, _ in noises])
    degrees = np.array([nu for *_, nu in noises])
    is_student = np.isfinite(degrees)
    student = logsumexp(logs[is_student])
    gauss = logsumexp(logs[~is_student])
    weights = np.exp(logs[is_student] - student)
    degrees = degrees[is_student]
    mean = float(weights @ degrees)
    deviations = (degrees - mean) ** 2
    std = float(np.sqrt(weights @ deviations))
    return float(student - gauss), mean, std


def _on_scale_of_median(white: np.ndarray) -> np.ndarray | None:
    """Residuals (m, n) in sigmas of the median sample; None where most fit exactly, or something is no number."""
    middle = float(np.median((white**2).sum(0)))
    if 0 < middle < np.inf:
        return white / np.sqrt(middle / chi2.ppf(0.5, len(white)))
    return None


def _log_mixture_density(core_density, outlier_density, share):
    """(n,) log density of a mixture."""
    return np.logaddexp(core_density + np.log1p(-share), outlier_density + np.log(share))


def _log_outlier_density(x: np.ndarray) -> np.ndarray:
    """(n,) log density of an outlier: off in any direction, or, as likely, in one coordinate alone."""
    m = len(x)
    length = np.sqrt((x**2).sum(0))
    anywhere = _log_uniform_density(length, m) - _sphere(m)
    others = _gauss(x) + 0.5 * (x**2 + np.log(2 * np.pi))
    in_coordinate = _log_uniform_density(np.abs(x), 1)
    total = logsumexp(in_coordinate + others, axis=0)
    one_coordinate = total - _sphere(1) - np.log(m)
    return np.logaddexp(anywhere, one_coordinate) - np.log(2)


def _sphere(m: int) -> float:
    """Log area of the unit sphere in m dimensions."""
    power = 0.5 * m * np.log(np.pi)
    return float(np.log(2) + power - gammaln(0.5 * m))


def _log_uniform_density(length, m):
    """Log density in m dimensions, but for the sphere's area: every logarithm of the length is as likely."""
    spread = np.log(np.log(_FARTHEST / _NEAREST))
    limited = np.clip(length, _NEAREST, _FARTHEST)
    density = -m * np.log(limited) - spread
    return np.where(length < _NEAREST, -np.inf, density)


def _noises(m: int):
    """(log prior, log density of x (m, n) as a function, degrees of freedom) of every noise.

    A Gaussian, which has infinitely many, is as likely as all Student's.
    """
    share = np.log(0.5 / len(_SCALES))
    half = np.log(2 * len(_DEGREES))
    for scale in _SCALES:
        yield share, _scaled(_gauss, scale), np.inf
        for nu in _DEGREES:
            student_median = m * fisher.ppf(0.5, m, nu)
            median = chi2.ppf(0.5, m) / student_median
            same = scale * np.sqrt(median)  # which stays
            for kind in (_joint, _log_student_density):
                yield share - half, _scaled(kind, same, nu), nu


def _scaled(density, spread, *parameters):
    """The log density of what is `spread` times as wide."""
    return lambda x: density(x / spread, *parameters) - len(x) * np.log(spread)


def _gauss(x):
    squares = (x**2).sum(0)
    volume = 0.5 * len(x) * np.log(2 * np.pi)
    return -0.5 * squares - volume


def _joint(x, nu):
    """Student's density of vectors x (m, n): a spread for each sample."""
    m = len(x)
    squares = (x**2).sum(0)
    exponent = 0.5 * (nu + m)
    return _norm(nu, m) - exponent * np.log1p(squares / nu)


def _log_student_density(x, nu):
    """Student's density of every coordinate of x (m, n) by itself."""
    exponent = 0.5 * (nu + 1)
    logs = np.log1p(x**2 / nu).sum(0)
    return len(x) * _norm(nu, 1) - exponent * logs


def _norm(nu, m):
    spread = 0.5 * m * np.log(nu * np.pi)
    return gammaln((nu + m) / 2) - gammaln(nu / 2) - spread


def _thinned(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the samples that are looked at, and how many each stands for: of many inner ones, every so many."""
    squares = (x**2).sum(0)
    inner = np.flatnonzero(squares < FULL_WEIGHT**2)
    step = max(1, len(inner) // _MIN_GROUPED_SAMPLES)
    chosen = inner[::step]
    samples = np.arange(x.shape[1])
    outer = np.setdiff1d(samples, inner)
    count = len(inner) / max(len(chosen), 1)
    counts = np.full(len(chosen), count)
    all_counts = np.concatenate([counts, np.ones(len(outer))])
    return np.concatenate([chosen, outer]), all_counts
