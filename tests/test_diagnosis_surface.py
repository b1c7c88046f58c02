"""Diagnosis of a profiler and of a 3-D camera from distances to a ball."""

import json
from dataclasses import replace

import numpy as np
import pytest

from workbench.commands import cli
from workbench.core.errors import InputError
from workbench.diagnosis.scanner.surface import diagnose_surface
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
