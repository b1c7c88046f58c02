"""Progress of long work and remaining time, as one line."""

import time
from collections.abc import Callable

_BEFORE_A_GUESS_S = 2.0
_FEW = 10
"""Steps so few that the first one, preparation included, says something about the others."""


def paced(say: Callable[[str], None], what: str, clock: Callable[[], float] = time.monotonic):
    """A function of (done, total) that reports `what`, the counts, and the remaining time.

    The pace is that of the steps after the first report, which includes the preparation.
    say: takes one line; what: "image", "scan" …; clock: seconds.
    """
    start = clock()
    first: list[tuple[int, float]] = []

    def tick(done: int, total: int) -> None:
        now = clock()
        line = f"{what} {done} of {total}"
        steps, seconds = done, now - start
        later = first and done > first[0][0]
        if later:
            steps, seconds = done - first[0][0], now - first[0][1]
        has_pace = steps > 0 and (later or total <= _FEW)
        if has_pace and done < total and now - start > _BEFORE_A_GUESS_S:
            line += f", about {duration(seconds / steps * (total - done))} left"
        if not first:
            first.append((done, now))
        say(line)

    return tick


def counted(
    say: Callable[[str], None], total: int, clock: Callable[[], float] = time.monotonic
) -> Callable[[str], None]:
    """A function of a text that reports the next of `total` steps, its number, and the remaining time.

    The remaining time assumes that the steps to come take as long as those that are finished.
    """
    start = clock()
    finished = 0

    def step(text: str) -> None:
        nonlocal finished
        spent = clock() - start
        line = f"{finished + 1} of {total}"
        if finished and spent > _BEFORE_A_GUESS_S:
            line += f", about {duration(spent / finished * (total - finished))} left"
        say(f"{text} ({line})")
        finished += 1

    return step


def at_most_every(
    seconds: float, say: Callable[[str], None], clock: Callable[[], float] = time.monotonic
) -> Callable[[str], None]:
    """A function of a text that passes on the first text after each period of so many seconds; the others are lost."""
    last = clock()

    def step(text: str) -> None:
        nonlocal last
        if clock() - last >= seconds:
            last = clock()
            say(text)

    return step


def staged(
    say: Callable[[str], None], clock: Callable[[], float] = time.monotonic
) -> Callable[[str, int, int], None]:
    """A function of (what, done, total) that reports each kind of step as `paced` does, with a clock of its own.

    The remaining time is that of this kind of steps; how many other ones follow is not known before they begin.
    """
    ticks: dict[str, Callable[[int, int], None]] = {}

    def tick(what: str, done: int, total: int) -> None:
        if what not in ticks:
            ticks[what] = paced(say, what, clock)
        ticks[what](done, total)

    return tick


def elapsed(
    say: Callable[[str], None], repeats: int, clock: Callable[[], float] = time.monotonic
) -> Callable[[str], None]:
    """A function of a text that adds how long a search of unknown length took, and at least how long its repeats take.

    repeats: how often the whole search is repeated afterwards, at least.
    """
    start = clock()

    def step(text: str) -> None:
        spent = clock() - start
        if spent > _BEFORE_A_GUESS_S:
            rest = duration(repeats * spent)
            text = f"search, {duration(spent)} so far, its validation then takes {rest} or more: {text}"
        say(text)

    return step


def duration(seconds: float) -> str:
    """Rounded duration: '40 s', '3 min', '2 h'."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{round(seconds / 60)} min" if seconds < 5400 else f"{round(seconds / 3600)} h"
