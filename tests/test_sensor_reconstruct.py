"""From pixels to points: the exact inverse of the lens, the cut with the light planes, effects in order, sigmas."""

import numpy as np
import pytest

from plane_scenes import CAMERA, HALF_DIAGONAL, MIDDLE, mirror, simulated_scanner
from sensors.camera.model import Camera
from sensors.camera.undistort import BLOCK, fit_inverse, iterate
from sensors.effects import CATALOGUE
from sensors.light.board_chain import BoardStripeChain
from sensors.light.planes import moved
from sensors.scanner.errors import (
    by_camera,
    by_pixel,
    by_plane,
    cut,
    field_points,
    frame_moves,
    plane_moves,
)
from sensors.scanner.model import Scanner
from sensors.state import stripe_direction
from workbench.core.errors import InputError

LENSES = {
    "narrow": [3421, 3419, 645, 507, -0.11, 0.23, 4e-4, -3e-4, 0.0],
    "without tangential": [3421, 3419, 645, 507, -0.1, 0.2, 0, 0, 0.05],
    "strongly decentred": [3421, 3421, 645, 507, -0.1, 0.2, 5e-3, -5e-3, 0.05],
    "rational": [3421, 3419, 645, 507, -0.1, 0.2, 1e-3, 1e-4, 0.05, 0.01, 0.02, 0.03],
    "wide": [900, 905, 645, 507, -0.1, 0.02, 1e-3, -1e-3, -0.001],
    "no distortion": [3421, 3419, 645, 507, 0, 0, 0, 0, 0],
    "pincushion": [1500, 1500, 645, 507, 0.25, 0.1, -2e-3, 1e-3, 0.0],
}


def pixels(rng, n):
    return np.stack([rng.uniform(-0.5, 1279.5, n), rng.uniform(-0.5, 1023.5, n)])


def planes(count):
    return mirror().planes(np.linspace(-0.08, 0.08, count) if count > 1 else np.zeros(1))


@pytest.mark.parametrize("lens", LENSES)
def test_the_inverse_of_the_lens_is_exact(lens):
    camera, seen = (
        Camera.of(LENSES[lens], (1280, 1024)),
        pixels(np.random.default_rng(1), 3 * BLOCK + 7),
    )
    flat = camera.normalised(seen)
    back = camera.project(np.vstack([flat, np.ones(seen.shape[1])]))
    assert abs(back - seen).max() < 1e-9
    slow = iterate(camera, camera.seen(seen[:, :2000]))
    assert abs(flat[:, :2000] - slow).max() * camera.fx < 1e-9


def test_pixels_outside_the_image_are_as_exact():
    camera = CAMERA
    seen = pixels(np.random.default_rng(2), 2 * BLOCK + 5)
    seen[:, ::5] += 900
    flat = camera.normalised(seen)
    assert abs(camera.project(np.vstack([flat, np.ones(seen.shape[1])])) - seen).max() < 1e-9


def test_a_pixel_that_no_lens_reaches_is_nan_and_spoils_no_other():
    camera = Camera.of([900, 900, 640, 512, -0.3, 0.0, 0, 0, 0], (1280, 1024))
    seen = pixels(np.random.default_rng(3), 2 * BLOCK + 5)
    seen[:, 17] = [9000.0, 9000.0]
    seen[0, 23] = np.nan
    for part in (seen, seen[:, :100]):
        flat = camera.normalised(part)
        assert np.isnan(flat[:, [17, 23]]).any(0).all()
        others = np.delete(np.arange(part.shape[1]), [17, 23])
        reached = np.isfinite(flat[:, others]).all(0)
        back = camera.project(np.vstack([flat[:, others], np.ones(len(others))]))[:, reached]
        # r (1 - 0.3 r^2) has its largest value, 2 / 3 / sqrt(0.9), where the lens folds over
        size = np.hypot(*camera.seen(part[:, others])) / (2 / 3 / np.sqrt(0.9))
        assert reached[size < 0.995].all() and not reached[size > 1.001].any()
        assert abs(back - part[:, others][:, reached]).max() < 1e-9


def test_a_camera_of_unknown_size_has_a_start_too():
    camera = Camera.of(LENSES["narrow"], (0, 0))
    assert fit_inverse(camera).enough > 0
    seen = pixels(np.random.default_rng(4), 2 * BLOCK)
    assert (
        abs(
            camera.project(np.vstack([camera.normalised(seen), np.ones(seen.shape[1])])) - seen
        ).max()
        < 1e-9
    )


