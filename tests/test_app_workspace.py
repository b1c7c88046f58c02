"""The state of the app without its page: what is opened, selected, drawn and edited, and background jobs."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import datasets
from app_diagnosis import diagnosis_answer, image_diagnosis_answer, write_diagnosis
from workbench.app.data import decimate, diagnosis
from workbench.app.data.arm import arm_pose, joint_coverage
from workbench.app.data.opened import open_subject
from workbench.app.data.plan import plan_sentence, stage_items
from workbench.app.data.residuals import updated_threshold
from workbench.app.edits.session import read_session
from workbench.app.figures import diagnosis as diagnosis_figures
from workbench.app.figures import residuals, robot
from workbench.app.jobs import CANCELLED, DONE, FAILED, Job
from workbench.app.workspace import EXTEND, REMOVE, Workspace
from workbench.core.errors import InputError
from workbench.core.solution import Stage
from workbench.report.text import p_value

STAGES = (
    Stage("geometry", "lengths", free=("base.*", "sensor.*", "joint-*.theta*"), earn=False),
    Stage("compliance", "joints deflect", (("joint-compliance", "joint-2", {}),)),
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder of the bundled arm, as `workbench calibrate` writes it."""
    from workbench.commands.robot.calibration_run import solve_into

    folder = tmp_path_factory.mktemp("run")
    options = {"plan": STAGES, "folds": 3}
    solve_into(
        folder,
        folder,
        datasets.read("elastic-arm"),
        "elastic-arm",
        options,
        lambda text: None,
        False,
    )
    return folder


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
    assert "after=3104.35)" in work.session.changes[0].sentence


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


def test_a_calibration_after_a_diagnosis_is_compared_with_its_baseline(run, tmp_path):
    opened = open_subject(str(write_diagnosis(tmp_path / "diagnosis")))
    work = Workspace(opened, tmp_path / "session.toml")
    work.open_run(open_subject(str(run)))
    rows = {row["name"]: row for row in work.comparison()}
    assert rows["held-out RMS (mm)"]["before"] == "0.117"
    before = next(one for one in residuals.comparison(work).data if one.name == "before")
    assert before.x[-1] == opened.residuals.lengths["before"].max()
    assert not residuals.has_side_by_side(work)


def test_figures_hold_every_row_of_a_small_run(work):
    arrows = residuals.arrows(work)
    marks = next(one for one in arrows.data if one.name == "measured points")
    assert list(marks.customdata) == list(range(300))
    chart = residuals.chart(work, next(iter(work.quantities)), "")
    assert (
        sum(len(one.x) for one in chart.data if one.name in ("samples", "excluded", "selected"))
        == 300
    )
    counts = {one.name: sum(one.y) for one in residuals.histogram_figure(work).data}
    assert counts["fit"] == counts["held out"] == 300


def test_excluded_samples_are_marked_and_not_counted(work):
    work.select(range(10))
    work.exclude_selected()
    chart = residuals.chart(work, next(iter(work.quantities)), "")
    assert sorted(next(one for one in chart.data if one.name == "excluded").customdata) == list(
        range(10)
    )
    assert sum(residuals.histogram_figure(work).data[0].y) == 290


def test_the_arm_ends_at_the_flange_and_looks_at_the_measured_ball(work):
    for row in (0, 17):
        pose = arm_pose(work.opened, row)
        assert np.allclose(pose.links[:, -1], pose.flange[:3, 3])
        point = pose.sensor[:3, :3] @ work.opened.samples.points[row] + pose.sensor[:3, 3]
        # The nominal arm and the fitted hand-eye put it there up to the arm's own errors.
        assert np.linalg.norm(point - work.opened.residuals.points[:, row]) < 20


def test_the_scene_shows_arm_sensor_and_artefact(work):
    names = {one.name for one in robot.scene(work).data}
    assert {"arm at the current sample", "field of the sensor", "balls of the artefact"} <= names


def test_coverage_counts_every_reading(work):
    rows = joint_coverage(work.opened)
    assert [row["counts"].sum() for row in rows] == [300] * 6
    assert all(row["limits"][0] <= row["low"] <= row["high"] <= row["limits"][1] for row in rows)


