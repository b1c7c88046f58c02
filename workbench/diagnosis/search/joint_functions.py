"""One error curve in place of a series of laws of one joint's angle: harmonics and a curve are one function there."""

from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.search.state import Search

CURVE, HARMONIC = "joint-curve", "transmission-harmonic"
_FEW = 2  # harmonics of a joint that stand by themselves
_AS_GOOD = 0.95  # share of what the laws together explain that the curve must explain


def merge_joint_functions(search: Search) -> None:
    """Replace the laws of one joint's angle by one curve, where there are a curve and others, or many harmonics.

    The curve of fewest terms that explains as much; where none does, the laws stay.
    """
    for place in sorted({h.where for h in search.accepted if h.effect in (CURVE, HARMONIC)}):
        members = tuple(
            i
            for i in search.everyone
            if search.accepted[i].where == place and search.accepted[i].effect in (CURVE, HARMONIC)
        )
        has_curve = any(search.accepted[i].effect == CURVE for i in members)
        if len(members) > (1 if has_curve else _FEW):
            _merge(search, place, members)


def _merge(search: Search, place: str, members: tuple[int, ...]) -> None:
    others = tuple(i for i in search.everyone if i not in members)
    together = search.together(members)
    curve = _smallest(search.table(others), place, _AS_GOOD * together)
    if curve is None:
        return
    search.say(f"{CURVE} at {place} {curve.label}: in place of {len(members)} laws of its angle")
    kept = tuple(search.accepted[i] for i in others)
    search.accepted = (*kept, curve)
    search.solve()


def _smallest(table: list[Hypothesis], place: str, least: float) -> Hypothesis | None:
    """The curve of fewest terms at a place that gains at least so much; None where there is none."""
    curves = [h for h in table if h.effect == CURVE and h.where == place and h.gain >= least]
    return min(curves, key=lambda h: h.effects[0].terms, default=None)


__all__ = ["merge_joint_functions"]
