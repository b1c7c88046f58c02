"""Accepted terms as findings, each with its posterior probability among its alternatives."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from robot_model.effects import CATALOGUE
from robot_model.effects.curve import JointCurve
from robot_model.effects.friction import JointTorque
from robot_model.effects.transmission import TransmissionHarmonic
from robot_model.effects.unknown_masses import GravityCompliance
from workbench.diagnosis.levels import (
    CONFIDENCE,
    CONFOUNDED_SHARE,
    LISTED_PROBABILITY,
    MOST_LISTED,
    RARE_PRIOR,
)
from workbench.diagnosis.linear.hypotheses import Hypothesis, family_wise
from workbench.diagnosis.linear.problem import Alternative, Finding, likeness_text
from workbench.diagnosis.noise.random_effect_findings import movement, unrecorded_causes
from workbench.diagnosis.robot.library import compliances, names
from workbench.diagnosis.robot.mass_responses import LABEL
from workbench.diagnosis.search.compatible import (
    CLOSE_GAIN,
    equivalent_places,
    only_generalises,
    same_place,
)
from workbench.diagnosis.search.constant_load import unstated_load
from workbench.diagnosis.search.instants import instant_of
from workbench.diagnosis.search.options import option_of
from workbench.diagnosis.search.posterior import EffectPosterior, is_law_of_function, odds_of_both
from workbench.diagnosis.search.prior import LAW_ERROR, SECOND
from workbench.diagnosis.search.state import Search
from workbench.diagnosis.search.stepwise import LAW

ELASTIC = frozenset(names(compliances(CATALOGUE)))
SAME_FUNCTION = "a function of these covariates at one of the places is one at the other"
CONFOUNDED = "it makes nearly the same of any poses"
_MAX_DIRECTIONS = 6  # directions in which a smooth nonparametric alternative may displace a place


def finding(
    search: Search, i: int, names: Mapping[tuple, EffectPosterior] | None = None
) -> Finding:
    """One that is accepted, with its posterior among all that could replace it, conditional on the others.

    names: posterior of the elastic terms over sets of them, see `search.posterior`; it decides between these.
    """
    table = search.alternatives(i)
    accepted = search.accepted[i]
    tested = search.conditional_hypothesis(i, table)
    explained = search.explained()
    chance = CLOSE_GAIN * search.variance()
    explanations = []
    for h in table:
        counts = (
            tested.smooth_covariates
            or not h.smooth_covariates
            or _explains_more(h, tested, explained)
        )
        if counts and not only_generalises(h, tested, chance):
            explanations.append(h)
    total = logsumexp([h.log_weight for h in explanations])
    shares: Counter[tuple] = Counter()
    for h in explanations:
        shares[h.key] += float(np.exp(h.log_weight - total))
    if not tested.smooth_covariates:
        shares = _with_sets_of_both(search, i, explanations, shares)
    result = Finding(
        *accepted.key,
        accepted.label,
        accepted.effects,
        max(family_wise(table), 1e-300),
        float(shares[accepted.key]),
        search.size(i),
        tested.gain,
        accepted.smooth_covariates,
        _alternatives(explanations, shares, tested, search.unexplained_gain(), chance),
        instant=instant_of(search, i, tested),
        option=option_of(search, i),
    )
    if names and accepted.key in names:
        result = _with_set_posterior(result, shares, names)
    chain = search.bench.chain
    if chain is not None:
        result = with_equivalent_places(result, chain.robot.joints)
    if not accepted.smooth_covariates:
        result = _with_unexplained_alternative(search, tested, result)
    further = (*_own_gravity(search, i, table), *_own_torque(search, i))
    further += _simpler_compliances(search, i, table, tested)
    result = _with_confounded_laws(result, further)
    load = unstated_load(search, i)
    if load is None or (load.effect, load.where) in {
        (a.effect, a.where) for a in result.alternatives
    }:
        return result
    return replace(result, alternatives=(*result.alternatives, load))


def _with_sets_of_both(
    search: Search, i: int, explanations: Sequence[Hypothesis], shares: Counter[tuple]
) -> Counter[tuple]:
    """Shares of the names, where sets that hold another one in addition to the finding count for the finding.

    A term that is missing next to the finding may explain more than it. Only one that makes the same signature is an
    alternative to it: next to any other, the finding explains as much as without it.
    """
    key = search.accepted[i].key
    others = {}
    by_weight = sorted(explanations, key=lambda h: -h.log_weight)
    for h in by_weight:
        if h.key != key and shares[h.key] >= LISTED_PROBABILITY:
            others.setdefault(h.key, h)
    odds = odds_of_both(search, i, list(others.values())) if others else ()
    joint_odds = float(sum(shares[other] * o for other, o in zip(others, odds)))
    out = Counter({name: share / (1 + joint_odds) for name, share in shares.items()})
    out[key] += joint_odds / (1 + joint_odds)
    return out


def with_equivalent_places(finding: Finding, joints: int) -> Finding:
    """The finding of a function without a law, with the places at which it is the same: all are equally probable."""
    places = equivalent_places(finding.where, finding.depends_on, joints)
    if finding.effect != "unknown" or not places:
        return finding
    count = 1 + len(places)
    probability = finding.probability / count
    description = (finding.label, probability, 1.0, SAME_FUNCTION)
    others = tuple(Alternative(finding.effect, where, *description) for where in places)
    unchanged = tuple(
        a for a in finding.alternatives if a.effect != finding.effect or a.where not in places
    )
    return replace(finding, probability=probability, alternatives=(*others, *unchanged))


def _with_confounded_laws(finding: Finding, further: Sequence[Alternative] = ()) -> Finding:
    """The finding with the laws that make the same of any poses; all share what it and these have, each as much.

    further: laws that make the same in these poses.
    """
    laws = [law for effect in finding.effects for law in effect.confounded_with]
    if not laws and not further:
        return finding
    alternatives = (Alternative(*law, 0.0, 1.0, CONFOUNDED) for law in laws)
    named = [*alternatives, *further]
    keys = {(law.effect, law.where) for law in named}
    same = [a for a in finding.alternatives if (a.effect, a.where) in keys]
    others = tuple(a for a in finding.alternatives if a not in same)
    total = finding.probability + sum(a.probability for a in same)
    share = total / (1 + len(named))
    named = [replace(law, probability=share) for law in named]
    return replace(finding, probability=share, alternatives=(*named, *others))


def _own_gravity(search: Search, i: int, table: Sequence[Hypothesis]) -> tuple[Alternative, ...]:
    """The gravity compliance of the joint of an accepted first harmonic, where this makes the same in these poses.

    The torque of links whose masses are not stated is a first harmonic of the joint's angle as far as the links beyond
    keep their direction, as the forearm of a parallelogram does. Only the number of unknowns then decides between the
    two laws. Its probability is 0 here: the confounded laws share what they have.
    """
    accepted = search.accepted[i]
    if accepted.effect != TransmissionHarmonic.effect or accepted.effects[0].order != 1:
        return ()
    key = GravityCompliance.effect, accepted.where
    gravity_laws = [h for h in table if h.key == key and type(h.effects[0]) is GravityCompliance]
    if not gravity_laws:
        return ()
    problem = search.problem.conditional_on(search.other_indices(i))
    columns = accepted.columns(problem)
    wave = problem.orthogonal_basis(columns)
    gravity = problem.orthogonalise(gravity_laws[0].columns(problem))
    shared = ((wave.T @ gravity) ** 2).sum()
    length = max((gravity**2).sum(), 1e-300)
    likeness = float(shared / length)
    why = likeness_text(likeness)
    if likeness >= CONFOUNDED_SHARE:
        return (Alternative(*key, "", 0.0, likeness, why),)
    return ()


def _simpler_compliances(
    search: Search, i: int, table: Sequence[Hypothesis], tested: Hypothesis
) -> tuple[Alternative, ...]:
    """Compliances elsewhere that explain as much as an accepted one but for chance, with fewer coefficients.

    A bearing of joint 1 tilts as a pedestal whose two compliances are equal. Only the sizes that are usual at either
    place then speak for the one with more. Where first moments are estimated, too, the laws share these.
    """
    accepted = search.accepted[i]
    chance = CLOSE_GAIN * search.variance()
    if accepted.effect not in ELASTIC or accepted.label.startswith(LABEL):
        return ()
    found: dict[tuple[str, str], Alternative] = {}
    for h in table:
        is_simpler = h.effect in ELASTIC and h.key != accepted.key and h.rank < tested.rank
        if is_simpler and h.gain > tested.gain - chance:
            likeness = min(1.0, h.gain / max(tested.gain, 1e-300))
            why = likeness_text(likeness)
            found.setdefault(h.key, Alternative(*h.key, h.label, 0.0, likeness, why))
    return tuple(found.values())


def _own_torque(search: Search, i: int) -> tuple[Alternative, ...]:
    """The torque of a hose or a spring at the joint of an accepted error curve, where it makes the same in these poses.

    Either deflects the joint by a function of its own angle alone: no pose distinguishes them. The torque has few
    bends; what gears and encoders repeat, or a worn patch, has more. A slide has no such torque.
    """
    curve = next(iter(search.accepted[i].effects), None)
    if not isinstance(curve, JointCurve) or search.bench.chain.slides(curve.number):
        return ()
    torque = JointTorque(curve.where, curve.start, curve.end)
    other_terms = search.other_indices(i)
    problem = search.problem.conditional_on(other_terms)
    signature = problem.columns_of(torque)
    basis = problem.orthogonal_basis(signature)
    columns = search.problem.added[i] @ search.problem.values[i]
    curved = problem.orthogonalise(columns)
    shared = ((basis.T @ curved) ** 2).sum()
    likeness = float(shared / max(curved @ curved, 1e-300))
    label = "of a spring or a hose"
    as_torque = Alternative(torque.effect, torque.where, label, 0.0, likeness, CONFOUNDED)
    return (as_torque,) if likeness >= CONFOUNDED_SHARE else ()


def bare_finding(h: Hypothesis) -> Finding:
    """An accepted term by its name and effects alone."""
    return Finding(*h.key, h.label, h.effects, h.p, 1.0, 0.0, h.gain, h.smooth_covariates)


def _explains_more(function: Hypothesis, law: Hypothesis, explained: float) -> bool:
    """Whether a nonparametric function explains more than the model error of the laws, of all that is `explained`.

    A function of the same covariates as the law, at its place, differs from the law only by its shape. Then only the
    model error of this law is permitted, as a share of what it explains itself. For other functions the error of all
    that is explained is permitted, before the place of the law is in doubt. For a function of a joint's own angle see
    `is_law_of_function`.
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
    remaining = list(findings)
    for general in findings:
        special_cases = [
            finding
            for finding in remaining
            if finding is not general and _is_case_of(finding, general)
        ]
        if special_cases and any(finding is general for finding in remaining):
            merged = [
                _merged(general, special_cases) if finding is general else finding
                for finding in remaining
            ]
            remaining = [
                finding for finding in merged if not any(finding is part for part in special_cases)
            ]
    return remaining


