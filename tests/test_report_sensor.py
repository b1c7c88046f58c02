"""Pages of the sensor's commands: complete, self-contained, in plain numbers, and true to what they show."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from sensor_recordings import handeye_recording, scanner_recording
from sensors.camera.model import Camera
from workbench.report import sections, style
from workbench.report.page import write_sheet
from workbench.report.sections import Page, Section
from workbench.report.sensor import field, space


def own_text(page: str) -> str:
    """The page without scripts, data and images."""
    return re.sub(r'<script.*?</script>|<style>.*?</style>|data:image/[^"]*', "", page, flags=re.S)


def figures(page: str) -> dict:
    found = re.findall(
        r'<script type="application/json" data-for="([\w-]+)">(.*?)</script>', page, flags=re.S
    )
    return {name: json.loads(data) for name, data in found}


@pytest.fixture(scope="session")
def pages(tmp_path_factory):
    """`pages(command)`: the text of each command's page on the rendered recordings."""
    home, made = tmp_path_factory.mktemp("pages"), {}

    def of(command) -> str:
        if command not in made:
            (home / command).mkdir()
            made[command] = write_sheet(PAGES[command](home / command), home / command).read_text(
                encoding="utf-8"
            )
        return made[command]

    return of


def camera_page(folder: Path) -> Page:
    import datasets
    from workbench.jobs.sensor import camera
    from workbench.report.sensor.camera import page

    return page(camera.calibrate(datasets.read(scanner_recording()[0]), "brown", lambda text: None))


def scans(folder: Path):
    import datasets
    from workbench.jobs.sensor import scan

    return scan.scan(datasets.read(scanner_recording()[0]), None, folder, lambda text: None)


def scan_page(folder: Path) -> Page:
    from workbench.report.sensor.scan import page

    return page(scans(folder))


def handeye_page(folder: Path) -> Page:
    import datasets
    from workbench.jobs.sensor import hand_eye
    from workbench.report.sensor.handeye import page

    return page(
        hand_eye.calibrate(datasets.read(handeye_recording()[0]), None, None, lambda text: None)
    )


PAGES = {"camera": camera_page, "scan": scan_page, "handeye": handeye_page}
SHOWN = {
    "camera": {
        "perimage",
        "coverage",
        "arrows",
        "mapu",
        "mapv",
        "sigma",
        "halves",
        "bow",
        "bowsigma",
    },
    "scan": {
        "form",
        "ballmap0",
        "clouds3d",
        "space3d",
        "stripemap",
        "persteps",
        "camera-perimage",
        "camera-bow",
    },
    "handeye": {"perpose", "space3d"},
}


@pytest.mark.parametrize("command", PAGES)
def test_page_is_complete_and_asks_for_nothing_from_the_network(command, pages):
    page = pages(command)
    assert SHOWN[command] <= figures(page).keys()
    assert all(figure["data"] for figure in figures(page).values())
    assert len(re.findall(r"\* plotly\.js v", page)) == 1
    assert not re.search(
        r'<script[^>]+src=|<link[^>]+href="http|@import|url\(|https?://', own_text(page)
    )


@pytest.mark.parametrize("command", PAGES)
def test_every_anchor_of_the_page_is_there_once(command, pages):
    page = own_text(pages(command))
    names = re.findall(r'id="([\w-]+)"', page)
    assert len(names) == len(set(names))
    assert set(re.findall(r'href="#([\w-]+)"', page)) <= set(names)


@pytest.mark.parametrize("command", PAGES)
def test_no_number_is_longer_than_a_person_reads(command, pages):
    text = re.sub(r"[0-9a-f]{40,}", "", own_text(pages(command)))  # the hash of the data
    assert re.findall(r"\d\.\d{8,}", text) == []
    assert "nan" not in re.findall(r"[a-z]+", text) and "None" not in text


@pytest.mark.parametrize("command", PAGES)
def test_every_flat_figure_has_axes_with_units(command, pages):
    for name, figure in figures(pages(command)).items():
        if "scene" in figure["layout"]:
            continue
        titles = [figure["layout"][axis]["title"]["text"] for axis in ("xaxis", "yaxis")]
        assert all(titles) and any(
            re.search(r"\((px|mm|µm|deg)\)|px|mm|step|points", title) for title in titles
        ), name


def test_text_of_a_recording_cannot_become_markup(pages):
    assert "small scanner &lt;for&gt; tests" in pages(
        "camera"
    ) and "small scanner <for>" not in own_text(pages("camera"))


def test_camera_page_says_what_opencv_counts_and_what_is_held_out(pages):
    text = own_text(pages("camera"))
    assert (
        "RMS reprojection error (2-D, as in OpenCV)" in text
        and "cv2.calibrateCamera" in text
        and "Height difference between highest and lowest point" in text
    )


def test_scan_page_says_what_is_not_determined(pages):
    text = own_text(pages("scan"))
    assert "P_Form.Sph.D95%:SMV.SV:O3D" in text and "Flat form: no plane was measured." in text
    assert "clouds/1.ply" in text


