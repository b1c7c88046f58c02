"""Balls on a single stripe: distinguished from the others that share it by the width of the line, or refused with a reason."""

import dataclasses
import re
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from sensors.ball.arcs import Arcs
from sensors.ball.search import Refusal, find_balls
from sensors.ball.single_stripe import (
    NOT_DISTINGUISHED,
    centre_sigma,
    most_probable_ball,
    undetermined,
    unlike_spheres,
)
from sensors.camera.model import Camera
from sensors.scanner.cloud import Cloud
from sensors.scanner.file import scanner_of, scanner_text
from sensors.scanner.model import Scanner
from sensors.stripe.surface_bias.surface_line import UNKNOWN_SCATTER, LineShape, line_on_ball
from workbench.core.errors import InputError
from workbench.core.text.structured_text import parse_toml
from workbench.jobs.sensor.missing_balls import line_width_missing
from workbench.jobs.sensor.scan import _Work

LINE, NOISE_PX, NOISE_WIDTH = LineShape(0.25, 0.8), 0.02, 0.02
NORMAL = np.array([0.8, 0.05, 0.6]) / np.linalg.norm([0.8, 0.05, 0.6])
RADII = [20.0, 26.0]


def scanner(centre, away) -> Scanner:
    """One light plane that passes a ball's centre (3,) at `away` mm, and another far from it."""
    offset = -NORMAL @ centre - away
    planes = np.array([[*NORMAL, offset], [*NORMAL, offset + 90.0]]).T
    camera = Camera.of(np.array([900.0, 900.0, 400.0, 300.0, -0.1, 0.05, 0, 0, 0]), (800, 600))
    return Scanner(camera, np.arange(2), planes, line=LINE)


def stripe(ball, away, seed=0, wider=1.0):
    """Points, widths (px) and the cloud of the stripe that a light plane makes on a ball (4,), as a camera sees it."""
    rng, made = np.random.default_rng(seed), scanner(ball[:3], away)
    axes = np.linalg.svd(NORMAL[None])[2][1:]
    angle = np.linspace(0, 2 * np.pi, 4000)
    ring = np.sqrt(ball[3] ** 2 - away**2) * (axes.T @ np.stack([np.cos(angle), np.sin(angle)]))
    points = ball[:3, None] + away * NORMAL[:, None] + ring
    outward = (points - ball[:3, None]) / ball[3]
    sight = points / np.linalg.norm(points, axis=0)
    pixels = made.camera.project(points[:, -(outward * sight).sum(0) > 0.3])
    rows = np.unique(np.round(pixels[1]))
    order = np.argsort(pixels[1])
    places = np.stack([np.interp(rows, pixels[1, order], pixels[0, order]), rows])
    return _cloud(made, places, ball, rng, wider)


def _cloud(made, places, ball, rng, wider):
    count = places.shape[1]
    planes = np.repeat(made.planes[:, :1], count, axis=1)
    bend = line_on_ball(made.camera, ball[:3], ball[3], places, planes, np.array([1.0, 0.0]))
    width = wider * np.sqrt(bend.width_square(LINE)) * (1 + NOISE_WIDTH * rng.normal(size=count))
    noisy = places + np.stack([NOISE_PX * rng.normal(size=count), np.zeros(count)])
    steps = np.zeros(count, int)
    local = made.reconstruct(noisy, steps)
    return Cloud(made, local, noisy, steps, np.zeros(count, int)), width


def found_in(cloud, width, refused=None, radii=RADII):
    length = np.linalg.norm(cloud.error, axis=0)
    return find_balls(
        cloud.points,
        radii,
        free=True,
        stripe=cloud.stripe,
        refused=refused,
        incidence=np.deg2rad(60),
        view=cloud.view,
        sigma=NOISE_PX * length,
        direction=cloud.error / length,
        widths=lambda place, balls: cloud.subset(place).width_ratios(width[place], balls),
        width_scatter=cloud.scanner.line.scatter,
    )