def _is_case_of(finding: Finding, general: Finding) -> bool:
    """Whether all effects of a finding may act several at a place, where one of the other contains them."""
    if finding.where != general.where or not finding.effects or not general.effects:
        return False
    contained = {name for effect in general.effects for name in effect.subsumes}
    return all(effect.coexists and effect.effect in contained for effect in finding.effects)


def _merged(general: Finding, special_cases: Sequence[Finding]) -> Finding:
    """The general finding with the effects of its special cases."""
    names = {(part.effect, part.where) for part in special_cases}
    merged = (general, *special_cases)
    others = [a for a in general.alternatives if (a.effect, a.where) not in names]
    probability = max(finding.probability for finding in merged)
    listed = sum(a.probability for a in others)
    unshared = max(1 - probability, 0.0)  # a sum of shares may exceed 1 by rounding
    scale = min(1.0, unshared / max(listed, 1e-300))
    squares = sum(finding.size**2 for finding in merged)
    size = float(np.sqrt(squares))
    alternatives = tuple(replace(a, probability=a.probability * scale) for a in others)
    labels = (finding.label for finding in merged if finding.label)
    return replace(
        general,
        label=", ".join(labels),
        effects=tuple(effect for finding in merged for effect in finding.effects),
        p_value=min(finding.p_value for finding in merged),
        probability=probability,
        size=size,
        gain=sum(finding.gain for finding in merged),
        alternatives=alternatives,
    )


