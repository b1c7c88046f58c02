"""The recording that would distinguish two explanations, predicted before anybody measures it.

How far a finding stands from its best imitation by something else (and by the whole baseline), in sigmas, follows
from the normal matrix of both together. Normal matrices add, so that every further pose has its worth: of each kind of
recording (more poses; the same poses with a load, warmer, from both sides) the best poses are chosen by exchange,
and the kind that needs the fewest of them is proposed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robot_model.effects.friction import JointHysteresis
from robot_model.effects.transmission import Backlash
from robot_model.system import RobotChain, bind
from workbench.core.errors import InputError
from workbench.core.least_squares.design import choose, normal_of
from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.model import NOISE, Model
from workbench.core.parameters import Parameters
from workbench.core.vocabulary import Covariate
from workbench.diagnosis.levels import UNMODELLED_LEVEL
from workbench.diagnosis.linear.problem import Problem
from workbench.diagnosis.search.findings import CONFOUNDED
from workbench.diagnosis.validation.held_out import critical_t
from workbench.explanation.minimal_detectable_bias import separable_distance
from workbench.explanation.planning.candidate_recordings import CandidateRecording, list_candidates
from workbench.explanation.planning.scenes import scene_of
from workbench.explanation.result import Experiment, Term
from workbench.explanation.sentences.words import covariate, listed, place

POSES = 30
_ASKED = 3
_MOST_EXTRA = 30  # times as many samples as were planned
_LEAST_GAINED = 0.1  # sigma that a recording has to add to a distance, to be worth measuring
_LIKELY, _SIMILAR = (
    0.05,
    0.9,
)  # probability, or share of the signature, from which on an alternative is plausible
_PRIOR_SIZES = 10.0  # typical sizes: what is known of the sizes of the two before measuring
NOTHING = (
    "No finding is in doubt, and no further recording is needed. `workbench compensate RUN targets.csv` corrects the "
    "findings that move the arm."
)
EXCEPT = "No finding is in doubt, except by what this recording does not hold."
REFUSED = (
    "Of the findings that are retained none is in doubt. Open is {names}, which was found and not retained, because "
    "the held-out samples do not show it clearly: more poses, spread over the workspace, decide whether it is there."
)
TOO_FEW_POSES = (
    "Measure more poses, spread over the workspace: from {poses} a law that fits some of them does not carry to the "
    "others."
)
CONFIRM = (
    "To confirm {name}: about {more} more poses like these, if it is there at the size found, else a recording in "
    "which it is larger."
)
SIDES_FROM_MOVES = (
    "The recording has no columns approach1 ...: the side of approach was taken from the last moves between samples, "
    "as if the arm had moved straight on. To distinguish backlash from hysteresis, reach some poses from both sides "
    "and record the side."
)
CLEAN = (
    "None is needed: these data show no further effect. smallest-visible.csv in the run folder lists the minimal "
    "detectable bias of each effect."
)
FEW_DEGREES = (
    "Measure more poses, spread over the workspace: these show no further effect, but {poses} poses leave "
    "{degrees:.0f} degrees of freedom next to {rank} combinations of parameters, so that only large effects "
    "are visible. smallest-visible.csv in the run folder lists the minimal detectable bias of each effect."
)

CORRELATED = (
    "Measure some poses again at other times, in random order, or state sigma_mm: what is left is correlated from pose "
    "to pose, and without repeats nothing distinguishes slow noise from an effect that the catalogue does not describe."
)


@dataclass(frozen=True)
class ConfoundedPair:
    """A finding with its effects and values, the `alternative` effects that may replace it, and both their names.

    `solved`: the effects of the finding and of all other terms, in an order in which the bench has solved them.
    """

    own: tuple
    values: np.ndarray
    alternative: tuple
    name: str
    other: str
    solved: tuple = ()

    def model_effects(self, others: Sequence) -> tuple:
        """The effects of the model that holds the finding and the others."""
        return self.solved or (*others, *self.own)


def next_experiment(
    bench,
    terms: Sequence[Term],
    problem: Problem,
    p_first: float,
    refused: Sequence[Term] = (),
) -> Experiment:
    """The experiment that distinguishes the least certain finding from its most probable alternative.

    problem: of the model with the certain findings, or of the baseline. refused: terms that were found and not
    retained. Without a robot, with an alternative that is no effect, or with a missing column, the answer is a sentence
    without figures.
    """
    physical = [term for term in terms if term.finding.where != NOISE]
    untested = sides_from_moves(bench.chain) if _may_be_backlash(terms) else ""
    if all(term.share is not None and not term.remainder for term in physical):
        too_few_poses = TOO_FEW_POSES.format(poses=len(np.unique(bench.pose)))
        is_clean = p_first >= UNMODELLED_LEVEL
        return _without_figures(_clean(bench, problem) if is_clean else too_few_poses, untested)
    doubtful = [term for term in terms if not term.is_certain or term.finding.effect == "unknown"]
    if not doubtful:
        return _without_figures(EXCEPT if untested and not refused else _nothing(refused), untested)
    # recordings of lengths between two poses are not planned: what they would show is not computed
    is_planned = bench.chain is not None and bench.chain.poses_per_sample == 1
    kinds = list_candidates(bench) if is_planned else []
    least_certain = sorted(
        doubtful, key=lambda term: (not term.finding.effects, term.finding.probability)
    )[:_ASKED]
    term, others, pair, rows = _first_undecided(bench, terms, least_certain, problem, kinds)
    if not rows:
        request = _confirmed(bench, term, refused) or _missing(doubtful) or _by_word(term)
        return _without_figures(request, untested)
    best, plan = rows[0]
    scene, robot = scene_of(bench, others, pair, plan, len(best["poses"]))
    sentences = (describe_comparison(pair, rows), _missing(doubtful, others=True), untested)
    sentence = " ".join(filter(None, sentences))
    figures = tuple({k: v for k, v in row.items() if k != "poses"} for row, _ in rows)
    return Experiment(sentence, figures, scene, plan.listing(best["poses"]), robot)


def _first_undecided(bench, terms, least_certain: Sequence[Term], problem: Problem, kinds):
    """The least certain term that the recorded poses do not decide, with what `_asked` says of it.

    The least certain of all where the poses decide all of them: no other experiment is needed then.
    """
    asked = []
    for term in least_certain:
        others, pair, rows = _asked(bench, terms, term, problem, kinds)
        asked.append((term, others, pair, rows))
        if rows and rows[0][0]["samples_needed"] > 0:
            return asked[-1]
    return asked[0]


def _clean(bench, problem: Problem) -> str:
    """What to measure where nothing was found: nothing, or more poses where the parameters take most of the numbers."""
    if problem.degrees >= problem.rank:
        return CLEAN
    poses = len(np.unique(bench.pose))
    return FEW_DEGREES.format(poses=poses, degrees=problem.degrees, rank=problem.rank)


def _without_figures(*sentences: str) -> Experiment:
    return Experiment(" ".join(filter(None, sentences)))


def _confirmed(bench, term: Term, refused: Sequence[Term]) -> str:
    """State how many more poses would confirm the most probable unknown; "" where no refused term is likely.

    A t grows with the root of the number of poses.
    """
    keys = {
        (alternative.effect, alternative.where, alternative.label)
        for alternative in term.finding.alternatives
    }
    min_t = critical_t(bench.sigma)
    if term.finding.effect != "unknown":
        return ""
    for refused_term in refused:
        found = refused_term.finding
        t = min(
            value for value in (refused_term.t, refused_term.t_nested, np.inf) if value is not None
        )
        if (found.effect, found.where, found.label) in keys and 0 < t < min_t:
            poses = len(np.unique(bench.pose))
            extra_poses = poses * min((min_t / t) ** 2 - 1, _MOST_EXTRA)
            return CONFIRM.format(
                name=_called(refused_term), more=max(int(np.ceil(extra_poses / 10)) * 10, 10)
            )
    return ""


def _nothing(refused: Sequence[Term]) -> str:
    """That no retained finding is in doubt, with the names of those that were not retained."""
    names = [_called(term) for term in refused]
    return REFUSED.format(names=listed(names)) if names else NOTHING


def _may_be_backlash(terms: Sequence[Term]) -> bool:
    """Whether backlash would explain a term: hysteresis, a function of the last move, or what no place explains."""
    return any(_resembles_backlash(t.finding) and not _has_likely_law(t.finding) for t in terms)


def _has_likely_law(found) -> bool:
    """Whether an unknown has an alternative that needs no other column: a law that was found and not confirmed."""
    return found.effect == "unknown" and any(
        not alternative.missing_covariate for alternative in found.alternatives
    )


def _resembles_backlash(found) -> bool:
    if found.effect in (JointHysteresis.effect, Backlash.effect):
        return True
    kinds = {Covariate.of(name).kind for name in found.depends_on}
    return found.effect == "unknown" and (not kinds or "move" in kinds)


def sides_from_moves(chain) -> str:
    """State what to record where a robot's recording does not state the side of approach; "" where it does.

    chain: of the bench; None or a scanner's where no joint has backlash.
    """
    if not hasattr(chain, "robot"):
        return ""
    is_recorded = any(name.startswith("approach") for name in chain.state.covariates)
    return "" if is_recorded else SIDES_FROM_MOVES


def _asked(bench, terms, term: Term, problem: Problem, kinds: Sequence[CandidateRecording]):
    """The other terms' effects, the doubt about one, and the recordings of these kinds that might end it."""
    others = tuple(
        e for other_term in terms if other_term is not term for e in other_term.finding.effects
    )
    pair = _confounded_pair(term, problem) if bench.chain is not None else None
    if pair is not None:
        solved = tuple(effect for term in terms for effect in term.finding.effects)
        pair = replace(pair, solved=solved)
    return others, pair, compared(bench, others, pair, kinds) if pair is not None else []


