"""The page of `workbench compensate`: corrections, refused targets, and changes of the joint readings."""

from collections.abc import Iterator, Mapping

import numpy as np

from robot_model.state import sliding
from workbench.jobs.robot.compensation.compensate import Compensated
from workbench.report import style
from workbench.report.sections import Page, Section, facts, figure, note, table, words
from workbench.report.text import rounded, sentence

_FILES = ("corrected.csv",)


def page(arm, programme, found: Compensated, answer: Mapping) -> Page:
    """The whole page.

    arm: the `Solution` that was inverted; programme: the `Programme` of targets; answer: that of the command.
    """
    uncertainty = answer["expanded_uncertainty_max_mm"]
    numbers = (
        ("targets corrected", f"{answer['corrected_count']} of {answer['count']}", ""),
        ("largest correction", rounded(answer["largest_correction_mm"]), "mm"),
        ("largest expanded uncertainty (factor 2)", rounded(uncertainty), "mm"),
    )
    sections = (
        Section("corrections", "Corrections", tuple(_corrections(found, answer))),
        Section("joints", "Changes of the joint readings", tuple(_joints(arm, programme, found))),
        Section("provenance", "Provenance", (_source(answer),)),
    )
    warning = " ".join(map(sentence, (*answer["warnings"], *answer["remarks"])))
    title = f"Targets of {answer['targets'].name}"
    lead = (answer["verdict"]["sentence"],)
    return Page("Corrected targets", title, numbers, lead, sections, warning, files=_FILES)


def _corrections(found: Compensated, answer: Mapping) -> Iterator[dict]:
    yield figure(
        "corrections",
        _bars(found, answer),
        "Distance of the real arm from each target at the nominal readings, and the expanded uncertainty of the "
        "corrected position.",
    )
    reasons = _without_readings(answer)
    if reasons:
        yield note(
            f"{len(reasons)} targets have no readings",
            ["Do not run a program that contains them.", *answer["unattainable"]],
        )
        yield table(["target", "reason"], reasons, left=2)


def _bars(found: Compensated, answer: Mapping):
    """Correction of each target, coloured by its outcome, and its expanded uncertainty."""
    is_refused = np.zeros(len(found.reached), bool)
    is_refused[[row["row"] - 1 for row in answer["refused"]]] = True
    outcomes = (
        ("correction", found.reached & ~is_refused, style.BLUE),
        ("correction, refused", found.reached & is_refused, style.ORANGE),
        ("correction, target not reached", ~found.reached, style.GREY),
    )
    rows = np.arange(1, len(found.reached) + 1)
    drawn = style.figure(340, "target", "mm")
    for name, chosen, colour in outcomes:
        if chosen.any():
            heights = found.correction_mm[chosen]
            drawn.add_bar(x=rows[chosen], y=heights, name=name, marker_color=colour)
    uncertainty = found.expanded_uncertainty_mm
    marker = dict(size=8, color="white", symbol="diamond", line=dict(width=1.5, color=style.VIOLET))
    drawn.add_scatter(
        x=rows, y=uncertainty, mode="markers", name="expanded uncertainty", marker=marker
    )
    shown = np.concatenate([found.correction_mm, uncertainty])
    shown = shown[np.isfinite(shown) & (shown > 0)]
    if len(shown):
        drawn.update_yaxes(**style.log_axis(shown.min() / 1.5, shown.max() * 1.5))
    return drawn.update_layout(bargap=0.2)


def _without_readings(answer: Mapping) -> list[list]:
    """(number of the target, reason) of each target without readings."""
    reasons = {row["row"]: row["why"] for row in answer["refused"]}
    for row in answer["beyond_limits_rows"]:
        reasons[row] = "the corrected readings exceed the limits of the joints"
    for row in answer["unattainable_rows"]:
        reasons[row] = "not attainable"
    return [[row, reasons[row]] for row in sorted(reasons)]


def _joints(arm, programme, found: Compensated) -> Iterator[dict]:
    if programme.poses is not None:
        yield words("The targets are poses, so that no joint readings were programmed.")
        return
    change = found.readings - programme.readings
    is_linear = sliding(arm.robot)
    for unit, chosen, factor in (("deg", ~is_linear, 180 / np.pi), ("mm", is_linear, 1.0)):
        if chosen.any():
            yield _changes(change[:, chosen] * factor, np.flatnonzero(chosen) + 1, unit)


def _changes(change: np.ndarray, joints: np.ndarray, unit: str) -> dict:
    """Change (n, J) of the readings of the joints with numbers (J,)."""
    drawn = style.figure(300, "target", f"change of the reading ({unit})")
    rows = np.arange(1, len(change) + 1)
    for joint, values in zip(joints, change.T):
        drawn.add_scatter(x=rows, y=values, mode="markers", name=f"joint {joint}", marker_size=6)
    return figure(
        f"changes-{unit}",
        drawn,
        "Corrected minus programmed reading of each joint, at each target.",
    )


def _source(answer: Mapping) -> dict:
    return facts(
        [
            ("targets", str(answer["targets"])),
            ("model", str(answer["solution"])),
            ("held-out error of the model (RMS, mm)", rounded(answer["expected_error_mm"])),
            ("errors refer to", answer["point"]),
        ]
    )