def _with_set_posterior(
    finding: Finding, shares: Mapping[tuple, float], names: Mapping[tuple, EffectPosterior]
) -> Finding:
    """The finding with the posterior over sets of elastic terms in place of single exchanges between these.

    Everything else keeps its share: together the elastic terms have what they had.
    """
    posterior = names[finding.effect, finding.where]
    elastic = sum(share for key, share in shares.items() if key in names)
    known = {(a.effect, a.where): a for a in finding.alternatives}
    others = [a for key, a in known.items() if key not in names]
    replacements = []
    for key, share, likeness in posterior.replacements:
        probability = elastic * share
        why = likeness_text(likeness)
        label = known[key].label if key in known else ""
        replacements.append(Alternative(*key, label, probability, likeness, why))
    ranked = sorted((*replacements, *others), key=lambda a: -a.probability)
    return replace(
        finding,
        probability=elastic * posterior.probability,
        alternatives=tuple(ranked[:MOST_LISTED]),
        variation=posterior.variation,
    )


def _alternatives(
    table, shares, tested, unexplained: float, noise: float
) -> tuple[Alternative, ...]:
    """Alternatives in the 95 % credible set, or so near in explained variance that the residual could decide.

    Also a compliance at another place that explains as much but for chance: only its prior differs. Also a joint
    compliance under its own links alone: it equals one with estimated masses if the load's mass is zero.
    """
    covered, out = 0.0, []
    special = tested.effects[0].subsumes if tested.label == LABEL else ()
    for key, share in shares.most_common():
        alternatives_of_key = (h for h in table if h.key == key)
        other = max(alternatives_of_key, key=lambda h: h.log_weight)
        lost_gain = tested.gain - other.gain  # than the finding explains
        are_elastic = other.effect in ELASTIC and tested.effect in ELASTIC
        is_special = other.effect in special and other.where == tested.where
        is_law = not other.smooth_covariates and other.rank <= tested.rank
        is_near = is_special or (are_elastic and lost_gain < noise)
        is_near = is_near or (
            is_law and 0 < unexplained and lost_gain < unexplained and len(out) < MOST_LISTED
        )
        if key != tested.key and (covered < CONFIDENCE or is_near):
            likeness = min(1.0, other.gain / max(tested.gain, 1e-300))
            why = likeness_text(likeness)
            out.append(
                Alternative(*key, other.label, share, likeness, why, other.missing_covariate)
            )
        covered += share
    return tuple(out)


