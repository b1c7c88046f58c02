"""Random effects of a place from sample to sample: what no recorded covariate explains still has a direction.

A joint whose cause was not recorded (its temperature, the side that it came from) and an encoder that rounds leave
no smooth function of anything, but residuals that lie along what that joint does. The test compares the direction
of each residual with the port's, given its length, so that neither heavy tails nor a wrong sigma counts.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, norm
from scipy.stats import t as student

from robot_model.effects.drift import LinkThermalGrowth
from robot_model.effects.elastic import JointCompliance
from robot_model.effects.transmission import Backlash, JointThermalDrift, TimeOffset
from workbench.core.least_squares.linear_algebra import inverse_positive, symmetric_eigen
from workbench.diagnosis.levels import MOVES, ROUNDING
from workbench.diagnosis.linear.problem import Alternative, Finding, Located, Problem, Site

QUANTISATION = "encoder-quantisation"
"""A finding on the data: readings of a joint that move at random, as counts of an encoder do."""
_NEAR = 0.5
"""Share of the clearest place's score from which on another place is about as clear: likelihoods decide then."""
_SPREADS, _TRIED = (0.05, 50.0), 40
"""Spreads that are tried, in units of the noise: from invisible to nothing else, in steps of a fifth."""
_SAME = 1e-3
"""Share of a tensor's squares below which it is the same for all samples, or for all directions."""
_ROUNDS = 30
"""Iterations for a shape (Tyler 1987): each at least halves what is left."""
_FAR = 3.0
"""Median lengths from which on a sample counts no more: one in a hundred of Gaussian ones."""
_PERIODS, _ORDERS, _CLEAR = 1.6, 400_000, 1e-4
"""How far a count may be from what its spread says, how many counts are tried, and the p-value of one."""
_GRID = 20
"""Places of a grid in the shortest wave: that costs a hundredth of its power."""
LABEL = "from sample to sample, with nothing that was recorded"
ALONG = "from sample to sample, back along the last moves"
_COLUMNS = {
    "approach": "approach",
    "temperature": "temperature",
    "payload": "payload",
    "speed": "qdot",
}


