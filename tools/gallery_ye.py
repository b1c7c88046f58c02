"""Writes docs/gallery/unified-kinematic-compliance.md with its images: the models of Ye et al., Sensors 24, 2559.

`python tools/gallery.py unified` runs the page's own commands in an empty folder and writes every number of the page.
Needs MuJoCo. Six minutes, three more where the real recording irb120_faro is at hand, ten for the
images of the scanner.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import datasets  # noqa: E402
from datasets import papers  # noqa: E402
from datasets.makers import ye  # noqa: E402
from robot_model.effects import CATALOGUE  # noqa: E402
from workbench.core.effect import make_effects  # noqa: E402
from workbench.core.least_squares.solver import solve  # noqa: E402
from workbench.fitting.calibration_plans.plans import read_plan  # noqa: E402
from workbench.jobs.robot.calibrate import calibrate  # noqa: E402

PAGE = ROOT / "docs" / "gallery" / "unified-kinematic-compliance.md"
PAPER = papers.load("ye-2024")
MODELS = {"ye-mdh": "MDH", "ye-ntm": "NTM", "ye-rfcm": "RFCM", "ye-2024": "all"}
OURS = ("arm-torsion", "default")
AFTER = "NTM after MDH"
LOAD = "RFCM, load alone"
NOISE = {1: 0.031, 2: 0.0205}
WIDE = 4  # the second experiment over most of the arm's reach
EXPERIMENT = {1: "ball_experiment", 2: "tracker_experiment"}
DRAWS = range(1, 9)
REAL = "irb120_faro"


def plans(*more: str) -> str:
    """The --plan options of the paper's models and some others."""
    return " ".join(f"--plan {name}" for name in (*MODELS, *more))


COMMANDS = (
    f"python -m datasets.makers.ye balls --experiment 1 --noise {NOISE[1]}",
    f"python -m datasets.makers.ye tracker --experiment 2 --noise {NOISE[2]}",
    "seq 1 100 > fit.txt",
    f"workbench compare balls {plans(*OURS)} --fit-samples fit.txt --out compared-balls",
    f"workbench compare tracker {plans(*OURS)} --fit-samples fit.txt --out compared-tracker",
    f"python -m datasets.makers.ye tracker-wide --experiment 2 --wide --noise {NOISE[2]}",
    f"workbench compare tracker-wide {plans(*OURS)} --fit-samples fit.txt --out compared-tracker-wide",
)
REAL_COMMAND = f"workbench compare {REAL} {plans('default')} --out compared-{REAL}"


def run(command: str, folder: Path) -> None:
    """One of the page's commands, where and as the reader would give it."""
    words = re.sub("^python", sys.executable, re.sub("^workbench", "python -m workbench", command))
    setting = {**os.environ, "PYTHONPATH": str(ROOT)}
    if (real := ROOT.parent / "shared" / "recordings").is_dir():
        setting.setdefault("WORKBENCH_RECORDINGS", str(real))
    subprocess.run(
        words, shell=True, cwd=folder, env=setting, check=True, capture_output=True, text=True
    )


def collect(read) -> tuple[dict, dict, dict]:
    """JSON answers by experiment, held-out errors over random draws by experiment, and what `read` makes.

    read: called with the folder in which the commands ran, before it is gone.
    """
    real = datasets.find(REAL) is not None
    with tempfile.TemporaryDirectory() as folder:
        for command in (*COMMANDS, *([REAL_COMMAND] if real else [])):
            run(command, Path(folder))
        names = {"balls": 1, "tracker": 2, "tracker-wide": WIDE} | ({REAL: 3} if real else {})
        answers = {}
        for name, number in names.items():
            made = Path(folder) / f"compared-{name}"
            answers[number] = json.loads((made / "answer.json").read_text(encoding="utf-8"))
            shutil.copy(made / "comparison.png", PAGE.with_name(f"unified-{name}.png"))
        made = read(Path(folder))
    return answers, {k: (drawn(k), drawn(k, reading=True)) for k in (1, 2)}, made


def drawn(experiment: int, reading: bool = False) -> dict[str, np.ndarray]:
    """plan -> (draws,) held-out RMS, mm, for draws of the 100 fitted poses and of the noise.

    reading: under the reading of the paper's tables that comes nearest to its residuals.
    """
    made = noise_free(experiment, reading).recording()
    found: dict[str, list[float]] = {name: [] for name in (*MODELS, AFTER, LOAD, *OURS)}
    for seed in DRAWS:
        recording = noisy(made, NOISE[experiment], seed, 200 if experiment == 1 else 2000)
        split = dict(
            fit_samples=recording.sample_ids[:100], test_samples=recording.sample_ids[100:]
        )
        done = {
            n: calibrate(recording, None if n == "default" else Path(n), **split)
            for n in (*MODELS, *OURS)
        }
        for name, calibration in done.items():
            found[name].append(calibration.held_out["rms_mm"])
        found[AFTER].append(_after(done["ye-mdh"], read_plan(Path("ye-ntm"))[-1], 100))
        found[LOAD].append(calibrate(recording, load_alone(), **split).held_out["rms_mm"])
    return {name: np.array(values) for name, values in found.items()}