def _with_unexplained_alternative(search: Search, tested: Hypothesis, finding: Finding) -> Finding:
    """The finding, its probability reduced by that of one unknown effect at its place that causes it and the remainder.

    One unknown effect is simpler than two effects at one place, but its direction must equal that of the law by chance
    up to a share s of the whole. Among P directions one lies so near to r given ones with a probability of about
    s^((P - r) / 2) (tail of the beta distribution of a squared correlation). If the remainder is at a link or the base,
    which may move in any direction, a law of one joint has one direction, however many parameters its function has. A
    remainder at the joint itself rotates about the same axis: then only the function, of r parameters, coincides.
    The reduction is weighted by the probability that the remainder is at this place, since one unknown effect leaves a
    remainder at every place.
    """
    unexplained, moves, port, is_there = _unexplained_at_place(search, tested)
    if unexplained <= 0:
        return finding
    share = unexplained / (unexplained + tested.gain)
    places = len({site.where for site in search.problem.sites})
    two = (1 - RARE_PRIOR) * np.exp(SECOND) / (1 if moves else places)
    directions = 1 if port == "frame" and _has_one_axis(search, tested) else tested.rank
    single = RARE_PRIOR * share ** (max(_MAX_DIRECTIONS - directions, 1) / 2)
    sure = float(1 - is_there * single / (two + single))
    other = Alternative(
        "unknown",
        finding.where,
        "one cause of this and of the structure that remains there",
        finding.probability * (1 - sure),
        1.0,
        "what is left at this place is beyond chance",
    )
    alternatives = (other, *finding.alternatives)
    return replace(finding, probability=finding.probability * sure, alternatives=alternatives)


