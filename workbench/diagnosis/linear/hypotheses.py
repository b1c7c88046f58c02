"""All hypotheses, judged at once: library effects at every place, and smooth nonparametric alternatives."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, logsumexp

from workbench.core.effect import Effect
from workbench.diagnosis.levels import CHUNK_SIZE, MOST_LISTED, RARE_PRIOR
from workbench.diagnosis.linear.candidates import Candidate, Scan, Site, Source
from workbench.diagnosis.linear.evidence import (
    Moments,
    Projected,
    Scores,
    scan_moments,
)
from workbench.diagnosis.linear.problem import Located, Problem

SMOOTH_LEVEL = 0.3
"""Share of the error level that the smooth nonparametric alternatives receive."""
_TAIL = 2.0
"""Power with which the prior of a parameter falls beyond its largest plausible value: a hundredth at ten times it."""


@dataclass(frozen=True)
class Hypothesis:
    """One possibly missing effect, judged conditional on a fitted baseline.

    `evidence`: log Bayes factor against nothing; `p`: of its F test by itself; `gain`, `rank` as in `Scores`. `mass`:
    of this variant's prior, relative to others of its `family`; `log_prior`: of this variant; `log_bonus`: what other
    terms add to it; `weight`: its share of the error level of the whole search. `smooth_covariates`: covariates of a
    smooth nonparametric alternative, () for a named effect. `source`: a Candidate, or a Scan or Site of which the
    `value` is an option or names of covariates.
    """

    effect: str
    where: str
    label: str
    family: str = ""
    effects: tuple[Effect, ...] = ()
    source: Source | None = None
    value: float | tuple[str, ...] | None = None
    prior_weight: float = 1.0
    evidence: float = 0.0
    p: float = 1.0
    gain: float = 0.0
    rank: int = 1
    smooth_covariates: tuple[str, ...] = ()
    missing_covariate: str = ""
    coexists: bool = True
    log_prior: float = 0.0
    weight: float = 1.0
    log_bonus: float = 0.0

    @property
    def log_weight(self) -> float:
        """Log of prior times evidence."""
        return self.log_prior + self.log_bonus + self.evidence

    @property
    def key(self) -> tuple[str, str]:
        """Effect and place, by which an answer is scored."""
        if not self.smooth_covariates:
            return (self.effect, self.where)
        return ("unknown", self.where)

    @property
    def reads(self) -> set[str]:
        """Covariates of which a law of one joint is a function; none of other laws."""
        is_of_joint = self.effects and self.where.startswith("joint-")
        if is_of_joint:
            return set(self.effects[0].reads)
        return set()

    @property
    def needs_compliance(self) -> bool:
        """Whether it acts through the compliances of the model alone, see `Effect`."""
        return any(effect.needs_compliance for effect in self.effects)

    @property
    def carries_load(self) -> bool:
        """Whether other effects act through it, as a load acts through a compliance; see `Effect`."""
        return any(effect.carries_load for effect in self.effects)

    def columns(self, problem: Problem) -> np.ndarray:
        """(N, P) whitened columns in typical sizes."""
        return self.source.columns_at(problem, self.value)

    def at(self, problem: Problem) -> "Hypothesis | None":
        """The same with its columns at another solution; its evidence stays. None where that does not compare it."""
        source = problem.sources.get(self.source.key)
        return None if source is None else replace(self, source=source)


def ranked_hypotheses(
    problem: Problem,
    required: Sequence = (),
    functions: bool = True,
    laws: Callable[[Candidate | Scan], bool] | None = None,
) -> list[Hypothesis]:
    """Every hypothesis that the effects in the model leave room for, judged; the most probable first.

    required: (family, label) of options of scans that must be among them, however unlikely. functions: with smooth
    nonparametric alternatives. laws: which laws are asked for (None: all); those of other families are not judged. The
    hypotheses that remain are the same, their priors included.
    """
    projected = Projected(problem)
    required = set(required)
    candidates = (*problem.candidates, *problem.with_masses)
    scans = [scan for scan in problem.scans if functions or not scan.smooth_covariates]
    families = {law.family for law in (*candidates, *scans) if not law.smooth_covariates}
    part = ""
    if laws is not None:
        part = laws.__qualname__
        asked = {law.family for law in (*candidates, *scans) if laws(law)}
        candidates = [c for c in candidates if c.family in asked]
        scans = [scan for scan in scans if scan.smooth_covariates or scan.family in asked]
    named = [*_of_candidates(candidates, projected, part)]
    periods = []
    moments = [scan_moments(projected, scan) for scan in scans]
    scan_scores = projected.score_groups(moments)
    for scan, scores in zip(scans, scan_scores):
        (periods if scan.smooth_covariates else named).extend(_of_scan(scan, scores, required))
    smooth = [*_of_sites(problem, projected)] if functions else []
    found = [*_named_priors(named, len(families)), *_smooth_priors(smooth, periods)]
    present: dict[tuple[str, str], list[Effect]] = {}
    for effect in problem.effects:
        present.setdefault((effect.effect, effect.where), []).append(effect)
    free = [h for h in found if not any(_excludes(e, h) for e in present.get(h.key, ()))]
    return sorted(free, key=lambda h: -h.log_weight)


def _excludes(effect: Effect, h: Hypothesis) -> bool:
    """Whether an effect in the model, of a hypothesis' `key`, leaves no room for it: another variant of its law."""
    if h.smooth_covariates:
        return effect.names == h.smooth_covariates and all(
            other.options == effect.options for other in h.effects
        )
    return not h.coexists or any(_law_of(effect) == _law_of(other) for other in h.effects)


