"""That the checks of a scanner are checks: the mirror's probability, board poses left out, the frame's covariance."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import kstest

from conftest import sizes
from plane_scenes import CAMERA, board, board_stripes, simulated_scanner, views
from sensors.camera.calibration import calibrate_camera
from sensors.scanner.calibration import calibrate_scanner
from sensors.scanner.check import leave_out
from sensors.scanner.errors import by_plane, frame_moves, laid_over
from sensors.scanner.file import read_scanner, scanner_text, write_scanner
from sensors.scanner.model import Scanner
from workbench.core.errors import InputError


def calibrated(truth, **more):
    camera = calibrate_camera(views(truth), board(), CAMERA.size, folds=0)
    stripes = more.pop("stripes", board_stripes(truth))
    return calibrate_scanner(
        views(truth), stripes, board(), CAMERA.size, check=False, camera=camera, **more
    )


@pytest.fixture(scope="module")
def truth():
    return simulated_scanner(np.random.default_rng(3), points=15, steps=8, placements=6)


@pytest.fixture(scope="module")
def made(truth):
    return calibrated(truth)


def shifted(chain, group, by):
    """The chain with the stripes of one board pose `by` px farther along the rows."""
    pixels = chain.pixels.copy()
    pixels[0, chain.labels["placement"] == group] += by
    return replace(chain, pixels=pixels)


@pytest.mark.parametrize("which", ["free", "made"])
def test_a_left_out_placement_has_no_say_in_the_planes_it_is_judged_by(made, which):
    """Its stripes moved by half a pixel, its residuals move by just that; with a say they would by a sixth less."""
    fit, whole = getattr(made, which), made.stripes.at(~made.wrong)
    plain = leave_out(fit, whole)
    for group in (0, 3):
        changed = replace(fit, board_stripes=shifted(fit.board_stripes, group, 0.5))
        moved = leave_out(changed, shifted(whole, group, 0.5))
        own = whole.labels["placement"] == group
        assert np.abs((moved.residual_px - plain.residual_px)[own]) == pytest.approx(
            np.full(own.sum(), 0.5), abs=0.01
        )
        # and the others see it: they are judged by planes that it had a say in
        assert np.abs((moved.residual_px - plain.residual_px)[~own]).max() > 0.02


def test_a_commanded_angle_that_is_20_degrees_off_is_no_mirror(truth):
    """That of one step; all of them off by as much are the same mirror with another zero."""
    wrong = truth.angles + np.where(np.arange(8) == 5, np.deg2rad(20), 0)
    found = calibrated(truth, stripes=replace(board_stripes(truth), mirror=wrong[truth.step]))
    check = found.mirror
    assert (
        check.probability < 1e-9
        and not check.agrees
        and not check.supported
        and found.scanner.mirror is None
    )
    assert "contradict it; it is refused and the free planes are used" in " ".join(found.sentences)


def test_planes_that_no_ray_meets_are_reported_and_not_laid_over(truth):
    behind = truth.planes * [[1], [1], [1], [-1]]
    points, step, distance, error = laid_over(CAMERA, truth.planes, CAMERA, behind, (115.0, 135.0))
    assert np.isnan(error).all() and np.allclose(
        distance, (behind[:3, step] * points).sum(0) + behind[3, step]
    )
    nowhere = laid_over(CAMERA, truth.planes, CAMERA, behind * np.nan, (115.0, 135.0))
    assert np.isnan(nowhere[2]).all()


@pytest.mark.parametrize(
    "angle",
    [lambda angles: angles + np.deg2rad(20), lambda angles: 0 * angles],
    ids=["zero", "same"],
)
def test_angles_with_another_zero_and_angles_that_say_nothing_are_a_mirror_all_the_same(
    truth, angle
):
    found = calibrated(
        truth, stripes=replace(board_stripes(truth), mirror=angle(truth.angles)[truth.step])
    )
    assert found.mirror.agrees and found.mirror.supported


def test_what_is_said_of_the_mirror_is_what_was_tested(made):
    """By chi-square and by how far the planes are from one another; the two are not confused."""
    fine = replace(made.mirror, probability=0.4, difference_mm=2.0, expected_mm=1.0)
    assert fine.agrees and fine.supported and "agree with one mirror; it is used" in fine.verdict
    near = replace(made.mirror, probability=1e-30, difference_mm=0.5, expected_mm=1.0)
    assert near.supported and not near.agrees
    assert "contradict one perfect mirror" in near.verdict and "sigmas do not hold" in near.verdict
    far = replace(near, difference_mm=1.5)
    assert not far.supported and "refused" in far.verdict
    assert made.mirror.verdict in " ".join(made.sentences)


@cache
def made_of(seed):
    """A simulated scanner of so many small ones, and what its calibration finds."""
    scene = simulated_scanner(np.random.default_rng(700 + seed), points=20, steps=8, placements=6)
    return scene, calibrated(scene)


@pytest.mark.parametrize("count", sizes(30, 60))
def test_the_mirrors_probability_is_uniform_where_it_is_true(count):
    found = [made_of(seed)[1].mirror for seed in range(count)]
    probability = np.array([check.probability for check in found])
    assert kstest(probability, "uniform").pvalue > 0.01
    assert all(check.agrees for check in found)
    ratio = np.mean([check.difference_mm**2 for check in found]) / np.mean(
        [check.expected_mm**2 for check in found]
    )
    assert ratio == pytest.approx(1, abs=0.35)


def test_the_frame_goes_into_the_file_and_comes_back(made, tmp_path):
    assert np.array_equal(
        made.scanner.frame, made.best_frame.frame
    ) and made.scanner.frame.shape == (
        6,
        6,
    )
    write_scanner(made.scanner, tmp_path / "scanner.toml")
    read = read_scanner(tmp_path / "scanner.toml")
    assert np.array_equal(read.frame, made.scanner.frame) and scanner_text(read) == scanner_text(
        made.scanner
    )
    bare = Scanner(CAMERA, made.scanner.steps, made.scanner.planes)
    assert (
        "frame_covariance" not in scanner_text(bare)
        and not bare.frame_covariance(np.ones((3, 2))).any()
    )


@pytest.mark.parametrize(
    "change",
    [
        lambda frame: frame - 2 * np.diag(np.diag(frame)),
        lambda frame: frame + np.triu(frame, 1),
        lambda frame: frame[:5],
    ],
)
def test_a_frame_that_is_no_covariance_is_named(made, tmp_path, change):
    path = tmp_path / "scanner.toml"
    path.write_text(
        scanner_text(replace(made.scanner, frame=change(made.scanner.frame))), encoding="utf-8"
    )
    with pytest.raises(InputError, match="light.frame_covariance"):
        read_scanner(path)


@pytest.mark.slow
def test_places_in_the_cameras_frame_err_as_the_frame_and_the_planes_say():
    """Of a point that the true planes hold, over seeds; without the frame the sigma is ten times too small."""
    point, z, blind = np.array([[2.0], [-3.0], [125.0]]), [], []
    for seed in range(30):
        scene, found = made_of(seed)
        found = found.scanner
        distance = scene.planes[:3].T @ point[:, 0] + scene.planes[3]
        step = int(found.steps[np.argmin(np.abs(distance[found.steps]))])
        normal, offset = scene.planes[:3, step], scene.planes[3, step]
        on = point * (-offset / (normal @ point))  # along its ray, in the plane
        error = (found.reconstruct(CAMERA.project(on), np.array([step])) - on)[:, 0]
        place = found.places(np.array([step]))
        moves = by_plane(on, found.planes[:, place])[..., 0]
        own = moves.T @ found.plane_covariance[place[0]] @ moves
        z.append(error / np.sqrt(np.diag(own + found.frame_covariance(on)[..., 0])))
        blind.append(error[2] / np.sqrt(own[2, 2]))
    assert np.sqrt(np.square(z).mean()) == pytest.approx(1, abs=0.25)
    assert np.sqrt(np.square(blind).mean()) > 2


def test_frame_moves_are_a_shift_and_a_turn():
    from workbench.core.rigid import rotation_matrix

    points, small = (
        np.random.default_rng(0).uniform(-50, 150, (3, 6)),
        np.array([1e-3, -2e-3, 3e-3, 1e-5, 2e-5, -1e-5]),
    )
    there = rotation_matrix(small[3:]) @ points + small[:3, None]
    assert np.abs(points + np.tensordot(small, frame_moves(points), 1) - there).max() < 1e-7
