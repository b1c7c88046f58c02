"""Errors that points share: their variances are found, they stand in the sigmas, and weights follow them."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from plane_scenes import (
    CAMERA,
    aligned,
    board,
    board_stripes,
    seen,
    simulated_scanner,
    stripe_points,
    views,
)
from sensors.ball.fit import fit_ball
from sensors.ball.shared import Shared
from sensors.light.board_chain import BoardStripeChain
from sensors.light.planes import tilt_directions
from sensors.light.shared_errors import SharedStripeErrors, decorrelated
from sensors.scanner.adjustment import linearised, solve_once
from sensors.scanner.calibration import calibrate_scanner
from sensors.scanner.file import read_scanner, write_scanner
from sensors.scanner.shared import _effects, _left, shared_errors
from sensors.variance_components import VarianceComponents, estimate_components
from workbench.core.least_squares.bundle import solve_bundle
from workbench.core.least_squares.bundle_blocks import Family
from workbench.core.model import Model
from workbench.core.parameters import Parameter, Parameters

SHIFT, TILT = 0.06, 0.05  # px


def shaken(seed, shift=SHIFT, tilt=TILT, placements=8, steps=8):
    """A simulated scanner whose stripes are each shifted, and tilted along themselves, as a whole."""
    rng = np.random.default_rng(seed)
    truth = simulated_scanner(rng, placements, steps, 60, sweep=np.deg2rad(4))
    number = truth.placement * steps + truth.step
    along = truth.stripes[1] / CAMERA.size[1] * 2 - 1
    moved = (
        rng.normal(0, shift, number.max() + 1)[number]
        + rng.normal(0, tilt, number.max() + 1)[number] * along
    )
    return replace(truth, stripes=truth.stripes + np.stack([moved, 0 * moved]))


def calibrated(truth, **more):
    return calibrate_scanner(
        views(truth), board_stripes(truth), board(), CAMERA.size, check=False, **more
    )


def whitened(made, truth):
    """Errors of camera and free planes, as independent numbers of variance one where the covariance is right."""
    planes, real = made.free.board_stripes.planes, truth.planes[:, made.scanner.steps]
    real = real * np.sign((real[:3] * planes[:3]).sum(0))
    tilts = np.einsum("kis,is->ks", tilt_directions(planes), planes[:3] - real[:3])
    error = np.r_[
        made.free.camera.values - CAMERA.values, np.vstack([tilts, planes[3] - real[3]]).T.ravel()
    ]
    factor = made.free.joint()
    size = np.sqrt((factor**2).sum(1))
    values, vectors = np.linalg.eigh(factor @ factor.T / np.outer(size, size))
    known = values > 1e-7 * values[-1]  # below, rounding and the second order of the tilts
    return vectors[:, known].T @ (error / size) / np.sqrt(values[known])


def test_decorrelated_errors_are_those_of_the_whole_covariance():
    """T'W T is the inverse of the covariance with all shared errors in it, also where a point stands there twice."""
    rng, n = np.random.default_rng(1), 30
    labels = {"placement": np.repeat([0, 1], 15), "step": np.tile(np.repeat([0, 1, 2], 5), 2)}
    together = replace(
        SharedStripeErrors.of(labels, rng.uniform(0, 1000, n)), sigma=np.array([0.2, 0.1, 0.3])
    )
    sigma = rng.uniform(0.1, 0.4, n)
    covariance = np.diag(sigma**2)
    for spread, label, shape in zip(together.sigma, together.labels, together.shapes):
        covariance += spread**2 * (label[:, None] == label) * np.outer(shape, shape)
    made = decorrelated(together.steps(sigma), np.eye(n)).T
    np.testing.assert_allclose(
        made.T @ np.diag(sigma**-2) @ made, np.linalg.inv(covariance), rtol=1e-9, atol=1e-9
    )
    twice = together.at(np.r_[np.arange(n), 3, 3])
    again = decorrelated(twice.steps(np.r_[sigma, sigma[[3, 3]]]), np.r_[made[3], made[3, [3, 3]]])
    np.testing.assert_allclose(again[:n], decorrelated(together.steps(sigma), made[3]), atol=1e-12)