@dataclass(frozen=True)
class RandomEffect:
    """A place that moves at random from sample to sample.

    `site`: the place, with `p_value` over all sites. `spread`: of its slots, in typical sizes; `ratio`: of it to the
    noise that is left. `kurtosis`: excess kurtosis of its movement, with standard error `error` (joints alone, else
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
    """The place whose movement from sample to sample is clearest; None where none is beyond chance `level`.

    For each site the sum over samples of z' A z, A the site's covariance in typical sizes less its trace and less
    its mean over all samples (which a noise that is not round makes), over the root of its squares: normal where
    directions are chance. After the score tests of variance components: Lin, Biometrika 84 (1997) 309. That test is
    blind where a place moves all samples nearly the same way, as the last joint does what a sensor sees; so that
    the likelihoods of the directions are compared in addition, a place's and that of a noise of any one shape. Of the
    places about as clear the likeliest is taken.
    """
    m = len(problem.residual) // problem.n
    if m < 2 or len(problem.residual) != m * problem.n or not problem.sites:
        return None
    root = np.sqrt(np.maximum(problem.weights, 1e-12))[problem.sample]
    whole = (problem.clear(problem.residual) / root).reshape(m, problem.n)
    sites = [replace(site, rows=site.rows / root) for site in places(problem)]
    length = np.sqrt((whole**2).sum(0))
    z = whole * np.minimum(1.0, _FAR * np.median(length) / np.maximum(length, 1e-300))
    _, pose = np.unique(problem.pose, return_inverse=True)
    share = (
        1.0 / np.bincount(pose)[pose]
    )  # repeats of a pose err together: by Hoelder's inequality they count as one
    scores = np.array([_score(_tensor(site, m), z, pose) for site in sites])
    turns = np.array([_turned(site, z, share) for site in sites]) - _constant(z, share)
    p = (
        2
        * len(sites)
        * min(float(norm.sf(scores.max())), _TRIED * float(np.exp(-max(turns.max(), 0.0))))
    )
    if p > level:
        return None
    near = [
        site
        for site, score, turn in zip(sites, scores, turns)
        if score > _NEAR * scores.max() or turn > max(_NEAR * turns.max(), 0.0)
    ]
    likely = [_likelihood(site, z) for site in near]
    best = int(np.argmax([row[0] for row in likely]))
    own, (log, ratio, noise) = near[best], likely[best]
    spread = ratio * noise
    return RandomEffect(
        own,
        float(np.clip(p, 1e-300, 1.0)),
        spread,
        ratio,
        *_shape(own, whole),
        _rounds(own, whole, spread, problem.covariates),
        log - _of_noise(z),
    )


def places(problem: Problem) -> tuple[Site, ...]:
    """Every place that may have a random effect; all joints at once, too, as when readings are of another instant."""
    joints = [site for site in problem.sites if site.port == "joint" and not site.sharp]
    some = [site for site in (*problem.sites, *problem.growing) if not site.sharp]
    if len(joints) > 1:
        rows, typical = (
            np.concatenate([getattr(s, name) for s in joints]) for name in ("rows", "typical")
        )
        some.append(
            replace(joints[0], where="time", rows=rows, typical=typical, covariates=(), pairs=())
        )
        some.extend(_last_moves(problem, joints))
    return tuple(some)


def _last_moves(problem: Problem, joints) -> list[Site]:
    """All joints back along their last move, as when readings are taken at any moment before the arm rests."""
    held = [problem.covariates.get(site.where.replace("joint-", "move")) for site in joints]
    if any(x is None for x in held):
        return []
    metres = np.array(
        [[1e-3 if site.unit == "mm" else 1.0] for site in joints]
    )  # a slide's metre counts as a radian
    moves = np.stack(held) / np.maximum(np.abs(held * metres).max(0), 1e-300)
    row = sum(site.rows * move[problem.sample] for site, move in zip(joints, moves))
    return [
        replace(
            joints[0], where="time", rows=row, typical=joints[0].typical, covariates=(), pairs=()
        )
    ]


def _directions(site: Site, m: int) -> np.ndarray:
    """(k, m, n) what each slot does, in typical sizes."""
    return (site.rows * site.typical[:, None]).reshape(len(site.rows), m, -1)


def _tensor(site, m):
    d = _directions(site, m)
    tensor = np.einsum("kan,kbn->abn", d, d)
    made = tensor - np.eye(m)[:, :, None] * np.einsum("aan->n", tensor) / m
    return (
        made if (made**2).sum() > _SAME * (tensor**2).sum() else np.zeros_like(made)
    )  # every way alike


def _likelihood(site, z) -> tuple[float, float, float]:
    """Log likelihood of residuals z (m, n) in noise and what a site does by chance; its likeliest spread over the
    noise, and that noise."""
    d = _directions(site, len(z))
    values, vectors = symmetric_eigen(np.einsum("kan,kbn->nab", d, d))
    squares = np.einsum("nab,an->bn", vectors, z) ** 2
    spreads = np.geomspace(*_SPREADS, _TRIED) / np.sqrt(np.maximum(values.mean(), 1e-300))
    widths = 1 + spreads[:, None, None] ** 2 * values.T
    level = np.maximum((squares / widths).mean((1, 2)), 1e-300)
    logs = -0.5 * (np.log(widths).sum((1, 2)) + z.size * np.log(level))
    best = int(np.argmax(logs))
    return float(logs[best]), float(spreads[best]), float(np.sqrt(level[best]))


def _turned(site, z, share) -> float:
    """Log likelihood of the directions of residuals z (m, n) with a random effect at a site in isotropic noise.

    Against directions that are all as likely; the angular central Gaussian: Tyler, Biometrika 74 (1987) 579.
    share (n,): what each sample counts.
    """
    d = _directions(site, len(z))
    values, vectors = symmetric_eigen(np.einsum("kan,kbn->nab", d, d))
    unit = z / np.maximum(np.sqrt((z**2).sum(0)), 1e-300)
    squares = np.einsum("nab,an->bn", vectors, unit) ** 2
    spreads = np.geomspace(*_SPREADS, _TRIED) / np.sqrt(np.maximum(values.mean(), 1e-300))
    widths = 1 + spreads[:, None, None] ** 2 * values.T
    logs = (
        -0.5
        * (np.log(widths).sum(1) + len(z) * np.log(np.maximum((squares / widths).sum(1), 1e-300)))
        @ share
    )
    return float(logs.max())


def _constant(z, share) -> float:
    """As `_turned`, of noise with the one shape, the same for all samples, that is likeliest (Tyler 1987).

    One over the ratio of a place's likelihood to this is a valid p-value: the likeliest shape is no less likely than
    the true one, whose ratio is more than k by chance at most once in k times. However far each sample lies off.
    """
    unit = z / np.maximum(np.sqrt((z**2).sum(0)), 1e-300)
    m = len(unit)
    shape = np.eye(m)
    for _ in range(_ROUNDS):
        lengths = np.maximum(np.einsum("an,ab,bn->n", unit, inverse_positive(shape), unit), 1e-300)
        shape = m / share.sum() * (unit * share / lengths) @ unit.T + ROUNDING * np.eye(m)
        shape *= m / np.trace(shape)
    lengths = np.maximum(np.einsum("an,ab,bn->n", unit, inverse_positive(shape), unit), 1e-300)
    return -0.5 * (
        share.sum() * float(np.linalg.slogdet(shape)[1]) + m * float(np.log(lengths) @ share)
    )


def _of_noise(z) -> float:
    """Log likelihood of residuals z (m, n) without a random effect, on the scale of `_likelihood`."""
    return -0.5 * z.size * float(np.log(max((z**2).mean(), 1e-300)))


def _score(tensor, z, pose):
    whole, z = (tensor**2).sum(), z / np.maximum(np.sqrt((z**2).sum(0)), 1e-300)
    tensor = tensor - tensor.mean(-1, keepdims=True)
    if (
        (tensor**2).sum() <= _SAME * whole
    ):  # the same for all samples, as of a frame that the instrument moves with
        return 0.0
    each = np.bincount(pose, np.einsum("an,abn,bn->n", z, tensor, z))
    score = float(each.sum() / max(np.sqrt((each**2).sum()), 1e-300))
    number = (each**2).sum() ** 2 / max(
        (each**4).sum(), 1e-300
    )  # of samples that the sum is as good as made of
    return float(norm.isf(max(student.sf(score, number), 1e-300)))


def _moved(site, z):
    """(n,) what one slot did at each sample in typical sizes, (n,) the variance of that, (n,) how far it is seen."""
    d = _directions(site, len(z))
    own, along = (d[0] ** 2).sum(0), _along(d, z)
    noise = max(float(((z**2).sum(0) - along).mean() / (len(z) - 1)), 1e-300)
    return (d[0] * z).sum(0) / np.maximum(own, 1e-300), noise / np.maximum(own, 1e-300), own


def _shape(site, z):
    """Kurtosis (excess) of one slot's movement and its standard error, noise taken off; nan of several slots."""
    if len(site.rows) > 1:
        return np.nan, np.nan
    made, error, own = _moved(site, z)
    clear = own > np.median(own)
    made, error = made[clear] - made[clear].mean(), error[clear]
    second = float((made**2 - error).mean())
    if second <= 0:
        return np.nan, np.nan
    fourth = float((made**4 - 6 * error * second - 3 * error**2).mean())
    ratio = float((made**2).mean()) / second
    return fourth / second**2 - 3, float(np.sqrt(24 / clear.sum()) * ratio**2)


