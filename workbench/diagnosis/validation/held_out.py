"""Errors of samples that were left out, and whether a fall of them is real."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future

import numpy as np

from workbench.core.covariates import clock
from workbench.core.distributions import chi2, norm, student
from workbench.core.effect import Effect
from workbench.core.model import Model
from workbench.diagnosis.levels import (
    CRITICAL_CLARK_WEST_T,
    CRITICAL_T,
    LEAST_NUMBER,
    NEGLIGIBLE_SHARE,
)
from workbench.diagnosis.linear.problem import Problem, cached
from workbench.diagnosis.noise.data_findings import is_move_known
from workbench.diagnosis.validation.folds import tested_samples
from workbench.diagnosis.validation.left_out_blocks import (
    block_shares,
    decorrelated,
    left_out_rows,
)
from workbench.fitting.cross_validation import HeldOut, hold_out, pad_to_position

_LIMIT, _MEDIAN = 2.8, float(chi2.ppf(0.5, 3))
"""Length on the scale of the median sample from which on an error counts by its length and not by its square, as in
the fit (5 % of clean samples are beyond it), and the median of a squared length of three coordinates."""


DOUBLED = 2.0
"""t of Clark and West over that of the fall of the error, about, for an effect that is there."""
_ROWS = 5
"""Rows of the errors of an arm's samples: distance, rotation angle, and three components of the position."""


def rms(errors: np.ndarray, inliers: np.ndarray, sigma: np.ndarray | None = None) -> float:
    """Root mean square of the errors (n,) that there are, of the inliers; with sigma (n,) in the errors' unit
    each weighs as in a fit."""
    used = inliers & np.isfinite(errors)
    if not used.any():
        return float("nan")
    weights = None if sigma is None else sigma[used] ** -2.0
    return float(np.sqrt(np.average(errors[used] ** 2, weights=weights)))


def rms_pair(
    before: np.ndarray, after: np.ndarray, inliers: np.ndarray, sigma: np.ndarray | None = None
) -> tuple[float, float]:
    """RMS of the errors (n,) without and with some terms, as of `rms`, of the samples that both predict.

    Where the squares rise and Huber's loss falls, a few samples far off decide on the squares: errors then count by
    the loss, which decides on a term in every other place (`paired_t`).
    """
    used = _compared(inliers, before, after)
    plain = rms(before, used, sigma), rms(after, used, sigma)
    if plain[1] < plain[0] or not used.any():
        return plain
    if sigma is None:
        unit = np.ones(int(used.sum()))
    else:
        unit = sigma[used]
    errors = before[used] / unit, after[used] / unit
    losses = _loss(_scaled(*errors))
    squares = losses * _scale(*errors)
    total_weight = (unit**-2.0).sum()
    base, with_it = np.sqrt(squares.sum(1) / total_weight)
    if with_it < base:
        return (float(base), float(with_it))
    return plain