@pytest.mark.parametrize("wider", [0.97, 1.0, 1.03])
@pytest.mark.parametrize("away", [-17.0, -13.0, -9.0])
@pytest.mark.parametrize("radius", RADII)
def test_a_ball_on_one_stripe_is_found_on_its_side_of_the_light_plane_and_of_its_size(
    radius, away, wider
):
    ball = np.array([12.0, -5.0, 250.0, radius])
    cloud, width = stripe(ball, away, wider=wider)
    (found,) = found_in(cloud, width)
    assert found.radius == radius
    assert np.linalg.norm(found.centre - ball[:3]) < 0.1
    assert abs((found.centre - ball[:3]) @ NORMAL) < 5 * centre_sigma(found) < 0.5


def test_a_ball_that_the_light_plane_cuts_near_its_middle_is_refused():
    """Both balls are a millimetre apart: the lines on them are nearly as wide."""
    cloud, width = stripe(np.array([12.0, -5.0, 250.0, 20.0]), 0.6)
    refused = []
    assert found_in(cloud, width, refused, [20.0]) == []
    assert "single stripe" in refused[0].why or "determine its centre to" in refused[0].why


def test_without_the_widths_no_ball_on_one_stripe_is_found():
    cloud, _ = stripe(np.array([12.0, -5.0, 250.0, 20.0]), 9.0)
    assert find_balls(cloud.points, RADII, free=True, stripe=cloud.stripe) == []


@pytest.mark.parametrize("line", [LINE, None])
def test_a_scanner_without_a_line_width_says_to_calibrate_it_again(line, tmp_path):
    """The file of an earlier version does not hold it; a ball on a single stripe is then never found."""
    cloud, width = stripe(np.array([12.0, -5.0, 250.0, 20.0]), 9.0)
    cloud = dataclasses.replace(cloud, scanner=dataclasses.replace(cloud.scanner, line=line))
    recording = SimpleNamespace(balls={1: (0.0, 0.0, 0.0, 20.0)}, samples={}, name="one ball")
    work = _Work(recording, cloud.scanner, tmp_path)
    sigma = np.full(len(width), NOISE_PX)
    height = np.full_like(width, 150.0)
    shape = np.stack([width, np.ones_like(width), height, np.zeros_like(width)])
    balls, outcome, _ = work.balls([{"step": 0, "scan": "1"}], cloud, sigma, shape)
    assert balls == ()
    assert ("workbench scanner" in outcome) == (line is None)


def test_a_post_across_the_light_plane_is_no_ball():
    """It is cut in a circle, which lies on two balls, but the line on it is as wide as on a ball cut in its middle."""
    post = np.array([12.0, -5.0, 250.0, 17.0])
    cloud, width = stripe(post, 0.0)
    refused = []
    assert found_in(cloud, width, refused, [20.0]) == []
    assert "not as wide as on a ball" in refused[0].why


def test_arcs_of_two_balls_are_no_ball_of_another_size():
    """Arcs that lie near a ball of a known radius may fit one of another radius better: no ball of the artefact."""
    rng = np.random.default_rng(1)
    large = np.array([0.0, 0.0, 250.0, 31.0])
    parts = [stripe(large, away)[0].local for away in (-8.0, 11.0)]
    points = np.hstack(parts)
    label = np.repeat([0, 1], [part.shape[1] for part in parts])
    points = points + 0.005 * rng.normal(size=points.shape)
    refused = []
    assert find_balls(points, [27.0], free=True, stripe=label, refused=refused) == []
    assert refused


def test_widths_that_no_ball_has_are_refused():
    place = np.linspace(-1, 1, 100)
    noise = 0.02 * np.random.default_rng(0).normal(size=(2, 100))
    assert most_probable_ball(noise + np.array([[0.0], [0.5]])).why == ""
    assert (
        "not as wide" in most_probable_ball(noise + np.stack([0.3 * place**2, 0.5 * place**2])).why
    )
    assert "does not distinguish" in most_probable_ball(noise + np.array([[0.0], [0.05]])).why
    assert most_probable_ball(np.stack([noise[0], np.full(100, np.nan)])).number == 0


