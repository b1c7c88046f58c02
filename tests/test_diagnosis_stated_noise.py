"""A wrong statement of the noise is a finding of its own, and a right one never is."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w

from test_diagnosis_engine import recorded
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.robot.bench import bench_of
from workbench.explanation.answer import diagnose
from workbench.explanation.noise.heavy_tails import heavy_tails
from workbench.explanation.noise.local_structure import local_structure
from workbench.explanation.noise.stated_noise import StatedNoise, compare, finding_of
from workbench.explanation.planning.experiment import CLEAN, next_experiment
from workbench.explanation.result import CONSISTENT, EXPLAINED, UNEXPLAINED, Term, verdict_of
from workbench.fitting.verdicts.diagnosis_verdict import check_diagnosis
from workbench.jobs.robot.simulate import simulate

POSITION = ("x_mm", "y_mm", "z_mm")
SCENE = {
    "robot": "abb_irb120",
    "samples": 80,
    "seed": 4,
    "sigma_mm": 0.02,
    "reflectors": [[0.0, 30.0, 120.0]],
    "share_of_limits": 0.6,
    "errors": {"length_mm": 0.1, "angle_deg": 0.02},
}


def stated(rng, factor=1.0, poses=60, repeats=1, kind="normal", rank=33) -> StatedNoise:
    """Residuals of a fit of `rank` parameters to noise that is `factor` times the stated one."""
    n = poses * repeats
    white = rng.normal(size=(3, n))
    if kind == "heavy tails":
        white = rng.standard_t(4, size=(3, n)) / np.sqrt(2)
    basis = np.linalg.qr(rng.normal(size=(3 * n, rank)))[0]
    flat = white.ravel()
    left = (flat - basis @ (basis.T @ flat)).reshape(3, n)
    if kind == "outliers":  # a robust fit does not follow them
        left[:, rng.choice(n, n // 20, replace=False)] *= 8
    length = (left**2).sum(0)
    usual = length < 4 * np.quantile(length, 0.9)
    return StatedNoise(
        factor * left, 3 * n - rank, usual, np.repeat(np.arange(poses), repeats), np.zeros(n, int)
    )


@pytest.mark.parametrize("repeats", [1, 12])
def test_a_residual_above_the_noise_is_recognised(repeats):
    """The residual of poses in common, which repeats do not show, or a residual of twice the stated noise."""
    rng = np.random.default_rng(12)
    quiet = [stated(rng, poses=60, repeats=repeats) for _ in range(50)]
    assert not any(one.is_exceeded() for one in quiet)
    one = stated(rng, factor=2.0 if repeats == 1 else 1.0, poses=60, repeats=repeats)
    if repeats > 1:
        common = rng.normal(size=(3, 60))[:, one.pose]
        one = replace(one, white=one.white + common)
    assert one.is_exceeded()


@pytest.mark.parametrize("kind", ["normal", "heavy tails", "outliers"])
@pytest.mark.parametrize("repeats", [1, 4])
def test_a_right_statement_raises_no_alarm(kind, repeats):
    rng = np.random.default_rng(11)
    found = [compare(stated(rng, kind=kind, repeats=repeats), False) for _ in range(300)]
    assert sum(one is not None for one in found) <= 3


@pytest.mark.parametrize("poses", [60, 150])
def test_heavy_tails_are_found_with_their_degrees_of_freedom(poses):
    rng = np.random.default_rng(2)
    assert not any(heavy_tails(stated(rng, poses=poses)) for _ in range(60))
    found = [heavy_tails(stated(rng, poses=poses, kind="heavy tails")) for _ in range(20)]
    rows = [term.parameters for term in found if term is not None]
    # a fit of 33 parameters to 60 poses mixes their noise, which then is less heavy-tailed
    assert len(rows) >= (3 if poses == 60 else 15)
    off = [(degrees["value"] - 4) / degrees["std"] for degrees, _ in rows]
    assert np.sqrt(np.mean(np.square(off))) < 1.5


@pytest.mark.parametrize("repeats, source", [(1, "from residuals"), (4, "from replicates")])
@pytest.mark.parametrize("factor", [1 / 3, 0.6, 1.9, 3.0])
def test_a_wrong_statement_is_found_with_its_factor(factor, repeats, source):
    rng = np.random.default_rng(3)
    found = [compare(stated(rng, factor, repeats=repeats), False) for _ in range(40)]
    assert all(one is not None and one.source == source for one in found)
    off = [(one.factor - factor) / one.error for one in found]
    assert np.sqrt(np.mean(np.square(off))) < 1.5


def test_structure_that_is_left_is_no_noise():
    """Without replicates nothing is said of the noise while something in the residual is not explained."""
    wrong = stated(np.random.default_rng(1), 2.0)
    assert compare(wrong, False) is not None and compare(wrong, True) is None
    too_large = compare(stated(np.random.default_rng(1), 0.5), True)
    assert too_large is not None and too_large.factor < 0.7
    repeated = stated(np.random.default_rng(1), 2.0, repeats=4)
    assert compare(repeated, True) is not None


def test_a_residual_above_the_scatter_of_repeats_is_a_lack_of_fit():
    rng = np.random.default_rng(5)
    right = stated(rng, repeats=4)
    assert right.lack_of_fit() > 0.001
    by_pose = np.repeat(rng.normal(size=(3, 60)), 4, axis=1)
    assert replace(right, white=right.white + 2 * by_pose).lack_of_fit() < 1e-6


def test_a_wrong_statement_explains_no_structure():
    term = Term(finding_of(compare(stated(np.random.default_rng(1), 2.0), False)))
    assert verdict_of((term,), 0.5) == CONSISTENT
    assert verdict_of((term,), 1e-6) == UNEXPLAINED
    assert verdict_of((term,), 0.5, left=True) == UNEXPLAINED


def test_findings_on_the_noise_alone_are_no_unmodelled_effects():
    """Next to an effect that is found the verdict is about that effect."""
    noise = Term(Finding("angular-noise", "noise", "", (), 1e-9, 1.0, 0.0, 0.0))
    gear = Term(Finding("backlash", "joint-2", "", (), 1e-9, 1.0, 0.0, 0.0))
    assert verdict_of((noise,), 0.5) == CONSISTENT
    assert verdict_of((noise, gear), 1e-6) == EXPLAINED
    bench = SimpleNamespace(pose=np.arange(3), chain=None)
    determined, nearly_interpolated = (
        SimpleNamespace(degrees=degrees, rank=20) for degrees in (60.0, 10.0)
    )
    assert next_experiment(bench, (noise,), determined, 0.5).sentence == CLEAN
    sentence = next_experiment(bench, (noise,), nearly_interpolated, 0.5).sentence
    assert "3 poses leave 10 degrees of freedom next to 20 combinations" in sentence


def test_heavy_tails_are_no_noise_stated_too_small(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(SCENE | {"samples": 150, "sigma_mm": 0.001}), encoding="utf-8")
    recording = simulate(path)
    rng = np.random.default_rng(1)
    moved = {
        name: recording.columns[name] + 0.02 * rng.standard_t(2.5, recording.n)
        for name in ("x_mm", "y_mm", "z_mm")
    }
    recording = replace(recording, columns={**recording.columns, **moved}, sigma_mm=0.02)
    made = diagnose(recording)
    (term,) = made.terms
    assert made.verdict == CONSISTENT and term.finding.effect == "noise-heavy-tailed"
    sentence = check_diagnosis(made, recording).verdict.sentence
    assert "agrees with the noise" in sentence and "heavy-tailed" in sentence


@pytest.mark.parametrize("factor", [1.0, 1.9, 3.0, 0.4])
def test_a_wrong_statement_of_the_noise_is_found(tmp_path, factor):
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(SCENE), encoding="utf-8")
    recording = replace(simulate(path), sigma_mm=0.02 / factor)
    made = diagnose(recording)
    if factor == 1.0:
        assert made.verdict == CONSISTENT and not made.terms
        return
    (term,) = made.terms
    assert made.verdict == CONSISTENT
    assert (term.finding.effect, term.finding.where) == ("stated-noise", "noise")
    assert term.parameters[0]["value"] == pytest.approx(factor, rel=0.2)
    assert made.proof.noise == pytest.approx(np.sqrt(3) * 0.02, rel=0.2)
    assert (
        "the stated sigma" in term.statement
        and made.as_json()["effects"][0]["parameters"][0]["std"] > 0
    )
    # the verdict goes by the noise that was found, and does not doubt it again
    sentence = check_diagnosis(made, recording).verdict.sentence
    assert "agrees with the noise" in sentence and "the stated noise is wrong" in sentence


def test_the_noise_of_a_solution_is_that_of_its_own_residual(tmp_path):
    """After a large effect: with the noise of the baseline its prior would hold it short of its size."""
    from robot_model.effects.sensed import FieldBias
    from workbench.diagnosis.robot.bench import bench_of
    from workbench.fitting.noise_scale import noise_scaled

    effect = {"effect": "field-bias", "where": "sensor", "values": {"xy": 1.0, "yy": -1.0}}
    scene = {
        "robot": "abb_irb120",
        "measures": "ball-centre",
        "samples": 100,
        "seed": 7,
        "sigma_mm": 0.003,
        "balls": [[0.0, 0.0, 0.0, 15.0], [60.0, 0.0, 0.0, 15.0], [0.0, 60.0, 0.0, 15.0]],
        "base": {"xyz_mm": [-450.0, 0.0, -100.0]},
        "effect": [effect],
    }
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(scene), encoding="utf-8")
    bench = bench_of(simulate(path))
    bench.solve()
    model, fit, _ = bench.solve((FieldBias("sensor"),))
    assert np.allclose(noise_scaled(model.chain, fit).sigma, model.chain.sigma, rtol=0.03)


def _left_by(seed: int, error, factor: float = 1.0, n: int = 110):
    """`local_structure` of what the baseline leaves of noise times a factor and an error (3, n) mm of joint angles."""
    recording, rng = recorded(seed, n=n, sigma=0.02), np.random.default_rng(seed)
    angles = np.deg2rad([recording.columns[f"q{k}_deg"] for k in range(1, 7)])
    point = np.stack([recording.columns[name] for name in POSITION])
    noise = rng.standard_t(5, (3, n)) * 0.02 * np.sqrt((factor**2 - 1) * 3 / 5)
    changed = point + error(angles, point) + noise
    columns = recording.columns | dict(zip(POSITION, changed))
    bench = bench_of(replace(recording, columns=columns))
    before = bench.problem(())
    return local_structure(before.conditional_on(), before, point)


def test_structure_that_no_smooth_function_of_two_covariates_makes_is_no_larger_noise():
    """A foot that rocks over an edge, and a product of three joints, each of two to four sigmas."""
    direction = np.array([[0.05], [0.03], [-0.04]])
    rocking = _left_by(31, lambda q, x: direction * np.sign(x[0] - np.median(x[0])))
    assert rocking.where == "base" and rocking.p_value < 1e-6
    product = _left_by(
        32, lambda q, x: 3 * direction * np.sin(2 * q[1]) * np.cos(1.5 * q[3]) * q[0]
    )
    assert product.where == "base" and "joints 1, 2 and 4" in product.label


@pytest.mark.parametrize("factor", [1.0, 1.5, 4.0])
def test_larger_noise_is_not_alike_at_neighbouring_poses(factor):
    assert _left_by(int(10 * factor), lambda q, x: 0.0, factor) is None


def test_gaussian_noise_of_a_fit_with_few_degrees_of_freedom_has_no_heavy_tails():
    """The residuals of 12 samples with 27 of 36 numbers fitted have variances from a thousandth to nearly one."""
    rng = np.random.default_rng(0)
    plain, studentised = 0, 0
    for _ in range(100):
        reach = np.repeat(rng.uniform(0.02, 1.0, 12) ** 2, 3)  # the least do not matter to the fit
        basis = np.linalg.qr(rng.normal(size=(36, 27)) * reach[:, None])[0]
        noise = rng.normal(size=36)
        white = (noise - basis @ (basis.T @ noise)).reshape(12, 3).T
        blocks = basis.reshape(12, 3, 27)
        shares = np.eye(3) - blocks @ blocks.swapaxes(1, 2)
        usual = np.ones(12, bool)
        one = StatedNoise(white, 9, usual, np.arange(12), np.zeros(12, int))
        plain += heavy_tails(one) is not None
        known = replace(one, shares=shares)
        studentised += heavy_tails(known) is not None
        assert known.studentised.shape == (3, 12)
    assert studentised == 0 < plain


def test_studentised_residuals_have_unit_variance():
    rng = np.random.default_rng(4)
    basis = np.linalg.qr(
        rng.normal(size=(30, 21)) * np.repeat(np.linspace(0.1, 1, 10), 3)[:, None]
    )[0]
    blocks = basis.reshape(10, 3, 21)
    shares = np.eye(3) - blocks @ blocks.swapaxes(1, 2)
    noise = rng.normal(size=(30, 4000))
    residuals = (noise - basis @ (basis.T @ noise)).T.reshape(4000, 10, 3)
    usual = np.ones(10, bool)
    rows = [
        StatedNoise(one.T, 9, usual, np.arange(10), np.zeros(10, int), shares).studentised
        for one in residuals
    ]
    assert np.var(rows, axis=0) == pytest.approx(1.0, abs=0.12)