def _compared(inliers: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(n,) bool: inliers whose errors (n,) are known both without and with some terms."""
    return inliers & np.isfinite(before) & np.isfinite(after)


def paired_t(
    pose: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    inliers: np.ndarray,
    sigma: np.ndarray | None = None,
) -> float:
    """t of the falls of the loss, one fall a pose: their mean over its standard error.

    The loss is Huber's, as in every fit: of squares alone, a few poses that lie far off own the spread of all falls,
    and what helps nine tenths of the poses is called luck (Diebold & Mariano, J. Bus. Econ. Stat. 13 (1995), leave the
    loss free). Its scale is that of the median sample, of the smaller errors of the two.

    sigma (n,): noise of each sample where they are not all of one kind, as corners, stripes on boards and stripes on
    balls are not. Errors then count in it and a pose by all of its samples, see `_jackknife_t`.
    """
    used = _compared(inliers, before, after)
    _, group = np.unique(pose[used], return_inverse=True)
    if not used.any() or group.max() < 2:
        return 0.0
    unit = 1.0 if sigma is None else sigma[used]
    scaled = _scaled(before[used] / unit, after[used] / unit)
    base, with_it = _loss(scaled)
    falls = np.bincount(group, base - with_it)
    if sigma is not None:
        moved = np.bincount(group, _moved(base, with_it))
        return _jackknife_t(falls, moved)
    return _t_of_mean(falls / np.bincount(group))


def _t_of_mean(falls: np.ndarray) -> float:
    """Mean of independent values over its standard error; 0 where they are all equal."""
    spread = falls.std(ddof=1) / np.sqrt(len(falls))
    if spread > 0:
        return float(falls.mean() / spread)
    return 0.0


def significance(
    pose: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    inliers: np.ndarray,
    sigma: np.ndarray | None = None,
) -> float:
    """t of a gain, of components (m, n) of the errors without and with it.

    That of `clark_west_t`, or with sigma (n,) of `paired_t`; `critical_t` is the level for either.
    """
    if sigma is None:
        return clark_west_t(pose, before, after, inliers)
    return paired_t(
        pose, *(np.sqrt((errors**2).sum(0)) for errors in (before, after)), inliers, sigma
    )


def critical_t(sigma: np.ndarray | None) -> float:
    """t above which a gain is significant: of `clark_west_t`, or with sigma of `paired_t`."""
    return CRITICAL_CLARK_WEST_T if sigma is None else CRITICAL_T


def rises_significantly(t: float, sigma: np.ndarray | None) -> bool:
    """Whether a t says that the error significantly rises: of `clark_west_t`, or with sigma of `paired_t`."""
    return t < (-DOUBLED * CRITICAL_T if sigma is None else -CRITICAL_T)


def clark_west_t(
    pose: np.ndarray, before: np.ndarray, after: np.ndarray, inliers: np.ndarray
) -> float:
    """t of the change of the predictions by some terms in the errors without them; before, after (m, n) mm.

    Of two nested models the larger pays for its coefficients even where it is right: squared errors fall by
    2 e'd - d'd, with the error e without the terms and the change d of the prediction, and d'd is no evidence against
    them. Clark & West, J. Econometrics 138 (2007), test the mean of e'd alone, whose t is about twice that of the
    fall. Their test is of forecasts in time; errors by Huber's loss, blocks left out in turn and the standard error
    by `_jackknife_t` are an extension. Where the loss does not fall, it is the t of `paired_t` on the same scale.
    Poses in the order of their rows may err alike; the standard error then allows for it, see `_serial_factor`.
    """
    lengths = [np.sqrt((errors**2).sum(0)) for errors in (before, after)]
    fall = paired_t(pose, *lengths, inliers)
    used = inliers & np.isfinite(before).all(0) & np.isfinite(after).all(0)
    if not fall > 0:
        return DOUBLED * fall
    _, first, group, count = np.unique(
        pose[used], return_index=True, return_inverse=True, return_counts=True
    )
    change = before[:, used] - after[:, used]
    scaled = _scaled(lengths[0][used], lengths[1][used])
    size = np.sqrt(scaled[0])
    weight = np.minimum(1.0, _LIMIT / np.maximum(size, _LIMIT))
    projection = (before[:, used] * change).sum(0)
    score = np.bincount(group, weight * projection) / count
    squared_change = (change**2).sum(0)
    moved = np.bincount(group, weight * squared_change) / count
    order = np.argsort(first)
    return _jackknife_t(score[order], moved[order], in_order=True)


def _scaled(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(2, k) squared errors on the scale of the median sample of the smaller errors."""
    return np.stack([before, after]) ** 2 / _scale(before, after)


def _scale(before: np.ndarray, after: np.ndarray) -> float:
    """Square of the scale of the median sample, of the smaller of some errors (k,)."""
    squares = np.stack([before, after]) ** 2
    return max(float(np.median(squares, axis=1).min()) / _MEDIAN, 1e-300)


def _jackknife_t(falls: np.ndarray, moved: np.ndarray, in_order: bool = False) -> float:
    """t of the sum of the falls (p,) of the loss of poses with different sensitivity `moved` (p,) to an effect.

    in_order: whether the poses are in the order in which they were measured.

    An effect changes the prediction of some poses a lot and of others not at all: that of a ball is independent of the
    board, that of a board perpendicular to the light hardly changes. If the effect is present, the fall of a pose is
    proportional to the square of this change. Only the deviations from this proportionality enter the standard error,
    each pose by the proportion of all others (jackknife: MacKinnon & White, J. Econometrics 29 (1985)), so that a
    single pose that shows nearly all of an effect proves little.
    """
    total, shown = falls.sum(), moved.sum()
    shown_by_others = shown - moved  # by all others
    others = np.divide(
        total - falls,
        shown_by_others,
        out=np.zeros_like(falls),
        where=shown_by_others > NEGLIGIBLE_SHARE * shown,
    )
    remaining = falls - others * moved
    spread = np.sqrt((remaining**2).sum() * (len(falls) - 1) / len(falls))
    spread *= np.sqrt(_serial_factor(remaining)) if in_order else 1.0
    if not spread > 0:
        return 0.0
    # t as a normal would have it
    p = np.clip(student.sf(total / spread, _effective_number(moved)), 1e-300, 1 - 1e-16)
    return float(norm.isf(p))


def _effective_number(moved: np.ndarray) -> float:
    """Number of poses that would show an effect equally and determine it as well, `moved` (p,) what each shows."""
    return float(max(moved.sum() ** 2 / max((moved**2).sum(), 1e-300), 1.0))


def showing_poses(
    pose: np.ndarray, before: np.ndarray, after: np.ndarray, inliers: np.ndarray, sigma: np.ndarray
) -> float:
    """Effective number of poses that show an effect: before, after (n,) errors without and with it, sigma (n,)."""
    used = _compared(inliers, before, after)
    if not used.any():
        return 1.0
    _, group = np.unique(pose[used], return_inverse=True)
    scaled = _scaled(before[used] / sigma[used], after[used] / sigma[used])
    losses = _loss(scaled)
    moved = np.bincount(group, _moved(*losses))
    return _effective_number(moved)


def _moved(base: np.ndarray, with_it: np.ndarray) -> np.ndarray:
    """(n,) squared change of the errors between two losses (n,)."""
    return (np.sqrt(base) - np.sqrt(with_it)) ** 2


def _serial_factor(series: np.ndarray) -> float:
    """Variance of the sum of a series (p,) over that of independent values, at least 1.

    1 unless neighbours are significantly alike; then the heteroscedasticity and autocorrelation consistent estimate
    with Bartlett's weights (Newey & West, Econometrica 55 (1987)), its lags by the rule of Andrews, Econometrica 59
    (1991), eq. 6.4, for an autoregressive process.
    """
    count = len(series)
    variance = float(series @ series)
    if count < LEAST_NUMBER or not variance > 0:
        return 1.0
    rho = float(series[1:] @ series[:-1]) / variance
    if rho * np.sqrt(count) < CRITICAL_T:
        return 1.0
    alpha = 4 * rho**2 / ((1 - rho) * (1 + rho)) ** 2
    bandwidth = 1.1447 * (alpha * count) ** (1 / 3)
    lags = np.arange(1, min(int(bandwidth), count // 4) + 1)
    products = np.array([series[k:] @ series[:-k] for k in lags])
    correlations = products / variance
    bartlett = 1 - lags / (len(lags) + 1)
    return float(max(1.0, 1 + 2 * (bartlett * correlations).sum()))


def _loss(z: np.ndarray) -> np.ndarray:
    """Huber's loss of squared lengths z."""
    linear = 2 * _LIMIT * np.sqrt(z) - _LIMIT**2
    return np.where(z < _LIMIT**2, z, linear)


def sigma_of(bench, samples: np.ndarray | None = None) -> np.ndarray | None:
    """(n,) noise (px) of each of some samples (n,) bool (None: all) of a bench that has them of several kinds."""
    sigma = bench.sigma
    if sigma is None or samples is None:
        return sigma
    return sigma[samples]


class Errors:
    """Held-out errors of a bench, each set of effects and folds once.

    Errors are distances (n,) in mm or px; `angles_of` gives the rotation angles that belong to them. independent: those
    of a sensor without what samples of one board pose share, to be compared and not to be shown.
    """

    def __init__(self, bench, independent: bool = False):
        self.bench, self._independent = bench, independent
        self._blocks: dict[tuple, np.ndarray] = {}
        self._rows: dict[bytes, np.ndarray] = {}
        self._problems: dict[tuple, Problem] = {}
        self._begun: dict[tuple, Future[HeldOut]] = {}

    def __call__(self, effects: Sequence[Effect], fold: np.ndarray) -> np.ndarray:
        """(n,) each sample predicted from the other folds (n,) int."""
        return self.predicted(fold, dict.fromkeys(np.unique(fold).tolist(), effects))

    def prepare(self, effects: Sequence[Effect], block: np.ndarray) -> None:
        """Make and keep the errors of one block (n,) bool, without and with some effects."""
        self._block((), block)
        self._block(effects, block)

    def begin(
        self,
        effects: Sequence[Effect],
        folds: Sequence[np.ndarray],
        submit: Callable[..., Future],
    ) -> None:
        """Have the errors of an arm with some effects made elsewhere, block by block of some folds (n,) int.

        submit(function, *arguments): gives what the function returns later. Only where all samples are tested: there
        the solution with these effects is the one that other steps of the proof use, too.
        """
        if tested_samples(self.bench) is not None:
            return
        model, fit, _ = self.bench.solve(effects, is_complete=False)
        sent = Model(model.chain, model.effects)  # without its bases, which are megabytes
        for block in [fold == k for fold in folds for k in np.unique(fold)]:
            key = _key(effects, block)
            if key not in self._blocks and not self._is_undetermined_without(effects, block):
                self._begun[key] = submit(hold_out, sent, fit.parameters, block, ~block, "huber")

    def predicted(self, fold: np.ndarray, chosen: Mapping[int, Sequence[Effect]]) -> np.ndarray:
        """(n,) errors where every fold is predicted with effects of its own."""
        rows = np.empty((_ROWS, len(fold)))
        for k, effects in chosen.items():
            is_block = fold == k
            rows[:, fold == k] = self._block(effects, is_block)
        if self.bench.chain is not None:  # a sensor has distances alone
            self._rows[rows[0].tobytes()] = rows
        return rows[0]

    def angles_of(self, errors: np.ndarray) -> np.ndarray:
        """(n,) rotation angles (deg) of the predictions whose distances (n,) this object returned.

        nan where no orientation is measured.
        """
        return self._rows_of(errors)[1]

    def components_of(self, errors: np.ndarray) -> np.ndarray:
        """(3, n) components (mm) of the predictions whose distances (n,) this object returned; nan for a sensor."""
        return self._rows_of(errors)[2:]

    def _rows_of(self, errors: np.ndarray) -> np.ndarray:
        """(5, n) rows that belong to distances (n,); nan where this object did not return these."""
        unknown = np.full((_ROWS, len(errors)), np.nan)
        return self._rows.get(errors.tobytes(), unknown)

    def _block(self, effects, block: np.ndarray) -> np.ndarray:
        """(5, k) distances, angles (deg, nan where there are none) and components of the samples of one block (n,)."""
        predict = self._of_sensor if self.bench.chain is None else self._of_arm
        return cached(self._blocks, _key(effects, block), lambda: predict(effects, block)[:, block])

    def _of_sensor(self, effects, block: np.ndarray) -> np.ndarray:
        """(5, n): px and nan."""
        folds = np.where(block, 0, -1)
        distances = self.bench.held_out(effects, folds, independent=self._independent)
        unknown = np.full((_ROWS - 1, len(distances)), np.nan)
        return np.stack([distances, *unknown])

    def _of_arm(self, effects, block: np.ndarray) -> np.ndarray:
        """(5, n): mm, deg and mm; nan where the others do not tell on which side of an instant a sample lies.

        Where the others leave a direction open (all have the tool upright, say), it stays where all samples have it.
        """
        out = np.full((_ROWS, len(block)), np.nan)
        if self._is_undetermined_without(effects, block):
            problem = self.bench.problem(effects, hypotheses=False).conditional_on()
            folds = np.where(block, 0, -1)
            rows = left_out_rows(problem, folds, only=0)
            out[:2] = _lengths_of(problem, rows)
            out[2:] = pad_to_position(_components_of(problem, rows))
            return self._without_ambiguous(out, effects, block)
        found = self._held_out(effects, block)
        out[0], out[2:] = np.sqrt(found.squares), found.position
        if len(found.rotation):
            squared_rotation = (found.rotation**2).sum(0)
            out[1] = np.rad2deg(np.sqrt(squared_rotation))
        return self._without_ambiguous(out, effects, block)

    def _held_out(self, effects, block: np.ndarray) -> HeldOut:
        """A block predicted by a fit of the others; the one that was begun elsewhere, if any."""
        begun = self._begun.pop(_key(effects, block), None)
        if begun is not None:
            return begun.result()
        model, fit, _ = self.bench.solve(effects, is_complete=False)
        return hold_out(model, fit.parameters, block, ~block, "huber")

    def _without_ambiguous(self, rows: np.ndarray, effects, block: np.ndarray) -> np.ndarray:
        """Rows (5, n) with nan for held-out samples that the effects of the others do not predict."""
        rows[:, is_ambiguous(self.bench, effects, block)] = np.nan
        return rows

    def _is_undetermined_without(self, effects, block: np.ndarray) -> bool:
        """Whether a direction of the fit is determined by the samples of a block (n,) bool alone."""
        part = tested_samples(self.bench)
        problem = self._tested_problem(effects, part)
        samples_of_block = block if part is None else block[part]
        rows = samples_of_block[problem.sample]
        largest_share = block_shares(problem, rows).max(initial=0.0)
        return largest_share > 1 - NEGLIGIBLE_SHARE

    def _tested_problem(self, effects, part: np.ndarray | None) -> Problem:
        """The problem with some effects on the tested samples (n,) bool; the last one is kept for its other blocks."""
        key = tuple(sorted(map(name_of, effects)))
        if key not in self._problems:
            problem = self.bench.problem(effects, part, hypotheses=False)
            self._problems = {key: problem.conditional_on()}
        return self._problems[key]


def is_ambiguous(
    bench, effects: Sequence[Effect], block: np.ndarray, samples: np.ndarray | None = None
) -> np.ndarray:
    """(n,) bool: held-out samples between the others just before and just after an instant, and some first poses.

    block (n,) bool: the samples held out, of some samples (None: all) of a bench of an arm. The other samples show that
    a step lies between these two, and not on which side of a sample between them. Nor is the first pose predicted by
    effects of the last move.
    """
    state = bench.chain.state
    used = slice(None) if samples is None else samples
    is_known = is_move_known(state.covariates, effects)
    out = ~(np.ones(len(bench.pose), bool) & is_known)[used]
    # of each arm pose of a sample
    times = clock(state).reshape(-1, len(bench.pose))[:, used]
    instants = {getattr(effect, "after", None) for effect in effects}
    for after in instants - {None}:
        others = times[:, ~block]
        before = others[others <= after].max(initial=-np.inf)
        next_one = others[others > after].min(initial=np.inf)
        out |= (block & (times > before) & (times < next_one)).any(0)
    return out


def _key(effects: Sequence[Effect], block: np.ndarray) -> tuple:
    """Of the errors of a block (n,) bool with some effects, in any order."""
    return tuple(sorted(map(name_of, effects))), block.tobytes()


def name_of(effect: Effect) -> str:
    """Unique key of an effect."""
    return f"{type(effect).__qualname__} {effect.effect} {effect.where} {effect.options}"


def left_out(problem: Problem, fold: np.ndarray) -> np.ndarray:
    """(n,) length of each sample's position residual (mm, px) when its block of `fold` (n,) int is left out."""
    return _lengths_of(problem, left_out_rows(problem, fold))[0]


def nested_components(
    smaller: Problem, fold: np.ndarray, errors: Sequence[np.ndarray], scored: bool = False
) -> list[np.ndarray]:
    """(m, n) components (mm, px), 0 where a sample has fewer, of left-out rows (N,) of two nested models.

    smaller: the problem of the smaller model; fold (n,): as of `left_out`. All errors are decorrelated by the
    covariance of the smaller model's: what another term leaves uncertain in a block (a drift that begins shortly before
    it) is in the errors of both, and would hide the tested term. scored: the rows are scores, which contain that
    covariance.
    """
    if not scored:
        errors = decorrelated(smaller, fold, np.stack(errors))
    return [_components_of(smaller, rows) for rows in errors]


def _components_of(problem: Problem, rows: np.ndarray) -> np.ndarray:
    """(m, n) components (mm, px) of the positions among residuals (N,); 0 where a sample has fewer than others."""
    position = slice(None) if problem.rotation is None else ~problem.rotation
    sample = problem.sample[position]
    rows = rows[position]
    order = np.argsort(sample, kind="stable")
    count = np.bincount(sample, minlength=problem.n)
    first = np.cumsum(count) - count
    number = np.arange(len(sample)) - np.repeat(first, count)
    out = np.zeros((count.max(initial=1), problem.n))
    out[number, sample[order]] = rows[order]
    return out


def _lengths_of(problem: Problem, out: np.ndarray) -> np.ndarray:
    """(2, n) lengths of position (mm, px) and orientation (deg, nan where none is measured) of residuals (N,)."""
    if problem.rotation is None:
        squares = np.bincount(problem.sample, out**2, minlength=problem.n)
        lengths = np.sqrt(squares)
        angles = np.full_like(lengths, np.nan)
        return np.stack([lengths, angles])
    kinds = [np.where(part, out, 0.0) for part in (~problem.rotation, problem.rotation)]
    lengths = [np.sqrt(np.bincount(problem.sample, kind**2, minlength=problem.n)) for kind in kinds]
    return np.stack([lengths[0], np.rad2deg(lengths[1])])
