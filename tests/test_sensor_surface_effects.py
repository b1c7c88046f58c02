"""Effects that depend on the surface: its properties are stated, or a message asks for them; balls of a scan determine them."""

import numpy as np
import pytest

from ball_scenes import cap
from sensors.camera.model import Camera
from sensors.effects import CATALOGUE
from sensors.scanner.model import Scanner
from workbench.core.errors import InputError
from workbench.files.images.scan_surface import reconstructed

CAMERA = Camera(1500.0, 1500.0, 640.0, 512.0, (0.0,) * 5, (1280, 1024))
CENTRE, RADIUS = np.array([[4.0], [-3.0], [125.0]]), 12.0
INCIDENCE, SCATTER = 0.05, np.array([0.06, 0.03])


def scene(n=4000, steps=60):
    """Points (3, n) of a ball and of a wall behind it, outward normals (nan on the wall), and steps (n,)."""
    rng = np.random.default_rng(1)
    ball = CENTRE + cap(n, np.deg2rad(60), RADIUS)
    wall = np.stack([*rng.uniform(-40, 40, (2, n // 2)), np.full(n // 2, 150.0)])
    normals = np.hstack([(ball - CENTRE) / RADIUS, np.full(wall.shape, np.nan)])
    points = np.hstack([ball, wall])
    return points, normals, np.arange(points.shape[1])


def scanner(points, shift, effects=()):
    """One whose planes, a step each, go through points that are shifted by `shift` (3, n) mm from where they truly are."""
    tilt = np.array([[0.9], [0.0], [0.4]]) / np.hypot(0.9, 0.4)
    planes = np.vstack([np.repeat(tilt, points.shape[1], 1), -(tilt * (points + shift)).sum(0)])
    return Scanner(CAMERA, np.arange(points.shape[1]), planes, effects=effects)


def incidence(points, normals):
    """(3, n) mm: c tan(incidence) along the ray, away from the camera."""
    rays = points / np.linalg.norm(points, axis=0)
    cosine = -(rays * normals).sum(0)
    return np.nan_to_num(INCIDENCE * np.sqrt(1 - cosine**2) / cosine * rays)


def scatter(points, normals):
    """(3, n) mm: deeper along the ray, and inwards."""
    return np.nan_to_num(
        SCATTER[0] * points / np.linalg.norm(points, axis=0) * (normals[0] == normals[0])
        - SCATTER[1] * normals
    )


CASES = [
    ("incidence-bias", {}, [INCIDENCE], incidence, "normals"),
    ("subsurface-scatter", {}, SCATTER, scatter, "normals and ball"),
    ("subsurface-scatter", {"everywhere": True}, SCATTER, scatter, "normals"),
]


@pytest.mark.parametrize(("name", "options", "values", "law", "asked"), CASES)
def test_what_is_asked_of_the_surface_has_to_be_given(name, options, values, law, asked):
    points, normals, steps = scene(200)
    effect = CATALOGUE[name]("sensor", **options), np.array(values)
    shift = law(points, normals)
    made, seen = scanner(points, shift, (effect,)), CAMERA.project(points + shift)
    with pytest.raises(InputError, match=f"{name} at sensor: expected {asked} of the surface"):
        made.reconstruct(seen, steps)
    if asked == "normals and ball":
        with pytest.raises(InputError, match="expected ball of the surface"):
            made.reconstruct(seen, steps, normals=normals)
    ball = np.isfinite(normals[0]).astype(int)
    found = made.reconstruct(seen, steps, normals=normals, ball=ball)
    on = ball > 0
    assert np.abs(shift[:, on]).max() > 0.05
    # the direction of a ray differs by the shift's part across it over the range
    assert np.abs(found - points)[:, on].max() < 1e-3


@pytest.mark.parametrize(("name", "options", "values", "law", "asked"), CASES[:2])
def test_balls_of_a_scan_tell_what_their_surface_is_like(name, options, values, law, asked):
    points, normals, steps = scene()
    effect = CATALOGUE[name]("sensor", **options), np.array(values)
    shift = law(points, normals)
    made, seen = scanner(points, shift, (effect,)), CAMERA.project(points + shift)
    found, sentence = reconstructed(made, seen, steps, {}, [RADIUS])
    on = np.isfinite(normals[0])
    before, after = (np.sqrt(np.mean((p - points)[:, on] ** 2)) for p in (points + shift, found))
    assert before > 0.02 and after < 0.05 * before
    assert np.abs(found - points)[:, ~on].max() < 1e-9
    count = int(sentence.split("off the ")[1].split(" of ")[0])
    assert sentence.startswith(f"{name} at sensor taken off the") and sentence.endswith(
        f"of {len(steps)} points that lie on balls"
    )
    assert abs(count - on.sum()) < 0.02 * on.sum()


def test_without_such_effects_nothing_is_looked_for():
    points, normals, steps = scene(200)
    found, sentence = reconstructed(scanner(points, 0.0), CAMERA.project(points), steps, {}, None)
    assert sentence == "" and np.abs(found - points).max() < 1e-9


@pytest.mark.parametrize("steps", [np.array([0.0, 2.0]), np.array([0, 2], np.uint8), [0, 2]])
def test_whole_steps_of_any_type_find_their_planes(steps):
    made = scanner(scene(200)[0], 0.0)
    seen = np.array([[600.0, 640], [500, 510]])
    assert np.array_equal(made.reconstruct(seen, steps), made.reconstruct(seen, np.array([0, 2])))


@pytest.mark.parametrize(
    ("steps", "odd"), [([0.0, 1.5], "1.5"), ([0.0, np.nan], "nan"), (["0", "1"], "0")]
)
def test_other_steps_get_a_sentence(steps, odd):
    made = scanner(scene(200)[0], 0.0)
    with pytest.raises(InputError, match=f"steps: expected whole numbers, found {odd}"):
        made.reconstruct(np.array([[600.0, 640], [500, 510]]), np.array(steps))