def test_the_file_of_a_scanner_keeps_the_line():
    made = scanner(np.array([0.0, 0.0, 250.0]), 0.0)
    keys = parse_toml(scanner_text(made))
    assert scanner_of(keys, "scanner.toml").line == LINE
    assert "line_mm_px" not in scanner_text(dataclasses.replace(made, line=None))
    keys["light"]["line_mm_px"] = [0.0, 0.5]
    with pytest.raises(InputError, match="line_mm_px"):
        scanner_of(keys, "scanner.toml")


def test_a_floor_behind_a_ball_does_not_cut_its_arc():
    """In space the floor lies next to the ball's steep ends; the sensor sees it above and below them."""
    ball = np.array([12.0, 45.0, 250.0, 20.0])
    local = stripe(ball, -9.0)[0].local
    rows = np.arange(60)
    depth = 285.0
    above, below = local[1].min() * depth / local[2].max(), local[1].max() * depth / 250.0
    height = np.r_[above - 12 + 0.2 * rows, below + 0.2 * rows]
    across = (NORMAL @ local[:, 0] - NORMAL[1] * height - NORMAL[2] * depth) / NORMAL[0]
    floor = np.stack([across, height, np.full_like(height, depth)])
    points = np.hstack([floor[:, :60], local, floor[:, 60:]])
    label = np.zeros(points.shape[1], int)
    is_ball = (np.arange(len(label)) >= 60) & (np.arange(len(label)) < 60 + local.shape[1])
    arcs = Arcs(points, label).split(20.0)
    (on_ball,) = [arc for arc in arcs if is_ball[arc].any()]
    assert is_ball[on_ball].all() and len(on_ball) == is_ball.sum()


def test_shuffled_points_of_a_stripe_are_one_arc():
    local = stripe(np.array([12.0, -5.0, 250.0, 20.0]), -9.0)[0].local
    is_wide = np.abs(local[1] - local[1].mean()) < 12  # the ends of a visible half circle turn back
    local = local[:, is_wide]
    local = local[:, np.random.default_rng(0).permutation(local.shape[1])]
    (arc,) = Arcs(local, np.zeros(local.shape[1], int)).split(20.0)
    assert len(arc) == local.shape[1]


@pytest.mark.parametrize("probability, factor", [(0.5, 1.0), (1e-4, 5.0)])
def test_a_form_counts_for_the_centre_where_chance_does_not_explain_it(probability, factor):
    ball = np.array([12.0, -5.0, 250.0, 20.0])
    (found,) = found_in(*stripe(ball, -13.0))
    form = found.rms * np.sqrt(24 / found.inliers.sum())
    made = dataclasses.replace(found, form=form, form_probability=probability)
    plain = centre_sigma(dataclasses.replace(found, form=0.0))
    assert centre_sigma(made) == pytest.approx(factor * plain)
    why = undetermined(dataclasses.replace(made, covariance=found.covariance * (0.05 / plain) ** 2))
    assert ("with the form that its points follow" in why) == (factor > 1)


