"""How far long work has come, and about how long it will still take, as one line for a person."""

import time
from collections.abc import Callable

_BEFORE_A_GUESS_S = 2.0


def paced(say: Callable[[str], None], what: str, clock: Callable[[], float] = time.monotonic):
    """A function of (done, total) that says `what`, how many of how many, and the time left.

    say: takes one line; what: "image", "scan" …; clock: seconds.
    """
    start = clock()

    def tick(done: int, total: int) -> None:
        spent = clock() - start
        line = f"{what} {done} of {total}"
        if 0 < done < total and spent > _BEFORE_A_GUESS_S:
            line += f", about {duration(spent / done * (total - done))} left"
        say(line)

    return tick


def duration(seconds: float) -> str:
    """'40 s', '3 min', '2 h': as exactly as a guess deserves."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{round(seconds / 60)} min" if seconds < 5400 else f"{round(seconds / 3600)} h"
