"""Cases of a benchmark run: number per suite, and creation of each case."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from workbench.core.errors import InputError
from workbench.proving import protocol

COUNTS = {
    "clean": 400,
    "library": 400,
    "swallowed": 80,
    "pairs": 80,
    "outside": 80,
    "covariate-withheld": 80,
    "sensor": 40,
    "real-knocked-out": 40,
    "real-planted": 40,
    "real-withheld": 6,
}
"""Suite -> cases of the full benchmark; the number of real cases is limited by the available recordings."""
IMAGES, REAL = ("sensor",), ("real-knocked-out", "real-planted", "real-withheld")


@dataclass(frozen=True)
class Task:
    """A planned case: its suite, its number in the suite, the seed of the benchmark."""

    suite: str
    index: int
    seed: int

    @property
    def name(self) -> str:
        return protocol.name_of(self.suite, self.index, self.seed)


@dataclass(frozen=True)
class Plan:
    """Tasks, and the reason for each suite that cannot be run here."""

    tasks: tuple[Task, ...]
    skipped: Mapping[str, str] = field(default_factory=dict)

    @property
    def counts(self) -> dict[str, int]:
        """Suite -> cases."""
        return dict(Counter(task.suite for task in self.tasks))


def plan(suites: Sequence[str], cases: int | None, seed: int) -> Plan:
    """Tasks of the given suites (none: all), each `name` or `name=count`. Raises InputError.

    cases: number for each suite without a count; None: as in COUNTS.
    """
    wanted = [_counted(word, cases) for word in suites or COUNTS]
    tasks, skipped = [], {}
    for suite, count in wanted:
        max_count, reason = available(suite)
        if reason:
            skipped[suite] = reason
        tasks += [Task(suite, k, seed) for k in range(min(count, max_count))]
    return Plan(tuple(tasks), skipped)


def _counted(word: str, cases: int | None) -> tuple[str, int]:
    """Suite and count of `name` or `name=count`."""
    name, sign, count = word.partition("=")
    if name not in COUNTS:
        raise InputError(
            f"--suite: expected one of {', '.join(COUNTS)}, found '{name}'. Choose one of them."
        )
    if sign and not (count.isdecimal() and int(count)):
        raise InputError(
            f"--suite {word}: expected a number of cases from 1 after '=', found '{count}'. "
            f"Write {name}=20, or {name} alone."
        )
    return name, int(count) if sign else cases or COUNTS[name]


def available(suite: str) -> tuple[int, str]:
    """Largest number of cases of a suite here, and the reason if it has none."""
    if suite in IMAGES:
        return _images()
    if suite in REAL:
        from workbench.proving import real

        return real.available(suite)
    try:
        import mujoco  # noqa: F401
    except ImportError:
        return 0, "the package mujoco is missing: pip install 'vision-sensor-workbench[proof]'"
    return 10**6, ""


def _images() -> tuple[int, str]:
    from importlib.util import find_spec

    missing = [name for name in ("cv2", "scipy") if find_spec(name) is None]
    if missing:
        return (0, f"the package {missing[0]} is missing")
    return (10**6, "")


def create_case(folder: Path, task: Task) -> str:
    """Create one case and return its name. Runs in a process that makes no diagnosis."""
    exam = protocol.BenchmarkRun(folder)
    if exam.truth(task.name).exists() and exam.recording(task.name).is_dir():
        return task.name
    if task.suite in REAL:
        from workbench.proving import real

        write, truth = real.made(task.suite, task.index, task.seed)
    else:
        write, truth = _made(task)
    protocol.write_case(exam, task.name, write, truth)
    return task.name


def _made(task: Task):
    if task.suite in IMAGES:
        from datasets.makers.blind import images as maker
        from datasets.makers.blind import images as writing
    else:
        from datasets.makers.blind import case as maker
        from datasets.makers.blind import writing
    case = maker.draw(task.suite, task.index, task.seed)
    salt = writing.salt(task.seed, task.suite, task.index)
    return lambda folder: writing.recording(case, folder), lambda: writing.truth(case, salt)


def baseline(truth: Mapping) -> str:
    """The baseline of a case; apart from the recording, the only input of a diagnosis."""
    return truth.get("baseline", "geometry")
