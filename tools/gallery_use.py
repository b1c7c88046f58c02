"""Writes docs/gallery/poses-and-compensation.md with its image: which poses to measure, what a calibration is for.

`python tools/gallery.py poses-and-compensation` runs the page's own commands in an empty folder, then
more draws of the same, and writes every number of the page. Needs MuJoCo. Ten minutes.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from datasets.makers import ye  # noqa: E402
from datasets.makers.mujoco_arm import pose, reflector_points  # noqa: E402
from robot_model import load_robot  # noqa: E402
from workbench.core.rigid import rotation_matrix  # noqa: E402
from workbench.files.solution_file import read_solution  # noqa: E402
from workbench.fitting.calibration_plans.plans import geometry  # noqa: E402
from workbench.jobs.robot.calibrate import calibrate, save  # noqa: E402
from workbench.jobs.robot.compensation.compensate import compensate, nominal_poses  # noqa: E402
from workbench.jobs.robot.poses import CRITERIA, Chosen, choose_poses  # noqa: E402

PAGE = ROOT / "docs" / "gallery" / "poses-and-compensation.md"
NOISE, CHOSEN, DRAWS, ARMS = 0.0205, 40, 200, range(41, 47)
POSES = (
    f"python -m datasets.makers.ye upright --experiment 2 --wide --samples 300 --seed 11 --noise {NOISE}",
    f"workbench poses upright -n {CHOSEN} --out chosen",
)
TASKS = (
    f"python -m datasets.makers.ye anywhere --experiment 2 --anywhere --samples 3000 --seed 11 --noise {NOISE}",
    f"python -m datasets.makers.ye cell --experiment 2 --cell --samples 60 --seed 12 --noise {NOISE}",
    f"workbench poses anywhere -n {CHOSEN} --criterion task --tasks cell --out chosen-for-cell",
    f"workbench poses upright -n {CHOSEN} --criterion task --tasks cell --out upright-for-cell",
)
# candidates: grid (None: anywhere), how many, how often one may be measured
POOLS = {
    "3000 anywhere": (None, 3000, 1),
    "300 anywhere": (None, 300, 1),
    "300 anywhere, each up to twice": (None, 300, 2),
    "300 with the tool upright": (ye.WIDE, 300, 1),
}
ILLUSTRATED = ("3000 anywhere", "300 with the tool upright")
USE = (
    f"python -m datasets.makers.ye measured --experiment 2 --samples 300 --seed 41 --noise {NOISE}",
    "seq 1 200 > fit.txt",
    "workbench calibrate measured --plan ye-2024 --fit-samples fit.txt --out arm",
    "cut -d, -f1-7 cell/samples.csv > programme.csv",
    "workbench compensate arm programme.csv --out corrected",
)
EXPORTS = (
    "workbench export arm --to urdf --out arm.urdf",
    "workbench export arm --to mdh-json --out arm.json",
    "workbench export arm --to mdh-csv --out arm.csv",
    "workbench render docs/scenes/small-scanner.toml --out images",
    "workbench camera images --out camera",
    "workbench export camera --to ros --out camera_info.yaml",
    "workbench export camera --to opencv --out camera.yml",
    "workbench export camera --to kalibr --out camchain.yaml",
)


class Pool(NamedTuple):
    """Of one kind of candidates: the set chosen for the tasks, and by set (draws,) mm RMS of the true error there."""

    chosen: Chosen
    errors: dict[str, np.ndarray]


class Used(NamedTuple):
    """RMS, mm, of one arm: `before` and `after` the correction; held-out RMS without (`free`) and with noise."""

    before: np.ndarray
    after: np.ndarray
    held_out: float
    free: float
    sigma: float


def run(command: str, folder: Path) -> str:
    """One of the page's commands, where and as the reader would give it; what it says."""
    words = re.sub(
        "^python", sys.executable, re.sub("^workbench", f"{sys.executable} -m workbench", command)
    )
    words = words.replace("docs/scenes", str(ROOT / "docs" / "scenes"))
    setting = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        words, shell=True, cwd=folder, env=setting, check=True, capture_output=True, text=True
    )
    return done.stdout