@dataclass(frozen=True)
class Straight:
    """A chain as that of stripes, but linear: y = a x + p u + s v, a for all, p of a board pose, s of a step."""

    x: np.ndarray
    y: np.ndarray
    labels: dict
    sigma: np.ndarray
    shared_errors: SharedStripeErrors
    poses: np.ndarray = 0.0
    change: np.ndarray = 0.0
    parameters = Parameters.of([Parameter("line.a", "1", 0.0, 1.0)])
    state = None

    def with_families(self, values):
        return replace(self, poses=values["placement"], change=values["step"])

    def at(self, index):
        labels = {name: label[index] for name, label in self.labels.items()}
        return replace(
            self,
            x=self.x[:, index],
            y=self.y[index],
            labels=labels,
            sigma=self.sigma[:, index],
            shared_errors=self.shared_errors.at(index),
        )

    def evaluate(self, values, deltas):
        p, s = self.poses[self.labels["placement"], 0], self.change[self.labels["step"], 0]
        residual = (values[0] * self.x[0] + p * self.x[1] + s * self.x[2] - self.y)[None]
        return SimpleNamespace(
            residual=residual,
            own_rows=lambda k: self.x[None, :1][k],
            family_rows=lambda name: self.x[None, [1 if name == "placement" else 2]],
        )

    decorrelated, between_groups, _decorrelation_steps = (
        BoardStripeChain.decorrelated,
        BoardStripeChain.between_groups,
        property(lambda self: self.shared_errors.steps_apart(self.sigma[0])),
    )


@pytest.mark.parametrize("spread", [(0.2, 0.1, 0.3), (0.0, 0.0, 0.3), (0.2, 0.0, 0.0)])
def test_a_bundle_with_shared_errors_is_the_dense_generalised_least_squares(spread):
    """Also of steps whose numbers a board pose's error mixes: answer and covariance, against the whole matrices."""
    rng, n, placements, steps = np.random.default_rng(7), 180, 5, 4
    labels = {"placement": rng.integers(placements, size=n), "step": rng.integers(steps, size=n)}
    together = replace(
        SharedStripeErrors.of(labels, rng.uniform(0, 1000, n)), sigma=np.array(spread)
    )
    chain = Straight(
        rng.normal(size=(3, n)), rng.normal(size=n), labels, rng.uniform(0.1, 0.4, (1, n)), together
    )
    one = np.ones(1)
    families = {
        "placement": Family("placement", np.zeros((placements, 1)), one),
        "step": Family("step", np.zeros((steps, 1)), one, None, ("s",), ("1",)),
    }
    fit = solve_bundle([Model(chain)], chain.parameters.free("*"), families)
    design = np.concatenate(
        [
            chain.x[:1],
            chain.x[2] * (labels["step"] == np.arange(steps)[:, None]),
            chain.x[1] * (labels["placement"] == np.arange(placements)[:, None]),
        ]
    )
    covariance = np.diag(chain.sigma[0] ** 2)
    for size, label, shape in zip(together.sigma, together.labels, together.shapes):
        covariance += size**2 * (label[:, None] == label) * np.outer(shape, shape)
    weight = np.linalg.inv(covariance)
    inverse = np.linalg.inv(design @ weight @ design.T)
    found = np.r_[
        fit.parameters.values, fit.values["step"].ravel(), fit.values["placement"].ravel()
    ]
    np.testing.assert_allclose(found, inverse @ design @ weight @ chain.y, atol=1e-4)
    np.testing.assert_allclose(
        fit.covariance / fit.sigma_scale**2, inverse[: 1 + steps, : 1 + steps], rtol=1e-3, atol=1e-7
    )


def test_variances_of_a_layout_are_found():
    """Two kinds of shared error, over sets of random layout: right in the mean, and as sure as stated."""
    rng, found = np.random.default_rng(2), []
    for _ in range(40):
        groups, n = 30, 300
        label, shape = rng.integers(groups, size=n), rng.normal(size=n)
        design = np.zeros((n, 2 * groups))
        design[np.arange(n), label], design[np.arange(n), groups + label] = 1, shape
        known = rng.normal(size=(n, 5))
        y = (
            known @ rng.normal(size=5)
            + design @ np.r_[rng.normal(0, 0.5, groups), rng.normal(0, 0.8, groups)]
        )
        y += 1.3 * rng.normal(size=n)
        project = np.eye(n) - known @ np.linalg.solve(known.T @ known, known.T)
        weight = project / 1.69
        made = estimate_components(
            design.T @ weight @ design, design.T @ weight @ y, np.repeat([0, 1], groups)
        )
        found.append([*made.variance, *made.std])
    mean, spread = np.mean(found, 0), np.std(found, 0)
    assert (np.abs(mean[:2] - [0.25, 0.64]) < 3 * spread[:2] / np.sqrt(40)).all()
    np.testing.assert_allclose(mean[2:], spread[:2], rtol=0.35)


