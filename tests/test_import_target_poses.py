"""Import of flange poses and target poses: layouts, units, rotation conventions, place of the camera."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import datasets
from target_scenes import euler_deg, quaternions, rotation_vectors, target_scene
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, transform
from workbench.jobs.sensor.hand_eye import calibrate
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.templates import write_template

METRES = np.array([[1, 1, 1, 1000]] * 3 + [[1, 1, 1, 1]])


def _write(path: Path, cells, header="", separator=","):
    np.savetxt(path, cells, fmt="%.7f", delimiter=separator, header=header, comments="")
    return path


def _made(paths, tmp_path, **options):
    return import_recording(paths, tmp_path / "made", ImportOptions(**options))


def _check(paths, sensor, tmp_path, kind="in-hand"):
    recording = _made(paths, tmp_path).recording
    assert recording.measures == "target-pose"
    run = calibrate(recording, None, None, lambda text: None)
    assert run.made.kind == kind
    error = np.linalg.norm(run.made.sensor[:3, 3] - sensor[:3, 3])
    assert error < 5 * np.sqrt(np.trace(run.made.covariance[:3, :3]))


def test_two_tables_without_headers(tmp_path):
    flange, seen, sensor = target_scene(1)
    first = _write(tmp_path / "robot.csv", np.c_[flange[:, :3, 3], euler_deg(flange, "ZYX")])
    rotations = rotation_vectors(seen)
    second = _write(tmp_path / "camera.csv", np.c_[rotations, seen[:, :3, 3] / 1000])
    _check([second, first], sensor, tmp_path)


def test_one_table_without_headers_and_with_row_numbers(tmp_path):
    flange, seen, sensor = target_scene(2)
    cells = (np.arange(14), flange[:, :3, 3], rotation_vectors(flange), seen[:, :3, 3])
    path = _write(tmp_path / "poses.csv", np.c_[(*cells, euler_deg(seen, "xyz"))], separator=";")
    _check([path], sensor, tmp_path)


def test_matrices_below_each_other(tmp_path):
    flange, seen, sensor = target_scene(3)
    first = _write(tmp_path / "gripper.txt", (flange / METRES).reshape(-1, 4), separator=" ")
    second = _write(tmp_path / "board.txt", (seen / METRES).reshape(-1, 4), separator=" ")
    _check([first, second], sensor, tmp_path)


def test_records_of_moveit(tmp_path):
    flange, seen, sensor = target_scene(4)
    records = [
        {"effector_wrt_world": one.ravel().tolist(), "object_wrt_sensor": other.ravel().tolist()}
        for one, other in zip(flange / METRES, seen / METRES)
    ]
    path = tmp_path / "samples.yaml"
    path.write_text(yaml.safe_dump(records), encoding="utf-8")
    _check([path], sensor, tmp_path)


def test_transforms_of_ros_in_json(tmp_path):
    flange, seen, sensor = target_scene(5)

    def transforms(poses):
        for place, quaternion in zip(poses[:, :3, 3] / 1000, quaternions(poses)):
            yield {
                "translation": dict(zip("xyz", place.tolist())),
                "rotation": dict(zip("xyzw", quaternion.tolist())),
            }

    records = [
        {"robot": one, "optical": other} for one, other in zip(transforms(flange), transforms(seen))
    ]
    path = tmp_path / "samples.json"
    path.write_text(json.dumps(records), encoding="utf-8")
    _check([path], sensor, tmp_path)


def test_arrays_by_the_names_of_opencv(tmp_path):
    flange, seen, sensor = target_scene(6)
    np.savez(
        tmp_path / "poses.npz",
        R_gripper2base=flange[:, :3, :3],
        R_target2cam=seen[:, :3, :3],
        t_gripper2base=flange[:, :3, 3],
        t_target2cam=seen[:, :3, 3],
    )
    _check([tmp_path / "poses.npz"], sensor, tmp_path)


def test_two_series_of_pose_files_of_visp(tmp_path):
    flange, seen, sensor = target_scene(7)
    folder = tmp_path / "poses"
    folder.mkdir()
    for name, poses in (("rPe", flange), ("cPo", seen)):
        for number, cells in enumerate(np.c_[poses[:, :3, 3] / 1000, rotation_vectors(poses)], 1):
            lines = "".join(f"  - [{cell:.9f}]\n" for cell in cells)
            path = folder / f"pose_{name}_{number}.yaml"
            path.write_text(f"rows: 6\ncols: 1\ndata:\n{lines}", encoding="utf-8")
    _check([folder], sensor, tmp_path)


def test_two_tables_with_the_same_headers(tmp_path):
    flange, seen, sensor = target_scene(8)
    header = "x,y,z,qx,qy,qz,qw"
    paths = [
        _write(tmp_path / f"{name}.csv", np.c_[poses[:, :3, 3] / 1000, quaternions(poses)], header)
        for name, poses in (("marker", seen), ("robot", flange))
    ]
    _check(paths, sensor, tmp_path)


def test_a_stationary_camera_is_recognised(tmp_path):
    flange, seen, sensor = target_scene(9, kind="to-hand")
    header = "flange_x,flange_y,flange_z,flange_rx,flange_ry,flange_rz,tag_x,tag_y,tag_z,tag_qx,tag_qy,tag_qz,tag_qw"
    cells = np.c_[
        flange[:, :3, 3], euler_deg(flange, "xyz"), seen[:, :3, 3] / 1000, quaternions(seen)
    ]
    path = _write(tmp_path / "poses.csv", cells, header)
    _check([path], sensor, tmp_path, "to-hand")


def test_inverted_poses_of_the_target_are_recognised(tmp_path):
    flange, seen, sensor = target_scene(10)
    back = inverse(seen)
    first = _write(tmp_path / "robot.csv", np.c_[flange[:, :3, 3], euler_deg(flange, "ZYZ")])
    second = _write(tmp_path / "board.csv", np.c_[back[:, :3, 3], quaternions(back)])
    _check([first, second], sensor, tmp_path)


def test_the_mapping_of_an_import_repeats_it(tmp_path):
    from datasets.importers.mapping.model import read_mapping

    flange, seen, _ = target_scene(11)
    paths = [
        _write(tmp_path / f"{name}.csv", np.c_[poses[:, :3, 3], quaternions(poses)])
        for name, poses in (("robot", flange), ("camera", seen))
    ]
    first = _made(paths, tmp_path)
    mapping = read_mapping(tmp_path / "made" / "import.toml")
    again = import_recording(paths, tmp_path / "again", ImportOptions(mapping=mapping))
    assert np.array_equal(first.recording.points, again.recording.points)


def test_poses_that_do_not_belong_together_are_refused(tmp_path):
    flange, seen, _ = target_scene(12)
    turned = Rotation.random(14, random_state=3).as_quat()
    first = _write(tmp_path / "robot.csv", np.c_[flange[:, :3, 3], quaternions(flange)])
    second = _write(tmp_path / "camera.csv", np.c_[seen[:, :3, 3], turned])
    with pytest.raises(
        InputError, match="found none under any reading.*rotate by different angles"
    ):
        _made([first, second], tmp_path)


def test_a_wrong_row_is_named(tmp_path):
    flange, seen, _ = target_scene(13)
    seen[6, :3, 3] += [0, 40.0, 0]
    first = _write(tmp_path / "robot.csv", np.c_[flange[:, :3, 3], quaternions(flange)])
    second = _write(tmp_path / "camera.csv", np.c_[seen[:, :3, 3], quaternions(seen)])
    doubts = _made([first, second], tmp_path).suspicions
    assert len(doubts) == 1
    assert "row 7 " in doubts[0]


@pytest.mark.parametrize("header", ["", "q1,q2,q3,q4,q5,q6,x,y,z,rx,ry,rz"])
def test_joint_readings_next_to_a_pose_are_no_two_poses(tmp_path, header):
    """Twelve columns may be six joints and the pose of the flange; without a robot the import asks for it."""
    write_template("external-pose", tmp_path / "template", "ur10")
    columns = datasets.read(tmp_path / "template").columns
    joints = np.stack([columns[f"q{k}_deg"] for k in range(1, 7)], 1)
    points = np.stack([columns[f"{axis}_mm"] for axis in "xyz"], 1)
    quaternion = np.stack([columns[f"q{axis}"] for axis in "xyzw"], 1)
    angles = Rotation.from_quat(quaternion).as_euler("xyz", degrees=True)
    table = _write(tmp_path / "table.csv", np.c_[joints, points, angles], header)
    with pytest.raises(InputError) as refused:
        _made([table], tmp_path)
    assert "joint" in str(refused.value) and "flange poses" not in str(refused.value)
    made = _made([table], tmp_path / "named", robot="ur10").recording
    assert made.measures.startswith("external-")


def test_a_wrong_size_of_the_target_is_named_instead_of_a_question(tmp_path):
    """It makes both places of the camera fit about equally badly, which no answer to a question can repair."""
    flange, seen, _ = target_scene(2, count=20, sigma=(0.06, 0.0003))
    seen[:, :3, 3] *= 0.9
    paths = [
        _write(tmp_path / f"{name}.csv", np.c_[poses[:, :3, 3], quaternions(poses)], header)
        for name, poses, header in (
            ("robot", flange, "x_mm,y_mm,z_mm,qx,qy,qz,qw"),
            ("marker", seen, "x_mm,y_mm,z_mm,qx,qy,qz,qw"),
        )
    ]
    with pytest.raises(InputError, match="the target looks 1.11") as refused:
        _made(paths, tmp_path)
    assert "camera on the flange" in str(refused.value)


def test_a_camera_on_the_flange_is_no_question_of_inverted_poses_at_the_other_place(tmp_path):
    """Noise of the positions alone leaves as much of the model with inverted poses and a stationary camera."""
    flange, seen, _ = target_scene(15, count=12, sigma=(1.5, 0.0005))
    first = _write(tmp_path / "hand.csv", np.c_[flange[:, :3, 3], quaternions(flange)])
    second = _write(tmp_path / "eye.csv", np.c_[seen[:, :3, 3], quaternions(seen)])
    made = _made([first, second], tmp_path)
    assert made.mapping.board == {"fixed_to": "base"}
    assert not any("inverted" in fit.title for fit in made.fits[:1])


def test_exact_poses_are_no_question_of_inverted_ones(tmp_path):
    """Of computed poses, rounding is left of either model, and says nothing."""
    rng = np.random.default_rng(2)

    def poses(count, size):
        turns = Rotation.random(count, random_state=rng).as_matrix()
        return transform(turns, rng.uniform(-size, size, (count, 3)))

    (sensor, target), flange = poses(2, 500), poses(14, 500)
    seen = inverse(flange @ sensor) @ target
    cells = np.c_[flange[:, :3, 3], quaternions(flange), seen[:, :3, 3], quaternions(seen)]
    path = tmp_path / "poses.csv"
    np.savetxt(path, cells, fmt="%.17g", delimiter=",")
    made = _made([path], tmp_path)
    assert made.mapping.board == {"fixed_to": "base"}
    assert any("poses of the camera in the target" in warning for warning in made.warnings)


def test_two_tables_of_one_name_in_different_folders(tmp_path):
    flange, seen, sensor = target_scene(16)
    header = "x,y,z,qx,qy,qz,qw"
    paths = []
    for name, poses in (("marker", seen), ("robot", flange)):
        (tmp_path / name).mkdir()
        cells = np.c_[poses[:, :3, 3] / 1000, quaternions(poses)]
        paths.append(_write(tmp_path / name / "poses.csv", cells, header))
    _check(paths, sensor, tmp_path)
    mapping = import_recording(paths, tmp_path / "again", ImportOptions()).mapping
    assert mapping.flange_point.columns == ("robot/poses: x", "robot/poses: y", "robot/poses: z")
    assert mapping.point.columns == ("marker/poses: x", "marker/poses: y", "marker/poses: z")
