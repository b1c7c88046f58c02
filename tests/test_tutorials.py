"""The tutorials of docs/: every command and all code run, in order, and print what the page prints."""

import sys

import pytest

from conftest import ROOT

sys.path.insert(0, str(ROOT / "tools"))

from tutorial_output import TUTORIALS, blocks, difference, run, shortened

PAGES = sorted(TUTORIALS.glob("*.md"))


def test_every_tutorial_prints_outputs():
    assert {page.stem for page in PAGES} == {
        "arm-with-tracker",
        "camera",
        "hand-eye",
        "line-scanner",
    }
    for page in PAGES:
        printed = [block.printed for block in blocks(page) if block.printed]
        assert len(printed) >= 3 and any("Verdict" in text for text in printed), page.stem


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_tutorial_prints_what_its_page_says(page, tmp_path):
    folder = tmp_path / "work"
    folder.mkdir()
    for block in blocks(page):
        found = difference(block.printed, run(block, folder))
        assert found is None, (
            f"{block.code}{found}; run `python tools/tutorial_output.py {page.stem}`"
        )


@pytest.mark.parametrize(
    ("printed", "output"),
    [
        ("error 0.0535 mm", "error  0.0537\nmm"),
        ("rms 0.12 ─────", "rms 0.14 ───"),
        ("p 5.2e-09", "p 7.3e-09"),
        ("8317 stripe points", "8320 stripe points"),
        ("300 samples, arm/report.html", "300 samples, arm/report.html"),
    ],
)
def test_outputs_that_agree(printed, output):
    assert difference(printed, output) is None


@pytest.mark.parametrize(
    ("printed", "output"),
    [
        ("error 0.0535 mm", "error 0.0635 mm"),
        ("error 2.27 mm", "error 2.27 deg"),
        ("30 samples", "31 samples"),
        ("rms 0.12", "rms -0.12"),
        ("p 5.2e-05", "p 5.2e-04"),
        ("drift 0.05", "drift 0.05 not retained"),
        ("Stages", ""),
    ],
)
def test_outputs_that_differ(printed, output):
    assert difference(printed, output) is not None


def test_a_long_output_keeps_its_beginning_and_its_verdict():
    lines = [f"line {k}" for k in range(60)] + ["Verdict: good", "run/report.html"]
    kept = shortened("\n".join(lines)).splitlines()
    assert kept == [*lines[:24], "...", "Verdict: good", "run/report.html"]
    assert shortened("\n".join(kept)).splitlines() == kept
