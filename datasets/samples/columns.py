"""The vocabulary of samples.csv: which kind of recording needs which columns, and what they hold.

Everything here is data; the checks in `datasets.samples.checks` and `datasets.samples.plausible` read it.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches

POINT = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qw", "qx", "qy", "qz")
FLANGE = (
    "flange_x_mm",
    "flange_y_mm",
    "flange_z_mm",
    "flange_qw",
    "flange_qx",
    "flange_qy",
    "flange_qz",
)
"""T_base_flange of an arm whose controller gave poses instead of joint readings."""
AXES = (("nx", "ny", "nz"), ("ox", "oy", "oz"))
OTHER = "other_"
"""Before the name of a column, in memory only: what it holds in the second row of a pair."""


@dataclass(frozen=True)
class Kind:
    """Columns and files of a recording for one value of `measures`."""

    sample: str
    """In words, for the error sentences."""
    columns: tuple[str, ...] = ()
    either: tuple[tuple[str, ...], ...] = ()
    """Groups of columns of which at least one group must be there."""
    artefact: bool = False
    images: bool = False
    joints: bool = True
    """False where the recording may hold images only."""


KINDS = {
    "ball-centre": Kind(
        "the centre of a ball in the sensor frame", ("ball", *POINT), artefact=True
    ),
    "target-pose": Kind(
        "pose of a board or marker in the frame of a camera", (*POINT, *QUATERNION)
    ),
    "external-point": Kind("a reflector in the frame of an external instrument", POINT),
    "external-pose": Kind("point and orientation in an external frame", (*POINT, *QUATERNION)),
    "partial-pose": Kind("a point and one unit axis of the tool", POINT, either=AXES),
    "touch-point": Kind("a touch of a fixed point", ("point",)),
    "laser-spot": Kind("a laser beam through a point on a sphere", ("point", "sphere")),
    "distance": Kind("a length between two places", ("pair", "length_mm")),
    "plane-touch": Kind("a touch of a plane", ("plane",)),
    "ball-surface": Kind("a point on a ball's surface", ("ball", *POINT), artefact=True),
    "board-images": Kind("images of a board", images=True, joints=False),
    "scan-images": Kind("images of a board and of scans", images=True, joints=False),
}

INTEGERS = ("sample", "ball", "point", "sphere", "pair", "plane", "pose", "repeat", "reflector")
MEASURED_GROUPS = ("point", "sphere", "plane", "reflector")
"""Groups that are objects which are measured again in other recordings."""
GROUPS = ("point", "sphere", "pair", "plane", "pose", "repeat", "reflector")
"""Columns that only say which rows belong together: a number or a name."""
TEXT = ("fixed_to", "note")
FIXED_TO = ("tool", "base", "floor")
SIGMAS = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm")
"""1 sigma of each coordinate of a point, where they differ."""
LENGTHS = ("sigma_mm", *SIGMAS, "sigma_deg", "length_mm")
"""Columns whose every cell must be above zero."""

MEASURED = {*POINT, *QUATERNION, *AXES[0], *AXES[1], "length_mm"}
BOOKKEEPING = {*INTEGERS, *TEXT, *FLANGE, "sigma_mm", *SIGMAS, "sigma_deg", "set"}

KNOWN = {*MEASURED, *BOOKKEEPING, "payload_kg", "temperature_c", "time_s", "session"}
_LIKE = 0.88
"""Share of letters that a misspelt name has in common with the right one."""

_JOINT = re.compile(r"q(\d+)_(deg|mm)")
_WRONG_UNIT = {
    "x": "x_mm",
    "y": "y_mm",
    "z": "z_mm",
    "q": "q1_deg",
    "x_m": "x_mm",
    "y_m": "y_mm",
    "z_m": "z_mm",
    "x_cm": "x_mm",
    "y_cm": "y_mm",
    "z_cm": "z_mm",
    "sigma": "sigma_mm",
    "sigma_m": "sigma_mm",
    "sigma_rad": "sigma_deg",
    "length": "length_mm",
    "length_m": "length_mm",
    **{f"flange_{axis}{unit}": f"flange_{axis}_mm" for axis in "xyz" for unit in ("", "_m", "_cm")},
}


def joint_columns(columns: Iterable[str]) -> list[str]:
    """Names of the joint readings, q1_deg … (q1_mm where prismatic), in order of their number."""
    found = [(int(m[1]), name) for name in columns if (m := _JOINT.fullmatch(name))]
    return [name for _, name in sorted(found)]


def joint_number(column: str) -> int:
    """3 for q3_deg and q3_mm."""
    return int(_JOINT.fullmatch(column)[1])


def intended_column(column: str) -> str | None:
    """The column that a name without its unit, or with another one, was probably meant to be."""
    if m := re.fullmatch(r"[qj](?:oint)?_?(\d+)(?:_?(?:rad|m|degrees?|deg|mm))?", column.lower()):
        return None if _JOINT.fullmatch(column) else f"q{m[1]}_deg"
    return _WRONG_UNIT.get(column.lower())


def misspelt(column: str) -> str | None:
    """The column whose name, or whose name without its unit, a further column nearly has; None where there is none."""
    if column in KNOWN or re.search(r"\d", column) or column.startswith(OTHER):
        return None
    lengthened = [name for name in KNOWN if name.rpartition("_")[0] == column]
    close = lengthened or get_close_matches(column, KNOWN, 1, _LIKE)
    return close[0] if close else None