@pytest.mark.parametrize("count", [1, 12])
def test_blocks_of_points_are_what_single_points_are(count):
    rng = np.random.default_rng(5)
    n = 2 * BLOCK + 11
    seen, steps = pixels(rng, n), rng.integers(0, count, n)
    scanner = Scanner(CAMERA, np.arange(count), planes(count))
    whole = scanner.reconstruct(seen, steps)
    some = slice(BLOCK - 50, BLOCK + 50)
    assert abs(whole[:, some] - scanner.reconstruct(seen[:, some], steps[some])).max() < 1e-9
    own = scanner.planes[:, steps]
    assert abs((own[:3] * whole).sum(0) + own[3]).max() < 1e-9
    assert abs(CAMERA.project(whole) - seen).max() < 1e-9


def test_points_behind_the_camera_are_nan():
    scanner = Scanner(CAMERA, np.arange(2), np.array([[0.0, 0, 1, -100], [0.0, 0, 1, 100]]).T)
    n = 2 * BLOCK
    steps = (np.arange(n) == 5).astype(int)
    points = scanner.reconstruct(pixels(np.random.default_rng(6), n), steps)
    assert np.isnan(points[:, 5]).all() and np.isfinite(np.delete(points, 5, 1)).all()
    assert np.isnan(scanner.reconstruct(np.array([[600.0], [500.0]]), np.array([1]))).all()


@pytest.mark.parametrize("steps", [np.arange(5), np.array([7, 3, 9]), np.array([0, 5_000_000])])
def test_steps_find_their_planes_and_unknown_ones_their_sentence(steps):
    scanner = Scanner(CAMERA, steps, planes(len(steps)))
    asked = np.tile(steps, 3)
    assert np.array_equal(scanner.steps[scanner.places(asked)], asked)
    for wrong in (-1, 4_000_000, steps.max() + 1, 6):
        if wrong not in steps:
            with pytest.raises(
                InputError, match=f"step {wrong}: expected one of the {len(steps)} steps"
            ):
                scanner.places(np.append(asked, wrong))
    assert scanner.places(np.empty(0, int)).size == 0


def test_no_points_are_no_mistake():
    scanner = Scanner(CAMERA, np.arange(3), planes(3))
    assert scanner.reconstruct(np.empty((2, 0)), np.empty(0, int)).shape == (3, 0)


EFFECTS = [
    ("lens-residual", "camera", {}, 0.1 * np.arange(-5, 5)),
    ("window-refraction", "camera", {}, np.array([2.0])),
    ("mirror-encoder-harmonic", "mirror", {"order": 40}, np.array([1e-3, -2e-3])),
    ("mirror-wobble", "mirror", {}, 1e-2 * np.array([0.1, 1, 0.2, 1, -0.1, 1, 0.1, 2])),
    ("plane-bow", "laser", {}, np.array([2e-4])),
]
WIDTH = {"pixel": 2, "ray": 3, "mirror": 1, "plane": 5}


def changes(effects, chain, state):
    """What effects do to each port, as the core would tell the chain."""
    made = {}
    for effect, values in effects:
        whole = made.setdefault(
            effect.port, (np.arange(WIDTH[effect.port]), np.zeros((WIDTH[effect.port], chain.n)))
        )[1]
        whole[list(effect.port_indices(chain))] += effect.delta(values, state)
    return made


@pytest.mark.parametrize(
    "rows", [*([row] for row in EFFECTS), EFFECTS], ids=[*(row[0] for row in EFFECTS), "all"]
)
def test_effects_act_on_scans_as_on_the_stripe_chain(rows):
    scene = simulated_scanner(
        np.random.default_rng(7), placements=2, steps=4, points=30, stripe=0.0
    )
    chain = BoardStripeChain(
        CAMERA,
        scene.stripes,
        {"placement": scene.placement, "step": scene.step},
        scene.poses,
        scene.planes,
        MIDDLE,
        HALF_DIAGONAL,
        mirror=scene.mirror,
        angles=scene.angles,
    )
    effects = tuple(
        (CATALOGUE[name](where, **options), values) for name, where, options, values in rows
    )
    found = Scanner(
        CAMERA, np.arange(4), scene.planes, scene.mirror, scene.angles, effects
    ).reconstruct(chain.pixels, scene.step)
    plain = Scanner(CAMERA, np.arange(4), scene.planes).reconstruct(chain.pixels, scene.step)
    assert abs(found - plain).max() > 1e-3
    deltas = changes(
        effects,
        chain,
        Scanner(CAMERA, np.arange(4), scene.planes, scene.mirror, scene.angles)._state(
            chain.pixels, scene.step, plain, {}, None
        ),
    )
    here = chain.evaluate(chain.parameters.values, deltas)
    assert abs(np.cross(found, here.ray, axis=0)).max() < 1e-9 * 125
    along = (stripe_direction(scene.planes)[:, scene.step] * found).sum(0)
    curvature = deltas["plane"][1][4] if "plane" in deltas else 0
    assert abs((here.plane[:3] * found).sum(0) + here.plane[3] + curvature * along**2).max() < 1e-9


