"""Points in spherical coordinates, as trackers and total stations measure them: range, azimuth and a vertical angle.

A convention is "spherical", followed by what is known about it:

- the vertical angle: "elevation" above the horizontal plane, or "zenith" from the vertical axis,
- the unit of both angles,
- the direction of the azimuth, seen from above: "counterclockwise", as in mathematics, or "clockwise", as in surveying.

What is not stated is tested on the robot. The direction from which the azimuth counts is a rotation of the instrument,
which every calibration estimates.
"""

import re
from collections.abc import Mapping
from itertools import product

import numpy as np

from datasets.importers.mapping.columns.headers import MEASURED_WORDS, Header
from datasets.importers.units import ANGLES

SPHERICAL = "spherical"
VERTICAL = ("elevation", "zenith")
UNITS = ("deg", "rad", "gon", "mrad")
DIRECTIONS = ("counterclockwise", "clockwise")
_TESTED_UNITS = ("deg", "rad", "gon")
_ANGLE = "(?:angle|winkel|richtung|direction)?"
_PATTERNS = {
    "range": r"(?:slope|slant|schraeg)?(?:range|distance|distanz|dist|strecke|entfernung)|radius|sd|r|d",
    "azimuth": rf"(?:azimuth|azimut|azi|az|hz|horizontal|hor|ha|h){_ANGLE}",
    "elevation": rf"(?:elevation|elev|el|altitude|hoehen){_ANGLE}",
    "zenith": rf"(?:zenith|zenit|zen|polar){_ANGLE}|(?:zenith|zenit)(?:distance|distanz)|zd",
    "vertical": rf"(?:vertical|vertikal|vert|va|v){_ANGLE}",
}


def _conventions() -> tuple[str, ...]:
    word_groups = product(("", *VERTICAL), ("", *UNITS), ("", *DIRECTIONS))
    return tuple(" ".join(filter(None, (SPHERICAL, *words))) for words in word_groups)


CONVENTIONS = _conventions()
"""All conventions, complete or not; the parts stand in this order."""


def is_spherical(convention: str | None) -> bool:
    """Whether a convention is one of this module."""
    return convention is not None and convention.startswith(SPHERICAL)


def completions(convention: str, stated_only: bool = True) -> list[str]:
    """The complete conventions that agree with what a convention states; stated_only=False: all, the usual ones."""
    stated = set(convention.split()) if stated_only else set()
    choices = []
    for known, tested in ((VERTICAL, VERTICAL), (UNITS, _TESTED_UNITS), (DIRECTIONS, DIRECTIONS)):
        stated_words = [word for word in known if word in stated]
        choices.append(stated_words or tested)
    return [" ".join((SPHERICAL, *words)) for words in product(*choices)]


def points_of(values: np.ndarray, convention: str) -> np.ndarray:
    """(3, n) x, y, z in the unit of the range, z upwards, of (3, n) range, azimuth, vertical angle.

    convention: a complete one.
    """
    _, vertical, unit, direction = convention.split()
    distance = values[0]
    azimuth, angle = np.deg2rad(ANGLES[unit]) * values[1:]
    elevation = angle if vertical == "elevation" else np.pi / 2 - angle
    sign = 1.0 if direction == "counterclockwise" else -1.0
    level = distance * np.cos(elevation)
    return np.stack(
        [level * np.cos(azimuth), sign * level * np.sin(azimuth), distance * np.sin(elevation)]
    )


def find_triple(headers: Mapping[str, Header]) -> tuple[tuple[Header, Header, Header], str] | None:
    """Headers of range, azimuth and vertical angle with the convention as far as they state it; None without them.

    Two columns that may be the same quantity are no triple.
    """
    found: dict[str, list[Header]] = {name: [] for name in _PATTERNS}
    for header in headers.values():
        quantity = _quantity_of(header)
        if quantity is not None:
            found[quantity].append(header)
    verticals = [(name, h) for name in (*VERTICAL, "vertical") for h in found[name]]
    if len(found["range"]) != 1 or len(found["azimuth"]) != 1 or len(verticals) != 1:
        return None
    distance, azimuth, (kind, angle) = found["range"][0], found["azimuth"][0], verticals[0]
    units = {azimuth.unit, angle.unit} & set(UNITS)
    words = [SPHERICAL, kind if kind in VERTICAL else "", units.pop() if len(units) == 1 else ""]
    return (distance, azimuth, angle), " ".join(filter(None, words))


def _quantity_of(header: Header) -> str | None:
    if header.is_deviation or header.is_nominal:
        return None
    words = [header.core] if header.kind else list(header.words)
    core = "".join(word for word in words if word not in MEASURED_WORDS)
    for name, pattern in _PATTERNS.items():
        if re.fullmatch(pattern, core):
            return name
    return None
