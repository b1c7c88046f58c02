"""Balls in a scan: found, distinguished from other surfaces, cut ones named, and matched with the artefact."""

import time

import numpy as np
import pytest

from ball_scenes import along_rays, ball, block, cap, post, ray_cast
from sensors.ball.matching import match
from sensors.ball.search import find_balls
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_matrix

TABLE = ([0, 0, 335], [300, 300, 10])
BALLS = (
    ([-40.0, -30, 300], 12.7),
    ([40.0, -30, 310], 12.7),
    ([40.0, 30, 290], 10.0),
    ([-40.0, 30, 300], 12.7),
    ([-14.6, 30, 300], 12.7),
)
NOISE = 0.02


def scene(balls, *others, size=(320, 256), focal=480.0, noise=NOISE, resolution=150):
    """(3, H, W) mm with noise along the rays."""
    shapes = [ball(centre, radius, resolution) for centre, radius in balls]
    return along_rays(ray_cast([*shapes, *others], *size, focal), noise, np.random.default_rng(0))


@pytest.fixture(scope="module")
def plate():
    """Five balls, two of which touch, two on posts, above a table with a block on it."""
    posts = post([40, 30, 315], 4, 30), post([-40, -30, 320], 4, 20)
    return scene(BALLS, block(*TABLE), block([0, -10, 320], [20, 20, 20]), *posts)


def agree(found, balls, tolerance=0.01):
    """Every ball found once, no other."""
    assert len(found) == len(balls)
    for centre, radius in balls:
        gap = [np.linalg.norm(one.centre - centre) for one in found]
        assert min(gap) < tolerance and abs(found[int(np.argmin(gap))].radius - radius) < tolerance


@pytest.mark.parametrize(
    "options",
    [
        {"radii": [12.7, 10.0]},
        {"radii": [12.7, 10.0], "free": True},
        {"radius_range": (5.0, 30.0)},
        {},
    ],
    ids=["known", "known-but-fitted", "between", "unknown"],
)
def test_balls_are_found_among_table_posts_and_blocks(plate, options):
    """Two touching balls too; known radii keep theirs."""
    found = find_balls(plate, **options)
    agree(found, BALLS)
    assert all(one.std[3] == 0 for one in found) == ("radii" in options and "free" not in options)
    used = sum(one.inliers.astype(int) for one in found)
    assert used.max() == 1 and all(len(one.reason) == plate[0].size for one in found)


def test_order_and_organisation_do_not_matter(plate):
    points = plate.reshape(3, -1)
    points = points[:, np.isfinite(points).all(0)]
    shuffled = points[:, np.random.default_rng(1).permutation(points.shape[1])]
    agree(find_balls(shuffled, [12.7, 10.0]), BALLS)
    first, again = find_balls(points, [12.7, 10.0]), find_balls(points, [12.7, 10.0])
    assert all(np.array_equal(a.centre, b.centre) for a, b in zip(first, again))


def test_the_view_need_not_be_from_the_origin(plate):
    """In another frame, with the direction of view said."""
    turn, shift = rotation_matrix(np.array([2.0, 0.4, -1.0])), np.array([500.0, -200, 80])
    moved = (turn @ plate.reshape(3, -1)) + shift[:, None]
    found = find_balls(moved, [12.7, 10.0], view=turn @ plate.reshape(3, -1))
    agree(found, [(turn @ centre + shift, radius) for centre, radius in BALLS])


@pytest.mark.parametrize(
    "options",
    [{"radii": 12.7}, {"radius_range": (5.0, 40.0)}, {}],
    ids=["known", "between", "unknown"],
)
def test_no_ball_is_seen_where_there_is_none(options):
    """A lying post of the ball's own radius with its round end, a block, a table."""
    points = scene(
        [],
        block(*TABLE),
        post([0, 0, 310], 12.7, 80, lying=True),
        block([60, -40, 325], [25, 25, 20]),
    )
    assert find_balls(points, **options) == []


@pytest.mark.parametrize(
    "options", [{"radii": 20.0}, {"radius_range": (10.0, 40.0)}], ids=["known", "between"]
)
def test_a_dome_with_something_inside_is_no_solid_ball(options):
    """A rounded shell of glass over a block; without the block it is a ball like any other."""
    dome = cap(6000, 1.0, 20.0) + [[0], [0], [300]]
    random = np.random.default_rng(4)
    inside = np.vstack([random.uniform(-9, 9, (2, 3000)), np.full((1, 3000), 297.0)])
    points = [along_rays(one, NOISE, random) for one in (dome, np.hstack([dome, inside]))]
    agree(find_balls(points[0], **options), [([0.0, 0, 300], 20.0)])
    assert find_balls(points[1], **options) == []


