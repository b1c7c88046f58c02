"""Writes docs/gallery/partial-pose.md with its chart: the TX60 of Mathematics 2023, 11, 4802, one axis at a time.

`python tools/gallery.py partial-pose` runs the page's own commands in an empty folder, twenty seeds more, and
writes every number of the page. Half a minute.
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
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from datasets import papers  # noqa: E402
from datasets.makers import poses  # noqa: E402
from datasets.makers.tx60 import tx60  # noqa: E402
from workbench.jobs.robot.calibrate import calibrate  # noqa: E402
from workbench.jobs.robot.identify import identifiability  # noqa: E402

PAGE = ROOT / "docs" / "gallery" / "partial-pose.md"
_NAMES = {"full": "full pose", "np": "NP (x axis)", "op": "OP (y axis)"}
PLAN, KINDS, SEEDS = Path("mdh-partial-pose"), ("full", "np", "op"), range(1, 21)
TABLES = dict(zip(KINDS, ("table_3", "table_4", "table_5")))
COMMANDS = (
    "workbench significance staubli_tx60 --points 50 --mm 0.1 --rad 0.1 --out significance",
    "python -m datasets.makers.tx60 planned-np --measures np --planned",
    "python -m datasets.makers.tx60 planned-op --measures op --planned",
    "workbench identifiability planned-np --plan mdh-partial-pose",
    "workbench identifiability planned-op --plan mdh-partial-pose",
    "python -m datasets.makers.tx60 measured-op --measures op",
    "seq 1 100 > fit.txt",
    "workbench calibrate measured-op --plan mdh-partial-pose --fit-samples fit.txt --out calibrated-op",
)

_TEXT = """# One axis is enough, if it is the right one

*Mathematics 2023, 11, 4802: a Staubli TX60, a tracker that sees one reflector in two places 10 mm apart on the flange.
This page and its numbers are written by `python tools/gallery.py partial-pose`.*

A tracker's reflector gives a place; moved along a slide on the flange it also gives one axis. The paper's question is
which axis to measure. Before anything is measured, the effect of each parameter says it:

```sh
{first}
```

![Average significance of every parameter for place and axes](partial-pose.png)

The x axis alone ("NP") shows nothing of alpha6, the z axis nothing of theta6; the y axis ("OP") shows both, as in the
paper's figure 3. The same is said of a planned measurement, in words, before anybody measures:

```sh
{planned}
```

```
{said}
```

The last one lists nothing as not identifiable: all 24 are determined. The plan `mdh-partial-pose` frees
exactly the paper's 24 parameters; base and tool are known there, as in the paper. Where they are not,
`workbench identifiability planned-op` without the plan lists {more} directions that stay open.

## Measured

```sh
{measured}
```

Mean 3-D distance of the flange (the paper's eq. 13), mm, {seeds} seeds of poses and noise, 100 fitted, 200 others;
`{recording}` above is seed 1: {fit:.4f} fitted, {check:.4f} checked.

| measured | before, fit / check | fitted | checked | alpha6, 1e-3 rad (true 0.783) | alpha6 in the paper, 1e-3 rad |
|---|---|---|---|---|---|
{rows}| the paper, all three | {published} | | |

Attitude errors, mean angle in deg over the same seeds: of the measured axis or attitude, which contains the noise of
the measurement (a slide of 10 mm), and of the whole flange at the 200 check poses against the true arm, without noise:

| measured | axis or attitude, before | fitted | checked | flange against the true arm, before | checked |
|---|---|---|---|---|---|
{attitudes}
The axis that NP measures does not show alpha6, so its measured error is as small as that of OP, and the attitude of
the flange about that axis keeps the whole error of alpha6.

The fitted error lies between {low:.4f} and {high:.4f} mm over the seeds, the largest checked one is {largest:.4f} mm.

What differs. The noise is set to 0.048 mm a coordinate, because that makes the fitted 0.074 mm; the paper does not
state it. Errors of the paper's 200 check samples are twice those of its fit; with its own parameter errors and
noise they come out {larger:.0f} % larger, as they must from 24 parameters out of 100 poses. So something else was at
work there that 24 parameters do not hold: the paper's check errors grow along z and x, as a frame that moved or an arm
that bends would make them. The paper learns that NP leaves alpha6 open from its result, 1.84e-15 rad: a start
value that never moved. Here it is held at its nominal value, without a sigma, and the sentence above says so before
anything is measured.
"""


def main() -> None:
    """Run, collect, write."""
    with tempfile.TemporaryDirectory() as folder:
        said = {command: run(command, Path(folder)) for command in COMMANDS}
        shutil.copy(
            Path(folder) / "significance" / "significance.png", PAGE.with_name("partial-pose.png")
        )
        answer = json.loads(
            (Path(folder) / "calibrated-op" / "answer.json").read_text(encoding="utf-8")
        )
    found = {kind: [figures(kind, seed) for seed in SEEDS] for kind in KINDS}
    PAGE.write_text(page(said, found, answer), encoding="utf-8")


def run(command: str, folder: Path) -> str:
    """Standard output of one of the page's commands, run where the reader would."""
    words = re.sub("^python", sys.executable, re.sub("^workbench", "python -m workbench", command))
    setting = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "110"}
    return subprocess.run(
        words, shell=True, cwd=folder, env=setting, check=True, capture_output=True, text=True
    ).stdout


