"""`python -m benchmarks.commands [WORD ...]`: processor time, wall time and memory of commands, with their criteria.

Each command is a process of its own; words choose rows by their names. Processor time is that of one process
(`--jobs 1`). Other programs change it by a third and more, so that the least of several runs counts. Rows of real
recordings are left out where these are absent (docs/reference/real-recordings.md).
"""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import datasets
from benchmarks.large import long_recording

REPEATS = 2
FARO, UR10 = "irb120_faro", "ur10_ipa_tmac_A"
EVERY = 13  # poses of the UR10, of which one is taken: 917 of 11,911


@dataclass(frozen=True)
class Command:
    """A row: `name`, the command's `arguments`, and criteria in seconds of processor time and of wall time."""

    name: str
    arguments: tuple[str, ...]
    processor_s: float | None = None
    wall_s: float | None = None
    first_s: float | None = None


@dataclass(frozen=True)
class Used:
    """Seconds of processor and wall time, seconds until the first result is written (nan: none is), and MiB."""

    processor_s: float
    wall_s: float
    first_s: float
    memory_mib: float


def run(command: Command, folder: Path) -> Used:
    """Run a command once in an empty folder."""
    call = [sys.executable, "-m", "workbench", *command.arguments]
    if command.arguments[0] != "check":
        call += ["--out", str(folder / "run"), "--no-report"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    start, first = time.perf_counter(), float("nan")
    process = subprocess.Popen(call, cwd=os.getcwd(), **quiet)
    while True:
        ended, status, usage = os.wait4(process.pid, os.WNOHANG)
        if np.isnan(first) and any(folder.rglob("provisional.json")):
            first = time.perf_counter() - start
        if ended:
            break
        time.sleep(0.05)
    if os.waitstatus_to_exitcode(status) not in (0, 1):
        raise SystemExit(f"'{' '.join(call)}' ended with {os.waitstatus_to_exitcode(status)}")
    spent = usage.ru_utime + usage.ru_stime
    return Used(spent, time.perf_counter() - start, first, usage.ru_maxrss / 1024)


def least(command: Command) -> Used:
    """The least of each figure over some runs."""
    runs = []
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(run(command, Path(folder)))
    columns = ("processor_s", "wall_s", "first_s", "memory_mib")
    return Used(*(min(getattr(used, name) for used in runs) for name in columns))


def commands(folder: Path) -> list[Command]:
    """All rows; the recordings that they need are made in a folder."""
    rows = []
    for samples, criterion in ((2000, None), (20_000, 20.0)):
        name = str(folder / f"simulated-{samples}")
        long_recording(Path(name), samples)
        about = f"simulated, {samples:,} samples"
        rows.append(Command(f"calibrate, {about}", ("calibrate", name), criterion))
        rows.append(Command(f"diagnose, {about}", ("diagnose", name, "--jobs", "1")))
    if _is_there(FARO):
        rows.append(Command(f"check {FARO}", ("check", FARO), 0.9))
        rows.append(Command(f"calibrate {FARO}", ("calibrate", FARO), 8.0))
    if _is_there(UR10):
        recording = datasets.read(UR10)
        _, pose = np.unique(recording.poses, return_inverse=True)
        name = str(recording.select(np.flatnonzero(pose % EVERY == 0)).save(folder / "ur10"))
        about = f"diagnose {UR10}, every {EVERY}th pose"
        call = ("diagnose", name, "--jobs")
        rows.append(Command(f"{about}, one process", (*call, "1"), processor_s=40.0, first_s=10.0))
        rows.append(Command(f"{about}, two processes", (*call, "2"), wall_s=60.0, first_s=10.0))
    return rows


def _is_there(name: str) -> bool:
    try:
        datasets.read(name)
    except datasets.InputError:
        return False
    return True


def line(command: Command, used: Used) -> str:
    """The figures of a row, each with its criterion and whether it is met."""
    parts = []
    for label, value, most in (
        ("processor time", used.processor_s, command.processor_s),
        ("wall time", used.wall_s, command.wall_s),
        ("first result", used.first_s, command.first_s),
    ):
        if most is not None:
            met = "met" if value <= most else "not met"
            parts.append(f"{label} {value:.2f} s (criterion {most:g} s: {met})")
        elif not np.isnan(value):
            parts.append(f"{label} {value:.2f} s")
    return f"{command.name}: {', '.join(parts)}, {used.memory_mib:,.0f} MiB"


def main(words: list[str]) -> None:
    """Print a line for each chosen command."""
    print(f"load {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as folder:
        for command in commands(Path(folder)):
            if not words or any(word in command.name for word in words):
                print(line(command, least(command)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
