"""A session with every kind of edit, repeated from the command line on the rendered scanner."""

import json

import pytest

import app_browser
from workbench.app.data.opened import open_subject
from workbench.app.edits.session import Session
from workbench.app.workspace import Workspace

pytestmark = pytest.mark.slow

_PLAN = (
    app_browser.FRAMES
    + """
[[stage]]
name = "zeros"
why = "zero offsets of the encoders"
free = ["joint-*.theta*"]
[[stage]]
name = "compliance"
why = "joints deflect under gravity"
effects = [{ effect = "joint-compliance", where = "joint-2" }, { effect = "joint-compliance", where = "joint-3" }]
"""
)
_HARMONIC = {"effect": "transmission-harmonic", "where": "joint-1", "order": 1}
_FILES = ("residuals.csv", "parameters.toml", "residual-arrows.parquet", "scanner.toml")


@pytest.fixture
def edited(scanner_run, tmp_path):
    """A workspace with excluded samples, poses, images, stages and effects, an added one, a threshold and an undo."""
    (tmp_path / "plan.toml").write_text(_PLAN, encoding="utf-8")
    opened = open_subject(str(scanner_run))
    plan = str(tmp_path / "plan.toml")
    Session(opened.subject, plan, folds=3).save(tmp_path / "session.toml")
    work = Workspace(opened, tmp_path / "session.toml")
    work.select([3, 8])
    work.exclude_selected()
    work.select([11])
    work.exclude_poses()
    work.set_image(_place_of(work, "board-003.png"), False)
    work.set_items("stages", ["zeros"], False)
    work.set_items("effects", ["joint-compliance at joint-3"], False)
    work.add_effects([_HARMONIC], "ticked in the diagnosis")
    assert work.exclude_above(0.8) == 2
    work.set_image(_place_of(work, "board-002.png"), False)
    work.undo()
    return work


def _place_of(work: Workspace, name: str) -> int:
    """Place of an image in images.csv."""
    names = [row["image"] for row in work.opened.recording.images]
    return names.index(f"images/{name}")


def _without_date(path) -> list[str]:
    """Lines of a file without the time at which it was written."""
    lines = path.read_bytes().splitlines()
    return [line for line in lines if not line.startswith(b"date = ")]


def _answer(folder) -> dict:
    """What a run says, without its name, its place and the times at which it was made."""
    text = (folder / "answer.json").read_text(encoding="utf-8")
    here = json.dumps(str(folder))[1:-1]
    answer = json.loads(text.replace(here, "RUN"), object_hook=_undated)
    answer.pop("run")
    return answer


def _undated(keys: dict) -> dict:
    """An object of JSON; that of a provenance without its date."""
    return {key: value for key, value in keys.items() if key != "date" or "workbench" not in keys}


def test_every_kind_of_edit_is_repeated_from_the_command_line(edited, tmp_path):
    job = edited.start()
    assert job.wait(400) == "done", list(job.lines)
    words = ["--session", edited.path, "--out", tmp_path / "again", "--no-report"]
    app_browser.run_workbench("calibrate", *words, cwd=tmp_path)
    for name in _FILES:
        assert _without_date(job.out / name) == _without_date(tmp_path / "again" / name), name
    first, again = _answer(job.out), _answer(tmp_path / "again")
    assert first == again
    assert first["samples"] == 30 - 5  # two by number, one by pose, two above the threshold
    assert "zeros" not in [stage["name"] for stage in first["stages"]]
    before = _answer(edited.opened.folder)["sensor"]["calibration"]
    assert first["sensor"]["calibration"]["camera"] != before["camera"]  # without an image
    edited.finish()
    assert edited.count == 25 and edited.previous.samples.n == 30
