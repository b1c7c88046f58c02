"""Stripes on tilted boards: what perspective and the light's slope pull a centre by, and what is left once it is off."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import brentq, least_squares

from plane_scenes import CAMERA, HALF_DIAGONAL, MIDDLE, mirror
from sensors.camera.model import Camera
from sensors.light.board_chain import BoardStripeChain
from sensors.light.straight import straightened, unshaded
from sensors.stripe.surface_bias.surface_line import LineShape, line_on_ball, line_on_boards
from workbench.core.rigid import rotation_matrix

PINHOLE = Camera.of([1700.0, 1700.0, 640.0, 512.0, 0.0, 0.0, 0.0, 0.0, 0.0], (1280, 1024))
PLANE_WIDTH = 0.12  # mm
LIGHT = mirror().point


def board(turn):
    """Unit normal (3,) and distance (mm) of a board that stands at 125 mm, turned about the image's vertical."""
    normal = rotation_matrix(np.array([0.0, turn, 0.0]))[:, 2]
    return normal, normal @ [0.0, 0.0, 125.0]


def across(normal, height, plane, x, y):
    """Points (3, k) of the board that pixels x (k,) of row y see, and their distances (k,) from the light plane."""
    rays = PINHOLE.rays(np.stack([x, np.full(len(x), y)]))
    points = rays * (height / (normal @ rays))
    return points, plane[:3] @ points + plane[3]


def crossing(normal, height, plane, y):
    """px, where the light plane's middle is seen in row y."""
    return brentq(lambda x: across(normal, height, plane, np.array([x]), y)[1][0], 100.0, 1200.0)


def fitted_centre(normal, height, plane, zero, y, light):
    """Middle and width of a Gaussian that is fitted to the light along row y."""
    x = zero + np.arange(-30, 30, 0.05)
    points, away = across(normal, height, plane, x, y)
    bright = np.exp(-0.5 * (away / PLANE_WIDTH) ** 2)
    if light is not None:
        towards = light[:, None] - points
        bright = bright * np.abs(normal @ towards) / np.linalg.norm(towards, axis=0)
    start = [bright.max(), x[bright.argmax()], 3.0]
    found = least_squares(
        lambda p: p[0] * np.exp(-0.5 * ((x - p[1]) / p[2]) ** 2) - bright,
        start,
        x_scale=[0.01, 0.1, 0.1],
    )
    return found.x[1], found.x[2]


@pytest.mark.parametrize("turn", [-0.4, 0.0, 0.45])
@pytest.mark.parametrize("light", [None, LIGHT])
def test_the_pull_on_a_tilted_board_is_that_of_a_fit_to_its_light(turn, light):
    normal, height = board(turn)
    plane = mirror().planes(np.array([0.01]))[:, 0]
    zero = crossing(normal, height, plane, 300.0)
    centre, width = fitted_centre(normal, height, plane, zero, 300.0, light)
    bend = line_on_boards(
        PINHOLE,
        normal[:, None],
        np.array([height]),
        np.array([[zero], [300.0]]),
        plane[:, None],
        np.array([1.0, 0.0]),
        light,
    )
    modelled = bend.centre_bias(LineShape(PLANE_WIDTH, 0.0), np.array([width]), np.array([0.0]))[0]
    assert abs(bend.offset[0]) < 1e-9
    assert modelled == pytest.approx(centre - zero, rel=0.05, abs=2e-4)
    assert abs(modelled) > 0.002 or turn >= 0


def blurred_on_ball(centre, radius, plane, zero, row, blur):
    """Middle and width of a Gaussian fitted to the light on a ball along a row, blurred along both axes of the image."""
    step = 0.1
    x, y = zero + np.arange(-14, 14, step), row + np.arange(-5 * blur, 5 * blur + step, step)
    grid = np.stack(np.meshgrid(x, y)).reshape(2, -1)
    rays = PINHOLE.rays(grid)
    along = centre @ rays
    points = rays * (along - np.sqrt(radius**2 - ((rays * along - centre[:, None]) ** 2).sum(0)))
    away = plane[:3] @ points + plane[3]
    towards = LIGHT[:, None] - points
    cosine = ((points - centre[:, None]) * towards).sum(0) / np.sqrt((towards**2).sum(0))
    light = (np.exp(-0.5 * (away / PLANE_WIDTH) ** 2) * cosine).reshape(len(y), len(x))
    profile = np.exp(-0.5 * ((y - row) / blur) ** 2) @ light
    profile = gaussian_filter1d(profile, blur / step)
    found = least_squares(
        lambda p: p[0] * np.exp(-0.5 * ((x - p[1]) / p[2]) ** 2) - profile,
        [profile.max(), x[profile.argmax()], 2.0],
    )
    return found.x[1], found.x[2]


