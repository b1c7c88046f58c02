"""Every example in the docstrings of the Python API runs and gives what it says; so does the first page."""

import doctest
import inspect
import re

import numpy as np
import pytest

import workbench as wb
from conftest import ROOT
from workbench.api.examples import EXAMPLES
from workbench.api.functions import COMMANDS


def examples_of(name: str) -> doctest.DocTest:
    text = inspect.getdoc(getattr(wb, name)) or ""
    return doctest.DocTestParser().get_doctest(text, {"wb": wb, "np": np}, name, None, 0)


def test_examples_are_of_functions_and_stand_in_their_docstrings():
    assert set(EXAMPLES) <= set(COMMANDS)
    assert {name for name in wb.__all__ if examples_of(name).examples} >= set(EXAMPLES)


@pytest.mark.parametrize("name", [name for name in wb.__all__ if not name.startswith("__")])
def test_the_example_of_a_docstring_gives_what_it_says(name, tmp_path, monkeypatch):
    found = examples_of(name)
    if not found.examples:
        pytest.skip("no example")
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    runner = doctest.DocTestRunner(verbose=False)
    runner.run(found, out=said.append)
    assert runner.failures == 0, "".join(said)


@pytest.mark.slow
def test_the_first_page_of_the_api_runs(tmp_path, monkeypatch):
    recording = wb.load_example("elastic-arm")
    joints = np.rad2deg(recording.joints)
    lines = [
        ",".join([*(f"q{k}_deg" for k in range(1, joints.shape[1] + 1)), *recording.covariates])
    ]
    rows = np.column_stack([joints, *recording.covariates.values()])[:3]
    lines += [",".join(f"{value:.6f}" for value in row) for row in rows]
    (tmp_path / "targets.csv").write_text("\n".join(lines) + "\n")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "tools" / "api_page.py").read_text(encoding="utf-8")
    names = {"q": joints, "p": recording.points, "t": np.full(recording.n, 21.0)}
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)[:2]
    assert len(blocks) == 2
    for block in blocks:
        exec(compile(block, "api page", "exec"), names)
    assert (tmp_path / "arm.urdf").exists() and (tmp_path / "my-run").is_dir()
