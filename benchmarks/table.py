"""The table that a benchmark prints, and how a time is taken."""

import gc
import importlib.metadata
import platform
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Row:
    """One comparison: seconds of ours and of the peer for the same answer.

    `required` is the target of the ratio peer / ours, None where the row only informs.
    `at_least`: the peer was stopped before it had an answer, so that the ratio is a lower bound.
    `note` says what was checked.
    """

    what: str
    ours: float
    peer: float
    required: float | None
    note: str
    at_least: bool = False

    @property
    def ratio(self) -> float:
        return self.peer / self.ours

    @property
    def ok(self) -> bool:
        return self.required is None or self.ratio >= self.required


class Disagreement(Exception):
    """The two sides do not give the same answer: their times mean nothing."""


def agree(what: str, difference: float, allowed: float) -> str:
    """A clause for the note; Disagreement where `difference` is larger than `allowed`."""
    if not difference <= allowed:
        raise Disagreement(
            f"{what}: the two sides differ by {difference:.3g}, expected at most {allowed:.3g}"
        )
    return f"{what} agree to {difference:.1g}"


def compare(ours: Callable, peer: Callable, repeats: tuple[int, int]) -> tuple[float, float]:
    """Seconds of ours and of the peer, minima of `repeats`; ours before and after the peer.

    Both sides are taken alike, so that a busy machine favours neither.
    """
    before = fastest(repeats[0], ours)
    theirs = fastest(repeats[1], peer)
    return min(before, fastest(repeats[0], ours)), theirs


def fastest(repeats: int, action: Callable[[], object]) -> float:
    """Least seconds of `repeats` runs, after one that is not counted where there are several.

    The minimum is what the program needs; everything above it is the rest of the machine.
    """
    if repeats > 1:
        action()
    gc.collect()
    return float(np.min([timed(action)[0] for _ in range(repeats)]))


def writing_time(array: np.ndarray) -> float:
    """Seconds to write an array of this size once: no computation of it takes less."""
    target = np.empty_like(array)
    return fastest(20, lambda: target.fill(1.0))


def timed(action: Callable[[], object]) -> tuple[float, object]:
    """Seconds and result of one run: the processor time of this process, of which it uses one core.

    Time that other programs take from it does not count, on either side.
    """
    start = time.process_time()
    result = action()
    return time.process_time() - start, result


def show(comparisons: Iterable[Callable[[], Row]]) -> int:
    """Run and print each comparison; 1 where the two sides of one give different answers, else 0.

    A ratio below its target is printed as such, and a row that is behind its peer says so: both are results.
    """
    print(_versions(), flush=True)
    print(f"{'':56} {'ours':>10} {'peer':>10} {'ratio':>11} {'target':>9}", flush=True)
    wrong = [comparison.__name__ for comparison in comparisons if not _run(comparison)]
    print(
        "the answers of all rows agree" if not wrong else f"DIFFERENT ANSWERS: {', '.join(wrong)}"
    )
    return 1 if wrong else 0


def _run(comparison) -> bool:
    try:
        row = comparison()
    except Disagreement as fault:
        print(f"{comparison.__name__}: {fault}  NOT OK", flush=True)
        return False
    ratio = ("> " if row.at_least else "") + (
        f"{row.ratio:,.0f}" if row.ratio >= 100 else f"{row.ratio:.3g}"
    )
    asked = "" if row.required is None else f"{row.required:,.6g}"
    verdict = "" if row.required is None else "met" if row.ok else "not met"
    if row.ratio < 1:
        verdict = f"{verdict}, behind the peer".lstrip(", ")
    print(
        f"{row.what:56} {_time(row.ours):>10} {_time(row.peer):>10} {ratio:>11} {asked:>9}  {verdict}"
    )
    print(f"    {row.note}", flush=True)
    return True


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"


def _versions() -> str:
    names = (
        "pybotics",
        "pin",
        "figaroh",
        "scipy",
        "opencv-contrib-python-headless",
        "scikit-image",
        "jax",
        "pyceres",
    )
    libraries = [f"{name} {_version(name)}" for name in names]
    ours = [_processor(), f"Python {platform.python_version()}", f"numpy {np.__version__}"]
    return ", ".join([*ours, *libraries, "one thread", "processor time"])


def _processor() -> str:
    """What /proc says of the processor, where it does."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            lines = [line for line in file if line.startswith("model name")]
    except OSError:
        lines = []
    return lines[0].split(":", 1)[1].strip() if lines else platform.processor()


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
