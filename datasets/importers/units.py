"""Units that foreign files use, and their size in the units of a recording (mm, deg, s)."""

import re

import numpy as np

LENGTHS = {"mm": 1.0, "m": 1000.0, "in": 25.4, "cm": 10.0, "um": 0.001}
"""Unit -> mm."""
ANGLES = {"deg": 1.0, "rad": 180 / np.pi, "gon": 0.9, "mrad": 0.18 / np.pi}
"""Unit -> deg."""
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
"""Unit -> s."""

_NAMES = {
    "mm": ("mm", "millimeter", "millimeters", "millimetre", "millimetres", "millimetern"),
    "m": ("m", "meter", "meters", "metre", "metres", "metern"),
    "cm": ("cm", "centimeter", "zentimeter"),
    "um": ("um", "µm", "μm", "micron", "microns"),
    "in": ("in", "inch", "inches", "zoll", '"'),
    "deg": ("deg", "degree", "degrees", "°", "grad", "º", "altgrad"),
    "rad": ("rad", "radian", "radians", "radiant"),
    "gon": ("gon", "gons", "gradian", "gradians", "neugrad"),
    "mrad": ("mrad",),
    "s": ("s", "sec", "second", "seconds", "sekunden"),
    "ms": ("ms", "msec", "milliseconds"),
    "us": ("us", "µs"),
    "ns": ("ns", "nsec", "nanoseconds"),
    "min": ("min",),
    "h": ("h",),
    "c": ("c", "°c", "degc", "celsius"),
    "kg": ("kg",),
    "1": ("1", "-"),
}
_BY_NAME = {name: unit for unit, names in _NAMES.items() for name in names}
_STATED = re.compile(r"(?:units?|einheit(?:en)?)\s*[:=]?\s*\"?([a-zµ]+)", re.IGNORECASE)


def unit_named(text: str) -> str | None:
    """The unit that a word means ("Zoll" -> "in"); None where it is no unit."""
    return _BY_NAME.get(text.strip().lower())


def is_unit(text: str) -> bool:
    """Whether a word is a unit."""
    return unit_named(text) is not None or text.strip().lower() in {
        "n",
        "nm",
        "a",
        "v",
        "%",
        "mm/s",
        "deg/s",
        "k",
    }


def length_unit_in_text(text: str) -> str | None:
    """The length unit that the lines before a table state ("Units: Millimeters"); None where they state none."""
    for match in _STATED.finditer(text):
        unit = unit_named(match[1])
        if unit in LENGTHS:
            return unit
    return None
