"""Hand-eye data without headers: two sets of poses below each other, and flange poses with the centres of a ball."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.importing.target_poses.layouts import two_pose_sets

ROWS = 16


def flange_poses(rng) -> tuple[np.ndarray, Rotation]:
    """Origins (n, 3) mm and rotations of a flange above a table."""
    down = Rotation.from_euler("x", 180, degrees=True)
    turned = Rotation.from_rotvec(rng.normal(size=(ROWS, 3)) * 0.35) * down
    return rng.normal(size=(ROWS, 3)) * [90, 110, 60] + [640, -80, 510], turned


def poses_of_target(origins, turned) -> tuple[np.ndarray, Rotation]:
    """The pose of a fixed board in a camera on the flange."""
    camera = Rotation.from_euler("xyz", [4, -7, 88], degrees=True)
    board = Rotation.from_euler("xyz", [170, 5, 30], degrees=True)
    seen = (turned * camera).inv()
    places = np.array([600.0, 20.0, 5.0]) - origins - turned.apply([35.0, -20.0, 80.0])
    return seen.apply(places), seen * board


def written(path, blocks, separator=" "):
    text = "\n\n".join(
        "\n".join(separator.join(f"{value:.8g}" for value in row) for row in block)
        for block in blocks
    )
    path.write_text(text + "\n")
    return path


def matrices(origins, turned) -> np.ndarray:
    """(n, 4, 4) m."""
    made = np.tile(np.eye(4), (len(origins), 1, 1))
    made[:, :3, :3], made[:, :3, 3] = turned.as_matrix(), origins / 1000
    return made


@pytest.mark.parametrize("as_matrices", [False, True])
def test_two_blocks_of_one_file_are_flange_and_target(tmp_path, as_matrices):
    rng = np.random.default_rng(1)
    origins, turned = flange_poses(rng)
    places, turns = poses_of_target(origins, turned)
    noise = Rotation.from_rotvec(rng.normal(size=(ROWS, 3)) * 1e-3)
    sets = (origins, turned), (places + rng.normal(size=(ROWS, 3)) * 0.1, noise * turns)
    if as_matrices:
        blocks = [matrices(*one).reshape(-1, 4) for one in sets]
    else:
        blocks = [np.column_stack([places / 1000, turns.as_quat()]) for places, turns in sets]
    path = written(tmp_path / "pairs.txt", blocks)
    made = import_recording([path], tmp_path / "out", ImportOptions())
    assert made.recording.measures == "target-pose" and made.recording.n == ROWS
    assert made.fits[0].rms_mm < 2
    options = ImportOptions(mapping=made.mapping)
    again = import_recording([path], tmp_path / "again", options)
    assert again.recording.n == ROWS


def test_one_set_of_matrices_is_no_pair():
    cells = matrices(*flange_poses(np.random.default_rng(2))).reshape(-1, 4)
    columns = {f"column {k}": cells[:, k - 1] for k in range(1, 5)}
    table = RawTable("poses.txt", columns, np.arange(1, len(cells) + 1))
    assert two_pose_sets([table], Mapping()) is None


@pytest.mark.parametrize("files", [1, 2])
def test_poses_and_centres_of_a_ball_are_found(tmp_path, files):
    rng = np.random.default_rng(3)
    origins, turned = flange_poses(rng)
    sensor = Rotation.from_euler("zyx", [60, 3, -4], degrees=True)
    sight = rng.normal(size=(ROWS, 3)) * [9, 8, 6] + [0, 0, 190]
    fixed = np.array([620.0, -90.0, 35.0])
    origins = fixed - turned.apply(sensor.apply(sight) + [12.0, 40.0, 66.0])
    seen = sight + rng.normal(size=(ROWS, 3)) * 0.02
    poses = np.column_stack([origins, turned.as_quat()[:, [3, 0, 1, 2]]])
    if files == 2:
        paths = [
            written(tmp_path / "robot.txt", [poses], ", "),
            written(tmp_path / "scanner.txt", [seen]),
        ]
    else:
        both = np.column_stack([np.arange(1, ROWS + 1), poses, seen])
        paths = [written(tmp_path / "both.txt", [both], ";")]
    made = import_recording(paths, tmp_path / "out", ImportOptions())
    assert made.recording.measures == "ball-centre"
    assert made.mapping.flange_rotation.convention == "quaternion wxyz"
    assert made.fits[0].rms_mm < 0.1
    assert any("No header names flange poses" in said for said in made.warnings)


def test_centres_that_keep_no_ball_in_place_are_not_read(tmp_path):
    rng = np.random.default_rng(4)
    origins, turned = flange_poses(rng)
    cells = np.column_stack([origins, turned.as_quat(), rng.normal(size=(ROWS, 3)) * 10])
    path = written(tmp_path / "both.txt", [cells])
    with pytest.raises(Exception, match="joint readings"):
        import_recording([path], tmp_path / "out", ImportOptions())


@pytest.mark.parametrize("by_columns", [False, True])
def test_matrices_of_16_numbers_in_two_files_are_flange_and_target(tmp_path, by_columns):
    """Eigen and MATLAB write a matrix column by column, other programs row by row."""
    rng = np.random.default_rng(5)
    origins, turned = flange_poses(rng)
    places, turns = poses_of_target(origins, turned)
    noise = Rotation.from_rotvec(rng.normal(size=(ROWS, 3)) * 1e-3)
    target = matrices(places + rng.normal(size=(ROWS, 3)) * 0.1, noise * turns)
    paths = []
    for name, poses in (
        ("arm_poses.txt", matrices(origins, turned)),
        ("pattern_poses.txt", target),
    ):
        poses = poses.transpose(0, 2, 1) if by_columns else poses
        paths.append(written(tmp_path / name, [poses.reshape(-1, 16)]))
    made = import_recording(paths, tmp_path / "out", ImportOptions())
    assert made.recording.measures == "target-pose" and made.fits[0].rms_mm < 2
    np.testing.assert_allclose(made.recording.flange[:, :3, 3], origins, atol=1e-2)
    np.testing.assert_allclose(made.recording.points, 1000 * target[:, :3, 3], atol=1e-2)


def test_equal_rotations_are_the_reason_why_no_reading_is_chosen(tmp_path):
    rng = np.random.default_rng(6)
    origins, turned = flange_poses(rng)
    turned = Rotation.from_quat(np.tile(turned[0].as_quat(), (ROWS, 1)))
    places, turns = poses_of_target(origins, turned)
    sets = (origins, turned), (places + rng.normal(size=(ROWS, 3)) * 3, turns)
    blocks = [np.column_stack([places / 1000, turns.as_quat()]) for places, turns in sets]
    with pytest.raises(InputError, match="the flange only moved and never turned"):
        import_recording(
            [written(tmp_path / "pairs.txt", blocks)], tmp_path / "out", ImportOptions()
        )


def test_rotations_in_another_frame_than_the_positions_are_left_out_with_the_reason(tmp_path):
    rng = np.random.default_rng(5)
    turned = Rotation.random(20, rng)
    origins = rng.uniform(-0.5, 0.5, (20, 3))
    base, tool = Rotation.from_euler("xyz", [0.01, -0.02, 0.6]), Rotation.from_rotvec([0.4, 1, 0.2])
    points = base.apply(origins + turned.apply([0.02, 0.01, 0.35])) * 1000 + [6000.0, 4000.0, -600]
    quarter = Rotation.from_euler("z", 90, degrees=True)
    angles = (quarter * base * turned * tool).as_euler("xyz")
    numbers = np.arange(1, 21)[:, None]
    np.savetxt(
        tmp_path / "first.txt", np.hstack([numbers, origins, turned.as_rotvec()]), "%.6f", ","
    )
    np.savetxt(tmp_path / "second.txt", np.hstack([numbers, points, angles]), "%.6f")
    files = [tmp_path / "first.txt", tmp_path / "second.txt"]
    made = import_recording(files, tmp_path / "out", ImportOptions())
    assert made.recording.measures == "external-point" and made.fits[0].rms_mm < 0.05
    (reason,) = made.suspicions
    assert "the rotations agree, and the positions scatter by" in reason
    assert "second: column 5" in reason and "are left out" in reason
    again = import_recording(files, tmp_path / "again", ImportOptions(mapping=made.mapping))
    assert np.allclose(again.recording.columns["x_mm"], points[:, 0], atol=1e-3)
    stated = ImportOptions(mapping=Mapping(measures="target-pose"))
    with pytest.raises(InputError, match="flange rotation vector in radians, m; target") as found:
        import_recording(files, tmp_path / "stated", stated)
    assert "in radians, mm" in str(found.value)
