"""Names by marginal posterior: an accepted law against other effects at its place, summed over their variants."""

from scipy.special import logsumexp

from workbench.diagnosis.levels import WORTHWHILE
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.search.posterior import is_elastic
from workbench.diagnosis.search.state import Search


def exchange_names(search: Search) -> None:
    """Exchange accepted laws for effects whose posterior, summed over the variants at a place, is higher.

    The search compares sets of single variants. A step at one of many instants has a small share of its family's prior
    at each of them, so that a law without such an option may win against every single instant and still be less
    probable than all of them together. Names of elastic laws come from sets (`search.posterior`).
    """
    for i in search.everyone:
        other = _likelier(search, i)
        if other is not None:
            accepted = list(search.accepted)
            accepted[i] = other
            search.accepted = tuple(accepted)
            search.solve()


def _likelier(search: Search, i: int) -> Hypothesis | None:
    """The best variant of the effect with the highest marginal posterior; None where that is the accepted one."""
    mine = search.accepted[i]
    if mine.unnamed or is_elastic(mine):
        return None
    families: dict[tuple, list[Hypothesis]] = {}
    for h in search.table(search.others(i)):
        if not h.unnamed and not is_elastic(h):
            families.setdefault(h.key, []).append(h)
    if mine.key not in families:
        return None
    marginal = {
        key: float(logsumexp([h.log_weight for h in members])) for key, members in families.items()
    }
    best = max(marginal, key=marginal.get)
    if marginal[best] - marginal[mine.key] < WORTHWHILE:
        return None
    return max(families[best], key=lambda h: h.log_weight)


__all__ = ["exchange_names"]