def test_blocks_are_drawn_in_their_order(tmp_path):
    blocks = (
        sections.words("plain <b>"),
        sections.words("soft", quiet=True),
        sections.facts([("a", "1"), ("b", "")]),
        sections.table(["x", "y"], [("one", 2)]),
        sections.note("Mind", ["this"]),
        sections.links([("a.html", "there")]),
        sections.figure("f", style.figure(200, "x (mm)", "y (mm)"), "caption"),
    )
    page = Page(
        "over",
        "title",
        (("n", "1.0", "mm"),),
        ("lead",),
        (Section("s", "S", blocks),),
        warning="careful",
    )
    text = write_sheet(page, tmp_path).read_text(encoding="utf-8")
    for part in (
        "plain &lt;b&gt;",
        '<p class="quiet">soft</p>',
        "<td>1</td>",
        '<td class="n">2</td>',
        "<li>this</li>",
        '<a href="a.html">there</a>',
        "<dd>1.0<span> mm</span></dd>",
        '<p class="warning">careful</p>',
    ):
        assert part in text
    assert '<th scope="row">b</th>' not in text  # a fact without words is none


def test_an_image_that_cannot_be_read_has_no_thumbnail(tmp_path):
    import cv2

    (tmp_path / "broken.png").write_bytes(b"\x89PNG")
    cv2.imwrite(str(tmp_path / "good.png"), np.zeros((600, 800), np.uint8))
    assert sections.thumbnail(tmp_path / "broken.png") == ""
    assert sections.thumbnail(tmp_path / "good.png").startswith("data:image/jpeg;base64,")


def test_arrows_are_the_residuals_times_the_stated_scale():
    random = np.random.default_rng(1)
    pixels, residual = random.uniform(0, 400, (2, 50)), random.normal(0, 0.1, (2, 50))
    made, scale = field.arrows(pixels, residual, (640, 480))
    path = np.array([made.data[0].x, made.data[0].y]).reshape(2, 50, 3)
    assert np.allclose(path[:, :, 1] - path[:, :, 0], scale * residual, atol=0.02)
    assert float(f"{scale:e}".split("e")[0]) in (1, 2, 5)


def test_a_map_is_the_mean_of_its_cells_and_empty_where_nothing_is():
    pixels = np.array([[10.0, 11, 12, 600], [10, 11, 12, 400]])
    u, v, mean = field.cells(pixels, np.array([1.0, 2, 3, 9]), (640, 480), cell_count=4)
    assert mean.shape == (3, 4) and mean[0, 0] == 2 and np.isnan(np.delete(mean.ravel(), 0)).all()
    assert u[0] == pytest.approx(79.5) and v[0] == pytest.approx(79.5)


def test_field_map_is_symmetric_about_nought():
    made = field.residual_map(np.tile([[5.0], [5.0]], 9), np.full(9, 0.2), (64, 48), "mean")
    assert made.data[0].zmin == -made.data[0].zmax == pytest.approx(-0.2)


def test_patches_of_a_light_plane_lie_in_it_and_in_the_field():
    camera = Camera(1000.0, 1000.0, 320.0, 240.0, size=(640, 480))
    plane = np.array([[0.9], [0.01], [0.4], [-50.0]])
    plane /= np.linalg.norm(plane[:3])
    corners = space.patches(plane, camera, 100, 150)[0]
    assert np.allclose(corners @ plane[:3, 0] + plane[3, 0], 0)
    assert sorted(set(corners[:, 2])) == [100, 150]


def test_pyramid_passes_through_the_corners_of_the_image():
    camera = Camera(1000.0, 1000.0, 320.0, 240.0, size=(640, 480))
    path = space.pyramid(camera, 100.0)
    pixels = camera.project(path[1:3].T)
    assert np.allclose(pixels, [[-0.5, 639.5], [-0.5, -0.5]])


def test_front_page_links_both_reports(tmp_path):
    from workbench.report.front import page

    table = {
        "held_out": {"rms_mm": 0.07},
        "nominal": {"rms_mm": 0.8},
        "samples": 3000,
        "run": tmp_path / "tracker",
    }
    made = page(tmp_path, None, table, "Recording: x.")
    text = write_sheet(made, tmp_path).read_text(encoding="utf-8")
    assert 'href="tracker/report.html"' in text and "0.0700" in text


def test_time_left_is_shown_once_there_is_an_estimate():
    from workbench.machine.progress import paced

    said, seconds = [], iter([0.0, 1.0, 10.0, 20.0])
    tick = paced(said.append, "image", lambda: next(seconds))
    for done in (1, 2, 4):
        tick(done, 4)
    assert said == ["image 1 of 4", "image 2 of 4, about 18 s left", "image 4 of 4"]


