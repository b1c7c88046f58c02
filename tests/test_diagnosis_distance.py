"""Diagnosis of lengths between two places: what acts differently at the two ends adds up to the one length."""

import numpy as np
import pytest

from datasets.recording import Recording
from plain_frames import frames_of
from robot_model import load_robot
from scenes import ABB
from workbench.diagnosis.linear.candidates import Scan
from workbench.diagnosis.linear.evidence import Projected
from workbench.diagnosis.linear.hypotheses import ranked_hypotheses
from workbench.diagnosis.robot.bench import bench_of
from workbench.explanation.answer import diagnose
from workbench.report.diagnosis.figures import space

REFLECTOR = np.array([40.0, -25.0, 150.0])
ORDER, COSINE, SINE = 2, 4e-4, -3e-4  # of joint 3, rad


def lengths(pairs, seed=0, sigma=0.02, step=0.0, cosine=COSINE, sine=SINE):
    """Lengths by plain matrix products of an arm whose joint 3 errs twice a revolution; joint 4 is turned by `step`
    rad from the pair 3/5 of all pairs on."""
    rng, robot = np.random.default_rng(seed), load_robot(ABB)
    q = rng.uniform(-1.5, 1.5, (2 * pairs, 6))
    true = q + np.deg2rad(rng.normal(0, 0.05, 6))
    true[:, 2] += cosine * np.cos(ORDER * q[:, 2]) + sine * np.sin(ORDER * q[:, 2])
    true[np.arange(2 * pairs) // 2 >= 3 * pairs // 5, 3] += step
    flanges = np.array([frames_of(robot, row)[-1] for row in true])
    places = flanges[:, :3, :3] @ REFLECTOR + flanges[:, :3, 3]
    measured = np.linalg.norm(places[::2] - places[1::2], axis=1) + rng.normal(0, sigma, pairs)
    columns = {
        "sample": np.arange(1.0, 2 * pairs + 1),
        "pair": np.repeat(np.arange(1.0, pairs + 1), 2),
        "length_mm": np.repeat(measured, 2),
    }
    columns |= {f"q{k + 1}_deg": np.rad2deg(column) for k, column in enumerate(q.T)}
    return Recording("distance", columns, ABB, sigma_mm=sigma, name="bar")


def test_sums_over_both_ends_are_the_products_of_the_columns_of_lengths():
    """Of a smooth function, of a step of one joint and of the whole tool, and of a gear error of an order."""
    problem = bench_of(lengths(50)).problem()
    assert problem.ends.count == 2 and problem.n == 50 and len(problem.covariates["q1"]) == 100
    projected, seen = Projected(problem), set()
    for h in ranked_hypotheses(problem):
        kind = getattr(h.source, "kind", type(h.source).__name__)
        if (kind, len(h.columns(problem).T)) in seen:
            continue
        seen.add((kind, len(h.columns(problem).T)))
        scores = projected.score_hypotheses(projected.column_moments(h.columns(problem)[None]))
        assert scores.gain[0] == pytest.approx(h.gain, rel=1e-6, abs=1e-9)
        assert scores.rank[0] == h.rank
    assert {kind for kind, _ in seen} >= {"Site", "step", "wave", "Candidate"}


def test_a_column_of_a_scan_is_the_derivative_of_the_lengths():
    bench = bench_of(lengths(30))
    problem = bench.problem()
    scan = next(
        s for s in problem.scans if (s.effect, s.where) == ("transmission-harmonic", "joint-3")
    )
    assert isinstance(scan, Scan) and scan.rows.shape == (1, 60)
    model, fit, _ = bench.solve()
    effect = scan.make(float(scan.options[4]))[0]
    wider = model.with_effects(effect)
    start = wider.parameters.take_over(fit.parameters)
    own = start.only(np.arange(len(start)) >= wider.spans[-1].start)
    size = np.array([1e-6, 0.0])
    moved = wider.residual(own.unpack(size)) - wider.residual(own.unpack(-size))
    whitening = np.sqrt(problem.weights) / problem.sigma
    phase = scan.options[4] * scan.x
    column = problem.ends.joined(scan.rows[0] * np.cos(phase))
    np.testing.assert_allclose(column, moved[0] / 2e-6 * whitening, rtol=1e-5, atol=1e-2)


def test_an_error_of_a_joint_is_named_from_lengths_alone():
    found = diagnose(lengths(90))
    assert found.verdict == "explained" and len(found.terms) == 1
    term = found.terms[0]
    assert (term.finding.effect, term.finding.where) == ("transmission-harmonic", "joint-3")
    values = {row["name"]: (row["value"], row["std"]) for row in term.parameters}
    for name, true in (("cos2", COSINE), ("sin2", SINE)):
        value, std = values[name]
        assert abs(value - true) < 4 * std < abs(true)
    assert found.proof.after < 1.5 * 0.02 < found.proof.before
    assert found.views.names == ("residual",)
    traces = [trace.name for trace in space(found, "before").data]
    assert traces == ["samples", "arm in one pose"]  # a length has no direction that an arrow shows


def test_an_instant_is_found_in_lengths():
    found = diagnose(lengths(100, step=1.5e-3, cosine=0.0, sine=0.0))
    assert [(t.finding.effect, t.finding.where) for t in found.terms] == [("zero-shift", "joint-4")]
    assert found.terms[0].finding.effects[0].after == pytest.approx(59.5, abs=1.5)


def test_nothing_is_found_in_lengths_of_an_arm_that_the_baseline_holds():
    found = diagnose(lengths(90, seed=5, cosine=0.0, sine=0.0))
    assert found.verdict == "consistent" and not found.terms
