"""Hand-eye from motions that determine little: nothing raises, and what is undetermined is named and has no sigma."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import mostly_slow
from hand_eye_scenes import (
    CAMERA,
    HAND_EYE,
    LOOKS,
    board,
    camera_prior,
    images,
    jolt,
    looks,
    off,
    profiles,
)
from sensors.hand_eye.images import hand_eye_from_views
from sensors.hand_eye.motion import motion
from sensors.hand_eye.profiles import hand_eye_from_profiles
from sensors.hand_eye.start import align
from workbench.core.rigid import inverse, rotation_vector, transform

COUNT = 10


def rotations(name, count=COUNT):
    """(P, 3, 3) of a sensor that looks down."""
    random, step = np.random.default_rng(1), np.arange(count)
    vectors = {
        "constant": np.zeros((count, 3)),
        "one axis": np.outer(np.linspace(-1, 1, count), [0, 0, 1]),
        "tilts": np.outer(np.linspace(-0.4, 0.4, count), [1, 0.3, 0]),
        "half turns": np.outer(step % 2 * np.pi, [0, 0, 1]),
        "quarter turns": np.outer(step % 4 * np.pi / 2, [0, 0, 1]),
        "half turns about two axes": np.array(
            [[0, 0, 0], [0, 0, np.pi], [np.pi, 0, 0], [0, np.pi, 0]]
        )[step % 4],
        "rounding": random.uniform(-1e-5, 1e-5, (count, 3)),
        "free": random.uniform(-0.35, 0.35, (count, 3)),
    }
    return LOOKS @ Rotation.from_rotvec(vectors[name]).as_matrix()


PLACES = {
    "box": np.random.default_rng(2).uniform(-40, 40, (COUNT, 3)),
    "line": np.outer(np.linspace(-40, 40, COUNT), [0.6, 0.8, 0]),
    "one place": np.zeros((COUNT, 3)),
}


def image_poses(turns, places, kind="in-hand", noise=1.0, seed=3):
    """Views and flange poses of a camera at `places` (P, 3), mm from 300 mm before the middle of the board."""
    random, points = np.random.default_rng(seed), board().points
    middle = points.mean(1)
    eyes = transform(turns, -300 * turns[:, :, 2] + places)
    seen = inverse(eyes) @ transform(np.eye(3), -middle)
    errors = transform(np.eye(3), middle) @ jolt(len(turns), random, 0.02 * noise, 1e-5 * noise)
    errors = errors @ transform(np.eye(3), -middle)
    placed = transform(Rotation.from_rotvec([0.1, -0.2, 0.5]).as_matrix(), np.array([400.0, 0, 50]))
    flange = placed @ errors @ inverse(seen) @ inverse(HAND_EYE)
    if kind == "to-hand":
        flange = HAND_EYE @ seen @ inverse(placed @ errors)
    views = []
    for pose in seen:
        pixels = CAMERA.project(pose[:3, :3] @ points + pose[:3, 3:])
        views.append(
            SimpleNamespace(
                index=np.arange(35), pixels=pixels + 0.1 * noise * random.normal(size=pixels.shape)
            )
        )
    return views, flange


def check_stated(found):
    """Sigmas are positive or infinite, and what is finite holds."""
    variance = np.diag(found.covariance)
    assert np.isfinite(found.sensor).all() and not np.isnan(variance).any() and (variance > 0).all()
    assert not np.isnan(list(found.std.values())).any()
    error, sure = np.abs(off(found.sensor)), np.isfinite(variance)
    assert (error[sure] < 6 * np.sqrt(variance[sure]) + 1e-6).all(), (error, np.sqrt(variance))


OPEN = {
    ("constant", "box"): ("never turned", [1, 1, 1, 0, 0, 0]),
    ("constant", "line"): ("along one line only", [1, 1, 1, 1, 1, 1]),
    ("constant", "one place"): ("never moved", [1, 1, 1, 1, 1, 1]),
    ("one axis", "box"): ("about one axis only", [1, 1, 1, 0, 0, 0]),
    ("one axis", "one place"): ("one fixed line only", [1, 1, 1, 1, 1, 1]),
    ("half turns", "box"): ("about one axis only", [1, 1, 1, 0, 0, 0]),
    ("free", "one place"): (None, [0, 0, 0, 0, 0, 0]),
}


RECORDED = (("in-hand", 0.0), ("in-hand", 1.0), ("to-hand", 0.0), ("to-hand", 1.0))
OPENED = [(*motions, *recorded) for motions in OPEN for recorded in RECORDED]


@pytest.mark.parametrize(("turns", "places", "kind", "noise"), mostly_slow(OPENED, 4, 8))
def test_one_sentence_says_which_translations_and_rotations_are_undetermined(
    turns, places, kind, noise
):
    """And they have no sigma: the constant flange orientation, the single line, the single axis, no motion at all."""
    words, undetermined = OPEN[turns, places]
    views, flange = image_poses(rotations(turns), PLACES[places], kind, noise)
    found = hand_eye_from_views(views, board(), CAMERA, flange, kind)
    check_stated(found)
    assert np.isinf(np.diag(found.covariance)).tolist() == [bool(k) for k in undetermined]
    assert len(found.undetermined) == (words is not None)
    assert words is None or words in found.undetermined[0]


REPEATED = {
    "distinct": np.arange(8),
    "identical": np.zeros(8, int),
    "two poses": np.arange(8) % 2,
    "pairs": np.arange(8) // 2,
}
FEW = [
    ("tilts", "distinct", "free radius"),
    ("rounding", "distinct", "radius"),
    ("rounding", "pairs", "radius"),
    ("quarter turns", "pairs", "radius"),
    ("constant", "two poses", "radius"),
    ("constant", "distinct", "radius"),
    ("one axis", "identical", "camera"),
    ("half turns", "pairs", "camera"),
    ("half turns", "pairs", "to-hand"),
    ("half turns about two axes", "distinct", "to-hand"),
    ("free", "identical", "in-hand"),
    ("free", "two poses", "radius"),
    ("free", "pairs", "in-hand"),
    ("constant", "identical", "free radius"),
]


EXACT_AND_NOISY = [(*case, noise) for case in FEW for noise in (0.0, 1.0)]


@pytest.mark.parametrize(("turns", "repeated", "what", "noise"), mostly_slow(EXACT_AND_NOISY, 4, 7))
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_repeated_poses_and_exact_data_end_in_a_result(turns, repeated, what, noise):
    """Duplicated poses, half turns, rotations of the size of rounding; residuals of exactly zero."""
    order, turned = REPEATED[repeated], rotations(turns, 8)
    if "radius" in what:
        points, pose, flange = profiles(
            5, 8, turned, noise=0.01 * noise, shift=0.05 * noise, larger=0.005 * noise
        )
        points, flange = points.reshape(3, 8, -1)[:, order].reshape(3, -1), flange[order]
        found = hand_eye_from_profiles(points, pose, flange, 20.0 if what == "radius" else None)
    else:
        kind = "to-hand" if what == "to-hand" else "in-hand"
        views, flange = images(
            5, kind, 8, turned, shift=0.2 * noise, spin=3e-4 * noise, noise=0.1 * noise
        )
        prior = camera_prior(CAMERA) if what == "camera" else None
        views, flange = [views[k] for k in order], flange[order]
        found = hand_eye_from_views(views, board(), CAMERA, flange, kind, camera_covariance=prior)
    variance = np.diag(found.covariance)
    assert np.isfinite(found.sensor).all() and not np.isnan(variance).any() and (variance > 0).all()
    assert not np.isnan(list(found.std.values())).any() and all(
        np.isfinite(list(found.fit.values()))
    )
    if (
        turns != "free"
        and turns != "half turns about two axes"
        or repeated in ("identical", "two poses")
    ):
        assert found.undetermined and np.isinf(variance).any()


@pytest.mark.parametrize("kind", ["in-hand", "to-hand"])
def test_the_small_motions_named_change_no_measurement(kind):
    """x commutes with every motion of the flange: the predicted board pose in the camera stays where it is."""
    for turns, places in OPEN:
        flange = image_poses(rotations(turns), PLACES[places], kind, 0.0)[1]
        moved = flange if kind == "in-hand" else inverse(flange)
        target = (
            moved[0]
            @ HAND_EYE
            @ transform(looks(1, np.random.default_rng(0))[0], np.array([5.0, 7, 300]))
        )
        before = inverse(HAND_EYE) @ inverse(moved) @ target
        found = motion(flange, kind)
        for sensor, carried in zip(found.sensor.T, found.target.T):
            after = (
                inverse(small(1e-4 * sensor) @ HAND_EYE)
                @ inverse(moved)
                @ small(1e-4 * carried)
                @ target
            )
            gap = inverse(before) @ after
            assert (
                np.abs(gap[:, :3, 3]).max() < 1e-3
                and np.abs(rotation_vector(gap[:, :3, :3])).max() < 1e-6
            )


def small(twist):
    return transform(Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3])


@pytest.mark.parametrize("turns", ["half turns", "half turns about two axes"])
def test_half_turns_align(turns):
    """Their axes have no sign; the products of the axes with themselves have."""
    moved = transform(rotations(turns), PLACES["box"])
    seen = inverse(HAND_EYE) @ inverse(moved) @ transform(np.eye(3), np.array([400.0, 0, 50]))
    found, misfit, _ = align(moved, seen)
    assert misfit < 0.5 and np.abs(off(found)[3:]).max() < 1e-3
