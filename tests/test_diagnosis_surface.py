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


def scale(recording):
    z = recording.columns["z_mm"]
    return 0.004 * (z - z.mean())


@pytest.mark.parametrize("kind", KINDS)
def test_a_sensor_without_errors_shows_none(kind, recordings):
    answer = diagnose_surface(recordings[kind], lambda text: None)
    assert not answer["effects"]
    assert answer["held_out"]["after_mm"] < 1.3 * answer["held_out"]["noise_mm"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_wrong_scale_of_z_is_named_with_its_size(kind, recordings):
    recording = recordings[kind]
    answer = diagnose_surface(with_error(recording, scale(recording)), lambda text: None)
    assert [one["effect"] for one in answer["effects"]] == ["range-scale"]
    found = answer["effects"][0]
    assert abs(found["values"][0] - 0.004) < 3 * found["std"][0]
    held_out = answer["held_out"]
    assert held_out["after_mm"] < 0.9 * held_out["before_mm"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_curved_field_is_named(kind, recordings):
    recording = recordings[kind]
    bowl = 0.1 * (recording.columns["x_mm"] / 20.0) ** 2
    answer = diagnose_surface(with_error(recording, bowl), lambda text: None)
    assert answer["effects"][0]["effect"] == "field-bias"


def test_drift_with_a_recorded_column_is_named(recordings):
    recording = recordings["3d-camera"]
    pose = recording.columns["pose"]
    warm = np.random.default_rng(3).uniform(20, 30, 40)[pose.astype(int)]
    answer = diagnose_surface(
        with_error(recording, 0.03 * (warm - 25), temperature_c=warm), lambda text: None
    )
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
    assert "Effects" in (out / "report.html").read_text()
