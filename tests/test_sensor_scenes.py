"""Scene files of the renderer, and the recordings that are made of them."""

import tomllib

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")

from conftest import ROOT
from datasets.formats.recording1 import read_recording
from sensors.camera.model import Camera, camera_from_keys
from sensors.rendering.places import board_poses
from sensors.rendering.recording import Stations, make_recording
from sensors.rendering.scene import read_scene
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_matrix, transform

TINY = """
title = "tiny"
balls = [[0.0, 0.0, 0.0, 8.0], [20.0, 0.0, 0.0, 6.0]]
[camera]
width_px = 160
height_px = 128
fx_px = 300.0
fy_px = 299.0
cx_px = 80.0
cy_px = 63.0
[laser]
width_mm = 0.6
[mirror]
steps = 3
first_deg = -1.0
last_deg = 1.0
both_ways = true
speed_deg_s = [2.0, 4.0]
[board]
columns = 5
rows = 4
square_mm = 6.0
[placements]
count = 3
laser = 2
[scans]
count = 2
"""


def scene_file(tmp_path, text):
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def tiny(tmp_path, more="", **replaced):
    text = TINY
    for old, new in replaced.items():
        assert old in text
        text = text.replace(old, new)
    return read_scene(scene_file(tmp_path, text + more))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The tiny scene as a recording: folder, scene, what came back."""
    folder = tmp_path_factory.mktemp("made")
    scene = tiny(folder)
    progress_calls = []
    truth = folder / "truth.toml"
    result = make_recording(
        scene,
        folder / "recording",
        lambda done, total: progress_calls.append((done, total)),
        truth=truth,
    )
    return folder / "recording", scene, result, progress_calls, tomllib.loads(truth.read_text())


def test_a_recording_is_read_back(made):
    folder, scene, result, progress_calls, _ = made
    recording = read_recording(folder)
    assert recording.measures == "scan-images"
    roles = [row["role"] for row in recording.images]
    assert [roles.count(role) for role in ("board", "board-laser", "scan")] == [3, 2 * 3, 2 * 3]
    assert recording.board == {"kind": "chessboard", "columns": 5, "rows": 4, "square_mm": 6.0}
    assert recording.balls == {1: (0, 0, 0, 8), 2: (20, 0, 0, 6)}
    assert progress_calls == [(k, 15) for k in range(1, 16)]
    assert len(result.images) == 15
    for row in recording.images:
        image = cv2.imread(str(folder / row["image"]), cv2.IMREAD_UNCHANGED)
        assert image.shape == (128, 160) and image.dtype == np.uint8


def test_its_rows_say_when_where_and_which_way(made):
    rows = [row for row in read_recording(made[0]).images if row["role"] != "board"]
    for row in rows:
        assert row["mirror_deg"] == pytest.approx(row["step"] - 1)
        assert 2 <= row["sweep"] * row["mirror_speed_deg_s"] <= 4
        place = int(row["placement"] or row["scan"])
        assert row["sweep"] == (-1 if place == 2 else 1)
        assert row["step"] in (0, 1, 2)
    for place in ("1", "2"):
        sweep = [row for row in rows if row.get("scan") == place]
        order = np.array([row["time_s"] for row in sweep]) * sweep[0]["sweep"]
        assert np.diff(order) == pytest.approx(1 / abs(sweep[0]["mirror_speed_deg_s"]), abs=2e-4)


def test_the_truth_says_where_everything_is(made):
    """Balls' silhouettes and the planes, from the truth file alone."""
    folder, scene, _, _, truth = made
    camera = camera_from_keys(truth["camera"], "truth")
    assert camera == scene.sees
    assert len(truth["planes"]) == 3 and len(truth["boards"]) == 3
    pose = np.array(truth["boards"][0]["T_camera_board"])
    corners = camera.project(
        rotation_matrix(pose[3:]) @ scene.board.pattern.board.points + pose[:3, None]
    )
    image = cv2.imread(str(folder / "images" / "board-001.png"), 0)
    found, seen = cv2.findChessboardCornersSB(image, (5, 4))
    assert found
    gap = np.linalg.norm(seen[:, 0].T[:, :, None] - corners[:, None], axis=0).min(1)
    assert gap.max() < 0.5
    scan = truth["scans"][1]
    pose, balls = (
        np.array(scan["T_camera_artefact"]),
        {ball["ball"]: ball for ball in scan["balls"]},
    )
    for number, (*place, radius) in enumerate(scene.balls, 1):
        if number in balls:
            centre = rotation_matrix(pose[3:]) @ place + pose[:3]
            np.testing.assert_allclose(balls[number]["centre_mm"], centre, atol=1e-9)
            assert balls[number]["radius_mm"] == radius
    assert 2 in balls  # the second scan looks at the second ball


