"""The diagnosis engine: evidence against brute force, and cases made from seeds by the model run forwards."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from datasets.makers import elastic_arm
from datasets.recording import Recording
from robot_model import load_robot
from robot_model.effects import CATALOGUE
from robot_model.system import bind
from workbench.core.model import Model
from workbench.diagnosis.linear.evidence import SIZES, Moments, Projected, score_hypotheses
from workbench.diagnosis.linear.problem import Problem
from workbench.diagnosis.noise.outliers import robust_weights, spread_with
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.select import find

SIGMA = 0.02


def recorded(
    seed: int,
    effects=(),
    values=(),
    n: int = 220,
    more=None,
    repeats: int = 1,
    sigma: float = SIGMA,
) -> Recording:
    """External points of an arm with wrong lengths, effects and noise; n samples, of n / repeats poses."""
    rng = np.random.default_rng(seed)
    joints = rng.uniform(-1.4, 1.4, (n // repeats, 6)).repeat(repeats, 0)
    columns = {f"q{k}_deg": np.rad2deg(q) for k, q in enumerate(joints.T, 1)}
    columns |= {
        "time_s": 20.0 * np.arange(n),
        **dict.fromkeys(("x_mm", "y_mm", "z_mm"), np.zeros(n)),
        **(more or {}),
    }
    recording = Recording(
        "external-point", columns, elastic_arm.robot(), sigma_mm=sigma, name="made"
    )
    start = np.array([300.0, -200.0, 100.0, 0.1, -0.2, 0.3, 40.0, -30.0, 90.0])
    chain = bind(load_robot(elastic_arm.robot(), "made"), recording, start)
    model = Model(chain, tuple(effects))
    truth = model.parameters.values.copy()
    truth[6:36] += (rng.uniform(-1, 1, (6, 5)) * [0.005, 0.5, 0.5, 0.005, 0]).ravel()
    truth[36 + 3 :] = values
    residual = model.residual(replace(model.parameters, values=truth))
    return replace(
        recording,
        columns=columns
        | chain.measurement.columns(residual + rng.normal(0, sigma, residual.shape)),
    )


def found(*args, **given):
    return find(bench_of(recorded(*args, **given)))


def test_evidence_is_the_marginal_likelihood():
    """Against a sum over sizes and a numerical integral over sigma of Gaussian densities."""
    rng = np.random.default_rng(1)
    z, y = rng.normal(size=(12, 2)), rng.normal(size=12)
    scores = score_hypotheses(
        Moments((z.T @ z)[None], (z.T @ y)[None], np.array([20.0])), float(y @ y), 12
    )
    logs, anchor = np.linspace(-4, 4, 4001), 4.0
    variance = np.exp(logs)
    weight = variance ** (-anchor / 2) * np.exp(
        -anchor / 2 / variance
    )  # inverse gamma, d variance / variance

    def likelihood(covariance):
        base = multivariate_normal(np.zeros(12), covariance)
        whitened = np.linalg.solve(covariance, y) @ y
        level = base.logpdf(np.zeros(12))
        return np.trapezoid(weight * np.exp(level - 6 * logs - whitened / 2 / variance), logs)

    likely = 1 / np.maximum(1, SIZES / 3)
    averaged = sum(
        p * likelihood(np.eye(12) + s**2 * z @ z.T) for p, s in zip(likely / likely.sum(), SIZES)
    )
    assert scores.evidence[0] == pytest.approx(np.log(averaged / likelihood(np.eye(12))), abs=1e-3)


def test_p_values_are_uniform_when_nothing_is_there():
    rng = np.random.default_rng(2)
    z, y = rng.normal(size=(60, 3)), rng.normal(size=(4000, 60))
    p = np.array(
        [
            score_hypotheses(
                Moments((z.T @ z)[None], (z.T @ row)[None], np.array([99.0])), row @ row, 60
            ).p[0]
            for row in y
        ]
    )
    counts = np.histogram(p, 10, (0, 1))[0]
    assert ((counts - 400) ** 2 / 400).sum() < 27.9  # 0.1 % of chi-square with 9


def test_projecting_takes_out_what_the_baseline_makes():
    bench = bench_of(recorded(3))
    problem = bench.problem()
    assert np.allclose(problem.basis.T @ problem.basis, np.eye(problem.basis.shape[1]), atol=1e-10)
    assert problem.basis.shape[1] == 30 - 3  # base and tool shift as lengths do
    offset = next(
        c
        for c in problem.candidates
        if c.effect == "transmission-harmonic" and c.where == "joint-3"
    )
    left = problem.orthogonalise(offset.columns)
    assert 0 < (left**2).sum() < 0.5 * (offset.columns**2).sum()


def test_steps_and_waves_agree_with_their_columns():
    from workbench.diagnosis.linear.evidence import scan_moments

    problem = bench_of(recorded(4)).problem()
    projected = Projected(problem)
    for scan in problem.scans:
        moments, i = scan_moments(projected, scan), len(scan.options) // 3
        columns = problem.orthogonalise(scan.columns_at(problem, scan.options[i]))
        assert moments.gram[i] == pytest.approx(
            columns.T @ columns, rel=1e-6, abs=1e-6 * moments.raw[i]
        )
        assert moments.score[i] == pytest.approx(columns.T @ projected.y, rel=1e-6, abs=1e-5)


CASES = [
    ("joint-compliance", "joint-3", {}, [2e-5]),
    ("zero-shift", "joint-4", {"after": 1510.0}, [1e-3]),
    ("transmission-harmonic", "joint-5", {"order": 2.0}, [8e-4, -4e-4]),
    ("transmission-harmonic", "joint-2", {"order": 23.0}, [4e-5, 4e-5]),
    ("joint-coupling", "joint-6", {"joint": 5}, [8e-4]),
]


SLOW = [*CASES[:1], *(pytest.param(*case, marks=pytest.mark.slow) for case in CASES[1:])]


@pytest.mark.parametrize("effect, where, options, values", SLOW)
def test_names_what_is_there(effect, where, options, values):
    answer = found(5, [CATALOGUE[effect](where, **options)], values)
    assert [(f.effect, f.where) for f in answer.findings] == [(effect, where)]
    assert answer.findings[0].p_value < 1e-6
    assert answer.findings[0].probability > 0.9


@pytest.mark.slow
def test_finds_two_at_once_and_when_the_joint_slipped():
    pair = [
        CATALOGUE["zero-shift"]("joint-4", after=1510.0),
        CATALOGUE["joint-compliance"]("joint-2"),
    ]
    answer = found(6, pair, [1e-3, 1.5e-5])
    assert {(f.effect, f.where) for f in answer.findings} == {
        ("zero-shift", "joint-4"),
        ("joint-compliance", "joint-2"),
    }
    slip = next(f for f in answer.findings if f.effect == "zero-shift")
    assert slip.effects[0].after == pytest.approx(1510.0, abs=60)


def test_nothing_is_found_in_clean_data():
    assert not any(found(seed, n=120).findings for seed in range(20, 24))


def test_a_law_outside_the_library_is_unknown_at_its_place():
    class Odd(CATALOGUE["joint-coupling"]):
        def basis(self, state):
            return np.sin(2 * state.variables[3] * state.variables[5])[None, None]

    answer = found(7, [Odd("joint-5", joint=4)], [6e-4])
    assert [(f.effect, f.where) for f in answer.findings] == [("unknown", "joint-5")]
    assert set(answer.findings[0].depends_on) == {"q4", "q6"}
    assert answer.located[0].where == "joint-5"


def test_outliers_are_named_and_make_nothing_else():
    recording = recorded(8)
    x = recording.columns["x_mm"].copy()
    x[[10, 60, 111, 160]] += 8 * SIGMA * np.array([1, -1, 1, 1])
    answer = find(bench_of(replace(recording, columns={**recording.columns, "x_mm": x})))
    assert not answer.findings
    assert {10, 60, 111, 160} <= set(np.flatnonzero(answer.outliers))


def test_spread_that_grows_is_seen_and_heavy_tails_are_not_taken_for_it():
    rng = np.random.default_rng(9)
    x = {"range": rng.uniform(0, 1, 400), "idle": rng.uniform(0, 1, 400)}
    name, p = spread_with(rng.normal(size=(3, 400)) * np.exp(0.6 * x["range"]), x)
    assert name == "range"
    assert p < 1e-4
    assert (
        np.mean([spread_with(rng.standard_t(5, (3, 400)), x)[1] < 0.01 for _ in range(200)]) <= 0.03
    )


def test_weights_fall_only_far_out():
    white = np.zeros((3, 50))
    white[0] = np.linspace(0.5, 3, 50)
    white[0, 0] = 200
    weights = robust_weights(white)
    assert weights[0] < 1e-3
    assert (weights[1:30] == 1).all()


def test_keeping_an_effect_is_the_same_as_solving_with_it():
    slip = CATALOGUE["zero-shift"]("joint-4", after=1510.0)
    bench = bench_of(recorded(10, [slip], [1e-3]))
    there: Problem = bench.problem((slip,))
    without, plain = there.conditional_on(()), bench.problem(())
    a, b = (p.orthogonalise(p.residual) * p.sigma for p in (without, plain))
    assert np.corrcoef(a, b)[0, 1] > 0.999
    assert there.conditional_on().rank == plain.rank + 1


def test_moments_conditional_on_most_effects_are_those_of_their_columns():
    """With a third effect that is a copy of the second, so that leaving it out changes nothing."""
    effects = [
        CATALOGUE["zero-shift"]("joint-4", after=1510.0),
        CATALOGUE["transmission-harmonic"]("joint-2", order=2.0),
        CATALOGUE["joint-compliance"]("joint-3"),
    ]
    problem = bench_of(recorded(10, effects, [1e-3, 8e-4, -4e-4, 2e-5])).problem(effects)
    problem = replace(
        problem,
        added=(*problem.added, problem.added[1]),
        values=(*problem.values, 0 * problem.values[1]),
        precisions=(),
        effects=(*problem.effects, problem.effects[1]),
    )
    columns = np.stack([c.columns * c.typical for c in problem.candidates if len(c.typical) == 1])
    for kept in [(0, 1, 2, 3), (0, 1, 2), (0, 1, 3), (1, 2, 3), (1,), ()]:
        conditional = problem.conditional_on(kept)
        moments = Projected(conditional).column_moments(columns, ("tested",))
        remaining = conditional.orthogonalise(columns[:, :, 0].T)
        expected = (remaining**2).sum(0)
        assert moments.gram[:, 0, 0] == pytest.approx(expected, rel=1e-6, abs=1e-6)
        expected = remaining.T @ conditional.orthogonalise(conditional.residual)
        assert moments.score[:, 0] == pytest.approx(expected, rel=1e-6, abs=1e-5)


def worn(angle):
    """A bump of a gear's error, a twelfth of its way wide."""
    return np.exp(-(((angle - 0.4) / 0.22) ** 2))


