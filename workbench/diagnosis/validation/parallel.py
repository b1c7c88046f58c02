"""Searches inside folds, one a process where that is worth it: they know nothing of one another."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import numpy as np

from workbench.core.memory import release_freed_memory
from workbench.diagnosis.linear.problem import Bench
from workbench.machine.processes import local, one_thread

Search = Callable[[Bench, np.ndarray], list]
_held: dict = {}  # of a process that searches: the bench and the search, sent once


@contextmanager
def parallel_searches(
    bench: Bench, search: Search, jobs: int
) -> Iterator[Callable[[Iterable[np.ndarray]], Iterator[list]]]:
    """A function of parts of the samples, each (n,) bool: what `search(bench, part)` gives of each, in their order.

    jobs: processes; with one all is done here.
    """
    if jobs == 1:
        yield lambda parts: (search(bench, part) for part in parts)
        return
    release_freed_memory()
    with local(jobs, "workbench.diagnosis.search.select", _begin, bench, search) as pool:
        yield lambda parts: pool.map(_search, parts)


def _begin(bench, search) -> None:
    one_thread()
    _held.update(bench=bench, search=search)


def _search(part: np.ndarray) -> list:
    return _held["search"](_held["bench"], part)