def load_alone() -> tuple:
    """The plan RFCM without the links' own weight: six load compliances, 36 parameters with a hand-eye."""
    kinematics, compliance = read_plan(Path("ye-rfcm"))
    return kinematics, replace(compliance, free=("joint-?.joint-compliance.load",))


def noise_free(experiment: int, reading: bool):
    """The experiment as printed; reading: with nearer views and larger compliances (the first), or in the wide box."""
    if experiment == 2:
        return ye.ye_second_experiment(7000, 1, 0.0, grid=ye.WIDE if reading else ye.NARROW)
    views = {"tilt_deg": 30, "roll_deg": 90} if reading else {}
    return ye.ye_first_experiment(
        200, 1, 0.0, _softer(ye.FIRST, 5) if reading else ye.FIRST, **views
    )


def noisy(recording, sigma_mm: float, seed: int, count: int):
    """`count` of the samples in a random order with noise of sigma_mm a coordinate."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(recording.n)[:count]
    columns = {key: column[order] for key, column in recording.columns.items()}
    columns |= {
        f"{axis}_mm": columns[f"{axis}_mm"] + rng.normal(0, sigma_mm, count) for axis in "xyz"
    }
    columns |= {"sample": np.arange(1.0, count + 1)}
    return replace(recording, columns=columns, sigma_mm=sigma_mm, name="ye")


def readings() -> list[tuple[int, str, dict[str, float]]]:
    """What the printed parameters make under several readings: noise-free RMS, mm, that each model leaves of them."""
    first, second = ye.ye_first_experiment, ye.ye_second_experiment
    return [
        (1, "as printed", left_over(first(400, 1, 0.0))),
        (
            1,
            "views within 30° of the vertical, rotated by up to 90°",
            left_over(first(400, 1, 0.0, tilt_deg=30, roll_deg=90)),
        ),
        (
            1,
            "the same, and all compliances five times as large",
            left_over(first(400, 1, 0.0, _softer(ye.FIRST, 5), tilt_deg=30, roll_deg=90)),
        ),
        (2, "as printed, narrow box", left_over(second(600, 1, 0.0))),
        (2, "as printed, wide box", left_over(second(600, 1, 0.0, grid=ye.WIDE))),
        (
            2,
            "narrow box, all compliances six times as large",
            left_over(second(600, 1, 0.0, _softer(ye.SECOND, 6))),
        ),
    ]


def _softer(table: ye.Table, times: float) -> ye.Table:
    return table._replace(compliance=tuple(times * x for x in table.compliance))


def left_over(made) -> dict[str, float]:
    """Model -> RMS, mm, of what it leaves of noise-free samples; AFTER holds the kinematics, as eq. 29."""
    recording = replace(made.recording(), sigma_mm=0.005, name="ye")
    found = {name: calibrate(recording, Path(name), folds=2) for name in MODELS}
    left = {MODELS[name]: c.fit["rms_mm"] for name, c in found.items()}
    left[LOAD] = calibrate(recording, load_alone(), folds=2).fit["rms_mm"]
    return left | {AFTER: _after(found["ye-mdh"], read_plan(Path("ye-ntm"))[-1])}


def _after(calibration, stage, fitted: int = 0) -> float:
    """RMS, mm, with a stage alone fitted to what a calibration left; on the rows not `fitted`, or on all."""
    effects = make_effects(CATALOGUE, stage.effects)
    model = calibration.model.with_effects(*effects)
    start = model.parameters.take_over(calibration.solution.parameters)
    own = [p.key for effect in effects for p in effect.parameters(model.chain)]
    rows = np.arange(model.chain.n)
    found = solve(
        model.at(rows < fitted if fitted else rows >= 0), start.only(np.isin(start.keys, own))
    ).parameters
    return float(np.sqrt((model.residual(found)[:, fitted:] ** 2).sum(0).mean()))


def printed_sign() -> tuple[float, float]:
    """RMS, mm, that the whole model leaves of noise-free statics: joint 3's sign from statics, and as printed."""
    recording = replace(ye.ye_first_experiment(400, 1, 0.0).recording(), sigma_mm=0.005, name="ye")
    found = calibrate(recording, Path("ye-2024"), folds=2)
    printed = [
        _AsPrinted(e.where) if e.effect == "joint-compliance" else e for e in found.model.effects
    ]
    model = replace(found.model, effects=tuple(printed), _bases={})
    residual = solve(model, model.parameters.take_over(found.solution.parameters)).residual
    return found.fit["rms_mm"], float(np.sqrt((residual**2).sum(0).mean()))


class _AsPrinted(CATALOGUE["ye-compliance"]):
    """Eq. 25 to the letter: a plus at joint 3."""

    def delta(self, p, state):
        change = super().delta(p, state)
        change[2] += 2e-3 * p[2] * p[7] * np.sin(state.variables[1] - state.variables[2])
        return change

    def derivative(self, p, state):
        out, angle = super().derivative(p, state), np.sin(state.variables[1] - state.variables[2])
        out[7, 2] += 2e-3 * p[2] * angle
        out[2, 2] += 2e-3 * p[7] * angle
        return out
