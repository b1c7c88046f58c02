"""An effect far larger than usual is not shrunk towards zero, and a usual one keeps its prior."""

import numpy as np
import pytest
import tomli_w

from robot_model.effects import CATALOGUE
from robot_model.effects.curve import JointCurve
from robot_model.effects.transmission import TransmissionHarmonic
from test_joint_curve import with_curves
from test_shrinkage import waved
from workbench.core.least_squares.solver import solve
from workbench.diagnosis.robot.bench import bench_of
from workbench.fitting.priors.wider_priors import widened
from workbench.jobs.robot.simulate import simulate

SCENE = {
    "robot": "abb_irb120",
    "samples": 100,
    "seed": 50,
    "sigma_mm": 0.03,
    "reflectors": [[0.0, 30.0, 120.0]],
    "share_of_limits": 0.6,
}
TYPICAL = 3e-4  # rad, of a transmission harmonic


def priors_of(parameters):
    return np.array([p.prior for p in parameters.table], float)[parameters.mask]


def test_priors_in_conflict_with_the_data_are_widened():
    """Gears of all joints err by thirty times the typical size; the prior alone leaves a third of the error or more."""
    model, free, truth = waved(30 * TYPICAL, 14)
    first = fit = solve(model, free)
    for _ in range(8):  # the next solution shows which other effects are shrunk
        wider = widened(model, fit)
        if wider is fit.parameters:
            break
        fit = solve(model, wider)
    assert (priors_of(fit.parameters) >= priors_of(first.parameters)).all()
    assert (priors_of(fit.parameters) > 3 * priors_of(first.parameters)).any()
    away, left = (
        np.square(found.parameters.pack() - truth.pack()).mean() for found in (first, fit)
    )
    assert left < 0.1 * away


@pytest.mark.parametrize("size, n", [(0.0, 14), (TYPICAL, 14), (TYPICAL, 100), (2 * TYPICAL, 14)])
def test_priors_that_hold_stay(size, n):
    for seed in range(3):
        model, free, _ = waved(size, n, seed)
        fit = solve(model, free)
        assert widened(model, fit) is fit.parameters


@pytest.mark.parametrize("sigma", [0.02, 0.05])
def test_a_ripple_too_fine_for_a_curve_does_not_widen_its_prior(sigma):
    """Waves of a long domain that cancel where the poses are can follow a fine ripple: large, and wild elsewhere."""
    model, start = with_curves({3: lambda q: 3e-4 * np.sin(18 * q)}, n=1500, sigma=sigma)
    angle = model.chain.variables[2]
    middle = np.median(angle)
    model = model.at(np.flatnonzero(np.abs(angle - middle) < 0.5))
    waves = [TransmissionHarmonic("joint-3", order=order) for order in (1, 2)]
    curve = JointCurve("joint-3", start=middle - 3.5, end=middle + 3.5, terms=15)
    model = model.with_effects(*waves, curve)
    begin = model.parameters.take_over(start)
    fit = solve(model, begin.only(start_mask(start, begin)))
    assert fit.sigma_scale > 1.2  # the ripple is there
    assert widened(model, fit) is fit.parameters


def start_mask(start, wider):
    """(P,) True for what was free before, and for all parameters of effects."""
    added = len(wider) - len(start)
    return np.append(start.mask, np.ones(added, bool))


def solved_harmonic(tmp_path, values: dict, order: int, **more):
    """Values and 1 sigma of a harmonic of joint 3 in a simulated recording that has it: (2,) each."""
    effect = {"effect": "transmission-harmonic", "where": "joint-3", "order": order}
    scene = {
        "robot": "abb_irb120",
        "measures": "external-point",
        "reflectors": [[30.0, -40.0, 100.0]],
        "effect": [effect | {"values": values}],
        **more,
    }
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(scene), encoding="utf-8")
    bench = bench_of(simulate(path))
    bench.solve()
    effects = (TransmissionHarmonic("joint-3", order=order),)
    bench.solve(effects)
    rows = {row["name"]: row for row in bench.parameters(effects)}
    return np.array([[rows[name]["value"], rows[name]["std"]] for name in values]).T


def test_a_large_effect_of_the_diagnosis_has_its_size(tmp_path):
    """A gear that errs by thirty times the typical size, measured coarsely."""
    true = {"sin2": 30 * TYPICAL, "cos2": -20 * TYPICAL}
    found, _ = solved_harmonic(tmp_path, true, 2, samples=50, seed=7, sigma_mm=1.0)
    assert np.hypot(*found) == pytest.approx(np.hypot(30, 20) * TYPICAL, rel=0.08)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_large_effect_that_the_geometry_resembles_has_its_size(tmp_path, seed):
    """Over a short range of joint 3 the geometry takes most of a harmonic: what cancels then is no fine structure."""
    true = {"sin1": 30 * TYPICAL, "cos1": -20 * TYPICAL}
    more = {"samples": 60, "seed": seed, "sigma_mm": 0.02, "share_of_limits": 0.12}
    found, sigma = solved_harmonic(tmp_path, true, 1, **more)
    assert (np.abs(found - list(true.values())) < 3 * sigma).all()


def test_the_prior_of_an_effect_many_times_larger_than_usual_is_widened_where_it_has_a_small_share(
    tmp_path,
):
    """Refraction of 30 typical sizes: the prior has 2 % of the information, and shrinks it by 1.5 sigma."""
    values = {"gradient_x": 0.05, "gradient_y": 0.0, "gradient_z": -0.3}
    effect = {"effect": "sight-line-refraction", "where": "instrument", "values": values}
    scene = SCENE | {"samples": 300, "sigma_mm": 0.005, "effect": [effect]}
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(scene), encoding="utf-8")
    bench = bench_of(simulate(path))
    law = CATALOGUE["sight-line-refraction"]("instrument")
    _, fit, _ = bench.solve((law,))
    assert (priors_of(fit.parameters)[-3:] > 0.1).all()


def test_sizes_are_stated_without_the_pull_of_their_priors(tmp_path):
    """Refraction of three prior sigmas that the data determine to one: its mean error is no part of its sigma."""
    law, deviations = CATALOGUE["sight-line-refraction"]("instrument"), []
    values = {"gradient_x": 0.09, "gradient_y": -0.06, "gradient_z": -0.09}
    effect = {"effect": "sight-line-refraction", "where": "instrument", "values": values}
    for seed in range(12):
        path = tmp_path / f"scene-{seed}.toml"
        path.write_text(tomli_w.dumps(SCENE | {"seed": seed, "effect": [effect]}), encoding="utf-8")
        rows = bench_of(simulate(path)).parameters((law,))
        deviations += [(row["value"] - values[row["name"]]) / row["std"] for row in rows]
    assert np.sqrt(np.mean(np.square(deviations))) < 1.35


def test_a_load_and_the_compliances_that_it_deflects_keep_their_priors(tmp_path):
    """Their product is determined and hardly its factors: one linear step would lead far from both."""
    values = {"compliance": 2e-5}
    effect = {"effect": "joint-compliance", "where": "joint-2", "values": values}
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(SCENE | {"effect": [effect]}), encoding="utf-8")
    bench = bench_of(simulate(path))
    compliance = CATALOGUE["joint-compliance"]("joint-2")
    for effects, is_step in (
        ((compliance,), True),
        ((compliance, CATALOGUE["payload"]("tool")), False),
    ):
        _, fit, _ = bench.solve(effects)
        row = next(row for row in bench.parameters(effects) if row["name"] == "compliance")
        assert (row["value"] != fit.parameters[row["key"]]) == is_step
