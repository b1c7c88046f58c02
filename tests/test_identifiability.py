"""Identifiability: rank and null space in words on known cases, indices by formula, covariance, confounding."""

import numpy as np
import pytest

import scenes
from robot_model.system import geometry_free
from scenes import KINDS, model_of, observed, scene
from workbench.core.least_squares.identifiability import identifiability, independent
from workbench.core.least_squares.solver import normal_matrix, solve
from workbench.core.parameters import Parameter, Parameters
from workbench.core.solution import Solution
from workbench.jobs.robot import identify

TOOL = {
    "ball-centre": "sensor.*",
    "external-point": "tool.*",
    "external-pose": "tool.*",
    "partial-pose": "tool.*",
}


def table(count, prior=None, typical=1.0):
    """`count` free parameters p0, p1, ... in mm."""
    rows = [
        Parameter(f"joint-1.p{k}", "mm", 0.0, typical, f"number {k}", prior) for k in range(count)
    ]
    return Parameters.of(rows).only(np.ones(count, bool))


def known_of(model, *patterns):
    free = model.parameters.free(*patterns)
    return identifiability(normal_matrix(model, free), free)


def upright(measures="external-point", **more):
    """Base and tool without rotation, so that base rz is about joint 1's axis."""
    return scene(measures, n=80, angle=0.0, **more)


def test_joint_1s_offset_is_the_bases_turn_about_z():
    known = known_of(model_of(upright()), "base.*", "tool.*", "joint-1.theta1")
    groups = known.groups()
    assert known.rank == len(known.keys) - 1 and len(groups) == 1
    # the base turns about the origin of the instrument, so that its shift comes along
    assert (
        {"base.rz", "joint-1.theta1"}
        <= set(groups[0])
        <= {"base.rz", "joint-1.theta1", "base.x", "base.y"}
    )
    assert (
        "joint-1.theta1" in known.tied()["base.rz"] and "base.rz" in known.tied()["joint-1.theta1"]
    )
    sentence = known.sentences()[0]
    assert "joint 1's zero offset (theta)" in sentence and "base rotation about z" in sentence


def test_joint_1s_height_is_the_bases_height_in_one_sentence():
    known = known_of(model_of(upright()), "base.*", "tool.*", "joint-1.d1")
    assert [set(group) for group in known.groups()] == [{"base.z", "joint-1.d1"}]
    assert known.sentences()[0].endswith(
        "are confounded: only a combination of them is identifiable"
    )
    assert not known.determined[list(known.keys).index("base.z")]
    assert known.determined[list(known.keys).index("base.x")]


def test_offsets_along_parallel_axes_are_one():
    """Axes 2 and 3 of this arm are parallel: shifts along them add up."""
    known = known_of(model_of(upright()), "base.*", "tool.*", "joint-2.d2", "joint-3.d3")
    assert [set(group) for group in known.groups()] == [{"joint-2.d2", "joint-3.d3"}]


def test_a_constant_term_is_the_joints_offset():
    model = model_of(upright(), ("zero-offset", "joint-3", {}))
    known = known_of(model, "base.*", "tool.*", "joint-3.theta3", "*.k0")
    assert [set(group) for group in known.groups()] == [
        {"joint-3.theta3", "joint-3.zero-offset.k0"}
    ]
    sentence = known.sentences()[0]
    assert (
        "the constant term of joint 3" in sentence and "joint 3's zero offset (theta)" in sentence
    )


def test_a_parameter_that_moves_nothing_is_said_to():
    """A tilted mount is seen only through compliance."""
    model = model_of(upright(), ("mount-tilt", "base", {}))
    known = known_of(model, "base.*", "tool.*", "*.tilt_*")
    assert sorted(known.sentences()) == [
        f"the tilt of gravity ({i}) has no effect on these measurements" for i in (1, 2)
    ]


