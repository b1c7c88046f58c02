"""Import of tables with gross errors, exchanged rows, or a unit that changes at a row: the rows are named."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hand_eye_recordings
from conftest import mostly_slow
from import_scenes import SCENE, UR10, degrees, simulated, write_rows
from workbench.commands.cli import run
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.inspection import inspect_recording

HEADER = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def table(path, truth, points=None, joints=None):
    points = truth.points if points is None else points
    joints = degrees(truth) if joints is None else joints
    return write_rows(path, HEADER, np.column_stack([joints, points]))


def imported(path, tmp_path):
    return import_recording([path], tmp_path / "out", UR10).warnings


def test_gross_errors_are_named_with_the_rows_of_the_file(truth, tmp_path):
    points = truth.points.copy()
    points[[4, 20, 30], 0] += [40.0, -60.0, 90.0]
    (said,) = imported(table(tmp_path / "t.csv", truth, points), tmp_path)
    assert "3 of 36 rows are off" in said
    assert "In the file: rows 6, 22 and 32." in said
    assert "correct or remove" in said


def test_exchanged_rows_are_named(truth, tmp_path):
    points = truth.points.copy()
    points[[4, 20]] = points[[20, 4]]
    (said,) = imported(table(tmp_path / "t.csv", truth, points), tmp_path)
    assert "sample 5 holds that of 21 and 21 holds that of 5" in said
    assert "rows 6 and 22" in said


def test_a_sound_table_is_imported_without_a_word(truth, tmp_path):
    assert imported(table(tmp_path / "t.csv", truth), tmp_path) == ()


@pytest.mark.parametrize(
    ("column", "factor", "words"),
    mostly_slow(
        [
            ("point", 1e-3, "millimetres in rows 2 to 23 and metres in rows 24 to 37"),
            ("point", 1 / 25.4, "millimetres in rows 2 to 23 and inches in rows 24 to 37"),
            ("point", 25.4, "inches in rows 2 to 23 and millimetres in rows 24 to 37"),
            ("joints", np.pi / 180, "degrees in rows 2 to 23 and radians in rows 24 to 37"),
            ("joints", 180 / np.pi, "radians in rows 2 to 23 and degrees in rows 24 to 37"),
        ],
        0,
        2,
    ),
)
def test_a_unit_that_changes_at_a_row_is_located(truth, tmp_path, column, factor, words):
    points, joints = truth.points.copy(), degrees(truth)
    changed = points if column == "point" else joints
    changed[:22] *= min(1.0, 1 / factor)
    changed[22:] *= min(1.0, factor)
    path = table(tmp_path / "t.csv", truth, points, joints)
    with pytest.raises(InputError, match=words):
        import_recording([path], tmp_path / "out", UR10)


def poses(path, recording, order, displaced=()):
    flange = recording.flange[order].copy()
    for row in displaced:
        flange[row, 0, 3] += 40.0
    angles = Rotation.from_matrix(flange[:, :3, :3]).as_quat()
    names = [row["image"].rpartition("/")[2] for row in recording.images]
    rows = [(name, *pose[:3, 3], *quat) for name, pose, quat in zip(names, flange, angles)]
    return write_rows(path, ["image", "x", "y", "z", "qx", "qy", "qz", "qw"], rows)


@pytest.mark.slow
def test_a_displaced_flange_pose_is_named_with_its_row_and_image(tmp_path):
    recording = hand_eye_recordings.made("ChArUco").recording
    path = poses(tmp_path / "p.csv", recording, np.arange(12), displaced=(4,))
    options = ImportOptions(board=dict(recording.board))
    made = import_recording([recording.folder / "images", path], tmp_path / "out", options)
    (said,) = made.warnings
    assert "1 of 12 images do not fit" in said
    assert "row 6 (05.png)" in said


@pytest.mark.slow
def test_exchanged_flange_poses_are_named_with_their_rows_and_images(tmp_path):
    recording = hand_eye_recordings.made("ChArUco").recording
    order = np.arange(12)
    order[[2, 7]] = order[[7, 2]]
    path = poses(tmp_path / "p.csv", recording, order)
    options = ImportOptions(board=dict(recording.board))
    with pytest.raises(InputError, match=r"row 4 \(03.png\) and row 9 \(08.png\) look exchanged"):
        import_recording([recording.folder / "images", path], tmp_path / "out", options)


def test_what_to_do_about_a_warning_comes_before_the_next_command(truth, tmp_path, capsys):
    points = truth.points.copy()
    points[[4, 20]] = points[[20, 4]]
    points[30] = np.nan
    path, out = table(tmp_path / "t.csv", truth, points), tmp_path / "made"
    assert run(["import", str(path), "--robot", "ur10", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert said.index("Note: t.csv: 1 rows with an empty cell") < said.index("Warning: ")
    first, then = said.index("First: do what the warning above asks for"), said.index("Then: ")
    assert said.index("Warning: ") < first < then
    assert "workbench calibrate" in said[then:]
    assert "Next:" not in said


def test_check_names_rows_that_are_exchanged(truth, tmp_path):
    points = truth.points.copy()
    points[[4, 20]] = points[[20, 4]]
    path = table(tmp_path / "t.csv", truth, points)
    made = inspect_recording(import_recording([path], tmp_path / "out", UR10).recording)
    (mistake,) = [need for need in made.needs if need.is_mistake]
    assert not made.is_sufficient, "wrong rows are named: `check` ends with status 1"
    assert made.sentence.startswith("Not right as it is for `workbench calibrate`. First look at")
    assert "sample 5 holds that of 21" in mistake.what
    assert mistake.action == "correct or remove these rows"
