"""Cameras of more than 8 bits, or that clip below the end of their numbers: clipped pixels are known for what they are."""

import cv2
import numpy as np
import pytest
from scipy.special import erf

from datasets.recording import Recording
from sensors.boards.board import Board
from sensors.boards.detection import View
from sensors.camera.model import Camera
from sensors.images import as_image
from sensors.scanner.file import write_scanner
from sensors.scanner.model import Scanner
from sensors.stripe.clipping import Counts, clip_level
from sensors.stripe.find import find_stripes
from workbench.files.images.images import full_scale
from workbench.jobs.sensor.scan import scan
from workbench.jobs.sensor.scanner import board_stripes

SIDE = 256
TRUTH = 60.37 + 0.3 * np.arange(SIDE)
BOARD = Board("chessboard", 9, 9, 5.0)


def lit(peak=12_000.0, width=1.6, frames=2, noise=10.0, ground=100.0, seed=0) -> np.ndarray:
    """(F, H, W) light of a Gaussian line, averaged over each pixel, not clipped."""
    x, c = np.arange(SIDE), TRUTH[:, None]
    high, low = ((x + side - c) / (width * np.sqrt(2)) for side in (0.5, -0.5))
    made = ground + peak * width * np.sqrt(np.pi / 2) * (erf(high) - erf(low))
    return made + noise * np.random.default_rng(seed).standard_normal((frames, SIDE, SIDE))


def twelve_bits(left=False, **light) -> np.ndarray:
    """(F, H, W) uint16 of a 12-bit camera; `left`: in the upper bits of the 16."""
    grey = np.clip(np.rint(lit(**light)), 0, 4095).astype(np.uint16)
    return grey << 4 if left else grey


def rms(found) -> float:
    return float(np.sqrt(np.mean((found.centre - TRUTH[found.line]) ** 2)))


@pytest.mark.parametrize(("left", "full"), [(False, 4095), (True, 65520)])
@pytest.mark.parametrize("along", ["rows", "columns"])
def test_a_clipped_line_of_twelve_bits_is_found_without_its_clipped_pixels(left, full, along):
    """Three times as bright as full scale: fitted as a Gaussian, the flat top costs 0.06 px."""
    stack = twelve_bits(left)
    found = find_stripes(stack if along == "rows" else stack.transpose(0, 2, 1), along)
    assert Counts.of(stack).full == full and found.saturated.all() and len(found) > 0.95 * 2 * SIDE
    assert rms(found) < 0.005
    assert 0.8 < np.mean(((found.centre - TRUTH[found.line]) / found.sigma) ** 2) < 1.25


@pytest.mark.parametrize(
    ("kind", "level"), [(np.uint8, 230), (np.uint16, 3800), (np.float32, 3800)]
)
@pytest.mark.parametrize("width", [0.8, 2.0])
def test_values_that_pile_up_below_full_scale_are_clipped(kind, level, width):
    light = lit(1.3 * level, width, noise=level / 400, ground=level / 40)
    stack = np.clip(np.rint(light), 0, level).astype(kind)
    for saturation in (None, 65535.0):
        assert clip_level(stack, saturation) == level
    found = find_stripes(stack, saturation=65535.0)
    assert found.saturated.mean() > 0.6
    assert rms(found) < 0.01


@pytest.mark.parametrize("noise", [0.0, 0.3, 3.0])
@pytest.mark.parametrize(
    ("kind", "peak"), [(np.uint8, 30), (np.uint8, 180), (np.uint16, 3000), (np.float32, 3000)]
)
@pytest.mark.parametrize("width", [0.8, 2.0, 6.0])
@pytest.mark.parametrize("slope", [True, False])
def test_a_line_that_is_not_clipped_is_not_said_to_be(kind, peak, noise, width, slope):
    """Neither the flat top of a wide line in few grey values nor a straight line that is alike in every row."""
    light = lit(peak, width, noise=noise, ground=10)
    light = light if slope else np.broadcast_to(light[:, :1], light.shape)
    stack = np.rint(np.maximum(light, 0)).astype(kind)
    assert clip_level(stack) > stack.max()


