"""What a ball fit checks before it is believed: convergence, form, plane, cylinder, and the stated radius."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ball_scenes import cap
from plane_scenes import CAMERA
from sensors.ball.fit import fit_ball
from sensors.ball.form import low_orders
from sensors.ball.point_errors import plane_error
from sensors.ball.search import find_balls
from sensors.ball.shared import Shared
from sensors.light.planes import moved
from sensors.scanner.cloud import Cloud
from sensors.scanner.model import Scanner
from workbench.jobs.sensor.ball_centres import ball_json, uncertainty
from workbench.jobs.sensor.scan import Ball, _Work

RADIUS, SIGMA, SIXTY = 12.7, 0.01, np.pi / 3
CENTRE = np.array([3.0, -4, 125])


def seen(n=3000, half=SIXTY, radius=RADIUS, seed=0, sigma=SIGMA):
    points = cap(n, half, radius) + CENTRE[:, None]
    return points + np.random.default_rng(seed).normal(0, sigma, points.shape)


def flat(seed, size=20):
    random = np.random.default_rng(seed)
    return np.vstack(
        [random.uniform(-size, size, (2, 2000)), np.full((1, 2000), 100.0)]
    ) + random.normal(0, SIGMA, (3, 2000))


def cylinder():
    random = np.random.default_rng(2)
    turn, along = random.uniform(-1, 1, 3000), random.uniform(-15, 15, 3000)
    points = np.stack([RADIUS * np.sin(turn), along, 125 - RADIUS * np.cos(turn)])
    return points + random.normal(0, SIGMA, points.shape)


def test_a_radius_that_is_two_percent_wrong_is_reported_with_its_consequence():
    """At 60 deg the centre goes 326 um away, with a sigma of 1 um that knows nothing of it."""
    fit = fit_ball(seen(), SIGMA, 1.02 * RADIUS)
    off = np.linalg.norm(fit.centre - CENTRE)
    assert off > 0.3 and fit.centre_moves == pytest.approx(off, rel=0.05) and fit.radius_gap < -100
    assert any(
        "radius differs from the stated one by" in one and "the centre moves by" in one
        for one in fit.warnings
    )
    assert fit.warnings[-1] in fit.outcome
    assert np.abs(fit.free.centre - CENTRE).max() < 4 * fit.free.std.max()


def test_a_true_radius_is_not_doubted():
    """Nor the form: a thousandth of fits for each of both."""
    fits = [fit_ball(seen(300, seed=seed), SIGMA, RADIUS) for seed in range(100)]
    assert sum(bool(fit.warnings) for fit in fits) <= 2
    assert np.std([fit.radius_gap for fit in fits]) == pytest.approx(1, abs=0.25)


def test_found_balls_compare_their_radius_too():
    assert not find_balls(seen(), RADIUS, sigma=SIGMA)[0].warnings
    (fit,) = find_balls(seen(), 1.02 * RADIUS, sigma=SIGMA)
    assert "radius differs from the stated one" in fit.outcome


@pytest.mark.parametrize("sigma", [SIGMA, None])
@pytest.mark.parametrize("radius", [None, RADIUS])
def test_planes_and_cylinders_are_no_balls(radius, sigma):
    for seed in range(5):
        fit = fit_ball(flat(seed), sigma, radius)
        assert not fit and "plane" in fit.outcome
    fit = fit_ball(
        flat(0, size=2), sigma, radius
    )  # a piece that is hardly curved on the ball either
    assert not fit and ("plane" in fit.outcome or "too small" in fit.outcome)
    fit = fit_ball(cylinder(), sigma, radius)
    assert not fit and "no ball found" in fit.outcome


@pytest.mark.parametrize(
    "start", [[0, 0, 0, 1.0], [3, -4, 100, 12.7], [3, -4, 98, 13.0], [3, -4, 50, 5.0]]
)
@pytest.mark.parametrize("radius", [None, RADIUS])
def test_a_bad_start_ends_at_the_ball_all_the_same(radius, start):
    fit = fit_ball(seen(), SIGMA, radius, start=start)
    assert fit and fit.step < 0.1 and np.abs(fit.centre - CENTRE).max() < 4 * fit.std.max() < 0.01


def test_what_has_not_converged_says_so(monkeypatch):
    """One step from far away."""
    monkeypatch.setattr("sensors.ball.solve._STEPS", 1)
    monkeypatch.setattr("sensors.ball.solve._ROUNDS", 1)
    fit = fit_ball(seen(), SIGMA, start=[3, -4, 130, 14.0])
    assert not fit and "has not converged" in fit.outcome


def test_a_form_that_is_not_noise_is_named_and_measured():
    """Flattened by 1 % along x: far above the noise, and below what makes it another surface."""
    points = seen()
    points[0] = CENTRE[0] + 1.01 * (points[0] - CENTRE[0])
    fit = fit_ball(points, SIGMA)
    assert fit and "that is not noise" in fit.warnings[0] and 0.005 < fit.form < 0.05
    points[0] = CENTRE[0] + 1.3 * (points[0] - CENTRE[0])
    assert not fit_ball(points, SIGMA) and fit_ball(points, SIGMA, form=0.2)


def test_form_is_as_probable_as_chance_where_there_is_none():
    """Uniform between 0 and 1, on a small cap as on a large one."""
    for half in (0.2, 1.2):
        normal, random = cap(400, half, 1.0), np.random.default_rng(1)
        rows = np.vstack([normal, np.ones(400)])
        each = [
            low_orders(normal, random.normal(0, 4.0, 400), np.full(400, 0.5), rows, 1.0).probability
            for _ in range(300)
        ]
        assert (
            np.mean(each) == pytest.approx(0.5, abs=0.05) and np.mean(np.array(each) < 0.1) < 0.16
        )


def grazed(seed):
    """Stripes on a ball whose errors act along the stripe's cross direction, which grazes the ball at their ends."""
    random, points, stripe = np.random.default_rng(seed), [], []
    for k, y in enumerate(np.linspace(-4, 4, 6)):
        r = np.sqrt(6.0**2 - y * y)
        turn = np.linspace(-1.5, 1.5, 80)
        ring = np.stack([np.full(80, y), r * np.sin(turn), 120 - r * np.cos(turn)])
        ring[0] += random.normal(0, 0.02, 80)
        points.append(ring)
        stripe.append(np.full(80, k))
    points, stripe = np.hstack(points), np.concatenate(stripe)
    along = np.tile([[1.0], [0], [0.3]], points.shape[1])
    return points, stripe, along


