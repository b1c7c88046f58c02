"""What a search accepted, as findings: each with its probability among all that might stand in its place."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from robot_model.effects import CATALOGUE
from workbench.diagnosis.levels import CONFIDENCE, MOST_LISTED, RARE_PRIOR
from workbench.diagnosis.linear.hypotheses import Hypothesis, family_wise
from workbench.diagnosis.linear.problem import Alternative, Finding
from workbench.diagnosis.noise.random_effects import movement, unrecorded_causes
from workbench.diagnosis.robot.library import compliances, names
from workbench.diagnosis.robot.mass_responses import LABEL
from workbench.diagnosis.search.compatible import equivalent_places, same_place
from workbench.diagnosis.search.instants import instant_of
from workbench.diagnosis.search.options import option_of
from workbench.diagnosis.search.posterior import EffectPosterior, is_law_of_function
from workbench.diagnosis.search.prior import LAW_ERROR, SECOND
from workbench.diagnosis.search.state import Search
from workbench.diagnosis.search.stepwise import LAW

ELASTIC = frozenset(names(compliances(CATALOGUE)))
_CLOSE_GAIN = 6.0  # variances of noise: a difference that chance makes once in seventy times
SAME_FUNCTION = "a function of these covariates at one of the places is one at the other"
CONFOUNDED = "it makes nearly the same of any poses"
_MAX_DIRECTIONS = 6  # directions in which a smooth nonparametric alternative may displace a place


def finding(
    search: Search, i: int, names: Mapping[tuple, EffectPosterior] | None = None
) -> Finding:
    """One that is accepted, with its posterior among all that could replace it, conditional on the others.

    names: posterior of the elastic terms over sets of them, see `search.posterior`; it decides between these.
    """
    table, mine = search.alternatives(i), search.accepted[i]
    own = search.conditional_hypothesis(i, table)
    explained, chance = search.explained(), _CLOSE_GAIN * search.variance()
    explanations = []
    for h in table:
        counts = (
            own.smooth_covariates or not h.smooth_covariates or _explains_more(h, own, explained)
        )
        if counts and not _only_generalises(h, own, chance):
            explanations.append(h)
    total = logsumexp([h.log_weight for h in explanations])
    shares: Counter[tuple] = Counter()
    for h in explanations:
        shares[h.key] += float(np.exp(h.log_weight - total))
    made = Finding(
        *mine.key,
        mine.label,
        mine.effects,
        max(family_wise(table), 1e-300),
        float(shares[mine.key]),
        search.size(i),
        own.gain,
        mine.smooth_covariates,
        _alternatives(explanations, shares, own, search.unexplained_gain(), chance),
        instant=instant_of(search, i, own),
        option=option_of(search, i),
    )
    if names and mine.key in names:
        made = _with_set_posterior(made, shares, names)
    if search.bench.chain is not None:
        made = with_equivalent_places(made, search.bench.chain.robot.joints)
    if not mine.smooth_covariates:
        made = _with_unexplained_alternative(search, own, made)
    return _with_confounded_laws(made)


def with_equivalent_places(made: Finding, joints: int) -> Finding:
    """The finding of a function without a law, with the places at which it is the same: all are equally probable."""
    places = equivalent_places(made.where, made.depends_on, joints)
    if made.effect != "unknown" or not places:
        return made
    probability = made.probability / (1 + len(places))
    about = (made.label, probability, 1.0, SAME_FUNCTION)
    others = tuple(Alternative(made.effect, where, *about) for where in places)
    kept = tuple(a for a in made.alternatives if a.effect != made.effect or a.where not in places)
    return replace(made, probability=probability, alternatives=(*others, *kept))


def _with_confounded_laws(made: Finding) -> Finding:
    """The finding with the laws that make the same of any poses; all share what it and these have, each as much."""
    laws = [law for effect in made.effects for law in effect.confounded_with]
    if not laws:
        return made
    keys = {(effect, where) for effect, where, _ in laws}
    same = [a for a in made.alternatives if (a.effect, a.where) in keys]
    others = tuple(a for a in made.alternatives if a not in same)
    share = (made.probability + sum(a.probability for a in same)) / (1 + len(laws))
    named = tuple(Alternative(*law, share, 1.0, CONFOUNDED) for law in laws)
    return replace(made, probability=share, alternatives=(*named, *others))


def bare_finding(h: Hypothesis) -> Finding:
    """An accepted term by its name and effects alone."""
    return Finding(*h.key, h.label, h.effects, h.p, 1.0, 0.0, h.gain, h.smooth_covariates)


def _explains_more(function: Hypothesis, law: Hypothesis, explained: float) -> bool:
    """Whether a nonparametric function explains more than a law's own error may leave of all that is `explained`.

    A function of the very covariates that the law reads, at its place, differs from the law only by its shape: of what
    the law explains itself, only the error of a law that is right is then left. What other laws explain may be wrong
    by more, and so may all of it before a law's place is in doubt. A function of a joint's own angle is the law that
    makes all of it, see `is_law_of_function`.
    """
    if is_law_of_function(function, law):
        return False
    error = (1 - LAW) * explained
    if function.where in same_place(law) and law.reads & set(function.smooth_covariates):
        others = max(explained - law.gain, 0.0)
        error = LAW_ERROR**2 * law.gain + (1 - LAW) * others
    return function.gain > law.gain + error


def with_special_cases(findings: Sequence[Finding]) -> list[Finding]:
    """The findings, where one whose law contains others at its place takes these in: a curve and its harmonics.

    A series of few terms with one harmonic beyond them is one error of the joint, found as two terms of the search.
    """
    kept = list(findings)
    for general in findings:
        parts = [one for one in kept if one is not general and _is_case_of(one, general)]
        if parts and any(one is general for one in kept):
            whole = [_merged(general, parts) if one is general else one for one in kept]
            kept = [one for one in whole if not any(one is part for part in parts)]
    return kept


def _is_case_of(finding: Finding, general: Finding) -> bool:
    """Whether all effects of a finding may act several at a place, where one of the other contains them."""
    if finding.where != general.where or not finding.effects or not general.effects:
        return False
    contained = {name for effect in general.effects for name in effect.subsumes}
    return all(effect.coexists and effect.effect in contained for effect in finding.effects)


def _merged(general: Finding, parts: Sequence[Finding]) -> Finding:
    """The general finding with the effects of its special cases."""
    mine = {(part.effect, part.where) for part in parts}
    every = (general, *parts)
    return replace(
        general,
        label=", ".join(one.label for one in every if one.label),
        effects=tuple(effect for one in every for effect in one.effects),
        p_value=min(one.p_value for one in every),
        probability=max(one.probability for one in every),
        size=float(np.sqrt(sum(one.size**2 for one in every))),
        gain=sum(one.gain for one in every),
        alternatives=tuple(a for a in general.alternatives if (a.effect, a.where) not in mine),
    )


def _only_generalises(other: Hypothesis, own: Hypothesis, chance: float) -> bool:
    """Whether another law contains this one as a special case, and what it has more explains no more than chance.

    It is then no other name: friction that does not grow with the load is backlash.
    """
    contains = any(own.effect in effect.subsumes for effect in other.effects)
    is_larger = other.where == own.where and other.rank > own.rank
    return contains and is_larger and other.gain <= own.gain + chance


def _with_set_posterior(
    made: Finding, shares: Mapping[tuple, float], names: Mapping[tuple, EffectPosterior]
) -> Finding:
    """The finding with the posterior over sets of elastic terms in place of single exchanges between these.

    Everything else keeps its share: together the elastic terms have what they had.
    """
    own = names[made.effect, made.where]
    elastic = sum(share for key, share in shares.items() if key in names)
    known = {(a.effect, a.where): a for a in made.alternatives}
    others = [a for key, a in known.items() if key not in names]
    instead = []
    for key, share, alike in own.instead:
        probability = elastic * share
        why = f"it makes {100 * alike:.0f} % of the same signature in these poses"
        label = known[key].label if key in known else ""
        instead.append(Alternative(*key, label, probability, alike, why))
    ranked = sorted((*instead, *others), key=lambda a: -a.probability)
    return replace(
        made,
        probability=elastic * own.probability,
        alternatives=tuple(ranked[:MOST_LISTED]),
        variation=own.variation,
    )


def _alternatives(table, shares, own, left: float, noise: float) -> tuple[Alternative, ...]:
    """What else is in the 95 % credible set, or so near in what it explains that what is left could tip the balance.

    Also a compliance at another place that explains as much but for chance: only its prior differs. Also a joint
    compliance under its own links alone: it equals one with estimated masses if the load's mass is zero.
    """
    covered, out = 0.0, []
    special = own.effects[0].subsumes if own.label == LABEL else ()
    for key, share in shares.most_common():
        other = max((h for h in table if h.key == key), key=lambda h: h.log_weight)
        less = own.gain - other.gain  # than the finding explains
        are_elastic = other.effect in ELASTIC and own.effect in ELASTIC
        is_special = other.effect in special and other.where == own.where
        is_law = not other.smooth_covariates and other.rank <= own.rank
        near = is_special or (are_elastic and less < noise)
        near = near or (is_law and 0 < left and less < left and len(out) < MOST_LISTED)
        if key != own.key and (covered < CONFIDENCE or near):
            alike = min(1.0, other.gain / max(own.gain, 1e-300))
            why = f"it makes {100 * alike:.0f} % of the same signature in these poses"
            out.append(Alternative(*key, other.label, share, alike, why, other.missing_covariate))
        covered += share
    return tuple(out)


def _with_unexplained_alternative(search: Search, own: Hypothesis, made: Finding) -> Finding:
    """The finding as likely as what is left at its very place allows: something unnamed there might make both.

    That takes one thing instead of two at one place, but its direction must be the law's by chance but for a share s
    of the whole: a direction among P lies so near to r given ones with a chance of about s^((P - r) / 2) (the tail of
    the beta distribution of a squared correlation). Next to something at a link or the base, which may move in any
    direction, a law of one joint has one direction, however many parameters its function has. What is left at the
    joint itself turns about the same axis: only the function, of r parameters, is then a coincidence.
    """
    left, moves, port = _unexplained_at_place(search, own)
    if left <= 0:
        return made
    share = left / (left + own.gain)
    places = len({site.where for site in search.problem.sites})
    two = (1 - RARE_PRIOR) * np.exp(SECOND) / (1 if moves else places)
    directions = 1 if port == "frame" and _has_one_axis(search, own) else own.rank
    one = RARE_PRIOR * share ** (max(_MAX_DIRECTIONS - directions, 1) / 2)
    sure = float(two / (two + one))
    other = Alternative(
        "unknown",
        made.where,
        "one cause of this and of the structure that remains there",
        made.probability * (1 - sure),
        1.0,
        "what is left at this place is beyond chance",
    )
    alternatives = (other, *made.alternatives)
    return replace(made, probability=made.probability * sure, alternatives=alternatives)


def explains_movement(search: Search, own: Hypothesis) -> bool:
    """Whether the random effect at its place is what a law makes of a covariate that was not recorded."""
    if search.random_effect is None or search.random_effect.site.where not in same_place(own):
        return False
    return any(
        a.effect == own.effect for a in unrecorded_causes(search.random_effect, search.problem)
    )


def with_unrecorded_covariates(search: Search, made: Finding) -> Finding:
    """The finding with the effects of covariates not recorded that may cause the random effect at its place."""
    if search.random_effect is None or search.random_effect.site.where != made.where:
        return made
    known = {(a.effect, a.where, a.label) for a in made.alternatives}
    more = []
    for a in unrecorded_causes(search.random_effect, search.problem):
        is_asked = made.effect in ("unknown", a.effect)
        if is_asked and (a.effect, a.where, a.label) not in known:
            more.append(a)
    return replace(made, alternatives=(*made.alternatives, *more))


def _has_one_axis(search: Search, own: Hypothesis) -> bool:
    """Whether a law turns one joint."""
    chain = search.bench.chain
    is_of_joints = {effect.port for effect in own.effects} == {"joint"}
    return is_of_joints and all(len(effect.slots(chain)) == 1 for effect in own.effects)


def _unexplained_at_place(search: Search, own: Hypothesis) -> tuple[float, bool, str]:
    """Sum of squares of what is unexplained at a law's place next to it; whether it is the law's own covariate, not
    recorded, that may make it; and through which port the largest part acts."""
    places, noise = same_place(own), search.variance()
    left = [(0.0, "")]
    for h in search.table(search.accepted_indices):
        if h.smooth_covariates and h.where in places and h.p / h.weight <= search.level:
            left.append((h.gain - h.rank * noise, _port(h)))
    for i, h in enumerate(search.accepted):
        if h.smooth_covariates and h.where in places:
            left.append((search.conditional_hypothesis(i).gain, _port(h)))
    moves = search.random_effect is not None and search.random_effect.site.where in places
    if moves:
        left.append((movement(search.random_effect), search.random_effect.site.port))
    most, port = max(left)
    return most, explains_movement(search, own), port


def _port(function: Hypothesis) -> str:
    """The port of a smooth nonparametric alternative; "" where its row does not say."""
    return getattr(function.source, "port", "")
