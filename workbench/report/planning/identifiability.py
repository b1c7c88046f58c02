"""The page of `workbench identifiability`: stages, predicted standard deviations, confounded parameters, poses."""

from collections.abc import Mapping

import numpy as np

from robot_model import load_robot
from robot_model.measurements import end_recordings, samples_of
from workbench.core.text.confounded import confounded_lists
from workbench.report import style
from workbench.report.planning import arm_space, observability
from workbench.report.sections import Page, Section, facts, figure, note, table, words
from workbench.report.text import rounded, shown_unit

_GAUGE = (
    "A combination that is not identifiable in any poses is a gauge freedom: predictions and corrections do not depend "
    "on it, and no action is needed. It was tested at random poses with the reflectors and loads of this recording. A "
    "combination that is not identifiable in these poses is determined by others, see `workbench poses`."
)


def page(recording, answer: Mapping) -> Page:
    """The whole page. answer: of `workbench.jobs.robot.identify.identifiability`."""
    last = answer["stages"][-1]
    numbers = (
        ("samples", str(answer["samples"]), ""),
        ("poses", str(answer["poses"]), ""),
        ("free parameters", str(last["free"]), ""),
        ("identifiable", str(last["identifiable"]), ""),
    )
    assumed = answer["sigma_assumed_mm"]
    lead = [
        "Nothing is fitted: the page judges the poses and the stated noise at the nominal geometry."
    ]
    if assumed is not None:
        lead.append(
            f"The recording states no noise; {assumed:g} mm (1 sigma of a coordinate) is assumed."
        )
    sections = [
        Section("stages", "Stages", tuple(_stages(answer))),
        Section("precision", "Predicted standard deviations", tuple(_precision(answer))),
        Section("confounded", "What is not identifiable", tuple(_confounded(answer))),
    ]
    poses = tuple(_poses(recording))
    if poses:
        sections.append(Section("space", "Poses", poses))
    source = facts(
        [
            ("recording", recording.name),
            ("measures", recording.measures),
            ("source", recording.source),
        ]
    )
    sections.append(Section("provenance", "Provenance", (source,)))
    title = recording.title or recording.name
    return Page("Identifiability before any fit", title, numbers, tuple(lead), tuple(sections))


def _stages(answer):
    stages = answer["stages"]
    names = [stage["name"] for stage in stages]
    drawn = style.figure(340, "stage", "parameters")
    identified = [stage["identifiable"] for stage in stages]
    not_identifiable = [stage["free"] - stage["identifiable"] for stage in stages]
    drawn.add_bar(x=names, y=identified, name="identifiable", marker_color=style.BLUE)
    drawn.add_bar(x=names, y=not_identifiable, name="not identifiable", marker_color=style.ORANGE)
    drawn.update_layout(barmode="stack", bargap=0.35)
    yield figure("stages", drawn, "Free parameters of each stage, each with all stages before it.")
    yield observability.of_stages(stages)
    yield observability.meaning()


def _precision(answer):
    rows = answer["stages"][-1]["parameters"]
    drawn = style.figure(440, "parameter", "1 σ over typical size")
    for is_identifiable, name, colour in (
        (True, "identifiable", style.BLUE),
        (False, "takes part in a direction that is not", style.ORANGE),
    ):
        chosen = [row for row in rows if row["identifiable"] == is_identifiable]
        ratios = [row["std"] / row["typical"] for row in chosen]
        drawn.add_bar(x=[row["key"] for row in chosen], y=ratios, name=name, marker_color=colour)
    drawn.update_layout(showlegend=True)
    ratios = [row["std"] / row["typical"] for row in rows]
    drawn.update_yaxes(style.log_axis(min(ratios), max(ratios)))
    drawn.update_xaxes(tickangle=-60)
    yield figure(
        "precision",
        drawn,
        "Predicted 1 sigma of each parameter with these poses and this noise, in units of the size that is typical "
        "for it: below 1 the recording adds information, 0.01 is one hundredth of a typical error.",
    )
    lines = []
    for row in rows:
        unit, factor = shown_unit(row["unit"])
        state = "yes" if row["identifiable"] else "no"
        lines.append((row["key"], rounded(factor * row["std"]), unit, state))
    yield table(["parameter", "predicted 1 σ", "unit", "identifiable alone"], lines)


def _confounded(answer):
    yield words(_GAUGE)
    lists = confounded_lists(answer["stages"])
    for title, sentences in lists:
        yield note(title[0].upper() + title[1:], sentences)
    if not lists:
        yield words("All free parameters are identifiable.")


def _poses(recording):
    moving = samples_of(recording)
    if not recording.robot or not moving.joints.size:
        return
    robot = load_robot(recording.robot, f"robot of {recording.name}")
    joints = np.concatenate([end.joints for end in end_recordings(moving)])
    drawn = arm_space.joint_ranges(robot, [("recorded", joints, style.BLUE)])
    yield figure(
        "joints",
        drawn,
        "Smallest to largest reading of each joint, over its limits where they are known.",
    )
    places = arm_space.flange_places(robot, joints)
    drawn = arm_space.poses_in_space([("flange", places, style.BLUE, 3)])
    yield figure("space", drawn, "Origin of the nominal flange in the base frame (mm).")
