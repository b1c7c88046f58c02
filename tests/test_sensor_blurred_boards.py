"""Why a board is not found: focus and motion blur are recognised by the widths of edges, and every image is named."""

import cv2
import numpy as np
import pytest

from sensors.boards.board import Board
from sensors.boards.detection import Rejected, detect
from sensors.images import blur
from workbench.fitting.verdicts.sensor_verdict import blurred_images
from workbench.recordings.inspection.coverage import ImageCoverage
from workbench.recordings.inspection.needs import _image_needs

BOARD = Board("chessboard", 6, 4, 10.0)


def drawn(turn_deg=12.0):
    """(480, 640) of a chessboard with squares of 40 px, turned in the image plane."""
    squares = np.kron(np.indices((5, 7)).sum(0) % 2, np.ones((40, 40))) * 170 + 30
    plain = np.full((480, 640), 120.0)
    plain[140:340, 180:460] = squares
    turn = cv2.getRotationMatrix2D((320, 240), turn_deg, 1.0)
    made = cv2.warpAffine(plain, turn, (640, 480), flags=cv2.INTER_AREA, borderValue=120)
    noise = np.random.default_rng(2).normal(0, 1.5, made.shape)
    return np.clip(cv2.GaussianBlur(made, (0, 0), 0.7) + noise, 0, 255).astype(np.uint8)


def moved(image, length):
    return cv2.blur(image, (length, 1))


@pytest.mark.parametrize("turn_deg", [0.0, 12.0, 45.0])
def test_a_sharp_board_is_not_blurred(turn_deg):
    assert blur(drawn(turn_deg)) is None


def test_focus_and_motion_are_named():
    out_of_focus = detect(cv2.GaussianBlur(drawn(), (0, 0), 25), BOARD, "a.png")
    in_motion = detect(moved(drawn(), 31), BOARD, "b.png")
    assert isinstance(out_of_focus, Rejected) and isinstance(in_motion, Rejected)
    assert out_of_focus.why.startswith("blurred: its sharpest edges are ")
    assert in_motion.why.startswith("blurred along one direction, as by motion: edges are up to 3")


@pytest.mark.parametrize("wider", [0.0, 2.0, 4.0])
def test_the_blur_of_a_board_that_is_found_is_measured(wider):
    image = drawn() if not wider else cv2.GaussianBlur(drawn(), (0, 0), wider)
    seen = detect(image, BOARD, "a.png")
    # sharp edges were drawn with 0.7 px, and resampled by the rotation
    assert seen.blur_px == pytest.approx(np.hypot(wider, 0.8), abs=0.15)


def test_blurred_images_are_named_with_their_blur():
    views = [
        detect(cv2.GaussianBlur(drawn(), (0, 0), width), BOARD, f"{width:g}.png")
        for width in (0.5, 3.0, 4.0)
    ]
    (said,) = blurred_images(views)
    assert said.startswith("2 of 3 images are blurred: 1 sigma of their edges is 3.")
    assert "(3.png, 4.png)" in said
    assert blurred_images(views[:1]) == []


def test_check_names_every_image_with_its_own_reason():
    rejected = (("a.png", "blurred"), ("b.png", "no contrast"), ("c.png", "the same as d.png"))
    images = ImageCoverage({"board": 14}, 11, rejected, np.ones((2, 1)), (640, 480))

    class Recording:
        measures = "board-images"

    said = " ".join(need.what for need in _image_needs(Recording, images))
    for name, why in rejected:
        assert f"{name}: {why}" in said
