"""Searches in scans of balls, whose weights depend on what is found there."""

from collections.abc import Callable

from workbench.diagnosis.linear.problem import Found

_ROUNDS = 4


def find_in_weighed_scans(bench, find: Callable[..., Found]) -> tuple[object, Found]:
    """The bench with the weights that belong to what a search finds on it, and what it finds.

    The first search has weights next to nothing: what the baseline lacks is taken for errors of the poses, so that
    such errors are not taken for an effect. They blur an effect that is there. The search is therefore repeated with
    the weights next to what it accepts, until they stay. Where it finds nothing, and of all but scans, there is one.
    """
    if bench.chain is None or bench.roots_of_points is None:
        return bench, find(bench)
    bench = bench.weighed_next_to(()) or bench
    found = find(bench)
    for _ in range(_ROUNDS):
        effects = [effect for finding in found.findings for effect in finding.effects]
        other = bench.weighed_next_to(effects) if effects else None
        if other is None:
            break
        bench, found = other, find(other)
    return bench, found
