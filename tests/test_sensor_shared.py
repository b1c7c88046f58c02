"""Errors that points share: their variances are found, they stand in the sigmas, and weights follow them."""

from dataclasses import replace

import numpy as np
import pytest

from plane_scenes import CAMERA, board, board_stripes, twin, views
from sensors.ball.fit import fit_ball
from sensors.ball.shared import Shared
from sensors.components import components
from sensors.light.planes import tilt_directions
from sensors.light.together import Together, decorrelated
from sensors.scanner.calibration import calibrate_scanner
from sensors.scanner.file import read_scanner, write_scanner

SHIFT, TILT = 0.06, 0.05  # px


def shaken(seed, shift=SHIFT, tilt=TILT, placements=8, steps=8):
    """A twin whose stripes are each shifted, and tilted along themselves, as a whole."""
    rng = np.random.default_rng(seed)
    truth = twin(rng, placements, steps, 60, sweep=np.deg2rad(4))
    number = truth.placement * steps + truth.step
    along = truth.stripes[1] / CAMERA.size[1] * 2 - 1
    moved = rng.normal(0, shift, number.max() + 1)[number] + rng.normal(0, tilt, number.max() + 1)[number] * along
    return replace(truth, stripes=truth.stripes + np.stack([moved, 0 * moved]))


def calibrated(truth, **more):
    return calibrate_scanner(views(truth), board_stripes(truth), board(), CAMERA.size, check=False, **more)


def whitened(made, truth):
    """Errors of camera and free planes, as independent numbers of variance one where the covariance is right."""
    planes, real = made.free.sheets.planes, truth.planes[:, made.scanner.steps]
    real = real * np.sign((real[:3] * planes[:3]).sum(0))
    tilts = np.einsum("kis,is->ks", tilt_directions(planes), planes[:3] - real[:3])
    error = np.r_[made.free.camera.values - CAMERA.values, np.vstack([tilts, planes[3] - real[3]]).T.ravel()]
    factor = made.free.joint()
    size = np.sqrt((factor**2).sum(1))
    values, vectors = np.linalg.eigh(factor @ factor.T / np.outer(size, size))
    known = values > 1e-7 * values[-1]  # below, rounding and the second order of the tilts
    return vectors[:, known].T @ (error / size) / np.sqrt(values[known])


def test_decorrelated_errors_are_those_of_the_whole_covariance():
    """T'W T is the inverse of the covariance with all shared errors in it, also where a point stands there twice."""
    rng, n = np.random.default_rng(1), 30
    labels = {"placement": np.repeat([0, 1], 15), "step": np.tile(np.repeat([0, 1, 2], 5), 2)}
    together = replace(Together.of(labels, rng.uniform(0, 1000, n)), sigma=np.array([0.2, 0.1, 0.3]))
    sigma = rng.uniform(0.1, 0.4, n)
    covariance = np.diag(sigma**2)
    for spread, label, shape in zip(together.sigma, together.labels, together.shapes):
        covariance += spread**2 * (label[:, None] == label) * np.outer(shape, shape)
    made = decorrelated(together.steps(sigma), np.eye(n)).T
    np.testing.assert_allclose(made.T @ np.diag(sigma**-2) @ made, np.linalg.inv(covariance), rtol=1e-9, atol=1e-9)
    twice = together.at(np.r_[np.arange(n), 3, 3])
    again = decorrelated(twice.steps(np.r_[sigma, sigma[[3, 3]]]), np.r_[made[3], made[3, [3, 3]]])
    np.testing.assert_allclose(again[:n], decorrelated(together.steps(sigma), made[3]), atol=1e-12)


