"""The bundle and the corner chain: gradients of every port and family, the dense solve's answer, honest sigmas."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from board_scenes import BOW, CAMERA, board_model, disturbed
from sensors.camera.corners import PORTS, POSE, Corners, placements
from sensors.camera.model import Camera
from workbench.core.effect import Effect
from workbench.core.errors import InputError
from workbench.core.least_squares.bundle import NOT_FINITE, OUT_OF_STEPS, solve_bundle
from workbench.core.least_squares.bundle_blocks import tiles_of
from workbench.core.least_squares.identifiability import identifiability
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.core.parameters import Parameter, Parameters

CAMERA_AND_BOW = ("camera.*", "*board-bow*")


class PosesInside:
    """The corner chain with its poses as parameters of its own: what the dense solve of the core needs."""

    def __init__(self, chain: Corners):
        self.chain, self.state, self.sigma = chain, chain.state, chain.sigma
        family = placements(chain.poses)
        rows = [
            Parameter(f"board-{g}.{name}", "mm", 0.0, size)
            for g in range(len(chain.poses))
            for name, size in zip(POSE, family.typical)
        ]
        joined = Parameters.of([*chain.parameters.table, *rows])
        self.parameters = replace(
            joined, values=np.r_[chain.parameters.values, chain.poses.ravel()]
        )
        self.port_indices = chain.port_indices
        self.numbers, self.slides = chain.numbers, chain.slides

    def evaluate(self, values, deltas):
        own = len(self.chain.parameters)
        chain = self.chain.with_families({"placement": values[own:].reshape(-1, 6)})
        return InsideEvaluation(chain.evaluate(values[:own], deltas), chain, own)


class InsideEvaluation:
    def __init__(self, evaluation, chain, own):
        self.evaluation, self.chain, self.own = evaluation, chain, own
        self.residual, self.rows = evaluation.residual, evaluation.rows

    def own_rows(self, indices):
        group, poses = self.chain.labels["placement"], self.evaluation.family_rows("placement")
        each = [poses * (group == g) for g in range(len(self.chain.poses))]
        return np.concatenate([self.evaluation.own_rows(np.arange(self.own)), *each])[indices]


@pytest.mark.parametrize("radius", [0.0, 1.2])
@pytest.mark.parametrize("bent", [False, True])
def test_rows_are_the_derivatives_for_every_port_family_and_camera_value(radius, bent):
    rng = np.random.default_rng(3)
    camera = Camera.of([*CAMERA.values, 0.3, 0.2, 0.1], CAMERA.size)
    chain = board_model(rng, 3, radius=radius, camera=camera)[0].chain
    n = chain.pixels.shape[1]
    deltas = {
        port: (np.arange(PORTS[port]), np.zeros((PORTS[port], n)))
        for port in ("pixel", "ray", "target")
    }
    if bent:
        for port, size in (("pixel", 1.0), ("ray", 1e-3), ("target", 0.1)):
            deltas[port] = deltas[port][0], rng.normal(0, size, deltas[port][1].shape)
    evaluation = chain.evaluate(camera.values, deltas)
    for port, step in (("pixel", 1e-3), ("ray", 1e-6), ("target", 1e-3)):
        for port_index, row in enumerate(evaluation.rows(port, np.arange(PORTS[port]))):

            def moved(h, port=port, port_index=port_index):
                change = deltas[port][1] + h * unit(port_index, PORTS[port], n)
                return chain.evaluate(
                    camera.values, {**deltas, port: (deltas[port][0], change)}
                ).residual

            assert_derivative(row, moved, step)
    for k, row in enumerate(evaluation.family_rows("placement")):

        def moved(h, k=k):
            return (
                chain.with_families({"placement": chain.poses + h * np.eye(6)[k]})
                .evaluate(camera.values, deltas)
                .residual
            )

        assert_derivative(row, moved, 1e-4 if k < 3 else 1e-6)
    for k, row in enumerate(evaluation.own_rows(np.arange(12))):

        def moved(h, k=k):
            return chain.evaluate(camera.values + h * np.eye(12)[k], deltas).residual

        assert_derivative(row, moved, 1e-4 * chain.parameters.typical[k])


def assert_derivative(row, moved, step):
    """Central differences, to what rounding of pixels in the thousands leaves of them."""
    allowed = 1e-7 * np.abs(row).max() + 2e-12 / step
    np.testing.assert_allclose(row, (moved(step) - moved(-step)) / (2 * step), rtol=0, atol=allowed)


def unit(port_index, count, n):
    return np.repeat(np.eye(count)[port_index][:, None], n, 1)


def test_what_happens_to_laser_light_does_not_reach_a_corner():
    chain = board_model(np.random.default_rng(0), 2)[0].chain
    evaluation = chain.evaluate(CAMERA.values, {})
    for port in ("plane", "mirror", "point"):
        assert not evaluation.rows(port, np.arange(PORTS[port])).any()
    with pytest.raises(InputError, match="expected a port of the scanner .* found joint; "):
        chain.port_indices("joint", "joint-1", ())


def test_the_schur_complement_gives_what_the_dense_solve_gives():
    """Values to 1e-7 of their sigma; poses, sigma, covariance of camera and poses; uneven groups in random order."""
    rng = np.random.default_rng(5)
    model, truth = board_model(rng, 6)
    model = uneven(rng, model)
    model = model.with_chain(replace(model.chain, poses=disturbed(rng, model.chain.poses, 0.3)))
    start = truth.free(*CAMERA_AND_BOW).update({"camera.fx": 3450.0, **dict.fromkeys(BOW, 0.0)})
    fit = solve_bundle([model], start, {"placement": placements(model.chain.poses)})
    inside = Model(PosesInside(model.chain), model.effects)
    dense = solve(inside, inside.parameters.take_over(start).free("board-*"))
    shared = [dense.parameters.index[key] for key in fit.table.keys]
    poses = [k for k, key in enumerate(dense.parameters.keys) if key.startswith("board-")]
    assert fit.converged
    assert fit.history[-1] == pytest.approx(dense.history[-1], rel=1e-10)
    # far from the minimum a step differs by rounding times the condition of the normal equations
    assert fit.history == pytest.approx(dense.history, rel=1e-8)
    # the order of sums differs between processors: what is determined less well has larger rounding errors
    sigma = np.sqrt(np.diag(fit.covariance))
    np.testing.assert_array_less(
        np.abs(fit.table.values - dense.parameters.values[shared]), 1e-7 * sigma
    )
    assert fit.values["placement"].ravel() == pytest.approx(
        dense.parameters.values[poses], rel=1e-10, abs=1e-10
    )
    assert fit.residual[0] == pytest.approx(dense.residual, abs=1e-8)
    assert (fit.sigma_scale, fit.degrees) == pytest.approx(
        (dense.sigma_scale, dense.degrees), rel=1e-10
    )
    assert_same_covariance(fit, dense, shared, poses)


def assert_same_covariance(fit, dense, shared, poses):
    """Both in typical sizes: with the priors and the faint floor that identifiability gives every direction."""
    whole = identifiability(dense.normal, dense.parameters, dense.sigma_scale).covariance
    place = np.cumsum(dense.parameters.mask) - 1
    whole = whole[np.ix_(*[np.r_[place[shared], place[poses]]] * 2)]
    size = fit.table.typical
    scaled = np.outer(size, size)
    np.testing.assert_allclose(
        fit.covariance / scaled, whole[: len(size), : len(size)] / scaled, rtol=1e-6, atol=1e-10
    )
    own = placements(np.zeros((1, 6))).typical
    for g, found in enumerate(group_covariance(fit) / np.outer(own, own)):
        span = slice(len(size) + 6 * g, len(size) + 6 * g + 6)
        np.testing.assert_allclose(
            found, whole[span, span] / np.outer(own, own), rtol=1e-6, atol=1e-8
        )
        cross = whole[span, : len(size)] / np.outer(own, size)
        np.testing.assert_allclose(
            fit.group_cross()[g] / np.outer(own, size), cross, rtol=1e-6, atol=1e-8
        )


def group_covariance(fit):
    """(G, L, L) of each group of the eliminated family, from the Schur complement."""
    gone = fit.eliminated
    by_shared = gone.mix @ fit.covariance @ gone.mix.transpose(0, 2, 1)
    return fit.sigma_scale**2 * gone.inverse + by_shared


def uneven(rng, model):
    """Without a random third of the corners, in random order."""
    n = model.chain.pixels.shape[1]
    return model.at(rng.permutation(n)[: 2 * n // 3])


def test_a_family_that_is_kept_gives_what_one_that_is_eliminated_gives():
    rng = np.random.default_rng(1)
    model, truth = board_model(rng, 5)
    start = truth.free(*CAMERA_AND_BOW).update({"camera.fx": 3440.0})
    family = {"placement": placements(disturbed(rng, model.chain.poses, 0.2))}
    gone = solve_bundle([model], start, family)
    kept = solve_bundle([model], start, family, eliminate=None)
    shared = len(gone.table)
    assert kept.table.keys[shared:][:2] == ("placement-0.x", "placement-0.y")
    assert kept.parameters.values == pytest.approx(gone.parameters.values, rel=1e-9)
    assert kept.values["placement"] == pytest.approx(gone.values["placement"], rel=1e-8)
    assert kept.covariance[:shared, :shared] == pytest.approx(gone.covariance, rel=1e-5)
    assert np.diag(kept.covariance)[shared : shared + 6] == pytest.approx(
        np.diag(group_covariance(gone)[0]), rel=1e-5
    )


def test_models_share_one_table_and_each_has_its_own_scale():
    """Half of the corners in a model of their own, with twice the noise that they state."""
    rng = np.random.default_rng(2)
    model, truth = board_model(rng, 12)
    even = np.arange(model.chain.pixels.shape[1]) % 2 == 0
    gap = model.residual(truth)
    worse = replace(model.chain, pixels=model.chain.pixels - gap)  # the noise once more
    parts = [model.at(even), Model(worse, model.effects).at(~even)]
    fit = solve_bundle(
        parts, truth.free(*CAMERA_AND_BOW), {"placement": placements(model.chain.poses)}
    )
    assert [r.shape[1] for r in fit.residual] == [even.sum(), (~even).sum()]
    assert fit.scales == pytest.approx((1.0, 2.0), abs=0.1)
    pulls = (fit.table.values - truth.values) / np.array(list(fit.std.values()))
    assert np.abs(pulls).max() < 4


def test_a_prior_of_a_family_holds_what_no_sample_shows():
    rng = np.random.default_rng(4)
    model, truth = board_model(rng, 4)
    seen = model.chain.labels["placement"] < 3
    family = replace(placements(model.chain.poses), prior=np.full(6, 0.2))
    fit = solve_bundle([model.at(seen)], truth.free(*CAMERA_AND_BOW), {"placement": family})
    assert fit.values["placement"][3] == pytest.approx(model.chain.poses[3])
    assert np.sqrt(np.diag(group_covariance(fit)[3])) == pytest.approx(
        [0.2] * 3 + [0.2] * 3, rel=0.15
    )
    assert np.sqrt(np.diag(group_covariance(fit)[0])).max() < 0.1


def test_poses_alone_can_be_fitted():
    rng = np.random.default_rng(6)
    model, truth = board_model(rng, 4, noise=0)
    fit = solve_bundle([model], truth, {"placement": placements(disturbed(rng, model.chain.poses))})
    assert fit.converged and fit.covariance.shape == (0, 0)
    assert fit.values["placement"] == pytest.approx(model.chain.poses, abs=1e-6)


def test_huber_resists_what_ruins_the_linear_loss_and_its_sigmas_hold():
    rng = np.random.default_rng(7)
    pulls = {"linear": [], "huber": []}
    for _ in range(25):
        model, truth = board_model(rng, 6)
        pixels = model.chain.pixels.copy()
        wild = rng.random(pixels.shape[1]) < 0.02
        pixels[:, wild] += rng.normal(0, 2, (2, wild.sum()))
        model = model.with_chain(replace(model.chain, pixels=pixels))
        for loss, found in pulls.items():
            fit = solve_bundle(
                [model],
                truth.free(*CAMERA_AND_BOW),
                {"placement": placements(model.chain.poses)},
                loss=loss,
            )
            found.append(
                (fit.table.values - truth.values)
                / np.array(list(fit.std.values()))
                * fit.sigma_scale
            )
    spread = {loss: np.sqrt(np.mean(np.square(found))) for loss, found in pulls.items()}
    assert spread["huber"] < 1.2 and spread["linear"] > 2 * spread["huber"]


def test_directions_that_nothing_determines_are_named_and_stay():
    """A shift of the whole image is the principal point: one combination of the two is known."""
    rng = np.random.default_rng(8)
    model, truth = board_model(rng, 6)
    model = model.with_effects(Shift("camera"))
    start = model.parameters.take_over(truth).free(*CAMERA_AND_BOW, "camera.shift.*")
    fit = solve_bundle([model], start, {"placement": placements(model.chain.poses)})
    said = " ".join(fit.known.sentences())
    assert fit.converged
    assert "the principal point cx and the image's shift in x are confounded" in said.replace(
        "the image's shift in x and the principal point cx",
        "the principal point cx and the image's shift in x",
    )
    assert not fit.known.determined[fit.table.index["camera.cx"]]
    assert fit.known.determined[fit.table.index["camera.fx"]]


class Shift(Effect):
    """A image that is shifted: exactly what the principal point does."""

    effect, port, places, components = "shift", "pixel", ("camera",), (0,)

    def table(self, chain):
        return (self.parameter("x", "px", 1.0, "the image's shift in x"),)

    def basis(self, state):
        return np.ones((1, 1, state.n))


def test_the_cost_falls_at_every_step_and_is_reported():
    rng = np.random.default_rng(9)
    model, truth = board_model(rng, 5)
    start = truth.free(*CAMERA_AND_BOW).update({"camera.fx": 3900.0, "camera.k1": 0.4})
    progress_calls = []
    fit = solve_bundle(
        [model],
        start,
        {"placement": placements(disturbed(rng, model.chain.poses, 2))},
        progress=lambda step, cost: progress_calls.append((step, cost)),
    )
    assert fit.converged and (np.diff(fit.history) < 0).all()
    assert [step for step, _ in progress_calls] == list(
        range(1, len(progress_calls) + 1)
    ) and progress_calls[-1][1] == fit.history[-1]


def test_a_start_that_is_not_finite_and_too_few_steps_are_said():
    model, truth = board_model(np.random.default_rng(0), 3)
    family = {"placement": placements(model.chain.poses)}
    assert (
        solve_bundle([model], truth.update({"camera.fx": np.nan}).free("camera.fx"), family).outcome
        == NOT_FINITE
    )
    short = solve_bundle(
        [model], truth.free(*CAMERA_AND_BOW).update({"camera.fx": 4500.0}), family, steps=1
    )
    assert short.outcome == OUT_OF_STEPS and not short.converged


def test_a_missing_parameter_or_group_gets_its_sentence():
    model, truth = board_model(np.random.default_rng(0), 3)
    with pytest.raises(
        InputError,
        match="expected a parameter artefact.board-bow.xx in the shared table, found none",
    ):
        solve_bundle(
            [model], Model(model.chain).parameters, {"placement": placements(model.chain.poses)}
        )
    with pytest.raises(InputError, match="expected a start for placement 2, found 2 of them"):
        solve_bundle([model], truth, {"placement": placements(model.chain.poses[:2])})


@given(st.lists(st.integers(0, 6), min_size=1, max_size=60), st.integers(1, 3))
def test_tiles_hold_every_sample_once_in_its_own_groups(groups, families):
    """Whatever the sizes and the order of the groups."""
    labels = {f"f{k}": np.roll(np.array(groups), k) % (7 - k) for k in range(families)}
    tiles = tiles_of(labels, len(groups))
    assert sorted(tiles.index[tiles.live]) == list(range(len(groups)))
    assert (tiles.index[tiles.place] == np.arange(len(groups))).all()
    combination = (
        np.searchsorted(tiles.start, np.arange(len(tiles.index)) // tiles.length, side="right") - 1
    )
    for name, label in labels.items():
        assert (label[tiles.index] == tiles.groups[name][combination]).all()


class CurvedValley:
    """Rosenbrock's function as a chain: residuals 10 (y - x^2) and 1 - x, whose valley is a parabola."""

    sigma, state, labels = np.ones((2, 1)), None, {"valley": np.zeros(1, int)}
    parameters = Parameters.of(
        [Parameter("valley.x", "1", -1.2, 1.0), Parameter("valley.y", "1", 1.0, 1.0)]
    )

    def with_families(self, values):
        return self

    def evaluate(self, values, deltas):
        x, y = values
        rows = np.array([[[-20 * x], [-1.0]], [[10.0], [0.0]]])
        return SimpleNamespace(
            residual=np.array([[10 * (y - x**2)], [1 - x]]), own_rows=lambda indices: rows[indices]
        )


def test_full_steps_leap_across_the_side_of_a_curved_valley():
    """Two full steps reach the minimum, the first of which raises the cost a hundredfold; damped ones are very many."""
    model = Model(CurvedValley(), ())
    fit = solve_bundle([model], model.parameters.free("*"), eliminate=None, steps=4)
    assert fit.converged
    np.testing.assert_allclose(fit.parameters.values, [1.0, 1.0], atol=5e-3)
