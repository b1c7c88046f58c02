"""The page of `workbench evaluate`: errors of a fixed model on another recording, by joint reading and by time."""

from collections.abc import Iterator, Mapping

import numpy as np

from datasets.samples.columns import joint_columns
from workbench.jobs.robot.evaluate import Evaluated
from workbench.report import style
from workbench.report.sections import Page, Section, facts, figure, table, words
from workbench.report.text import joint_label, rounded, sentence

_STATISTICS = ("rms", "mean", "p95", "max")


def page(evaluated: Evaluated, answer: Mapping) -> Page:
    """The whole page. answer: `Evaluated.as_json`."""
    error = answer["error"]
    nominal = answer["nominal"]
    numbers = (
        ("RMS position error", rounded(error["rms_mm"]), "mm"),
        ("95 % below", rounded(error["p95_mm"]), "mm"),
        ("nominal arm, RMS", rounded(nominal["rms_mm"]), "mm"),
    )
    lead = (answer["verdict"]["sentence"],)
    sections = (
        Section("errors", "Errors", tuple(_errors(evaluated, answer))),
        Section("joints", "Errors by joint reading", tuple(_by_joint(evaluated))),
        Section("time", "Errors in the order of measurement", tuple(_by_time(evaluated))),
        Section("provenance", "Provenance", (_source(evaluated, answer),)),
    )
    recording = evaluated.recording
    title = recording.title or recording.name
    warning = " ".join(map(sentence, answer["warnings"]))
    return Page("Evaluation of a model", title, numbers, lead, sections, warning=warning)


def _errors(evaluated: Evaluated, answer: Mapping) -> Iterator[dict]:
    models = (
        ("calibrated arm", answer["error"]),
        ("the same, base and tool estimated here", answer["refitted"]),
        ("nominal arm, base and tool estimated here", answer["nominal"]),
    )
    for unit, prefix in (("mm", ""), ("deg", "rotation_")):
        keys = [f"{prefix}{name}_{unit}" for name in _STATISTICS]
        if keys[0] not in answer["error"]:
            continue
        rows = [[name, *(rounded(errors[key]) for key in keys)] for name, errors in models]
        heads = [f"{statistic} ({unit})" for statistic in ("RMS", "mean", "95 % below", "max")]
        yield table(["model", *heads], rows)
    yield words("Geometry and effects of the calibrated arm are fixed.", quiet=True)
    drawn = style.figure(340, "3-D position error (mm)", "share of samples below (%)")
    for name, values, colour in _series(evaluated):
        ordered = np.sort(values)
        share = 100 * np.arange(1, len(ordered) + 1) / len(ordered)
        drawn.add_scatter(x=ordered, y=share, mode="lines", name=name, line_color=colour)
    drawn.update_xaxes(rangemode="tozero")
    yield figure("distribution", drawn, "Cumulative distribution of the position error.")


def _series(evaluated: Evaluated):
    return (
        ("calibrated", evaluated.distances, style.BLUE),
        ("nominal", evaluated.nominal_distances, style.GREY),
    )


def _by_joint(evaluated: Evaluated) -> Iterator[dict]:
    for name in joint_columns(evaluated.recording.columns):
        yield _scatter(evaluated, evaluated.recording.columns[name], joint_label(name))


def _by_time(evaluated: Evaluated) -> Iterator[dict]:
    times = evaluated.recording.columns.get("time_s")
    if times is None:
        yield _scatter(evaluated, np.arange(1, evaluated.recording.n + 1), "row number")
    else:
        yield _scatter(evaluated, times, "time (s)")


def _scatter(evaluated: Evaluated, x: np.ndarray, title: str) -> dict:
    drawn = style.figure(260, title, "position error (mm)")
    shown_rows = style.thinned(evaluated.recording.n)
    for name, values, colour in _series(evaluated)[::-1]:
        marker = dict(size=5, color=colour, opacity=0.7)
        drawn.add_scatter(
            x=x[shown_rows], y=values[shown_rows], mode="markers", name=name, marker=marker
        )
    drawn.update_yaxes(rangemode="tozero")
    name = "-".join(title.split(" (")[0].split())
    return figure(f"errors-{name}", drawn, f"Position error of each sample by {title}.")


def _source(evaluated: Evaluated, answer: Mapping) -> dict:
    return facts(
        [
            ("recording", evaluated.recording.name),
            ("measures", evaluated.recording.measures),
            ("calibrated on", str(answer["calibrated_on"])),
            ("estimated on this recording", answer["refit"]),
        ]
    )