def test_full_scale_of_one_image():
    """Of what its bits say: a dim one is of fewer bits than the camera."""
    fulls = {4095: 4095, 1023: 1023, 1024: 4095, 60: 1023, 16_000: 16_383, 50_001: 65_535}
    for largest, full in fulls.items():
        grey = np.arange(largest + 1, dtype=np.uint16)[None]
        assert as_image(grey).full == full
    for bits in (10, 12, 14):
        grey = np.arange(2**bits, dtype=np.uint16)[None] << (16 - bits)
        assert as_image(grey).full == 2**16 - 2 ** (16 - bits)
        assert as_image(grey).saturated == 2.0**-bits


def recorded(folder, images, role, **more) -> Recording:
    """A recording in `folder` of images by name."""
    for name, image in images.items():
        assert cv2.imwrite(str(folder / name), image)
    rows = tuple(
        {"image": name, "role": role, "step": step, **more} for step, name in enumerate(images)
    )
    return Recording("scan-images", {}, {}, images=rows, name="cell-4", folder=folder)


def test_full_scale_is_that_of_all_images(tmp_path):
    """A dim image whose brightest pixel is 1023 is not clipped where others of the camera reach 4095."""
    dim = twelve_bits(peak=800.0, ground=50, frames=1)
    dim[0, ::3, 200] = 1023
    made = recorded(tmp_path, {"dim.png": dim[0], "bright.png": twelve_bits(frames=1)[0]}, "scan")
    assert full_scale(made, made.images[:1]) == 1023 and full_scale(made, made.images) == 4095
    assert not (dim >= full_scale(made, made.images)).any()
    eight = recorded(tmp_path, {"eight.png": np.zeros((20, 20), np.uint8)}, "scan")
    assert full_scale(eight, eight.images) is None and full_scale(eight, []) is None


def passed_on(monkeypatch, module) -> list:
    """What a module passes to `find_stripes` as saturation."""
    saturations = []

    def watched(*arguments, saturation=None, **more):
        saturations.append(saturation)
        return find_stripes(*arguments, saturation=saturation, **more)

    monkeypatch.setattr(module, "find_stripes", watched)
    return saturations


@pytest.mark.parametrize(("left", "full"), [(False, 4095), (True, 65520)])
def test_scans_know_the_full_scale_of_their_camera(tmp_path, monkeypatch, left, full):
    import open3d

    import workbench.jobs.sensor.scan

    saturations = passed_on(monkeypatch, workbench.jobs.sensor.scan)
    images = twelve_bits(left)
    made = recorded(
        tmp_path, {f"{k}.png": image for k, image in enumerate(images)}, "scan", scan="1"
    )
    camera = Camera(900.0, 900.0, 127.0, 127.0, (0.0,) * 5, (SIDE, SIDE))
    write_scanner(
        Scanner(camera, np.arange(2), np.array([[0, 0, 1, -100.0]] * 2).T),
        tmp_path / "scanner.toml",
    )
    scan(made, tmp_path / "scanner.toml", tmp_path, lambda text: None)
    cloud = open3d.io.read_point_cloud(str(tmp_path / "clouds" / "1.ply"))
    u, v = camera.project(np.asarray(cloud.points).T)
    assert (
        len(u) > 0.95 * 2 * SIDE
        and np.sqrt(np.mean((u - TRUTH[np.rint(v).astype(int)]) ** 2)) < 0.005
    )
    assert set(saturations) == {full}


@pytest.mark.parametrize(("left", "full"), [(False, 4095), (True, 65520)])
def test_stripes_on_boards_know_the_full_scale_of_their_camera(tmp_path, monkeypatch, left, full):
    import workbench.jobs.sensor.scanner

    saturations = passed_on(monkeypatch, workbench.jobs.sensor.scanner)
    images = {f"{k}.png": image for k, image in enumerate(twelve_bits(left))}
    made = recorded(tmp_path, images, "board-laser", placement="1")
    assert cv2.imwrite(str(tmp_path / "dark.png"), twelve_bits(left, peak=0.0, frames=1, seed=1)[0])
    pixels = np.stack(np.meshgrid(np.linspace(30, 225, 9), np.linspace(30, 225, 9))).reshape(2, 81)
    view = View(
        "dark.png",
        "1",
        np.arange(81),
        pixels,
        (SIDE, SIDE),
        np.full(81, 0.1),
        row={"image": "dark.png"},
    )
    found = board_stripes(made, [(view, list(made.images))], BOARD, lambda text: None)
    u, v = found.pixels
    assert found.n > 300 and np.sqrt(np.mean((u - TRUTH[v.astype(int)]) ** 2)) < 0.005
    assert set(saturations) == {full}
