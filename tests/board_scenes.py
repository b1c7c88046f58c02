"""Made boards before a made camera, as corners with known truth: what the tests of the sensor's solves share."""

from dataclasses import replace

import numpy as np

from sensors.camera.corners import Corners
from sensors.camera.model import Camera
from sensors.effects import CATALOGUE
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.rigid import rotation_matrix

CAMERA = Camera(3421.0, 3420.0, 640.0, 512.0, (-0.1, 0.05, 1e-3, -1e-3, 0.0), (1280, 1024))
COLUMNS, ROWS, SQUARE = 11, 8, 3.5
BOW = {"artefact.board-bow.xx": 0.05, "artefact.board-bow.yy": 0.03, "artefact.board-bow.xy": 0.0}


def board_points() -> np.ndarray:
    """(3, 88) mm, z = 0, origin at the first corner."""
    x, y = np.meshgrid(np.arange(COLUMNS) * SQUARE, np.arange(ROWS) * SQUARE)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def board_poses(rng, count: int, tilt: float = 0.6) -> np.ndarray:
    """(count, 6) poses about 125 mm away, tilted by up to `tilt` rad about each axis, the board filling the image."""
    turns = rng.uniform(-tilt, tilt, (count, 3))
    middle = np.array([(COLUMNS - 1) * SQUARE / 2, (ROWS - 1) * SQUARE / 2, 0])
    away = np.stack(
        [rng.uniform(-4, 4, count), rng.uniform(-4, 4, count), rng.uniform(115, 135, count)], -1
    )
    return np.c_[away - rotation_matrix(turns) @ middle, turns]


def board_model(
    rng,
    count=20,
    bow=BOW,
    noise=0.06,
    radius=0.0,
    camera=CAMERA,
    effects=(),
    tilt=0.6,
    poses=None,
    values=None,
) -> tuple[Model, Parameters]:
    """Corners of `count` boards with normal noise (px), the board-bow and other effects; and their true parameters."""
    poses = board_poses(rng, count, tilt) if poses is None else poses
    points = board_points()
    middle = points.mean(1, keepdims=True)
    place = ((points - middle) / np.linalg.norm(points[:, -1:] - middle))[:2]
    n = points.shape[1] * count
    chain = Corners(
        camera,
        np.tile(points, count),
        np.tile(place, count),
        np.zeros((2, n)),
        {"placement": np.repeat(np.arange(count), points.shape[1])},
        poses,
        np.full((2, 1), noise or 0.06),
        radius,
    )
    aimed = Model(chain).residual(Model(chain).parameters)
    chain = replace(chain, pixels=aimed)  # effects on the lens ask where in the image
    model = Model(chain, (CATALOGUE["board-bow"]("artefact"), *effects))
    truth = model.parameters.update({**bow, **(values or {})})
    seen = aimed + model.residual(truth)
    noisy = seen + rng.normal(0, noise, seen.shape)
    return Model(replace(chain, pixels=noisy, _kept_state=model.chain.state), model.effects), truth


def disturbed(rng, poses: np.ndarray, size: float = 1.0) -> np.ndarray:
    """Poses off by about a millimetre and a hundredth of a radian, times `size`."""
    return poses + size * rng.normal(0, 1, poses.shape) * [1, 1, 3, 0.02, 0.02, 0.02]
