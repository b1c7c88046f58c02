"""The page of `workbench register`: distance of every point after the rigid transform, and the residuals in space."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from workbench.jobs.robot.register import Registration
from workbench.report import style
from workbench.report.calibration.scene import arrow_scale
from workbench.report.sections import Page, Section, facts, figure, table
from workbench.report.text import rounded, sentence

_MOST_BARS = 60


def page(found: Registration, points: np.ndarray, labels: Sequence[str], answer: Mapping) -> Page:
    """The whole page. points: (n, 3) mm, in the frame of the source; labels: their n names."""
    numbers = (
        ("RMS distance", rounded(answer["rms_mm"]), "mm"),
        ("largest distance", rounded(answer["max_mm"]), "mm"),
        ("leave-one-out RMS distance", rounded(answer["left_one_out_rms_mm"]), "mm"),
    )
    outliers = answer["outliers"]
    outlier_sentence = (
        f"Much farther off than the other points: {', '.join(outliers)}." if outliers else ""
    )
    warning = " ".join([*map(sentence, answer["warnings"]), outlier_sentence]).strip()
    sections = (
        Section("points", "Points", tuple(_distances(found, labels))),
        Section("space", "Residuals in space", (_in_space(found, points, labels),)),
        Section("transform", "Rigid transform", (_transform(found),)),
        Section("provenance", "Provenance", (_source(answer),)),
    )
    title = f"{answer['source'].name} and {answer['target'].name}"
    return Page("Registration of points", title, numbers, (), sections, warning)


def _distances(found: Registration, labels: Sequence[str]) -> Iterator[dict]:
    """The distances, the largest first."""
    order = np.argsort(found.distances)[::-1][:_MOST_BARS]
    names = np.array([str(labels[k]) for k in order])
    is_outlier = np.isin(order, found.outliers())
    heights = found.distances[order]
    drawn = style.figure(320, "point", "distance (mm)")
    for name, chosen, colour in (
        ("all points fitted", ~is_outlier, style.BLUE),
        ("the same, outlier", is_outlier, style.ORANGE),
    ):
        if chosen.any():
            drawn.add_bar(x=names[chosen], y=heights[chosen], name=name, marker_color=colour)
    marker = dict(size=8, color="white", symbol="diamond", line=dict(width=1.5, color=style.VIOLET))
    drawn.add_scatter(
        x=names, y=found.left_out[order], mode="markers", name="leave-one-out", marker=marker
    )
    drawn.update_xaxes(type="category", categoryorder="array", categoryarray=names)
    drawn.update_layout(bargap=0.2)
    caption = "Distance of each point, the largest first."
    if len(found.distances) > _MOST_BARS:
        caption += f" The {_MOST_BARS} largest of {len(found.distances)} are drawn."
    yield figure("distances", drawn, caption)


def _in_space(found: Registration, points: np.ndarray, labels: Sequence[str]) -> dict:
    """Points in the target's frame, with enlarged residuals."""
    feet = found.matrix[:3, :3] @ points.T + found.matrix[:3, 3:]
    scale = arrow_scale(feet, found.residual.T)
    tips = feet + scale * found.residual.T
    gaps = np.full(len(points), np.nan)
    lines = [np.column_stack([a, b, gaps]).ravel() for a, b in zip(feet, tips)]
    drawn = style.figure(480)
    drawn.add_scatter3d(
        **dict(zip("xyz", feet)),
        mode="markers",
        name="points",
        text=list(map(str, labels)),
        marker=dict(size=4, color=style.BLUE),
    )
    drawn.add_scatter3d(
        **dict(zip("xyz", lines)),
        mode="lines",
        name=f"residual, enlarged {scale:,.0f} times",
        line=dict(width=4, color=style.ORANGE),
    )
    axes = {f"{axis}axis": dict(title=f"{axis} (mm)") for axis in "xyz"}
    drawn.update_layout(scene=axes)
    return figure(
        "space", drawn, "Transformed source points minus target points, in the target's frame."
    )


def _transform(found: Registration) -> dict:
    """The first three rows of T_target_source."""
    rows = [[axis, *(f"{value:.9g}" for value in row)] for axis, row in zip("xyz", found.matrix)]
    return table(["row", "x", "y", "z", "translation (mm)"], rows)


def _source(answer: Mapping) -> dict:
    return facts(
        [
            ("source", str(answer["source"])),
            ("target", str(answer["target"])),
            ("points", str(answer["points"])),
        ]
    )
