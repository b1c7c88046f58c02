"""Harmonics of one order at several joints: most arms have gears of one kind and ratio at several joints.

An order that one joint has is likely at the others, too. The harmonics of all joints together are then one hypothesis
with two numbers a joint and a single prior of the order: it shows harmonics of which none is significant by itself.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from robot_model.effects.curve import JointCurve
from robot_model.effects.transmission import TransmissionHarmonic
from workbench.diagnosis.levels import MAJORITY
from workbench.diagnosis.linear.candidates import Scan
from workbench.diagnosis.linear.evidence import Projected, Scores, scan_moments
from workbench.diagnosis.linear.hypotheses import SMOOTH_LEVEL, Hypothesis, row_of_scan
from workbench.diagnosis.linear.problem import Problem

LOG_ODDS_OF_COMMON = 0.0
"""Log prior odds that a further joint has an order which another joint has: as likely as not."""
_LOW = 4.0
"""Orders up to this one are those of eccentric gears and encoders, which any joint may have: none is a gear ratio."""
_HALVES = 40.0
"""Order up to which half-integer orders are distinguished."""


def order_group(h: Hypothesis) -> float:
    """The order of a harmonic above those that any joint has, rounded as the searched ones; nan of other terms."""
    effect = h.effects[0] if h.effects and not h.smooth_covariates else None
    if not isinstance(effect, TransmissionHarmonic) or effect.order <= _LOW:
        return np.nan
    return rounded_order(effect.order)


def rounded_order(order: float) -> float:
    """An order, rounded to those that are distinguished."""
    step = 0.5 if order < _HALVES else 1.0
    return float(np.rint(order / step) * step)


def is_curve(h: Hypothesis) -> bool:
    """Whether a term is the error curve of a joint, of which harmonics at this joint are a part.

    An error of many orders shows no gear, so that its orders say nothing of other joints, nor theirs of it.
    """
    return not h.smooth_covariates and any(isinstance(e, JointCurve) for e in h.effects)


def groups_of(terms: Sequence[Hypothesis]) -> dict[float, set[str]]:
    """Orders beyond those that any joint has among some terms, with the joints without a curve that have each."""
    with_curve = {h.where for h in terms if is_curve(h)}
    groups: dict[float, set[str]] = {}
    for h in terms:
        group = order_group(h)
        if np.isfinite(group) and h.where not in with_curve:
            groups.setdefault(group, set()).add(h.where)
    return groups


def required_harmonics(problem: Problem, terms: Sequence[Hypothesis]) -> list[tuple[str, str]]:
    """(family, label) of the harmonics at all joints that have the order of one of some terms."""
    groups = groups_of(terms)
    required = []
    for scan in harmonic_scans(problem) if groups else ():
        for i, option in enumerate(scan.options):
            if rounded_order(option) in groups:
                required.append((scan.family, scan.word.format(scan.options[i])))
    return required


def with_common_orders(
    table: Sequence[Hypothesis], terms: Sequence[Hypothesis]
) -> list[Hypothesis]:
    """A table conditional on some terms, with the prior odds of their orders at other joints; the likeliest first.

    Harmonics of these orders share half of the error level.
    """
    groups = groups_of(terms)
    if not groups:
        return list(table)
    with_curve = {h.where for h in terms if is_curve(h)}
    common = []
    for h in table:
        joints = groups.get(order_group(h), set())
        common.append(bool(joints) and h.where not in joints | with_curve)
    count = len({h.where for h, is_common in zip(table, common) if is_common})
    if not count:
        return list(table)
    rows = []
    for h, is_common in zip(table, common):
        if is_common:
            weight = MAJORITY * (1 - SMOOTH_LEVEL) / count
            bonus = LOG_ODDS_OF_COMMON - h.log_prior
            rows.append(replace(h, log_bonus=max(bonus, 0.0), weight=weight))
        else:
            rows.append(replace(h, weight=(1 - MAJORITY) * h.weight))
    return sorted(rows, key=lambda h: -h.log_weight)


def harmonic_scans(problem: Problem) -> list[Scan]:
    """The scans of a problem over the orders of harmonics, one a joint."""
    name = TransmissionHarmonic.effect
    return [s for s in problem.scans if s.effect == name and not s.is_exact]


def harmonics_of_common_order(
    problem: Problem, table: Sequence[Hypothesis], accepted: Sequence[Hypothesis] = ()
) -> list[Hypothesis]:
    """The harmonics of the order that is most probable at several joints together; none where no order is.

    problem: conditional on what is accepted; table: of the same. Joints with an accepted curve have none.
    Each joint has the order or does not, either as likely as the other, so that its Bayes factor B counts as
    (1 + B) / 2.
    """
    known = {h.family: h for h in table if np.isfinite(order_group(h))}
    with_curve = {h.where for h in accepted if is_curve(h)}
    scans = [s for s in harmonic_scans(problem) if s.family in known and s.where not in with_curve]
    if len(scans) < 2:
        return []
    projected = Projected(problem)
    moments = [scan_moments(projected, scan) for scan in scans]
    scores = projected.score_groups(moments)
    order, log_odds = _most_probable_order(scans, scores)
    rows = [_row(scan, s, known[scan.family], order) for scan, s in zip(scans, scores)]
    harmonics = [h for h in rows if h is not None and h.evidence > 0]
    if len(harmonics) < 2 or log_odds + max(h.log_prior for h in harmonics) < 0:
        return []
    return harmonics


def common_order_p_value(problem: Problem) -> float:
    """p-value of harmonics of one order at several joints: F test of their columns, Bonferroni over the orders."""
    scans = harmonic_scans(problem)
    if len(scans) < 2:
        return 1.0
    projected = Projected(problem)
    moments = [scan_moments(projected, scan) for scan in scans]
    scores = projected.score_groups(moments)
    order = _most_probable_order(scans, scores)[0]
    columns = [s.columns_at(problem, order) for s in scans if order in s.options]
    joined = np.concatenate(columns, 1)
    moments = projected.column_moments(joined[None])
    scores_of_all = projected.score_hypotheses(moments)
    options = np.concatenate([scan.options for scan in scans])
    count = len(np.unique(options))
    p = float(scores_of_all.p[0])
    return min(1.0, p * count)


def _most_probable_order(scans: Sequence[Scan], scores: Sequence[Scores]) -> tuple[float, float]:
    """The order with the highest posterior odds at all joints together, and the log of these without its prior."""
    total: dict[float, float] = {}
    for scan, of_joint in zip(scans, scores):
        log_odds = np.logaddexp(0.0, of_joint.evidence)
        log_odds -= np.log(2)
        for option, value in zip(scan.options.tolist(), log_odds):
            present = total.get(option, 0.0)
            total[option] = present + float(value)
    order = max(total, key=total.get)
    return order, total[order]


def _row(scan: Scan, scores: Scores, known: Hypothesis, order: float) -> Hypothesis | None:
    """The harmonic of one order of a scan as a table has it; None where the scan has no such order.

    known: a row of the same family.
    """
    places = np.flatnonzero(scan.options == order)
    if not len(places):
        return None
    row = row_of_scan(scan, scores, int(places[0]))
    log_share = float(np.log(row.prior_weight / known.prior_weight))
    return replace(row, log_prior=known.log_prior + log_share, weight=known.weight)
