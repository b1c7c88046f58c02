"""Kill long commands at random moments: nothing is lost, no process stays, and the same command completes afterwards.

`python tools/kill_runs.py --kills 200` kills with SIGKILL, SIGTERM, SIGHUP and SIGINT in turn. After every fourth kill
the command runs to its end in the same folder; its result must be that of a run that was never interrupted.
"""

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
import study_scenes  # noqa: E402

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
SCENE = 'robot = "abb_irb120"\nmeasures = "external-pose"\nsamples = 3000\nsigma_mm = 0.02\n'
PATIENCE_S = 20


@dataclass(frozen=True)
class Command:
    """Words of a command that writes into a folder, and the file whose bytes are its result."""

    name: str
    words: tuple[str, ...]
    result: str


COMMANDS = (
    Command("study", ("study", "{}/study.toml", "--workers", "2", "--no-report"), "table.csv"),
    Command("simulate", ("simulate", "{}/scene.toml"), "samples.csv"),
    Command("calibrate", ("calibrate", "elastic-arm", "--no-report"), "residuals.csv"),
)


def main() -> int:
    """Exit status 1 where a kill has left something."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--minutes", type=float, default=120, help="no further kill after this time"
    )
    given = parser.parse_args()
    # commands that a shell starts in the background ignore SIGINT, and so would all that they start
    signal.signal(signal.SIGINT, signal.default_int_handler)
    until = time.monotonic() + 60 * given.minutes
    faults, kills = 0, 0
    with tempfile.TemporaryDirectory(prefix="workbench-kills-") as home:
        for number in range(0, given.kills, 4):
            if time.monotonic() > until:
                break
            several = min(4, given.kills - number)
            found = kill_turn(Path(home), number // 4, several, given.seed)
            faults += len(found)
            kills += several
            print("\n".join([*found, f"{kills} kills, {faults} faults"]), flush=True)
    return int(bool(faults))


def kill_runs(home: Path, kills: int, seed: int, commands=COMMANDS) -> list[str]:
    """What went wrong, one sentence each."""
    faults = []
    for turn in range(-(-kills // 4)):
        faults += kill_turn(home, turn, min(4, kills - 4 * turn), seed, commands)
    return faults


def kill_turn(home: Path, turn: int, kills: int, seed: int, commands=COMMANDS) -> list[str]:
    """Faults of up to four kills of one command in one folder, and of the run that completes it afterwards."""
    _write_inputs(home)
    rng, faults = random.Random(f"{seed} {turn}"), []
    command = commands[turn % len(commands)]
    reference, duration = _reference(command, home)
    if not reference:
        return [f"{command.name}: fails without a kill"]
    out = home / f"killed-{turn}"
    for number in SIGNALS[:kills]:
        faults += killed(command, home, out, number, rng.uniform(0.1, duration))
    result, _ = finished(command, home, out)
    if result != reference:
        faults.append(f"{command.name}: another result after kills in {out.name}")
    faults += [f"{path.name} was left behind" for path in home.glob(f".partial-{out.name}*")]
    return faults


@cache
def _reference(command: Command, home: Path) -> tuple[str, float]:
    """Checksum and duration in s of a run that nobody kills."""
    return finished(command, home, home / f"reference-{command.name}")


def _write_inputs(home: Path) -> None:
    changes = ("runs = 40", "runs = 60"), ("part = 3", "part = 2")
    study_scenes.write_study(home / "study.toml", *changes)
    (home / "scene.toml").write_text(SCENE, encoding="utf-8")


def started(command: Command, home: Path, out: Path) -> subprocess.Popen:
    """The command in a session of its own."""
    words = [word.replace("{}", str(home)) for word in command.words]
    return subprocess.Popen(
        [sys.executable, "-m", "workbench", *words, "--out", str(out)],
        cwd=home,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def finished(command: Command, home: Path, out: Path) -> tuple[str, float]:
    """Checksum of the result of a command that is not killed ("" where it failed), and its duration in s."""
    start = time.monotonic()
    if not (out / command.result).is_file():
        started(command, home, out).wait()
    path = out / command.result
    found = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
    return found, max(time.monotonic() - start, 3.0)


def killed(
    command: Command, home: Path, out: Path, number: signal.Signals, after_s: float
) -> Iterator[str]:
    """Faults of one kill: processes that stay, or a result without all its files."""
    process = started(command, home, out)
    time.sleep(after_s)
    process.send_signal(number)
    try:
        process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        yield f"{command.name}: runs on {PATIENCE_S} s after {number.name}"
    until = time.monotonic() + PATIENCE_S
    while (left := members(process.pid)) and time.monotonic() < until:
        time.sleep(0.2)
    if left:
        yield f"{command.name}: {len(left)} processes stay after {number.name}"
    if out.is_dir() and not (out / command.result).is_file():
        yield f"{command.name}: {out.name} stands without {command.result} after {number.name}"


def members(session: int) -> list[int]:
    """Processes of a session that are no zombies (Linux)."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(int(path.parent.name))
    return found


if __name__ == "__main__":
    sys.exit(main())
