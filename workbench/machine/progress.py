"""Progress of long work and remaining time, as one line."""

import time
from collections.abc import Callable

_BEFORE_A_GUESS_S = 2.0
_FEW_STEPS = 10
"""Steps so few that the first one, preparation included, says something about the others."""


def paced(report: Callable[[str], None], label: str, clock: Callable[[], float] = time.monotonic):
    """A function of (done, total) that reports `label`, the counts, and the remaining time.

    The pace is that of the steps after the first report, which includes the preparation.
    report: takes one line; label: "image", "scan" …; clock: seconds.
    """
    start = clock()
    first: list[tuple[int, float]] = []

    def tick(done: int, total: int) -> None:
        now = clock()
        line = f"{label} {done} of {total}"
        steps, seconds = done, now - start
        later = first and done > first[0][0]
        if later:
            steps = done - first[0][0]
            seconds = now - first[0][1]
        has_pace = steps > 0 and (later or total <= _FEW_STEPS)
        if has_pace and done < total and now - start > _BEFORE_A_GUESS_S:
            line += f", about {duration(seconds / steps * (total - done))} left"
        if not first:
            first.append((done, now))
        report(line)

    return tick


def counted(
    report: Callable[[str], None], total: int, clock: Callable[[], float] = time.monotonic
) -> Callable[[str], None]:
    """A function of a text that reports the next of `total` steps, its number, and the remaining time.

    The remaining time assumes that the steps to come take as long as those that are finished.
    """
    start = clock()
    finished = 0

    def step(text: str) -> None:
        nonlocal finished
        elapsed_s = clock() - start
        line = f"{finished + 1} of {total}"
        if finished and elapsed_s > _BEFORE_A_GUESS_S:
            seconds = elapsed_s / finished * (total - finished)
            line += f", about {duration(seconds)} left"
        report(f"{text} ({line})")
        finished += 1

    return step


def at_most_every(
    seconds: float, report: Callable[[str], None], clock: Callable[[], float] = time.monotonic
) -> Callable[[str], None]:
    """A function of a text that passes on the first text after each period of so many seconds; the others are lost."""
    last = clock()

    def step(text: str) -> None:
        nonlocal last
        if clock() - last >= seconds:
            last = clock()
            report(text)

    return step


def staged(
    report: Callable[[str], None], clock: Callable[[], float] = time.monotonic
) -> Callable[[str, int, int], None]:
    """A function of (what, done, total) that reports each kind of step as `paced` does, with a clock of its own.

    The remaining time is that of this kind of steps; how many other ones follow is not known before they begin.
    """
    ticks: dict[str, Callable[[int, int], None]] = {}

    def tick(label: str, done: int, total: int) -> None:
        if label not in ticks:
            ticks[label] = paced(report, label, clock)
        ticks[label](done, total)

    return tick


def elapsed(
    report: Callable[[str], None], repeats: int, clock: Callable[[], float] = time.monotonic
) -> Callable[[str], None]:
    """A function of a text that adds how long a search of unknown length took, and at least how long its repeats take.

    repeats: how often the whole search is repeated afterwards, at least.
    """
    start = clock()

    def step(text: str) -> None:
        elapsed_s = clock() - start
        if elapsed_s > _BEFORE_A_GUESS_S:
            remaining = duration(repeats * elapsed_s)
            text = f"search, {duration(elapsed_s)} so far, its validation then takes {remaining} or more: {text}"
        report(text)

    return step


def duration(seconds: float) -> str:
    """Rounded duration: '40 s', '3 min', '2 h'."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    if seconds < 5400:
        return f"{round(seconds / 60)} min"
    return f"{round(seconds / 3600)} h"
