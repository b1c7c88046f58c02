"""Table of parameters by group, and the combinations that the data do not identify."""

from collections import Counter
from collections.abc import Mapping
from math import isfinite
from types import MappingProxyType

from workbench.core.text.stiffness_text import holds_for, stiffness_table
from workbench.report.text import counted, decimals_of, fixed, listed, rounded, sentence, shown_unit

_ROUNDING = 1e-9
"""What is smaller, in the unit of the page, is rounding in the file of a robot: no instrument measures it."""
_NO_LABELS: Mapping[str, str] = MappingProxyType({})


def section(calibration) -> dict:
    """Groups of rows, and the null space in words."""
    groups: dict[str, list] = {}
    for parameter in calibration.parameters:
        groups.setdefault(parameter["where"], []).append(parameter)
    labels = {f"{p['where']}.{p['name']}": p["label"] for p in calibration.parameters}
    return {
        "groups": [group(where, rows, labels) for where, rows in groups.items()],
        "count": count(calibration.parameters),
        "null_space": null_space(calibration),
        "stiffness": stiffness(calibration),
    }


def stiffness(calibration) -> dict | None:
    """Table of joint stiffness, as in the terminal, and what it holds for; None where no joint deflects."""
    if not calibration.stiffness:
        return None
    title, head, rows = stiffness_table(calibration.stiffness)
    noise = getattr(calibration, "noise", None)
    is_misfit = noise is not None and noise.level != "none"
    return {
        "title": title,
        "head": head,
        "rows": rows,
        "holds_for": holds_for(calibration.stiffness, is_misfit),
    }


def null_space(calibration) -> list[str]:
    """Parameters that are not identifiable from these data, in words."""
    return [sentence(shortened(words)) for words in calibration.solution.null_sentences]


def shortened(words: str, max_items: int = 8) -> str:
    """A sentence that lists at most `max_items` items; the JSON lists all of them."""
    items = words.split(", ")
    if len(items) <= max_items + 2:
        return words
    listed = ", ".join(items[:max_items])
    unlisted_count = len(items) - max_items + (" and " in items[-1])
    return f"{listed} and {unlisted_count} more (listed in the JSON)"


def count(parameters) -> str:
    """Number of parameters that are estimated, not identifiable, and held."""
    statuses = Counter(p["status"] for p in parameters)
    bounded = _bounded_count(statuses["at zero"])
    return (
        f"Of {counted(len(parameters), 'parameter')}, {statuses['estimated']} are estimated with a standard "
        f"deviation, {statuses['not identifiable']} are not identifiable from this recording, {bounded}and "
        f"{statuses['held']} are held at nominal by the plan."
    )


def _bounded_count(count: int) -> str:
    if not count:
        return ""
    verb = "is" if count == 1 else "are"
    return f"{count} cannot be negative and {verb} held at zero, "


def group(where: str, parameters: list[dict], labels: Mapping[str, str]) -> dict:
    """One fold-out group with its one-line summary; labels: key of a parameter -> what it is in words."""
    free = [p for p in parameters if p["free"]]
    statuses = Counter(p["status"] for p in parameters)
    counts = [
        f"{statuses[name]} {name}"
        for name in ("estimated", "not identifiable", "held")
        if statuses[name]
    ]
    return {
        "where": where.replace("-", " "),
        "rows": [row(p, labels) for p in parameters],
        "lost": sum(not p["identifiable"] for p in free),
        "summary": ", ".join(counts) + _largest(free),
    }


def row(p: dict, labels: Mapping[str, str] = _NO_LABELS) -> dict:
    """One line, in the unit of the page, rounded to two digits of its standard deviation."""
    unit, factor = shown_unit(p["unit"])
    known = p["free"] and p["identifiable"]
    std = _scaled(p["std"], factor) if known else None
    decimals = None if std is None else decimals_of(std)
    digits = 3 if p["free"] else 6
    nominal = _scaled(_nominal(p), factor)
    change = _scaled(_change(p), factor)
    return {
        "name": p["name"],
        "label": p["label"],
        "unit": unit,
        "std": _number(std, decimals),
        "value": _number(_scaled(p["value"], factor), decimals, digits),
        "nominal": _number(nominal, decimals),
        "change": _signed(change, decimals, digits) if p["free"] else "–",
        "sigmas": _sigmas(change, std),
        "state": state(p, labels),
        "known": known,
        "free": p["free"],
    }


def state(p: dict, labels: Mapping[str, str]) -> str:
    """Why a parameter is held or not identifiable; "" if it is estimated."""
    if p["free"] and p["identifiable"]:
        return ""
    others = list(p["tied_to"])
    words = _several([labels.get(key, key) for key in others])
    tied = f": tied to {words}" if others else ""
    why = p["why"].replace(", ".join(others), words) if others else p["why"]
    return sentence(why or p["status"] + tied)


def _several(keys, max_names=4):
    """The first names, and the number of further ones."""
    return listed(
        [*keys[:max_names], *([f"{len(keys) - max_names} more"] if len(keys) > max_names else [])]
    )


def _largest(free):
    """'; most significant deviation a3 +0.40 mm (36 σ)', or nothing."""
    sizes = [
        (abs(_change(p)) / p["std"], p)
        for p in free
        if p["identifiable"] and p["std"] and _change(p) is not None and isfinite(p["std"])
    ]
    if not sizes:
        return ""
    size, largest_row = max(sizes, key=lambda pair: pair[0])
    unit, factor = shown_unit(largest_row["unit"])
    change = _signed(factor * _change(largest_row), decimals_of(factor * largest_row["std"]))
    return f"; most significant deviation {largest_row['name']} {change} {unit} ({_sigma_text(size)} σ)"


def _nominal(p):
    """The nominal value; None for poses and points, which have none."""
    return None if p["deviation"] is None else p["nominal"]


def _change(p):
    return p["deviation"]


def _scaled(value, factor):
    return None if value is None or not isfinite(value) else factor * value


def _number(value, decimals, digits=6):
    """`value` with `decimals` decimals; with `digits` significant digits if `decimals` is None."""
    if value is None:
        return "–"
    if decimals is None:
        value = 0.0 if abs(value) < _ROUNDING else value
        return f"{value:.6g}".replace("-", "−") if digits == 6 else rounded(value, digits)
    return fixed(value, decimals)


def _signed(value, decimals, digits=6):
    return ("+" if value is not None and value > 0 else "") + _number(value, decimals, digits)


def _sigma_text(size):
    """A multiple of sigma: one decimal below 10, none above."""
    return fixed(size, 1 if size < 9.95 else 0)


def _sigmas(change, std):
    return "–" if change is None or not std else _sigma_text(abs(change) / std)
