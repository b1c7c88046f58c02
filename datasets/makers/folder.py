"""A made recording in memory, and the few lines that write it as a recording/1 folder."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Made:
    """Columns of a recording in file units (mm, deg), with its further files.

    `truth` is the complete input of the simulation. It is for scoring and is
    never written to the folder.
    """

    measures: str
    title: str
    columns: Mapping[str, np.ndarray]
    robot: Mapping
    sigma_mm: float
    balls: Mapping[int, tuple[float, float, float, float]] = field(default_factory=dict)
    licence: str = "CC0-1.0"
    source: str = ""
    truth: Mapping = field(default_factory=dict)

    def recording(self):
        """The same as a `datasets.recording.Recording`."""
        from datasets.recording import Recording

        return Recording(
            measures=self.measures,
            columns={k: np.asarray(v, float) for k, v in self.columns.items()},
            robot=dict(self.robot),
            title=self.title,
            sigma_mm=self.sigma_mm,
            balls=dict(self.balls),
            source=self.source,
            licence=self.licence,
        )


def files(made: Made) -> dict[str, str]:
    """File name -> text of the recording/1 folder."""
    texts = {
        "recording.toml": _recording_toml(made),
        "robot.toml": robot_toml(made.robot),
        "samples.csv": _csv(made.columns),
    }
    if made.balls:
        rows = np.array([(ball, *xyzr) for ball, xyzr in sorted(made.balls.items())], float)
        names = ("ball", "x_mm", "y_mm", "z_mm", "radius_mm")
        texts["artefact.csv"] = _csv(dict(zip(names, rows.T)))
    return texts


def write(made: Made, folder: str | Path) -> None:
    """Write the folder; files of the same name are replaced."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files(made).items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")


def _recording_toml(made: Made) -> str:
    lines = ['format = "recording/1"', f"title = {json.dumps(made.title)}"]
    lines += [f'measures = "{made.measures}"', f"sigma_mm = {made.sigma_mm!r}"]
    lines += [f"source = {json.dumps(made.source)}", f'licence = "{made.licence}"']
    tables = {"robot": "robot.toml", "samples": "samples.csv"}
    tables |= {"artefact": "artefact.csv"} if made.balls else {}
    for table, name in tables.items():
        lines += ["", f"[{table}]", f'file = "{name}"']
    return "\n".join(lines) + "\n"


def robot_toml(robot: Mapping) -> str:
    """Text of a robot.toml: plain values first, then [payload], then each [[joint]]."""
    lines = [
        f"{key} = {json.dumps(value)}"
        for key, value in robot.items()
        if key not in ("joint", "payload")
    ]
    if "payload" in robot:
        lines += ["", "[payload]"] + [f"{k} = {json.dumps(v)}" for k, v in robot["payload"].items()]
    for row in robot["joint"]:
        lines += ["", "[[joint]]"] + [f"{k} = {json.dumps(v)}" for k, v in row.items()]
    return "\n".join(lines) + "\n"


def _csv(columns: Mapping[str, np.ndarray]) -> str:
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(columns)
    rows.writerows(zip(*([_cell(x) for x in column] for column in columns.values())))
    return out.getvalue()


def _cell(value) -> str:
    value = float(value)
    # Rounding keeps the file the same on machines whose last bits differ.
    return str(int(value)) if value == int(value) else format(round(value, 4), ".10g")


def joint_columns(degrees: np.ndarray) -> dict[str, np.ndarray]:
    """q1_deg ... qJ_deg of an (n, J) array."""
    return {f"q{k}_deg": column for k, column in enumerate(degrees.T, 1)}


def point_columns(points: np.ndarray) -> dict[str, np.ndarray]:
    """x_mm, y_mm, z_mm of an (n, 3) array."""
    return dict(zip(("x_mm", "y_mm", "z_mm"), points.T))
