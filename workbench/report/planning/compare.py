"""The page of `workbench compare`: errors of every plan, their distribution and the paired tests."""

from collections.abc import Mapping

import numpy as np

from workbench.jobs.robot.compare import Comparison
from workbench.report import style
from workbench.report.sections import Page, Section, facts, figure, note, table, words
from workbench.report.text import p_value, rounded, sentence

_COLOURS = (style.GREY, style.BLUE, style.GREEN, style.VIOLET, style.ORANGE)
_MOST_TICKS = 20


def page(comparison: Comparison, answer: Mapping) -> Page:
    """The whole page. answer: `Comparison.as_json`."""
    plans = answer["plans"]
    best = min(plans, key=lambda row: row["held_out_rms_mm"])
    numbers = (
        ("plans", str(len(plans)), ""),
        ("samples held out", str(answer["held_out_samples"]), ""),
        ("smallest held-out RMS", rounded(best["held_out_rms_mm"]), "mm"),
    )
    lead = (f"Plan {best['plan']} has the smallest held-out RMS position error.", _first(plans))
    sections = [
        Section("errors", "Errors of the plans", tuple(_errors(plans))),
        Section(
            "distribution", "Distribution of the held-out errors", tuple(_distribution(comparison))
        ),
        Section("blocks", "The same held-out samples under each plan", tuple(_blocks(comparison))),
        Section("noise", "Residual and noise", tuple(_verdicts(plans))),
    ]
    recording = comparison.recording
    source = facts(
        [
            ("recording", recording.name),
            ("measures", recording.measures),
            ("source", recording.source),
        ]
    )
    sections.append(Section("provenance", "Provenance", (source,)))
    title = recording.title or recording.name
    warning = " ".join(map(sentence, answer.get("warnings", ())))
    return Page("Comparison of plans", title, numbers, lead, tuple(sections), warning=warning)


def _first(plans) -> str:
    return f"Ratios and tests compare each plan with the first plan, {plans[0]['plan']}."


def _errors(plans):
    names = [row["plan"] for row in plans]
    for unit, prefix, quantity in (("mm", "", "position"), ("deg", "rotation_", "orientation")):
        if f"held_out_{prefix}rms_{unit}" not in plans[0]:
            continue
        drawn = style.figure(90 + 60 * len(plans), f"RMS {quantity} error ({unit})")
        for kind, name, colour in (
            ("fit", "fitted", style.GREY),
            ("held_out", "held out", style.BLUE),
        ):
            values = [row[f"{kind}_{prefix}rms_{unit}"] for row in plans]
            drawn.add_bar(x=values, y=names, orientation="h", name=name, marker_color=colour)
        drawn.update_yaxes(autorange="reversed")
        drawn.update_layout(barmode="group", bargap=0.3, margin_l=140)
        yield figure(f"errors-{unit}", drawn, f"RMS {quantity} error of each plan.")
    rows = [
        (
            row["plan"],
            row["free"],
            row["identifiable"],
            rounded(row["fit_rms_mm"]),
            rounded(row["held_out_rms_mm"]),
            rounded(row["ratio"]),
            p_value(row["p"]),
        )
        for row in plans
    ]
    head = ["plan", "free", "identifiable", "fit (mm)", "held out (mm)", "ratio", "p"]
    yield table(head, rows)
    for row in plans[1:]:
        if row["p"] is None:
            yield words(f"p of {row['plan']}: {row['test']}.", quiet=True)
    yield words(
        "p: probability of so large a difference of the mean squared errors if both plans predict equally well "
        "(Student's t over folds or blocks, two-sided).",
        quiet=True,
    )


def _distribution(comparison: Comparison):
    kinds = [("3-D position error", "mm", comparison.distances)]
    if comparison.measures_orientation:
        kinds.append(("rotation angle", "deg", comparison.angles))
    for quantity, unit, errors in kinds:
        drawn = style.figure(360, f"{quantity}, held out ({unit})", "share of samples below (%)")
        for name, values, colour in zip(comparison.names, errors, _cycle(len(errors))):
            ordered = np.sort(values)
            share = 100 * np.arange(1, len(ordered) + 1) / len(ordered)
            drawn.add_scatter(x=ordered, y=share, mode="lines", name=name, line_color=colour)
        drawn.update_xaxes(rangemode="tozero")
        yield figure(f"distribution-{unit}", drawn, f"Cumulative distribution of the {quantity}.")


def _blocks(comparison: Comparison):
    """RMS of each fold or block under each plan: the pairs that the test compares."""
    block = comparison.block[comparison.block >= 0]
    numbers = np.unique(block)
    drawn = style.figure(340, "fold or block", "held-out RMS (mm)")
    for name, values, colour in zip(
        comparison.names, comparison.distances, _cycle(len(comparison.names))
    ):
        rms = [np.sqrt(np.mean(values[block == number] ** 2)) for number in numbers]
        drawn.add_scatter(x=numbers + 1, y=rms, mode="lines+markers", name=name, line_color=colour)
    drawn.update_yaxes(rangemode="tozero")
    if len(numbers) <= _MOST_TICKS:
        drawn.update_xaxes(tickvals=numbers + 1)
    yield figure(
        "blocks",
        drawn,
        "A plan is better beyond chance if its line is below the other in nearly every fold.",
    )
    first = comparison.distances[0]
    if len(comparison.names) > 1:
        drawn = style.figure(
            380, f"error under plan {comparison.names[0]} (mm)", "error under the other plan (mm)"
        )
        shown_rows = style.thinned(len(first))
        for name, values, colour in zip(
            comparison.names[1:], comparison.distances[1:], _cycle(len(comparison.names))[1:]
        ):
            marker = dict(size=4, color=colour, opacity=0.6)
            drawn.add_scattergl(
                x=first[shown_rows], y=values[shown_rows], mode="markers", name=name, marker=marker
            )
        largest = float(comparison.distances.max())
        drawn.add_scatter(
            x=[0, largest],
            y=[0, largest],
            mode="lines",
            name="equal",
            line=dict(color=style.GREY, dash="dot"),
        )
        yield figure(
            "pairs",
            drawn,
            "Each held-out sample: below the dotted line the other plan predicts it better.",
        )


def _verdicts(plans):
    for row in plans:
        yield note(row["plan"], [row["verdict"]["sentence"]])


def _cycle(count: int) -> list[str]:
    return [_COLOURS[k % len(_COLOURS)] for k in range(count)]
