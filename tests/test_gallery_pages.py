"""Pages of the gallery are not stale: what takes minutes is computed again and compared.

The slow tests compute single rows; the long tests compute every page.
"""

import os
import shutil
import subprocess
import sys

import pytest

from conftest import ROOT, mostly_slow, recordings_folder

sys.path.insert(0, str(ROOT / "tools"))

from gallery import PAGES
from tutorial_output import text_difference

GALLERY = ROOT / "docs" / "gallery"
LONG = [pytest.mark.long, pytest.mark.timeout(4 * 3600)]
COMPUTED = (
    pytest.param("laser-spot", "laser-spot", marks=LONG),
    pytest.param("partial-pose", "partial-pose", marks=LONG),
    pytest.param("touch-point", "touch-point", marks=LONG),
    pytest.param("poses-and-compensation", "poses-and-compensation", marks=LONG),
    pytest.param("rendered-scanner", "rendered-scanner", marks=LONG),
    pytest.param("unified", "unified-kinematic-compliance", marks=LONG),
)
"""Names for `tools/gallery.py` and of the pages: two of a minute of processor time, and others of up to an hour."""


def test_every_page_of_the_gallery_is_computed_by_a_test():
    assert {one.values[0] for one in COMPUTED} == set(PAGES)
    assert {one.values[1] for one in COMPUTED} == {page.stem for page in GALLERY.glob("*.md")}


@pytest.mark.parametrize(("name", "stem"), COMPUTED)
def test_a_page_says_what_is_computed_now(name, stem, tmp_path, real):
    if name == "unified":
        real("irb120_faro")
    for part in ("tools", "docs"):
        shutil.copytree(ROOT / part, tmp_path / part, ignore=shutil.ignore_patterns(".parts"))
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    page = tmp_path / "docs" / "gallery" / f"{stem}.md"
    before = page.read_text(encoding="utf-8")
    page.unlink()
    places = {"PYTHONPATH": str(ROOT), "WORKBENCH_RECORDINGS": str(recordings_folder())}
    environment = {**os.environ, **places}
    words = [sys.executable, str(tmp_path / "tools" / "gallery.py"), name]
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = text_difference(before, page.read_text(encoding="utf-8"))
    assert found is None, f"{found}; run `python tools/gallery.py {name}`"


def printed_row(stem: str, start: str) -> str:
    """The line of a page that begins so."""
    lines = (GALLERY / f"{stem}.md").read_text(encoding="utf-8").splitlines()
    (row,) = [line for line in lines if line.startswith(start)]
    return row


@pytest.mark.parametrize(
    "effect", mostly_slow(["mirror-encoder-harmonic", "none", "camera-thermal-drift"], 0, 1)
)
def test_rows_of_the_rendered_scanner_are_what_is_computed_now(effect):
    import gallery_rendered_scanner as figures
    import gallery_rendered_scanner_page as text

    row = text.effect_row(effect, figures.parts()[effect]())
    found = text_difference(printed_row("rendered-scanner", f"| {effect} |"), row)
    assert found is None, f"{found}; run `python tools/gallery.py rendered-scanner`"


@pytest.mark.slow
def test_the_statistics_of_the_ye_page_are_what_is_computed_now(tmp_path):
    """The first experiment: joint-space spread, and RMS, Std, Avg and Max of the four models."""
    pytest.importorskip("mujoco", reason="MuJoCo makes the recordings")
    import gallery_ye as figures
    import gallery_ye_sections as sections

    made = {1: figures.ye.ye_first_experiment(200, 1, figures.NOISE[1]).recording()}
    computed = [
        *sections.spread(made).splitlines()[2:],
        *sections.statistics(sections.held_out_errors(made)).splitlines()[2:],
    ]
    assert len(computed) == 5
    for row in computed:
        start = "|".join(row.split("|")[:3]) + "|"
        found = text_difference(printed_row("unified-kinematic-compliance", start), row)
        assert found is None, f"{found}; run `python tools/gallery.py unified`"
