"""The tutorials of docs/: every command in them runs, in order, and answers what the text says."""

import os
import re
import stat
import subprocess
import sys

import pytest

from conftest import ROOT

TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
SAID = {
    "arm-with-tracker": ("geometry", "compliance", "corrected"),
    "camera": ("px",),
    "hand-eye": ("flange",),
    "line-scanner": ("ball", "mm"),
}


def blocks(page) -> list[str]:
    """The `sh` blocks of a page."""
    return re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def test_every_tutorial_has_commands_and_an_expectation():
    assert {page.stem for page in TUTORIALS} == set(SAID)
    assert all(blocks(page) for page in TUTORIALS)


@pytest.fixture
def shell(tmp_path):
    """Runs a script in an empty folder where `workbench` is the command of this checkout."""
    command = tmp_path / "bin" / "workbench"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m workbench "$@"\n')
    command.chmod(command.stat().st_mode | stat.S_IXUSR)
    folder = tmp_path / "work"
    folder.mkdir()
    environment = {
        **os.environ,
        "PATH": f"{command.parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
    }

    def run(script: str) -> subprocess.CompletedProcess:
        return subprocess.run(
            ["bash", "-euo", "pipefail", "-c", script],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )

    return run


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_the_commands_of_a_tutorial_run(page, shell):
    output = ""
    for block in blocks(page):
        done = shell(block)
        assert done.returncode == 0, f"{block}\n{done.stdout}\n{done.stderr}"
        output += done.stdout
    for word in SAID[page.stem]:
        assert word in output, output