def _rounds(site, z, spread, covariates) -> float:
    """Chance, over all tried, of so clear a wave of the joint's reading with the period of rounding of this spread.

    A rounded reading errs by a sawtooth of one count, whose root mean square is the count over the root of twelve.
    """
    reading = covariates.get(site.where.replace("joint-", "q"))
    if (
        len(site.rows) > 1
        or not site.where.startswith("joint")
        or reading is None
        or not np.ptp(reading)
    ):
        return 1.0
    made, error, _ = _moved(site, z)
    weight = made / (error + spread**2)
    count = spread * float(site.typical[0]) * np.sqrt(12)
    reading, same = np.unique(reading, return_inverse=True)  # samples of one pose move together
    weight = np.bincount(same, weight)
    power, tried = _waves(reading, weight, count)
    return float(min(1.0, tried * np.exp(-power / (weight**2).sum()))) if tried else 1.0


def _waves(reading, weight, count) -> tuple[float, int]:
    """The highest power of a wave of the reading whose period is about a count, and how many were tried.

    Readings are laid on a grid of a twentieth of the shortest wave, which costs a hundredth of its power.
    """
    span, shortest = np.ptp(reading), count / _PERIODS
    shortest = max(shortest, 2 * np.pi * span / (_ORDERS * np.pi / 2))
    size = int(2 ** np.ceil(np.log2(4 * span / (shortest / _GRID))))
    laid = np.bincount(((reading - reading.min()) / shortest * _GRID).astype(int), weight, size)
    power = np.abs(np.fft.rfft(laid)) ** 2
    order = np.arange(len(power)) * (_GRID / (size * shortest))  # waves a radian
    tried = (order >= 1 / (_PERIODS * count)) & (order <= 1 / shortest)
    return float(power[tried].max(initial=0.0)), int(tried.sum())