def test_a_worn_patch_of_a_gear_is_no_series_of_harmonics():
    class Worn(CATALOGUE["joint-coupling"]):
        def basis(self, state):
            return worn(state.variables[2])[None, None]

    answer = found(11, [Worn("joint-3", joint=4)], [1.2e-3])
    assert {(f.effect, f.where) for f in answer.findings} == {("joint-curve", "joint-3")}


@pytest.mark.slow
def test_a_random_effect_is_located_and_the_missing_covariate_named():
    class Random(CATALOGUE["joint-coupling"]):
        def basis(self, state):
            return np.random.default_rng(1).normal(size=(1, 1, state.n))

    answer = found(12, [Random("joint-2", joint=4)], [2e-4])
    assert not answer.findings
    assert [(f.effect, f.where) for f in answer.noise_findings] == [("unknown", "joint-2")]
    assert {"temperature", "approach", "speed"} <= {
        a.missing_covariate for a in answer.noise_findings[0].alternatives
    }
    assert answer.located[0].where == "joint-2"


@pytest.mark.slow
def test_noise_that_grows_with_the_load_is_named_and_makes_no_function_of_it():
    rng = np.random.default_rng(13)
    load = np.repeat(rng.choice([0.0, 1.5, 3.0], 23), 10)[:220]
    recording = recorded(13, more={"payload_kg": load})
    noise = rng.normal(0, SIGMA, (3, 220)) * load * 0.8
    columns = {c: recording.columns[c] + row for c, row in zip(("x_mm", "y_mm", "z_mm"), noise)}
    answer = find(bench_of(replace(recording, columns={**recording.columns, **columns})))
    assert not answer.findings
    assert [(f.effect, f.depends_on[0].startswith("payload")) for f in answer.noise_findings] == [
        ("noise-heteroscedastic", True)
    ]
