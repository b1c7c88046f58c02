"""Kill long commands at random moments: nothing is lost, no process stays, and the same command completes afterwards.

`python tools/kill_runs.py --kills 200` kills with SIGKILL, SIGTERM, SIGHUP and SIGINT in turn. After every fourth kill
the command runs to its end in the same folder; its result must be that of a run that was never interrupted. Parts of
a study are torn before that, as a loss of power would leave them.
"""

import argparse
import hashlib
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
import study_scenes  # noqa: E402
from workbench.files.runs import PROVISIONAL  # noqa: E402

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
SCENE = 'robot = "abb_irb120"\nmeasures = "external-pose"\nsamples = 3000\nsigma_mm = 0.02\n'
ARM = """robot = "abb_irb120"
measures = "external-point"
samples = 60
sigma_mm = 0.02
[errors]
length_mm = 0.2
angle_deg = 0.05
[[effect]]
effect = "joint-compliance"
where = "joint-2"
values = { compliance = 3e-5 }
"""
PATIENCE_S = 20
DATE = re.compile(rb"^date = .*$", re.MULTILINE)
"""The line of a result that differs from run to run."""


def _study(home: Path) -> None:
    changes = ("runs = 40", "runs = 60"), ("part = 3", "part = 2")
    study_scenes.write_study(home / "study.toml", *changes)


def _scene(home: Path) -> None:
    (home / "scene.toml").write_text(SCENE, encoding="utf-8")


def _nothing(home: Path) -> None:
    """A command that reads what the product contains."""


def _recording(home: Path) -> None:
    """60 points of a compliant arm in `recording`."""
    if not (home / "recording").is_dir():
        (home / "arm.toml").write_text(ARM, encoding="utf-8")
        _run(home, "simulate", "{}/arm.toml", "--out", "{}/recording")


def _calibrated(home: Path) -> None:
    """A calibrated arm in `arm`, and 2,000 targets."""
    _recording(home)
    if not (home / "arm").is_dir():
        _run(home, "calibrate", "{}/recording", "--no-report", "--out", "{}/arm")
    angles = np.random.default_rng(2).uniform(-50, 50, (2000, 6))
    _write_table(home / "targets.csv", [f"q{k}_deg" for k in range(1, 7)], angles)