@pytest.mark.parametrize(
    ("radii", "distances", "column", "numbers"),
    [
        ([10.0, 20.0], [50.0], None, [1, 3]),  # sizes tell them
        ([10.0], [], None, [None]),  # two balls of that size
        ([10.0], [], 2, [2]),  # the sample says so
        ([10.0, 10.1], [40.0], 2, [2, 1]),  # and the other by its distance
    ],
)
def test_balls_are_named_only_where_that_is_certain(radii, distances, column, numbers):
    from datasets.recording import Recording
    from workbench.files.images.ball_names import named

    balls = {1: (0.0, 0.0, 0.0, 10.0), 2: (40.0, 0.0, 0.0, 10.0), 3: (0.0, 90.0, 0.0, 20.0)}
    if numbers == [1, 3]:
        balls.pop(2)
    columns = {"sample": np.array([7.0])} | (
        {} if column is None else {"ball": np.array([float(column)])}
    )
    centres = [np.zeros(3), *(np.array([d, 0.0, 0.0]) for d in distances)]
    found, why = named(
        Recording("scan-images", columns, {}, balls=balls), {"sample": 7}, radii, centres
    )
    assert found == numbers and bool(why) == (None in numbers)


def test_distance_from_the_truth_is_that_after_one_rigid_motion():
    from workbench.core.rigid import rotation_matrix
    from workbench.files.images.ground_truth import centre_errors

    true = np.random.default_rng(4).uniform(-30, 30, (6, 3))
    moved = true @ rotation_matrix(np.array([0.01, 0.02, -0.01])).T + [0.1, 0.2, -0.3]
    rows = [
        {
            "scan": str(k),
            "balls": [
                {
                    "ball": 1,
                    **dict(zip(("x_mm", "y_mm", "z_mm"), c)),
                    "beyond_calibrated_depths": k == 5,
                }
            ],
        }
        for k, c in enumerate(moved)
    ]
    truth = {
        "scans": [
            {"scan": k, "balls": [{"ball": 1, "centre_mm": c.tolist()}]} for k, c in enumerate(true)
        ]
    }
    errors = centre_errors(rows, truth)
    assert errors["balls"] == 5 and errors["rms_mm"] < 1e-9
    assert centre_errors(rows[:2], truth)["rms_mm"] is None


def test_flange_poses_come_from_columns_or_from_joints():
    from datasets.recording import Recording
    from robot_model import load_robot
    from robot_model.chain import forward
    from workbench.files.images.flange import flange_poses

    q = np.deg2rad([[10.0, 20, -30, 40, 50, 60]])
    columns = {"sample": np.array([1.0])} | {f"q{k + 1}_deg": np.rad2deg(q[:, k]) for k in range(6)}
    robot = load_robot("abb_irb120")
    pose = flange_poses(Recording("board-images", columns, {"builtin": "abb_irb120"}))[0]
    frames = forward(robot, robot.mixing @ q.T)
    assert np.allclose(pose[:3, 3], frames.end_origin[:, 0]) and np.allclose(
        pose[:3, 0], frames.end[0][:, 0]
    )
    other = {
        "sample": np.array([1.0]),
        "flange_x_mm": np.array([1.0]),
        "flange_y_mm": np.array([2.0]),
        "flange_z_mm": np.array([3.0]),
        "flange_qw": np.array([1.0]),
        "flange_qx": np.zeros(1),
        "flange_qy": np.zeros(1),
        "flange_qz": np.zeros(1),
    }
    assert np.allclose(flange_poses(Recording("board-images", other, {}))[0][:3, 3], [1, 2, 3])


def test_sigmas_of_each_coordinate_are_used():
    from datasets.recording import Recording
    from robot_model.measurements.closure import position_sigma

    columns = {"sample": np.array([1.0, 2.0])} | {
        f"sigma_{a}_mm": np.full(2, s) for a, s in zip("xyz", (0.01, 0.02, 0.03))
    }
    recording = Recording("ball-centre", columns, {})
    assert (
        np.allclose(position_sigma(recording), [[0.01] * 2, [0.02] * 2, [0.03] * 2])
        and recording.covariates == {}
    )


def test_a_step_without_a_plane_is_left_out_and_said(tmp_path):
    from dataclasses import replace

    from workbench.jobs.sensor import scan

    made = scans(tmp_path)
    scanner = made.scanner
    kept = np.delete(np.arange(12), [5, 6])  # two of those that see the ball
    fewer = replace(
        scanner,
        steps=scanner.steps[kept],
        planes=scanner.planes[:, kept],
        mirror=None,
        angles=None,
        covariance=None,
    )
    groups = scan.scans_of(made.recording)
    (tmp_path / "again" / "clouds").mkdir(parents=True)
    found = scan._Work(made.recording, fewer, tmp_path / "again")(("1", groups["1"]))
    assert "2 of 12 images are at steps that the scanner has no plane for" in found.outcome
    assert 0 < found.points < made.scans[0].points


def test_bars_mark_the_faulty_and_the_median():
    made = field.bars(["a", "b"], np.array([0.1, 0.4]), "RMS (px)", np.array([False, True]))
    assert list(made.data[0].marker.color) == [style.BLUE, style.ORANGE]
    assert list(made.data[1].y) == [0.25, 0.25]
