"""Differences between a recording and its simulation, on the page of a diagnosis: parameters, noise, physics."""

from collections.abc import Mapping, Sequence

import numpy as np

from workbench.explanation.result import Diagnosis
from workbench.report.sections import table, words
from workbench.report.text import counted, p_value, rounded

_DEGREES = {"rad": ("deg", float(np.rad2deg(1.0)))}


def three_parts(diagnosis: Diagnosis):
    """Blocks of the three parts; none where the recording was not compared with a simulation or a solution."""
    found = diagnosis.as_json()["differences"]
    if found is None:
        return
    yield from _parameters(found)
    yield words(_noise(found["noise"]))
    yield words(_physics(found["physics"]))


def _physics(effects: Sequence[Mapping]) -> str:
    names = ", ".join(f"{effect['effect']} at {effect['where']}" for effect in effects)
    return f"Physics that is not in the simulation: {names or 'none found'}."


def _parameters(found: Mapping):
    tested = counted(found["parameters_tested"], "parameter")
    if not found["parameters"]:
        yield words(f"None of {tested} differs significantly (partial F-tests).")
        return
    yield words(
        f"Of {tested}, these differ significantly from the simulation (partial F-tests, recording minus simulation). "
        "The size is the RMS displacement of the measured point. An alternative explains this recording about as well."
    )
    head = ["parameter", "difference", "standard deviation", "sigmas", "size (mm RMS)"]
    rows = [_row(parameter) for parameter in found["parameters"]]
    yield table([*head, "alternatives"], rows)


def _row(parameter: Mapping) -> tuple[str, ...]:
    value, std = (_with_unit(parameter[key], parameter["unit"]) for key in ("value", "std"))
    return (
        f"{parameter['where']} {parameter['name']}",
        value,
        std,
        f"{parameter['sigmas']:.1f}",
        rounded(parameter["size_mm"]),
        "; ".join(parameter["confounded_with"]) or "–",
    )


def _with_unit(value: float, unit: str) -> str:
    """A value with its unit; angles in degrees."""
    shown_unit, factor = _DEGREES.get(unit, (unit, 1.0))
    return f"{rounded(value * factor)} {shown_unit}"


def _noise(noise: Mapping) -> str:
    """The noise of one coordinate as a sentence."""
    if noise["factor"] is None:
        return f"Noise (1 sigma of a coordinate): {rounded(noise['found'])} mm; none is stated."
    return (
        f"Noise (1 sigma of a coordinate): stated {rounded(noise['stated'])} mm, found {rounded(noise['found'])} mm, "
        f"factor {rounded(noise['factor'])} (p of the statement: {p_value(noise['p_value'])})."
    )


__all__ = ["three_parts"]
