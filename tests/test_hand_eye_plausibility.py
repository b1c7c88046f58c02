"""Plausibility of hand-eye recordings before a fit: relative motions, equal poses, size of the board."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import datasets
import hand_eye_recordings as recordings
from sensors.hand_eye.checks.relative_motions import (
    displacement_px,
    equal_poses,
    relative_motions,
    scale_gap,
    wrong_equal_poses,
)
from workbench.commands import cli
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, transform
from workbench.recordings.inspection import inspect_recording

COUNT = 14


def rigid(random, angle, away):
    """(COUNT, 4, 4) random poses."""
    turns = Rotation.from_rotvec(random.uniform(-angle, angle, (COUNT, 3))).as_matrix()
    return transform(turns, random.uniform(-away, away, (COUNT, 3)))


def seen_by(flange, kind, random, scale=1.0):
    """(COUNT, 4, 4) board poses in the camera, their lengths `scale` times too large, for a random hand-eye."""
    sensor, board = rigid(random, 2.0, 150.0)[0], rigid(random, 1.0, 600.0)[0]
    chain = flange if kind == "in-hand" else inverse(flange)
    seen = inverse(chain @ sensor) @ board
    seen[:, :3, 3] *= scale
    return seen


@pytest.mark.parametrize("kind", ["in-hand", "to-hand"])
@pytest.mark.parametrize("scale", [1.0, 0.96, 25.4])
def test_relative_motions_do_not_depend_on_the_hand_eye(kind, scale):
    for seed in range(4):
        random = np.random.default_rng(seed)
        flange = rigid(random, 0.6, 300.0)
        found = relative_motions(flange, seen_by(flange, kind, random, scale), kind)
        assert found.angle_gap_deg < 1e-6
        assert found.scale == pytest.approx(scale, rel=1e-6)
        assert (scale_gap(found) is None) == (scale == 1.0)


def test_noise_of_board_poses_makes_no_wrong_size():
    """1 % of wrong verdicts would show in 60 sets: 0.2 mm and 0.03 deg of noise, a board of the right size."""
    random = np.random.default_rng(5)
    for _ in range(60):
        flange = rigid(random, 0.5, 200.0)
        seen = seen_by(flange, "in-hand", random)
        noise = Rotation.from_rotvec(np.deg2rad(0.03) * random.normal(size=(COUNT, 3))).as_matrix()
        seen = seen @ transform(noise, 0.2 * random.normal(size=(COUNT, 3)))
        assert scale_gap(relative_motions(flange, seen, "in-hand")) is None


def looks_at_the_middle(random, count, spread, scale=1.0):
    """Flange (count, 4, 4) and board poses of a camera 300 mm from the middle of the board, moved by up to `spread` mm.

    1 sigma of the arm: 0.05 mm and 0.004 deg; of the board in the camera: 0.02 mm, along the line of sight 0.08 mm.
    """
    turns = Rotation.from_rotvec(random.uniform(-1, 1, (count, 3)) * [0.35, 0.35, 1.2]).as_matrix()
    seen = transform(turns, [0, 0, 300] + random.uniform(-spread, spread, (count, 3)))
    spins = Rotation.from_rotvec(random.normal(0, 7.5e-5, (count, 3))).as_matrix()
    arm = transform(spins, random.normal(0, 0.05, (count, 3)))
    board, sensor = rigid(random, 1.0, 600.0)[0], rigid(random, 2.0, 150.0)[0]
    flange = board @ arm @ inverse(seen) @ inverse(sensor)
    seen[:, :3, 3] += random.normal(0, 1, (count, 3)) * [0.02, 0.02, 0.08]
    seen[:, :3, 3] *= scale
    return flange, seen


@pytest.mark.parametrize("count", [5, 10, 20, 50])
@pytest.mark.parametrize("spread", [0.0, 1.0, 3.0])
def test_a_camera_that_looks_at_the_middle_has_no_wrong_size(count, spread):
    """Positions that hardly change say nothing of lengths: at most 1 wrong verdict in 100 recordings."""
    random = np.random.default_rng(11)
    found = [
        relative_motions(*looks_at_the_middle(random, count, spread), "in-hand") for _ in range(60)
    ]
    assert sum(scale_gap(one) is not None for one in found) == 0
    assert all(one.scale_low < 1 < one.scale_high for one in found)
    if spread == 0:
        assert all(np.isnan(one.scale) and np.isinf(one.scale_high) for one in found)


@pytest.mark.parametrize("count", [10, 20])
def test_a_wrong_size_is_found_at_ordinary_poses(count):
    random = np.random.default_rng(12)
    for _ in range(30):
        found = relative_motions(*looks_at_the_middle(random, count, 20.0, 1.04), "in-hand")
        assert scale_gap(found) is not None
        assert found.scale == pytest.approx(1.04, abs=5 * found.scale_std)


def test_images_of_other_poses_have_other_angles():
    random = np.random.default_rng(3)
    flange = rigid(random, 0.6, 300.0)
    seen = seen_by(flange, "in-hand", random)
    assert relative_motions(flange, np.roll(seen, 1, 0), "in-hand").angle_gap_deg > 5


def test_equal_poses_are_found_once():
    flange = rigid(np.random.default_rng(0), 0.6, 300.0)
    flange[5] = flange[9] = flange[2]
    assert equal_poses(flange) == [(2, 5), (2, 9)]


def test_a_rotation_of_the_board_about_its_middle_is_a_displacement():
    x, y = np.meshgrid(np.arange(9) * 20.0, np.arange(6) * 20.0)
    corners = np.stack([x.ravel() - 80, y.ravel() - 50])
    rotated = Rotation.from_euler("z", 40, degrees=True).as_matrix()[:2, :2] @ corners
    seen = [SimpleNamespace(index=np.arange(54), pixels=pixels) for pixels in (corners, rotated)]
    assert displacement_px(*seen) > 20
    reversed_order = SimpleNamespace(index=np.arange(54), pixels=corners[:, ::-1])
    assert displacement_px(seen[0], reversed_order) == 0


@pytest.mark.parametrize(("mm", "is_wrong"), [(0.05, False), (5.0, True)])
def test_a_pose_that_was_taken_twice_is_no_mistake_in_a_fine_image(mm, is_wrong):
    """At 30 px/mm the repeatability of an arm moves the board of 40 mm by more than a pixel."""
    x, y = np.meshgrid(np.arange(9) * 5.0, np.arange(6) * 5.0)
    corners = 30 * np.stack([x.ravel(), y.ravel()])
    shift = 30 * mm * np.array([[1.0], [1.0]])
    seen = [SimpleNamespace(index=np.arange(54), pixels=one) for one in (corners, corners + shift)]
    found = wrong_equal_poses(np.stack([np.eye(4)] * 2), seen)
    assert bool(found) == is_wrong and displacement_px(*seen) > 2


def changed(recording, change):
    columns = {
        name: change(cells.copy()) if name.startswith("flange_") else cells
        for name, cells in recording.columns.items()
    }
    return replace(recording, columns=columns)


def with_equal_rows(cells):
    cells[5] = cells[2]
    return cells


@pytest.fixture(scope="module")
def right():
    return recordings.made("chessboard").recording


def test_a_right_recording_is_sufficient_for_a_hand_eye(right):
    made = inspect_recording(right)
    assert made.job == "handeye" and made.is_sufficient
    assert made.hand_eye.motions.scale == pytest.approx(1, abs=0.005)
    assert not any(need.is_mistake for need in made.needs)


def test_a_wrong_size_of_the_squares_is_found_by_check(right, tmp_path, capsys):
    board = {**right.board, "square_mm": 1.04 * right.board["square_mm"]}
    datasets.write(replace(right, board=board), tmp_path / "wrong")
    answer = tmp_path / "a.json"
    words = [
        "check",
        str(tmp_path / "wrong"),
        "--out",
        str(tmp_path / "out"),
        "--json",
        str(answer),
    ]
    assert cli.run(words) == 1
    result = json.loads(answer.read_text())
    assert (
        result["verdict"]["pass"] is False
        and "squares of the board look 1.0" in result["verdict"]["sentence"]
    )
    assert result["hand_eye"]["scale"] == pytest.approx(1.04, abs=0.005)
    assert "Not right for `workbench handeye`" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("change", [with_equal_rows, lambda cells: np.full_like(cells, cells[0])])
def test_equal_poses_of_different_images_are_refused_by_their_cause(right, tmp_path, change):
    from workbench.jobs.sensor import hand_eye

    wrong = changed(right, change)
    sentence = inspect_recording(wrong).sentence
    assert "images have a flange pose that another image has too" in sentence
    with pytest.raises(InputError, match="a flange pose that another image has too"):
        hand_eye.calibrate(wrong, None, None, lambda text: None)


def poses_table(recording, path):
    names = [name for name in recording.columns if name.startswith("flange_")]
    head = ["image", *(name.removeprefix("flange_") for name in names)]
    lines = [",".join(head)]
    for row, image in enumerate(recording.images):
        cells = [f"{recording.columns[name][row]:.9g}" for name in names]
        lines.append(",".join([image["image"].rpartition("/")[2], *cells]))
    path.write_text("\n".join(lines))
    return path


def test_import_names_equal_poses_and_a_wrong_size(right, tmp_path, capsys):
    images = str(right.folder / "images")
    table = poses_table(changed(right, with_equal_rows), tmp_path / "equal.csv")
    words = ["import", images, str(table), "--board", "chessboard 9x6 8mm", "--out"]
    assert cli.run([*words, str(tmp_path / "a")]) == 2
    assert "found the pose of an earlier row in 1 of 12 rows" in " ".join(
        capsys.readouterr().err.split()
    )
    words[2] = str(poses_table(right, tmp_path / "right.csv"))
    words[4] = "chessboard 9x6 8.32mm"
    answer = tmp_path / "answer.json"
    assert cli.run([*words, str(tmp_path / "b"), "--json", str(answer)]) == 0
    warnings = json.loads(answer.read_text())["warnings"]
    assert any("Lengths that the images show are 1.04 times" in one for one in warnings)
    words[4] = "chessboard 9x6 8mm"
    assert cli.run([*words, str(tmp_path / "c"), "--json", str(answer)]) == 0
    assert not any("Lengths" in one for one in json.loads(answer.read_text())["warnings"])
    capsys.readouterr()


def test_profiles_at_flange_poses_are_judged_for_a_hand_eye(tmp_path):
    from workbench.recordings.templates import write_template

    write_template("profiler", tmp_path / "profiler")
    made = inspect_recording(datasets.read(tmp_path / "profiler"))
    assert made.job == "handeye" and made.is_sufficient
