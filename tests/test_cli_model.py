"""The run folder of a diagnosis on the command line: every command that takes a calibration takes it."""

import json

import pytest
import tomli_w

from test_corrected_models import SCENE


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
    told = {}
    for name, call in calls.items():
        place = () if call[0] == "export" else ("--out", f"run-{name}")
        done = workbench(*call, *place, "--json", f"{name}.json")
        assert done.returncode == 0, (name, done.stderr)
        told[name] = json.loads((tmp_path / f"{name}.json").read_text())
    kept, bare = (
        {p["where"] + p["name"] for p in told[k]["parameters"]} for k in ("calibrate", "bare")
    )
    assert kept - bare == {"joint-3backlash.half_gap"}
    assert told["bare"]["held_out"]["rms_mm"] > 1.3 * told["calibrate"]["held_out"]["rms_mm"]
    assert told["simulate"]["samples"] == 70 and told["poses"]["poses"] == 30
    assert told["export"]["left_out"] == [] and "PTP {AXIS:" in (tmp_path / "p.src").read_text()
    rows = [
        (tmp_path / f"run-{name}" / "corrected.csv").read_text()
        for name in ("compensate", "compensate-bare")
    ]
    assert rows[0] != rows[1]


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
