"""Writes a case as a recording/1 folder, and its truth as a file of its own: plain text, no code of the readers."""

import csv
import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from datasets.makers.blind.case import Case


def recording(case: Case, folder: Path) -> None:
    """Write the recording's files into a new folder; they reveal neither the truth nor the suite."""
    folder.mkdir(parents=True)
    for name, text in files(case).items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")


def files(case: Case) -> dict[str, str]:
    """File name -> text."""
    texts = {
        "recording.toml": _recording(case),
        "robot.toml": _robot(case.robot),
        "samples.csv": table(case.columns),
    }
    if case.balls:
        rows = np.array([(ball, *place) for ball, place in sorted(case.balls.items())], float)
        texts["artefact.csv"] = table(
            dict(zip(("ball", "x_mm", "y_mm", "z_mm", "radius_mm"), rows.T))
        )
    return texts


def truth(case: Case, salt: str) -> str:
    """The text of the truth. The salt prevents guessing it from its checksum."""
    return json.dumps({**case.truth, "salt": salt}, indent=1, sort_keys=True) + "\n"


def salt(seed: int, suite: str, index: int) -> str:
    """Salt of a case, deterministic, so that a benchmark run can be repeated byte for byte."""
    return hashlib.sha256(f"salt {seed} {suite} {index}".encode()).hexdigest()[:32]


def _recording(case: Case) -> str:
    lines = [
        'format = "recording/1"',
        'title = "An arm and its measured points"',
        f'measures = "{case.measures}"',
    ]
    lines += [] if case.sigma_mm is None else [f"sigma_mm = {case.sigma_mm!r}"]
    tables = {"robot": "robot.toml", "samples": "samples.csv"} | (
        {"artefact": "artefact.csv"} if case.balls else {}
    )
    for name, file in tables.items():
        lines += ["", f"[{name}]", f'file = "{file}"']
    return "\n".join(lines) + "\n"


def _robot(robot: Mapping) -> str:
    lines = [
        f"{key} = {_value(value)}"
        for key, value in robot.items()
        if key not in ("joint", "payload")
    ]
    lines += ["", "[payload]"] + [
        f"{key} = {_value(value)}" for key, value in robot["payload"].items()
    ]
    for row in robot["joint"]:
        lines += ["", "[[joint]]"] + [f"{key} = {_value(value)}" for key, value in row.items()]
    return "\n".join(lines) + "\n"


def _value(value) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_value(inner)}" for key, inner in value.items()) + " }"
    return json.dumps(value)


def table(columns: Mapping[str, np.ndarray]) -> str:
    """CSV of numeric columns, to a tenth of a micrometre or 1e-4 deg."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(columns)
    rows.writerows(zip(*([_cell(x) for x in column] for column in columns.values())))
    return out.getvalue()


def _cell(value) -> str:
    value = float(value)
    return str(int(value)) if value == int(value) else format(round(value, 4), ".10g")
