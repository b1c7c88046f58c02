"""Who does the runs: processes of this machine, a Dask cluster, or any `concurrent.futures.Executor`."""

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager

from workbench.core.errors import InputError

THREADS = (
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"),
    *("VECLIB_MAXIMUM_THREADS", "OPENCV_FOR_THREADS_NUM"),
)


def one_thread() -> None:
    """Keep the numerical libraries of this process to one thread: runs fill the cores, threads would only push."""
    import sys

    os.environ.update(dict.fromkeys(THREADS, "1"))  # read when the libraries are loaded
    for name, call in (("cv2", "setNumThreads"), ("torch", "set_num_threads")):
        if name in sys.modules:
            getattr(sys.modules[name], call)(1)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def local(workers: int) -> Iterator[Executor]:
    """Processes of this machine, each with one thread, of which none inherits what this one has open.

    Where the system can fork, they come from a server that has loaded the libraries once.
    """
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))  # a fresh process takes them over before it loads anything
    context = _context()
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=one_thread)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _context():
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["workbench.study.runs"])
    return context


@contextmanager
def dask(address: str) -> Iterator[tuple[Executor, int]]:
    """A Dask cluster that is there already, and its number of threads; InputError where there is none.

    A worker that is lost has its work given to another by the scheduler.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--scheduler: expected the package distributed, found none; type pip install "
                         "'vision-sensor-workbench[study]'") from None  # fmt: skip
    try:
        client = Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as problem:
        raise InputError(f"--scheduler {address}: expected a Dask scheduler that answers, found none "
                         f"({type(problem).__name__}); start one with `dask scheduler`, or leave the option "
                         "out") from None
    try:
        threads = sum(client.nthreads().values())
        if not threads:
            raise InputError(f"--scheduler {address}: expected workers, found none; start some with `dask worker "
                             f"{address}`")
        yield client.get_executor(pure=False, retries=2), threads
    finally:
        client.close()
