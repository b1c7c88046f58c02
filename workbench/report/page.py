"""Puts the sections together into one HTML file that asks for nothing from the network."""

from pathlib import Path

from workbench.report import errors as spread
from workbench.report import headline, history, parameters, provenance, residuals, scene, stages
from workbench.report.picture import write_picture
from workbench.runs import replace_file

PAGE, PICTURE = "report.html", "summary.png"


def write_report(calibration, folder: Path) -> Path:
    """Write `report.html`, and `summary.png` where it can be drawn, into an existing folder.

    calibration: a `workbench.calibrate.Calibration`. Returns the path of the page.
    Raises InputError where the folder cannot be written.
    """
    path = Path(folder) / PAGE
    replace_file(path, page(calibration))
    write_picture(calibration, spread.errors_of(calibration), path.with_name(PICTURE))
    return path


def page(calibration) -> str:
    """The HTML text of the report."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from plotly.offline import get_plotlyjs

    loader = PackageLoader("workbench", "report")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("page.html.j2").render(plotly=get_plotlyjs(), **sections(calibration))


def sections(calibration) -> dict[str, dict]:
    """What each section of the page shows, by its name in the template."""
    errors = spread.errors_of(calibration)
    return {
        "headline": headline.section(calibration, errors),
        "stages": stages.section(calibration),
        "spread": spread.section(calibration, errors),
        "parameters": parameters.section(calibration),
        "residuals": residuals.section(calibration, errors),
        "scene": scene.section(calibration, errors),
        "history": history.section(calibration),
        "provenance": provenance.section(calibration),
    }