def test_one_seed_one_recording(tmp_path, made):
    again = make_recording(tiny(tmp_path), tmp_path / "again")
    for row in again.images:
        assert (tmp_path / "again" / row["image"]).read_bytes() == (
            made[0] / row["image"]
        ).read_bytes()
    assert (tmp_path / "again" / "images.csv").read_text() == (made[0] / "images.csv").read_text()


def test_boards_at_random_show_their_whole_grid(tmp_path):
    scene = tiny(tmp_path)
    scene.placements.count = 50
    poses = board_poses(scene.placements, scene.board.pattern, scene.sees, np.random.default_rng(0))
    pixels = [
        scene.sees.project(rotation_matrix(p[3:]) @ scene.board.pattern.board.points + p[:3, None])
        for p in poses
    ]
    assert len(poses) == 50
    assert (np.min(pixels) > 0) and (np.max(pixels, axis=(0, 2)) < [159, 127]).all()
    tilts = np.rad2deg(np.arccos(rotation_matrix(poses[:, 3:])[:, 2, 2]))
    assert tilts.max() <= 30.1 and np.median(tilts) > 10


def test_an_arm_says_where_the_sensor_stands(tmp_path):
    """Its poses are the scans', its readings the samples', its robot the recording's."""
    turn = rotation_matrix(np.array([[0.1, 0, 0], [0, -0.1, 0.3]]))
    poses = transform(turn, -np.einsum("nij,j->ni", turn, [0, 0, 128.0]))
    columns = {"sample": np.array([4, 7]), "q1_deg": np.array([10.0, 20.0])}
    boards = transform(np.tile(np.eye(3), (2, 1, 1)), np.array([[-12.0, -9, 120], [-10, -9, 125]]))
    stations = Stations(
        poses,
        columns,
        section={"builtin": "abb_irb120"},
        boards=boards,
        board_samples=np.array([4, 7]),
    )
    made = make_recording(tiny(tmp_path), tmp_path / "made", stations=stations)
    assert [row["sample"] for row in made.images] == [4] * 4 + [7] * 4 + [4] * 3 + [7] * 3
    for scan, pose in zip(made.truth["scans"], poses):
        centre = np.array(scan["balls"][0]["centre_mm"])
        np.testing.assert_allclose(pose[:3, :3] @ centre + pose[:3, 3], 0, atol=1e-9)
    assert (tmp_path / "made" / "samples.csv").read_text().splitlines() == [
        "sample,q1_deg",
        "4,10.0",
        "7,20.0",
    ]
    keys = tomllib.loads((tmp_path / "made" / "recording.toml").read_text())
    assert keys["robot"] == {"builtin": "abb_irb120"} and keys["samples"] == {"file": "samples.csv"}


def test_a_profiler_has_one_plane_and_no_mirror(tmp_path):
    text = TINY[: TINY.index("[mirror]")] + TINY[TINY.index("[board]") :]
    plane = "[[plane]]\nnormal = [0.9, 0.0, 0.43]\noffset_mm = -55.0\n"
    scene = read_scene(scene_file(tmp_path, text + plane))
    made = make_recording(scene, tmp_path / "made")
    assert [row.get("step") for row in made.images if row["role"] == "scan"] == [0, 0]
    assert "mirror_deg" not in made.images[-1] and "sweep" not in made.images[-1]
    assert np.linalg.norm(made.truth["planes"][0]["normal"]) == pytest.approx(1)
    lit = [
        cv2.imread(str(tmp_path / "made" / row["image"]), 0).max()
        for row in made.images
        if row["role"] == "board-laser"
    ]
    assert min(lit) > 60
    assert read_recording(tmp_path / "made").n == 0


def test_boards_alone_are_a_recording_of_board_images(tmp_path):
    text = TINY[: TINY.index("[laser]")] + TINY[TINY.index("[board]") : TINY.index("[scans]")]
    make_recording(read_scene(scene_file(tmp_path, text)), tmp_path / "made")
    assert read_recording(tmp_path / "made").measures == "board-images"


