"""Using a calibration from the command line: poses to measure, targets corrected, exports; and what is refused."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenes import ABB, scene
from workbench.jobs.robot.calibrate import calibrate, save


@pytest.fixture
def run(workbench):
    """`run("compensate", …, folder=…)`: a finished process of the command in a folder."""
    return lambda *words, folder: workbench(*words, cwd=folder)


@pytest.fixture(scope="module")
def solution(tmp_path_factory):
    """A run folder of a calibrated arm."""
    folder = tmp_path_factory.mktemp("solution")
    made = scene("external-point", n=80, arm=ABB, reflectors={1: (30.0, -40.0, 100.0)})
    columns = dict(made.recording.columns)
    columns["q3_deg"] = columns["q3_deg"] + 0.3
    save(
        calibrate(
            type(made.recording)("external-point", columns, ABB, sigma_mm=0.02, name="scene"),
            folds=4,
        ),
        folder,
    )
    return folder


def write_targets(
    folder,
    text="q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,payload_kg,time_s\n0,10,10,0,30,0,1,0\n20,-10,15,10,40,5,1,0\n",
):
    path = folder / "targets.csv"
    path.write_text(text)
    return path


def test_targets_are_corrected(run, solution, tmp_path):
    done = run(
        "compensate",
        solution,
        write_targets(tmp_path),
        "--json",
        "answer.json",
        "--out",
        "run",
        folder=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert answer["reached"] == 2 and answer["left_rms_mm"] < 1e-3
    table = np.genfromtxt(tmp_path / "run" / "corrected.csv", delimiter=",", names=True)
    # the third joint's readings are 0.3 deg too large, so the correction makes them so
    np.testing.assert_allclose(table["q3_deg"] - [10, 15], 0.3, atol=0.02)
    assert done.stdout.strip().splitlines()[-1].endswith("run")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("q1_deg,q2_deg\n1,2\n", "6 joint columns"),
        (
            "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n0,500,0,0,0,0\n",
            "row 2, column q2_deg: expected -110 to 110",
        ),
        (
            "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n0,nan,0,0,0,0\n",
            "column q2_deg: expected a finite number",
        ),
        ("x_mm,y_mm,z_mm\n1,2,3\n", "column qw"),
        ("x_mm,y_mm,z_mm,qw,qx,qy,qz\n300,0,300,1,1,0,0\n", "quaternion of length 1"),
        ("a,b,c\n1,2,3\n", "joint columns q1_deg"),
        ("", "expected"),
    ],
)
def test_bad_targets_are_one_sentence(run, solution, tmp_path, text, words):
    done = run(
        "compensate", solution, write_targets(tmp_path, text), "--out", "run", folder=tmp_path
    )
    assert (
        done.returncode == 2 and words in done.stderr and len(done.stderr.strip().splitlines()) == 1
    )
    assert not (tmp_path / "run").exists()


def test_a_target_out_of_reach_keeps_no_readings_and_the_answer_is_no(run, solution, tmp_path):
    text = "x_mm,y_mm,z_mm,qw,qx,qy,qz,payload_kg,time_s\n350,0,350,0,1,0,0,1,0\n3000,0,300,0,1,0,0,1,0\n"
    done = run(
        "compensate",
        solution,
        write_targets(tmp_path, text),
        "--json",
        "answer.json",
        "--out",
        "run",
        folder=tmp_path,
    )
    assert done.returncode == 1 and "Target 2" in done.stdout, done.stderr
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert "workspace of the arm" in answer["unattainable"][0]
    assert (
        answer["reached"] == 1
        and answer["unreached_rows"] == [2]
        and answer["correction_rms_mm"] < 20
    )
    table = np.genfromtxt(tmp_path / "run" / "corrected.csv", delimiter=",", names=True)
    assert np.isfinite(table["q1_deg"]).tolist() == [True, False]
    page = (tmp_path / "run" / "report.html").read_text()
    assert "1 of 2" in page and "not attainable" in page and "corrected.csv" in page


def test_a_file_that_is_not_there_is_named_once(run, solution, tmp_path):
    done = run("compensate", solution, tmp_path / "none.csv", folder=tmp_path)
    assert (
        done.returncode == 2
        and done.stderr.count("expected a file") == 1
        and "no such file" in done.stderr
    )


def test_a_calibration_that_failed_is_refused_unless_forced(run, solution, tmp_path):
    keys = json.loads((solution / "solution.json").read_text()) | {"converged": False}
    (tmp_path / "bad.json").write_text(json.dumps(keys))
    targets = write_targets(tmp_path)
    refused = run("compensate", "bad.json", targets, folder=tmp_path)
    assert refused.returncode == 2 and "add --force" in refused.stderr
    assert (
        run("export", "bad.json", "--to", "urdf", "--out", "a.urdf", folder=tmp_path).returncode
        == 2
    )
    assert not (tmp_path / "a.urdf").exists()
    assert run("compensate", "bad.json", targets, "--force", folder=tmp_path).returncode == 0


def test_the_exported_model_runs_in_mujoco(run, solution, tmp_path):
    mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo")
    done = run("export", solution, "--to", "mjcf", "--out", "arm.xml", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    mujoco.mj_forward(model, mujoco.MjData(model))
    assert model.nu == 6


def test_the_exported_module_runs_in_a_fresh_interpreter(run, solution, tmp_path):
    done = run("export", solution, "--to", "python", "--out", "arm.py", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    code = "import arm; print(arm.flange_poses([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]]).shape)"
    alone = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env={}, capture_output=True, text=True
    )
    assert alone.stdout.strip() == "(1, 4, 4)", alone.stderr


@pytest.mark.parametrize("name", ["urdf", "mdh-json", "mdh-csv"])
def test_arms_are_exported(run, solution, tmp_path, name):
    done = run("export", solution, "--to", name, "--out", "arm.out", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "joint" in (tmp_path / "arm.out").read_text()


def test_cameras_are_exported(run, tmp_path):
    import tomli_w

    from sensors.camera.model import Camera, camera_keys

    camera = Camera(
        3421.5, 3415.25, 640.5, 511.75, (-0.2, 0.11, 0.0013, -0.0021, 0.05), (1280, 1024)
    )
    (tmp_path / "camera.toml").write_text(tomli_w.dumps(camera_keys(camera)))
    assert (
        run(
            "export", "camera.toml", "--to", "ros", "--out", "camera.yaml", folder=tmp_path
        ).returncode
        == 0
    )
    assert "plumb_bob" in (tmp_path / "camera.yaml").read_text()
    held = run("export", "camera.toml", "--to", "kalibr", "--out", "chain.yaml", folder=tmp_path)
    assert (
        held.returncode == 0
        and "off by up to" in held.stdout
        and "radtan" in (tmp_path / "chain.yaml").read_text()
    )
    bent = replace(camera, fx=900.0, fy=900.0, distortion=(-0.3, 0.15, 0.0, 0.0, -0.2))
    (tmp_path / "bent.toml").write_text(tomli_w.dumps(camera_keys(bent)))
    wrong = run("export", "bent.toml", "--to", "kalibr", "--out", "none.yaml", folder=tmp_path)
    assert (
        wrong.returncode == 2 and "radtan" in wrong.stderr and not (tmp_path / "none.yaml").exists()
    )


def test_poses_are_chosen(run, tmp_path):
    done = run("poses", "elastic-arm", "-n", "12", "--json", "-", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["poses"] == 12 and answer["gain_over_random"] > 1
    assert len(Path(tmp_path, answer["file"]).read_text().splitlines()) == 1 + len(
        answer["samples"]
    )
    wrong = run("poses", "elastic-arm", "-n", "100000", folder=tmp_path)
    assert wrong.returncode == 2 and len(wrong.stderr.strip().splitlines()) == 1