def test_a_kind_that_the_unknowns_take_whole_has_no_variance():
    """Two groups and a mean leave one difference, which does not determine a variance."""
    design = np.repeat(np.eye(2), 50, axis=0)
    project = np.eye(100) - 0.01
    y = design @ [3.0, -3.0] + np.random.default_rng(3).normal(size=100)
    made = estimate_components(
        design.T @ project @ design, design.T @ project @ y, np.zeros(2, int)
    )
    assert made.variance[0] == 0 and np.isinf(made.std[0])


def test_stripes_that_err_as_a_whole_are_found_and_said(tmp_path):
    made = calibrated(shaken(4))
    together = made.made.board_stripes.shared_errors
    assert (np.abs(together.sigma[:2] - [SHIFT, TILT]) < 3 * together.std[:2]).all() and (
        together.std[:2] < 0.03
    ).all()
    assert together.sentence in made.sentences and "points of a stripe share" in together.sentence
    write_scanner(made.scanner, tmp_path / "scanner.toml")
    assert (
        read_scanner(tmp_path / "scanner.toml").shared_px
        == made.scanner.shared_px
        == together.named
    )


def test_stripes_that_do_not_are_left_alone():
    together = calibrated(shaken(5, 0.0, 0.0)).free.board_stripes.shared_errors
    assert (together.sigma[:2] < 0.03).all() and (together.std[:2] < 0.03).all()


@pytest.mark.slow
def test_sigmas_of_planes_cover_the_truth_where_stripes_err_as_a_whole():
    """68 % within one sigma over eight sets; with points taken as independent, less than half as many."""
    z = np.concatenate(
        [
            whitened(calibrated(shaken(seed), mirror=False), truth=shaken(seed))
            for seed in range(10, 18)
        ]
    )
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
        points = points + towards[:, None] * (
            rng.normal(0, 0.003, len(x)) + rng.normal(0, 0.004, 20)[step]
        )
        shared = Shared(step, along[None], 1e-12 * np.eye(20), along[None])
        for kept, one in ((covered, shared), (plain, replace(shared, unknown=None))):
            fit = fit_ball(points, 0.003, 15.0, direction=along, shared=one, ordered=False)
            kept.append((fit.centre - [0, 0, 150]) / fit.std[:3])
    assert 0.85 < np.sqrt(np.mean(np.square(covered))) < 1.2 < np.sqrt(np.mean(np.square(plain)))


