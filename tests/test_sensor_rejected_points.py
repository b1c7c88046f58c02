"""Where points of the laser line were left out as wrong: in the image, on the board, in a plane, by brightness."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from sensors.scanner.residuals.rejected_points import rejected_points


def stripes(seed=3, poses=8, steps=10, points=50):
    """A chain of stripes with random places on the board and in the image, and the shape (2, n) of their line."""
    rng = np.random.default_rng(seed)
    n = poses * steps * points
    along = np.tile(np.linspace(0, 400, points), poses * steps)
    step = np.tile(np.repeat(np.arange(steps), points), poses)
    placement = np.repeat(np.arange(poses), steps * points)
    shift = rng.uniform(-60, 60, (2, poses))[:, placement]
    pixels = np.stack([60.0 * step, along]) + 0.5 * shift
    board = (np.stack([60.0 * step, along]) - shift) / 300
    chain = SimpleNamespace(
        pixels=pixels,
        stripe_place=along,
        labels={"step": step, "placement": placement},
        state=SimpleNamespace(board=board, target=150 * np.vstack([board, np.zeros(n)])),
    )
    return chain, np.stack([rng.uniform(1, 2, n), rng.uniform(20, 200, n)])


def near(place, centre, reach):
    return (np.abs(place - np.asarray(centre)[:, None]) < reach).all(0)


@pytest.mark.parametrize(
    "cause, where, depends_on",
    [
        (lambda c, s: near(c.pixels, (250, 200), 60), "camera", ("u", "v")),
        (lambda c, s: near(c.state.board, (0.8, 0.7), 0.2), "artefact", ("board_x", "board_y")),
        (lambda c, s: c.labels["step"] == 4, "laser", ("mirror",)),
        (lambda c, s: s[1] > 180, "camera", ("line_brightness",)),
        (lambda c, s: s[0] > 1.9, "laser", ("line_width",)),
    ],
)
def test_the_place_of_wrong_points_is_found(cause, where, depends_on):
    chain, shape = stripes()
    random = np.random.default_rng(5).random(shape.shape[1])
    wrong = np.where(cause(chain, shape), random < 0.8, random < 0.02)
    found = rejected_points(chain, wrong, shape)
    assert (found.where, found.depends_on) == (where, depends_on)
    assert found.share == pytest.approx(wrong.mean()) and found.p_value < 1e-6


def test_wrong_points_anywhere_have_no_place():
    chain, shape = stripes()
    wrong = np.random.default_rng(6).random(shape.shape[1]) < 0.2
    found = rejected_points(chain, wrong, shape)
    assert (found.where, found.depends_on) == ("sensor", ())
    assert rejected_points(chain, np.zeros(len(wrong), bool), None).share == 0


def test_a_scratch_is_described_by_its_ends_and_its_width():
    chain, shape = stripes()
    distance = (chain.pixels - np.array([[280.0], [200.0]])) * np.array([[0.6], [0.8]])
    wrong = (np.abs(distance.sum(0)) < 8) & near(chain.pixels, (280, 200), 160)
    found = rejected_points(chain, wrong, shape)
    assert found.depends_on == ("u", "v")
    numbers = [float(number) for number in re.findall(r"-?\d+\.?\d*", found.region)]
    first, last, width = np.array(numbers[:2]), np.array(numbers[2:4]), numbers[4]
    direction = (last - first) / np.linalg.norm(last - first)
    assert abs(direction @ [0.8, -0.6]) > 0.98
    assert np.linalg.norm(last - first) == pytest.approx(390, rel=0.15)
    assert width == pytest.approx(15, rel=0.5)
    assert "along a line" in found.region and numbers[5] > 90 and numbers[6] < 3


def test_a_spot_is_described_by_its_middle_and_its_size():
    chain, shape = stripes()
    random = np.random.default_rng(5).random(shape.shape[1])
    wrong = np.where(near(chain.pixels, (250, 200), 60), random < 0.8, random < 0.02)
    found = rejected_points(chain, wrong, shape)
    assert "in an area of" in found.region
    numbers = [float(number) for number in re.findall(r"\d+\.?\d*", found.region)]
    assert numbers[:2] == pytest.approx([108, 108], rel=0.25)
    assert numbers[2:4] == pytest.approx([250, 200], abs=12)


def test_points_of_a_bright_line_are_distinguished_from_those_of_a_dim_one():
    chain, shape = stripes()
    bright = rejected_points(chain, shape[1] > 180, shape)
    dim = rejected_points(chain, shape[1] < 40, shape)
    assert bright.is_bright and not dim.is_bright
    assert "with the most 100 %" in bright.region and "with the most 0 %" in dim.region
