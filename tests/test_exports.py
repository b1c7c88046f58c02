"""Every export is read back and means the same; what a format cannot hold is said."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from export_scenes import flanges
from plain_frames import frames_of
from robot_model import load_robot
from scenes import ABB, ARMS, CRAIG
from sensors.camera.model import Camera
from workbench.core.errors import InputError
from workbench.files.exports import (
    CAMERA_FORMATS,
    camera_text,
    mdh_csv,
    mdh_json,
    read_camera_text,
    read_mdh,
    urdf,
)
from workbench.files.exports.camera import with_supported_distortion
from workbench.files.exports.hand_eye import read_hand_eye
from workbench.files.exports.mdh import calibrated_geometry
from workbench.files.solution_file import CalibratedArm

BROWN = Camera(3421.5, 3415.25, 640.5, 511.75, (-0.2, 0.11, 0.0013, -0.0021, 0.05), (1280, 1024))
RADTAN = Camera(3421.5, 3415.25, 640.5, 511.75, (-0.2, 0.11, 0.0013, -0.0021, 0.0), (1280, 1024))
RATIONAL = Camera(
    800.0, 801.0, 320.0, 240.0, (-0.2, 0.11, 0.0013, -0.0021, 0.05, 0.1, 0.02, 0.003), (640, 480)
)


def arm_of(spec, seed=0) -> CalibratedArm:
    """An arm with errors in every length and angle."""
    robot = load_robot(spec)
    rng = np.random.default_rng(seed)
    moved = robot.geometry + rng.normal(size=robot.geometry.shape) * [1e-2, 1, 1, 1e-2, 1e-2]
    values = {
        f"joint-{k + 1}.{name}{k + 1}": moved[k, c]
        for k in range(robot.joints)
        for c, name in enumerate(("theta", "d", "a", "alpha", "beta"))
    }
    return CalibratedArm(robot, (), values, (), np.zeros((0, 0)), np.zeros(3), 0.05, True, "", {})


@pytest.mark.parametrize("write", [mdh_json, mdh_csv])
@pytest.mark.parametrize("spec", ARMS.values(), ids=ARMS.keys())
def test_a_table_read_back_is_the_same_arm(spec, write):
    arm = arm_of(spec)
    np.testing.assert_allclose(
        read_mdh(write(arm), arm.robot), calibrated_geometry(arm), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("spec", ARMS.values(), ids=ARMS.keys())
def test_a_urdf_read_back_puts_the_flange_where_the_calibration_does(spec, tmp_path):
    arm = arm_of(spec)
    (tmp_path / "arm.urdf").write_text(urdf(arm))
    again = load_robot(tmp_path / "arm.urdf")
    rng = np.random.default_rng(1)
    readings = np.where(arm.robot.prismatic, 50, 1) * rng.uniform(-1, 1, (20, arm.robot.joints))
    expected = flanges(arm.robot, readings, calibrated_geometry(arm))
    coupled = np.count_nonzero(arm.robot.mixing) > arm.robot.joints
    own = readings @ arm.robot.mixing.T if coupled else readings
    np.testing.assert_allclose(flanges(again, own), expected, atol=1e-6)
    plain = np.array([frames_of(again, reading)[-1] for reading in own])
    np.testing.assert_allclose(plain, expected, atol=1e-6)


def test_coupled_joints_are_angles_between_links_and_the_file_says_how():
    rows = [dict(row) for row in CRAIG["joint"]]
    rows[2]["coupled"] = {"joint": 2, "ratio": 1.0}
    assert "joint_3 = 1 q2 + 1 q3" in urdf(arm_of(CRAIG | {"joint": rows}))
    assert "joint_3" not in urdf(arm_of(CRAIG)).split("-->")[0]


def test_a_table_of_another_arm_is_a_sentence():
    text = mdh_csv(arm_of(ABB))
    with pytest.raises(InputError, match="expected 6 joints"):
        read_mdh("\n".join(text.splitlines()[:-1]), load_robot(ABB))
    with pytest.raises(InputError, match="expected columns joint, theta_deg"):
        read_mdh("a,b\n1,2\n", load_robot(ABB))


@pytest.mark.parametrize("camera", [BROWN, RADTAN, RATIONAL], ids=["brown", "radtan", "rational"])
@pytest.mark.parametrize("name", CAMERA_FORMATS)
def test_a_camera_read_back_is_the_same(camera, name):
    if name == "kalibr" and camera is not RADTAN:
        with pytest.raises(InputError, match="radtan model does not have"):
            camera_text(camera, name)
        return
    again = read_camera_text(camera_text(camera, name), name)
    np.testing.assert_allclose(again.values, camera.values, rtol=1e-15)
    assert again.size == camera.size


def test_opencv_itself_reads_its_file(tmp_path):
    import cv2

    path = tmp_path / "camera.yml"
    path.write_text(camera_text(BROWN, "opencv"))
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_allclose(file.getNode("camera_matrix").mat(), BROWN.matrix)
    np.testing.assert_allclose(file.getNode("distortion_coefficients").mat()[0], BROWN.distortion)


def test_files_tell_the_four_coefficients_of_a_fisheye_from_k1_k2_p1_p2(tmp_path):
    """OpenCV's calibration sample names the model in `fisheye_model`, ROS in `distortion_model`."""
    import cv2

    values = [500.0, 500.0, 640.0, 480.0, 0.05, -0.02, 0.003, -0.001]
    fisheye, brown = Camera.of(values, (1280, 960)), Camera.of([*values, 0.0], (1280, 960))
    texts = {camera: camera_text(camera, "opencv") for camera in (fisheye, brown)}
    for camera, text in texts.items():
        path = tmp_path / "camera.yml"
        path.write_text(text)
        file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        assert file.getNode("fisheye_model").real() == camera.is_fisheye
        assert read_camera_text(text, "opencv") == camera
    short = camera_text(brown, "ros").replace(", 0.0]", "]", 1)
    assert len(short) < len(camera_text(brown, "ros"))
    assert read_camera_text(short, "ros") == brown
    assert read_camera_text(camera_text(fisheye, "ros"), "ros") == fisheye


