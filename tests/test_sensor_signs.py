"""Signs of effects that no image shows by itself: scans made from the vocabulary's laws, in plain numbers, are undone."""

import numpy as np
import pytest

from sensors.camera.model import Camera
from sensors.effects import CATALOGUE
from sensors.light.mirror import Mirror
from sensors.scanner.model import Scanner

F, CX, CY = 1500.0, 640.0, 512.0
ANGLES = np.deg2rad([-3.0, -1.0, 0.5, 2.5])
FACE, BEAM, BASE = np.deg2rad(16.0), np.deg2rad(61.0), -69.0


def light_planes(phi) -> tuple[np.ndarray, np.ndarray]:
    """Normals (3, n) and offsets (n,) of a light plane upright through (BASE, 0, 0), mirrored in a face turned by phi about y."""
    normal = np.array(
        [np.cos(FACE - phi), 0 * phi, np.sin(FACE - phi)]
    )  # right-handed about y: from z to x
    light_plane = np.array([np.cos(BEAM), 0, np.sin(BEAM)])
    mirrored = light_plane[:, None] - 2 * (light_plane @ normal) * normal
    return mirrored, -mirrored[0] * BASE


def scanner(effect, *values) -> Scanner:
    light_plane = np.array([np.cos(BEAM), 0, np.sin(BEAM)])
    mirror = Mirror(
        np.array([0.0, 1, 0]),
        np.array([BASE, 0, 0]),
        np.array([np.cos(FACE), 0, np.sin(FACE)]),
        0.0,
        np.append(light_plane, -light_plane[0] * BASE),
    )
    camera = Camera(F, F, CX, CY, (0.0,) * 5, (1280, 1024))
    normal, offset = light_planes(ANGLES)
    return Scanner(
        camera,
        np.arange(4),
        np.vstack([normal, offset]),
        mirror,
        ANGLES,
        ((effect, np.array(values)),),
    )


def seen(rng, n=40):
    """Pixels (2, n), steps (n,)."""
    return np.stack([rng.uniform(300, 1000, n), rng.uniform(200, 800, n)]), rng.integers(0, 4, n)


def cut(pixels, phi) -> np.ndarray:
    """(3, n) mm where rays through ideal pixels meet the light at mirror angles phi (n,)."""
    ray = np.array([(pixels[0] - CX) / F, (pixels[1] - CY) / F, np.ones(pixels.shape[1])])
    normal, offset = light_planes(phi)
    return ray * (-offset / (normal * ray).sum(0))


def undone(effect, values, pixels, steps, covariates, truth):
    """The effect acts by more than 0.01 mm, and what is left with it is next to nothing."""
    plain = cut(pixels, ANGLES[steps])
    assert np.abs(plain - truth).max() > 0.01 and plain[2].min() > 50
    found = scanner(effect, *values).reconstruct(pixels, steps, covariates)
    assert np.abs(found - truth).max() < 1e-9


def test_images_taken_late_are_lit_where_the_mirror_has_turned_to():
    """frame-sync: dphi = omega dt; at 40 degrees a second, 2 ms are 0.08 degrees further."""
    rng = np.random.default_rng(1)
    pixels, steps = seen(rng)
    speed = rng.choice([-40.0, 25.0], 40)
    truth = cut(pixels, ANGLES[steps] + np.pi / 180 * speed * 0.002)
    undone(
        CATALOGUE["frame-sync"]("time"),
        [0.002],
        pixels,
        steps,
        {"mirror_speed_deg_s": speed},
        truth,
    )


def test_a_mirror_with_hysteresis_is_off_towards_its_sweep():
    """mirror-hysteresis: dphi = h sweep direction."""
    rng = np.random.default_rng(2)
    pixels, steps = seen(rng)
    sweep = rng.choice([-1.0, 1.0], 40)
    truth = cut(pixels, ANGLES[steps] + 4e-4 * sweep)
    undone(CATALOGUE["mirror-hysteresis"]("mirror"), [4e-4], pixels, steps, {"sweep": sweep}, truth)


def test_an_encoders_harmonic_is_a_cosine_and_a_sine_of_the_commanded_angle():
    """mirror-encoder-harmonic: dphi = A cos(n phi) + B sin(n phi), each by itself, for their signs."""
    pixels, steps = seen(np.random.default_rng(3))
    phi = ANGLES[steps]
    effect = CATALOGUE["mirror-encoder-harmonic"]("mirror", order=30)
    undone(effect, [5e-4, 0.0], pixels, steps, {}, cut(pixels, phi + 5e-4 * np.cos(30 * phi)))
    undone(effect, [0.0, 5e-4], pixels, steps, {}, cut(pixels, phi + 5e-4 * np.sin(30 * phi)))


@pytest.mark.parametrize("column", ["temperature_camera_c", "temperature_c"])
@pytest.mark.parametrize(
    ("focal", "x", "y"), [(2e-5, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, 0.05)]
)
def test_a_warm_camera_is_one_of_longer_focal_length_and_moved_centre(column, focal, x, y):
    """camera-thermal-drift: what such a camera saw at 20 degrees plus dT is undone to the square of the drift."""
    rng = np.random.default_rng(4)
    points = np.stack([*rng.uniform(-30, 30, (2, 40)), rng.uniform(110, 140, 40)])
    warm = rng.uniform(-10, 15, 40)
    grown = F * (1 + focal * warm)
    pixels = np.stack(
        [
            CX + x * warm + grown * points[0] / points[2],
            CY + y * warm + grown * points[1] / points[2],
        ]
    )
    effect = CATALOGUE["camera-thermal-drift"]("camera")
    found = scanner(effect, focal, x, y).reconstruct(
        pixels, np.zeros(40, int), {column: 20.0 + warm}
    )
    cold = np.stack([CX + F * points[0] / points[2], CY + F * points[1] / points[2]])
    seen_at = CX + F * found[0] / found[2], CY + F * found[1] / found[2]
    assert np.abs(pixels - cold).max() > 0.05
    assert np.abs(np.array(seen_at) - cold).max() < 1e-4
