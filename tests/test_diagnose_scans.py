"""`workbench diagnose --scanner`: ball centres of scans are diagnosed, not the images of the boards."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import datasets
from datasets.samples.columns import FLANGE
from sensor_recordings import scanner_recording
from workbench.commands import cli

BALL = np.array([500.0, 50.0, 20.0])
SAG = 0.25
"""mm by which the camera is displaced where gravity is across the z axis of the flange."""
COPIES = 6


def _flange_poses(centres: np.ndarray) -> np.ndarray:
    """(k, 7) mm and quaternions, scalar first, at which a camera that sags sees the ball at `centres` (k, 3) mm."""
    rng = np.random.default_rng(0)
    mounted = Rotation.from_rotvec([0.1, -0.2, 1.2])
    poses = []
    for centre in centres:
        roll, pitch, yaw = rng.uniform(-0.9, 0.9), rng.uniform(-0.9, 0.9), rng.uniform(-2, 2)
        flange = Rotation.from_euler("xyz", [np.pi + roll, pitch, yaw])
        gravity = flange.inv().apply([0.0, 0.0, -1.0])
        displaced = SAG * gravity * [1.0, 1.0, 0.0]
        origin = BALL - flange.apply(mounted.apply(centre) + [15.0, -30.0, 80.0] + displaced)
        x, y, z, w = flange.as_quat()
        poses.append([*origin, w, x, y, z])
    return np.array(poses)


@pytest.fixture(scope="module")
def sagging(tmp_path_factory):
    """A recording of 12 scans with flange poses, whose camera sags, and its calibrated scanner."""
    home = tmp_path_factory.mktemp("sagging")
    folder, truth = scanner_recording()
    scanner = home / "scanner.toml"
    call = ["scanner", str(folder), "--out", str(scanner), "--no-report", "--json"]
    assert cli.run([*call, str(home / "scanner.json")]) == 0
    recording = datasets.read(folder)
    rng = np.random.default_rng(1)
    centres, images = [], []
    (home / "made" / "images").mkdir(parents=True)
    for copy in range(COPIES):
        for scan in truth["scans"]:
            centres.append(scan["balls"][0]["centre_mm"])
            for row in (r for r in recording.images if r.get("scan") == str(scan["scan"])):
                seen = cv2.imread(str(recording.folder / row["image"]), cv2.IMREAD_GRAYSCALE)
                noisy = np.clip(np.round(seen + rng.normal(0, 0.5, seen.shape)), 0, 255)
                name = f"images/{copy}-{scan['scan']}-{row['step']}.png"
                cv2.imwrite(str(home / "made" / name), noisy.astype(np.uint8))
                images.append(
                    {**row, "image": name, "scan": f"{copy}-{scan['scan']}", "sample": len(centres)}
                )
    poses = _flange_poses(np.array(centres))
    columns = {"sample": np.arange(1.0, len(poses) + 1), **dict(zip(FLANGE, poses.T))}
    made = replace(
        recording, columns=columns, images=tuple(images), folder=home / "made", name="sagging"
    )
    return datasets.write(made, home / "recording"), scanner


def test_sag_is_named_from_scans_with_flange_poses(sagging, tmp_path):
    recording, scanner = sagging
    out = tmp_path / "run"
    call = ["diagnose", str(recording), "--scanner", str(scanner), "--out", str(out)]
    assert cli.run([*call, "--tolerance", "0.05mm"]) == 0
    answer = json.loads((out / "answer.json").read_text())
    assert answer["verdict"] == "explained"
    assert [(e["effect"], e["where"]) for e in answer["effects"]] == [("tool-deflection", "tool")]
    held_out = answer["held_out"]
    assert held_out["after_mm"] < held_out["before_mm"] / 3
    assert len(answer["sensor"]["scans"]) == 12
    assert (out / "ball-centres" / "samples.csv").is_file()


def test_scans_without_poses_are_refused(sagging, tmp_path, capsys):
    scanner = sagging[1]
    call = ["diagnose", str(scanner_recording()[0]), "--scanner", str(scanner)]
    assert cli.run([*call, "--out", str(tmp_path / "run")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "expected [samples] with joint readings and [robot], or with flange poses" in said
    assert "omit --scanner to diagnose the images" in said
