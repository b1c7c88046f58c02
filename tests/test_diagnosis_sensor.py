"""The sensor's diagnosis on measurements without images: derivatives, noise, names, held-out errors."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import sensor_virtual
from conftest import mostly_slow
from sensors.effects import CATALOGUE
from simulated_images import simulated
from workbench.core.model import Model
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.linear.problem import Finding, Found
from workbench.diagnosis.scanner import sensor, sensor_review
from workbench.diagnosis.search.select import find
from workbench.diagnosis.validation import folds
from workbench.diagnosis.validation.controls import controls
from workbench.diagnosis.validation.held_out import name_of
from workbench.diagnosis.validation.proof import retained_in_fold
from workbench.jobs.sensor import chains as measured_chains

CASES = {
    "plane-bow": ("laser", {}, {"curvature": 5e-6}),
    "mirror-encoder-harmonic": ("mirror", {"order": 12}, {"cos12": 1e-4, "sin12": -5e-5}),
    "board-bow": ("artefact", {}, {"xx": 0.02, "yy": -0.01, "xy": 0.01}),
    "lens-residual": ("camera", {}, {"z0c3r": 0.03, "z3c0i": 0.03, "z0c2r": 0.02}),
    "subsurface-scatter": ("sensor", {}, {"depth": 0.02, "shrink": 0.04}),
    "frame-sync": ("time", {}, {"delay": 2e-4}),
    "mirror-hysteresis": ("mirror", {}, {"half_gap": 2e-5}),
}


@cache
def true():
    return sensor_virtual.chains()


def measured(name, seed=0, times=1.0):
    """Chains with an effect at `times` its size, and the effect."""
    where, options, values = CASES[name]
    effect = CATALOGUE[name](where, **options)
    return simulated(
        true(), (effect,), {f"{where}.{name}.{key}": times * v for key, v in values.items()}, seed
    ), effect


@cache
def clean():
    return sensor.SensorBench(simulated(true(), (), {}, 7))


@pytest.mark.parametrize(
    "port, port_index",
    [
        ("pixel", 0),
        ("pixel", 1),
        ("ray", 0),
        ("ray", 2),
        ("mirror", 0),
        ("plane", 1),
        ("plane", 3),
        ("plane", 4),
        ("point", 2),
        ("target", 1),
    ],
)
def test_derivatives_of_the_ball_chain_by_its_ports_are_those_of_its_values(port, port_index):
    balls = true().balls
    step = {
        "pixel": 1e-3,
        "ray": 1e-6,
        "mirror": 1e-6,
        "plane": 1e-6,
        "point": 1e-3,
        "target": 1e-3,
    }[port]
    step = 1e-8 if (port, port_index) == ("plane", 4) else step
    values = balls.parameters.values

    def residual(by):
        return balls.evaluate(
            values, {port: (np.array([port_index]), np.full((1, balls.n), by))}
        ).residual[0]

    numeric = (residual(step) - residual(-step)) / (2 * step)
    rows = balls.evaluate(values, {}).rows(port, np.array([port_index]))[0, 0]
    assert np.abs(numeric - rows).max() < 1e-4 * np.abs(rows).max()


def test_derivatives_of_the_ball_chain_by_camera_mirror_and_centres_are_those_of_its_values():
    balls = true().balls
    table = balls.parameters.free("*")
    rows = Model(balls).linearise(table)[1][:, 0]
    for k, key in enumerate(table.keys):
        h = 1e-5 * table.typical[k]
        up, down = (
            Model(balls).residual(table.update({key: table.values[k] + s * h}))[0] for s in (1, -1)
        )
        assert np.abs((up - down) / (2 * h) - rows[k]).max() < 1e-3 * max(
            np.abs(rows[k]).max(), 1e-9
        ), key
    by_centre = balls.evaluate(table.values, {}).family_rows("ball")[:, 0]
    moved = (
        balls.with_families({"ball": balls.centres + [0, 0, 1e-4]})
        .evaluate(table.values, {})
        .residual[0]
    )
    assert np.abs(moved / 1e-4 - by_centre[2]).max() < 1e-3 * np.abs(by_centre[2]).max()


def test_noise_is_read_from_neighbours_and_a_planted_effect_does_not_raise_it():
    for chains in (simulated(true(), (), {}, 3), measured("lens-residual", 3, 5.0)[0]):
        for name, chain in chains.parts.items():
            assert measured_chains.noise_scale(chain, name) == pytest.approx(1.0, abs=0.15), name


def test_a_problem_is_whitened_and_its_basis_holds_every_pose_and_ball():
    problem = clean().problem()
    left = problem.orthogonalise(problem.residual)
    assert (
        len(problem.sample)
        == len(problem.residual)
        == 2 * clean().chains.counts[0] + sum(clean().chains.counts[1:])
    )
    assert (left**2).sum() / problem.degrees == pytest.approx(1.0, abs=0.06)
    assert problem.basis.shape[1] >= 6 * 12 + 3 * 18 + 9 + 7
    assert np.allclose(problem.basis.T @ problem.basis, np.eye(problem.basis.shape[1]), atol=1e-10)


def test_an_effects_columns_are_what_the_baseline_leaves_of_it():
    chains, effect = measured("plane-bow", 0, 2.0)
    bench = sensor.SensorBench(chains)
    still = sensor.SensorBench(simulated(true(), (), {}, 0))
    problem, without = bench.problem(), still.problem()
    column = next(
        c.columns
        for c in problem.candidates
        if c.effect == "plane-bow" and c.label == "the same all along"
    )
    change = problem.orthogonalise(
        problem.residual / np.sqrt(problem.weights)[problem.sample]
    ) - without.orthogonalise(without.residual)
    expected = problem.orthogonalise(column[:, 0]) * 1e-5
    assert change @ expected / (expected @ expected) == pytest.approx(
        -1.0, abs=0.1
    )  # the prediction lacks it


def test_a_search_inside_a_fold_sees_all_of_the_other_placements():
    """A tenth of the samples shows a tenth as much: what was found outside would be called luck."""
    seen, bench = [], clean()

    def search(bench, samples):
        seen.append(samples)
        return []

    others = bench.pose % 5 > 0
    assert retained_in_fold(bench, others, search) == []
    assert others.sum() > 2 * folds._SEARCHED and np.array_equal(seen[0], others)


def test_every_sample_has_the_noise_of_its_kind():
    bench = clean()
    corners, board_stripes, balls = bench.chains.counts
    kinds = np.split(bench.sigma, np.cumsum((corners, board_stripes)))
    assert [len(kind) for kind in kinds] == [corners, board_stripes, balls]
    assert np.allclose([np.median(kind) for kind in kinds], (0.01, 0.03, 0.03), rtol=0.1)


def test_nothing_is_found_in_a_flawless_scanner():
    found = find(clean())
    assert found.p_first > 0.01
    assert not found.findings


def test_a_bowed_light_plane_is_named_at_the_laser():
    named("plane-bow")


@pytest.mark.parametrize("name", mostly_slow([name for name in CASES if name != "plane-bow"], 0, 4))
def test_planted_effect_is_named_at_its_place(name):
    named(name)


def named(name):
    chains, effect = measured(name)
    found = find(sensor.SensorBench(chains)).findings
    assert [(one.effect, one.where) for one in found] == [(effect.effect, effect.where)]
    others = [(one.effect, one.where) for one in found[0].alternatives]
    if name == "subsurface-scatter":  # a wrong radius of all balls looks the same
        assert others[0] == ("ball-radius", "artefact")
        assert found[0].probability + found[0].alternatives[0].probability > 0.7
    else:
        assert found[0].probability > 0.7


@pytest.mark.parametrize("part", ["corners", "board_stripes", "balls"])
def test_what_an_effect_reads_of_a_place_holds_none_of_its_noise(part):
    """A large effect that a camera makes as well would shrink the noise, and be preferred for that."""
    quiet, noisy = (simulated(true(), (), {}, seed).parts[part] for seed in (1, 2))
    apart = np.abs(quiet.pixels - noisy.pixels).max()
    assert np.abs(quiet.state.pixels - noisy.state.pixels).max() < 0.02 * apart


def test_a_whitened_problem_makes_columns_of_an_effect_that_is_no_candidate():
    problem = clean().problem()
    effect = CATALOGUE["mirror-encoder-harmonic"]("mirror", order=12)
    weight = np.linspace(0.5, 1.0, len(problem.residual))
    made = problem.transformed(lambda rows: weight * rows).columns_of(effect)
    assert np.allclose(made, weight[:, None] * problem.columns_of(effect))


def test_held_out_errors_fall_to_the_noise_with_the_effect_and_parameters_are_right():
    chains, effect = measured("board-bow", 1, 3.0)
    bench = sensor.SensorBench(chains)
    folds = bench.pose % 4
    before, after = (bench.held_out(effects, folds) for effects in ((), (effect,)))
    corners = slice(0, bench.chains.counts[0])
    assert np.sqrt((after[corners] ** 2).mean()) == pytest.approx(0.01 * np.sqrt(2), rel=0.08)
    assert np.sqrt((before[corners] ** 2).mean()) > 1.5 * np.sqrt((after[corners] ** 2).mean())
    for row, value in zip(bench.parameters((effect,)), (0.06, -0.03, 0.03)):
        assert abs(row["value"] - value) < 4 * row["std"]
        assert row["size_px"] > 0 and row["size_mm"] > 0


@pytest.mark.slow
def test_what_a_scan_found_passes_its_control_though_it_is_no_candidate():
    """A harmonic of an order that only the scan has: its columns come from the solution that holds it."""
    chains, effect = measured("mirror-encoder-harmonic")
    bench = sensor.SensorBench(chains)
    effects = find(bench).findings[0].effects
    assert effects[0].effect == effect.effect
    held = {name_of(e) for one in bench.problem().candidates for e in one.effects}
    assert name_of(effects[0]) not in held
    made = controls(bench, (), effects)
    assert [one.passed for one in made] == [True]


@pytest.mark.slow
def test_a_wobble_so_large_that_it_is_not_linear_is_named_or_declared_with_its_confounded_effect():
    effect = CATALOGUE["mirror-wobble"]("mirror")
    fine = sensor_virtual.chains(2, steps=24, boards=14, stripe_px=0.008, corner_px=0.004)
    values = {"tilt_cos1": 0.0163, "shift_cos1": -0.56, "tilt_sin1": -0.0022, "shift_sin1": -0.61}
    values |= {"tilt_cos2": -0.0035, "shift_cos2": 0.22, "tilt_sin2": -0.0116, "shift_sin2": -0.64}
    chains = simulated(
        fine, (effect,), {f"mirror.mirror-wobble.{k}": v for k, v in values.items()}, 2
    )
    found = find(sensor.SensorBench(chains)).findings
    confounded = {("mirror-wobble", "mirror"), ("mirror-encoder-harmonic", "mirror")}
    said = {
        (found[0].effect, found[0].where),
        *((a.effect, a.where) for a in found[0].alternatives),
    }
    assert len(found) == 1
    assert ("mirror-wobble", "mirror") in said
    assert said <= confounded


@pytest.mark.parametrize(
    "where, evidence, size, declared",
    [
        ("mirror", 30.0, True, True),
        ("mirror", 30.0, False, False),
        ("mirror", 10.0, True, False),
        ("laser", 30.0, True, False),
    ],
)
def test_large_law_that_is_likelier_is_an_alternative_to_a_function_at_its_place(
    monkeypatch, where, evidence, size, declared
):
    label = "a smooth function of mirror and along"
    law = Hypothesis("a law", where, "", evidence=evidence, gain=80.0, rank=3, log_prior=-3.0)
    own = Hypothesis(
        "unknown",
        "mirror",
        label,
        smooth_covariates=("mirror", "along"),
        evidence=20.0,
        gain=100.0,
        rank=16,
        log_prior=-5.0,
    )
    bare = SimpleNamespace(conditional_on=lambda: None)
    monkeypatch.setattr(sensor_review, "ranked_hypotheses", lambda problem: [law, own])
    monkeypatch.setattr(sensor_review, "large", lambda *about: size)
    finding = Finding(
        "unknown", "mirror", label, ("a function",), 1e-9, 0.99, 1.0, 100.0, ("mirror", "along")
    )
    found = Found((finding,), bare, bare, 0.0, 0.0, (), (), np.zeros(1, bool))
    (revised,) = sensor_review.reviewed(
        SimpleNamespace(problem=lambda *about: bare), found
    ).findings
    assert [a.effect for a in revised.alternatives] == ["a law"] * declared
    assert revised.probability + sum(a.probability for a in revised.alternatives) == pytest.approx(
        1.0 if declared else 0.99
    )
    assert (revised.effect, revised.depends_on) == ("unknown", ("mirror", "along"))


def test_the_samples_that_have_a_covariate_are_known():
    """A corner has no place along a stripe, and a point on a ball none on the board."""
    bench = clean()
    ends = np.cumsum(bench.chains.counts)
    parts = dict(zip(bench.chains.parts, np.split(np.arange(bench.n), ends[:-1])))
    described = {name: set(np.unique(mask)) for name, mask in bench.described.items()}
    assert described["u"] == {True} and described["range"] == {True}
    for name, rows in parts.items():
        assert bench.described["along"][rows].all() == (name != "corners")
        assert bench.described["board_x"][rows].any() == ("ball" not in name)
