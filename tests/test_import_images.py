"""Import of images of a board with flange poses: readings of the poses, and a board that is not shown."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from import_scenes import write_rows
from workbench.core.errors import InputError
from workbench.jobs.sensor.render import render
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.importing.board_images.reading_fits import agreeing_labels
from workbench.recordings.templates.images import _BOARD, _BOARDS, _HAND_EYE, _pose


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


def symmetric_views(ways: int, count: int, rng):
    """Rotations (T, k, 3, 3) of a board that looks the same after 360 / T deg, labelled at random; flange (k, 3, 3)."""
    flange = Rotation.random(count, random_state=rng).as_matrix()
    tool, board = Rotation.random(2, random_state=rng).as_matrix()
    noise = Rotation.from_rotvec(0.002 * rng.normal(size=(count, 3))).as_matrix()
    seen = noise @ np.linalg.inv(flange @ tool) @ board
    wrong = rng.integers(0, ways, count)
    every = [seen @ about_z(360 / ways * ((turn + wrong) % ways)) for turn in range(ways)]
    return np.array(every), flange, (-wrong) % ways


def about_z(degrees) -> np.ndarray:
    """(k, 3, 3) rotations about z by degrees (k,)."""
    turns = np.asarray(degrees, float).reshape(-1, 1) * [0.0, 0.0, 1.0]
    return Rotation.from_rotvec(np.deg2rad(turns)).as_matrix()


@pytest.mark.parametrize("ways", [1, 2, 4])
def test_the_labels_of_a_symmetric_board_are_found_from_the_flange_poses(ways):
    seen, flange, expected = symmetric_views(ways, 12, np.random.default_rng(ways))
    labels = agreeing_labels(np.linalg.inv(seen), flange)
    np.testing.assert_array_equal((labels - labels[0]) % ways, (expected - expected[0]) % ways)


def test_a_chessboard_that_is_symmetric_under_half_a_turn_is_imported(tmp_path):
    """The camera is rolled by half a turn in every second image; the detector sees the same board in all of them."""
    import cv2

    scene = tmp_path / "scene.toml"
    scene.write_text(_BOARDS.replace("columns = 9", "columns = 8"))
    truth = render(scene, tmp_path / "rendered", lambda text: None)["truth"]
    boards = np.array([_pose(place["T_camera_board"]) for place in truth["boards"]])
    images = sorted((tmp_path / "rendered" / "images").iterdir())
    for path in images[::2]:
        cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)[::-1, ::-1])
    boards[::2] = np.diag([-1.0, -1.0, 1.0, 1.0]) @ boards[::2]
    flange = _BOARD @ np.linalg.inv(boards) @ np.linalg.inv(_HAND_EYE)
    rows = [
        (*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_euler("zyx", degrees=True), path.name)
        for pose, path in zip(flange, images)
    ]
    table = write_rows(tmp_path / "p.csv", ["X", "Y", "Z", "A", "B", "C", "image"], rows)
    board = {"kind": "chessboard", "columns": 8, "rows": 6, "square_mm": 12.0}
    sources = [tmp_path / "rendered" / "images", table]
    made = import_recording(sources, tmp_path / "out", ImportOptions(board=board))
    assert made.fits[0].is_good
    np.testing.assert_allclose(made.recording.flange, flange, atol=1e-5)


@pytest.mark.parametrize("content, found", [(b"no image", "cannot decode"), (None, "breaks off")])
def test_an_image_that_cannot_be_read_is_named_with_a_remedy(hand_eye, tmp_path, content, found):
    folder, truth = hand_eye
    images = tmp_path / "photos"
    images.mkdir()
    for path in sorted((folder / "images").iterdir()):
        (images / path.name).write_bytes(path.read_bytes())
    whole = path.read_bytes()
    (images / path.name).write_bytes(whole[: len(whole) // 3] if content is None else content)
    rows = [(*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()) for pose in truth.flange]
    table = write_rows(tmp_path / "p.csv", ["x", "y", "z", "qx", "qy", "qz", "qw"], rows)
    with pytest.raises(InputError, match=found) as refusal:
        import_recording([images, table], tmp_path / "out", ImportOptions(board=dict(truth.board)))
    assert str(refusal.value).startswith(f"{path.name}: ")
    assert "remove it and its row" in str(refusal.value)


MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
MISTAKES = {
    "looks mirrored, left-handed": lambda poses: MIRROR @ poses @ MIRROR,
    "the sign of column Y looks reversed": lambda poses: poses * _row_signs(1),
    "shifted by one row: each image has the pose of the image before": lambda p: np.roll(p, 1, 0),
}


def _row_signs(axis):
    signs = np.ones((4, 4))
    signs[axis, 3] = -1.0
    return signs


@pytest.mark.parametrize("words", MISTAKES)
def test_a_mistake_of_all_poses_is_named_with_the_columns_of_the_table(hand_eye, tmp_path, words):
    folder, truth = hand_eye
    images = [row["image"].rpartition("/")[2] for row in truth.images]
    rows = [
        (*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat(), image)
        for pose, image in zip(MISTAKES[words](truth.flange), images)
    ]
    columns = ["X", "Y", "Z", "qx", "qy", "qz", "qw", "image"]
    path = write_rows(tmp_path / "p.csv", columns, rows)
    with pytest.raises(InputError, match=words):
        import_recording(
            [folder / "images", path], tmp_path / "out", ImportOptions(board=truth.board)
        )
