"""Readings taken while the arm still brakes: the moves that the order of rows tells, and the lag that is found."""

import numpy as np
import pytest
import tomli_w

from robot_model.effects import CATALOGUE
from workbench.core.covariates import last_moves
from workbench.diagnosis.noise.random_effects import find_random_effect, places
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.select import find
from workbench.jobs.robot.simulate import simulate

STILL = np.array([1e-4, 1e-4])
SCENE = {
    "robot": "abb_irb120",
    "measures": "external-point",
    "samples": 120,
    "seed": 4,
    "sigma_mm": 0.02,
    "reflectors": [[0.0, 30.0, 120.0], [40.0, -20.0, 100.0]],
    "share_of_limits": 0.5,
    "base": {"xyz_mm": [1500.0, 200.0, -400.0]},
    "errors": {"length_mm": 0.2, "angle_deg": 0.05},
    "effect": [{"effect": "reading-lag", "where": "time", "values": {"short": 8e-4}}],
}


def test_rows_of_one_configuration_share_how_it_was_reached():
    q = np.array([[0.0, 0.0, 0.5, 0.5, 0.5, 0.2], [1.0, 1.0, 1.0, 1.0, 1.0, 1.4]])
    expected = [[0.0, 0.0, 0.5, 0.5, 0.5, -0.3], [0.0, 0.0, 0.0, 0.0, 0.0, 0.4]]
    np.testing.assert_allclose(
        last_moves(q, np.arange(6.0), STILL, np.arange(6)), expected, atol=1e-12
    )


def test_readings_that_jitter_within_a_pose_are_no_move():
    q = np.array([[0.0, 0.001, 0.5, 0.502, 0.501]])
    moves = last_moves(q, np.arange(5.0), STILL[:1], np.array([3, 3, 7, 7, 7]))
    np.testing.assert_allclose(moves, [[0.0, 0.0, 0.499, 0.499, 0.499]])


def test_the_clock_and_not_the_row_says_what_came_before():
    q = np.array([[0.2, 0.0, 0.5]])
    np.testing.assert_allclose(
        last_moves(q, np.array([2.0, 0.0, 1.0]), STILL[:1], np.arange(3)), [[-0.3, 0.0, 0.5]]
    )


@pytest.mark.parametrize(("law", "expected"), [("braking", [0.5, -1.0]), ("share", [0.2, -0.4])])
def test_all_joints_are_short_by_one_share_of_their_moves(law, expected):
    class Still:
        class robot:
            joints, prismatic = 2, np.zeros(2, bool)

        covariate = staticmethod({"move1": np.array([0.2]), "move2": np.array([-0.4])}.__getitem__)

    made = CATALOGUE["reading-lag"]("time", law=law).basis(Still)
    np.testing.assert_allclose(made[0, :, 0], expected)


def _bench(tmp_path, scene):
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(scene))
    return bench_of(simulate(path))


def test_a_lag_is_named_from_the_order_of_rows_alone(tmp_path):
    found = find(_bench(tmp_path, SCENE))
    assert [(f.effect, f.where, f.label) for f in found.findings] == [
        ("reading-lag", "time", "read while braking")
    ]


def test_readings_ahead_of_their_points_are_no_lag(tmp_path):
    """The opposite sign has no cause in an arm that brakes: a clock offset, or nothing, is named."""
    early = {"effect": "reading-lag", "where": "time", "values": {"short": -8e-4}}
    found = find(_bench(tmp_path, SCENE | {"effect": [early]}))
    assert "reading-lag" not in [f.effect for f in found.findings]


def test_a_lag_of_chance_size_scatters_along_the_last_moves(tmp_path):
    """Readings at random moments before the arm is static have no mean law, but a direction."""
    bench = _bench(tmp_path, SCENE | {"effect": [], "samples": 200})
    plain = bench.problem()
    row = places(plain)[-1].rows[0]
    assert places(plain)[-1].where == "time"
    pushed = (
        plain.residual + 8e-4 * row * np.random.default_rng(2).normal(size=plain.n)[plain.sample]
    )
    assert find_random_effect(plain, 1e-4) is None
    found = find_random_effect(type(plain)(**{**plain.__dict__, "residual": pushed}), 1e-4)
    assert found.site.where == "time"
    assert len(found.site.rows) == 1
