"""A recording named by a relative path, its robot in a URDF: what is saved names that file from anywhere."""

import numpy as np

import datasets
from export_scenes import URDF
from robot_model import load_robot
from workbench.files.solution_file import robot_keys


def test_the_urdf_of_a_relative_recording_is_found_from_another_folder(tmp_path, monkeypatch):
    folder = tmp_path / "cell"
    folder.mkdir()
    (folder / "robot.urdf").write_text(URDF)
    joints = load_robot({"urdf": str(folder / "robot.urdf"), "tip": "tool0"}).joints
    names = [f"q{k + 1}_deg" for k in range(joints)]
    readings = np.random.default_rng(1).uniform(-20, 20, (12, joints))
    rows = [",".join(map(str, (k + 1, *row, 1.0, 2.0, 3.0))) for k, row in enumerate(readings)]
    (folder / "samples.csv").write_text(
        ",".join(("sample", *names, "x_mm", "y_mm", "z_mm")) + "\n" + "\n".join(rows) + "\n"
    )
    (folder / "recording.toml").write_text(
        'format = "recording/1"\nmeasures = "external-point"\nsigma_mm = 0.02\n'
        '[robot]\nfile = "robot.urdf"\ntip = "tool0"\n[samples]\nfile = "samples.csv"\n'
    )
    monkeypatch.chdir(tmp_path)
    recording = datasets.read("cell")
    keys = robot_keys(recording)
    monkeypatch.chdir(tmp_path.parent)
    assert load_robot(keys).joints == joints
