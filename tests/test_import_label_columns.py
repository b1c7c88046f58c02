"""Reflectors that no header names: labels next to the readings, and several rows for each pose."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.mapping.label_parts import with_recurring_part
from import_scenes import SCENE, UR10, degrees, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import import_recording

OFFSETS = np.array([[0.0, 0.0, 0.0], [110.0, 5.0, -20.0], [-30.0, 95.0, 40.0]])
JOINTS = [f"J{k}" for k in range(1, 7)]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def rotations(truth) -> np.ndarray:
    """(n, 3, 3) of the target in the frame of the instrument."""
    return Rotation.from_quat([*zip(*(truth.columns[f"q{k}"] for k in "xyzw"))]).as_matrix()


def reflectors(truth) -> np.ndarray:
    """(n, 3, 3) mm: three reflectors on the tool of each pose."""
    return truth.points[:, None] + np.einsum("nij,kj->nki", rotations(truth), OFFSETS)


def one_of_three(truth) -> tuple[np.ndarray, np.ndarray]:
    """Labels (n,) 1, 2, 3 without an order, and the point (n, 3) of each."""
    labels = np.random.default_rng(4).permutation(np.arange(truth.n) % 3)
    return labels + 1.0, reflectors(truth)[np.arange(truth.n), labels]


def test_a_column_with_an_unknown_header_distinguishes_the_reflectors(truth, tmp_path):
    labels, points = one_of_three(truth)
    header = [*JOINTS, "Nest", "X", "Y", "Z"]
    rows = [[*q, f"N{int(k)}", *p] for q, k, p in zip(degrees(truth), labels, points)]
    path = write_rows(tmp_path / "t.csv", header, rows)
    made = import_recording([path], tmp_path / "out", UR10)
    assert made.mapping.columns["Nest"] == "reflector"
    assert len(set(made.recording.columns["reflector"].tolist())) == 3
    assert made.fits[0].rms_mm < 0.1
    assert "'Nest' is read as the reflector" in made.warnings[0]


def test_labels_that_explain_nothing_are_left_alone(truth, tmp_path):
    labels, _ = one_of_three(truth)
    cells = np.column_stack([degrees(truth), labels, truth.points])
    path = write_rows(tmp_path / "t.csv", [*JOINTS, "Schicht", "X", "Y", "Z"], cells)
    made = import_recording([path], tmp_path / "out", UR10)
    assert "reflector" not in made.mapping.columns.values()
    assert made.unused == ("Schicht",)


def test_labels_in_a_file_of_joints_without_headers(truth, tmp_path):
    labels, points = one_of_three(truth)
    joints = tmp_path / "joint_angles.txt"
    np.savetxt(joints, np.column_stack([degrees(truth), labels]), "%.9g", "\t")
    np.savetxt(tmp_path / "seen.txt", points, "%.6f", "  ")
    made = import_recording([joints, tmp_path / "seen.txt"], tmp_path / "out", UR10)
    assert made.mapping.joints.columns == tuple(f"joint_angles {k}" for k in range(1, 7))
    assert made.mapping.columns["joint_angles 7"] == "reflector"
    assert made.fits[0].rms_mm < 0.1
    assert "readings of the 6 joints" in made.warnings[0]


@pytest.mark.parametrize("by_pose", [True, False])
def test_several_rows_for_each_pose_are_reflectors(truth, tmp_path, by_pose):
    seen = reflectors(truth) if by_pose else reflectors(truth).transpose(1, 0, 2)
    joints = write_rows(tmp_path / "joints.csv", JOINTS, degrees(truth))
    points = write_rows(tmp_path / "tracker.csv", ["X", "Y", "Z"], seen.reshape(-1, 3))
    made = import_recording([joints, points], tmp_path / "out", UR10)
    columns = made.recording.columns
    assert made.recording.n == 3 * truth.n
    assert columns["reflector"][:4].tolist() == ([1, 2, 3, 1] if by_pose else [1, 1, 1, 1])
    assert np.abs(made.recording.points[columns["reflector"] == 1] - truth.points).max() < 1e-3
    assert made.fits[0].rms_mm < 0.1
    assert "3 reflectors on one tool" in made.warnings[0]
    again = import_recording(
        [joints, points], tmp_path / "again", UR10.__class__(robot="ur10", mapping=made.mapping)
    )
    assert again.recording.n == made.recording.n


def test_repeats_of_one_reflector_have_no_labels(truth, tmp_path):
    noise = np.random.default_rng(3).normal(size=(truth.n, 4, 3)) * 0.01
    seen = (truth.points[:, None] + noise).reshape(-1, 3)
    joints = write_rows(tmp_path / "joints.csv", JOINTS, degrees(truth))
    points = write_rows(tmp_path / "tracker.csv", ["X", "Y", "Z"], seen)
    made = import_recording([joints, points], tmp_path / "out", UR10)
    assert made.recording.n == 4 * truth.n and "reflector" not in made.recording.columns
    assert made.recording.columns["pose"][:5].tolist() == [1, 1, 1, 1, 2]


def test_rows_that_keep_no_distances_are_refused(truth, tmp_path):
    seen = np.random.default_rng(2).normal(size=(3 * truth.n, 3)) * 300
    joints = write_rows(tmp_path / "joints.csv", JOINTS, degrees(truth))
    points = write_rows(tmp_path / "tracker.csv", ["X", "Y", "Z"], seen)
    with pytest.raises(InputError, match="found 36 and 108 rows"):
        import_recording([joints, points], tmp_path / "out", UR10)


def test_a_part_of_the_names_of_the_points_distinguishes_the_reflectors(truth, tmp_path):
    labels, points = one_of_three(truth)
    names = [f"M_{row:03d} SMR{int(k)}" for row, k in enumerate(labels, 1)]
    rows = [[*q, name, *p] for q, name, p in zip(degrees(truth), names, points)]
    path = write_rows(tmp_path / "t.csv", [*JOINTS, "Label", "X", "Y", "Z"], rows)
    made = import_recording([path], tmp_path / "out", UR10)
    assert made.fits[0].rms_mm < 0.1
    assert made.recording.columns["reflector"].tolist() == labels.tolist()
    assert f"(of '{names[0]}' the part '{int(labels[0])}')" in made.warnings[0]


@pytest.mark.parametrize(
    "names, parts",
    [
        ([f"P{row}_{row % 2}" for row in range(12)], [row % 2 for row in range(12)]),
        ([f"{'AB'[row % 2]}.{row}" for row in range(12)], [*"AB" * 6]),
        ([f"P{row // 3}_{row % 3}" for row in range(18)], [row % 3 for row in range(18)]),
    ],
)
def test_the_recurring_part_with_the_fewest_values(names, parts):
    assert with_recurring_part(np.array(names)).tolist() == parts


@pytest.mark.parametrize(
    "names",
    [
        [f"SMR_{row}" for row in range(12)],
        [f"P{row}" if row else "Home" for row in range(12)],
        [f"P{row // 3}_{row % 3}" for row in range(9)],
        [f"SMR{row % 2}" for row in range(12)],
    ],
)
def test_names_without_one_recurring_part_stay(names):
    assert with_recurring_part(np.array(names)).tolist() == names
