"""The state of the app without its page: what is opened, selected, drawn and edited, and background jobs."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app_diagnosis import write_diagnosis
from workbench.app.data.comparison import comparison_rows
from workbench.app.data.effect_titles import Units, change_sentence, effect_title
from workbench.app.data.opened import newest_diagnosis, open_subject
from workbench.app.data.plan import plan_sentence, stage_items
from workbench.app.data.residuals import updated_threshold
from workbench.app.edits.session import read_session
from workbench.app.figures import residuals
from workbench.app.workspace import EXTEND, REMOVE, Workspace
from workbench.core.errors import InputError


@pytest.fixture
def run(solved_arm):
    """A run of the bundled arm, which no test changes."""
    return solved_arm


@pytest.fixture
def work(run, tmp_path):
    return Workspace(open_subject(str(run)), tmp_path / "session" / "session.toml")


def test_a_run_is_opened_with_its_recording_and_residuals(work):
    opened = work.opened
    assert opened.command == "calibrate" and opened.subject == "elastic-arm"
    assert work.count == 300
    assert np.allclose(
        opened.residuals.lengths["fit"], np.linalg.norm(opened.residuals.vectors["fit"], axis=0)
    )
    lengths = np.sqrt((opened.residuals.arrows**2).sum(0))
    assert np.allclose(lengths, opened.residuals.shown, atol=1e-5)


def test_a_recording_alone_is_opened(tmp_path):
    work = Workspace(open_subject("elastic-arm"), tmp_path / "session.toml")
    assert work.opened.residuals is None and work.count == 300 and work.lengths().max() == 0


def test_without_a_name_the_newest_run_is_opened(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="expected a run"):
        open_subject(None)
    for name in ("20260101-000000-calibrate-a", "20260102-000000-calibrate-b"):
        (tmp_path / "runs" / name).mkdir(parents=True)
        text = (run / "answer.json").read_text(encoding="utf-8")
        (tmp_path / "runs" / name / "answer.json").write_text(text, encoding="utf-8")
    assert open_subject(None).folder.name == "20260102-000000-calibrate-b"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "cannot be read"),
        ("[]", "JSON object"),
        ("{}", "key input"),
        ('{"input": true}', "key input: .* found True"),
        ('{"input": "gone"}', "--recording"),
    ],
)
def test_broken_runs_are_refused(tmp_path, text, words):
    (tmp_path / "answer.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words):
        open_subject(str(tmp_path))


def test_residuals_of_another_recording_are_refused(run, tmp_path):
    opened = open_subject(str(run))
    few = opened.samples.select(np.arange(20))
    with pytest.raises(InputError, match="expected residuals of samples of"):
        _ = replace(opened, samples=few).rows


def test_selection_by_rows_boxes_lengths_and_numbers(work):
    work.select([3, 5])
    work.select([5, 7], EXTEND)
    work.select([3], REMOVE)
    assert work.selected_rows.tolist() == [5, 7]
    name = next(iter(work.quantities))
    x, y = work.quantities[name], work.lengths()
    work.select_box(name, (0, 30), (0.05, 9))
    assert set(work.selected_rows) == set(np.flatnonzero((x >= 0) & (x <= 30) & (y >= 0.05)))
    work.select_lengths(0.1, 1e9)
    assert set(work.selected_rows) == set(np.flatnonzero(y >= 0.1))
    work.select_sample(42)
    assert work.opened.edit_ids[work.selected_rows].tolist() == [42]


@pytest.mark.parametrize("rows", [[-1], [300], [1.5], ["1"]])
def test_rows_that_do_not_exist_are_refused(work, rows):
    with pytest.raises(InputError):
        work.select(rows)


def test_edits_need_a_selection(work):
    for edit in (work.exclude_selected, work.include_selected, work.exclude_poses):
        with pytest.raises(InputError, match="No sample is selected"):
            edit()


def test_every_edit_is_saved_and_undone(work):
    work.select([0, 1])
    work.exclude_selected()
    assert (~work.kept).sum() == 2
    count = work.exclude_above(0.1)
    assert count > 0 and (~work.kept).sum() == 2 + count
    assert read_session(work.path) == work.session and len(work.session.changes) == 2
    work.undo()
    work.undo()
    assert work.kept.all() and read_session(work.path).changes == ()
    work.redo()
    assert (~work.kept).sum() == 2


def test_a_threshold_above_all_residuals_is_refused(work):
    with pytest.raises(InputError, match="lower the threshold"):
        work.exclude_above(1e6)


def test_stages_and_effects_can_be_excluded(work):
    work.set_items("stages", ["compliance"], False)
    work.set_items("effects", ["joint-compliance at joint-2"], False)
    stages, effects = stage_items(work.opened, work.session)
    assert [(one["name"], one["on"]) for one in stages] == [
        ("geometry", True),
        ("compliance", False),
    ]
    assert effects == [{"name": "joint-compliance at joint-2", "on": False}]
    work.set_items("stages", ["compliance"], True)
    assert stage_items(work.opened, work.session)[0][1]["on"]


def test_a_stage_that_a_rerun_left_out_is_listed_and_can_be_included_again(work, run, tmp_path):
    shutil.copytree(run, tmp_path / "second")
    answer = json.loads((run / "answer.json").read_text(encoding="utf-8"))
    answer["stages"] = [row for row in answer["stages"] if row["name"] != "compliance"]
    (tmp_path / "second" / "answer.json").write_text(json.dumps(answer), encoding="utf-8")
    work.set_items("stages", ["compliance"], False)
    work.open_run(open_subject(str(tmp_path / "second")))

    def shown():
        rows = stage_items(work.opened, work.session, work.runs[:-1])[0]
        return [(row["name"], row["state"], row["on"]) for row in rows]

    assert shown() == [("geometry", "retained", True), ("compliance", "excluded", False)]
    work.undo()
    assert shown()[1] == ("compliance", "part of the next run", True)


def test_added_effects_leave_all_samples_in_use(work):
    work.add_effects(
        [{"effect": "zero-shift", "where": "joint-2", "after": 3104.3500000000004}], ""
    )
    assert work.kept.all() and work.counts(["fit"]).counts["fit"].sum() == 300
    sentence = change_sentence(work.session.changes[0], Units())
    assert sentence == "add 1 effect: zero-shift at joint-2 (after 3104.35 s)"


@pytest.mark.parametrize(
    ("label", "title"),
    [
        ("joint-compliance at joint-3", "joint-compliance at joint-3"),
        (
            "joint-curve at joint-3 (end=2.200065, start=-0.727365, terms=7)",
            "joint-curve at joint-3 (from -41.67 deg to 126.1 deg, 7 terms)",
        ),
        (
            "joint-curve at joint-7 (end=900.5, start=12, terms=3)",
            "joint-curve at joint-7 (from 12 mm to 900.5 mm, 3 terms)",
        ),
        ("joint-hysteresis at joint-1 (width=0.1)", "joint-hysteresis at joint-1 (width 5.73 deg)"),
        (
            "base-drift at base (end=900, order=3, start=0)",
            "base-drift at base (from 0 s to 900 s, order 3)",
        ),
        ("joint-coupling at joint-4 (joint=5)", "joint-coupling at joint-4 (from joint 5)"),
        ("reading-lag at time (law=braking)", "reading-lag at time (law braking)"),
    ],
)
def test_options_of_effects_are_words_with_units(label, title):
    assert effect_title(label, Units(frozenset({"joint-7"}))) == title


def test_units_are_those_of_the_recording(work):
    samples = work.opened.samples
    assert Units.of(samples) == Units(frozenset(), "s")
    columns = {f"q{k}_{unit}": np.zeros(2) for k, unit in enumerate(("deg", "mm"), 1)}
    assert Units.of(replace(samples, columns=columns)) == Units(frozenset({"joint-2"}), "rows")


def test_the_session_is_taken_up_again_when_the_run_is_opened_again(work, run):
    work.select([4])
    work.exclude_selected()
    again = Workspace(open_subject(str(run)), work.path)
    assert again.session == work.session and not again.kept[4]


def test_a_session_of_another_recording_is_refused(work, run):
    work.path.parent.mkdir()
    work.path.write_text('format = "session/1"\nrecording = "another"\n', encoding="utf-8")
    with pytest.raises(InputError, match="key recording"):
        Workspace(open_subject(str(run)), work.path)


def test_options_of_the_run_are_kept_for_its_rerun(work):
    assert work.session.folds == 3 and work.session.plan == ""


def test_files_of_a_run_are_named_by_whole_paths_for_a_rerun_in_another_folder(
    run, tmp_path, monkeypatch
):
    opened = open_subject(str(run))
    monkeypatch.chdir(tmp_path)
    answer = {**opened.answer, "options": {"plan": "plan.toml", "scanner": "scanner.toml"}}
    session = Workspace(replace(opened, answer=answer), tmp_path / "session.toml").session
    assert session.plan == str(tmp_path.resolve() / "plan.toml")
    assert session.scanner == str(tmp_path.resolve() / "scanner.toml")
    answer["options"] = {"plan": "ye-mdh"}
    session = Workspace(replace(opened, answer=answer), tmp_path / "other.toml").session
    assert session.plan == "ye-mdh"


def test_a_run_states_its_files_by_whole_paths(tmp_path, monkeypatch):
    from workbench.commands.robot.calibration_run import _stated_options

    monkeypatch.chdir(tmp_path)
    stated = _stated_options({"plan": Path("plan.toml")}, Path("scanner.toml"))
    assert stated["plan"] == str(tmp_path.resolve() / "plan.toml")
    assert stated["scanner"] == str(tmp_path.resolve() / "scanner.toml")
    assert _stated_options({"plan": Path("ye-mdh")}, None)["plan"] == "ye-mdh"


def test_effects_of_a_diagnosis_are_not_listed_and_the_plan_of_the_calibration_is_named(
    run, tmp_path
):
    folder = write_diagnosis(tmp_path / "diagnosis")
    (folder / "solution.json").write_bytes((run / "solution.json").read_bytes())
    work = Workspace(open_subject(str(folder)), tmp_path / "session.toml")
    assert stage_items(work.opened, work.session) == ([], [])
    assert "the default plan" in plan_sentence(work.session)
    work.add_effects([{"effect": "joint-compliance", "where": "joint-3"}], "")
    stages, effects = stage_items(work.opened, work.session)
    assert [(one["name"], one["on"]) for one in stages] == [("added effects", True)]
    assert effects == [{"name": "joint-compliance at joint-3", "on": True}]


@pytest.mark.parametrize("text", ["{}", "[]", "{", '{"effects": [3]}'])
def test_a_broken_solution_is_refused_with_a_sentence(run, tmp_path, text):
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / "solution.json").write_text(text, encoding="utf-8")
    work = Workspace(open_subject(str(folder)), tmp_path / "session.toml")
    with pytest.raises(InputError, match="solution.json"):
        stage_items(work.opened, work.session)


@pytest.mark.parametrize("text", ["garbage\n1\n", "sample,x\n1,2\n", ""])
def test_a_broken_table_of_residuals_is_refused_with_a_sentence(run, tmp_path, text):
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / "residuals.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="residuals.csv"):
        Workspace(open_subject(str(folder)), tmp_path / "session.toml")


def test_before_and_after_compares_the_last_two_runs(work, run):
    assert work.comparison() == []
    work.open_run(open_subject(str(run)))
    rows = {row["name"]: (row["before"], row["after"]) for row in work.comparison()}
    assert rows["samples"] == ("300", "300")
    assert set(rows) == {"samples", "RMS of the fit (mm)", "held-out RMS (mm)"}


def test_before_and_after_of_other_samples_state_the_error_of_those_in_both(work, run):
    before = work.opened
    found = before.residuals
    keep = np.argsort(found.lengths["held_out"])[:250]
    smaller = replace(
        found,
        sample=found.sample[keep],
        vectors={kind: values[:, keep] for kind, values in found.vectors.items()},
    )
    after = open_subject(str(run))
    after.__dict__["residuals"] = smaller
    rows = comparison_rows(before, after, "calibrate")
    assert rows[-1]["name"] == "held-out RMS of the 250 samples in both runs (mm)"
    expected = np.sqrt(np.mean(found.lengths["held_out"][keep] ** 2))
    assert rows[-1]["before"] == rows[-1]["after"] == f"{expected:.4g}"
    assert expected < np.sqrt(np.mean(found.lengths["held_out"] ** 2))


def test_the_newest_diagnosis_of_the_same_data_is_found(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    opened = open_subject(str(run))
    same = opened.answer["provenance"]["data_sha256"]
    names = ("a-diagnose-1", "b-diagnose-2", "arm-session/diagnose-1", "c-diagnose-other")
    for second, (name, data) in enumerate(zip(names, (same, same, same, "other"))):
        folder = write_diagnosis(tmp_path / "runs" / name)
        path = folder / "answer.json"
        answer = json.loads(path.read_text(encoding="utf-8"))
        answer["provenance"] = {"data_sha256": data}
        path.write_text(json.dumps(answer), encoding="utf-8")
        os.utime(path, (1000 + second, 1000 + second))
    work = Workspace(opened, tmp_path / "session.toml")
    work.look_for_diagnosis()
    assert work.diagnosis.folder == tmp_path / "runs" / "arm-session" / "diagnose-1"
    assert work.diagnosis.recording is opened.recording
    (tmp_path / "runs" / "arm-session" / "diagnose-1" / "answer.json").write_text("{")
    assert newest_diagnosis(opened).folder.name == "b-diagnose-2"
    without = replace(opened, answer={**opened.answer, "provenance": {}})
    assert newest_diagnosis(without) is None


def test_a_calibration_after_a_diagnosis_is_compared_with_its_baseline(run, tmp_path):
    opened = open_subject(str(write_diagnosis(tmp_path / "diagnosis")))
    work = Workspace(opened, tmp_path / "session.toml")
    work.open_run(open_subject(str(run)))
    rows = {row["name"]: row for row in work.comparison()}
    assert rows["held-out RMS (mm)"]["before"] == "0.117"
    before = next(one for one in residuals.comparison(work).data if one.name == "before")
    assert before.x[-1] == opened.residuals.lengths["before"].max()
    assert not residuals.has_side_by_side(work)


def test_a_threshold_follows_the_largest_residual_unless_it_was_chosen():
    assert updated_threshold(0.8, 0.8, 0.9) == 0.9
    assert updated_threshold(0.5, 0.8, 0.9) == 0.5
    assert updated_threshold(0.5, 0.8, 0.3) == 0.3
    assert updated_threshold(0.0, 1.0, 0.8) == 0.8
