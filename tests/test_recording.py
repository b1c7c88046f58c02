"""The recording in memory: units, groups, selection, and writing without loss."""

import numpy as np
import pytest

import datasets
from datasets.recording import Recording
from datasets.samples.columns import KINDS
from good_recordings import write_good


def made(**columns) -> Recording:
    n = len(next(iter(columns.values())))
    columns = {"sample": np.arange(1.0, n + 1)} | {k: np.asarray(v) for k, v in columns.items()}
    return Recording("external-point", columns, {"builtin": "abb_irb120"}, name="made")


@pytest.mark.parametrize("samples", ["csv", "parquet"])
@pytest.mark.parametrize("measures", KINDS)
def test_written_and_read_again_is_the_same(tmp_path, measures, samples):
    first = datasets.read(write_good(tmp_path / "good", measures))
    folder = datasets.write(first, tmp_path / "copy", samples)
    second = datasets.read(folder)
    assert list(second.columns) == list(first.columns)
    for name, values in first.columns.items():
        np.testing.assert_array_equal(second.columns[name], values)
    for key in (
        "measures",
        "robot",
        "balls",
        "images",
        "board",
        "guess",
        "sigma_mm",
        "title",
        "name",
    ):
        assert getattr(second, key) == getattr(first, key), key


def test_writing_does_not_replace_a_recording(tmp_path):
    recording = datasets.read(write_good(tmp_path / "good"))
    before = (tmp_path / "good" / "samples.csv").read_bytes()
    with pytest.raises(datasets.InputError, match="name another folder"):
        datasets.write(recording, tmp_path / "good")
    assert (tmp_path / "good" / "samples.csv").read_bytes() == before


def test_broken_off_write_leaves_nothing(tmp_path):
    recording = datasets.read(write_good(tmp_path / "good", "board-images"))
    (tmp_path / "good" / "images" / "b.png").unlink()
    with pytest.raises(FileNotFoundError):
        datasets.write(recording, tmp_path / "copy")
    assert [p.name for p in tmp_path.iterdir()] == ["good"]


def test_joints_in_order_of_number_and_in_rad_or_mm():
    columns = {f"q{k}_deg": [float(k), -float(k)] for k in range(11, 1, -1)}
    recording = made(q1_mm=[1500.0, 20.0], **columns)
    expected = np.column_stack([[1500.0, 20.0], *(np.deg2rad([k, -k]) for k in range(2, 12))])
    np.testing.assert_allclose(recording.joints, expected, rtol=1e-15)


def test_poses_merge_pose_and_repeat():
    """Rows 0-1 share a pose, 1-3 a repeat, 4 and 5 stand alone: three groups, none parted."""
    recording = made(pose=[1, 1, 2, 3, 4, 5], repeat=[7, 8, 8, 8, 9, 10])
    assert list(recording.poses) == [0, 0, 0, 0, 1, 2]


def test_poses_without_columns_stand_alone():
    assert list(made(x_mm=[1.0, 2.0, 3.0]).poses) == [0, 1, 2]
    assert list(made(q1_deg=[1.0, 2.0, 3.0]).poses) == [0, 1, 2]


def test_rows_with_the_same_readings_are_one_pose_without_a_column():
    """Read-back joints differ by an encoder count; a tenth of a degree is another pose."""
    assert list(made(q1_deg=[1.0, 2.0, 1.0004, 1.1], q2_deg=[5.0, 6.0, 5.0, 5.0]).poses) == [
        0,
        1,
        0,
        2,
    ]


def test_sigma_of_the_row_comes_first():
    assert made(x_mm=[1.0]).sigma is None
    recording = Recording("external-point", {"x_mm": np.ones(2)}, {}, sigma_mm=0.5)
    np.testing.assert_array_equal(recording.sigma, [0.5, 0.5])
    with_rows = Recording("external-point", {"sigma_mm": np.array([0.1, 0.2])}, {}, sigma_mm=0.5)
    np.testing.assert_array_equal(with_rows.sigma, [0.1, 0.2])


def test_covariates_are_what_nobody_modelled():
    recording = made(
        q1_deg=[1.0],
        x_mm=[1.0],
        pose=[1.0],
        temperature_j2_c=[30.0],
        humidity=[0.4],
        fixed_to=["tool"],
    )
    assert set(recording.covariates) == {"temperature_j2_c", "humidity"}


def test_select_by_mask_and_by_index():
    recording = made(x_mm=[1.0, 2.0, 3.0], note=["a", "b", "c"])
    assert list(recording.select([True, False, True]).columns["note"]) == ["a", "c"]
    assert list(recording.select([2, 0]).sample_ids) == [3, 1]


def test_points_of_a_recording_without_points_is_said():
    with pytest.raises(datasets.InputError, match="x_mm"):
        made(point=[1.0, 1.0]).points