def test_a_mesh_is_scanned(tmp_path):
    import open3d as o3d

    box = o3d.geometry.TriangleMesh.create_box(20, 20, 5).translate((-10, -10, 0))
    o3d.io.write_triangle_mesh(str(tmp_path / "box.stl"), box.compute_triangle_normals())
    text = TINY.replace("balls = [[0.0, 0.0, 0.0, 8.0], [20.0, 0.0, 0.0, 6.0]]\n", "")
    scene = read_scene(
        scene_file(tmp_path, text.replace("count = 3", "count = 0") + '[mesh]\nfile = "box.stl"\n')
    )
    made = make_recording(scene, tmp_path / "made")
    lit = [cv2.imread(str(tmp_path / "made" / row["image"]), 0).max() for row in made.images]
    assert max(lit) > 60


def test_temperature_is_a_ramp_that_stands_still_while_the_mirror_sweeps(tmp_path):
    made = make_recording(
        tiny(tmp_path, title="temperature_c = [20.0, 24.0]\ntitle"), tmp_path / "made"
    )
    warm = {(row["role"], row["placement"], row["scan"]): [] for row in made.images}
    for row in made.images:
        warm[row["role"], row["placement"], row["scan"]].append(row["temperature_c"])
    assert all(len(set(values)) == 1 for values in warm.values())
    ramp = [values[0] for values in warm.values()]
    assert ramp[0] == 20 and ramp[-1] == 24 and ramp == sorted(ramp)


@pytest.mark.parametrize("name", ["ye-scanner", "small-scanner"])
def test_the_example_scenes_are_read(name):
    scene = read_scene(ROOT / "docs" / "scenes" / f"{name}.toml")
    assert isinstance(scene.sees, Camera) and scene.causes.pairs
    assert len(scene.instrument.steps) == scene.mirror.steps


BAD = {
    "no camera": (lambda t: t.replace("fx_px = 300.0\n", ""), "key camera.fx_px: field required"),
    "text for a number": (lambda t: t.replace("300.0", '"long"'), "key camera.fx_px"),
    "an unknown key": (
        lambda t: t.replace("[mirror]", "[mirror]\ncolour = 3"),
        "key mirror.colour",
    ),
    "a ball without size": (
        lambda t: t.replace("8.0]", "0.0]"),
        "key balls.1: expected .x, y, z, radius.",
    ),
    "range the wrong way": (
        lambda t: t.replace("count = 3", "count = 3\nrange_mm = [150.0, 120.0]"),
        "key placements.range_mm",
    ),
    "plane and mirror": (
        lambda t: t + "[[plane]]\nnormal = [1.0, 0.0, 0.0]\noffset_mm = 1.0\n",
        "either .mirror. or",
    ),
    "scans of nothing": (
        lambda t: t[: t.index("balls")] + t[t.index("[camera]") :],
        "scans need balls or a mesh",
    ),
    "no such effect": (
        lambda t: t + EFFECT.format("gremlin", "mirror", "a"),
        "no effect is called 'gremlin'",
    ),
    "a wrong place": (
        lambda t: t + EFFECT.format("plane-bow", "mirror", "a"),
        "cannot sit at 'mirror'",
    ),
    "a wrong parameter": (
        lambda t: t + EFFECT.format("plane-bow", "laser", "a"),
        "expected curvature, found a",
    ),
    "a ball too many": (
        lambda t: t + EFFECT.format("ball-radius", "ball-3", "growth"),
        "one of 1, 2, found 'ball-3'",
    ),
    "a mesh that is not there": (
        lambda t: t + '[mesh]\nfile = "no.stl"\n',
        "key mesh.file: expected a file next to",
    ),
    "a board of nothing": (
        lambda t: t.replace("columns = 5", 'kind = "charuco"\ncolumns = 5'),
        "marker_mm and dictionary",
    ),
    "no toml": (lambda t: t + "[", "cannot be read"),
}
EFFECT = '[[effect]]\neffect = "{}"\nwhere = "{}"\nvalues = {{ {} = 1.0 }}\n'


@pytest.mark.parametrize("name", BAD)
def test_a_wrong_scene_is_a_sentence(tmp_path, name):
    change, sentence = BAD[name]
    path = scene_file(tmp_path, change(TINY))
    with pytest.raises(InputError, match=sentence) as caught:
        read_scene(path)
    assert "scene.toml" in str(caught.value) and "\n" not in str(caught.value)


def test_a_board_that_does_not_fit_is_a_sentence(tmp_path):
    scene = tiny(tmp_path, **{"square_mm = 6.0": "square_mm = 60.0"})
    with pytest.raises(InputError, match="expected a board that fits into the image"):
        make_recording(scene, tmp_path / "made")
