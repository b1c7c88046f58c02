"""`python -m benchmarks.session [SCANS ...]`: `workbench scan` on sessions of up to ten thousand scans.

Each size in a process of its own; prints seconds of processor time and peak memory. The images of a few rendered
scans stand in for all: the others are links to them, so that the disk holds a session in a few MiB.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import datasets
from datasets.formats.recording1_writer import write_csv

SIZES = (100, 1000, 10_000)
RENDERED = 8
SCENE = f"""
title = "session"
seed = 11
balls = [[0.0, 0.0, 0.0, 12.0]]
parts = [3, 2]
[camera]
width_px = 160
height_px = 128
fx_px = 248.0
fy_px = 247.6
cx_px = 80.4
cy_px = 62.8
[lens]
blur_px = 0.6
defocus_px = 0.0
[laser]
width_mm = 0.6
[mirror]
steps = 6
first_deg = -4.0
last_deg = 4.0
[board]
kind = "chessboard"
columns = 7
rows = 5
square_mm = 6.0
dark = 0.25
[placements]
count = 9
laser = 4
range_mm = [112.0, 140.0]
tilt_deg = 35.0
aside = 0.3
[scans]
count = {RENDERED}
range_mm = [126.0, 132.0]
aside = 0.05
"""


def rendered(folder: Path) -> Path:
    """A folder with the few rendered scans, `few`, and the scanner calibrated from their boards, `run/scanner.toml`."""
    from workbench.jobs.sensor import scanner
    from workbench.jobs.sensor.render import render

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.toml").write_text(SCENE, encoding="utf-8")
    render(folder / "scene.toml", folder / "few", lambda text: None)
    (folder / "run").mkdir()
    scanner.save(
        scanner.calibrate(datasets.read(folder / "few"), progress=lambda text: None), folder / "run"
    )
    return folder


def session(few: Path, folder: Path, scans: int, seed: int = 1) -> Path:
    """A recording of `scans` scans, each of a sample of an arm, whose images are links to those of the folder `few`.

    Returns its folder; it lies on the disk of `few`.
    """
    rows = [row for row in datasets.read(few).images if row["role"] == "scan"]
    groups = [
        [row for row in rows if row["scan"] == name]
        for name in dict.fromkeys(row["scan"] for row in rows)
    ]
    (folder / "images").mkdir(parents=True)
    with (folder / "images.csv").open("w", encoding="utf-8") as file:
        file.write("image,role,scan,step,sample\n")
        for k in range(scans):
            for row in groups[k % len(groups)]:
                image = f"images/scan-{k + 1:05d}-{row['step']:03d}.png"
                os.link(few / row["image"], folder / image)
                file.write(f"{image},scan,{k + 1},{row['step']},{k + 1}\n")
    rng = np.random.default_rng(seed)
    joints = rng.uniform(-60, 60, (scans, 6)) * [1, 0.5, 0.5, 1, 1, 1]
    columns = {"sample": np.arange(1.0, scans + 1), "ball": np.ones(scans)}
    columns |= {f"q{k + 1}_deg": values for k, values in enumerate(joints.T)}
    write_csv(folder / "samples.csv", columns)
    head = (few / "recording.toml").read_text(encoding="utf-8")
    head += '\n[robot]\nbuiltin = "abb_irb120"\n\n[samples]\nfile = "samples.csv"\n'
    (folder / "recording.toml").write_text(head, encoding="utf-8")
    (folder / "artefact.csv").write_bytes((few / "artefact.csv").read_bytes())
    return folder


def one(home: Path, scans: int) -> dict:
    """Seconds of the processor and peak memory (MiB) of `workbench scan`, report included, on a session of `scans`."""
    folder = home / f"session-{scans}"
    _alone("--make", str(home / "few"), str(folder), str(scans))
    words = [
        "scan",
        folder,
        "--scanner",
        home / "run" / "scanner.toml",
        "--out",
        home / f"run-{scans}",
    ]
    start = time.perf_counter()
    command = subprocess.Popen(
        [sys.executable, "-m", "workbench", *map(str, words)], stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(command.pid, 0)
    if status:
        raise SystemExit(f"workbench scan ended with {os.waitstatus_to_exitcode(status)}")
    answer = json.loads((home / f"run-{scans}" / "answer.json").read_text(encoding="utf-8"))
    named = sum(ball["ball"] == 1 for one in answer["scans"] for ball in one["balls"])
    shutil.rmtree(home / f"run-{scans}")
    shutil.rmtree(folder)
    return {
        "scans": len(answer["scans"]),
        "balls": named,
        "centres": answer["ball_centres"]["samples"],
        "seconds": usage.ru_utime + usage.ru_stime,
        "wall": time.perf_counter() - start,
        "peak_mib": usage.ru_maxrss / 1024,
    }


def _alone(*words: str) -> None:
    """This module in a process of its own, so that none inherits the memory of making the images."""
    subprocess.run([sys.executable, "-m", "benchmarks.session", *words], check=True)


def main(words: list[str]) -> int:
    """All sizes, or some, or the images, or one session made."""
    if words[:1] == ["--render"]:
        rendered(Path(words[1]))
    elif words[:1] == ["--make"]:
        session(Path(words[1]), Path(words[2]), int(words[3]))
    else:
        _table([int(word) for word in words] or SIZES)
    return 0


def _table(sizes) -> None:
    print(f"{'scans':>7} {'balls':>7} {'centres':>8} {'seconds':>8} {'ms/scan':>8} {'peak MiB':>9}")
    rows = []
    with tempfile.TemporaryDirectory() as home:
        _alone("--render", home)
        for scans in sizes:
            rows.append(one(Path(home), scans))
            row = rows[-1]
            print(
                f"{row['scans']:7,} {row['balls']:7,} {row['centres']:8,} {row['seconds']:8.0f} "
                f"{1000 * row['seconds'] / scans:8.1f} {row['peak_mib']:9.0f}",
                flush=True,
            )
    if len(rows) > 1:
        first, last = rows[0], rows[-1]
        more = 1024 * (last["peak_mib"] - first["peak_mib"]) / (last["scans"] - first["scans"])
        print(f"{more:.2f} KiB of peak memory a scan, from {first['scans']:,} to {last['scans']:,}")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