def _law_of(effect: Effect) -> dict:
    """Options of an effect that are part of its law; the number of a repeated step is only its name."""
    return {name: value for name, value in effect.options.items() if name != "occurrence"}


def _of_candidates(
    candidates: Sequence[Candidate], projected: Projected, part: str
) -> Iterator[Hypothesis]:
    """Each candidate judged, those with equally many columns at once; part: name of these candidates, "" of all."""
    widths = np.array([c.columns.shape[1] for c in candidates])
    for chosen, name in _groups(candidates, widths):
        columns = np.stack([c.columns * c.typical for c in chosen])
        moments = projected.column_moments(columns, (*name, part))
        scores = projected.score_hypotheses(moments)
        signs = _one_sided(chosen, moments, scores, projected)
        scores = replace(scores, evidence=scores.evidence + signs)
        for i, c in enumerate(chosen):
            yield Hypothesis(
                c.effect,
                c.where,
                c.label,
                c.family,
                c.effects,
                c,
                None,
                c.prior_weight,
                *scores.row(i),
                missing_covariate=c.missing_covariate,
                coexists=c.coexists,
            )


def _groups(candidates: Sequence[Candidate], widths: np.ndarray):
    """(candidates, name) of groups with equally many columns, of no more numbers together than `CHUNK_SIZE`."""
    for width in np.unique(widths):
        rows = np.flatnonzero(widths == width)
        numbers_of_one = candidates[rows[0]].columns.size
        size = max(CHUNK_SIZE // numbers_of_one, 1)
        for start in range(0, len(rows), size):
            chosen = [candidates[i] for i in rows[start : start + size]]
            yield chosen, ("candidates", width, start)


def _one_sided(chosen, moments: Moments, scores: Scores, projected: Projected) -> np.ndarray:
    """(C,) what the evidence gains or loses by the limits of single parameters.

    log 2 Phi(z) where it cannot be negative, z sigmas from 0. Beyond its largest value the prior falls with the power
    `_TAIL` of the value: a part may warm by more than the thermometer of the recording.
    """
    only = np.array([c.positive and len(c.typical) == 1 for c in chosen])
    gain = scores.gain / projected.design_effect
    variance = np.maximum(projected.yy - gain, 1e-300) / projected.degrees
    sign = -np.sign(moments.score[:, 0])
    z = sign * np.sqrt(gain / variance)
    gram = np.maximum(moments.gram[:, 0, 0], 1e-300)
    information = gram / projected.design_effect
    size = np.sqrt(gain / information)  # in typical ones
    largest = np.array([c.largest for c in chosen])
    relative_size = np.maximum(size / largest, 1.0)
    excess = np.log(relative_size)
    log_odds = np.log(2) + log_ndtr(z) - _TAIL * excess
    return np.where(only, log_odds, 0.0)


def _of_scan(scan: Scan, scores: Scores, required: set) -> Iterator[Hypothesis]:
    """The best options of a scan, and those whose (family, label) is wanted; the first stands for all others, too."""
    mass = scan.prior_weight / max(scan.prior_weight.sum(), 1e-300)
    best = np.argsort(-(scores.evidence + np.log(mass)))
    others = best[MOST_LISTED:]
    if len(others):
        log_others = logsumexp(scores.evidence[others], b=mass[others]) - np.log(mass[best[0]])
        scores.evidence[best[0]] = np.logaddexp(scores.evidence[best[0]], log_others)
    labels = {label for family, label in required if family == scan.family}
    required_indices = [i for i in others if labels and scan.word.format(scan.options[i]) in labels]
    for i in (*best[:MOST_LISTED], *required_indices):
        yield row_of_scan(scan, scores, i)


def row_of_scan(scan: Scan, scores: Scores, i: int) -> Hypothesis:
    """Option i of a scan, judged; its prior is that of its family alone."""
    value = float(scan.options[i])
    return Hypothesis(
        scan.effect,
        scan.where,
        scan.word.format(value),
        scan.family,
        scan.make(value),
        scan,
        value,
        scan.prior_weight[i],
        *scores.row(i),
        smooth_covariates=scan.smooth_covariates,
        coexists=scan.coexists,
    )


def _of_sites(problem: Problem, projected: Projected) -> Iterator[Hypothesis]:
    """Functions of one covariate and of two at all sites, those with equally many columns judged at once."""
    groups = [
        (site, chosen, moments)
        for site in problem.sites
        for chosen, moments in _site_moments(site, problem, projected)
    ]
    judged_groups = projected.score_groups([moments for *_, moments in groups])
    for (site, chosen, _), scores in zip(groups, judged_groups):
        for i, names in enumerate(chosen):
            label = f"a smooth function of {' and '.join(names)}"
            description = ("unknown", site.where, label, "", (), site, names)
            yield Hypothesis(*description, 1.0, *scores.row(i), smooth_covariates=names)


def _site_moments(site: Site, problem: Problem, projected: Projected):
    """(chosen, Moments) of the functions of a site: names of covariates that are mapped to equally many numbers."""
    key = ("site", site.where, site.port)
    sample_sums = projected.sample_sums(site.rows, key)
    groups: dict[int, list[tuple[str, ...]]] = {}
    single = ((c,) for c in site.covariates)
    for names in (*single, *site.pairs):
        values = problem.functions_of(names, site.resolution)[0]
        groups.setdefault(len(values), []).append(names)
    for chosen in groups.values():
        known = [problem.functions_of(names, site.resolution) for names in chosen]
        waves = np.stack([functions for functions, _ in known])
        typical = np.stack([np.outer(site.typical, sizes).ravel() for _, sizes in known])
        moments = sample_sums.function_moments((site.resolution, *chosen), waves, typical)
        yield chosen, moments


def _named_priors(rows: Sequence[Hypothesis], families: int) -> Iterator[Hypothesis]:
    """Each of so many families equally likely, its variants by their mass; the level of the search shared alike."""
    total: Counter[str] = Counter()
    for h in rows:
        total[h.family] += h.prior_weight
    for h in rows:
        part = h.prior_weight / total[h.family] / families
        yield _with_prior(h, 1 - RARE_PRIOR, 1 - SMOOTH_LEVEL, part)


def _smooth_priors(smooth: Sequence[Hypothesis], periods: Sequence[Hypothesis]):
    """Functions of one covariate, of two, and periods: each kind shares the prior equally, as do its members."""
    by_covariates = [[h for h in smooth if len(h.smooth_covariates) == k] for k in (1, 2)]
    kinds = by_covariates + [periods]
    nonempty = [members for members in kinds if members]
    for members in nonempty:
        total = sum(h.prior_weight for h in members)
        for h in members:
            share = h.prior_weight / total / len(nonempty)
            yield _with_prior(h, RARE_PRIOR, SMOOTH_LEVEL, share)


def _with_prior(h: Hypothesis, share: float, level: float, part: float) -> Hypothesis:
    """With its part of the prior and of the error level that all of its kind have."""
    return replace(h, log_prior=float(np.log(share * part)), weight=level * part)


def family_wise(hypotheses: Sequence[Hypothesis], min_gain: float = 0.0) -> float:
    """p-value that any effect is missing that gains at least `min_gain`, over the whole search: weighted Bonferroni.

    A smooth alternative counts only if it is more probable than no effect: one with many parameters may not be.
    Holm, Scand. J. Stat. 6 (1979); weights: Genovese, Roeder & Wasserman, Biometrika 93 (2006).
    """
    counted = [
        h for h in hypotheses if h.gain >= min_gain and (h.evidence > 0 or not h.smooth_covariates)
    ]
    p_values = (h.p / h.weight for h in counted)
    return float(min([1.0, *p_values]))


def located(problem: Problem, table: Sequence[Hypothesis] | None = None) -> tuple[Located, ...]:
    """Each place with the covariate whose smooth function explains most there, the clearest first.

    `share`: of what the residual holds beyond noise (the unit variance that the degrees of freedom
    leave is taken off both). `p_value`: of the best function at the place over all places and covariates.
    """
    table = ranked_hypotheses(problem) if table is None else table
    best: dict[tuple, Hypothesis] = {}
    for h in table:
        if h.smooth_covariates and (
            (place := (h.where, _port(h))) not in best or h.evidence > best[place].evidence
        ):
            best[place] = h
    yy = float((problem.orthogonalise(problem.residual) ** 2).sum())
    noise = yy / max(problem.degrees, 1)
    rows = [
        Located(
            *place,
            h.smooth_covariates,
            max(0.0, h.gain - h.rank * noise) / max(yy, 1e-300),
            min(1.0, h.p / h.weight),
            float((h.gain / len(problem.sample)) ** 0.5),
        )
        for place, h in best.items()
    ]
    return tuple(sorted(rows, key=lambda row: (row.p_value, -row.share)))


def _port(h: Hypothesis) -> str:
    """The port of a smooth nonparametric alternative; one of which only the period is known moves a frame."""
    return getattr(h.source, "port", "frame")