def test_decimation_keeps_the_largest_and_the_selected():
    values = np.random.default_rng(1).random(100_000)
    drawn = decimate.thinned(len(values), 1000, values, always=[7, 11])
    assert len(drawn) <= 1100 and {7, 11} <= set(drawn)
    assert set(np.argsort(values)[-500:]) <= set(drawn)
    assert decimate.thinned(50, 1000).tolist() == list(range(50))


def test_histograms_count_all_samples_whatever_is_drawn():
    values = {"fit": np.random.default_rng(2).random(10_000), "held_out": np.full(10_000, np.nan)}
    counted = decimate.histogram(values)
    assert counted.counts["fit"].sum() == 10_000 and counted.counts["held_out"].sum() == 0


def test_bin_means_are_those_of_all_samples():
    x = np.repeat(np.arange(4.0), 100)
    y = x**2
    centres, means = decimate.bin_means(x, y)
    assert np.allclose(means, centres**2)
    assert decimate.bin_means(np.full(5, np.nan), np.ones(5))[0].size == 0


def test_a_rectangle_holds_its_edges_in_any_order():
    x = y = np.arange(5.0)
    assert decimate.within(x, y, (3, 1), (1, 9)).tolist() == [False, True, True, True, False]


def test_places_of_a_diagnosis_carry_share_and_findings():
    found = {place.name: place for place in diagnosis.places(diagnosis_answer(), 6)}
    assert found["joint-2"].share == 0.59 and found["joint-5"].share == 0  # p = 0.4 may be chance
    assert [row["decision"] for row in diagnosis.candidates(found["joint-2"])] == [
        "kept",
        "alternative",
    ]
    assert diagnosis.candidates(found["joint-5"])[0]["why"] == "the held-out error does not fall"
    values = dict(diagnosis.evidence(found["joint-2"].found[0]))
    assert (
        values["p-value"] == "< 1e-6" and values["permutation control"] == "passed (p-value 0.0050)"
    )
    assert values["compliance"] == "20.00 ± 0.40 µrad/(N m)"  # as on the report page


def test_ticked_terms_become_effects_of_a_plan_that_calibrate_reads(tmp_path):
    from workbench.fitting.plans import read_plan

    rows = diagnosis.plan_effects(diagnosis_answer(), [0, 1, 1, 99])
    assert rows == [
        {"effect": "joint-compliance", "where": "joint-2"},
        {"effect": "backlash", "where": "joint-5"},
    ]
    diagnosis.write_plan(rows, tmp_path / "plan.toml")
    stages = read_plan(tmp_path / "plan.toml")
    assert stages[-1].effects == (("joint-compliance", "joint-2", {}), ("backlash", "joint-5", {}))


def test_terms_that_no_plan_can_hold_are_named():
    answer = image_diagnosis_answer(Path("recording"))
    assert "effects of the arm only" in diagnosis.plan_problem(answer["effects"][0])
    assert diagnosis.plan_effects(answer, [0]) == []
    assert diagnosis.plan_problem(diagnosis_answer()["effects"][0]) == ""


def test_a_diagnosis_run_is_opened_with_its_views(tmp_path):
    work = Workspace(
        open_subject(str(write_diagnosis(tmp_path / "run"))), tmp_path / "session.toml"
    )
    made = diagnosis_figures.before_after(work.diagnosis, "time_s")
    assert {one.name for one in made.data} == {"before", "after", "mean before", "mean after"}
    poses = diagnosis.next_poses(work.diagnosis.folder, work.diagnosis.robot)
    arms, flanges = diagnosis_figures.next_poses(work.diagnosis, poses).data
    assert arms.name == "2 poses to measure"
    assert list(flanges.text) == ["<b>1</b>", "<b>2</b>"]
    assert "joint 2 (deg): 20.00<br>joint 3 (deg): -10.00" in flanges.customdata[0]


def test_residuals_of_a_diagnosis_have_places_and_held_out_lengths(run, tmp_path):
    folder = write_diagnosis(tmp_path / "run")
    shutil.copy(run / "solution.json", folder)
    found, calibrated = (open_subject(str(one)).residuals for one in (folder, run))
    assert np.allclose(found.points, calibrated.points, atol=1e-6)
    lengths = np.linalg.norm(found.arrows, axis=0)
    assert np.allclose(lengths, found.lengths["after"])
    later = Workspace(open_subject(str(folder)), tmp_path / "later" / "session.toml")
    later.open_run(open_subject(str(run)))
    assert not residuals.has_side_by_side(
        later
    )  # the arrows after a diagnosis are not those before
    made = residuals.histogram_figure(
        Workspace(open_subject(str(folder)), tmp_path / "session.toml")
    )
    assert [one.name for one in made.data] == ["before, held out", "after, held out", "bins"]
    assert sum(made.data[1].y) == 300 and found.lengths["held_out_after"].min() >= 0.1


