"""Front page of the demonstration: results from rendered images and from a table, with links to both reports."""

from collections.abc import Mapping
from pathlib import Path

from workbench.report.sections import Page, Section, facts, image, links, words
from workbench.report.text import counted, rounded


def page(folder: Path, rendered: Mapping | None, table: Mapping, why: str) -> Page:
    """The front page of a demonstration.

    folder: holds one subfolder per report; rendered, table: answers of the two calibrations.
    """
    numbers = [("from a tracker table, held-out RMS", rounded(table["held_out"]["rms_mm"]), "mm")]
    sections = [_table(folder, table, why)]
    if rendered is not None:
        numbers = [
            ("from images, held-out RMS", rounded(rendered["held_out"]["rms_mm"]), "mm"),
            ("ball centres from the truth", rounded(rendered["against_truth"]["rms_mm"]), "mm"),
            *numbers,
        ]
        sections.insert(0, _images(folder, rendered))
    lead = ("Errors are 3-D distances in mm on held-out samples.",)
    return Page(
        "Demonstration", "Two calibrations from end to end", tuple(numbers), lead, tuple(sections)
    )


def _images(folder: Path, rendered: Mapping) -> Section:
    """Section on the chain rendered images, scanner, ball centres, arm."""
    place = Path(rendered["run"]).name
    addresses = [
        (f"{place}/report.html", "The report of this chain, sensor and arm"),
        (f"{place}/recording/images.csv", "The rendered recording"),
        (f"{place}/truth.json", "The ground truth of the rendering"),
    ]
    return Section(
        "images",
        "From rendered images to the arm",
        (
            words(
                "No public data set covers the whole chain, so the images are rendered: a board, the board under "
                "the laser, and scans of three balls. The geometry of the arm deviates from its data sheet. The "
                "calibration uses only these images, the joint readings and the certificate of the balls."
            ),
            facts(_chain_figures(rendered)),
            *_drawn(folder / place),
            links(addresses),
        ),
    )


def _chain_figures(rendered: Mapping) -> list[tuple[str, str]]:
    """(what, figure in words) of each step of the chain, from the images to the arm."""
    sensor = rendered["sensor"]
    centre_errors = rendered["against_truth"]
    calibration = sensor["calibration"]
    acceptance = {row["name"]: row["value"] for row in sensor["acceptance"]}
    form = acceptance.get("probing_rms")
    return [
        (
            "images",
            f"{calibration['camera']['views']} of the board, {counted(len(calibration['planes']), 'light plane')}, "
            f"{counted(len(sensor['scans']), 'scan')}",
        ),
        (
            "camera",
            f"corners {rounded(calibration['camera']['rms_coordinate_px'])} px RMS per coordinate",
        ),
        (
            "light planes",
            f"stripe points {rounded(calibration['plane_rms_mm'])} mm RMS from their planes",
        ),
        ("balls", f"form error {rounded(form)} mm RMS, worst ball"),
        (
            "ball centres",
            f"{rounded(centre_errors['rms_mm'])} mm RMS error of {centre_errors['balls']} centres "
            "against the truth, after rigid alignment",
        ),
        (
            "arm",
            f"{rounded(rendered['held_out']['rms_mm'])} mm RMS held out, "
            f"{rounded(rendered['nominal']['rms_mm'])} mm with the nominal geometry",
        ),
    ]


def _arm_errors(held_out: Mapping, nominal: Mapping) -> str:
    return (
        f"{rounded(held_out['rms_mm'])} mm RMS held out, "
        f"{rounded(nominal['rms_mm'])} mm with the nominal geometry"
    )


def _table(folder: Path, table: Mapping, why: str) -> Section:
    """Section on a table of points of an arm, measured by an external instrument."""
    place = Path(table["run"]).name
    lines = [
        ("recording", why),
        ("samples", f"{table['samples']:,}"),
        ("arm", _arm_errors(table["held_out"], table["nominal"])),
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
    """The summary image, if it exists."""
    path = place / "summary.png"
    if not path.exists():
        return ()
    caption = "Held-out errors stage by stage, their distribution, and the residuals in space."
    return (image(path, caption),)