def test_a_radius_that_does_not_occur_finds_nothing(plate):
    assert find_balls(plate, 20.0) == []


def test_a_ball_on_a_plate_and_a_small_one():
    """They touch the plate; one is as large as six of the other."""
    balls = [([0.0, 0, 326], 4.0), ([50.0, 0, 306], 24.0)]
    agree(find_balls(scene(balls, block(*TABLE), size=(640, 512), focal=960.0), [4.0, 24.0]), balls)


def test_noise_as_large_as_a_hundredth_of_the_ball():
    found = find_balls(scene(BALLS[3:], block(*TABLE), noise=0.15), 12.7)
    agree(found, BALLS[3:], tolerance=0.05)


def test_a_ball_cut_by_the_field_is_named():
    """At the border of an organised scan, or where the caller says that the field ends."""
    balls = [([70.0, 0, 210], 12.7), ([0.0, 0, 300], 12.7)]
    points = scene(balls, block(*TABLE))
    for cloud, limit in (
        (points, None),
        (points.reshape(3, -1), np.indices(points.shape[1:])[1].ravel() == 319),
    ):
        whole, cut = sorted(find_balls(cloud, 12.7, at_limit=limit), key=lambda one: one.cut)
        assert cut.cut and "cut by the field" in cut.outcome and abs(cut.centre[0] - 70) < 0.02
        assert not whole.cut and "cut" not in whole.outcome


def test_empty_and_wrong_input():
    assert (
        find_balls(np.zeros((3, 0)), 5.0) == []
        and find_balls(np.full((3, 40, 40), np.nan), 5.0) == []
    )
    for arguments in ((np.zeros((10, 3)), 5.0), (np.zeros((3, 50)), -1.0)):
        with pytest.raises(InputError, match="expected .* found"):
            find_balls(*arguments)
    with pytest.raises(InputError, match="a smaller and a larger radius"):
        find_balls(np.random.default_rng(0).uniform(0, 1, (3, 99)), radius_range=(5.0, 2.0))


@pytest.mark.slow
def test_a_million_points_take_about_a_second():
    points = scene(BALLS, block(*TABLE), size=(1280, 1024), focal=1900.0)
    begun = time.process_time()
    found = find_balls(points, [12.7, 10.0])
    assert time.process_time() - begun < 3 and np.isfinite(points[0]).sum() > 1e6
    agree(found, BALLS, tolerance=0.002)


ARTEFACT = np.array([[0, 0, 0], [100, 0, 0], [0, 80, 0], [100, 85, 10], [40, 30, 25.0]]).T


def placed(order, noise=0.01, seed=0):
    """The artefact's balls in another frame and order."""
    turned = rotation_matrix(np.array([0.3, -1.2, 0.5])) @ ARTEFACT[:, order] + [[10], [-20], [300]]
    return turned + np.random.default_rng(seed).normal(0, noise, turned.shape)


def test_balls_are_matched_by_their_distances():
    found = match(placed([3, 0, 4, 1]), ARTEFACT)
    assert found and found.ball.tolist() == [3, 0, 4, 1] and found.rms < 0.03


def test_a_stray_ball_has_no_number():
    centres = np.insert(placed([2, 3, 4, 0]), 1, [5.0, 5, 250], axis=1)
    found = match(centres, ARTEFACT)
    assert found and found.ball.tolist() == [2, -1, 3, 4, 0] and "4 of 5" in found.outcome


@pytest.mark.parametrize(
    ("found", "artefact", "count"),
    [
        (np.array([[0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0.0]]).T, None, 8),
        (ARTEFACT[:, :2], ARTEFACT, 2),
    ],
)
def test_ambiguity_is_reported(found, artefact, count):
    """A square looks the same eight ways; two balls can always stand the other way round."""
    answer = match(found, found if artefact is None else artefact)
    assert (
        not answer
        and len(answer.others) == count - 1
        and f"ambiguous: {count} assignments" in answer.outcome
    )


def test_a_mirror_image_is_no_match():
    answer = match(ARTEFACT * [[1], [1], [-1]], ARTEFACT)
    assert not answer and "mirror image" in answer.outcome
    assert "as far apart" in match(ARTEFACT * 10, ARTEFACT).outcome