@pytest.mark.parametrize("grain, is_certain", [(1, True), (5, False)])
def test_widths_of_rows_that_err_together_count_for_fewer(grain, is_certain):
    """The same two candidates: certain where rows err separately, not where grains of speckle last for five rows."""
    rng = np.random.default_rng(2)
    noise = np.repeat(rng.normal(size=60 // grain), grain)
    noise = 0.05 * noise / noise.std()
    bend = 0.14 * np.linspace(-1, 1, 60) ** 2
    choice = most_probable_ball(noise + np.stack([0 * bend, bend]))
    assert choice.number == 0 and (choice.why == "") == is_certain


def test_an_overexposed_line_does_not_tell_which_ball_it_lies_on(tmp_path):
    """The width of a clipped line is extrapolated from its flanks, which blooming moves: such balls were 0.5 mm off."""
    cloud, width = stripe(np.array([12.0, -5.0, 250.0, 20.0]), -13.0)
    recording = SimpleNamespace(balls={1: (0.0, 0.0, 0.0, 20.0)}, samples={}, name="one ball")
    work = _Work(recording, cloud.scanner, tmp_path)
    sigma = np.full(len(width), NOISE_PX)
    for clipped in (0.0, 1.0):
        shape = np.stack([width, np.ones_like(width), 0 * width + 150.0, 0 * width + clipped])
        balls, _, refused = work.balls([{"step": 0, "scan": "1"}], cloud, sigma, shape)
        assert len(balls) == (clipped == 0)
    assert "overexposed" in refused[0].why


@pytest.mark.parametrize("actual, is_found", [(20.0, True), (18.0, False), (22.5, False)])
def test_a_sphere_of_another_radius_on_one_stripe_is_no_ball_of_the_artefact(actual, is_found):
    """It shares a circle with the ball: only the width of the line, which boards show to be known, distinguishes them."""
    cloud, width = stripe(np.array([12.0, -5.0, 250.0, actual]), -0.6 * actual)
    line = dataclasses.replace(LINE, scatter=0.02)
    cloud = dataclasses.replace(cloud, scanner=dataclasses.replace(cloud.scanner, line=line))
    refused = []
    found = found_in(cloud, width, refused, [20.0])
    assert len(found) == is_found
    assert is_found or "as wide as on a sphere of radius" in refused[0].why


def test_widths_without_power_against_other_radii_do_not_confirm_a_ball():
    """Rows with noise of 2 % distinguish the ball from spheres of other radii, those of a ragged line do not."""
    cloud, width = stripe(np.array([12.0, -5.0, 250.0, 20.0]), -13.0)
    (ball,) = found_in(cloud, width, radii=[20.0])
    noisy = width * np.exp(0.8 * np.random.default_rng(3).normal(size=len(width)))
    for measured, is_distinct in ((width, True), (noisy, False)):
        ratios = partial(cloud.width_ratios, measured)
        why = unlike_spheres(ball, cloud.points, ratios, 0.02).why
        assert (why == "") == is_distinct
    low, high = re.search(r"sphere of radius (\S+) to (\S+) mm: scan more steps", why).groups()
    assert float(low) < 17 and float(high) > 24


def test_the_file_of_a_scanner_keeps_the_scatter_of_its_widths():
    line = dataclasses.replace(LINE, scatter=0.013)
    made = dataclasses.replace(scanner(np.array([0.0, 0.0, 250.0]), 0.0), line=line)
    keys = parse_toml(scanner_text(made))
    assert scanner_of(keys, "scanner.toml").line == line
    del keys["light"]["line_scatter"]
    assert scanner_of(keys, "scanner.toml").line == LINE


def wide_stripe(ball, away, seed):
    """`stripe` where the surface turns to the camera: without the ends, which the generator of the image cuts off."""
    cloud, width = stripe(ball, away, seed=seed)
    outward = (cloud.points - ball[:3, None]) / ball[3]
    facing = -(outward * cloud.points).sum(0) / np.linalg.norm(cloud.points, axis=0)
    is_wide = facing > 0.65
    return cloud.subset(is_wide), width[is_wide]


@pytest.mark.parametrize("away", [-17.0, -13.0])
def test_few_right_balls_are_refused_for_the_width_of_their_line(away):
    """The noise of the centres is none of the widths, also where the slope of the surface changes fast (0.85 R)."""
    ball = np.array([12.0, -5.0, 250.0, 20.0])
    stated = SimpleNamespace(centre=ball[:3], radius=20.0)
    refusals = []
    for seed in range(12):
        cloud, width = wide_stripe(ball, away, seed)
        test = unlike_spheres(stated, cloud.points, partial(cloud.width_ratios, width), 0.02)
        refusals += [test.why] if test.why else []
        assert 0.01 < test.radii[1] - test.radii[0] < 3
    assert len(refusals) <= 1  # 1 % of 12: more than one with a probability of 0.6 %


def test_an_expected_width_does_not_follow_the_noise_of_the_centre():
    ball = np.array([12.0, -5.0, 250.0, 20.0])
    cloud, width = wide_stripe(ball, -17.0, 0)
    moved = dataclasses.replace(cloud, pixels=cloud.pixels + np.array([[0.1], [0.0]]))
    ratios, moved_ratios = (c.width_ratios(width, ball[None])[0] for c in (cloud, moved))
    along_line = np.abs(np.log(cloud._bend(ball, None).slope / moved._bend(ball, None).slope))
    assert np.median(2 * along_line) > 0.003
    assert (np.abs(ratios - moved_ratios) < 0.2 * 2 * along_line).all()


@pytest.mark.parametrize("actual", [20.0, 19.9])
def test_an_accepted_ball_on_one_stripe_states_which_radii_its_line_admits(actual):
    """Its centre is honest for the stated radius only; a sphere of nearly that radius is within what is admitted."""
    cloud, width = stripe(np.array([12.0, -5.0, 250.0, actual]), -0.6 * actual)
    line = dataclasses.replace(LINE, scatter=0.02)
    cloud = dataclasses.replace(cloud, scanner=dataclasses.replace(cloud.scanner, line=line))
    (found,) = found_in(cloud, width, radii=[20.0])
    words = re.search(r"radius (\S+) to (\S+) mm, whose centres are up to (\S+) mm", found.outcome)
    low, high, moves = (float(number) for number in words.groups())
    assert found.radius_note in found.warnings
    assert low <= actual <= high
    assert np.linalg.norm(found.centre - [12.0, -5.0, 250.0]) < moves + 3 * centre_sigma(found)


@pytest.mark.parametrize("scatter, is_known", [(UNKNOWN_SCATTER, False), (0.02, True)])
def test_a_scanner_file_without_line_scatter_says_to_calibrate_it_again(scatter, is_known):
    """Without it 8 % are assumed, and the test of the radius has no power: the same file calibrated again finds more."""
    line = dataclasses.replace(LINE, scatter=scatter)
    made = dataclasses.replace(scanner(np.array([0.0, 0.0, 250.0]), 0.0), line=line)
    assert ("line_scatter" in scanner_text(made)) == is_known
    ball = np.array([12.0, -5.0, 250.0, 20.0])
    cloud, width = wide_stripe(ball, -12.0, 0)
    stated = SimpleNamespace(centre=ball[:3], radius=20.0)
    noisy = width * np.exp(0.8 * np.random.default_rng(3).normal(size=len(width)))
    why = unlike_spheres(stated, cloud.points, partial(cloud.width_ratios, noisy), scatter).why
    sentence = line_width_missing(made, [Refusal(ball[:3], 20.0, len(width), why)])
    assert NOT_DISTINGUISHED in why
    assert ("this scanner file lacks line_scatter" in sentence) != is_known
    assert line_width_missing(made, []) == ""


@pytest.mark.parametrize("count", [0, 1, 2, 19])
def test_points_that_sight_grazes_do_not_confirm_a_radius(count):
    cloud, width = stripe(np.array([12.0, -5.0, 250.0, 20.0]), -13.0)
    few = cloud.subset(np.arange(cloud.points.shape[1]) < count)
    ball = SimpleNamespace(centre=np.array([12.0, -5.0, 250.0]), radius=20.0)
    test = unlike_spheres(ball, few.points, partial(few.width_ratios, width[:count]), 0.02)
    assert "sight grazes nearly all of them" in test.why
