"""Whether some samples come from another process: a few of them far out, against heavier tails of all.

The noise of the others is Gaussian or Student's, each sample's or each coordinate's, of unknown spread and degrees of
freedom; all of that is summed over. An outlier may lie from five to sixty sigmas off, in any direction or along one
axis. One over the Bayes factor of "some are outliers" against "none is" is a valid p-value on average over these
noises: by Markov's inequality the factor passes k by chance at most once in k times (Vovk & Wang, Ann. Stat. 49 (2021),
1736, on e-values).
"""

import numpy as np
from scipy.special import gammaln, logsumexp

from workbench.core.distributions import chi2, fisher
from workbench.diagnosis.noise.outliers import FULL_WEIGHT

_DEGREES = np.array([1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 11, 16, 25, 50])
"""Of freedom of Student's noises, from Cauchy's to one that no sample tells from a Gaussian."""
_SCALES = np.geomspace(0.75, 1.35, 13)
"""Spreads over what the median sample says, which of thirty samples is known to a third."""
_SHARES, _MOST = 5, 0.1
"""Shares of outliers that are tried, from half a sample to a tenth of all: more of them are a noise of their own."""
_NEAREST, _FARTHEST = 5.0, 60.0
"""Sigmas: nearer ones do no harm, farther ones are as certain."""
_MANY = 2000
"""Samples beyond which those within `FULL_WEIGHT` sigmas stand for one another: none of them is an outlier."""


def contaminated(white: np.ndarray) -> tuple[float, np.ndarray]:
    """Log Bayes factor that some of the residuals (m, n) are outliers, and the probability (n,) of each then."""
    middle = float(np.median((white**2).sum(0)))
    # most fit exactly, or something is no number: there is no noise to judge by
    if not 0 < middle < np.inf:
        return -np.inf, np.zeros(white.shape[1])
    x = white / np.sqrt(middle / chi2.ppf(0.5, len(white)))
    chosen, counts = _thinned(x)
    shares = np.geomspace(0.5 / x.shape[1], _MOST, _SHARES)
    far, noises = _far(x), list(_noises(len(x)))
    none, some = [], []
    for prior, density in noises:
        near = density(x[:, chosen])
        none.append(prior + counts @ near)
        mixed = np.array([counts @ _mixed(near, far[chosen], share) for share in shares])
        some.append(prior - np.log(_SHARES) + mixed)
    total = logsumexp(some)
    likely = []
    for weights, (_, density) in zip(np.exp(np.array(some) - total), noises):
        kept = np.flatnonzero(weights > 1e-4)
        likely += [(weights[i], shares[i], density) for i in kept]
    each = np.zeros(x.shape[1])
    for weight, share, density in likely:
        each += weight * np.exp(far + np.log(share) - _mixed(density(x), far, share))
    return float(total - logsumexp(none)), each / sum(weight for weight, *_ in likely)


def _mixed(near, far, share):
    """(n,) log density of a mixture."""
    return np.logaddexp(near + np.log1p(-share), far + np.log(share))


def _far(x: np.ndarray) -> np.ndarray:
    """(n,) log density of an outlier: off in any direction, or, as likely, in one coordinate alone."""
    m = len(x)
    anywhere = _off(np.sqrt((x**2).sum(0)), m) - _sphere(m)
    others = _gauss(x) + 0.5 * (x**2 + np.log(2 * np.pi))
    along = logsumexp(_off(np.abs(x), 1) + others, axis=0) - _sphere(1) - np.log(m)
    return np.logaddexp(anywhere, along) - np.log(2)


def _sphere(m: int) -> float:
    """Log area of the unit sphere in m dimensions."""
    return float(np.log(2) + 0.5 * m * np.log(np.pi) - gammaln(0.5 * m))


def _off(length, m):
    """Log density in m dimensions, but for the sphere's area: every logarithm of the length is as likely."""
    spread = np.log(np.log(_FARTHEST / _NEAREST))
    inside = -m * np.log(np.clip(length, _NEAREST, _FARTHEST)) - spread
    return np.where(length < _NEAREST, -np.inf, inside)


def _noises(m: int):
    """(log prior, log density of x (m, n) as a function) of every noise: Gaussian as likely as all Student's."""
    share, half = np.log(0.5 / len(_SCALES)), np.log(2 * len(_DEGREES))
    for scale in _SCALES:
        yield share, _scaled(_gauss, scale)
        for nu in _DEGREES:
            median = chi2.ppf(0.5, m) / (m * fisher.ppf(0.5, m, nu))
            same = scale * np.sqrt(median)  # which stays
            for kind in (_joint, _each):
                yield share - half, _scaled(kind, same, nu)


def _scaled(density, spread, *of):
    """The log density of what is `spread` times as wide."""
    return lambda x: density(x / spread, *of) - len(x) * np.log(spread)


def _gauss(x):
    return -0.5 * (x**2).sum(0) - 0.5 * len(x) * np.log(2 * np.pi)


def _joint(x, nu):
    """Student's density of vectors x (m, n): a spread for each sample."""
    m = len(x)
    return _norm(nu, m) - 0.5 * (nu + m) * np.log1p((x**2).sum(0) / nu)


def _each(x, nu):
    """Student's density of every coordinate of x (m, n) by itself."""
    return len(x) * _norm(nu, 1) - 0.5 * (nu + 1) * np.log1p(x**2 / nu).sum(0)


def _norm(nu, m):
    return gammaln((nu + m) / 2) - gammaln(nu / 2) - 0.5 * m * np.log(nu * np.pi)


def _thinned(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the samples that are looked at, and how many each stands for: of many inner ones, every so many."""
    inner = np.flatnonzero((x**2).sum(0) < FULL_WEIGHT**2)
    step = max(1, len(inner) // _MANY)
    chosen = inner[::step]
    outer = np.setdiff1d(np.arange(x.shape[1]), inner)
    counts = np.full(len(chosen), len(inner) / max(len(chosen), 1))
    return np.concatenate([chosen, outer]), np.concatenate([counts, np.ones(len(outer))])