@pytest.mark.parametrize("measures", KINDS)
def test_the_complete_arm_keeps_the_classical_number_of_parameters(measures):
    """4 R + 2 P + 6 with the end effector's whole pose (Everett, Driels & Mooring 1987), 3 less with its point only, 1 less with one axis."""
    model = model_of(scene(measures, n=120, reflectors={1: (30.0, -40.0, 100.0)}))
    free = model.parameters.free("base.*", TOOL[measures], *geometry_free(model.chain.robot))
    kept, tied = independent(normal_matrix(model, free), free)
    assert (
        kept.mask.sum()
        == {"ball-centre": 30, "external-point": 27, "external-pose": 30, "partial-pose": 29}[
            measures
        ]
    )
    assert set(tied) == {
        key for key, on, was in zip(free.keys, kept.mask, free.mask) if was and not on
    }


def test_singular_values_and_directions_are_those_of_the_scaled_matrix():
    rows = np.random.default_rng(0).normal(size=(20, 3))
    parameters = table(3, typical=2.0)
    known = identifiability(rows.T @ rows, parameters)
    u, s, vt = np.linalg.svd(rows * 2.0)
    np.testing.assert_allclose(known.singular, s[::-1])
    np.testing.assert_allclose(np.abs((known.directions * vt[::-1].T).sum(0)), 1)
    assert known.rank == 3 and known.null.shape == (3, 0) and known.sentences() == []


def test_observability_indices_are_their_formulas():
    s = np.array([2.0, 5.0, 40.0])
    o = identifiability(np.diag(s**2), table(3)).observability(16)
    assert o["O1"] == pytest.approx(np.prod(s) ** (1 / 3) / 4)
    assert o["O2"] == pytest.approx(2 / 40)
    assert o["O3"] == pytest.approx(2)
    assert o["O4"] == pytest.approx(4 / 40)
    assert o["O5"] == pytest.approx(1 / (1 / 2 + 1 / 5 + 1 / 40))


def test_observability_leaves_out_what_is_undetermined():
    whole = identifiability(np.diag([4.0, 25.0]), table(2)).observability(9)
    assert identifiability(np.diag([4.0, 0.0, 25.0]), table(3)).observability(9) == pytest.approx(
        whole
    )
    nothing = identifiability(np.zeros((2, 2)), table(2))
    assert nothing.rank == 0 and set(nothing.observability(9).values()) == {0.0}


def test_rank_is_judged_in_typical_sizes():
    """A parameter of 1 mm known to 0.5 mm counts; known to 2 mm it does not; larger residuals count it out."""
    assert identifiability(np.array([[4.0]]), table(1)).rank == 1
    assert identifiability(np.array([[0.25]]), table(1)).rank == 0
    assert identifiability(np.array([[4.0]]), table(1), scale=3.0).rank == 0
    assert identifiability(np.array([[0.25]]), table(1, typical=10.0)).rank == 1


def test_covariance_is_the_inverse_normal_matrix():
    rows = np.random.default_rng(1).normal(size=(40, 4)) * [30, 200, 40, 1000]
    normal = rows.T @ rows
    np.testing.assert_allclose(
        identifiability(normal, table(4)).covariance, np.linalg.inv(normal), rtol=1e-6
    )
    np.testing.assert_allclose(
        identifiability(normal, table(4), 2.0).covariance, 4 * np.linalg.inv(normal), rtol=1e-5
    )


def test_covariance_holds_the_prior_and_stays_finite_without():
    known = identifiability(np.diag([4.0, 0.0]), table(2, prior=0.5))
    np.testing.assert_allclose(np.sqrt(np.diag(known.covariance)), [8**-0.5, 0.5], rtol=1e-4)
    nothing = identifiability(np.zeros((1, 1)), table(1, typical=0.2))
    assert np.sqrt(nothing.covariance[0, 0]) == pytest.approx(20)


def test_independent_leaves_out_confounded_parameters_and_names_the_partner():
    rows = np.random.default_rng(2).normal(size=(50, 3)) * 100
    rows = np.column_stack(
        [rows[:, 0], rows[:, 1], 2 * rows[:, 0] - rows[:, 1], rows[:, 2], np.zeros(50)]
    )
    kept, tied = independent(rows.T @ rows, table(5))
    assert kept.mask.tolist() == [True, True, False, True, False]
    assert tied == {"joint-1.p2": ["joint-1.p0", "joint-1.p1"], "joint-1.p4": []}


