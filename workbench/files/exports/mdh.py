"""The calibrated geometry as a table: Denavit-Hartenberg rows with Hayati's beta, JSON or CSV."""

import csv
import io
import json

import numpy as np

from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.core.text.csv_text import csv_text
from workbench.files.solution_file import CalibratedArm

NAMES = ("theta", "d", "a", "alpha", "beta")
COLUMNS = ("joint", "theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg")
_UNIT = np.array([180 / np.pi, 1, 1, 180 / np.pi, 180 / np.pi])


def calibrated_geometry(arm: CalibratedArm) -> np.ndarray:
    """(J, 5) theta, d, a, alpha, beta, rad and mm, as calibrated; nominal where nothing was."""
    geometry = arm.robot.geometry.copy()
    for k in range(arm.robot.joints):
        for c, name in enumerate(NAMES):
            geometry[k, c] = arm.values.get(f"joint-{k + 1}.{name}{k + 1}", geometry[k, c])
    return geometry


def _rows(arm) -> list[dict]:
    numbers = calibrated_geometry(arm) * _UNIT
    return [dict(zip(COLUMNS, (k, *row.tolist()))) for k, row in enumerate(numbers, 1)]


def mdh_json(arm: CalibratedArm) -> str:
    """The table with what is needed to use it: convention, root and flange frames, and what it leaves out."""
    return json.dumps(
        {
            "robot": arm.robot.name,
            "convention": arm.robot.convention,
            "joints": _rows(arm),
            "T_root_base_mm": arm.robot.base.tolist(),
            "T_last_flange_mm": arm.robot.flange.tolist(),
            "held_out_rms_mm": arm.held_out_mm,
            "left_out": left_out(arm),
        },
        indent=1,
    )


def mdh_csv(arm: CalibratedArm) -> str:
    """The rows alone, a joint a line."""
    rows = [[repr(value) for value in row.values()] for row in _rows(arm)]
    return csv_text(COLUMNS, rows)


def left_out(arm: CalibratedArm) -> list[str]:
    """Effects that a table of lengths and angles cannot represent: use `workbench compensate` for these."""
    return [effect.title for effect in arm.effects]


def read_mdh(text: str, robot: Robot) -> np.ndarray:
    """(J, 5) rad and mm of what `mdh_json` or `mdh_csv` wrote for this robot; InputError where it is not that."""
    try:
        if text.lstrip().startswith("{"):
            rows = json.loads(text)["joints"]
        else:
            rows = list(csv.DictReader(io.StringIO(text)))
        geometry = np.array([[float(row[name]) for name in COLUMNS[1:]] for row in rows]) / _UNIT
    except (KeyError, TypeError, ValueError) as problem:
        raise InputError(
            f"MDH table: expected columns {', '.join(COLUMNS)} with numbers, found {problem}; "
            "export it again"
        ) from None
    if geometry.shape != robot.geometry.shape:
        raise InputError(
            f"MDH table: expected {robot.joints} joints as {robot.name} has, found {len(geometry)}; "
            "take the table of this robot"
        )
    return geometry