@pytest.mark.parametrize("name", CAMERA_FORMATS)
@pytest.mark.parametrize("text", ["", "[1]", "cam0: {", "camera_matrix: 3"])
def test_a_broken_camera_file_is_a_sentence(name, text):
    with pytest.raises(InputError, match="camera file: expected"):
        read_camera_text(text, name)


def test_kalibr_gets_the_nearest_camera_that_it_can_hold():
    """A calibrated camera always has a third radial term, which radtan lacks: said in px, by OpenCV's own projection."""
    import cv2

    held, off = with_supported_distortion(BROWN, "kalibr")
    again = read_camera_text(camera_text(held, "kalibr"), "kalibr")
    np.testing.assert_array_equal(again.values, held.values)
    u, v = np.random.default_rng(0).uniform(0, 1, (2, 500)) * np.array([[1279], [1023]])
    points = BROWN.rays(np.stack([u, v])).T
    none = np.zeros(3)
    seen = [
        cv2.projectPoints(points, none, none, c.matrix, np.array(c.distortion))[0][:, 0]
        for c in (BROWN, again)
    ]
    assert 0 < np.linalg.norm(seen[0] - seen[1], axis=1).max() <= off < 1e-3
    np.testing.assert_allclose(seen[0], np.column_stack([u, v]), atol=1e-6)
    assert with_supported_distortion(RADTAN, "kalibr") == (
        RADTAN,
        0.0,
    ) and with_supported_distortion(BROWN, "ros") == (BROWN, 0.0)


def test_a_lens_that_kalibr_cannot_follow_is_refused():
    bent = Camera(500.0, 500.0, 320.0, 240.0, (-0.3, 0.15, 0.0, 0.0, -0.2), (640, 480))
    with pytest.raises(InputError, match="misses by .* px; export to ROS or OpenCV"):
        with_supported_distortion(bent, "kalibr")


def hand_eye_run(folder, kind="in-hand", **more):
    """A run folder of `workbench handeye` and its T_parent_sensor."""
    import tomli_w

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec([0.3, -1.2, 2.0]).as_matrix()
    matrix[:3, 3] = 12.5, -80.25, 1e-3
    keys = {
        "format": "hand-eye/1",
        "kind": kind,
        "transform": {"in-hand": "T_flange_sensor", "to-hand": "T_base_sensor"}[kind],
        "matrix": matrix.tolist(),
        "std_mm": [0.1, 0.1, 0.2],
        "std_deg": [0.01] * 3,
        "undetermined": [],
        "suspicions": [],
    }
    folder.mkdir(exist_ok=True)
    (folder / "hand-eye.toml").write_text(tomli_w.dumps(keys | more))
    return matrix


def ros_matrix(translation, rotation):
    """(4, 4) m of a geometry_msgs/Transform, by the textbook formula of a unit quaternion."""
    x, y, z, w = (float(rotation[k]) for k in "xyzw")
    turn = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = turn, [float(translation[k]) for k in "xyz"]
    return made