def missing_of(terms: Sequence[Term]) -> tuple[str, ...]:
    """Names of covariates that were not recorded and that a plausible alternative to some term would need."""
    alternatives = [
        alternative
        for term in terms
        for alternative in term.finding.alternatives
        if alternative.missing_covariate
    ]
    return tuple(
        sorted(
            {
                alternative.missing_covariate
                for alternative in alternatives
                if alternative.probability >= _LIKELY or alternative.squared_correlation >= _SIMILAR
            }
        )
    )


def _missing(terms: Sequence[Term], others: bool = False) -> str:
    """The sentence on columns that were not recorded and that an alternative to some term would need.

    others: whether other recordings, too, would tell.
    """
    words = sorted({covariate(name) for name in missing_of(terms)})
    missing_columns = listed(words)
    if not missing_columns:
        return ""
    if others:
        return f"Also record {missing_columns} with every sample: it shows whether the error follows it."
    return f"Record {missing_columns} with every sample; without it this is not identifiable."


def _by_word(term: Term) -> str:
    alternatives = term.finding.alternatives
    others = [
        f"{alternative.effect} at {place(alternative.where)}" for alternative in alternatives[:3]
    ]
    first_effect = next(iter(term.finding.effects), None)
    reads = first_effect.reads if first_effect else ()
    names = sorted(term.finding.depends_on or reads)
    if others:
        aim = f"distinguish {_called(term)} from {listed(others, 'or')}"
    else:
        aim = f"learn what makes {_called(term)}"
    is_confounded = any(a.why == CONFOUNDED for a in alternatives)
    if first_effect and is_confounded and first_effect.distinguished_by:
        return f"To {aim}, {first_effect.distinguished_by}."
    if not names:
        return f"To {aim}, measure more poses, which fill all of the field and the working range."
    changed = listed([covariate(name) for name in names])
    return f"To {aim}, measure again so that only {changed} change{'s' * (len(names) == 1)}."