def test_what_points_share_does_not_depend_on_where_the_solve_began():
    """The shift of the stripes of one board, conditional on its pose, is a small difference of large numbers: of one place, or it
    comes out less than nothing and its variance without end."""
    made = calibrated(shaken(8, placements=6), mirror=False).free
    plain = replace(made.board_stripes, shared_errors=None)
    near = solve_once(made.corners, plain, made.effects, made.parameters)
    away = plain.planes + np.array([[0], [0], [0], [0.3]])
    far = solve_once(
        made.corners, plain.moved(plain.camera, plain.poses, away), made.effects, made.parameters
    )
    assert len(far.fit.history) > len(near.fit.history)
    (one, noise), (other, again) = shared_errors(near), shared_errors(far)
    np.testing.assert_allclose(other.sigma, one.sigma, rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(other.std, one.std, rtol=1e-2)
    assert again == pytest.approx(noise, rel=1e-4)
    here = linearised(far)
    left, pull = _left(
        here,
        _effects(
            here.board_stripes,
            SharedStripeErrors.of(here.board_stripes.labels, here.board_stripes.pixels[1]),
        ),
    )
    values = np.linalg.eigvalsh((left + left.T) / 2)
    assert values[0] > -1e-9 * values[-1] and np.isfinite(pull).all()


def test_placements_whose_stripes_all_err_alike_are_found_and_stand_in_the_sigmas_of_free_planes():
    """By a whole pixel each, which the poses nearly take up: neither is the variance lost nor do sigmas burst."""
    truth = shaken(8, 0.01, 0.0)
    moved = np.random.default_rng(8).normal(0, 1.0, 8)[truth.placement]
    truth = replace(truth, stripes=truth.stripes + np.stack([moved, 0 * moved]))
    made = calibrated(truth, mirror=False)
    together = made.free.board_stripes.shared_errors
    assert (
        abs(together.sigma[2] - 1.0) < 3 * together.std[2] < 1.5 and together.sigma[:2].max() < 0.05
    )
    assert np.abs(np.array(made.free.fit.scales) - 1).max() < 0.05
    assert 0.5 < np.square(whitened(made, truth)).mean() < 2


def lagging(seed, half_gap, placements=8, steps=16):
    """A simulated scanner whose mirror stands half a gap before its command at every other board pose, and half a gap behind."""
    rng = np.random.default_rng(seed)
    truth = simulated_scanner(rng, placements, steps, 60, sweep=np.deg2rad(7))
    planes = {way: truth.mirror.planes(truth.angles + way * half_gap) for way in (1, -1)}
    pixels = []
    for g, pose in enumerate(truth.poses):
        for s in range(steps):
            found, inside = seen(
                CAMERA, pose, stripe_points(pose, planes[1 - 2 * (g % 2)][:, s], 60)
            )
            pixels.append((found[:, inside], g, s))
    stripes = np.hstack([found for found, _, _ in pixels])
    placement, step = (
        np.concatenate([np.full(row[0].shape[1], row[k]) for row in pixels]) for k in (1, 2)
    )
    stripes[0] += 0.1 * rng.normal(size=stripes.shape[1])
    return replace(truth, stripes=stripes, placement=placement, step=step)


def test_sweeps_that_disagree_move_no_board_and_are_said():
    """By five pixels, the corners known to a few hundredths: it is no noise of these, and no plane is thrown off by it."""
    truth = lagging(3, 3e-4)
    made = calibrated(truth)
    plain = calibrated(lagging(3, 0.0))
    together = made.made.board_stripes.shared_errors
    assert 2 < together.sigma[2] < 4 and made.sigma_corner_px == pytest.approx(0.06, rel=0.1)
    for one, limit in ((made, 0.02), (plain, 0.004)):
        assert aligned(truth, one.camera, one.scanner.planes, steps=one.scanner.steps)[1] < limit
    assert any(
        "something that changed from board pose to board pose is missing" in said
        for said in made.sentences
    )
    assert not any("is missing" in said for said in plain.sentences)
    assert made.scanner.sigma_px == pytest.approx(
        0.1, rel=0.05
    )  # of a centre: what stripes share is not in it


def test_what_may_be_negative_is_counted_on_by_the_part_above_nought():
    """The mean of a normal distribution beyond nought, by its closed form and where it is far above."""
    found = VarianceComponents(
        np.array([0.0, 4.0, 1e-3, 2.0]),
        np.array([1.0, 0.1, np.inf, 1.0]),
        np.array([0.0, 4.0, 1e-3, -40.0]),
    )
    assert found.expected[0] == pytest.approx(np.sqrt(2 / np.pi)) and found.expected[
        1
    ] == pytest.approx(4.0)
    assert found.expected[2] == 1e-3 and 0 < found.expected[3] < 0.03


def test_a_profiler_states_its_plane_in_the_cameras_frame():
    """One plane has no other to be apart from: in the frame that fits best nothing would be left to tell."""
    from workbench.jobs.sensor.scanner import _plane_sigmas

    truth = simulated_scanner(np.random.default_rng(9), 8, 1, 60)
    made = calibrated(truth)
    assert len(made.scanner.steps) == 1 and len(made.made.board_stripes.shared_errors.named) == 3
    assert (
        made.sigma_apart_mm[0] < 1e-9
        and made.sigma_stated_mm is made.sigma_plane_mm
        and made.sigma_plane_mm[0] > 1e-4
    )
    assert _plane_sigmas(made) == [None]