def figures(kind: str, seed: int) -> dict:
    """Mean 3-D errors, mm, before and after, of 100 fitted and 200 other samples, and what is said of alpha6."""
    made = tx60(kind, seed=seed)
    recording = replace(made.recording(), name=kind)
    ids = recording.sample_ids
    found = calibrate(recording, PLAN, fit_samples=ids[:100], test_samples=ids[100:])
    before = np.linalg.norm(found.nominal_residual, axis=0)
    row = next(row for row in found.parameters if row["name"] == "alpha6")
    nominal, true = made.truth["nominal"], made.truth["flange"][100:]
    joints = recording.joints[100:]
    return {
        "attitude before": attitude_error(poses.forward(nominal, joints), true),
        "attitude": attitude_error(poses.forward(fitted_geometry(found, nominal), joints), true),
        "axis before": found.nominal["rotation_mean_deg"],
        "axis fit": found.fit["rotation_mean_deg"],
        "axis check": found.held_out["rotation_mean_deg"],
        "before fit": before[:100].mean(),
        "before check": before[100:].mean(),
        "fit": found.fit["mean_mm"],
        "check": found.held_out["mean_mm"],
        "alpha6": row["value"],
        "std": row["std"],
    }


def fitted_geometry(found, nominal: np.ndarray) -> np.ndarray:
    """(6, 5) theta, d, a, alpha, beta (rad, mm) of a calibration; what it does not hold is nominal."""
    parameters, made = found.solution.parameters, nominal.copy()
    for joint in range(6):
        for column, name in enumerate(("theta", "d", "a", "alpha", "beta")):
            key = f"joint-{joint + 1}.{name}{joint + 1}"
            if key in parameters.index:
                made[joint, column] = parameters[key]
    return made


def attitude_error(flange: np.ndarray, true: np.ndarray) -> float:
    """Mean rotation angle, deg, between flange poses (n, 4, 4)."""
    between = true[:, :3, :3].transpose(0, 2, 1) @ flange[:, :3, :3]
    return float(np.rad2deg(Rotation.from_matrix(between).magnitude()).mean())


def page(said, found, answer) -> str:
    """The page's text."""
    published = papers.load("mathematics-2023")
    errors = published["position_error"]
    rows = "".join(
        _row(kind, found[kind], published[TABLES[kind]]["deviation"][5][3]) for kind in KINDS
    )
    largest = max(max(f["check"] for f in rows) for rows in found.values())
    spread = [f["fit"] for f in found["op"]]
    ours = {key: np.mean([f[key] for f in found["op"]]) for key in ("fit", "check")}
    planned = identifiability(tx60("op", planned=True).recording())["stages"][0]
    more = planned["free"] - planned["identifiable"]
    return _TEXT.format(
        first=COMMANDS[0],
        planned="\n".join(COMMANDS[1:5]),
        said=_quote(said[COMMANDS[3]]),
        more=more,
        measured="\n".join(COMMANDS[5:]),
        seeds=len(SEEDS),
        recording=answer["recording"],
        fit=answer["fit"]["mean_mm"],
        check=answer["held_out"]["mean_mm"],
        rows=rows,
        attitudes="".join(_attitude_row(kind, found[kind]) for kind in KINDS),
        published="{fit_before_mm} / {check_before_mm} | {fit_after_mm} | {check_after_mm}".format(
            **errors
        ),
        low=min(spread),
        high=max(spread),
        largest=largest,
        larger=100 * (ours["check"] / ours["fit"] - 1),
    )


def _row(kind, found, paper) -> str:
    mean = {
        key: np.mean([f[key] for f in found])
        for key in ("before fit", "before check", "fit", "check", "alpha6")
    }
    stds = [f["std"] for f in found]
    alpha = (
        "held: no effect"
        if None in stds
        else f"{1e3 * mean['alpha6']:.2f}, each ± {1e3 * np.mean(stds):.2f}"
    )
    before = f"{mean['before fit']:.3f} / {mean['before check']:.3f}"
    return (
        f"| {_NAMES[kind]} | {before} | {mean['fit']:.4f} | {mean['check']:.4f} | {alpha} "
        f"| {1e3 * paper:.3g} |\n"
    )


def _attitude_row(kind, found) -> str:
    keys = ("axis before", "axis fit", "axis check", "attitude before", "attitude")
    cells = " | ".join(f"{np.mean([f[key] for f in found]):.3f}" for key in keys)
    return f"| {_NAMES[kind]} | {cells} |\n"


def _quote(text: str) -> str:
    """What a command prints, without the path of its run folder."""
    lines = [line.rstrip() for line in text.strip().splitlines()]
    return "\n".join(line for line in lines if not line.startswith("/"))
