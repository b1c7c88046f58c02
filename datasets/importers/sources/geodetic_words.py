"""GSI files of Leica instruments: each line is a measured point, each word of it one quantity.

A word is `82..08+00001234`: two digits for the quantity, four of information with the unit last, the sign, and 8 digits
or 16 (then the line begins with `*`). Quantities: 11 name, 21 horizontal direction, 22 zenith angle, 31 slope distance,
81 east, 82 north, 83 height. Source of the units: Leica TPS1100 User Manual 2.2.1, "Data format".
"""

import re
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import RawTable

EXTENSIONS = {".gsi"}
_LINE = re.compile(r"\s*\*?11[\d.]{4}[+-]\S{8}")
_WORD = re.compile(r"\*?(\d\d)[\d.]{3}([\d.])([+-])(\S{8}(?:\S{8})?)")
_MM = {"0": 1.0, "6": 0.1, "8": 0.01, "1": 0.3048, "7": 0.03048}
"""Digit of the unit -> mm of one count: 1, 1/10 and 1/100 mm, 1/1000 and 1/10000 ft."""
_DEG = {"2": 0.9e-5, "3": 1e-5}
"""Digit of the unit -> degrees of one count: 1/100000 gon, 1/100000 degree."""
_SEXAGESIMAL = "4"
_POINT = {"81": "X", "82": "Y", "83": "Z"}
_SPHERICAL = {"31": "Distance", "21": "Azimuth", "22": "Zenith"}
_DISTANCES = {"31", *_POINT}


def is_gsi(path: Path) -> bool:
    """Whether the first line of a file is one of GSI."""
    with path.open("rb") as file:
        return _LINE.match(file.read(64).decode("latin-1")) is not None


def read_gsi(path: Path) -> list[RawTable]:
    """One table: the name and the coordinates X, Y, Z of each point; distance and angles where there are none.

    Lines without all three, as of a station, are left out. Raises InputError for a unit that is not known, and where
    no line has a point.
    """
    lines = path.read_text(encoding="latin-1").splitlines()
    rows = [_words(path, number, line) for number, line in enumerate(lines, 1)]
    for headers in (_POINT, _SPHERICAL):
        kept = [place for place, row in enumerate(rows) if headers.keys() <= row.keys()]
        if kept:
            return [_table(path, headers, rows, kept)]
    raise complaint(
        path.name,
        "lines with the words 81, 82 and 83, or 21, 22 and 31",
        "none",
        "export the points as text",
    )


def _table(path: Path, headers, rows, kept) -> RawTable:
    columns = {"Point": np.array([rows[place].get("11", "") for place in kept])}
    columns |= {
        header: np.array([rows[place][code] for place in kept]) for code, header in headers.items()
    }
    units = {header: "mm" if code in _DISTANCES else "deg" for code, header in headers.items()}
    return RawTable(path.name, columns, np.array(kept) + 1, units=units)


def _words(path: Path, number: int, line: str) -> dict[str, float | str]:
    """Quantity -> name, mm or deg, of the words that are read."""
    found: dict[str, float | str] = {}
    for text in line.split():
        word = _WORD.fullmatch(text)
        if word is None:
            continue
        code, unit, sign, digits = word.groups()
        if code == "11":
            found[code] = digits.lstrip("0") or "0"
        elif code in _POINT or code in _SPHERICAL:
            value = _value(path, number, text)
            found[code] = -value if sign == "-" else value
    return found


def _value(path: Path, number: int, text: str) -> float:
    """mm or deg without sign. Raises InputError for an unknown unit or letters."""
    code, unit, _, digits = _WORD.fullmatch(text).groups()
    factors = _MM if code in _DISTANCES else _DEG
    is_known = unit in factors or (factors is _DEG and unit == _SEXAGESIMAL)
    if not is_known or not digits.isdecimal():
        raise complaint(
            f"{path.name}, line {number}",
            "digits, with a unit of metres, feet, gon or degrees",
            f"'{text}'",
            "export the points as text",
        )
    if unit == _SEXAGESIMAL and factors is _DEG:
        tenths = int(digits)
        return tenths // 100_000 + tenths // 1000 % 100 / 60 + tenths % 1000 / 36_000
    return factors[unit] * int(digits)
