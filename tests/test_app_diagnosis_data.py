"""What the tab Diagnosis shows, without its page: places, terms, poses of the next experiment."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from app_diagnosis import diagnosis_answer, image_diagnosis_answer, write_diagnosis
from workbench.app.data import diagnosis
from workbench.app.data.opened import open_subject
from workbench.app.figures import diagnosis as diagnosis_figures
from workbench.app.figures import residuals
from workbench.app.workspace import Workspace
from workbench.core.errors import InputError
from workbench.report.text import p_value


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
    from workbench.fitting.calibration_plans.plans import read_plan

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


@pytest.mark.parametrize(
    ("where", "name"),
    [("base", "base-warm-up"), ("link-4", "link-warm-up"), ("joint-2", "warm-up")],
)
def test_a_term_is_written_with_the_name_that_the_plan_has_for_its_place(where, name):
    options = {"time_constant": 427.0, "start": 0.0}
    term = {"effect": "warm-up", "where": where, "options": options}
    assert diagnosis.plan_problem(term) == ""
    assert diagnosis.plan_row(term) == {"effect": name, "where": where, **options}


def test_a_diagnosis_run_is_opened_with_its_views(tmp_path):
    work = Workspace(
        open_subject(str(write_diagnosis(tmp_path / "run"))), tmp_path / "session.toml"
    )
    made = diagnosis_figures.before_after(work.diagnosis, "time (s)")
    assert {one.name for one in made.data} == {"before", "after", "mean before", "mean after"}
    poses = diagnosis.next_poses(work.diagnosis.folder, work.diagnosis.robot)
    arms, flanges = diagnosis_figures.next_poses(work.diagnosis, poses).data
    assert arms.name == "2 poses to measure"
    assert list(flanges.text) == ["<b>1</b>", "<b>2</b>"]
    assert "joint 2 (deg): 20.00<br>joint 3 (deg): -10.00" in flanges.customdata[0]


def test_residuals_of_a_diagnosis_have_places_and_held_out_lengths(solved_arm, tmp_path):
    folder = write_diagnosis(tmp_path / "run")
    shutil.copy(solved_arm / "solution.json", folder)
    found, calibrated = (open_subject(str(one)).residuals for one in (folder, solved_arm))
    assert np.allclose(found.points, calibrated.points, atol=1e-6)
    lengths = np.linalg.norm(found.arrows, axis=0)
    assert np.allclose(lengths, found.lengths["after"])
    later = Workspace(open_subject(str(folder)), tmp_path / "later" / "session.toml")
    later.open_run(open_subject(str(solved_arm)))
    assert not residuals.has_side_by_side(
        later
    )  # the arrows after a diagnosis are not those before
    made = residuals.histogram_figure(
        Workspace(open_subject(str(folder)), tmp_path / "session.toml")
    )
    assert [one.name for one in made.data] == ["before, held out", "after, held out", "bins"]
    assert sum(made.data[1].y) == 300 and found.lengths["held_out_after"].min() >= 0.1


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
