"""Fixed rows of a Denavit-Hartenberg table: a mount before the first joint, or a flange after the last one.

Published tables hold such rows (Panda: "Flange, 0, 0.107, 0, 0"). They have no joint reading and become the sections
[base] and [flange] of robot.toml.
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.errors import complaint
from datasets.importers.source import RawTable

_FIXED = re.compile(r"fix|fixed|fest|static|const|constant")
_PI = re.compile(r"pi|π|deg|rad|°|e[+-]?\d")
_DIGITS = 9


def fixed_rows(table: RawTable, theta: str, sliding: Sequence[bool]) -> np.ndarray:
    """(n,) bool: rows without a joint reading.

    theta: the column of joint angles. sliding (n,): rows of prismatic joints. A row is fixed where a cell says so
    ("fixed"), where its name has no number ("Flange") although those of all joints have one, and where its theta has no
    joint variable although that of all joints has one.
    Raises InputError for a fixed row between two joints.
    """
    texts = {
        name: [str(cell).strip().lower() for cell in cells]
        for name, cells in table.columns.items()
        if cells.dtype.kind != "f"
    }
    fixed = np.zeros(table.n, bool)
    for name, cells in texts.items():
        fixed |= [bool(_FIXED.fullmatch(cell)) for cell in cells]
        fixed |= _without_number(cells) if name != theta else False
    fixed |= _without_variable(texts.get(theta, []), fixed | np.asarray(sliding, bool))
    moving = np.flatnonzero(~fixed)
    inner = fixed[moving[0] : moving[-1]] if len(moving) else fixed
    if inner.any() or not len(moving):
        row = int(np.argmax(fixed)) if not len(moving) else moving[0] + int(np.argmax(inner))
        raise complaint(
            f"{table.file}, row {table.lines[row]}",
            "fixed rows only before the first joint or after the last one",
            "one between two joints" if len(moving) else "fixed rows only",
            "merge it with the row of a joint, or describe the arm by a URDF",
        )
    return fixed


def _without_number(names: Sequence[str]) -> np.ndarray:
    """(n,) bool: rows at either end named such as "flange" where all rows between have a number (joint 1, ...)."""
    numbered = np.array([bool(re.search(r"\d", name)) for name in names])
    return (
        ~numbered if numbered.sum() > 1 and _are_between(numbered) else np.zeros(len(names), bool)
    )


def _without_variable(cells: Sequence[str], known: np.ndarray) -> np.ndarray:
    """(n,) bool: rows at either end whose theta is a number where all rows between hold a variable such as q2.

    known (n,): rows that are fixed or prismatic for another reason, which need no variable.
    """
    variable = np.array([bool(re.search(r"[^\W\d]", _PI.sub("", cell))) for cell in cells], bool)
    if variable.sum() < 2 or not _are_between(variable | known):
        return np.zeros(len(known), bool)
    return ~(variable | known)


def _are_between(rows: np.ndarray) -> bool:
    """Whether rows (n,) bool follow one another without a gap."""
    places = np.flatnonzero(rows)
    return bool(rows[places[0] : places[-1] + 1].all())


def placements(rows: Sequence[Mapping], fixed: np.ndarray, convention: str) -> dict[str, dict]:
    """Sections [base] and [flange] of robot.toml of the fixed rows; without rows at an end, no section.

    rows: theta_deg, d_mm, a_mm and alpha_deg of all rows.
    """
    moving = np.flatnonzero(~fixed)
    ends = {"base": rows[: moving[0]], "flange": rows[moving[-1] + 1 :]}
    return {name: _placement(end_rows, convention) for name, end_rows in ends.items() if end_rows}


def _placement(rows: Sequence[Mapping], convention: str) -> dict:
    pose = np.eye(4)
    for row in rows:
        joint = _screw("z", row["theta_deg"], row["d_mm"])
        link = _screw("x", row["alpha_deg"], row["a_mm"])
        pose = pose @ (joint @ link if convention == "standard" else link @ joint)
    angles = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz", degrees=True)
    # adding 0 makes -0 and 0 the same
    return {
        "xyz_mm": (np.round(pose[:3, 3], _DIGITS) + 0.0).tolist(),
        "rpy_deg": (np.round(angles, _DIGITS) + 0.0).tolist(),
    }


def _screw(axis: str, angle_deg: float, length_mm: float) -> np.ndarray:
    """(4, 4) rotation about an axis and translation along it."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    pose["xyz".index(axis), 3] = length_mm
    return pose
