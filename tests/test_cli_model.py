"""The run folder of a diagnosis on the command line: every command that takes a calibration takes it."""

import json
from types import SimpleNamespace

import pytest
import tomli_w

import datasets
from robot_model import load_robot
from robot_model.effects import CATALOGUE
from test_corrected_models import SCENE, recorded
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.validation.terms import Term
from workbench.explanation.output.corrected_model import corrected_stages
from workbench.files.solution_file import solution_keys
from workbench.fitting.calibration_plans.plan_file import plan_text
from workbench.jobs.robot.calibrate import calibrate, save
from workbench.jobs.robot.corrected_scene import corrected_scene, write_scene


@pytest.fixture
def found(workbench, tmp_path):
    """A recording `rec` and the run folder `found` of its diagnosis."""
    (tmp_path / "scene.toml").write_text(tomli_w.dumps(SCENE | {"samples": 70}))
    assert workbench("simulate", "scene.toml", "--out", "rec").returncode == 0
    done = workbench(
        "diagnose", "rec", "--out", "found", "--no-report", "--json", "a.json", "--jobs", "1"
    )
    assert done.returncode == 0, done.stderr
    return json.loads((tmp_path / "a.json").read_text())["model"]


@pytest.mark.slow
def test_the_run_of_a_diagnosis_is_used_like_a_calibration(workbench, tmp_path, found):
    assert found["plan"].endswith("found/plan.toml") and not found["left_out"]
    (tmp_path / "t.csv").write_text(
        "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,approach3\n0,10,10,0,30,0,1\n20,-10,15,10,40,5,-1\n"
    )
    off = ("--without", "joint-3.backlash")
    calls = {
        "calibrate": ("calibrate", "rec", "--from-diagnosis", "found", "--no-report"),
        "bare": ("calibrate", "rec", "--from-diagnosis", "found", *off, "--no-report"),
        "compensate": ("compensate", "found", "t.csv"),
        "compensate-bare": ("compensate", "found", "t.csv", *off),
        "simulate": ("simulate", "found"),
        "poses": ("poses", "found", "--count", "30", "--link-radius", "0"),
        "export": ("export", "found", "--to", "python", "--out", "arm.py"),
        "program": ("export", "found", "--to", "krl", "--targets", "t.csv", "--out", "p.src"),
    }
    answers = {}
    for name, call in calls.items():
        place = () if call[0] == "export" else ("--out", f"run-{name}")
        done = workbench(*call, *place, "--json", f"{name}.json")
        assert done.returncode == 0, (name, done.stderr)
        answers[name] = json.loads((tmp_path / f"{name}.json").read_text())
    kept, bare = (
        {p["where"] + p["name"] for p in answers[k]["parameters"]} for k in ("calibrate", "bare")
    )
    assert kept - bare == {"joint-3backlash.half_gap"}
    assert answers["bare"]["held_out"]["rms_mm"] > 1.3 * answers["calibrate"]["held_out"]["rms_mm"]
    assert answers["simulate"]["samples"] == 70 and answers["poses"]["poses"] == 30
    assert answers["export"]["left_out"] == [] and "PTP {AXIS:" in (tmp_path / "p.src").read_text()
    rows = [
        (tmp_path / f"run-{name}" / "corrected.csv").read_text()
        for name in ("compensate", "compensate-bare")
    ]
    assert rows[0] != rows[1]


