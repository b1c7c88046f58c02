"""The page of the commands in the documentation equals the one that is generated from the command line."""

import os
import re
import subprocess
import sys
from importlib import metadata
from importlib.util import find_spec

import pytest

from conftest import ROOT
from sensors.scanner.turntable import ANGLE_ERRORS, STEP_ERROR

PAGE = ROOT / "docs" / "reference" / "commands.md"
LOCK = ROOT / "requirements.lock"


def version_in_lock() -> str:
    """The version of typer whose generator wrote the page of the repository."""
    lines = LOCK.read_text(encoding="utf-8").splitlines()
    entry = next(line for line in lines if line.startswith("typer=="))
    return entry.split()[0].removeprefix("typer==")


def test_the_page_of_commands_is_that_of_the_command_line(tmp_path):
    if find_spec("typer.cli") is None:
        pytest.skip("typer has no module typer.cli, the generator of the page")
    if metadata.version("typer") != version_in_lock():
        pytest.skip("typer is not the version of requirements.lock, and pages differ by version")
    made = tmp_path / "commands.md"
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "commands_page.py"), str(made)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    is_current = made.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")
    assert is_current, "docs/reference/commands.md is not up to date; run `make docs` and commit it"


def test_the_list_of_effects_has_every_error_of_a_turntable():
    text = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    assert {error.name.partition(",")[0] for error in ANGLE_ERRORS} == {STEP_ERROR}
    for error in ANGLE_ERRORS:
        assert f"| `{error.name}` | `{error.law}` |" in text


def test_the_import_page_names_every_built_in_robot_and_boards_that_are_read():
    from workbench.recordings.importing.board_images.notation import board_keys

    page = (ROOT / "docs" / "how-to" / "import.md").read_text(encoding="utf-8")
    robots = sorted(path.stem for path in (ROOT / "robot_model" / "robots").glob("*.toml"))
    listed = re.search(r"Built-in robots: (.*?)\. The", page, re.DOTALL)[1]
    assert re.findall(r"`(\w+)`", listed) == robots
    boards = re.findall(r'^\| `"([^"]+)"` \|', page, re.MULTILINE)
    kinds = {(keys["kind"], keys.get("asymmetric", False)) for keys in map(board_keys, boards)}
    assert len(kinds) == len(boards) == 5


def test_the_summary_of_the_api_page_is_that_of_the_code():
    sys.path.insert(0, str(ROOT / "tools"))
    import api_summary

    text = api_summary.PAGE.read_text(encoding="utf-8")
    assert text == api_summary.page(text), "run python tools/api_summary.py and commit the page"
    assert "`wb.calibrate(recording=" in text and "Calibrate the arm of a recording" in text