def test_independent_keeps_first_what_nothing_was_known_about():
    """Of two confounded parameters the one without a prior stays, though it stands later."""
    both = Parameters.of(
        [Parameter("joint-1.theta1", "rad", prior=1.0), Parameter("base.rz", "rad")]
    ).only([True, True])
    kept, tied = independent(np.full((2, 2), 100.0), both)
    assert kept.mask.tolist() == [False, True]
    assert tied == {"joint-1.theta1": ["base.rz"]}


def test_independent_respects_the_present_mask():
    parameters = table(4).only([True, False, True, True])
    kept, tied = independent(np.diag([100.0, 100.0, 0.0]), parameters)
    assert kept.mask.tolist() == [True, False, True, False]
    assert tied == {"joint-1.p3": []}


def test_what_is_left_determines_itself():
    model = model_of(upright())
    free = model.parameters.free("base.*", "tool.*", *geometry_free(model.chain.robot))
    kept, _ = independent(normal_matrix(model, free), free)
    known = identifiability(normal_matrix(model, kept), kept)
    assert (
        known.singular[0] > 0.05
    )  # a confounded parameter has less than a tenth of a typical size left of its own
    assert known.rank >= kept.mask.sum() - 2


def test_a_solution_carries_covariance_and_sentences():
    model = model_of(upright())
    free = model.parameters.free("base.*", "tool.*", "joint-1.d1", "joint-2.a2")
    fit = solve(observed(model, free, np.random.default_rng(0)), free)
    solution = Solution(fit.parameters, fit, identifiability(fit.normal, free), {})
    assert set(solution.std) == set(np.array(free.keys)[free.mask])
    place = list(solution.known.keys).index("joint-2.a2")
    assert solution.std["joint-2.a2"] == pytest.approx(np.sqrt(solution.covariance[place, place]))
    assert 1e-3 < solution.std["joint-2.a2"] < 0.05
    assert (
        len(solution.null_sentences) == 1 and "joint 1's offset (d)" in solution.null_sentences[0]
    )
    assert (
        solution.converged and solution.history == fit.history and solution.outcome == fit.outcome
    )


def test_samples_of_one_pose_widen_the_covariance_and_never_narrow_it():
    model = model_of(upright())
    free = model.parameters.free("base.*", "tool.*")
    fit = solve(observed(model, free, np.random.default_rng(0)), free)
    plain = Solution(fit.parameters, fit, {}, {}).covariance
    inverse = np.linalg.inv(plain)
    wide = Solution(fit.parameters, fit, {}, {}, scores=9 * inverse)
    narrow = Solution(fit.parameters, fit, {}, {}, scores=inverse / 9)
    np.testing.assert_allclose(np.diag(wide.covariance) / np.diag(plain), 9, rtol=1e-3)
    np.testing.assert_allclose(narrow.covariance, plain)


def first_stage_of(recording):
    return identify.identifiability(recording, trust_data=True)["stages"][0]


def test_gauge_freedoms_are_separate_from_what_these_poses_leave_open(monkeypatch):
    moving = first_stage_of(upright().recording)
    readings = scenes._readings

    def with_a_still_wrist(rng, robot, n):
        drawn = readings(rng, robot, n)
        drawn[:, 3:] = 0.2
        return drawn

    monkeypatch.setattr(scenes, "_readings", with_a_still_wrist)
    still = first_stage_of(upright().recording)
    assert moving["undetermined"] == moving["undetermined_in_any_poses"]
    of_any_poses = set(still["undetermined_in_any_poses"])
    assert len(of_any_poses) == len(moving["undetermined"])
    in_these_poses = set(still["undetermined"]) - of_any_poses
    assert any("joint 4's" in text or "joint 5's" in text for text in in_these_poses)
    assert still["identifiable"] == moving["identifiable"] - len(in_these_poses)