def test_an_effect_on_the_point_is_taken_off_what_was_reconstructed():
    effect = CATALOGUE["range-scale"]("sensor", z0=125.0)
    seen, steps = pixels(np.random.default_rng(8), 50), np.zeros(50, int)
    plain = Scanner(CAMERA, np.arange(1), planes(1)).reconstruct(seen, steps)
    found = Scanner(
        CAMERA, np.arange(1), planes(1), effects=((effect, np.array([2e-3])),)
    ).reconstruct(seen, steps)
    assert np.allclose(plain[2] - found[2], 2e-3 * (plain[2] - 125), atol=1e-12)
    assert np.allclose(plain[:2], found[:2], atol=1e-12)


def test_an_effect_asks_for_its_column_and_for_a_mirror():
    late = CATALOGUE["frame-sync"]("time")
    scanner = Scanner(CAMERA, np.arange(3), planes(3), effects=((late, np.array([1e-3])),))
    seen, steps = pixels(np.random.default_rng(9), 5), np.zeros(5, int)
    with pytest.raises(InputError, match="expected a column mirror_speed_deg_s"):
        scanner.reconstruct(seen, steps)
    with pytest.raises(InputError, match="expected a mirror"):
        scanner.reconstruct(seen, steps, {"mirror_speed_deg_s": np.full(5, 100.0)})


def numeric(function, size, step):
    return np.stack(
        [(function(step * unit) - function(-step * unit)) / (2 * step) for unit in np.eye(size)]
    )


def test_points_move_as_stated_with_pixels_planes_and_camera():
    rng = np.random.default_rng(10)
    seen, own = pixels(rng, 20), planes(1)
    points = cut(CAMERA.normalised(seen), own)
    whole = np.repeat(own, 20, 1)
    found = by_pixel(CAMERA, points, whole)
    assert np.allclose(
        found, numeric(lambda d: cut(CAMERA.normalised(seen + d[:, None]), own), 2, 1e-3), atol=1e-7
    )
    found = by_plane(points, whole)
    assert np.allclose(
        found,
        numeric(lambda d: cut(CAMERA.normalised(seen), moved(own, d[None])), 3, 1e-6),
        atol=1e-4,
    )
    found, values = by_camera(CAMERA, points, whole), CAMERA.values
    size = np.array([1, 1, 1, 1, 1e-2, 1e-1, 1e-2, 1e-2, 1]) * 1e-3
    for k in range(9):
        sides = [
            cut(
                Camera.of(values + sign * size[k] * np.eye(9)[k], CAMERA.size).normalised(seen), own
            )
            for sign in (1, -1)
        ]
        assert np.allclose(found[k], (sides[0] - sides[1]) / (2 * size[k]), rtol=1e-4, atol=1e-7), k


def test_planes_move_with_their_frame():
    own = planes(3)
    points, step = field_points(CAMERA, own, 115, 135)
    for k, (move, change) in enumerate(
        zip(frame_moves(points), plane_moves(own).transpose(0, 2, 1))
    ):
        there = moved(own, 1e-6 * change)
        distance = (there[:3, step] * (points + 1e-6 * move)).sum(0) + there[3, step]
        assert abs(distance).max() < 1e-9, k


def test_points_of_the_working_volume_lie_on_their_planes_and_in_the_image():
    points, step = field_points(CAMERA, planes(5), 115, 135)
    own = planes(5)[:, step]
    assert abs((own[:3] * points).sum(0) + own[3]).max() < 1e-9
    seen = CAMERA.project(points)
    assert (seen > 0).all() and (seen < [[1279], [1023]]).all()
    assert points[2].min() == 115 and points[2].max() == 135 and len(np.unique(step)) == 5
