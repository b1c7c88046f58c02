"""Searches inside folds, in processes of their own; the first of them while this process still searches all samples."""

import pickle
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import ExitStack

import numpy as np

from workbench.core.memory import release_freed_memory
from workbench.diagnosis.linear.problem import Bench
from workbench.machine.processes import local, one_thread

Search = Callable[[Bench, np.ndarray], list]
_process_state: dict = {}  # of a process that searches: the bench and the search, sent once


class FoldSearches:
    """What `search(bench, subset)` gives of subsets (n,) bool of the samples, in up to `jobs` processes; a context.

    With one job all is done in this process. A subset is known by its samples: what was started for it early is what
    is asked for later.
    """

    def __init__(self, search: Search, jobs: int = 1):
        self.search, self.jobs = search, jobs
        self._bench: Bench | None = None
        self._pool: Executor | None = None
        self._stack = ExitStack()
        self._futures: dict[bytes, Future] = {}
        self._waiting: deque[np.ndarray] = deque()
        self._lock = threading.Lock()

    def __enter__(self) -> "FoldSearches":
        return self

    def __exit__(self, *error) -> None:
        self._waiting.clear()
        self._stack.close()

    @property
    def has_begun(self) -> bool:
        """Whether processes search, or none will."""
        return self.jobs == 1 or self._bench is not None

    def start(self, bench: Bench, subsets: Iterable[np.ndarray]) -> None:
        """Start searching subsets of the samples, one after the other on every core that this process does not use."""
        if self.has_begun:
            return
        self._open(bench)
        self._waiting.extend(subsets)
        for _ in range(self.jobs - 1):
            self._submit_next()

    def use_all_cores(self) -> None:
        """Search one more subset at a time, on the core that the search of all samples has left."""
        if self._bench is not None:
            self._submit_next()

    def results(self, bench: Bench, subsets: Iterable[np.ndarray]) -> Iterator[list]:
        """What the search gives of each subset, in their order; this process does nothing else meanwhile."""
        self._waiting.clear()
        if self.jobs == 1:
            yield from (self.search(bench, part) for part in subsets)
            return
        if self._bench is not bench:
            self._open(bench)
        subsets = list(subsets)
        asked = {part.tobytes() for part in subsets}
        for name, future in self._futures.items():
            if name not in asked:
                future.cancel()
        for future in [self._submit(part) for part in subsets]:
            yield future.result()

    @property
    def executor(self) -> Executor | None:
        """The processes, for other work once all results are there; None where this process does all."""
        return self._pool

    def _open(self, bench: Bench) -> None:
        """Start processes that know the bench; those that know another one end."""
        self._stack.close()
        self._futures.clear()
        release_freed_memory()
        module = "workbench.diagnosis.search.select"
        self._bench = bench
        # as bytes: a process may start while this one computes what the bench keeps
        sent = pickle.dumps((bench, self.search))
        self._pool = self._stack.enter_context(local(self.jobs, module, _begin, sent))

    def _submit(self, part: np.ndarray) -> Future:
        with self._lock:
            name = part.tobytes()
            if name not in self._futures:
                self._futures[name] = self._pool.submit(_search, part)
            return self._futures[name]

    def _submit_next(self, _: Future | None = None) -> None:
        """Submit the next part that waits, if any; again once it is done."""
        try:
            part = self._waiting.popleft()
        except IndexError:
            return
        self._submit(part).add_done_callback(self._submit_next)


def _begin(sent: bytes) -> None:
    one_thread()
    _process_state["bench"], _process_state["search"] = pickle.loads(sent)


def _search(part: np.ndarray) -> list:
    return _process_state["search"](_process_state["bench"], part)
