"""The page of `workbench check`: what is missing, coverage of the joints, poses in space, repeats, images."""

from collections.abc import Iterator

import numpy as np
import plotly.graph_objects as go

from workbench.recordings.inspection import Inspection
from workbench.report import style
from workbench.report.sections import Page, Section, facts, figure, table, words
from workbench.report.sensor import space
from workbench.report.text import counted, joint_label, rounded

_MOST_POINTS = 4000


def page(inspection: Inspection) -> Page:
    """The whole page."""
    recording = inspection.recording
    sections = [Section("missing", "What is missing", tuple(_missing(inspection)))]
    for name, title, blocks in (
        ("coverage", "Range of the joints", _joints(inspection)),
        ("space", "Poses in space", _space(inspection)),
        ("repeats", "Repeats and noise", _repeats(inspection)),
        ("images", "Images", _images(inspection)),
    ):
        found = tuple(blocks)
        if found:
            sections.append(Section(name, title, found))
    source = facts(
        [
            ("recording", recording.name),
            ("measures", recording.measures),
            ("source", recording.source),
        ]
    )
    sections.append(Section("provenance", "Provenance", (source,)))
    return Page(
        f"Check of a recording · {recording.measures}",
        recording.title or recording.name,
        tuple(_numbers(inspection)),
        _lead(inspection),
        tuple(sections),
        warning="" if inspection.is_sufficient else inspection.sentence,
    )


def _lead(inspection: Inspection) -> tuple[str, ...]:
    """The verdict, unless the warning above states it, and what the page is about."""
    scope = "Nothing is fitted: these are properties of the recording alone."
    if inspection.is_sufficient:
        return (inspection.sentence, scope)
    return (scope,)


def _numbers(inspection: Inspection) -> Iterator[tuple[str, str, str]]:
    if inspection.images is not None:
        yield "images", str(sum(inspection.images.roles.values())), ""
        yield "boards found", str(inspection.images.found), ""
        yield "field covered", f"{100 * inspection.images.share_of_field:.0f}", "%"
    if inspection.recording.n:
        yield "poses", str(len(np.unique(inspection.recording.poses))), ""
        yield "orientation spread", rounded(inspection.coverage.spread_deg), "deg RMS"
    if np.isfinite(inspection.repeats.noise_mm):
        yield "noise from repeats", rounded(inspection.repeats.noise_mm), "mm"
    motions = inspection.hand_eye.motions
    if motions is not None:
        yield "relative rotations, flange and camera", rounded(motions.angle_gap_deg), "deg apart"
    if motions is not None and np.isfinite(motions.scale):
        yield "lengths in the images over the flange's", rounded(motions.scale), ""


def _missing(inspection: Inspection):
    rows = [(f"workbench {n.command}", _rank(n), n.what, n.action) for n in inspection.needs]
    if rows:
        yield table(["for", "need", "what is missing or wrong", "what to do"], rows, left=4)
    else:
        yield words("Nothing that these checks look for.")


def _rank(need) -> str:
    if need.is_mistake:
        return "mistake"
    return "required" if need.is_required else "useful"


def _joints(inspection: Inspection):
    joints = inspection.coverage.joints
    if not joints:
        return
    drawn = style.figure(60 + 42 * len(joints), "reading (deg, mm for prismatic joints)")
    names = [joint_label(joint.name) for joint in joints]
    limits = [joint.upper_limit - joint.lower_limit for joint in joints]
    if np.isfinite(limits).any():
        base = [joint.lower_limit for joint in joints]
        drawn.add_bar(
            y=names,
            x=limits,
            base=base,
            orientation="h",
            name="limits",
            marker_color=style.GREY,
            opacity=0.3,
        )
    drawn.add_bar(
        y=names,
        x=[joint.extent for joint in joints],
        base=[joint.low for joint in joints],
        orientation="h",
        name="recorded",
        marker_color=style.BLUE,
        width=0.45,
    )
    drawn.update_layout(barmode="overlay")
    drawn.update_yaxes(autorange="reversed")
    yield figure(
        "joints",
        drawn,
        "Smallest to largest reading of each joint, over its limits where they are known.",
    )
    rows = [
        (
            joint_label(j.name),
            rounded(j.low),
            rounded(j.high),
            rounded(j.extent),
            f"{100 * j.share:.0f} %" if np.isfinite(j.share) else "–",
        )
        for j in joints
    ]
    yield table(["joint", "min", "max", "range", "of the limits"], rows)


def _space(inspection: Inspection):
    flange = inspection.coverage.flange
    if flange is None or not len(flange):
        return
    step = max(1, len(flange) // _MOST_POINTS)
    flange = flange[::step]
    drawn = space.space()
    order = np.arange(len(flange)) * step + 1
    space.points(drawn, flange[:, :3, 3].T, "flange", order, "row", size=3.5)
    length = 0.06 * max(float(np.ptp(flange[:, :3, 3], axis=0).max()), 50.0)
    ends = np.stack([flange[:, :3, 3], flange[:, :3, 3] + length * flange[:, :3, 2]], axis=1)
    space.lines(drawn, ends, "z axis of the flange", style.GREY, 1.5)
    space.points(drawn, np.zeros((3, 1)), "base", size=5, color=style.ORANGE, symbol="diamond")
    yield figure(
        "space",
        drawn,
        "Flange in the base frame, from the nominal robot or as recorded; colour: row number.",
    )
    if "x_mm" in inspection.recording.columns:
        measured = space.space()
        points = inspection.recording.points[::step].T
        space.points(measured, points, "measured", order[: points.shape[1]], "row", size=3)
        yield figure(
            "measured",
            measured,
            "Measured points in the frame of the instrument or sensor; colour: row number.",
        )


def _repeats(inspection: Inspection):
    repeats = inspection.repeats
    if not repeats.groups:
        return
    yield words(
        f"{counted(repeats.groups, 'pose')} measured more than once, {repeats.rows} rows; "
        "exact copies are counted once."
    )
    if not repeats.deviations.size:
        return
    drawn = style.figure(320, "deviation from the mean of the repeats (mm)", "rows")
    for name, row in zip("xyz", repeats.deviations):
        drawn.add_trace(
            go.Histogram(
                x=row, name=name, marker_color=style.COMPONENTS[name], opacity=0.6, nbinsx=40
            )
        )
    drawn.update_layout(barmode="overlay")
    if np.isnan(repeats.noise_deg):
        angle = ""
    else:
        angle = f", {rounded(repeats.noise_deg)} deg about an axis"
    noise = f"{rounded(repeats.noise_mm)} mm (1 σ of a coordinate, pooled over the groups){angle}"
    caption = f"Noise from repeats: {noise}."
    yield figure("repeats", drawn, caption)


def _images(inspection: Inspection):
    if inspection.images is None:
        return
    roles = [(role, str(count)) for role, count in inspection.images.roles.items()]
    yield table(["role", "images"], roles)
    if inspection.images.corners.size:
        width, height = inspection.images.size
        drawn = style.figure(420, "x (px)", "y (px)")
        x, y = inspection.images.corners[
            :, :: max(1, inspection.images.corners.shape[1] // _MOST_POINTS)
        ].round(1)
        drawn.add_scattergl(
            x=x, y=y, mode="markers", name="corners", marker=dict(size=3, color=style.BLUE)
        )
        drawn.update_xaxes(range=[0, width])
        drawn.update_yaxes(range=[height, 0], scaleanchor="x")
        yield figure("field", drawn, "Where the corners of all boards lie in the image.")
    if inspection.images.rejected:
        yield table(["image", "why the board is not used"], inspection.images.rejected, left=2)
