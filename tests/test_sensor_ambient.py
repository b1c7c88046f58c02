"""Light of the scene under the laser's line: its slope pulls centres, and is taken off; noise of centres from neighbours."""

import numpy as np
import pytest

from sensors.stripe.ambient import MOST_IMAGES, Lines, ambient_bias, chosen_images, scene_of
from sensors.stripe.centre_noise import centre_noise
from sensors.stripe.find import find_stripes

HEIGHT, WIDTH, LINE = 160, 240, 1.6


def scene(rng, slope, count=8, peak=120.0):
    """8-bit images (F, H, W) of a line that steps over a scene whose light rises by `slope` grey values a px to the right
    and has an edge elsewhere; and where the line truly is (F, H)."""
    column, row = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    light = 60 + slope * (column - WIDTH / 2) + 30.0 * (row > HEIGHT - 10)
    images, places = [], []
    for k in range(count):
        place = 40 + 150 * k / count + 0.13 * np.arange(HEIGHT)
        away = (column - place[:, None]) / LINE
        shown = light + peak * np.exp(-away * away / 2)
        noisy = shown + rng.normal(0, 0.1 * np.sqrt(shown))
        images.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
        places.append(place)
    return np.array(images), np.array(places)


@pytest.mark.parametrize("slope", [-0.25, 0.25])
@pytest.mark.parametrize("turned", [False, True])
def test_a_slope_of_the_light_no_longer_pulls_centres(slope, turned):
    """By 2.8 s w^2 / peak without the correction, 0.013 px here."""
    images, places = scene(np.random.default_rng(1), slope)
    seen = images.transpose(0, 2, 1) if turned else images
    found = find_stripes(seen, "columns" if turned else "rows")
    shape = np.vstack([found.shape, found.peak])
    pull = ambient_bias(seen[chosen_images(len(seen))], found.pixels, shape, not turned)
    inside = found.line < HEIGHT - 25
    error = (found.centre - places[found.frame, found.line])[inside]
    assert np.mean(error) == pytest.approx(np.sign(slope) * 0.013, abs=0.004)
    assert abs(np.mean(error - pull[inside])) < 0.0015
    assert np.std(error - pull[inside]) < 1.05 * np.std(error)


def test_some_images_show_the_scene():
    assert chosen_images(3).tolist() == [0, 1, 2]
    assert chosen_images(4).tolist() == [0, 1, 2, 3]
    assert len(chosen_images(100)) == MOST_IMAGES
    assert (ambient_bias([], np.zeros((2, 5)), np.ones((3, 5)), True) == 0).all()


def test_an_edge_of_the_scene_moves_no_centre_far():
    """A slope that is steep against the line is bounded: no line is straight there."""
    images = np.full((4, 50, 60), 10, np.uint8)
    images[:, :, 30:] = 200
    pixels = np.array([[30.0, 31.0], [20.0, 25.0]])
    shape = np.array([[2.0, 2.0], [0.1, 0.1], [20.0, 20.0]])
    assert np.abs(ambient_bias(images, pixels, shape, True)).max() < 0.3


@pytest.mark.parametrize("beyond", [0.0, 0.05])
def test_neighbours_show_the_noise_that_fits_do_not_state(beyond):
    rng = np.random.default_rng(2)
    image, line = np.divmod(rng.permutation(4 * 300), 300)
    stated = np.where(line < 150, 0.01, 0.03)
    curve = 100 + 0.3 * line + 2e-4 * (line - 150.0) ** 2
    centre = curve + np.hypot(stated, beyond) * rng.normal(size=len(line))
    made = centre_noise(centre, line, image, stated, 0.2)
    expected = np.hypot(stated, beyond)
    assert made == pytest.approx(expected, rel=0.12, abs=0.006)


def test_few_neighbours_leave_what_is_usual():
    line = np.arange(0, 60, 2)
    made = centre_noise(np.zeros(30), line, np.zeros(30, int), np.full(30, 0.03), 0.04)
    assert made == pytest.approx(0.05)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("turned", [False, True])
def test_the_slope_of_the_light_is_seen_next_to_the_lines_of_few_images(count, turned):
    images, places = scene(np.random.default_rng(3), 0.25, count)
    seen = images.transpose(0, 2, 1) if turned else images
    found = find_stripes(seen, "columns" if turned else "rows")
    shown = []
    for k in chosen_images(count):
        own = found.frame == k
        lines = Lines(found.pixels[:, own], found.width[own], not turned)
        shown.append(scene_of(seen[k], count, lines))
    shape = np.vstack([found.shape, found.peak])
    pull = ambient_bias(shown, found.pixels, shape, not turned)
    inside = found.line < HEIGHT - 25
    error = (found.centre - places[found.frame, found.line])[inside]
    assert np.mean(error) == pytest.approx(0.013, abs=0.006)
    assert abs(np.mean(error - pull[inside])) < 0.003
    assert np.std(error - pull[inside]) < 1.05 * np.std(error)
