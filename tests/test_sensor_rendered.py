"""The whole chain on rendered images whose truth is known: boards, stripes, scanner, clouds, ball centres."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import mostly_slow
from rendered_scanner import (
    BOW,
    camera_whitened,
    plane_whitened,
    render_scanner,
    rms,
    small_scene,
    without_bow,
    ye_scene,
)
from sensors.rendering import BallSurface, laser_light
from sensors.stripe.find import find_stripes
from sensors.stripe.surface_bias.surface_line import line_on_ball

TINY = {
    "mirror": {"steps": 10, "first_deg": -3.0, "last_deg": 3.0},
    "placements": {"count": 12, "laser": 5},
    "scans": {"count": 1},
}


@pytest.fixture(scope="module")
def tiny():
    return render_scanner(small_scene(3, **TINY))


@pytest.mark.slow
def test_images_become_a_scanner_and_a_ball_centre(tiny):
    error, sigma = tiny.camera_errors()["fx"]
    assert abs(error) < 3 * sigma < 3e-3 * tiny.scene.sees.fx
    assert tiny.plane_errors()[0] < 0.004
    (ball,) = tiny.ball_errors()
    assert rms(ball.laid) < 0.004 and ball.ball.fit.rms < 0.0114
    assert (np.abs(ball.z) < 4).all()


def test_a_flat_board_in_the_model_moves_the_focal_length(tiny):
    flat, start = without_bow(tiny), tiny.found.start
    assert abs(flat.camera.fx - tiny.scene.sees.fx) > 20 * start.std["camera.fx"]
    assert flat.rms_px > 2 * start.rms_px


def test_what_a_ball_does_to_its_stripes_is_known():
    """Centres on a ball almost without noise, against where the light plane truly meets it: the pull, and little else."""
    scene = ye_scene()
    whole, centre, radius = scene.instrument, np.array([1.0, -2.0, 136.0]), 15.0
    steps = np.arange(20, 105, 14)
    instrument = replace(whole, steps=whole.steps[steps], angles=whole.angles[steps])
    stack = np.stack(list(laser_light(instrument, (BallSurface(centre, radius, 1),))))
    noise = np.random.default_rng(1).normal(0, 0.05, stack.shape)
    found = find_stripes((stack * (200 / stack.max()) + noise).astype(np.float32))
    camera, planes, row = (
        instrument.camera,
        instrument.nominal_planes()[:, found.frame],
        np.array([1.0, 0.0]),
    )
    light, off = instrument.mirror.point, np.zeros(len(found))
    for _ in range(4):  # Newton's method to the middle of the light plane
        bend = line_on_ball(
            camera, centre, radius, found.pixels - off * row[:, None], planes, row, light
        )
        off = off + bend.offset / bend.slope
    near = (
        (bend.incidence_cosine > 0.5)
        & np.isfinite(off)
        & (found.pixels[1] > 100)
        & (found.pixels[1] < 900)
    )
    ratio = found.noise.gain * found.peak / found.noise.variance(found.background)
    line = bend.line_shape(found.width)
    pull = bend.centre_bias(line, found.width, ratio)
    assert line.plane_width_mm == pytest.approx(instrument.laser.width_mm, rel=0.05)
    assert (off * pull)[near].sum() / (pull**2)[near].sum() == pytest.approx(1, abs=0.1)
    assert rms((off - pull)[near]) < 0.4 * rms(off[near])


@pytest.mark.long
def test_the_simulated_copy_of_ye_meets_the_acceptance_criteria():
    made = render_scanner(ye_scene())
    error, sigma = made.camera_errors()["fx"]
    assert abs(error) < 3 * sigma and sigma < 1e-3 * made.scene.sees.fx
    assert made.plane_errors()[0] < 0.004 and made.plane_errors(free=True)[0] < 0.004
    balls = made.ball_errors()
    assert len(balls) == 6 and rms([ball.laid for ball in balls]) < 0.004
    assert max(ball.ball.fit.rms for ball in balls) < 0.0114
    # along x, where the uneven light on the ball would otherwise pull it by two micrometres
    assert np.abs(np.mean([ball.laid for ball in balls], axis=0)).max() < 0.001


@pytest.mark.long
def test_the_camera_covers_the_truth_over_seeds():
    boards = {"placements": {"laser": 0}, "scans": {"count": 0}}
    z = np.concatenate([camera_whitened(small_scene(seed, **boards)) for seed in range(201, 227)])
    assert 0.62 < (np.abs(z) < 1).mean() < 0.74


@pytest.mark.long
def test_planes_and_ball_centres_cover_the_truth_over_seeds():
    planes, balls = [], []
    for seed in range(101, 109):
        made = render_scanner(small_scene(seed, scans={"count": 4}))
        planes.append(plane_whitened(made))
        balls += [ball.z for ball in made.ball_errors()]
    for z in (np.concatenate(planes), np.concatenate(balls)):
        assert 0.62 < (np.abs(z) < 1).mean() < 0.74


# what moves the light or the lens: name, place, options, values, and what else the scene needs
SWEPT = {**TINY["mirror"], "steps": 14, "both_ways": True}
EFFECTS = [
    ("plane-bow", "laser", {}, {"curvature": 5e-5}, {}),
    ("mirror-hysteresis", "mirror", {}, {"half_gap": 3e-4}, {"mirror": SWEPT}),
    ("lens-residual", "camera", {}, {"z3c0r": 0.3}, {}),
    ("range-scale", "sensor", {"z0": 125.0}, {"scale": 4e-3}, {}),
]


@pytest.mark.parametrize(
    ("name", "where", "options", "values", "more"),
    mostly_slow(EFFECTS, 0, 2),
    ids=[row[0] for row in EFFECTS],
)
def test_an_effect_in_the_images_is_recovered(name, where, options, values, more):
    causes = [BOW, {"effect": name, "where": where, "values": values, **options}]
    boards = {
        "placements": {"count": 12, "laser": 8},
        "mirror": {**TINY["mirror"], "steps": 14},
        "scans": {"count": 0},
    }
    made = render_scanner(small_scene(5, effect=causes, **{**boards, **more}))
    found = made.again([(name, where, options)])
    for key, true in values.items():
        key = f"{where}.{name}.{key}"
        assert abs(found.made.parameters[key] - true) < 3 * found.std[key] < abs(true) * 1.5