def _called(term: Term) -> str:
    found = term.finding
    return f"{'an unknown error' if found.effect == 'unknown' else found.effect} at {place(found.where)}"


def _confounded_pair(term: Term, problem: Problem) -> ConfoundedPair | None:
    """The finding and its most probable named alternative; None if it has none."""
    estimated = [
        row for row in term.parameters if not row.get("derived")
    ]  # others follow from these
    values = np.array([row["value"] for row in estimated])
    for alternative in term.finding.alternatives:
        effects = _effects_of(problem, alternative)
        if effects and len(values):
            label = f" ({alternative.label})" if alternative.label else ""
            other = f"{alternative.effect}{label} at {place(alternative.where)}"
            found = tuple(term.finding.effects)
            return ConfoundedPair(found, values, effects, _called(term), other)
    return None


def _effects_of(problem: Problem, alternative) -> tuple:
    """The effects of an alternative: the candidate, or the option of a scan, of that name and place."""
    for c in (*problem.candidates, *problem.with_masses):
        if (c.effect, c.where, c.label) == (
            alternative.effect,
            alternative.where,
            alternative.label,
        ):
            return c.effects
    for scan in problem.scans:
        if (scan.effect, scan.where) == (alternative.effect, alternative.where) and scan.make:
            hits = [v for v in scan.options if scan.word.format(v) == alternative.label]
            if hits:
                return tuple(scan.make(float(hits[0])))
            return ()
    return ()