def test_points_that_come_to_graze_do_not_keep_the_fit_from_settling():
    for seed in range(20):
        points, stripe, along = grazed(seed)
        shared = Shared(stripe, along[None], 1e-6 * np.eye(6))
        for radius in (None, 6.0):
            assert fit_ball(points, 0.02, radius, direction=along, shared=shared)
            assert fit_ball(points, 0.02, radius, direction=along)


def profiled(seed, length=3.0):
    """Twelve stripes whose noise lasts for some points, and what each point was."""
    random, points = np.random.default_rng(seed), []
    kernel = np.exp(-0.5 * (np.arange(-12, 13) / length) ** 2)
    for y in np.linspace(-4, 4, 12):
        r, turn = np.sqrt(36 - y * y), np.linspace(-1, 1, 200)
        ring = np.stack([r * np.sin(turn), np.full(200, y), 120 - r * np.cos(turn)])
        error = 0.01 * np.convolve(
            random.normal(size=224), kernel / np.sqrt((kernel**2).sum()), "valid"
        )
        points.append(ring * (1 + error / np.linalg.norm(ring, axis=0)))
    points = np.hstack(points)
    return points, Shared(
        np.repeat(np.arange(12), 200),
        (points / np.linalg.norm(points, axis=0))[None],
        1e-10 * np.eye(12),
    )


