"""Units that foreign files use, and their size in the units of a recording (mm, deg, s)."""

import re
import unicodedata

import numpy as np

LENGTHS = {"mm": 1.0, "m": 1000.0, "in": 25.4, "cm": 10.0, "um": 0.001, "ft": 304.8, "mil": 0.0254}
"""Unit -> mm."""
ANGLES = {
    "deg": 1.0,
    "rad": 180 / np.pi,
    "gon": 0.9,
    "mrad": 0.18 / np.pi,
    "arcmin": 1 / 60,
    "arcsec": 1 / 3600,
}
"""Unit -> deg."""
DMS = "dms"
"""Degrees, minutes and seconds as digits of one number: 12.3045 is 12 deg 30 min 45 s."""
ANGLE_NAMES = (*ANGLES, DMS)
_FEWEST_FRACTIONS = 12
_ROUNDING = 1e-7
MASSES = {"kg": 1.0, "g": 0.001, "lb": 0.45359237}
"""Unit -> kg."""
TEMPERATURES = {"c": (1.0, 0.0), "k": (1.0, -273.15), "f": (5 / 9, -160 / 9)}
"""Unit -> (factor, addend) to degrees Celsius."""
COVARIATE_UNITS = {
    "payload_kg": {unit: (factor, 0.0) for unit, factor in MASSES.items()},
    "temperature_c": TEMPERATURES,
    "length_mm": {unit: (factor, 0.0) for unit, factor in LENGTHS.items()},
}
"""Column of a recording -> unit of a header -> (factor, addend)."""
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
"""Unit -> s."""

COUNTS = "counts"
"""Unit of encoders: how much one is, a mapping states."""

_NAMES = {
    "mm": (
        *("mm", "millimeter", "millimeters", "millimetre", "millimetres", "millimetern"),
        *("millimetri", "milimetros"),
    ),
    "m": ("m", "meter", "meters", "metre", "metres", "metern", "metri", "metros"),
    "cm": ("cm", "centimeter", "zentimeter"),
    "um": ("um", "µm", "μm", "micron", "microns"),
    "ft": ("ft", "foot", "feet"),
    "mil": ("mil", "mils", "thou", "thous"),
    "in": (
        *("in", "inch", "inches", "zoll", '"'),
        *("pouce", "pouces", "pollice", "pollici", "pulgada", "pulgadas", "polegada", "polegadas"),
    ),
    "deg": (
        *("deg", "degree", "degrees", "°", "grad", "º", "altgrad"),
        *("degre", "degres", "grado", "gradi", "grados", "grau", "graus"),
    ),
    "rad": ("rad", "radian", "radians", "radiant", "radianti", "radianes", "radianos"),
    "gon": ("gon", "gons", "gradian", "gradians", "neugrad", "grade", "grades"),
    "mrad": ("mrad", "milliradian", "milliradians"),
    "arcmin": ("arcmin", "arcminute", "arcminutes", "bogenminuten"),
    "arcsec": ("arcsec", "arcsecond", "arcseconds", "bogensekunden", "″"),
    "s": (
        *("s", "sec", "second", "seconds", "sekunden"),
        *("secondes", "secondi", "segundos"),
    ),
    "ms": ("ms", "msec", "milliseconds"),
    "us": ("us", "µs"),
    "ns": ("ns", "nsec", "nanoseconds"),
    "min": ("min",),
    "h": ("h",),
    "c": ("c", "°c", "degc", "celsius"),
    "k": ("k", "kelvin"),
    "f": ("f", "°f", "degf", "fahrenheit"),
    "kg": ("kg", "kilogram", "kilograms"),
    "g": ("g", "gram", "grams", "gramm"),
    "lb": ("lb", "lbs", "pound", "pounds"),
    COUNTS: (
        "counts",
        "count",
        "pulses",
        "pulse",
        "impulse",
        "impulses",
        "inkremente",
        "increments",
        "ticks",
    ),
    "1": ("1", "-"),
}
_BY_NAME = {name: unit for unit, names in _NAMES.items() for name in names}
_STATED = re.compile(r"(?:units?|einheit(?:en)?)\s*[:=]?\s*\"?([a-zµ]+)", re.IGNORECASE)


def degrees_of(values: np.ndarray, unit: str) -> np.ndarray:
    """Angles in one of `ANGLE_NAMES` as degrees. Raises KeyError for another unit."""
    if unit != DMS:
        return ANGLES[unit] * values
    degrees, minutes, seconds = _digit_pairs(values)
    return np.sign(values) * (degrees + minutes / 60 + seconds / 3600)


def may_be_dms(values: np.ndarray) -> bool:
    """Whether numbers may hold minutes and seconds in their decimals: no pair of digits is above 59.

    Decimal degrees with a dozen different fractions pass with a probability of 0.6^12, or 0.2 %.
    """
    finite = values[np.isfinite(values)]
    degrees, minutes, seconds = _digit_pairs(finite)
    fractions = np.unique((np.abs(finite) - degrees).round(4))
    return bool(len(fractions) >= _FEWEST_FRACTIONS and max(minutes.max(), seconds.max()) < 60)


def _digit_pairs(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whole degrees, the first two decimals, and the next two with all further decimals as their fraction."""
    size = np.abs(values)
    degrees = np.floor(size + _ROUNDING)
    hundredths = 100 * (size - degrees)
    minutes = np.floor(hundredths + _ROUNDING)
    return degrees, minutes, np.maximum(100 * (hundredths - minutes), 0.0)


def unit_named(text: str) -> str | None:
    """The unit that a word means ("Zoll" -> "in"); None where it is no unit."""
    plain = text.strip().lower()
    return _BY_NAME.get(plain) or _BY_NAME.get(_without_accents(plain))


def _without_accents(text: str) -> str:
    decomposed = unicodedata.normalize("NFD", text)
    return "".join(letter for letter in decomposed if not unicodedata.combining(letter))


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
    }


def length_unit_in_text(text: str) -> str | None:
    """The length unit that the lines before a table state ("Units: Millimeters"); None where they state none."""
    for match in _STATED.finditer(text):
        unit = unit_named(match[1])
        if unit in LENGTHS:
            return unit
    return None