def compared(
    bench, others, pair: ConfoundedPair, kinds: Sequence[CandidateRecording]
) -> list[tuple[dict, CandidateRecording]]:
    """Every kind of recording with its best poses and what they would reach, the most telling first."""
    found = []
    fitted = _fitted(bench, others, pair)
    for plan in kinds:
        try:
            found.append((_information_gain(bench, fitted, pair, plan), plan))
        except InputError:  # an effect needs a column that this kind of recording does not have
            continue
    found = [row for row in found if row[0] is not None]
    return sorted(found, key=lambda row: row[0]["samples_needed"])


@dataclass(frozen=True)
class _Fitted:
    """The model with a finding and all others in it: its chain, parameters and effects, and its noise (mm)."""

    chain: RobotChain
    parameters: Parameters
    effects: tuple
    sigma: float


def _fitted(bench, others, pair: ConfoundedPair) -> _Fitted:
    solved, fit, _ = bench.solve(pair.model_effects(others))
    effects = (*bench.baseline, *others, *pair.own, *pair.alternative)
    sigma = float(np.median(solved.sigma(fit.parameters)))
    return _Fitted(solved.chain, fit.parameters, effects, sigma)


def _information_gain(
    bench, fitted: _Fitted, pair: ConfoundedPair, plan: CandidateRecording
) -> dict | None:
    """Expected separation of the two explanations with the plan's best poses."""
    rows, places_of_term, prior, typical = _rows(fitted, pair, plan)
    n = bench.chain.n
    size = np.zeros(rows.shape[2])
    size[places_of_term] = pair.values / typical
    known = normal_of(rows[:n]) + np.diag(prior)
    blocks = _by_pose(rows[n:], plan.pose)
    count = min(POSES, len(blocks))
    task = np.zeros((1, 1, rows.shape[2]))
    task[0, 0] = size / max(np.linalg.norm(size), 1e-300)
    chosen = choose(blocks, count, "task", task, draws=0, known=known).chosen
    extended = known + normal_of(blocks[chosen])
    now = _separation(known, size, places_of_term)
    then = _separation(extended, size, places_of_term)
    gained = then**2 - now**2
    if not gained > 0:
        return None
    samples = int(np.isin(plan.pose, chosen).sum())
    needed = samples * max(separable_distance() ** 2 - now**2, 0.0) / gained
    return {
        "plan": plan.name,
        "poses": chosen,
        "samples": samples,
        "apart_now_sigma": now,
        "apart_then_sigma": then,
        "gain_per_sample": gained / samples,
        "samples_needed": float(np.ceil(needed)),
    }


