"""All hypotheses, judged at once: library effects at every place, and smooth nonparametric alternatives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import log_ndtr, logsumexp

from workbench.core.effect import Effect
from workbench.diagnosis.linear.evidence import Moments, Projected, once, scan_moments
from workbench.diagnosis.linear.problem import Candidate, Problem, Scan, Site
from workbench.diagnosis.linear.smooth_alternatives import functions

UNNAMED_SHARE = 0.1
"""Prior chance that what is missing is in no row of the library."""
LEVEL_UNNAMED = 0.3
"""Share of the error level that the smooth nonparametric alternatives receive."""
_KEPT = 2000  # samples up to which products of functions are kept
_AT_ONCE = 2_000_000  # numbers of columns that are judged together: sixteen megabytes
_FEW = 12  # options of a scan that are looked at one by one; the others only count in their family


@dataclass(frozen=True)
class Hypothesis:
    """One possibly missing effect, judged conditional on a fitted baseline.

    `log_prior`: of this variant; `evidence`: log Bayes factor against nothing; `p`: of its F test by
    itself; `weight`: its share of the error level of the whole search; `gain`, `rank` as in `Scores`.
    `unnamed`: covariates of a smooth nonparametric alternative, () for a named effect. `source`: what it came
    from, a Candidate, (Scan, option) or (Site, names).
    """

    effect: str
    where: str
    label: str
    family: str
    effects: tuple[Effect, ...]
    unnamed: tuple[str, ...]
    missing: str
    together: bool
    source: object
    log_prior: float
    weight: float
    evidence: float
    p: float
    gain: float
    rank: int

    @property
    def log_weight(self) -> float:
        """Log of prior times evidence."""
        return self.log_prior + self.evidence

    @property
    def key(self) -> tuple[str, str]:
        """What an answer is judged by: the effect and where it sits."""
        return (self.effect, self.where) if not self.unnamed else ("unknown", self.where)

    @property
    def reads(self) -> set[str]:
        """Covariates of which a law of one joint is a function; none of other laws."""
        return (
            set(self.effects[0].reads)
            if self.effects and self.where.startswith("joint-")
            else set()
        )

    @property
    def needs_compliance(self) -> bool:
        """Whether it acts through the compliances of the model alone, see `Effect`."""
        return any(effect.needs_compliance for effect in self.effects)

    @property
    def carries_load(self) -> bool:
        """Whether others act through it, see `Effect`."""
        return any(effect.carries_load for effect in self.effects)

    @property
    def typical(self) -> np.ndarray:
        """(P,) typical sizes of the parameters of a named effect."""
        source = self.source if isinstance(self.source, Candidate) else self.source[0]
        return source.typical

    def columns(self, problem: Problem) -> np.ndarray:
        """(N, P) whitened columns in typical sizes."""
        return columns_of(self.source, problem)

    def at(self, problem: Problem) -> "Hypothesis | None":
        """The same with its columns at another solution; its evidence stays. None where that does not compare it."""
        first, *option = self.source if isinstance(self.source, tuple) else (self.source,)
        found = problem.sources.get(first.key)
        if found is None:
            return None
        return replace(self, source=(found, *option) if option else found)


def columns_of(source, problem: Problem) -> np.ndarray:
    """(N, P) columns in typical sizes of what a hypothesis came from."""
    if isinstance(source, Candidate):
        return source.columns * source.typical
    first, option = source
    if isinstance(first, Site):
        waves, sizes = waves_at(problem, option, first.fine)
    elif first.kind == "step":
        step = (first.x > option).astype(float)
        waves, sizes = (step - first.centred * step.mean())[None], np.ones(1)
    else:
        waves, sizes = np.stack([np.cos(option * first.x), np.sin(option * first.x)]), np.ones(2)
    waves = (waves * sizes[:, None])[:, problem.sample]
    return (
        (first.typical[:, None, None] * first.rows[:, None] * waves)
        .reshape(-1, len(problem.sample))
        .T
    )


def waves_at(
    problem: Problem, names: tuple[str, ...], fine: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """(V, n) functions of some covariates on all samples of a problem, and their prior sizes (V,); made once."""

    def make():
        values = [problem.covariates[name] for name in names]
        return functions(names, values, [(float(v.min()), float(v.max())) for v in values], fine)

    return once(problem.made, (names, fine), make)


def _squares(problem: Problem, chosen: Sequence[tuple[str, ...]], fine: int) -> np.ndarray:
    """(C, U, n) products of all pairs of each of several `waves_at`; made once."""

    def make(names):
        waves, _ = waves_at(problem, names, fine)
        first, second = np.triu_indices(len(waves))
        return waves[first] * waves[second]

    kept = problem.made if problem.n <= _KEPT else {}
    return np.stack(
        [once(kept, ("squares", names, fine), partial(make, names)) for names in chosen]
    )


def judged(
    problem: Problem, projected: Projected | None = None, wanted: Sequence = ()
) -> list[Hypothesis]:
    """Every hypothesis that the effects in the model leave room for, judged; likeliest first.

    wanted: (family, label) of options of scans that must be among them, however unlikely.
    """
    projected = projected or Projected(problem)
    named = [*_candidates((*problem.candidates, *problem.with_masses), projected)]
    named += [
        row for s in problem.scans if not s.unnamed for row in _scan(s, projected, set(wanted))
    ]
    unnamed = [row for site in problem.sites for row in _site(site, problem, projected)]
    periods = [row for s in problem.scans if s.unnamed for row in _scan(s, projected, set(wanted))]
    found = [
        *_with_priors(named, 1 - UNNAMED_SHARE, 1 - LEVEL_UNNAMED),
        *_unnamed_priors(unnamed, periods),
    ]
    free = [h for h in found if not any(_excludes(effect, h) for effect in problem.effects)]
    return sorted(free, key=lambda h: -h.log_weight)


def _excludes(effect: Effect, h: Hypothesis) -> bool:
    """Whether an effect in the model leaves no room for a hypothesis: the same, or another variant of its law."""
    if (effect.effect, effect.where) != h.key:
        return False
    if h.unnamed:
        return effect.names == h.unnamed and all(
            other.options == effect.options for other in h.effects
        )
    return not h.together or any(effect.options == other.options for other in h.effects)


def _candidates(candidates: Sequence[Candidate], projected: Projected):
    """(mass, hypothesis without prior) of each candidate, those with equally many columns at once."""
    widths = np.array([c.columns.shape[1] for c in candidates])
    for chosen, name in _groups(candidates, widths):
        moments = projected.of_columns(np.stack([c.columns * c.typical for c in chosen]), name)
        scores = projected.judge(moments)
        scores = replace(
            scores, evidence=scores.evidence + _one_sided(chosen, moments, scores, projected)
        )
        for i, c in enumerate(chosen):
            description = (
                c.effect,
                c.where,
                c.label,
                c.family,
                c.effects,
                (),
                c.missing,
                c.together,
                c,
            )
            yield c.mass, description, _row(scores, i)


def _groups(candidates: Sequence[Candidate], widths: np.ndarray):
    """(candidates, name) of groups with equally many columns, of no more numbers together than `_AT_ONCE`."""
    for width in np.unique(widths):
        rows = np.flatnonzero(widths == width)
        size = max(_AT_ONCE // candidates[rows[0]].columns.size, 1)
        for start in range(0, len(rows), size):
            chosen = [candidates[i] for i in rows[start : start + size]]
            yield chosen, ("candidates", width, start)


def _one_sided(chosen, moments: Moments, scores, projected: Projected) -> np.ndarray:
    """(C,) log 2 Phi(z): what a single parameter that cannot be negative, z sigmas from 0, gains or loses."""
    only = np.array([c.positive and len(c.typical) == 1 for c in chosen])
    sigma = np.sqrt(
        np.maximum(projected.yy - scores.gain / projected.design_effect, 1e-300) / projected.degrees
    )
    z = -np.sign(moments.score[:, 0]) * np.sqrt(scores.gain / projected.design_effect) / sigma
    return np.where(only, np.log(2) + log_ndtr(z), 0.0)


def _scan(scan: Scan, projected: Projected, wanted):
    scores = projected.judge(scan_moments(projected, scan))
    mass = scan.mass / max(scan.mass.sum(), 1e-300)
    best = np.argsort(-(scores.evidence + np.log(mass)))
    rest = (
        logsumexp(scores.evidence[best[_FEW:]], b=mass[best[_FEW:]])
        if len(best) > _FEW
        else -np.inf
    )
    labels = {label for family, label in wanted if family == scan.family}
    also = [i for i in best[_FEW:] if labels and scan.word.format(scan.options[i]) in labels]
    for place, i in enumerate([*best[:_FEW], *also]):
        value = float(scan.options[i])
        effects = scan.make(value) if scan.make else ()
        label = scan.word.format(value)
        row, own = _row(scores, i), scan.mass[i]
        if place == 0 and np.isfinite(
            rest
        ):  # the best stands for all that are not looked at one by one
            evidence = np.logaddexp(row[0], rest - np.log(mass[i]))
            row = (evidence, *row[1:])
        source = (scan, value)
        yield (
            own,
            (
                scan.effect,
                scan.where,
                label,
                scan.family,
                effects,
                scan.unnamed,
                "",
                scan.together,
                source,
            ),
            row,
        )


def _row(scores, i):
    return float(scores.evidence[i]), float(scores.p[i]), float(scores.gain[i]), int(scores.rank[i])


def _with_priors(rows, share, level):
    """Each family equally likely, its variants by their mass; the level of the search shared alike."""
    rows = list(rows)
    total: dict[str, float] = {}
    for mass, description, _ in rows:
        total[description[3]] = total.get(description[3], 0.0) + mass
    for mass, description, (evidence, p, gain, rank) in rows:
        part = mass / total[description[3]] / len(total)
        yield Hypothesis(
            *description, float(np.log(share * part)), level * part, evidence, p, gain, rank
        )


def _site(site: Site, problem: Problem, projected: Projected):
    """Functions of one covariate and of two at a site, those with equally many numbers at once."""
    slots = projected.slots(site.rows, ("site", site.where, site.port))
    groups: dict[int, list] = {}
    for names in (*((c,) for c in site.covariates), *site.pairs):
        waves, sizes = waves_at(problem, names, site.fine)
        groups.setdefault(len(waves), []).append(
            (names, waves, np.outer(site.typical, sizes).ravel())
        )
    for group in groups.values():
        chosen, waves, typical = (
            np.stack(held) if i else tuple(held) for i, held in enumerate(zip(*group))
        )
        squares = partial(_squares, problem, chosen, site.fine) if len(site.rows) > 1 else None
        moments = slots.times((site.fine, *chosen), waves, typical, squares)
        scores = projected.judge(moments)
        for i, (names, *_) in enumerate(group):
            label = (
                f"a {'sharply changing' if site.sharp else 'smooth'} function of "
                + " and ".join(names)
            )
            yield (
                len(names),
                ("unknown", site.where, label, "", (), names, "", True, (site, names)),
                _row(scores, i),
            )


def _unnamed_priors(rows, periods):
    """Functions of one covariate, of two, and periods: each kind shares the prior equally, as do its members."""
    kinds = {k: [row for row in rows if row[0] == k] for k in (1, 2)} | {3: list(periods)}
    held = [members for members in kinds.values() if members]
    for members in held:
        total = sum(mass for mass, *_ in members) if members is kinds[3] else len(members)
        for mass, description, (evidence, p, gain, rank) in members:
            part = (mass if members is kinds[3] else 1.0) / total / len(held)
            prior = float(np.log(UNNAMED_SHARE * part))
            yield Hypothesis(*description, prior, LEVEL_UNNAMED * part, evidence, p, gain, rank)


def family_wise(hypotheses: Sequence[Hypothesis], least: float = 0.0) -> float:
    """p-value that anything is missing that gains `least` or more, valid under the whole search: weighted Bonferroni.

    A smooth alternative counts only if it is likelier than no effect: one with many parameters may not be.
    Holm, Scand. J. Stat. 6 (1979); weights: Genovese, Roeder & Wasserman, Biometrika 93 (2006).
    """
    counted = [h for h in hypotheses if h.gain >= least and (h.evidence > 0 or not h.unnamed)]
    return float(min([1.0, *(h.p / h.weight for h in counted)]))


__all__ = ["Hypothesis", "Moments", "columns_of", "family_wise", "judged", "waves_at"]
