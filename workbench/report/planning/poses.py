"""The page of `workbench poses`: the chosen poses in space, and how good they are next to random sets."""

from collections.abc import Mapping

import numpy as np

from robot_model import load_robot
from robot_model.measurements import end_recordings, samples_of
from workbench.jobs.robot.poses import Chosen
from workbench.report import style
from workbench.report.planning import arm_space, observability
from workbench.report.sections import Page, Section, facts, figure, note, table, words
from workbench.report.text import rounded


def page(chosen: Chosen, answer: Mapping) -> Page:
    """The whole page. answer: `Chosen.as_json` with its verdict."""
    recording = chosen.recording
    numbers = [
        ("poses chosen", str(answer["poses"]), ""),
        ("candidates", str(answer["candidates"]), ""),
        ("better than random sets", rounded(answer["gain_over_random"]), "times"),
    ]
    if answer["predicted"]:
        numbers.append(
            ("predicted error at the tasks", rounded(answer["predicted"]["chosen_mm"]), "mm RMS")
        )
    lead = (
        f"Criterion {chosen.criterion} of {answer['parameters']} parameters, compared with random sets of as many "
        "poses.",
        "Measure the rows of poses.csv; repeats stand at its end.",
    )
    sections = (
        Section("space", "Chosen poses", tuple(_space(chosen))),
        Section("criterion", "How good the set is", tuple(_criterion(chosen, answer))),
        Section("open", "What is not identifiable", tuple(_open(answer))),
        Section("left-out", "Candidates", tuple(_left_out(answer))),
        Section(
            "provenance",
            "Provenance",
            (facts([("candidates", answer["recording"]), ("kind", recording.measures)]),),
        ),
    )
    title = recording.title or answer["recording"]
    warning = " ".join(answer["warnings"])
    return Page("Choice of poses", title, tuple(numbers), lead, sections, warning=warning)


def _space(chosen: Chosen):
    moving = samples_of(chosen.recording)
    robot = load_robot(chosen.recording.robot, "robot of the candidates")
    ends = end_recordings(moving)
    joints = np.concatenate([end.joints for end in ends])
    numbers = np.concatenate([end.sample_ids for end in ends])
    taken = np.isin(numbers, chosen.samples)
    places = arm_space.flange_places(robot, joints)
    drawn = arm_space.poses_in_space(
        [
            ("candidates", places[:, ~taken], style.GREY, 2),
            ("chosen", places[:, taken], style.BLUE, 5),
        ]
    )
    yield figure("space", drawn, "Origin of the nominal flange in the base frame (mm).")
    point_sets = [("candidates", joints, style.GREY), ("chosen", joints[taken], style.BLUE)]
    drawn = arm_space.joint_ranges(robot, point_sets)
    yield figure("joints", drawn, "Range of each joint in all candidates and in the chosen poses.")


def _criterion(chosen: Chosen, answer: Mapping):
    design = chosen.design
    is_task = chosen.criterion == "task"
    scaled = np.sqrt if is_task else np.asarray
    label = "predicted error at the tasks (mm RMS)" if is_task else f"criterion {chosen.criterion}"
    drawn = style.figure(340, label, "random sets")
    drawn.add_histogram(
        x=scaled(design.random),
        nbinsx=40,
        name=f"{answer['poses']} at random",
        marker_color=style.GREY,
    )
    if len(design.twice):
        drawn.add_histogram(
            x=scaled(design.twice),
            nbinsx=40,
            name=f"{2 * answer['poses']} at random",
            marker_color=style.GREEN,
        )
    drawn.update_layout(barmode="overlay")
    drawn.add_vline(x=float(scaled(design.value)), line_color=style.BLUE, annotation_text="chosen")
    better = "Larger" if design.larger_is_better else "Smaller"
    yield figure(
        "criterion",
        drawn,
        f"The chosen set and {len(design.random)} random ones. {better} is better.",
    )
    if answer["predicted"]:
        yield _predicted(answer)
    if chosen.criterion.startswith("O"):
        yield observability.meaning()


def _predicted(answer: Mapping) -> dict:
    n = answer["poses"]
    error = answer["predicted"]
    rows = [
        (f"these {n}", rounded(error["chosen_mm"])),
        (f"{n} at random (median)", rounded(error["random_mm"])),
        (f"{2 * n} at random (median)", rounded(error["random_twice_mm"])),
        ("all candidates", rounded(error["all_mm"])),
        (f"lower bound for any {n}", rounded(error["bound_mm"])),
    ]
    return table(["measured", "predicted error (mm RMS)"], rows)


def _open(answer: Mapping):
    if answer["undetermined"]:
        yield note("Only combinations of these are determined", answer["undetermined"])
    else:
        yield words("All parameters are identifiable from these poses.")


def _left_out(answer: Mapping):
    rows = [(why, count) for why, count in answer["left_out"].items()]
    yield table(["reason", "candidates left out"], rows)
