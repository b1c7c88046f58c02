"""Hand-eye sets made by formula, with the truth known: views of a board, profiles of a ball, and their flange poses."""

from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from sensors.camera.model import Camera
from workbench.core.rigid import inverse, rotation_vector, transform

CAMERA = Camera(1800.0, 1805.0, 640.0, 500.0, (-0.1, 0.05, 0.001, -0.001, 0.0), (1280, 1024))
HAND_EYE = transform(
    Rotation.from_euler("xyz", [170, 5, 30], degrees=True).as_matrix(), np.array([60.0, -20, 90])
)
NOISE, SHIFT, SPIN = 0.1, 0.2, 3e-4
# Two sensors that look along -z and turn up to 25 degrees about any axis.
LOOKS = Rotation.from_euler("xyz", [180, 0, 0], degrees=True).as_matrix()


def board():
    x, y = np.meshgrid(np.arange(7) * 15.0, np.arange(5) * 15.0)
    return SimpleNamespace(points=np.stack([x.ravel(), y.ravel(), np.zeros(35)]))


def looks(count, random, tilt=0.35):
    """(P, 3, 3) turns of a sensor that looks down, spun about its axis and tilted."""
    spins = Rotation.from_rotvec(
        np.stack([*random.uniform(-tilt, tilt, (2, count)), random.uniform(-1.2, 1.2, count)], 1)
    )
    return LOOKS @ spins.as_matrix()


def jolt(count, random, shift, spin):
    """(P, 4, 4) errors of a robot's pose."""
    return transform(
        Rotation.from_rotvec(random.normal(0, spin, (count, 3))).as_matrix(),
        random.normal(0, shift, (count, 3)),
    )


def images(
    seed, kind="in-hand", count=12, turns=None, shift=SHIFT, spin=SPIN, noise=NOISE, points=None
):
    """Views and flange poses of a rendered-by-formula set: true hand-eye HAND_EYE; board at the base's (400, 0, 50)."""
    random = np.random.default_rng(seed)
    points = board().points if points is None else points
    middle = board().points.mean(1)
    turns = looks(count, random) if turns is None else turns
    eyes = transform(turns, np.zeros((count, 3)))
    eyes[:, :3, 3] = -300 * turns[:, :, 2] + random.uniform(
        -20, 20, (count, 3)
    )  # camera in the board's middle's frame
    seen = inverse(eyes) @ transform(np.eye(3), -middle)  # T_camera_board
    errors = (
        transform(np.eye(3), middle)
        @ jolt(count, random, shift, spin)
        @ transform(np.eye(3), -middle)
    )
    placed = transform(Rotation.from_rotvec([0.1, -0.2, 0.5]).as_matrix(), np.array([400.0, 0, 50]))
    if kind == "in-hand":
        flange = placed @ errors @ inverse(seen) @ inverse(HAND_EYE)
    else:
        flange = HAND_EYE @ seen @ inverse(placed @ errors)
    views = []
    for pose in seen:
        pixels = CAMERA.project(pose[:3, :3] @ points + pose[:3, 3:])
        views.append(
            SimpleNamespace(
                index=np.arange(35), pixels=pixels + random.normal(0, noise, pixels.shape)
            )
        )
    return views, flange


def off(found, truth=HAND_EYE):
    """(6,) mm and small turn (rad) along the outer axes, found less true."""
    return np.concatenate(
        [found[:3, 3] - truth[:3, 3], rotation_vector(found[:3, :3] @ truth[:3, :3].T)]
    )


def profiles(seed, count=12, turns=None, radius=20.0, noise=0.01, shift=0.05, larger=0.005):
    """Points (3, n), pose numbers and flange poses of a profiler HAND_EYE over a ball at (500, 100, 80)."""
    random = np.random.default_rng(seed)
    turns = looks(count, random) if turns is None else turns
    eyes = transform(turns, np.zeros((count, 3)))
    across = random.choice([-1, 1], count) * random.uniform(0.1, 0.6, count) * radius
    local = np.stack([random.uniform(-10, 10, count), across, random.uniform(90, 130, count)], 1)
    eyes[:, :3, 3] = [500.0, 100.0, 80.0] - np.einsum("pij,pj->pi", turns, local)
    flange = eyes @ inverse(HAND_EYE)
    flange[:, :3, 3] += random.normal(0, shift, (count, 3))
    cut = np.sqrt(radius**2 - across**2) + random.normal(0, larger, count)
    angle = np.radians(np.linspace(-160, -20, 150))[:, None]
    length = cut + random.normal(0, noise, (150, count))
    x, z = local[:, 0] + length * np.cos(angle), local[:, 2] + length * np.sin(angle)
    return (
        np.stack([x.T.ravel(), np.zeros(x.size), z.T.ravel()]),
        np.repeat(np.arange(count), 150),
        flange,
    )


def camera_prior(
    camera: Camera, focal: float = 0.002, centre: float = 0.005, distortion: float = 0.02
) -> np.ndarray:
    """(V, V) covariance of a camera of which only values are known, as data sheets state them.

    focal: of fx and fy, as a share; centre: of cx and cy, as a share of the focal length;
    distortion: of every coefficient, times 10 for each further power of the radius squared.
    """
    steps = [1, 10, 0.1, 0.1, 100, 1, 10, 100][: len(camera.distortion)]
    sigma = [focal * camera.fx, focal * camera.fy, centre * camera.fx, centre * camera.fy]
    return np.diag(np.square([*sigma, *(distortion * step for step in steps)]))
