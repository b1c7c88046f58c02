"""Diagnosis of a profiler and of a 3-D camera from distances to a ball, and from ball centres."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.recording import Recording
from workbench.commands import cli
from workbench.core.errors import InputError
from workbench.diagnosis.scanner.surface import diagnose_surface
from workbench.fitting.verdicts.verdict import AS_STATED
from workbench.recordings.templates.scanner_kinds import example

KINDS = ("profiler", "3d-camera")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("surface")
    return {kind: example(kind, folder / kind, lambda text: None).recording for kind in KINDS}


def with_error(recording, error, **more):
    """The recording with z moved by error (n,), mm."""
    z = recording.columns["z_mm"] + error
    return replace(recording, columns={**recording.columns, "z_mm": z, **more})


def diagnosed(recording):
    return diagnose_surface(recording, lambda text: None).as_json()


def scale(recording):
    z = recording.columns["z_mm"]
    return 0.004 * (z - z.mean())


@pytest.mark.parametrize("kind", KINDS)
def test_a_sensor_without_errors_shows_none(kind, recordings):
    answer = diagnosed(recordings[kind])
    assert answer["verdict"] == "consistent" and not answer["effects"] and not answer["located"]
    assert answer["held_out"]["after_mm"] < 1.3 * answer["held_out"]["noise_mm"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_wrong_scale_of_z_is_named_with_its_size(kind, recordings):
    recording = recordings[kind]
    answer = diagnosed(with_error(recording, scale(recording)))
    assert [one["effect"] for one in answer["effects"]] == ["range-scale"]
    found = answer["effects"][0]
    (scale_of_z,) = found["parameters"]
    assert answer["verdict"] == "explained" and found["probability"] > 0.95
    assert (
        abs(scale_of_z["value"] - 0.004) < 3 * scale_of_z["std"] and scale_of_z["unit"] == "mm/mm"
    )
    held_out = answer["held_out"]
    assert held_out["after_mm"] < 0.9 * held_out["before_mm"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_curved_field_is_named(kind, recordings):
    recording = recordings[kind]
    bowl = 0.1 * (recording.columns["x_mm"] / 20.0) ** 2
    answer = diagnosed(with_error(recording, bowl))
    assert answer["effects"][0]["effect"] == "field-bias"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("axis", "size", "cause"),
    [
        ("x", 0.004, ("lateral-scale", "scale of x")),
        ("z", 0.02, ("field-bias", "angle between x and z is not 90 deg")),
    ],
)
def test_a_lateral_scale_and_axes_that_are_not_orthogonal_are_named(
    kind, axis, size, cause, recordings
):
    recording = recordings[kind]
    x, along = recording.columns["x_mm"], recording.columns[f"{axis}_mm"]
    columns = {**recording.columns, "x_mm": x + size * (along - along.mean())}
    answer = diagnosed(replace(recording, columns=columns))
    (found,) = answer["effects"]
    assert (answer["verdict"], found["effect"], found["label"]) == ("explained", *cause)
    (number,) = found["parameters"]
    assert abs(number["value"] - size) < 3 * number["std"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_scale_and_a_curved_field_are_found_together(kind, recordings):
    recording = recordings[kind]
    bowl = 0.08 * (recording.columns["x_mm"] / 20.0) ** 2
    answer = diagnosed(with_error(recording, 0.75 * scale(recording) + bowl))
    assert {one["effect"] for one in answer["effects"]} == {"range-scale", "field-bias"}


@pytest.mark.parametrize("kind", KINDS)
def test_an_error_without_a_name_is_unexplained_and_located(kind, recordings):
    recording = recordings[kind]
    ripple = 0.05 * np.sin(2 * np.pi * recording.columns["x_mm"] / 11.0)
    answer = diagnosed(with_error(recording, ripple))
    assert answer["verdict"] == "unexplained"
    assert [one["effect"] for one in answer["effects"]] == ["unknown"]
    assert answer["located"][0]["where"] == "sensor" and answer["located"][0]["depends_on"] == ["x"]
    held_out = answer["held_out"]
    assert held_out["after_mm"] < 0.85 * held_out["before_mm"]


@pytest.mark.parametrize("kind", KINDS)
def test_errors_that_no_covariate_predicts_are_unexplained(kind, recordings):
    recording = recordings[kind]
    pose = recording.columns["pose"].astype(int)
    phase = np.random.default_rng(4).uniform(0, 2 * np.pi, pose.max() + 1)[pose]
    waves = 0.03 * np.sin(recording.columns["x_mm"] / 2.0 + phase)
    answer = diagnosed(with_error(recording, waves))
    assert answer["verdict"] == "unexplained" and not answer["effects"]
    assert answer["located"][0]["depends_on"] == ["place within a pose"]
    assert answer["located"][0]["size_mm"] < 0.03


def test_a_ball_that_is_larger_than_stated_is_named_with_its_sign(recordings):
    recording = recordings["3d-camera"]
    smaller = {ball: (*row[:3], row[3] - 0.1) for ball, row in recording.balls.items()}
    answer = diagnosed(replace(recording, balls=smaller))
    (found,) = answer["effects"]
    (radius,) = found["parameters"]
    assert found["effect"] == "ball-radius" and found["where"] == "ball-1"
    assert abs(radius["value"] - 0.1) < 4 * radius["std"]


def test_sizes_that_would_be_found_are_stated(recordings):
    rows = diagnosed(recordings["profiler"])["smallest_visible"]
    assert {"range-scale", "field-bias", "ball-radius"} <= {row["effect"] for row in rows}
    assert all(0 < row["size_mm"] < 1 for row in rows)


def test_drift_with_a_recorded_column_is_named(recordings):
    recording = recordings["3d-camera"]
    pose = recording.columns["pose"]
    warm = np.random.default_rng(3).uniform(20, 30, 40)[pose.astype(int)]
    answer = diagnosed(with_error(recording, 0.03 * (warm - 25), temperature_c=warm))
    assert [one["effect"] for one in answer["effects"]] == ["recorded-column"]
    assert "temperature_c" in answer["effects"][0]["label"]


def centres(error=lambda place, pose, flange: 0.0, n=40, seed=0):
    """Ball centres in the frame of a sensor that a robot with a random error of 0.03 mm carries around two balls."""
    rng = np.random.default_rng(seed)
    mount = np.eye(4)
    mount[:3, :3] = MOUNT
    mount[:3, 3] = 40.0, -60.0, 90.0
    balls = np.array([[900.0, 50.0, 200.0], [950.0, -150.0, 250.0]])
    rows = []
    for k in range(n):
        place = np.array([*rng.uniform(-60, 60, 2), rng.uniform(250, 450)])
        sensor = np.eye(4)
        angles = (180 + rng.uniform(-35, 35), rng.uniform(-35, 35), rng.uniform(-170, 170))
        sensor[:3, :3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
        sensor[:3, 3] = balls[k % 2] - sensor[:3, :3] @ place
        flange = sensor @ np.linalg.inv(mount)
        x, y, z, w = Rotation.from_matrix(flange[:3, :3]).as_quat()
        measured = place + rng.normal(0, 0.02, 3) + error(place, k, flange)
        stated = flange[:3, 3] + rng.normal(0, 0.03, 3)
        rows.append([k + 1, k + 1, k % 2 + 1, *stated, w, x, y, z, *measured])
    names = ("sample", "pose", "ball", *FLANGE, "x_mm", "y_mm", "z_mm")
    columns = dict(zip(names, np.array(rows).T))
    return Recording("ball-centre", columns, None, sigma_mm=0.02, name="centres")


MOUNT = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
FLANGE = ("flange_x_mm", "flange_y_mm", "flange_z_mm") + tuple(f"flange_q{axis}" for axis in "wxyz")
CENTRES = {
    "range-scale": lambda place, pose, flange: np.array([0, 0, 1e-3 * (place[2] - 350)]),
    "base-drift": lambda place, pose, flange: flange[:3, :3].T @ np.array([4e-3, 0, 4e-3]) * pose,
    "unknown": lambda place, pose, flange: np.array([0, 0, 0.12 * np.sin(place[0] / 8)]),
}


@pytest.mark.parametrize("name", CENTRES)
def test_effects_are_found_from_ball_centres(name):
    answer = diagnosed(centres(CENTRES[name]))
    assert [one["effect"] for one in answer["effects"]] == [name]
    assert (answer["verdict"] == "unexplained") == (name == "unknown")


def test_a_moving_base_has_the_sign_of_its_motion():
    """The sensor moves along with the base, and the ball then seems to be where it was the other way."""

    def error(place, pose, flange):
        return -(flange[:3, :3] @ MOUNT).T @ np.array([4e-3, 0.0, 0.0]) * pose

    (found,) = diagnosed(centres(error))["effects"]
    along_x = found["parameters"][0]
    assert found["effect"] == "base-drift" and along_x["name"] == "x_t1"
    assert abs(along_x["value"] - 4e-3 * 39 / 2) < 4 * along_x["std"]


def test_a_sag_is_stated_as_the_combination_that_the_ball_shows():
    """The same sag along all axes is a shift of the ball: no single component is determined."""

    def error(place, pose, flange):
        gravity = flange[:3, :3].T @ np.array([0.0, 0.0, -1.0])
        return -MOUNT.T @ np.array([0.5 * gravity[0], 0.0, 0.0])

    answer = diagnosed(centres(error, n=80))
    (found,) = answer["effects"]
    assert found["effect"] == "tool-deflection"
    x, y, z = found["parameters"]
    assert not any(one["identifiable"] for one in (x, y, z)) and x["std"] is None
    assert x["value"] - y["value"] == pytest.approx(0.5, abs=0.15)
    assert "only in combination" in found["statement"]


def test_ball_centres_without_an_effect_are_consistent():
    answer = diagnosed(centres())
    assert answer["verdict"] == "consistent" and answer["held_out"]["noise_from"] == AS_STATED
    assert "ball-radius" not in {row["effect"] for row in answer["smallest_visible"]}


def test_too_few_poses_are_refused(recordings):
    recording = recordings["profiler"]
    with pytest.raises(InputError, match="8 poses"):
        diagnose_surface(recording.select(recording.columns["pose"] < 7), lambda text: None)


def test_command_writes_answer_and_page(recordings, tmp_path):
    out = tmp_path / "out"
    assert cli.run(["diagnose", str(recordings["profiler"].folder), "--out", str(out)]) == 0
    answer = json.loads((out / "answer.json").read_text())
    assert answer["unit"] == "mm"
    text = (out / "report.html").read_text()
    assert "Effects" in text and "Held-out errors" in text