def _along(d, z):
    """(n,) square of the part of z along the first slot."""
    return (d[0] * z).sum(0) ** 2 / np.maximum((d[0] ** 2).sum(0), 1e-300)


def evened_by(problem: Problem, random_effect: RandomEffect) -> Problem:
    """The problem with residuals, and all that is compared with them, also whitened by a site's random effect."""
    m = len(problem.residual) // problem.n
    mine = _which(random_effect.site)
    site = next(s for s in places(problem) if _which(s) == mine)
    d = _directions(site, m)
    covariance = np.eye(m)[:, :, None] + random_effect.ratio**2 * np.einsum("kan,kbn->abn", d, d)
    values, vectors = symmetric_eigen(covariance.transpose(2, 0, 1))
    root = np.einsum(
        "nab,nb,ncb->acn",
        vectors,
        random_effect.ratio / random_effect.spread / np.sqrt(values),
        vectors,
    )

    def white(rows):
        return np.einsum("abn,kbn->kan", root, rows.reshape(-1, m, problem.n)).reshape(rows.shape)

    return problem.through(white)


def _which(site: Site) -> tuple:
    """What tells a place from all others: all joints, and all along their last moves, are both of the clock."""
    return site.where, site.port, len(site.rows)


def residual_random_effect(
    problem: Problem, where: str, port: str, level: float
) -> RandomEffect | None:
    """The random effect that a smooth nonparametric alternative leaves at its own place; None if there is none.

    By the likelihood ratio of the spread, on the border of what it can be (Self & Liang, JASA 82, 1987).
    """
    m = len(problem.residual) // problem.n
    site = next((s for s in places(problem) if (s.where, s.port) == (where, port)), None)
    if site is None or m < 2 or len(problem.residual) != m * problem.n:
        return None
    root = np.sqrt(np.maximum(problem.weights, 1e-12))[problem.sample]
    site, z = (
        replace(site, rows=site.rows / root),
        (problem.clear(problem.residual) / root).reshape(m, problem.n),
    )
    best, ratio, noise = _likelihood(site, z)
    gain = best - _of_noise(z)
    p = 0.5 * float(chi2.sf(max(2 * gain, 0.0), 1))
    return (
        RandomEffect(site, max(p, 1e-300), ratio * noise, ratio, np.nan, np.nan, 1.0, gain)
        if p < level
        else None
    )


