"""Worker processes on this machine: one thread each, by default one per core."""

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager

THREADS = (
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"),
    *("VECLIB_MAXIMUM_THREADS", "OPENCV_FOR_THREADS_NUM"),
)

_BLAS_THREADS = (
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"),
    "VECLIB_MAXIMUM_THREADS",
)
_IS_STATED = any(name in os.environ for name in _BLAS_THREADS)
"""Whether the user states a number of threads; later the functions below write into the environment themselves."""


def one_blas_thread() -> None:
    """Let linear algebra use one thread, unless the environment says otherwise; call it before numpy is loaded.

    The matrices of a fit are small: threads that wait for one another take many times longer on a busy machine.
    """
    for name in _BLAS_THREADS[1:]:
        os.environ.setdefault(name, "1")


@contextmanager
def limited_blas_threads() -> Iterator[None]:
    """One thread of linear algebra inside the block, also where numpy is loaded already; the old number after it.

    Numbers that the environment states are kept. Libraries are found by threadpoolctl.
    """
    if _IS_STATED:
        yield
        return
    import numpy  # noqa: F401
    import scipy.linalg  # noqa: F401  # has a library of its own, which has to be loaded to be limited
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield


def one_thread() -> None:
    """Limit the numerical libraries of this process to one thread: the processes already use all cores."""
    import sys

    os.environ.update(dict.fromkeys(THREADS, "1"))  # read when the libraries are loaded
    for name, call in (("cv2", "setNumThreads"), ("torch", "set_num_threads")):
        if name in sys.modules:
            getattr(sys.modules[name], call)(1)


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def local(workers: int, loaded: str, begin: Callable = one_thread, *given) -> Iterator[Executor]:
    """Pool of single-threaded processes on this machine; they inherit no open files of this process.

    If the system can fork, they come from a server that has loaded the module `loaded` once. Each calls `begin` with
    the arguments `given`, and ends when this process ends, however it ends.
    """
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(
        dict.fromkeys(THREADS, "1")
    )  # a new process inherits them before it loads libraries
    pool = ProcessPoolExecutor(
        workers,
        mp_context=_context(loaded),
        initializer=_begin_worker,
        initargs=(begin, *given),
    )
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _begin_worker(begin: Callable, *given) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    begin(*given)


def _end_with_parent() -> None:
    """Wait for the end of the process that made this one: a killed process cannot end its workers itself."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _context(loaded: str):
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([loaded])
    return context