def test_shared_errors_bring_the_memory_of_a_stripe_with_them():
    """Nobody has to say `ordered`: without it the sigma is three times too small."""
    scores = {None: [], False: []}
    for seed in range(40):
        points, shared = profiled(seed)
        for ordered, kept in scores.items():
            fit = fit_ball(points, 0.01, direction=points, shared=shared, ordered=ordered)
            kept.append((np.append(fit.centre, fit.radius) - [0, 0, 120, 6]) / fit.std)
    rms = {ordered: np.sqrt(np.square(kept).mean()) for ordered, kept in scores.items()}
    assert rms[None] == pytest.approx(1, abs=0.2) and rms[False] > 2.5


FRAME = np.diag([0.01, 0.02, 0.03, 1e-4, 1e-4, 1e-5]) ** 2


def scanner(**more):
    angle = np.linspace(-0.60, -0.39, 30)
    planes = np.stack([np.cos(angle), 0 * angle, -np.sin(angle), -69 * np.cos(angle)])
    return Scanner(CAMERA, np.arange(30), planes, **more)


def test_sigma_in_the_cameras_frame_holds_the_frames_own():
    """The shift's variance, and that of the turn times the distance; distances between balls know nothing of it."""
    fit, there = fit_ball(seen(), SIGMA, RADIUS), scanner(frame=FRAME)
    answer = ball_json(Ball(1, RADIUS, fit, fit.free, seen(), seen()[:2], False), there)
    x, y, z = fit.centre
    spread = FRAME.diagonal()
    frame = np.sqrt(
        [
            spread[0] + spread[4] * z**2 + spread[5] * y**2,
            spread[1] + spread[3] * z**2 + spread[5] * x**2,
            spread[2] + spread[3] * y**2 + spread[4] * x**2,
        ]
    )
    assert answer["std_in_best_frame_mm"] == pytest.approx(fit.std[:3])
    assert answer["std_mm"] == pytest.approx(np.hypot(frame, fit.std[:3]))
    assert np.diag(answer["covariance_mm2"]) == pytest.approx(np.square(answer["std_mm"]))
    assert "camera's frame" in uncertainty(there) and "is the same" in uncertainty(scanner())
    alone = ball_json(Ball(1, RADIUS, fit, fit.free, seen(), seen()[:2], False), scanner())
    assert alone["std_mm"] == alone["std_in_best_frame_mm"] and alone["warnings"] == []


def stripes_on_ball(instrument, centre, radius, steps, wide=0.9):
    """Pixels (2, n) and steps (n,) where the light planes meet the ball's side towards the camera."""
    pixels, numbers = [], []
    for step in steps:
        normal, offset = instrument.planes[:3, step], instrument.planes[3, step]
        away = normal @ centre + offset
        if abs(away) > 0.9 * radius:
            continue
        towards = -centre + (centre @ normal) * normal
        towards /= np.linalg.norm(towards)
        turn = np.linspace(-wide, wide, 120)
        ring = np.outer(towards, np.cos(turn)) + np.outer(np.cross(normal, towards), np.sin(turn))
        points = (centre - away * normal)[:, None] + np.sqrt(radius**2 - away**2) * ring
        pixels.append(instrument.camera.project(points))
        numbers.append(np.full(120, step))
    pixels, numbers = np.hstack(pixels), np.concatenate(numbers)
    inside = ((pixels > 0) & (pixels < np.array(instrument.camera.size)[:, None] - 1)).all(0)
    return pixels[:, inside], numbers[inside]


@pytest.mark.parametrize(
    ("centre", "swept", "cut"),
    [
        ((0.0, 0, 128), range(30), False),
        ((0.0, 17.5, 128), range(30), True),  # beyond the image's lower edge
        ((0.0, 0, 128), range(12, 30), True),  # the scan began in the middle of the ball
    ],
    ids=["whole", "image", "sweep"],
)
def test_a_ball_at_the_images_edge_or_the_sweeps_end_is_cut(centre, swept, cut):
    instrument = scanner()
    pixels, steps = stripes_on_ball(instrument, np.array(centre), 8.0, swept)
    rows = [{"step": step} for step in swept]
    pixels = pixels + np.random.default_rng(0).normal(0, 0.05, pixels.shape) * [[1], [0]]
    points, n = instrument.reconstruct(pixels, steps), len(steps)
    bench = _Work(SimpleNamespace(balls={}, columns={}, name="made"), instrument, None)
    cloud = Cloud(instrument, points, pixels, steps, steps - min(swept))
    (ball,), *_ = bench.balls(
        rows, cloud, np.full(n, 0.05), np.full((3, n), [[4.0], [20.0], [120.0]])
    )
    assert bool(ball.fit.cut) == cut
    assert ball_json(ball, instrument)["cut_by_field"] == cut