@pytest.mark.parametrize("row", [400.0, 480.0, 570.0])
def test_blur_along_the_line_moves_the_centre_on_a_ball(row):
    """A ball's line is curved: blur brings light of its neighbours to the inside of the curve."""
    radius, blur, plane = 15.0, 1.2, mirror().planes(np.array([0.01]))[:, 0]
    top = (
        -(plane[2] * 110 + plane[3]) / plane[0]
    )  # where the light meets the side of the ball that the camera sees
    centre = np.array([top + 1.0, 0.0, 110 + radius])

    def bend_at(x):
        place = np.array([[x], [row]])
        scan = np.array([1.0, 0.0])
        return line_on_ball(PINHOLE, centre, radius, place, plane[:, None], scan, LIGHT)

    middle = PINHOLE.project(np.array([[top], [0.0], [110.0]]))[0, 0]
    zero = brentq(lambda x: bend_at(x).offset[0], middle - 60, middle + 60)
    found, width = blurred_on_ball(centre, radius, plane, zero, row, blur)
    bend = bend_at(zero)
    pull = bend.centre_bias(LineShape(PLANE_WIDTH, blur), np.array([width]), np.array([0.0]))[0]
    without = bend.centre_bias(LineShape(PLANE_WIDTH, 0.0), np.array([width]), np.array([0.0]))[0]
    assert pull == pytest.approx(found - zero, rel=0.1, abs=1e-3)
    assert abs(without - (found - zero)) > 2 * abs(pull - (found - zero))


def chain(seed=1):
    """Stripes on boards turned both ways, with the width of every line: light plane and blur together."""
    rng, planes = np.random.default_rng(seed), mirror().planes(np.linspace(-0.05, 0.05, 8))
    turns = np.stack([np.zeros(6), np.linspace(-0.5, 0.5, 6), np.zeros(6)], 1)
    middle = np.stack([*np.zeros((2, 6)), np.linspace(115, 135, 6)], 1)
    poses = np.hstack(
        [middle - np.einsum("gij,j->gi", rotation_matrix(turns), [*MIDDLE, 0.0]), turns]
    )
    group, step = np.repeat(np.arange(6), 8 * 30), np.tile(np.repeat(np.arange(8), 30), 6)
    pixels = np.stack([rng.uniform(200, 1000, 1440), np.tile(np.linspace(100, 900, 30), 48)])
    made = BoardStripeChain(
        CAMERA, pixels, {"placement": group, "step": step}, poses, planes, MIDDLE, HALF_DIAGONAL
    )
    turn = rotation_matrix(turns)[:, :, 2]
    bend = line_on_boards(
        CAMERA,
        turn[group].T,
        (turn * poses[:, :3]).sum(1)[group],
        pixels,
        planes[:, step],
        np.array([1.0, 0.0]),
    )
    return made, np.hypot(PLANE_WIDTH / bend.slope, 0.8)


def test_the_width_of_the_light_plane_is_read_from_the_lines_and_unknown_widths_change_nothing():
    made, width = chain()
    straight, line = straightened(made, np.stack([width, np.ones(made.n)]))
    plane_width = line.plane_width_mm
    assert plane_width == pytest.approx(PLANE_WIDTH, rel=0.01)
    shift = (straight.pixels - made.pixels)[0]
    assert 0.005 < np.abs(shift).max() < 0.2 and (straight.pixels[1] == made.pixels[1]).all()
    assert straightened(made, None) == (made, LineShape(0.0, 0.0))
    assert unshaded(made, 0.0, LIGHT) is made
    away = unshaded(made, plane_width, 1e9 * LIGHT)  # parallel light falls evenly on a flat board
    assert (
        np.abs(away.pixels - made.pixels).max()
        < 1e-6
        < np.abs(unshaded(made, plane_width, LIGHT).pixels - made.pixels).max()
    )
    assert replace(made, pixels=straight.pixels).n == made.n


def test_the_scatter_of_widths_between_images_is_read_from_the_boards():
    """Each image is wider or narrower by its own 3 % (1 sigma of ln width^2)."""
    made, width = chain()
    image = made.labels["placement"] * (made.labels["step"].max() + 1) + made.labels["step"]
    own = 0.03 * np.random.default_rng(0).normal(size=image.max() + 1)
    line = straightened(made, np.stack([width * np.exp(own[image] / 2), np.ones(made.n)]))[1]
    assert 0.6 * 0.03 < line.scatter < 1.8 * 0.03
    few = replace(made, labels={name: np.zeros_like(label) for name, label in made.labels.items()})
    assert straightened(few, np.stack([width, np.ones(made.n)]))[1].scatter == 0.08