def collect() -> tuple[dict, dict, dict, list]:
    """Terminal output of the page's commands, their JSON answers, measured pools of poses, compensated arms."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        said = {command: run(command, folder) for command in (*POSES, *TASKS, *USE, *EXPORTS)}
        runs = ("chosen", "chosen-for-cell", "corrected", "arm")
        answers = {n: json.loads((folder / n / "answer.json").read_text()) for n in runs}
    pools = {}
    for name, kind in POOLS.items():
        wide = measured_errors(*kind, ye.CELL, compared=name in ILLUSTRATED)
        pools[name] = wide, measured_errors(*kind, ye.NARROW)
    return said, answers, pools, [used(seed) for seed in ARMS]


def gains() -> list[tuple[str, float]]:
    """Criterion and gain over random sets of 40 out of 300."""
    recording = ye.ye_second_experiment(300, 11, NOISE, grid=ye.WIDE).recording()
    return [
        (criterion, choose_poses(recording, CHOSEN, criterion).design.gain)
        for criterion in CRITERIA[:-1]
    ]


def measured_errors(
    pool, size: int, repeats: int, grid, draws: int = DRAWS, seed: int = 0, compared: bool = False
) -> Pool:
    """True errors at 60 poses of `grid` of an arm with wrong lengths alone, calibrated on sets of a pool's poses.

    pool: grid of the candidates, None for anywhere; size: how many; repeats: how often one may be measured. Noise
    and random sets are drawn for every draw. compared: also as many by D, and as many at random.
    """
    rigid = ye.SECOND._replace(
        compliance=(0.0,) * 6, **dict.fromkeys(("k0", "ka1", "ka2", "kb1", "kb2"), (0.0,) * 3)
    )
    made = (
        ye.ye_second_experiment(size, 11, 0.0, rigid, pool),
        ye.ye_second_experiment(60, 12, 0.0, rigid, grid),
    )
    candidates, tasks = (replace(m.recording(), sigma_mm=NOISE) for m in made)
    chosen = choose_poses(candidates, CHOSEN, "task", tasks, repeats=repeats)
    sets = {f"{CHOSEN} for the tasks": chosen.samples}
    if compared:
        sets[f"{CHOSEN} by D"] = choose_poses(candidates, CHOSEN).samples
    if sum(chosen.left_out.values()):
        raise ValueError("random sets would have poses that the choice may not take")
    rng, found = np.random.default_rng(seed), {}
    for _ in range(draws):
        sizes = (CHOSEN, 2 * CHOSEN) if compared else (2 * CHOSEN,)
        random = {
            f"{n} at random": rng.choice(candidates.sample_ids, n, replace=False) for n in sizes
        }
        for name, samples in (sets | random).items():
            rows = np.searchsorted(candidates.sample_ids, samples)
            found.setdefault(name, []).append(_error(candidates, rows, rng, tasks))
    return Pool(chosen, {name: np.array(values) for name, values in found.items()})


def _error(candidates, rows, rng, tasks) -> float:
    """RMS of the error at the tasks' exact poses, mm, of the geometry fitted to some candidates measured with noise."""
    columns = {
        key: np.concatenate([column[rows], tasks.columns[key]])
        for key, column in candidates.columns.items()
    }
    for key in ("x_mm", "y_mm", "z_mm"):
        columns[key][: len(rows)] += rng.normal(0, NOISE, len(rows))
    columns["sample"] = ids = np.arange(1.0, len(rows) + tasks.n + 1)
    both = replace(candidates, columns=columns, sigma_mm=NOISE, name="tasks")
    done = calibrate(
        both, [geometry(load_robot(both.robot))], ids[: len(rows)], ids[len(rows) :], folds=2
    )
    return done.held_out["rms_mm"]


def used(seed: int, fitted: int = 200) -> Used:
    """An arm with the 53 published parameters, calibrated on `fitted` samples, sent to the other poses."""
    made = ye.ye_second_experiment(fitted + 100, seed, NOISE)
    exact = ye.ye_second_experiment(fitted + 100, seed, 0.0).recording()
    recording, ids = made.recording(), np.arange(1, fitted + 101)
    split = dict(fit_samples=ids[:fitted], test_samples=ids[fitted:])
    done = calibrate(recording, Path("ye-2024"), **split)
    with tempfile.TemporaryDirectory() as folder:
        save(done, Path(folder))
        arm = read_solution(Path(folder))
    sent = recording.joints[fitted:]
    corrected = compensate(arm, sent)
    wanted = _wanted(arm, sent)
    before, after = (
        np.linalg.norm(_reached(q) - wanted, axis=1) for q in (sent, corrected.readings)
    )
    off = done.held_out_residual[:, fitted:] + (recording.points - exact.points)[fitted:].T
    free = float(np.sqrt((off**2).sum(0).mean()))
    return Used(before, after, done.held_out["rms_mm"], free, rms(corrected.sigma_mm))


def _wanted(arm, readings):
    """(n, 3) where the nominal arm would bring the reflector, with base and reflector as calibrated."""
    base = np.array([arm.values[f"base.{c}"] for c in ("x", "y", "z", "rx", "ry", "rz")])
    reflector = np.array([arm.values[f"tool.reflector1_{c}"] for c in "xyz"] + [1.0])
    return (nominal_poses(arm.robot, readings) @ reflector)[:, :3] @ rotation_matrix(
        base[3:]
    ).T + base[:3]


def _reached(readings):
    """(n, 3) where MuJoCo's arm really brings it."""
    flange = ye._flange(ye.SECOND, np.rad2deg(readings))
    return reflector_points(flange, ye.SECOND.tool[0], pose(*ye.SECOND.user))


def rms(values) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
