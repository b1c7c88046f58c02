"""The page of `workbench significance`: how much each parameter moves position and axes of the end effector."""

import numpy as np

from workbench.jobs.robot.significance import COMPONENTS, Significance
from workbench.report import style
from workbench.report.sections import Page, Section, facts, figure, pair, table, words
from workbench.report.text import rounded

_TITLES = {"position": "position", "x": "x axis", "y": "y axis", "z": "z axis"}


def page(found: Significance) -> Page:
    """The whole page."""
    step = f"{found.step_mm:g} mm or {found.step_rad:g} rad"
    largest = int(np.argmax(found.index[:, 0]))
    numbers = (
        ("parameters", str(len(found.keys)), ""),
        ("configurations", str(found.points), ""),
        ("largest change of position", rounded(found.index[largest, 0]), "mm"),
    )
    lead = (
        f"Mean change of the end effector when one parameter changes by {step}, over {found.points} {found.place}.",
        f"{found.keys[largest]} moves the position most. Nothing is fitted: only the nominal robot is used.",
    )
    lines = [("robot", found.robot.name), ("source", found.robot.source)]
    sections = (
        Section("change", "Mean change by an error of each parameter", tuple(_charts(found))),
        Section("ratio", "Sensitivity", tuple(_sensitivity(found))),
        Section("values", "All values", (_table(found),)),
        Section(
            "provenance",
            "Provenance",
            (facts(lines),),
        ),
    )
    return Page(
        "Significance of the kinematic parameters", found.robot.name, numbers, lead, sections
    )


def _charts(found: Significance):
    names = [key.partition(".")[2] for key in found.keys]
    charts = []
    for part, column in zip(COMPONENTS, found.index.T):
        axis_title = "change (mm)" if part == "position" else "change of the unit vector"
        drawn = style.figure(300, "parameter", axis_title)
        drawn.add_bar(x=names, y=column, marker_color=style.BLUE, showlegend=False)
        if part == "position" and (column > 0).any():
            drawn.update_yaxes(style.log_axis(column[column > 0].min() / 2, column.max() * 1.5))
        drawn.update_xaxes(tickangle=-60)
        drawn.update_layout(bargap=0.25)
        charts.append(figure(f"index-{part}", drawn, f"Mean change of the {_TITLES[part]}."))
    yield pair(*charts[:2])
    yield pair(*charts[2:])
    for part, keys in found.unseen().items():
        if keys:
            yield words(f"Without effect on the {_TITLES[part]}: {', '.join(keys)}.", quiet=True)


def _sensitivity(found: Significance):
    """Change of the position by lengths (mm/mm) and angles (mm/mrad), sorted."""
    is_angle = np.array(["alpha" in key or "beta" in key or "theta" in key for key in found.keys])
    scale = np.where(is_angle, 1e-3, 1.0)
    values = found.sensitivity[:, 0] * scale
    order = np.argsort(values)
    drawn = style.figure(60 + 18 * len(order), "change of position (mm per mm, mm per mrad)")
    for name, chosen, colour in (
        ("length", ~is_angle, style.GREEN),
        ("angle", is_angle, style.BLUE),
    ):
        rows = [k for k in order if chosen[k]]
        drawn.add_bar(
            x=values[rows],
            y=[found.keys[k] for k in rows],
            orientation="h",
            name=name,
            marker_color=colour,
        )
    drawn.update_yaxes(categoryorder="array", categoryarray=[found.keys[k] for k in order])
    drawn.update_layout(bargap=0.25, margin_l=130)
    yield figure(
        "sensitivity",
        drawn,
        "Change of the position by a small error of each parameter: a tolerance budget.",
    )


def _table(found: Significance) -> dict:
    rows = [(key, *map(rounded, values)) for key, values in zip(found.keys, found.index)]
    return table(["parameter", "position (mm)", "x axis", "y axis", "z axis"], rows)
