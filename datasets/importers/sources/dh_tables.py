"""A Denavit-Hartenberg table as text, spreadsheet or records: nominal kinematics of a robot without robot.toml.

One row per joint, and fixed rows at either end (`dh_fixed_rows`), with theta (offset), d, a and alpha, in any order and
with any usual header. Units come from the headers, else from the numbers. The convention (`standard` or `modified`)
follows from headers such as "alpha i-1" or the file name, else both are returned, and the measurements decide. A theta
with the variable of another joint ("q3 - q2 - 90") couples the two; "-q1" is a joint that rotates the other way.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.mapping.columns.headers import Header, read_header
from datasets.importers.source import RawTable
from datasets.importers.sources.dh_fixed_rows import fixed_rows, placements
from datasets.importers.sources.records import read_record_tables, record_lists
from datasets.importers.sources.tables.excel import read_excel
from datasets.importers.sources.tables.text_tables import read_text_table
from datasets.importers.units import ANGLES, LENGTHS
from datasets.recording_files.arms import check_robot
from workbench.core.text.structured_text import ContentError, read_json, read_toml, read_yaml

DH_TABLE = "Denavit-Hartenberg table"
"""First words of the source of a robot from such a table."""
EXTENSIONS = (".csv", ".tsv", ".txt", ".md", ".xlsx")
_READERS = {".yaml": read_yaml, ".yml": read_yaml, ".json": read_json, ".toml": read_toml}
"""Formats with a record for each joint; a .toml file with [[joint]] is a robot.toml."""
CONVENTIONS = ("standard", "modified")

_INDEX = r"(?:(?:i|k|j|n)?(?:m?1)?|prev|previous)"
_COLUMNS = {
    "theta": rf"(?:theta|th|q|offset|thetaoffset|offsettheta|qoffset|winkel|gelenkwinkel){_INDEX}(?:offset|0)?",
    "d": rf"(?:d|linkoffset|versatz){_INDEX}",
    "a": rf"(?:a|r|linklength|laenge){_INDEX}",
    "alpha": rf"(?:alpha|al|twist|linktwist|verdrehung){_INDEX}",
}
_KIND = r"(?:type|typ|kind|art|sigma)"
_SIGN = r"(?:sign|vorzeichen|direction|richtung)"
_LOW = r"(?:joint|q|theta|limits?|range)*(?:min|minimum|low|lower|von|from)(?:limit|imum)?"
_HIGH = r"(?:joint|q|theta|limits?|range)*(?:max|maximum|high|upper|bis|to)(?:limit|imum)?"
_PREVIOUS = re.compile(r"(?:i|k|j|n)\s*[-−_ ]\s*1|prev")
_MODIFIED, _STANDARD = ("modified", "craig", "mdh", "proximal"), ("standard", "classic", "distal")
_PI = re.compile(r"([+-]?\d*\.?\d*)\*?(?:pi|π)(?:/(\d+\.?\d*))?")
_VARIABLE = re.compile(r"(?:q|θ|theta|th|t)_?\d*\*?")
_COUPLED = re.compile(r"([+-])(\d*\.?\d*)\*?(?:q|θ|theta|th|t)_?(\d+)")
_MOST_MM_IN_METRES = (
    20.0  # no arm has a link of 20 m, and hardly one all of whose links are below 20 mm
)
_ROUNDED_DEG = 5e-4  # of a right angle written as 1.5708
_MOST_JOINTS = 20
_ANGLES = ("theta", "alpha")
_ROBOT_KEYS = frozenset(("joint", "urdf", "builtin", "mjcf"))


def is_dh_table(path: Path) -> bool:
    """Whether a file is a table by its extension, or holds a list of records that is not that of a robot.toml."""
    suffix = path.suffix.lower()
    if suffix not in _READERS or not path.is_file():
        return suffix in EXTENSIONS
    content = _content(path)
    is_robot = isinstance(content, dict) and bool(_ROBOT_KEYS & set(content))
    return not is_robot and any(record_lists(content, ""))


def _content(path: Path):
    """The value of a structured file; None where it is damaged."""
    try:
        return _READERS[path.suffix.lower()](path)
    except (OSError, ContentError):
        return None


def read_dh_table(path: Path) -> list[dict]:
    """Keys of a robot.toml for every convention that the table may have, `standard` before `modified`.

    Raises InputError where a column is missing, a cell is no number, or the unit of the angles is open.
    """
    table = _table(path)
    columns = _named_columns(table)
    if table.n > _MOST_JOINTS:
        raise complaint(
            path.name, f"one row per joint, {_MOST_JOINTS} at most", f"{table.n} rows", "correct it"
        )
    _check_filled(table, [columns[name] for name in ("d", "a", "alpha")])
    values = {name: _cells(table, header) for name, header in columns.items()}
    factors = _factors(table, columns, values)
    rows = [
        {key: float(values[key][0][k] * factors[key]) for key in ("theta", "d", "a", "alpha")}
        for k in range(table.n)
    ]
    rows = [_tidy_row(row) for row in rows]
    optional_keys, limits = [_optional(table, k) for k in range(table.n)], _limits(table)
    fixed = fixed_rows(table, columns["theta"].name, ["kind" in keys for keys in optional_keys])
    joints = []
    theta = table.columns[columns["theta"].name]
    for k in np.flatnonzero(~fixed):
        joint = rows[k] | _variables(str(theta[k]), len(joints) + 1) | optional_keys[k]
        if np.isfinite(limits[k]).all() and "kind" not in optional_keys[k]:
            joint["limits_deg"] = limits[k].tolist()
        joints.append(joint)
    return [
        _robot(path, joints, convention, placements(rows, fixed, convention))
        for convention in _conventions(path, columns)
    ]


def _table(path: Path) -> RawTable:
    if path.suffix.lower() == ".xlsx":
        return read_excel(path)[0]
    if path.suffix.lower() not in _READERS:
        return read_text_table(path)
    tables = read_record_tables(path, _content(path))
    return max(tables, key=lambda table: len(table.columns))


def _named_columns(table: RawTable) -> dict[str, Header]:
    """The header of each of theta, d, a and alpha. Raises InputError for a missing one."""
    headers = [read_header(name, table.units.get(name)) for name in table.columns]
    found = {}
    for wanted, pattern in _COLUMNS.items():
        matching = [header for header in headers if re.fullmatch(pattern, _plain(header))]
        if not matching:
            raise complaint(
                f"{table.file}",
                "a Denavit-Hartenberg table with the columns theta, d, a and alpha",
                f"no column {wanted} among {', '.join(table.columns)}",
                "name the columns so, or a i-1 and alpha i-1 in the modified convention",
            )
        found[wanted] = matching[0]
    return found


def _plain(header: Header) -> str:
    return "".join((*header.words, header.core)) if header.kind else "".join(header.words)


def _check_filled(table: RawTable, headers: list[Header]) -> None:
    """Raise InputError for an empty or infinite cell: a missing number is not taken for zero."""
    for header in headers:
        cells = table.columns[header.name]
        is_number = cells.dtype.kind == "f"
        missing = ~np.isfinite(cells) if is_number else np.array([not cell for cell in cells])
        if missing.any():
            row = int(np.argmax(missing))
            raise complaint(
                f"{table.file}, row {table.lines[row]}, column {header.name}",
                "a number",
                str(cells[row]) or "an empty cell",
                "write 0 where nothing is meant",
            )


def _cells(table: RawTable, header: Header) -> tuple[np.ndarray, bool]:
    """(J,) numbers, in radians where a cell contains pi, and whether one does. Raises InputError for other text."""
    cells = table.columns[header.name]
    if cells.dtype.kind == "f" and not np.isinf(cells).any():
        return np.where(np.isnan(cells), 0.0, cells), False
    cells = cells.astype(str)
    has_pi = any("pi" in cell.lower() or "π" in cell for cell in cells)
    values = []
    for row, cell in enumerate(cells):
        value = _evaluated(str(cell))
        if value is None:
            raise complaint(
                f"{table.file}, row {table.lines[row]}, column {header.name}",
                "a number, or a number of pi such as -pi/2, after the joint variable",
                repr(str(cell)),
                "correct the cell",
            )
        values.append(value)
    return np.array(values), has_pi


def _evaluated(text: str) -> float | None:
    """The constant of a cell such as "q2 - 90°", "theta1" or "-pi/2"; None for other text."""
    plain = _COUPLED.sub("", _without_variable(text), count=2)
    if plain in ("", "+", "-", "fixed"):
        return 0.0
    match = _PI.fullmatch(plain)
    try:
        if match is None:
            value = float(plain.replace(",", "."))
        else:
            factor = match[1] + "1" if match[1] in ("", "+", "-") else match[1]
            value = float(factor) * math.pi / float(match[2] or 1)
    except (ValueError, ZeroDivisionError):
        return None
    return value if math.isfinite(value) else None


def _without_variable(text: str) -> str:
    """A cell of theta in small letters and without spaces, behind its joint variable."""
    plain = text.lower().replace("°", "").replace("−", "-").replace(" ", "")
    return _VARIABLE.sub("", plain, count=1) if _VARIABLE.match(plain) else plain


def _variables(text: str, number: int) -> dict:
    """The keys `sign` and `coupled` of the joint `number` whose theta is -q1, or q3 - q2 with that of another joint."""
    keys: dict = {}
    for sign, ratio, joint in _COUPLED.findall(_without_variable(text)):
        if int(joint) == number and not ratio:
            keys["sign"] = -1 if sign == "-" else 1
        else:
            keys["coupled"] = {"joint": int(joint), "ratio": float(sign + (ratio or "1"))}
    return {key: value for key, value in keys.items() if value != 1}


def _factors(table: RawTable, columns: Mapping[str, Header], values: Mapping) -> dict[str, float]:
    """Degrees or mm of one unit of each column. Raises InputError where the unit of an angle is open."""
    stated = [columns[name].unit for name in _ANGLES] + [table.default_units.get("angle")]
    common = next((unit for unit in stated if unit in ANGLES), None)
    largest = max(np.abs(values[name][0]).max() for name in ("d", "a"))
    metres = 1000.0 if largest < _MOST_MM_IN_METRES else 1.0
    factors = {name: LENGTHS.get(columns[name].unit, metres) for name in ("d", "a")}
    return factors | {
        name: _angle_factor(table, columns[name], values[name], common) for name in _ANGLES
    }


def _angle_factor(table: RawTable, header: Header, values, common: str | None) -> float:
    """Degrees of one unit of an angle: stated, or from the numbers, which are multiples of 90 deg in most arms."""
    cells, has_pi = values
    if has_pi:
        return ANGLES["rad"]
    if header.unit in ANGLES:
        return ANGLES[header.unit]
    largest = np.abs(cells).max()
    # offsets of more than a turn are not in radians, whatever the unit of the other angles
    if common is not None and not (common == "rad" and largest > 2 * math.pi):
        return ANGLES[common]
    if 0 < largest < 2 * math.pi and _are_right_angles(cells, math.pi / 2):
        return ANGLES["rad"]
    if largest == 0 or largest > 2 * math.pi:
        return 1.0
    raise complaint(
        f"{table.file}, column {header.name}",
        "angles whose unit is clear",
        f"numbers up to {largest:.4g} without a unit",
        'write the unit into the header, such as "alpha [deg]"',
    )


def _are_right_angles(values: np.ndarray, quarter: float) -> bool:
    return bool(np.abs(values / quarter - np.round(values / quarter)).max() < 1e-3)


def _tidy(key: str, value: float) -> float:
    """A number without the rounding of its conversion; what is a multiple of 90 deg within that becomes one."""
    quarter = 90.0 * round(value / 90.0)
    if key.endswith("_deg") and abs(value - quarter) < _ROUNDED_DEG:
        return quarter
    return round(value, 9)


def _tidy_row(row: Mapping[str, float]) -> dict[str, float]:
    """theta_deg, d_mm, a_mm and alpha_deg of a row."""
    named = {f"{name}_{'deg' if name in _ANGLES else 'mm'}": value for name, value in row.items()}
    return {key: _tidy(key, value) for key, value in named.items()}


def _optional(table: RawTable, row: int) -> dict:
    """Kind and sign of a joint, where the table has such columns."""
    keys: dict = {}
    for name, cells in table.columns.items():
        plain = _plain(read_header(name))
        text = str(cells[row]).strip().lower()
        if re.fullmatch(_KIND, plain) and text[:1] in ("p", "1"):
            keys["kind"] = "prismatic"
        elif re.fullmatch(_SIGN, plain) and text.startswith("-"):
            keys["sign"] = -1
    return keys


def _limits(table: RawTable) -> np.ndarray:
    """(J, 2) deg, lowest and highest reading of each joint; nan where the table has none.

    Without a unit, numbers up to one revolution in radians are radians: no arm moves by so few degrees.
    """
    found = []
    for pattern in (_LOW, _HIGH):
        names = [
            n
            for n in table.columns
            if re.fullmatch(pattern, re.sub(r"[\W_\d]|deg$", "", n.lower().split("[")[0]))
        ]
        cells = table.columns[names[0]] if names else None
        if cells is None or cells.dtype.kind != "f":
            return np.full((table.n, 2), np.nan)
        unit = read_header(names[0], table.units.get(names[0])).unit
        found.append(cells * ANGLES.get(unit, 1.0))
        is_stated = unit in ANGLES
    limits = np.stack(found, axis=1)
    is_radian = not is_stated and np.nanmax(np.abs(limits), initial=0.0) <= 2 * math.pi
    return np.round(np.rad2deg(limits) if is_radian else limits, 6)


def _conventions(path: Path, columns: Mapping[str, Header]) -> tuple[str, ...]:
    """The convention that header or file name state, else both."""
    stated = path.stem.lower()
    is_previous = any(_PREVIOUS.search(columns[name].name.lower()) for name in ("a", "alpha"))
    if is_previous or any(word in stated for word in _MODIFIED):
        return ("modified",)
    return ("standard",) if any(word in stated for word in _STANDARD) else CONVENTIONS


def _robot(path: Path, joints: list[dict], convention: str, ends: Mapping[str, dict]) -> dict:
    source = f"{DH_TABLE} {path.name}"
    keys = {"name": path.stem, "convention": convention, "source": source, **ends, "joint": joints}
    check_robot(keys, path.name)
    return keys