def _separation(normal, size, places_of_term) -> float:
    """Sigmas between the finding's signature and all that the other columns can make of it."""
    other_columns = np.setdiff1d(np.arange(len(normal)), places_of_term)
    cross = normal[np.ix_(places_of_term, other_columns)]
    schur_complement = normal[np.ix_(places_of_term, places_of_term)] - cross @ solve_positive(
        normal[np.ix_(other_columns, other_columns)], cross.T
    )
    return float(np.sqrt(max(size[places_of_term] @ schur_complement @ size[places_of_term], 0.0)))


def _rows(fitted: _Fitted, pair: ConfoundedPair, plan: CandidateRecording):
    """Whitened rows (n + extra, m, F) in typical sizes, places of the finding's parameters, precisions, their sizes."""
    chain = bind(fitted.chain.robot, plan.recording, fitted.chain.start)
    chain = replace(chain, state=plan.state(chain))
    model = Model(chain, fitted.effects)
    parameters = model.parameters.take_over(fitted.parameters)
    keys_of_term = [p.key for e in pair.own for p in e.parameters(chain)]
    alternative = [p.key for e in pair.alternative for p in e.parameters(chain)]
    free = parameters.only(parameters.mask | np.isin(parameters.keys, keys_of_term + alternative))
    typical = free.typical[free.mask]
    rows = model.linearise(free)[1] / fitted.sigma * typical[:, None, None]
    keys = [key for key, chosen in zip(free.keys, free.mask) if chosen]
    prior = (
        np.where(
            np.isin(keys, keys_of_term + alternative),
            _PRIOR_SIZES**-2,
            free.precision[free.mask] * typical**2,
        )
        + 1e-9
    )
    term_columns = np.array([keys.index(key) for key in keys_of_term])
    return rows.transpose(2, 1, 0), term_columns, prior, typical[term_columns]


def _by_pose(rows, pose):
    """(poses, m', F) rows of one pose side by side, zeros where a pose has fewer than another."""
    counts = np.bincount(pose)
    place_in = np.arange(len(pose)) - np.repeat(np.cumsum(counts) - counts, counts)
    rows_of_pose = np.zeros((len(counts), counts.max(), *rows.shape[1:]))
    rows_of_pose[pose, place_in] = rows
    return rows_of_pose.reshape(len(counts), -1, rows.shape[2])


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def describe_comparison(
    pair: ConfoundedPair, rows: Sequence[tuple[Mapping, CandidateRecording]]
) -> str:
    """Describe what `compared` found in a sentence or two."""
    best, plan = rows[0]
    if best["samples_needed"] == 0:
        return (
            f"These poses distinguish {pair.name} from {pair.other}: at the estimated size their predictions differ "
            f"by {best['apart_now_sigma']:.1f} σ ({separable_distance():.1f} σ give a probability of 95 %). "
            "Both nevertheless remain likely, since neither alone describes the effect. "
            f"{_capital(plan.words.format(poses=len(best['poses'])))}."
        )
    gained = best["apart_then_sigma"] - best["apart_now_sigma"]
    if best["samples_needed"] > _MOST_EXTRA * best["samples"] or gained < _LEAST_GAINED:
        return (
            f"No recording of the compared kinds distinguishes {pair.name} from {pair.other}: their predictions "
            f"differ by {best['apart_now_sigma']:.1f} σ now and by {best['apart_then_sigma']:.1f} σ with "
            f"{best['samples']} more samples, {plan.name}. Each of them corrects for both."
        )
    first = (
        f"To distinguish {pair.name} from {pair.other}, {plan.words.format(poses=len(best['poses']))}. Their "
        f"predictions would then differ by {best['apart_then_sigma']:.1f} σ instead of "
        f"{best['apart_now_sigma']:.1f} σ; {separable_distance():.1f} σ are required for a probability of 95 %."
    )
    if len(rows) > 1:
        other, second = rows[1]
        reached = f"{other['apart_then_sigma']:.1f} σ with as many poses"
        first += f" The next best recording ({second.name}) reaches {reached}."
    return first