@pytest.mark.slow
def test_every_command_takes_a_run_with_a_joint_curve(workbench, tmp_path):
    """A curve without a physical law goes through every command, and is switched off by its name."""
    curve = {"effect": "joint-curve", "where": "joint-2", "start": -1.9, "end": 1.9, "terms": 15}
    truth = {"effect": "transmission-harmonic", "where": "joint-2", "order": 3.0}
    scene = SCENE | {"samples": 120, "effect": [truth | {"values": {"cos3": 5e-4, "sin3": 3e-4}}]}
    recording = recorded(tmp_path, scene)
    datasets.write(recording, tmp_path / "rec")
    made = Finding("joint-curve", "joint-2", "", (make_curve(curve),), 1e-9, 1.0, 1.0, 1.0, ("q2",))
    stages = corrected_stages(SimpleNamespace(outliers=(), given=(), terms=(Term(made),)), robot())
    folder = tmp_path / "found"
    folder.mkdir()
    (folder / "plan.toml").write_text(plan_text(stages, "a curve"))
    calibration = calibrate(recording, stages, folds=4)
    save(calibration, folder)
    keys = solution_keys(calibration)
    (folder / "solution.json").write_text(json.dumps(keys))
    assert not write_scene(corrected_scene(calibration, "curve"), folder)
    (tmp_path / "t.csv").write_text(TARGETS)
    off = ("--without", "joint-2.joint-curve")
    calls = {
        "calibrate": ("calibrate", "rec", "--from-diagnosis", "found", "--no-report"),
        "compensate": ("compensate", "found", "t.csv"),
        "simulate": ("simulate", "found"),
        "poses": ("poses", "found", "--count", "30", "--link-radius", "0"),
        "compare": ("compare", "rec", "--plan", "found", "--plan", "ye-mdh"),
        "python": ("export", "found", "--to", "python", "--out", "arm.py"),
        "mjcf": ("export", "found", "--to", "mjcf", "--out", "arm.xml"),
        "krl": ("export", "found", "--to", "krl", "--targets", "t.csv", "--out", "p.src"),
        "compensate-bare": ("compensate", "found", "t.csv", *off),
        "simulate-bare": ("simulate", "found", *off),
        "python-bare": ("export", "found", "--to", "python", "--out", "bare.py", *off),
        "calibrate-bare": ("calibrate", "rec", "--from-diagnosis", "found", "--no-report", *off),
    }
    answers = {}
    for name, call in calls.items():
        place = () if call[0] == "export" else ("--out", f"run-{name}")
        done = workbench(*call, *place, "--json", f"{name}.json")
        assert done.returncode == 0, (name, done.stderr)
        answers[name] = json.loads((tmp_path / f"{name}.json").read_text())
    plans = {row["plan"]: row["held_out_rms_mm"] for row in answers["compare"]["plans"]}
    assert plans["ye-mdh"] > 1.3 * plans["found"]
    held_out = {
        name: answers[name]["held_out"]["rms_mm"] for name in ("calibrate", "calibrate-bare")
    }
    assert held_out["calibrate-bare"] > 1.3 * held_out["calibrate"]
    for name, file in (("compensate", "corrected.csv"), ("simulate", "samples.csv")):
        texts = [(tmp_path / f"run-{n}" / file).read_text() for n in (name, f"{name}-bare")]
        assert texts[0] != texts[1]
    assert "class JointCurve" in (tmp_path / "arm.py").read_text()
    assert "class JointCurve" not in (tmp_path / "bare.py").read_text()
    assert answers["mjcf"]["control_file"].endswith("arm_control.py")


TARGETS = (
    "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,approach3\n0,10,10,0,30,0,1\n20,-10,15,10,40,5,-1\n"
)


def make_curve(row):
    options = {key: value for key, value in row.items() if key not in ("effect", "where")}
    return CATALOGUE[row["effect"]](row["where"], **options)


def robot():
    return load_robot(SCENE["robot"])


def test_wrong_calls_are_sentences(workbench, tmp_path):
    (tmp_path / "empty").mkdir()
    for call, words in (
        (("calibrate", "elastic-arm", "--from-diagnosis", "empty"), "with a plan.toml, found none"),
        (
            ("calibrate", "elastic-arm", "--plan", "ye-2024", "--from-diagnosis", "empty"),
            "found both",
        ),
        (("calibrate", "elastic-arm", "--without", "joint-3.backlash"), "found neither"),
        (("simulate", "empty"), "with a scene.toml, found a folder"),
        (("calibrate", "elastic-arm", "--plan", "ye-2024", "--without", "x.y"), "its terms are"),
    ):
        done = workbench(*call)
        assert done.returncode == 2 and words in " ".join(done.stderr.split()), done.stderr