def with_joint_errors(factor, draw):
    """The scanner as a calibration with errors `factor @ draw` of camera and planes states it."""
    true = scanner()
    joint = factor @ draw
    count = len(CAMERA.values)
    camera = type(CAMERA).of(CAMERA.values + joint[:count], CAMERA.size)
    planes = moved(true.planes, joint[count:].reshape(-1, 3))
    rays = np.zeros((count + 6, count + 6 + 90))
    whole = factor @ factor.T
    rays[:count, :count], rays[:count, count + 6 :] = whole[:count, :count], whole[:count, count:]
    return replace(true, camera=camera, planes=planes, covariance=whole[count:, count:], rays=rays)


@pytest.mark.parametrize(("is_held", "low", "high"), [(True, 0.7, 1.35), (False, 2.0, np.inf)])
def test_sigma_of_a_centre_holds_the_camera_with_the_planes_that_it_misplaced(is_held, low, high):
    """A focal length that is 0.1 % off and planes that are off with it: mean square over variance."""
    random = np.random.default_rng(5)
    count = len(CAMERA.values)
    factor = np.zeros((count + 90, 12))
    factor[:2, 0] = 1e-3 * CAMERA.fx
    factor[count + 2 :: 3, 0] = 0.04  # the offset of every plane follows the focal length
    factor[count:, 1:] = 1e-5 * random.normal(size=(90, 11))
    centre, scores = np.array([0.0, 0.5, 128]), []
    true = scanner()
    pixels, steps = stripes_on_ball(true, centre, 8.0, range(0, 30, 3))
    for _ in range(60):
        made = with_joint_errors(factor, random.normal(size=12))
        made = made if is_held else replace(made, rays=None)
        noisy = pixels + random.normal(0, 0.05, pixels.shape) * [[1], [0]]
        points = made.reconstruct(noisy, steps)
        cloud = Cloud(made, points, noisy, steps, steps)
        length = np.linalg.norm(cloud.error, axis=0)
        errors = dict(sigma=0.05 * length, direction=cloud.error / length, **cloud.shared_errors())
        fit = fit_ball(points, radius=8.0, start=np.append(centre, 8.0), compare=False, **errors)
        off = fit.centre - centre
        scores.append(off @ np.linalg.solve(fit.covariance[:3, :3], off) / 3)
    assert low < np.mean(scores) < high


@pytest.mark.parametrize("seed", [15, 60])
def test_the_fit_with_shared_errors_settles_where_points_come_to_graze(seed):
    """Two of eighty scans: in and out they went, by 0.4 sigma of the centre each time."""
    random, instrument = np.random.default_rng(seed), scanner()
    centre = random.uniform([-3, -3, 122], [3, 3, 134])
    pixels, steps = stripes_on_ball(instrument, centre, 6.0, range(0, 30, 4), wide=1.45)
    pixels[0] += random.normal(0, 0.1, pixels.shape[1])
    points = instrument.reconstruct(pixels, steps)
    error = instrument.by_stripe(points, steps)
    shared, sigma = (
        plane_error(points, instrument.planes, steps, 1e-10 * np.eye(90)),
        0.1 * np.linalg.norm(error, axis=0),
    )
    for radius in (None, 6.0):
        fit = fit_ball(points, sigma, radius, direction=error, shared=shared)
        assert fit and fit.step < 0.003 and (np.abs(fit.centre - centre) < 4 * fit.std[:3]).all()
