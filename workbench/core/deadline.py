"""A limit of processor time for a search whose result is optional, such as that for the cause of a misfit.

The functions that such searches spend their time in call `check`; without a limit it does nothing.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_SILENT_S = 3.0
_INTERVAL_S = 1.0


class OutOfTime(Exception):
    """A search reached its limit; the text says so in a sentence."""


class _Limit:
    def __init__(self, seconds: float, report: Callable[[str], None]):
        self.seconds, self.say = seconds, report
        self.start = time.process_time()
        self.reported = _SILENT_S - _INTERVAL_S

    def check(self) -> None:
        used_seconds = time.process_time() - self.start
        if used_seconds > self.seconds:
            raise OutOfTime(f"The search for a cause stopped after {self.seconds:.0f} s.")
        if used_seconds > self.reported + _INTERVAL_S:
            self.reported = used_seconds
            self.say(f"{used_seconds:.0f} s of at most {self.seconds:.0f} s")


_current: ContextVar[_Limit | None] = ContextVar("limit", default=None)


@contextmanager
def limited(seconds: float, report: Callable[[str], None] = lambda text: None) -> Iterator[None]:
    """Inside, `check` raises OutOfTime after so many seconds of processor time, and says how many are spent."""
    token = _current.set(_Limit(seconds, report))
    try:
        yield
    finally:
        _current.reset(token)


def check() -> None:
    """Raise OutOfTime where the limit of the search is reached; report the time spent about once a second."""
    limit = _current.get()
    if limit is not None:
        limit.check()
