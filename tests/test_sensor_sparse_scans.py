"""Balls in scans of few light planes: found from the arcs of single stripes, or refused with a reason."""

import numpy as np
import pytest

from sensors.ball.arcs import Arcs
from sensors.ball.search import Refusal, find_balls
from sensors.ball.single_stripe import undetermined
from workbench.jobs.sensor.missing_balls import nearest_candidates, seen_instead

RADIUS, CENTRE = 15.0, np.array([2.0, -3.0, 200.0])


def scan(offsets, noise=0.01, seed=0, floor=True, radius=RADIUS, centre=CENTRE):
    """Points (3, n) mm and light planes (n,) of a ball before a floor, cut by planes x = offset + 0.3 (z - 200)."""
    rng = np.random.default_rng(seed)
    points, stripe = [], []
    normal = np.array([1.0, 0.0, -0.3]) / np.hypot(1, 0.3)
    for label, offset in enumerate(offsets):
        away = normal @ (np.array([offset, 0.0, 200.0]) - centre)
        if abs(away) < radius:
            points.append(_arc(centre + away * normal, np.sqrt(radius**2 - away**2), normal))
            stripe.append(np.full(points[-1].shape[1], label))
        if floor:
            y = np.concatenate([np.arange(-60, -22, 0.3), np.arange(20, 60, 0.3)])
            points.append(np.stack([np.full_like(y, offset + 0.3 * 30), y, np.full_like(y, 230.0)]))
            stripe.append(np.full(len(y), label))
    made = np.hstack(points)
    return made + noise * rng.normal(size=made.shape), np.concatenate(stripe)


def _arc(middle, size, normal):
    """The side of a circle that a camera at the origin sees, to 60 degrees from the line of sight."""
    towards = -middle / np.linalg.norm(middle)
    towards = towards - normal * (normal @ towards)
    towards /= np.linalg.norm(towards)
    across = np.cross(normal, towards)
    angle = np.linspace(-np.pi / 3, np.pi / 3, 100)
    return middle[:, None] + size * (
        np.outer(towards, np.cos(angle)) + np.outer(across, np.sin(angle))
    )


@pytest.mark.parametrize("planes", [2, 3, 4, 8, 16])
def test_a_ball_is_found_however_few_planes_cut_it(planes):
    points, stripe = scan(np.linspace(-9, 9, planes) + CENTRE[0])
    found = find_balls(points, RADIUS, free=True, stripe=stripe)
    assert len(found) == 1
    assert np.linalg.norm(found[0].centre - CENTRE) < 0.1


def test_two_planes_are_too_few_without_the_arcs():
    """Neighbours of a point lie on its own stripe: there are no normals, and the arcs are what finds the ball."""
    points, stripe = scan(np.array([-9.0, 9.0]) + CENTRE[0])
    assert find_balls(points, RADIUS, free=True) == []
    assert find_balls(points, RADIUS, free=True, stripe=stripe)


def test_arcs_give_the_centre_among_their_candidates():
    points, stripe = scan([CENTRE[0] + 6.0], noise=0.0)
    candidates = Arcs(points, stripe).candidates(RADIUS)
    assert min(np.linalg.norm(centre - CENTRE) for _, centre, _ in candidates) < 0.01


def test_a_floor_alone_is_no_ball_and_says_what_was_seen():
    points, stripe = scan([-40.0, -35.0, -30.0], radius=0.0)
    refused = []
    assert find_balls(points, RADIUS, stripe=stripe, refused=refused) == []
    said = seen_instead(points, stripe, refused)
    assert "3 light planes" in said and "no surface that curves like a ball" in said


def test_a_ball_of_another_size_is_refused_with_the_requirement_that_fails():
    points, stripe = scan(np.linspace(-10, 10, 12) + CENTRE[0])
    refused = []
    found = find_balls(points, 21.0, stripe=stripe, refused=refused)
    assert found == []
    said = seen_instead(points, stripe, refused)
    assert "nearest candidate, a ball of radius 21 mm" in said and "refused:" in said


