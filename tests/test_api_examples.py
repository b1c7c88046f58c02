"""Every public name has an example in its docstring, which runs and gives what it says; so does the API page."""

import doctest
import inspect
import re
import sys

import numpy as np
import pytest

import workbench as wb
from conftest import ROOT
from test_corrected_models import SCENE, recorded
from workbench.api.answers import ANSWERS, SOURCES, TABLES
from workbench.api.examples import EXAMPLES
from workbench.api.functions import COMMANDS
from workbench.api.results import Result

sys.path.insert(0, str(ROOT / "tools"))

import api_stub

NAMES = [name for name in wb.__all__ if not name.startswith("__")]
SLOW = {"calibrate_large", "demo", "hand_eye", "prove", "render", "scan", "scanner", "stiffness"}
PAGE = ROOT / "docs" / "reference" / "api.md"
MODELS = PAGE.with_name("api-models.md")


def examples_of(name: str) -> doctest.DocTest:
    text = inspect.getdoc(getattr(wb, name)) or ""
    return doctest.DocTestParser().get_doctest(text, {"wb": wb, "np": np}, name, None, 0)


def results_of(values: dict) -> list[Result]:
    return [value for value in values.values() if isinstance(value, Result)]


def test_every_command_has_an_example_and_a_list_of_entries():
    assert set(EXAMPLES) == set(ANSWERS) == set(COMMANDS)
    assert set(SOURCES) <= set(COMMANDS)


def test_every_public_name_stands_once_on_the_pages_of_the_api():
    text = PAGE.read_text(encoding="utf-8") + MODELS.read_text(encoding="utf-8")
    assert sorted(re.findall(r"^::: workbench\.(\w+)$", text, re.MULTILINE)) == sorted(NAMES)


def test_the_stub_has_the_signatures_and_docstrings_of_the_functions():
    assert api_stub.STUB.read_text(encoding="utf-8") == api_stub.stub(), (
        "run python tools/api_stub.py"
    )


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_has_an_example(name):
    assert examples_of(name).examples, f"{name}: write an example into its docstring"


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in NAMES]
)
def test_the_example_of_a_docstring_gives_what_it_says(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = examples_of(name)
    said: list[str] = []
    runner = doctest.DocTestRunner(verbose=False)
    runner.run(found, out=said.append, clear_globs=False)
    assert runner.failures == 0, "".join(said)
    for result in results_of(found.globs):
        look_at(result, tmp_path / f"saved-{result.command}")
        if same_command(result.command, name):
            missing = set(ANSWERS[name]) - set(result.answer)
            assert not missing, f"{name}: the docstring names entries that the answer lacks"


def same_command(command: str, name: str) -> bool:
    other = {"hand_eye": "handeye", "import_data": "import", "datasets": "datasets list"}
    return command == other.get(name, name.replace("_", "-"))


def look_at(result: Result, place):
    """Summary, HTML, DataFrame and figure of a result; the same after it is saved and loaded."""
    assert result.summary() and "<pre>" in result._repr_html_()
    frame = result.to_frame()
    assert len(frame) or result.command == "diagnose"
    assert result.plot().data or result.plot().layout.images
    assert result.command not in TABLES or list(frame.columns) != ["name", "value"]
    loaded = wb.load(result.save(place))
    assert loaded.answer == result.answer and loaded.summary() == result.summary()


@pytest.mark.slow
def test_the_first_page_of_the_api_runs(tmp_path, monkeypatch):
    recording = recorded(
        tmp_path, SCENE
    )  # its diagnosis takes seconds, that of the example a minute
    monkeypatch.setattr(wb, "load_example", lambda name: recording)
    joints = np.rad2deg(recording.joints)
    lines = [
        ",".join([*(f"q{k}_deg" for k in range(1, joints.shape[1] + 1)), *recording.covariates])
    ]
    rows = np.column_stack([joints, *recording.covariates.values()])[:3]
    lines += [",".join(f"{value:.6f}" for value in row) for row in rows]
    (tmp_path / "targets.csv").write_text("\n".join(lines) + "\n")
    monkeypatch.chdir(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    names = {"q": joints, "p": recording.points, "t": np.full(recording.n, 21.0)}
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)[:2]
    assert len(blocks) == 2
    for block in blocks:
        exec(compile(block, "api page", "exec"), names)
    assert (tmp_path / "arm.urdf").exists() and (tmp_path / "my-run").is_dir()
