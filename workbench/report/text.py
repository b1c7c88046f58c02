"""Formatting of numbers and words for report pages."""

import math
import re

from workbench.core.vocabulary import Covariate

UNITS = {"rad": ("deg", 180 / math.pi), "rad/rad": ("mrad/rad", 1e3)}
"""Unit of a parameter -> unit on the page and the factor to it; other rad/... become µrad/..."""

_UNITS_OF_COLUMNS = {
    "c": "°C",
    "nm": "N m",
    "deg_s": "deg/s",
    "mm_s": "mm/s",
    "m_s2": "m/s²",
}
_QUANTITIES = {
    "tau": "gravity torque",
    "qdot": "speed",
    "move": "last move",
    "approach": "direction of approach",
    "moment": "bending moment",
}


def covariate_label(name: str) -> str:
    """Axis label of a column: quantity and unit, "temperature of joint 2 (°C)" for "temperature_j2_c"."""
    known = Covariate.of(name)
    words = _QUANTITIES.get(known.kind, known.kind.replace("_", " "))
    if known.place is not None:
        number = known.place.number
        words += f" of the {known.place}" if number is None else f" of {known.place.kind} {number}"
    if known.component:
        words += f", {known.component}"
    unit = _UNITS_OF_COLUMNS.get(known.unit, known.unit)
    return f"{words} ({unit})" if unit else words


def rounded(value: float | None, digits: int = 3) -> str:
    """`value` with `digits` significant digits and a true minus sign; a dash for no value."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{mantissa}·10{_raised(int(exponent))}".replace("-", "−")
    exponent = int(
        f"{value:.{digits - 1}e}".split("e")[1]
    )  # of the rounded value: 0.09999 is 0.100
    return fixed(value, digits - 1 - exponent)


def p_value(value: float | None) -> str:
    """A p-value with two significant digits; below a millionth "< 1e-6", where no test is that exact."""
    if value is not None and math.isfinite(value) and value < 1e-6:
        return "< 1e-6"
    return rounded(value, 2)


def fixed(value: float, decimals: int) -> str:
    """`value` with `decimals` decimals and a true minus sign."""
    shown = f"{value:z.{max(decimals, 0)}f}"
    return shown.replace("-", "−")


def decimals_of(std: float) -> int:
    """Decimals that show the first two digits of a standard deviation."""
    if not std > 0:
        return 4
    return min(max(1 - math.floor(math.log10(std)), 0), 9)


def shown_unit(unit: str) -> tuple[str, float]:
    """Unit on the page, and the factor from `unit` to it."""
    if unit.startswith("rad/") and unit not in UNITS:
        return f"µ{unit}", 1e6
    return UNITS.get(unit, (unit, 1.0))


def counted(number: int, noun: str) -> str:
    """'1 fold', '2,000 folds'."""
    return f"{number:,} {noun}" + ("" if number == 1 else "s")


def joint_label(column: str) -> str:
    """A column of joint readings with its unit: "q1_deg" -> "joint 1 (deg)"; any other name as it is."""
    name, _, unit = column.partition("_")
    if not (name[:1] == "q" and name[1:].isdecimal()):
        return column
    if unit:
        return f"joint {name[1:]} ({unit})"
    return f"joint {name[1:]}"


_COLUMN = re.compile(r"\b[a-z]\w*_(?:mm|deg|c|kg|s|nm)\b")


def with_labels(text: str) -> str:
    """A text with names of columns as quantities: "with range_mm the noise" -> "with range (mm) the noise"."""
    return _COLUMN.sub(lambda found: _label(found[0]), text)


def _label(column: str) -> str:
    joint = joint_label(column)
    return covariate_label(column) if joint == column else joint


def column_label(column: str) -> str:
    """A column of a table of results: "geometry_test_3kg_mm" -> "geometry test 3kg (mm)"."""
    stem, _, unit = column.rpartition("_")
    known = stem and unit in ("mm", "deg", "px", "um", "kg", "s")
    if known:
        return f"{stem} ({unit})".replace("_", " ")
    return column.replace("_", " ")


def axis_label(axis) -> str:
    """A varied parameter of a study with its unit: the stated one, else that of its name or path."""
    if axis.unit:
        name = axis.name.replace("_", " ")
        return f"{name} ({axis.unit})"
    label = column_label(axis.name)
    unit = Covariate.of(_key(axis.paths[0])).unit
    if label.endswith(")") or not unit:
        return label
    shown_unit = _UNITS_OF_COLUMNS.get(unit, unit)
    return f"{label} ({shown_unit})"


def _key(path: str) -> str:
    """The last part of a path that is no number of an entry: "sigma_mm" of "scene.sigma_mm.2"."""
    return next(part for part in reversed(path.split(".")) if not part.isdecimal())


def listed(words: list[str]) -> str:
    """'a', 'a and b', 'a, b and c'."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def sentence(words: str) -> str:
    """`words` with a capital at its start and a full stop at its end."""
    words = str(words).strip()
    return words and words[0].upper() + words[1:] + ("" if words[-1] in ".!?…" else ".")


def _raised(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻"))