def movement(random_effect: RandomEffect) -> float:
    """Sum of squares of all that it moves, in sigmas."""
    return float((random_effect.spread**2 * _directions(random_effect.site, 1) ** 2).sum())


def random_effect_finding(random_effect: RandomEffect, problem: Problem) -> Finding:
    """In words of the vocabulary: rounding where it follows the reading's counts, else an unknown and what may lack."""
    size = float(np.sqrt(movement(random_effect) / len(problem.residual)))
    given = (
        random_effect.p_value,
        1.0 - random_effect.p_value,
        size,
        size**2 * len(problem.residual),
    )
    if random_effect.rounds < _CLEAR:
        return Finding(QUANTISATION, random_effect.site.where, "", (), *given)
    label = ALONG if _which(random_effect.site)[::2] == ("time", 1) else LABEL
    return Finding(
        "unknown",
        random_effect.site.where,
        label,
        (),
        *given,
        alternatives=hidden(random_effect, problem),
    )


def hidden(random_effect: RandomEffect, problem: Problem) -> tuple[Alternative, ...]:
    """What could do it through a covariate that the recording does not hold, the likelier first."""
    site, held = random_effect.site, problem.covariates
    two = abs(random_effect.kurtosis + 2) < min(
        2 * random_effect.error, abs(random_effect.kurtosis)
    )  # two values: a coin's kurtosis
    warm = _warm(site)
    if site.port == "joint" and site.where != "time":
        rows = [(Backlash.effect, site.where, "by the side of approach", "approach"), *warm][
            :: 1 if two else -1
        ]
        rows.append(_loaded(site))
    else:
        rows = warm
    if site.port != "geometry":
        rows.append((TimeOffset.effect, "time", "", "speed"))
    return _lacking(rows, held)


def unrecorded(problem: Problem, place: Located) -> tuple[Alternative, ...]:
    """What could make what a place shows of a covariate that was not recorded; problem: without what is said of it.

    Where the place moves from sample to sample besides, what `hidden` says of that; where it goes with time, what
    changes with time.
    """
    found = find_random_effect(problem, MOVES)
    if found is not None and found.site.where == place.where:
        return hidden(found, problem)
    if "time" not in place.depends_on:
        return ()
    rows = [*_warm(place), *([_loaded(place)] if place.port == "joint" else [])]
    return _lacking(rows, problem.covariates)


def _warm(place) -> list[tuple]:
    effect = JointThermalDrift.effect if place.port == "joint" else LinkThermalGrowth.effect
    return (
        [(effect, place.where, "", "temperature")]
        if place.where.startswith(("joint", "link"))
        else []
    )


def _loaded(place) -> tuple:
    return JointCompliance.effect, place.where, "", "payload"


def _lacking(rows, held) -> tuple[Alternative, ...]:
    """Rows (effect, where, variant, kind of covariate) whose covariate is not among those `held`, as alternatives."""
    rows = [
        row
        for row in rows
        if not any(_COLUMNS[row[-1]] in name and np.ptp(x) > 0 for name, x in held.items())
    ]
    shares = 0.5 ** np.arange(1, len(rows) + 1)
    why = "it needs what was not recorded"
    return tuple(
        Alternative(*row[:3], float(share), 1.0, why, row[3]) for row, share in zip(rows, shares)
    )


def place_of(random_effect: RandomEffect) -> Located:
    """The place as the answer lists it: nothing goes with its movement, its size is the spread."""
    return Located(
        random_effect.site.where,
        random_effect.site.port,
        (),
        0.0,
        random_effect.p_value,
        random_effect.spread,
    )


__all__ = [
    "RandomEffect",
    "residual_random_effect",
    "evened_by",
    "hidden",
    "movement",
    "place_of",
    "find_random_effect",
    "random_effect_finding",
    "unrecorded",
]
