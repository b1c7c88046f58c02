"""A long recording calibrated in chunks gives what it gives in memory, and needs no more memory than its residuals."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import datasets
from benchmarks.large import SCENE, long_recording, plan
from conftest import mostly_slow
from datasets.samples.chunks import pose_labels, read_chunks
from robot_model.system import bind
from workbench.commands import cli
from workbench.core.errors import InputError
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.files.solution_file import read_solution
from workbench.jobs.robot import calibrate_large
from workbench.jobs.robot.calibrate import calibrate


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Ten thousand samples, with a file of row groups."""
    home = tmp_path_factory.mktemp("long")
    long_recording(home, 10_000)
    return home


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The first six hundred of them."""
    home = tmp_path_factory.mktemp("short")
    long_recording(home, 600)
    return home


def test_chunks_are_the_recording(folder):
    chunks, whole = read_chunks(folder), datasets.read(folder)
    parts = list(chunks)
    assert chunks.n == whole.n == sum(part.n for part in parts) and len(parts) > 1
    for name, values in whole.columns.items():
        assert np.array_equal(np.concatenate([part.columns[name] for part in parts]), values)
    assert np.array_equal(
        np.concatenate([part.columns["row"] for part in parts]), np.arange(whole.n)
    )
    assert sorted(chunks.first_rows.reflector) == [1, 2, 3]
    assert 2000 <= chunks.thin.n <= 10_000 and np.ptp(chunks.thin.sample_ids) > 0.99 * whole.n


def test_the_solve_gives_the_same_parameters_as_in_memory(folder):
    chunks, whole = read_chunks(folder), datasets.read(folder)
    thin = calibrate(chunks.thin.select(np.arange(400)), plan(), folds=2)
    stream = calibrate_large.stream_of(chunks, thin, lambda text: None)
    stream = replace(stream, extra=0 * stream.extra)
    model = Model(bind(stream.robot, whole, stream.start), stream.effects)
    start = model.parameters.only(stream.parameters.take_over(thin.solution.parameters).mask)
    in_memory, in_chunks = solve(model, start), solve(stream, start)
    assert in_memory.converged and in_chunks.converged and len(in_chunks.history) > 2
    assert np.abs(in_chunks.parameters.values - in_memory.parameters.values).max() < 1e-9  # mm, rad
    assert np.abs(in_chunks.residual - in_memory.residual).max() < 1e-9
    scale = np.sqrt(np.diag(in_memory.normal))
    assert np.abs((in_chunks.normal - in_memory.normal) / np.outer(scale, scale)).max() < 1e-9


def test_folds_by_one_step_are_folds_by_a_solve(folder, short):
    chunks = read_chunks(short)
    thin = calibrate(chunks.thin, plan(), folds=3)
    stream = calibrate_large.stream_of(chunks, thin, lambda text: None)
    fit = solve(stream, thin.solution.parameters)
    fold = calibrate_large._folds(chunks.pose, 3)
    found = calibrate_large._held_out(stream, fit, fold, 3)
    model = Model(bind(stream.robot, chunks.thin, stream.start), stream.effects)
    squares = 0.0
    for k in range(3):
        apart = solve(model.at(fold != k), fit.parameters).parameters
        squares += (model.at(fold == k).residual(apart) ** 2).sum()
    assert found["rms_mm"] == pytest.approx(np.sqrt(squares / chunks.n), rel=1e-4)


def test_the_whole_calibration_is_right_and_can_be_used(short, tmp_path):
    said = []
    made = calibrate_large.calibrate_chunks(short, plan(), folds=3, progress=said.append)
    sigma = np.sqrt(3) * SCENE.sigma_mm
    assert (
        made.solution.converged
        and sigma < made.held_out["rms_mm"] < 1.15 * sigma < made.nominal["rms_mm"]
    )
    calibrate_large.save(made, tmp_path)
    arm = read_solution(tmp_path)
    assert arm.trusted and arm.held_out_mm == made.held_out["rms_mm"]
    for joint, value in ((2, 1e-4), (3, 2e-4)):
        key = f"joint-{joint}.joint-compliance.compliance"
        assert abs(arm.values[key] - value) < 5 * made.solution.std[key]
    answer = json.loads((tmp_path / "calibration.json").read_text())
    assert answer["samples"] == 600 and answer["held_out"]["folds"] == 3
    assert any("sample 600 of 600" in text for text in said)


@pytest.mark.parametrize(("tolerance", "status"), mostly_slow([("100mm", 0), ("0.00001", 1)], 1))
def test_a_tolerance_decides_the_exit_status(short, tmp_path, tolerance, status):
    words = [
        "calibrate-large",
        str(short),
        "--out",
        str(tmp_path / "run"),
        "--tolerance",
        tolerance,
    ]
    assert cli.run([*words, "--json", str(tmp_path / "a.json")]) == status
    answer = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert (
        answer["verdict"]["pass"] is (status == 0) and answer["verdict"]["residual_over_noise"] > 0
    )
    assert answer["noise"]["factor"] == pytest.approx(1, abs=0.2) and answer["warnings"] == []


def test_repeats_of_a_pose_stand_in_one_fold(short):
    recording = datasets.read(short)
    twice = recording.select(np.concatenate([np.arange(600), np.arange(600)]))
    label = pose_labels(twice)
    assert np.array_equal(label[:600], label[600:]) and len(np.unique(label)) == len(
        np.unique(recording.poses)
    )
    fold = calibrate_large._folds(label, 5)
    assert np.array_equal(fold[:600], fold[600:]) and np.bincount(fold).min() > 100


def test_what_cannot_be_read_in_chunks_is_said(tmp_path, short):
    with pytest.raises(InputError, match="save the samples as samples.parquet"):
        read_chunks(Path(datasets.__file__).parent / "bundled" / "elastic-arm")
    import pyarrow.parquet as pq

    table = pq.read_table(short / "samples.parquet")
    broken = table.to_pydict()
    broken["x_mm"][300] = float("nan")
    for name in ("recording.toml", "robot.toml"):
        if (short / name).exists():
            (tmp_path / name).write_bytes((short / name).read_bytes())
    import pyarrow as pa

    pq.write_table(pa.table(broken), tmp_path / "samples.parquet")
    with pytest.raises(InputError, match="row 301"):
        read_chunks(tmp_path)