def explains_movement(search: Search, tested: Hypothesis) -> bool:
    """Whether the random effect at its place is what a law makes of a covariate that was not recorded."""
    if search.random_effect is None or search.random_effect.site.where not in same_place(tested):
        return False
    return any(
        a.effect == tested.effect for a in unrecorded_causes(search.random_effect, search.problem)
    )


def with_unrecorded_covariates(search: Search, finding: Finding) -> Finding:
    """The finding with the effects of covariates not recorded that may cause the random effect at its place."""
    if search.random_effect is None or search.random_effect.site.where != finding.where:
        return finding
    known = {(a.effect, a.where, a.label) for a in finding.alternatives}
    unrecorded = []
    causes = unrecorded_causes(search.random_effect, search.problem)
    for a in causes:
        is_asked = finding.effect in ("unknown", a.effect)
        if is_asked and (a.effect, a.where, a.label) not in known:
            unrecorded.append(a)
    alternatives = (*finding.alternatives, *unrecorded)
    return replace(finding, alternatives=alternatives)


def _has_one_axis(search: Search, law: Hypothesis) -> bool:
    """Whether a law turns one joint."""
    chain = search.bench.chain
    ports = {effect.port for effect in law.effects}
    is_of_joints = ports == {"joint"}
    return is_of_joints and all(len(effect.port_indices(chain)) == 1 for effect in law.effects)


def _unexplained_at_place(search: Search, law: Hypothesis) -> tuple[float, bool, str, float]:
    """Sum of squares of what is unexplained at a law's place next to it; whether it is the law's own covariate, not
    recorded, that may make it; through which port the largest part acts; and the probability that it is there.

    A drift of the session has no exact law: what is left of it in time is the same drift.
    """
    places, noise = same_place(law), search.variance()
    unexplained = [(0.0, "", 0.0)]
    table = search.table(search.accepted_indices)
    functions = [h for h in table if h.smooth_covariates]
    total = logsumexp([h.log_weight for h in functions]) if functions else 0.0
    local_functions = [h for h in functions if h.where in places]
    if law.effects and all(e.of_session and e.reads == ("time",) for e in law.effects):
        local_functions = [h for h in local_functions if h.smooth_covariates != ("time",)]
    probability = float(np.exp([h.log_weight - total for h in local_functions]).sum())
    for h in local_functions:
        if h.p / h.weight <= search.level:
            unexplained.append((h.gain - h.rank * noise, _port(h), probability))
    for i, h in enumerate(search.accepted):
        if h.smooth_covariates and h.where in places:
            unexplained.append((search.conditional_hypothesis(i).gain, _port(h), 1.0))
    moves = search.random_effect is not None and search.random_effect.site.where in places
    if moves:
        site = search.random_effect.site
        unexplained.append((movement(search.random_effect), site.port, 1.0))
    largest, port, is_there = max(unexplained)
    return largest, explains_movement(search, law), port, is_there


def _port(function: Hypothesis) -> str:
    """The port of a smooth nonparametric alternative; "" where its row does not say."""
    return getattr(function.source, "port", "")
