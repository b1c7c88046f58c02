"""Executors of the runs: processes of this machine, a Dask cluster, or any `concurrent.futures.Executor`."""

import asyncio
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager, suppress

from workbench.core.errors import InputError
from workbench.machine import processes


def local(workers: int) -> AbstractContextManager[Executor]:
    """Processes of this machine that have the runs loaded."""
    return processes.local(workers, "workbench.studies.runs")


@contextmanager
def dask(address: str) -> Iterator[tuple[Executor, int]]:
    """An existing Dask cluster and its number of threads. Raises InputError if it is not available.

    The scheduler reassigns the work of a lost worker.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "--scheduler: expected the package distributed, found none; type pip install "
            "'vision-sensor-workbench[study]'"
        ) from None
    try:
        client = Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as problem:
        raise InputError(
            f"--scheduler {address}: expected a Dask scheduler that answers, found none "
            f"({type(problem).__name__}); start one with `dask scheduler`, or leave the option "
            "out"
        ) from None
    try:
        threads = sum(client.nthreads().values())
        if not threads:
            raise InputError(
                f"--scheduler {address}: expected workers, found none; start some with `dask worker "
                f"{address}`"
            )
        yield client.get_executor(pure=False, retries=2), threads
    except _lost_errors() as problem:
        raise InputError(
            f"--scheduler {address}: the connection to the Dask cluster was lost ({type(problem).__name__}). All runs "
            "that were finished are saved; the same command continues with the remaining ones"
        ) from problem
    finally:
        with suppress(*_lost_errors()):
            client.close()


def _lost_errors() -> tuple[type[BaseException], ...]:
    """Exceptions of `distributed` for futures and connections of a scheduler that has ended."""
    from concurrent.futures import CancelledError as CancelledFuture

    from distributed.client import FutureCancelledError
    from distributed.comm.core import CommClosedError

    return (
        asyncio.CancelledError,
        CancelledFuture,
        CommClosedError,
        FutureCancelledError,
        ConnectionError,
        TimeoutError,
    )
