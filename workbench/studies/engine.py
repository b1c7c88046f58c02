"""Execution of a study: parts are submitted to an executor and written as they finish; a study can be resumed."""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from workbench.core.errors import InputError
from workbench.machine.processes import one_thread
from workbench.studies.robots import Row
from workbench.studies.spec import Study
from workbench.studies.tables import parts_done, remove_damaged_parts, write_part
from workbench.studies.variation import count

_PART_COUNT = 400
"""Approximate number of parts: a limited number of files, and little lost work if a study is stopped."""
_LONGEST = 500
_ATTEMPTS = 3
RunPart = Callable[[Study, range], tuple[list[Row], float]]


@dataclass(frozen=True)
class Done:
    """Work of a study: `runs` in total, `made` in this call, their `seconds` on the workers, and `wall` time in s."""

    runs: int
    made: int
    seconds: float
    wall: float
    workers: int

    @property
    def overhead(self) -> float | None:
        """Worker time outside of runs, relative to the time in runs; None if no run was made."""
        worker_time = self.wall * self.workers
        if not self.made:
            return None
        return max(worker_time / self.seconds - 1, 0.0)


def part_size(study: Study) -> int:
    """Runs per part: from the study file, else from the number of runs only. It does not depend on the machine."""
    return study.part or min(max(count(study) // _PART_COUNT, 1), _LONGEST)


def parts_of(study: Study) -> list[range]:
    """Run numbers of each part."""
    size, runs = part_size(study), count(study)
    return [range(first, min(first + size, runs + 1)) for first in range(1, runs + 1, size)]


def do_part(study: Study, runs: range) -> tuple[list[Row], float]:
    """Rows of some runs and their duration in s; the unit of work of a worker."""
    one_thread()
    from workbench.studies.runs import row_of

    start = time.perf_counter()
    return [row_of(study, run) for run in runs], time.perf_counter() - start


def carry_out(
    study: Study,
    folder: Path,
    executor: Callable[[], object],
    workers: int,
    tick: Callable[[int, int], None],
    work: RunPart = do_part,
) -> Done:
    """Compute every part that is missing in `folder` and write it there.

    executor: returns a context manager that yields a `concurrent.futures.Executor`; called again if one breaks.
    workers: number of concurrent runs; tick: called with runs done and in total. Only a few parts are in flight, which
    limits the memory. Raises InputError, and any other error of a run.
    """
    part_runs, start = parts_of(study), time.perf_counter()
    remove_damaged_parts(folder)
    remaining_parts = sorted(set(range(len(part_runs))) - parts_done(folder))
    total, seconds, rows_written = count(study), 0.0, 0
    done = total - sum(len(part_runs[k]) for k in remaining_parts)
    tick(done, total)

    def submit(pool, k):
        return pool.submit(work, study, part_runs[k])

    for k, (rows, part_seconds) in _results(remaining_parts, submit, executor, 2 * workers + 1):
        write_part(folder, k, rows)
        seconds = seconds + part_seconds
        rows_written = rows_written + len(rows)
        tick(done + rows_written, total)
    return Done(total, rows_written, seconds, time.perf_counter() - start, workers)


def _results(
    remaining_parts: Sequence[int], submit, executor, ahead: int
) -> Iterator[tuple[int, tuple]]:
    """Number and result of each part in order of completion; lost parts of a broken pool go to a new pool."""
    for _ in range(_ATTEMPTS):
        waiting: list[int] = list(remaining_parts)
        lost: list[int] = []
        if not waiting:
            return
        with executor() as pool:
            yield from _streamed(waiting, lost, lambda k: submit(pool, k), ahead)
        remaining_parts = sorted(lost)
    if remaining_parts:
        raise InputError(
            f"study, part {remaining_parts[0] + 1}: the process of these runs died {_ATTEMPTS} times, "
            "probably for lack of "
            "memory. Use fewer workers (--workers 1)"
        )


def _streamed(
    waiting: list[int], lost: list[int], submit, ahead: int
) -> Iterator[tuple[int, tuple]]:
    flying: dict[Future, int] = {}
    order = iter(waiting)
    try:
        while True:
            for k in islice(order, ahead - len(flying)):
                try:
                    flying[submit(k)] = k
                except BrokenProcessPool:
                    lost += [k, *order]
            if not flying:
                return
            for future in wait(flying, return_when=FIRST_COMPLETED).done:
                k = flying.pop(future)
                try:
                    result = future.result()
                except BrokenProcessPool:
                    lost.append(k)
                    continue
                yield k, result
    finally:
        for future in flying:
            future.cancel()


@contextmanager
def given(pool: Executor):
    """An executor that the caller opens and closes."""
    yield pool
