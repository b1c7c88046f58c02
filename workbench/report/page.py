"""Assembles the sections into one self-contained HTML file."""

from collections.abc import Callable, Sequence
from pathlib import Path

from workbench.files.runs import replace_file
from workbench.machine.progress import counted
from workbench.report import provenance
from workbench.report.calibration import errors as spread
from workbench.report.calibration import headline, history, parameters, residuals, scene, stages
from workbench.report.calibration.summary_image import write_summary
from workbench.report.sections import Page, Section

PAGE = "report.html"
IMAGE = "summary.png"
Progress = Callable[[str], None]


def silent(text: str) -> None:
    """Report no progress."""


def write_report(
    calibration,
    folder: Path,
    further_sections: Sequence[Section] = (),
    progress: Progress = silent,
    verdict: str = "",
) -> Path:
    """Write `report.html`, and `summary.png` if it can be drawn, into an existing folder.

    calibration: a `workbench.jobs.robot.calibrate.Calibration`; further_sections: placed before the provenance.
    progress: called with one line a step. verdict: the sentences that judge the held-out errors, "" for none.
    Returns the path of the page. Raises InputError if the folder is not writable.
    """
    path = Path(folder) / PAGE
    replace_file(path, page(calibration, further_sections, progress, verdict))
    progress("drawing the summary image")
    write_summary(calibration, spread.errors_of(calibration), path.with_name(IMAGE))
    return path


def write_sheet(report_page: Page, folder: Path) -> Path:
    """Write the page as `report.html` into an existing folder. Raises InputError if it is not writable."""
    path = Path(folder) / PAGE
    replace_file(path, _rendered("sheet.html.j2", page=report_page))
    return path


def page(
    calibration,
    further_sections: Sequence[Section] = (),
    progress: Progress = silent,
    verdict: str = "",
) -> str:
    """The HTML text of the report."""
    return _rendered(
        "page.html.j2", more=further_sections, **sections(calibration, progress, verdict)
    )


def _rendered(template: str, **values) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from plotly.offline import get_plotlyjs

    loader = PackageLoader("workbench", "report/templates")
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["marked"] = marked
    return environment.get_template(template).render(plotly=get_plotlyjs(), **values)


def marked(text: str):
    """Text for the page, in which words between backticks are set as code."""
    from markupsafe import Markup, escape

    pieces = str(text).split("`")
    if len(pieces) % 2 == 0:  # one of them has no counterpart
        return escape(text)
    codes = [Markup("<code>{}</code>").format(part) for part in pieces[1::2]]
    texts = [escape(part) for part in pieces[::2]]
    return texts[0] + Markup("").join(a + b for a, b in zip(codes, texts[1:]))


def sections(calibration, progress: Progress = silent, verdict: str = "") -> dict[str, dict]:
    """Content of each section, by its name in the template; progress: called with one line before each."""
    errors = spread.errors_of(calibration)
    rotation = spread.rotation_errors_of(calibration)
    builders = {
        "headline": lambda: headline.section(calibration, errors, rotation, verdict),
        "stages": lambda: stages.section(calibration),
        "spread": lambda: spread.section(calibration, errors, rotation),
        "parameters": lambda: parameters.section(calibration),
        "residuals": lambda: residuals.section(calibration, errors, rotation),
        "scene": lambda: scene.section(calibration, errors),
        "history": lambda: history.section(calibration),
        "provenance": lambda: provenance.section(calibration),
    }
    begin = counted(progress, len(builders))
    found = {}
    for name, section in builders.items():
        begin(f"writing the report: {name}")
        found[name] = section()
    return found
