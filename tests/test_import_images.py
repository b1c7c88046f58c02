"""Import of images of a board with flange poses: readings of the poses, and a board that is not shown."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from import_scenes import write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording


@pytest.fixture(scope="module")
def hand_eye(tmp_path_factory):
    """The template of images of a board with flange poses, and its recording."""
    import datasets
    from workbench.recordings.templates import write_template

    folder = tmp_path_factory.mktemp("template") / "board"
    write_template("board-images", folder)
    return folder, datasets.read(folder)


def test_folder_of_images_with_a_pose_table_in_inches(hand_eye, tmp_path):
    folder, truth = hand_eye
    data = tmp_path / "data"
    data.mkdir()
    for path in (folder / "images").iterdir():
        (data / path.name).write_bytes(path.read_bytes())
    flange = truth.flange
    angles = Rotation.from_matrix(flange[:, :3, :3]).as_euler("YZX", degrees=True)
    rows = zip(flange[:, :3, 3] / 25.4, angles, truth.images)
    table = [(*p, *a, row["image"].rpartition("/")[2]) for p, a, row in rows]
    write_rows(data / "poses.csv", ["X", "Y", "Z", "A", "B", "C", "image"], table)
    (data / "target.yaml").write_text(
        "target_type: 'checkerboard'\ntargetCols: 9\ntargetRows: 6\nrowSpacingMeters: 0.012\ncolSpacingMeters: 0.012\n"
    )
    made = import_recording([data], tmp_path / "out", ImportOptions())
    assert made.mapping.flange_point.unit == "in"
    assert made.mapping.flange_rotation.convention == "intrinsic YZX"
    assert made.recording.measures == "board-images"
    assert len(made.recording.images) == len(truth.images)
    assert np.abs(made.recording.flange - flange).max() < 1e-5
    assert made.unused == ()


def test_a_board_that_the_images_do_not_show_is_looked_for_in_the_option(hand_eye, tmp_path):
    """The user typed --board; there is no recording.toml yet that the message could point to."""
    folder, truth = hand_eye
    rows = [(*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()) for pose in truth.flange]
    path = write_rows(tmp_path / "p.csv", ["x", "y", "z", "qx", "qy", "qz", "qw"], rows)
    board = {**truth.board, "columns": 14, "rows": 11}
    with pytest.raises(InputError) as caught:
        import_recording([folder / "images", path], tmp_path / "out", ImportOptions(board=board))
    assert str(caught.value).startswith("--board: expected ")
    assert "recording.toml" not in str(caught.value)


@pytest.mark.slow
def test_inverse_poses_are_not_taken_silently(hand_eye, tmp_path):
    folder, truth = hand_eye
    flange = np.linalg.inv(truth.flange)
    turns = Rotation.from_matrix(flange[:, :3, :3]).as_quat()
    rows = [(*p, *q) for p, q in zip(flange[:, :3, 3], turns)]
    path = write_rows(tmp_path / "p.csv", ["x", "y", "z", "qx", "qy", "qz", "qw"], rows)
    with pytest.raises(InputError, match="inverse poses"):
        import_recording(
            [folder / "images", path], tmp_path / "out", ImportOptions(board=dict(truth.board))
        )
