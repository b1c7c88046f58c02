"""Random effects of places: directions tested against noise of any one shape, and what is not tested twice."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.diagnosis.linear.evidence import design_effect
from workbench.diagnosis.linear.problem import Finding, Located
from workbench.diagnosis.noise.data_findings import unweighted_squares
from workbench.diagnosis.noise.random_effect_findings import LABEL, unrecorded
from workbench.diagnosis.noise.random_effects import (
    _TRIED,
    _constant_shape_likelihood,
    _direction_likelihood,
    _occasional_gains,
    _shape_of_noise,
    find_random_effect,
)
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.select import _data_findings_with_functions
from workbench.diagnosis.search.stepwise import LAW
from workbench.explanation.answer import diagnose
from workbench.explanation.noise.noise_terms import noise_terms
from workbench.explanation.result import UNEXPLAINED


def _site(rng, n: int, turn: float):
    """A place whose direction turns by `turn` rad over the samples, and whose lever goes from 1 to 4."""
    angle = turn * rng.uniform(-1, 1, n)
    lever = rng.uniform(1, 4, n)
    rows = np.stack([lever * np.cos(angle), lever * np.sin(angle), np.zeros(n)])
    return SimpleNamespace(rows=rows.reshape(1, -1), typical=np.ones(1))


def test_noise_of_one_shape_is_no_movement_however_heavy_its_tails():
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(150):
        tails = rng.standard_t(2, 120) * np.exp(rng.normal(size=120))
        z = np.diag([4.0, 1.5, 1.0]) @ rng.normal(size=(3, 120)) * tails
        ratios.append(
            _direction_likelihood(_site(rng, 120, 0.3), z, np.ones(120))
            - _constant_shape_likelihood(z, np.ones(120))
        )
    assert max(ratios) < np.log(_TRIED * 150)


def test_place_that_moves_all_samples_nearly_one_way_is_distinguishable_from_such_noise():
    rng = np.random.default_rng(4)
    site = _site(rng, 400, 0.3)
    z = rng.normal(size=(3, 400)) + site.rows.reshape(3, -1) * rng.normal(size=400)
    assert _direction_likelihood(site, z, np.ones(400)) - _constant_shape_likelihood(
        z, np.ones(400)
    ) > np.log(_TRIED / 1e-4)


def test_repeats_of_a_pose_that_err_together_are_no_movement_by_chance():
    rng, smallest = np.random.default_rng(5), []
    plain = bench_of(recorded(14, n=240)).problem().conditional_on()
    pose = np.arange(240) // 6
    for _ in range(12):
        shared = rng.normal(size=(3, 40))[:, pose] + 0.3 * rng.normal(size=(3, 240))
        found = find_random_effect(
            replace(
                plain, residual=plain.orthogonalise(shared.ravel()), weights=np.ones(240), pose=pose
            ),
            1.0,
        )
        smallest.append(1.0 if found is None else found.p_value)
    assert min(smallest) > 0.01


def test_what_goes_with_time_asks_for_what_changes_with_time():
    problem = bench_of(recorded(5, n=60)).problem()
    asked = {
        a.missing_covariate
        for a in unrecorded(problem, Located("joint-3", "joint", ("time",), 0.3, 1e-9))
    }
    assert asked == {"temperature", "payload"}
    assert not unrecorded(problem, Located("joint-3", "joint", ("q3",), 0.3, 1e-9))


@pytest.mark.parametrize("kind", ["candidates", "with_masses"])
def test_what_the_baseline_holds_is_no_candidate(kind):
    recording = recorded(5, n=60)
    bare = {(c.effect, c.where) for c in getattr(bench_of(recording).problem(), kind)}
    compliances = {
        (c.effect, c.where)
        for c in getattr(bench_of(recording, "joint-compliance").problem(), kind)
    }
    gone = {pair for pair in bare if pair[0] == "joint-compliance"}
    assert gone
    assert not compliances & gone


@pytest.mark.parametrize(("share", "stay"), [(2.0, True), (0.5, False)])
def test_outliers_next_to_an_unknown_hold_more_than_it_may_miss(share, stay):
    problem = bench_of(recorded(8, n=60)).problem()
    outliers = np.arange(60) < 3
    gain = unweighted_squares(problem, outliers) / (1 - LAW) / share
    search = SimpleNamespace(
        accepted=[SimpleNamespace(smooth_covariates=("q4",))],
        accepted_indices=(0,),
        conditional_gain=lambda i: (gain, 0.0),
    )
    said = (SimpleNamespace(effect="outliers"), SimpleNamespace(effect="noise-heteroscedastic"))
    left, data = _data_findings_with_functions(search, problem, outliers, said)
    assert (left == (outliers & stay)).all()
    assert [f.effect for f in data] == ["outliers"] * stay


class Random(CATALOGUE["joint-coupling"]):
    def basis(self, state):
        return np.random.default_rng(1).normal(size=(1, 1, state.n))


@pytest.mark.parametrize(("moves", "places"), [(2e-4, ["joint-2"]), (0.0, [])])
def test_random_effect_is_reported_next_to_a_rejected_term_if_it_persists(moves, places):
    problem = (
        bench_of(recorded(12, [Random("joint-2", joint=4)], [moves])).problem().conditional_on()
    )
    spread = (
        Finding("unknown", "joint-2", LABEL, (), 1e-9, 1.0, 0.0, 0.0),
        Finding("noise-heteroscedastic", "noise", "with q1", (), 1e-9, 1.0, 0.0, 0.0, ("q1",)),
    )
    found = SimpleNamespace(noise_findings=spread, p_first=1e-9)
    assert [t.finding.where for t in noise_terms(found, (), ("refused",), problem)] == places


def test_what_lies_far_off_counts_without_the_weights_that_made_it_little():
    problem = bench_of(recorded(8, n=60)).problem()
    every = np.ones(problem.n, bool)
    left = problem.orthogonalise(problem.residual) / np.sqrt(problem.weights)[problem.sample]
    assert unweighted_squares(problem, every) == pytest.approx((left**2).sum())
    assert unweighted_squares(problem, ~every) == 0.0


def test_terms_that_follow_every_pose_do_not_make_repeats_independent():
    """Four repeats share most of the error of their pose, and a fit follows half of the poses' errors.

    The sum of squares then counts as if it were that of the means that are left, in their degrees of freedom.
    """
    rng, pose = np.random.default_rng(3), np.arange(240) // 4
    problem = bench_of(recorded(14, n=240)).problem((), hypotheses=False)
    followed = np.kron(np.eye(3), np.eye(60)[pose])[:, rng.permutation(180)[:90]]
    basis = np.linalg.qr(np.hstack([problem.basis, followed]))[0]
    shared = rng.normal(size=(3, 60))[:, pose] + 0.5 * rng.normal(size=(3, 240))
    for residual, variance_of_means in ((shared.ravel(), 4.25), (rng.normal(size=720), 1.0)):
        y = residual - basis @ (basis.T @ residual)
        degrees = (720 - basis.shape[1]) / design_effect(
            replace(problem, basis=basis, residual=residual, pose=pose)
        )
        assert degrees / (y @ y) == pytest.approx(1 / variance_of_means, rel=0.35)


class Occasional(CATALOGUE["joint-coupling"]):
    """One sample in seven was measured before the joint came to rest."""

    def basis(self, state):
        rng = np.random.default_rng(2)
        return (rng.exponential(size=(1, 1, state.n)) * (rng.random(state.n) < 1 / 7)) * np.sign(
            rng.normal(size=state.n)
        )


def test_a_joint_that_moves_in_some_samples_is_distinguishable_from_heavy_tails():
    """It was called heavy-tailed noise: most samples have only noise, in any direction."""
    settling = recorded(21, [Occasional("joint-2", joint=4)], [4e-4], n=160)
    found = find_random_effect(bench_of(settling).problem().conditional_on(), 1e-4)
    assert found is not None and found.site.where == "joint-2"
    plain, rng = bench_of(recorded(21, n=120)).problem().conditional_on(), np.random.default_rng(6)
    for _ in range(12):
        noise = np.diag([2.0, 1.0, 1.0]) @ rng.standard_t(2, (3, 120))
        noisy = replace(plain, residual=plain.orthogonalise(noise.ravel()), weights=np.ones(120))
        assert find_random_effect(noisy, 1e-3) is None


def test_a_joint_that_moves_in_some_samples_is_no_noise():
    made = diagnose(recorded(21, [Occasional("joint-2", joint=4)], [4e-4], n=160))
    assert [(t.finding.effect, t.finding.where) for t in made.terms if t.kept] == [
        ("unknown", "joint-2")
    ]
    assert made.verdict == UNEXPLAINED


def test_noise_of_another_size_in_some_coordinates_hides_no_joint_that_moves_at_times():
    """Poses: the rotations' sigma is seldom known as well as the positions'."""
    rng, n = np.random.default_rng(8), 150
    rows = rng.normal(size=(6, n))
    site = SimpleNamespace(rows=rows.reshape(1, -1), typical=np.ones(1))
    other = SimpleNamespace(rows=rng.normal(size=(1, 6 * n)), typical=np.ones(1))
    scale = np.array([[1.0], [1.0], [1.0], [5.0], [5.0], [5.0]])
    noise, moved = scale * rng.normal(size=(6, n)), rng.random(n) < 0.12
    share = np.ones(n)

    def gains(residual):
        return _occasional_gains([site, other], residual, _shape_of_noise(residual, share), share)

    assert max(gains(noise)) < 5
    found = gains(noise + 6 * rows * moved)
    assert found[0] > 15 and found[1] < 5