@pytest.mark.parametrize(("kind", "parent"), [("in-hand", "flange"), ("to-hand", "base")])
@pytest.mark.parametrize("source", ["run", "run/hand-eye.toml"])
def test_a_hand_eye_run_goes_to_ros(workbench, tmp_path, kind, parent, source):
    """It once ended with '[Errno 21] Is a directory'."""
    import yaml

    matrix = hand_eye_run(tmp_path / "run", kind)
    done = workbench("export", source, "--to", "ros", "--out", "he.yaml")
    assert done.returncode == 0, done.stderr
    keys = yaml.safe_load((tmp_path / "he.yaml").read_text())
    assert (keys["header"]["frame_id"], keys["child_frame_id"]) == (parent, "sensor")
    metres = matrix * np.array([[1, 1, 1, 1e-3]])
    metres[3, 3] = 1
    np.testing.assert_allclose(
        ros_matrix(keys["transform"]["translation"], keys["transform"]["rotation"]),
        metres,
        atol=1e-12,
    )
    node = yaml.safe_load((tmp_path / "he.launch.yaml").read_text())["launch"][0]["node"]
    assert (node["pkg"], node["exec"]) == ("tf2_ros", "static_transform_publisher")
    words = node["args"].split()
    options = dict(zip(words[::2], words[1::2]))
    assert (options["--frame-id"], options["--child-frame-id"]) == (parent, "sensor")
    rotation = {k: options[f"--q{k}"] for k in "xyzw"}
    np.testing.assert_allclose(
        ros_matrix({k: options[f"--{k}"] for k in "xyz"}, rotation), metres, atol=1e-12
    )
    assert done.stdout.strip().splitlines()[-2:] == ["he.launch.yaml", "he.yaml"]


def test_frames_are_named_by_the_user(workbench, tmp_path):
    import yaml

    hand_eye_run(tmp_path / "run")
    words = (
        "export",
        "run",
        "--to",
        "ros",
        "--out",
        "he.yaml",
        "--parent-frame",
        "tool0",
        "--child-frame",
    )
    assert workbench(*words, "camera_optical_frame").returncode == 0
    keys = yaml.safe_load((tmp_path / "he.yaml").read_text())
    assert (keys["header"]["frame_id"], keys["child_frame_id"]) == ("tool0", "camera_optical_frame")
    for name, sentence in (
        ("/camera", "expected a frame of ROS"),
        ("a b", "expected a frame of ROS"),
        ("tool0", "expected another frame"),
    ):
        done = workbench(*words, name)
        assert done.returncode == 2 and sentence in done.stderr


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (
            {"suspicions": ["the poses are permuted"]},
            "its recording is in doubt (the poses are permuted)",
        ),
        (
            {"std_mm": [0.1, float("inf"), 0.1], "undetermined": ["y is not known"]},
            "not determined (y is not known)",
        ),
    ],
)
def test_a_doubtful_hand_eye_is_exported_only_by_force(workbench, tmp_path, more, sentence):
    hand_eye_run(tmp_path / "run", **more)
    done = workbench("export", "run", "--to", "ros", "--out", "he.yaml")
    assert done.returncode == 2 and sentence in done.stderr and not (tmp_path / "he.yaml").exists()
    assert workbench("export", "run", "--to", "ros", "--out", "he.yaml", "--force").returncode == 0


@pytest.mark.parametrize(
    ("matrix", "transform"),
    [
        (np.eye(3).tolist(), "T_flange_sensor"),
        ((2 * np.eye(4)).tolist(), "T_flange_sensor"),
        ("x", "T_flange_sensor"),
        (np.diag([1.0, 1, -1, 1]).tolist(), "T_flange_sensor"),
        (np.eye(4).tolist(), "T_sensor_flange"),
    ],
)
def test_a_broken_hand_eye_file_is_a_sentence(tmp_path, matrix, transform):
    hand_eye_run(tmp_path / "run", matrix=matrix, transform=transform)
    with pytest.raises(InputError, match="hand-eye.toml, key"):
        read_hand_eye(tmp_path / "run" / "hand-eye.toml")


@pytest.mark.parametrize(
    ("files", "to", "words"),
    [
        (["hand-eye.toml"], "urdf", "it gives of its hand-eye transform ros"),
        (["camera.toml"], "mdh-csv", "it gives of its calibrated camera ros, opencv, kalibr"),
        (["solution.json"], "kalibr", "it gives of its calibrated arm urdf, mjcf, python, ros"),
        (
            ["solution.json", "camera.toml"],
            "none",
            "expected one of urdf, mjcf, python, ros, urscript, krl, rapid, fanuc, mdh-json, mdh-csv",
        ),
        (
            ["answer.json"],
            "ros",
            "expected a run folder of `workbench calibrate`, `camera`, `scanner` or `handeye`",
        ),
        ([], "urdf", "found none of them"),
    ],
)
def test_a_run_says_which_formats_it_can_give(workbench, tmp_path, files, to, words):
    (tmp_path / "run").mkdir()
    for name in files:
        (tmp_path / "run" / name).write_text("")
    done = workbench("export", "run", "--to", to, "--out", "x")
    assert done.returncode == 2 and words in done.stderr and "Errno" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1 and not (tmp_path / "x").exists()
