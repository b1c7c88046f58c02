"""The page that a demonstration ends in: what came out of rendered images and of a table, and the way to each."""

from collections.abc import Mapping
from pathlib import Path

from workbench.report.sections import Page, Section, facts, image, links, words
from workbench.report.text import rounded


def page(folder: Path, rendered: Mapping | None, table: Mapping, why: str) -> Page:
    """The front page of a demonstration.

    folder: where the reports stand, each in a folder of its own; rendered, table: their answers.
    """
    numbers = [("table, held-out RMS", rounded(table["held_out"]["rms_mm"]), "mm")]
    parts = [_table(folder, table, why)]
    if rendered is not None:
        numbers = [
            ("from images, held-out RMS", rounded(rendered["held_out"]["rms_mm"]), "mm"),
            ("ball centres from the truth", rounded(rendered["against_truth"]["rms_mm"]), "mm"),
            *numbers,
        ]
        parts.insert(0, _images(folder, rendered))
    lead = ("Errors are 3-D distances in mm on samples that no step of the solve has seen.",)
    return Page(
        "Demonstration", "Two calibrations from end to end", tuple(numbers), lead, tuple(parts)
    )


def _images(folder: Path, rendered: Mapping) -> Section:
    """Rendered images, scanner, ball centres, arm."""
    sensor, told = rendered["sensor"], rendered["against_truth"]
    made, place = sensor["calibration"], Path(rendered["run"]).name
    form = next(
        (one["value"] for one in sensor["acceptance"] if one["name"] == "probing_rms"), None
    )
    lines = [
        (
            "images",
            f"{made['camera']['views']} of the board, {len(made['planes'])} light planes, "
            f"{len(sensor['scans'])} scans",
        ),
        ("camera", f"corners {rounded(made['camera']['rms_coordinate_px'])} px RMS a coordinate"),
        ("light planes", f"stripes {rounded(made['plane_rms_mm'])} mm RMS from their planes"),
        ("balls", f"form {rounded(form)} mm RMS, the worst ball"),
        (
            "ball centres",
            f"{rounded(told['rms_mm'])} mm RMS from the truth, {told['balls']} of them, after the one "
            "rigid "
            "motion that the frame of the camera is free by",
        ),
        (
            "arm",
            f"{rounded(rendered['held_out']['rms_mm'])} mm RMS held out, {rounded(rendered['nominal']['rms_mm'])} "
            "mm with "
            "the geometry of the data sheet",
        ),
    ]
    ways = [
        (f"{place}/report.html", "The report of this chain, sensor and arm"),
        (f"{place}/recording/images.csv", "The rendered recording"),
        (f"{place}/truth.json", "What it was rendered from"),
    ]
    return Section(
        "images",
        "From rendered images to the arm",
        (
            words(
                "No public set holds the whole chain, so its images are rendered: a board, the board under the laser, "
                "and scans of "
                "three balls from an arm whose geometry is not that of its data sheet. Nothing but these images, the "
                "readings of the "
                "joints and the certificate of the balls went into the result."
            ),
            facts(lines),
            *_drawn(folder / place),
            links(ways),
        ),
    )


def _table(folder: Path, table: Mapping, why: str) -> Section:
    """A table of an arm that was measured from outside."""
    place = Path(table["run"]).name
    lines = [
        ("recording", why),
        ("samples", f"{table['samples']:,}"),
        (
            "arm",
            f"{rounded(table['held_out']['rms_mm'])} mm RMS held out, {rounded(table['nominal']['rms_mm'])} "
            "mm with the "
            "geometry of the data sheet",
        ),
    ]
    return Section(
        "table",
        "From a table of measured points",
        (
            facts(lines),
            *_drawn(folder / place),
            links([(f"{place}/report.html", "The report of this calibration")]),
        ),
    )


def _drawn(place: Path):
    """The summary image where it was drawn."""
    path = place / "summary.png"
    return (
        (image(path, "Held-out errors stage by stage, their spread, and the residuals in space."),)
        if path.exists()
        else ()
    )