def test_a_threshold_follows_the_largest_residual_unless_it_was_chosen():
    assert updated_threshold(0.8, 0.8, 0.9) == 0.9
    assert updated_threshold(0.5, 0.8, 0.9) == 0.5
    assert updated_threshold(0.5, 0.8, 0.3) == 0.3
    assert updated_threshold(0.0, 1.0, 0.8) == 0.8


def test_poses_of_the_next_experiment_are_a_table_with_numbers_and_units(tmp_path):
    folder = write_diagnosis(tmp_path / "run")
    poses = diagnosis.next_poses(folder, open_subject("elastic-arm").robot)
    assert poses.rows[1] == {
        "number": 2,
        "readings": ["-30.00", "10.00", "-20.00", "15.00", "-70.00", "40.00"],
    }
    lines = poses.as_csv.splitlines()
    assert lines[0].startswith("pose,joint 1 (deg),") and lines[2] == "2,-30,10,-20,15,-70,40"
    table = folder / diagnosis.NEXT_POSES
    table.write_text("joint 1,joint 2\n10,a\n", encoding="utf-8")
    with pytest.raises(InputError, match="diagnose again"):
        diagnosis.next_poses(folder, None)
    table.write_text("joint 1\n", encoding="utf-8")
    assert diagnosis.next_poses(folder, None) is None


def test_p_values_below_a_millionth_are_not_written_out():
    assert p_value(9e-159) == p_value(0.0) == "< 1e-6"
    assert p_value(0.0123) == "0.012"
    assert p_value(None) == p_value(float("nan")) == "–"


@pytest.fixture
def project(monkeypatch):
    """Processes that a job starts find this checkout."""
    root = str(Path(__file__).resolve().parent.parent)
    monkeypatch.setenv("PYTHONPATH", root)


def test_a_job_that_fails_says_why(tmp_path, project):
    job = Job(["calibrate", "no-such-recording"], tmp_path / "out", tmp_path)
    assert job.wait(120) == FAILED
    assert "no-such-recording" in job.last_line and not (tmp_path / "out").exists()


def test_a_job_reports_its_progress_and_ends(tmp_path, project):
    (tmp_path / "plan.toml").write_text(
        '[[stage]]\nname = "g"\nwhy = "w"\nfree = ["base.*", "sensor.*"]\n'
    )
    words = ["calibrate", "elastic-arm", "--plan", "plan.toml", "--folds", "2", "--no-report"]
    job = Job(words, tmp_path / "out", tmp_path)
    assert job.wait(300) == DONE
    assert job.lines[0] == "reading elastic-arm" and any("stage g" in line for line in job.lines)
    assert json.loads((tmp_path / "out" / "answer.json").read_text())["command"] == "calibrate"


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
def test_a_cancelled_job_leaves_nothing(tmp_path, project):
    job = Job(["calibrate", "elastic-arm", "--no-report"], tmp_path / "out", tmp_path)
    while not any("stage" in line for line in list(job.lines)) and job.state == "running":
        job._process.poll()
    job.cancel()
    assert job.state == CANCELLED
    assert list(tmp_path.iterdir()) == []


def test_without_trame_the_command_says_what_to_install(workbench, tmp_path):
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    for name in ("trame_plotly", "trame_vuetify", "trame"):
        (blocked / f"{name}.py").write_text(
            f"raise ModuleNotFoundError('no {name}', name='{name}')\n"
        )
    import os
    import subprocess

    root = Path(__file__).resolve().parent.parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(blocked), str(root)])}
    words = [sys.executable, "-m", "workbench", "open", "elastic-arm"]
    done = subprocess.run(
        words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "vision-sensor-workbench[app]" in done.stderr and "workbench open" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_subject_that_is_nothing_is_refused(workbench):
    done = workbench("open", "no-such-thing", "--no-browser")
    assert done.returncode == 2 and "no-such-thing" in done.stderr