OTHER, SMALL = np.array([70.0, 10.0, 190.0]), 11.0


def two_balls(planes):
    """A ball that 12 light planes cut, and a smaller one that `planes` of other ones cut; points and light planes."""
    points, stripe = scan(np.linspace(-9, 9, 12) + CENTRE[0], floor=False)
    offsets = OTHER[0] + 3.0 + np.linspace(-4, 4, planes) if planes > 1 else [OTHER[0] + 5.0]
    more, label = scan(offsets, seed=1, floor=False, radius=SMALL, centre=OTHER)
    return np.hstack([points, more]), np.concatenate([stripe, 12 + label])


@pytest.mark.parametrize("planes", [2, 3, 5])
def test_a_ball_of_few_light_planes_is_found_next_to_one_of_many(planes):
    points, stripe = two_balls(planes)
    refused = []
    found = find_balls(points, [SMALL, RADIUS], free=True, stripe=stripe, refused=refused)
    assert refused == []
    centres = sorted((ball.centre for ball in found), key=lambda centre: centre[0])
    assert len(centres) == 2
    assert np.linalg.norm(centres[0] - CENTRE) < 0.05
    assert np.linalg.norm(centres[1] - OTHER) < 0.1


def test_a_ball_on_one_light_plane_is_refused_with_its_reason_although_another_ball_is_found():
    points, stripe = two_balls(1)
    refused = []
    found = find_balls(points, [SMALL, RADIUS], free=True, stripe=stripe, refused=refused)
    assert len(found) == 1
    (one,) = refused
    assert one.points == 100
    assert "single stripe" in one.sentence
    assert np.linalg.norm(one.centre - OTHER) < RADIUS


def _biased(planes, bias):
    """A ball on few stripes whose points lie `bias` mm RMS off its surface in a form of order three along each arc."""
    points, stripe = scan(np.linspace(-9, 9, planes) + CENTRE[0], noise=0.005, floor=False)
    outward = (points - CENTRE[:, None]) / RADIUS
    place = outward[1] / np.abs(outward[1]).max()
    return points + np.sqrt(2) * bias * outward * (4 * place**3 - 3 * place), stripe


def test_a_bias_of_the_line_on_a_curved_surface_does_not_refuse_a_ball_whose_line_is_known():
    """Who knows the widths of the line corrects its centres; the form of the others may be any surface's."""
    points, stripe = _biased(2, 0.05)
    refused = []
    assert find_balls(points, RADIUS, free=True, stripe=stripe, refused=refused) == []
    assert "with the form that its points follow" in refused[0].why

    def widths(place, balls):
        return np.zeros((len(balls), len(place)))

    (found,) = find_balls(points, RADIUS, free=True, stripe=stripe, widths=widths)
    assert np.linalg.norm(found.centre - CENTRE) < 0.1
    assert undetermined(found, with_form=False) == "" and undetermined(found) != ""


def test_the_nearest_candidates_are_those_that_a_ball_fits():
    """A table has many candidates with more points, which a plane fits as well."""
    table = [
        Refusal(
            np.array([0.0, 20.0 * k, 400.0]), RADIUS, 200 + k, "a plane fits the points as well"
        )
        for k in range(6)
    ]
    ball = Refusal(np.zeros(3), RADIUS, 60, "its few stripes determine its centre to 0.2 mm", True)
    assert nearest_candidates([*table, ball], 1) == [ball]
    assert nearest_candidates([*table, ball], 2) == [ball, table[-1]]
    assert nearest_candidates(table, 0) == [table[-1]]
    points = np.array([[0.0, 1.0], [0.0, 0.0], [400.0, 401.0]])
    said = seen_instead(points, np.zeros(2), [*table, ball])
    assert "its few stripes determine its centre" in said
    assert said.count("is refused") == 1