def test_variances_of_a_layout_are_found():
    """Two kinds of shared error and the noise, over sets of random layout: right in the mean, and as sure as stated."""
    rng, found = np.random.default_rng(2), []
    for _ in range(40):
        groups, n = 30, 300
        label, shape = rng.integers(groups, size=n), rng.normal(size=n)
        design = np.zeros((n, 2 * groups))
        design[np.arange(n), label], design[np.arange(n), groups + label] = 1, shape
        known = rng.normal(size=(n, 5))
        y = known @ rng.normal(size=5) + design @ np.r_[rng.normal(0, 0.5, groups), rng.normal(0, 0.8, groups)]
        y += 1.3 * rng.normal(size=n)
        project = np.eye(n) - known @ np.linalg.solve(known.T @ known, known.T)
        made = components(design.T @ project @ design, design.T @ project @ y, np.repeat([0, 1], groups),
                          float(y @ project @ y), n - 5)  # fmt: skip
        found.append([*made.variance, made.noise, *made.std])
    mean, spread = np.mean(found, 0), np.std(found, 0)
    assert (np.abs(mean[:3] - [0.25, 0.64, 1.69]) < 3 * spread[:3] / np.sqrt(40)).all()
    np.testing.assert_allclose(mean[3:], spread[:2], rtol=0.35)


def test_a_kind_that_the_unknowns_take_whole_has_no_variance():
    """Two groups beside a mean: one difference, which tells nothing of a variance."""
    design = np.repeat(np.eye(2), 50, axis=0)
    project = np.eye(100) - 0.01
    y = design @ [3.0, -3.0] + np.random.default_rng(3).normal(size=100)
    made = components(design.T @ project @ design, design.T @ project @ y, np.zeros(2, int), float(y @ project @ y), 99)
    assert made.variance[0] == 0 and np.isinf(made.std[0])


def test_stripes_that_err_as_a_whole_are_found_and_said(tmp_path):
    made = calibrated(shaken(4))
    together = made.made.sheets.together
    assert (np.abs(together.sigma[:2] - [SHIFT, TILT]) < 3 * together.std[:2]).all() and (together.std[:2] < 0.03).all()
    assert together.sentence in made.sentences and "together" in together.sentence
    write_scanner(made.scanner, tmp_path / "scanner.toml")
    assert read_scanner(tmp_path / "scanner.toml").shared_px == made.scanner.shared_px == together.named


def test_stripes_that_do_not_are_left_alone():
    together = calibrated(shaken(5, 0.0, 0.0)).free.sheets.together
    assert (together.sigma[:2] < 0.03).all() and (together.std[:2] < 0.03).all()


@pytest.mark.slow
def test_sigmas_of_planes_cover_the_truth_where_stripes_err_as_a_whole():
    """68 % within one sigma over eight sets; with points taken as independent, less than half as many."""
    z = np.concatenate([whitened(calibrated(shaken(seed), mirror=False), truth=shaken(seed)) for seed in range(10, 18)])
    assert 0.62 < (np.abs(z) < 1).mean() < 0.74


def test_a_ball_finds_what_its_stripes_share():
    """Stripes of a ball shifted as a whole: the centre's sigma covers it, and is larger than without."""
    rng = np.random.default_rng(6)
    towards = np.array([0.0, 0.0, -1.0])
    covered, plain = [], []
    for _ in range(30):
        x = np.repeat(np.linspace(-10, 10, 20), 30)
        y = np.tile(np.linspace(-10, 10, 30), 20)
        points = np.stack([x, y, 150 - np.sqrt(15**2 - x**2 - np.clip(y, -10, 10) ** 2)])
        step = np.repeat(np.arange(20), 30)
        along = np.tile(towards[:, None], len(x))
        points = points + towards[:, None] * (rng.normal(0, 0.003, len(x)) + rng.normal(0, 0.004, 20)[step])
        shared = Shared(step, along[None], 1e-12 * np.eye(20), along[None])
        for kept, one in ((covered, shared), (plain, replace(shared, unknown=None))):
            fit = fit_ball(points, 0.003, 15.0, direction=along, shared=one, ordered=False)
            kept.append((fit.centre - [0, 0, 150]) / fit.std[:3])
    assert 0.85 < np.sqrt(np.mean(np.square(covered))) < 1.2 < np.sqrt(np.mean(np.square(plain)))
