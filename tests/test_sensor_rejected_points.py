"""Where points of the laser line were left out as wrong: in the image, on the board, in a plane, by brightness."""

from types import SimpleNamespace

import numpy as np
import pytest

from sensors.scanner.rejected_points import rejected_points


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
        along=along,
        labels={"step": step, "placement": placement},
        state=SimpleNamespace(board=board),
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
