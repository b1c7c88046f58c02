"""Results that are computed once."""

from collections.abc import Callable
from threading import Lock


class Memo:
    """Cache of computed values, for the `most` latest keys.

    Several threads may ask: the first figures are prepared in the background. Nobody waits for the result of another
    thread, so that a click never waits for a preparation; the same result is then computed twice.
    """

    def __init__(self, max_size: int):
        self._most = max_size
        self._known: dict[tuple, object] = {}
        self._lock = Lock()

    def get(self, key: tuple, compute: Callable):
        """Result of `compute`, computed once for a key."""
        with self._lock:
            if key in self._known:
                return self._known[key]
        value = compute()
        with self._lock:
            while len(self._known) >= self._most:
                self._known.pop(next(iter(self._known)))
            self._known[key] = value
        return value