def _point_sets(home: Path) -> None:
    """Two sets of 3,000 points that a rigid transform joins."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-400, 400, (3000, 3))
    turned = points[:, [1, 2, 0]] + [100, -50, 20] + rng.normal(0, 0.02, points.shape)
    for name, table in ("source", points), ("target", turned):
        _write_table(home / f"{name}.csv", ["x_mm", "y_mm", "z_mm"], table)


def _clouds(home: Path) -> None:
    """Twelve clouds of a ball in `scans`, and the flange poses of a 3-D camera."""
    from scipy.spatial.transform import Rotation

    from workbench.recordings.templates.scanner_kinds import example

    if (home / "scans").is_dir():
        return
    made = example("3d-camera", home / "camera", lambda text: None).recording
    (home / "scans").mkdir()
    lines = ["file,X,Y,Z,A,B,C"]
    for number in np.unique(made.columns["pose"])[:12]:
        rows = made.columns["pose"] == number
        name = f"scan_{int(number):02d}.xyz"
        np.savetxt(home / "scans" / name, made.points[rows], "%.5f")
        pose = made.flange[rows][0]
        angles = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX", degrees=True)
        lines.append(",".join(map(str, [name, *pose[:3, 3], *angles])))
    (home / "poses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _cell(home: Path) -> None:
    """Images of a board under the laser in `cell`."""
    if not (home / "cell").is_dir():
        _run(home, "new", "scan-images", "{}/cell")


def _write_table(path: Path, names: list[str], values: np.ndarray) -> None:
    np.savetxt(path, values, "%.6f", ",", header=",".join(names), comments="")


@dataclass(frozen=True)
class Command:
    """Words of a command that writes into a folder, and the file whose bytes are its result.

    `prepare(home)` writes what the command reads. `--out` names the folder; with `names_file` it names the file itself.
    """

    name: str
    words: tuple[str, ...]
    result: str
    prepare: Callable[[Path], None] = _nothing
    names_file: bool = False

    def destination(self, out: Path) -> Path:
        """What `--out` names, where the result belongs in the folder `out`."""
        return out / self.result if self.names_file else out


COMMANDS = (
    Command(
        "study", ("study", "{}/study.toml", "--workers", "2", "--no-report"), "table.csv", _study
    ),
    Command("simulate", ("simulate", "{}/scene.toml"), "samples.csv", _scene),
    Command("calibrate", ("calibrate", "elastic-arm", "--no-report"), "residuals.csv"),
    Command("calibrate page", ("calibrate", "{}/recording"), "residuals.csv", _recording),
    Command("diagnose", ("diagnose", "{}/recording", "--jobs", "2"), "residuals.csv", _recording),
    Command("compensate", ("compensate", "{}/arm", "{}/targets.csv"), "corrected.csv", _calibrated),
    Command(
        "register",
        ("register", "{}/source.csv", "{}/target.csv", "--nearest"),
        "residuals.csv",
        _point_sets,
    ),
    Command(
        "import",
        ("import", "{}/scans", "{}/poses.csv", "--ball-radius", "15", "--yes"),
        "samples.csv",
        _clouds,
    ),
    Command("scanner", ("scanner", "{}/cell"), "scanner.toml", _cell, names_file=True),
)


def main() -> int:
    """Exit status 1 where a kill has left something."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="part of the names of the commands")
    parser.add_argument(
        "--minutes", type=float, default=120, help="no further kill after this time"
    )
    given = parser.parse_args()
    # commands that a shell starts in the background ignore SIGINT, and so would all that they start
    signal.signal(signal.SIGINT, signal.default_int_handler)
    until = time.monotonic() + 60 * given.minutes
    chosen = [command for command in COMMANDS if given.only in command.name]
    faults, kills = 0, 0
    with tempfile.TemporaryDirectory(prefix="workbench-kills-") as home:
        for number in range(0, given.kills, 4):
            if time.monotonic() > until:
                break
            several = min(4, given.kills - number)
            found = kill_turn(Path(home), number // 4, several, given.seed, chosen)
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
    rng, faults = random.Random(f"{seed} {turn}"), []
    command = commands[turn % len(commands)]
    command.prepare(home)
    reference, duration = _reference(command, home)
    if not reference:
        return [f"{command.name}: fails without a kill"]
    out = home / f"killed-{turn}"
    for number in SIGNALS[:kills]:
        faults += killed(command, home, out, number, rng.uniform(0.1, duration))
        _tear_a_part(home / f".partial-{out.name}" / "parts", rng)
    result, _ = finished(command, home, out)
    if result != reference:
        faults.append(f"{command.name}: another result after kills in {out.name}")
    faults += [f"{path.name} was left behind" for path in home.glob(f".partial-{out.name}*")]
    return faults


@cache
def _reference(command: Command, home: Path) -> tuple[str, float]:
    """Checksum and duration in s of a run that nobody kills."""
    return finished(command, home, home / f"reference-{command.name}")


def _tear_a_part(folder: Path, rng: random.Random) -> None:
    """Cut one of the parts of an interrupted study short, as a loss of power would."""
    parts = sorted(folder.glob("part-*")) if folder.is_dir() else []
    if parts:
        part = rng.choice(parts)
        part.write_bytes(part.read_bytes()[: rng.randrange(200)])


def started(command: Command, home: Path, out: Path) -> subprocess.Popen:
    """The command in a session of its own."""
    if command.names_file:
        out.mkdir(exist_ok=True)
    return _run_in_background(home, *command.words, "--out", str(command.destination(out)))


def _run(home: Path, *words: str) -> None:
    if _run_in_background(home, *words).wait():
        raise SystemExit(f"workbench {' '.join(words)} fails without a kill")


def _run_in_background(home: Path, *words: str) -> subprocess.Popen:
    """`workbench` with words in which `{}` stands for the folder `home`."""
    return subprocess.Popen(
        [sys.executable, "-m", "workbench", *(word.replace("{}", str(home)) for word in words)],
        cwd=home,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def finished(command: Command, home: Path, out: Path) -> tuple[str, float]:
    """Checksum of the result of a command that is not killed, without its date, and of the names of all its files, ""
    where it failed; and its duration in s."""
    start = time.monotonic()
    if not (out / command.result).is_file():
        started(command, home, out).wait()
    path = out / command.result
    found = ""
    if path.is_file():
        names = "\n".join(sorted(inside.name for inside in out.iterdir()))
        content = DATE.sub(b"", path.read_bytes())
        found = hashlib.sha256(content + names.encode()).hexdigest()
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
    files = sorted(path.name for path in out.iterdir()) if out.is_dir() else []
    if files == [PROVISIONAL]:
        yield from _unreadable(out / PROVISIONAL, command)
    elif files and command.result not in files:
        yield f"{command.name}: {out.name} holds {files} without {command.result} after {number.name}"


def _unreadable(path: Path, command: Command) -> Iterator[str]:
    """A fault where the first result of an interrupted run is not whole."""
    try:
        json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        yield f"{command.name}: {path.parent.name}/{path.name} is not whole"


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
