"""Joint stiffness in words: one table for the terminal and the report page.

Units are those of all output: stiffness in N m/rad, compliance in µrad/(N m), deflection in mrad.
"""

import math
from collections.abc import Mapping, Sequence

HEAD = ("where", "known from", "stiffness, compliance or deflection")
CENTRE_HEAD = "load 10 mm off"
_STEP_MM = 10.0  # how far the centre of a load is easily off


def stiffness_table(stiffness: Sequence[Mapping]) -> tuple[str, list[str], list[list[str]]]:
    """Title, column heads and rows of joint stiffness; stiffness: rows of `StiffnessRow.as_json`."""
    title = "Joint stiffness"
    if any(row["known_from"] == "product only" for row in stiffness):
        title += "; 'product only': deflection under the links, whose masses are not stated"
    rows = [
        [row["where"].replace("-", " "), row["known_from"], stiffness_text(row)]
        for row in stiffness
    ]
    if not any(row.get("centre_per_mm") for row in stiffness):
        return title, list(HEAD), rows
    for row, cells in zip(stiffness, rows):
        share = row.get("centre_per_mm")
        cells.append("" if share is None else f"{100 * _STEP_MM * share:.2g} %")
    return title, [*HEAD, CENTRE_HEAD], rows


def holds_for(stiffness: Sequence[Mapping], is_misfit: bool = False) -> str:
    """Sentences on what the stated stiffness depends on: unmodelled effects, the centre of the load; else "".

    is_misfit: the residual contains unmodelled effects.
    """
    sentences = []
    if is_misfit and any(row["stiffness"] is not None for row in stiffness):
        sentences.append(
            "The residual contains unmodelled effects. A stiffness may contain a part of them, and its standard "
            "deviation does not: use the compliance that `workbench diagnose` states."
        )
    centres = [row["load_centre_mm"] for row in stiffness if row.get("centre_per_mm")]
    if centres:
        sentences.append(_centre_sentence(centres[0]))
    return " ".join(sentences)


def _centre_sentence(centre_mm: Sequence[float]) -> str:
    place = ", ".join(f"{coordinate:.0f}" for coordinate in centre_mm)
    return _CENTRE.format(place=place)


_CENTRE = (
    "Stiffness holds for a load whose centre is at {place} mm in the flange frame (`com_mm` of `[payload]`, else the "
    "measured point). The standard deviations do not contain its uncertainty; the last column lists the change for "
    "10 mm in the least favourable direction."
)


def stiffness_text(row: Mapping) -> str:
    """'24,900 ± 1,100 N m/rad', the compliance where no stiffness is stated, or that it is not determined."""
    if row["stiffness"] is not None:
        return f"{_fixed_point(row['stiffness'], row['stiffness_std'])} N m/rad"
    if not row["clear"] and row["std"] is None:
        return "not determined"
    if row["unit"] == "rad":
        unit, factor = "mrad", 1e3
    else:
        unit, factor = "µrad/(N m)", 1e6
    if row["std"] is None:
        spread = ""
    else:
        spread = f" ± {row['std'] * factor:.2g}"
    note = "" if row["clear"] else ", not significant"
    return f"{row['value'] * factor:.3g}{spread} {unit}{note}"


def _fixed_point(value: float, std: float | None) -> str:
    """Without powers of ten: to two digits of the standard deviation, or three digits where there is none."""
    size = abs(value) if std is None else std
    if not size > 0:
        return f"{value:,.6g}"
    digits = 2 if std is None else 1
    decimals = digits - math.floor(math.log10(float(f"{size:.{digits}e}")))
    shown = max(decimals, 0)
    if std is None:
        spread = ""
    else:
        spread = f" ± {round(std, decimals):,.{shown}f}"
    return f"{round(value, decimals):,.{shown}f}{spread}"
