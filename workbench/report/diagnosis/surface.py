"""Page of the diagnosis of a profiler or a 3-D camera: effects, held-out errors over covariates and poses."""

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go

from workbench.diagnosis.scanner.surface import SurfaceDiagnosis
from workbench.report import style
from workbench.report.diagnosis.figures import binned, covariate_name
from workbench.report.sections import Page, Section, figure, note, table, words
from workbench.report.text import rounded

_MOST_FIGURES = 6
_POINTS = 1500
_NAMES = {
    "x": "x in the sensor frame, mm",
    "y": "y in the sensor frame, mm",
    "z": "z in the sensor frame, mm",
    "incidence": "angle of incidence, deg",
    "order": "pose, in the order of the recording",
}
_ERRORS = {
    "ball-surface": "Errors are distances of measured points from the ball.",
    "ball-centre": "Errors are the coordinates of measured ball centres in the base, less their mean.",
}
_STAGES = (("baseline", style.GREY), ("with findings", style.BLUE))


def page(diagnosis: SurfaceDiagnosis, answer: Mapping) -> Page:
    """The page; answer: the object of `diagnose --json` of the same diagnosis."""
    held_out = answer["held_out"]
    numbers = [
        ("held-out RMS, baseline", rounded(held_out["before_mm"]), "mm"),
        ("held-out RMS, with findings", rounded(held_out["after_mm"]), "mm"),
        ("noise", rounded(held_out["noise_mm"]), "mm"),
        ("effects found", str(len(answer["effects"])), ""),
    ]
    lead = [
        f"Verdict: {answer['verdict']}. {answer['verdict_details']['sentence']}",
        f"{_ERRORS[diagnosis.recording.measures]} Hand-eye transform and centres of balls are estimated, with a random "
        "error of every flange pose. Each effect is tested by an F-test and by held-out poses.",
    ]
    return Page(
        "Diagnosis of the sensor",
        answer["recording"],
        tuple(numbers),
        tuple(lead),
        (
            Section("effects", "Effects", tuple(_effects(answer))),
            Section("errors", "Held-out errors", tuple(_errors(diagnosis))),
            Section("detectable", "Minimal detectable sizes", tuple(_detectable(answer))),
        ),
    )


def _effects(answer: Mapping):
    if not answer["effects"]:
        yield words("No effect was retained.")
    else:
        rows = [
            (
                effect["effect"],
                effect["where"],
                effect["label"],
                rounded(effect["size_mm"]),
                f"{effect['p_value']:.2g}",
                f"{effect['probability']:.2f}",
                rounded(effect["held_out_before_mm"]),
                rounded(effect["held_out_after_mm"]),
            )
            for effect in answer["effects"]
        ]
        head = [
            *("effect", "place", "law", "size, RMS (mm)", "p", "probability"),
            *("held out before (mm)", "after (mm)"),
        ]
        yield table(head, rows, left=3)
    statements = [place["statement"] for place in answer["located"] if "statement" in place]
    if statements:
        yield note("Not explained", statements)
    alternatives = [
        f"{effect['effect']}: {other['effect']} at {other['where']}, probability {other['probability']:.2f}, "
        f"{other['why']}"
        for effect in answer["effects"]
        for other in effect["alternatives"]
    ]
    if alternatives:
        yield note("Alternatives", alternatives)
    if answer["refused"]:
        yield note(
            "Tested and not retained", [refused["statement"] for refused in answer["refused"]]
        )
    yield words(f"Next: {answer['next_experiment']}.", quiet=True)


def _errors(diagnosis: SurfaceDiagnosis):
    for k, (name, values) in enumerate(list(diagnosis.covariates.items())[:_MOST_FIGURES]):
        caption = (
            "Signed error. Lines are means of bins; they are flat where nothing depends on it."
        )
        yield figure(f"error-{k}", _covariate_figure(diagnosis, name, values), caption)


def _covariate_figure(diagnosis: SurfaceDiagnosis, name: str, values: np.ndarray) -> go.Figure:
    plot = style.figure(300, _NAMES.get(name, covariate_name(name)), "held-out error, mm")
    shown = np.arange(0, len(values), 1 + len(values) // _POINTS)
    for (stage, colour), error in zip(_STAGES, (diagnosis.before, diagnosis.after)):
        if stage != _STAGES[0][0] and not diagnosis.retained:
            continue
        plot.add_scatter(
            x=values[shown],
            y=error[shown],
            mode="markers",
            showlegend=False,
            hoverinfo="skip",
            marker={"size": 2.5, "color": colour, "opacity": 0.3},
        )
        centres, means = binned(values, error)
        line = {"color": colour, "width": 3}
        plot.add_scatter(x=centres, y=means, mode="lines", name=stage, line=line)
    return plot


def _detectable(answer: Mapping):
    rows = [
        (row["effect"], row["where"], row["variant"], rounded(row["size_mm"]))
        for row in answer["smallest_visible"]
    ]
    yield table(["effect", "place", "law", "size, RMS (mm)"], rows, left=3)
    yield words("An effect of this size would be found with a probability of 95 %.", quiet=True)
