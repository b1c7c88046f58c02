"""Permutation and circular-shift controls of every effect, whatever the number of its parameters and columns."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from effect_cases import EVERY, OF_SLIDES
from robot_model.effects import CATALOGUE
from scenes import BALLS, CRAIG, SLIDING, scene
from test_diagnosis_engine import recorded
from test_real_arm_effects import without_masses
from workbench.core.effect import make_effects
from workbench.core.model import NOISE, STATE_PORTS
from workbench.diagnosis.linear.ends import Ends
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.validation.controls import PERMUTED, ROTATED, _Trial, controls

SIGMA = 0.02


def bench_with_noise(measures="external-point", n=40, arm=None, masses=True):
    """A bench of a scene with noise."""
    made = scene(measures, n=n, seed=3, sigma=SIGMA, **({"arm": arm} if arm else {})).recording
    rng = np.random.default_rng(5)
    xyz = {f"{axis}_mm" for axis in "xyz"}
    noisy = {k: c + SIGMA * rng.normal(size=n) if k in xyz else c for k, c in made.columns.items()}
    made = replace(made, columns=noisy)
    return bench_of(made if masses else without_masses(made))


def is_complete(made) -> bool:
    return all(c.passed is not None or c.why for c in made) and made[0].kind == PERMUTED


@EVERY
def test_every_effect_has_controls(case):
    """One column a parameter, also where a law is not linear and where its basis is wider than its parameters."""
    (effect,) = make_effects(CATALOGUE, [case])
    places = "ball-centre" if effect.port in ("sensor", "target") else "external-point"
    bench = bench_with_noise(places, arm=SLIDING if case[0] in OF_SLIDES else None)
    made = controls(bench, (), (effect,))
    assert is_complete(made)
    is_constant = effect.effect == "zero-offset"
    assert (made[0].passed is None) == (is_constant or effect.port in (*STATE_PORTS, NOISE))


def bench_of_all_balls(poses):
    """A bench of poses at which every ball is measured, in the same order, the third one off by 0.2 mm along x."""
    balls = list(BALLS)
    each = [
        scene("ball-centre", poses, 3, sigma=SIGMA, balls={k: BALLS[k]}).recording for k in balls
    ]
    columns = {k: np.stack([one.columns[k] for one in each], 1).ravel() for k in each[0].columns}
    rng = np.random.default_rng(5)
    for axis in "xyz":
        columns[f"{axis}_mm"] = columns[f"{axis}_mm"] + SIGMA * rng.normal(size=4 * poses)
    columns["x_mm"] = columns["x_mm"] + 0.2 * (columns["ball"] == balls[2])
    numbers = {"sample": np.arange(1.0, 4 * poses + 1), "time_s": np.arange(4.0 * poses)}
    return bench_of(replace(each[0], columns=columns | numbers, balls=BALLS)), balls[2]


def test_a_permutation_that_changes_nothing_refuses_nothing():
    """Every pose has the same balls in the same order: the permuted cause is the cause itself."""
    bench, ball = bench_of_all_balls(20)
    made = controls(bench, (), (CATALOGUE["ball-position"](f"ball-{ball}"),))
    assert made[0].passed is None and made[0].why
    harmonic = CATALOGUE["transmission-harmonic"]("joint-2", order=2)
    assert controls(bench, (), (harmonic,))[0].passed is not None


@pytest.mark.parametrize("arm", [CRAIG, SLIDING], ids=["craig", "sliding"])
def test_a_change_of_load_without_masses_has_controls_next_to_the_compliances(arm):
    bench = bench_with_noise(arm=arm, masses=False, n=60)
    rows = [
        ("gravity-compliance", v.effect.where, {})
        for v in CATALOGUE["gravity-compliance"].candidates(bench.chain)
    ]
    load, *soft = make_effects(CATALOGUE, [("load-deflection", "tool", {"after": 305.0}), *rows])
    assert len(soft) and len(load.basis(bench.chain.state)) > len(load.parameters(bench.chain))
    assert is_complete(controls(bench, soft, (load,)))
    assert is_complete(controls(bench, (load,), soft))


def autocorrelated(rng, n):
    """(3, n) mm, first-order autoregressive."""
    out = 0.05 * rng.normal(size=(3, n))
    for i in range(1, n):
        out[:, i] += 0.8 * out[:, i - 1]
    return out


def ramp(rng, n):
    return 0.15 * rng.normal(size=(3, 1)) * np.linspace(-0.5, 0.5, n)


def of_best_step(recording):
    """The circular-shift control of the shift of the tool at the instant with the largest gain."""
    bench = bench_of(recording)
    kind = CATALOGUE["shift"]
    (grid,) = (g for g in kind.grids(bench.chain) if g.where == "tool")
    trial = _Trial(bench, (), (grid.make(630.0),))
    steps = [(grid.make(t),) for t in grid.values]
    best = max(steps, key=lambda step: trial.gain(trial.basis(bench.chain.state, step), trial.y))
    found = {one.kind: one for one in controls(bench, (), best)}
    return found[ROTATED]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("size_mm", [0.055, 0.09])
def test_a_true_step_of_one_reflector_passes_the_circular_shift_control(seed, size_mm):
    """Before, the step itself was shifted, and overlapped with the true one."""
    rng = np.random.default_rng(seed)
    move = rng.normal(size=3)
    values = [*move * size_mm / np.linalg.norm(move), 0, 0, 0]
    step = CATALOGUE["shift"]("tool", after=630.0)
    assert of_best_step(recorded(seed, [step], values, n=90)).passed


@pytest.mark.parametrize("law", [autocorrelated, ramp])
@pytest.mark.parametrize("seed", range(2))
def test_a_step_fitted_to_a_slow_change_fails_the_circular_shift_control(seed, law):
    """At the instant where it gains most, so that its selection counts."""
    clean = recorded(seed, n=90)
    more = law(np.random.default_rng(seed), 90)
    columns = {f"{a}_mm": clean.columns[f"{a}_mm"] + row for a, row in zip("xyz", more)}
    made = of_best_step(replace(clean, columns=clean.columns | columns))
    assert made.passed is False and made.share > 0.2


def test_sums_over_the_components_of_a_sample_have_the_moments_of_the_columns():
    """A joint moves all components of a sample together: its moments follow from one sum a sample."""
    rng = np.random.default_rng(2)
    trial = _Trial.__new__(_Trial)
    trial.problem = SimpleNamespace(ends=Ends(1, 20))
    trial.rows, trial._basis = rng.normal(size=(1, 3, 20)), rng.normal(size=(60, 4))
    small, y = rng.normal(size=(5, 1, 20)), rng.normal(size=(60, 2))
    assert trial._sums is not None
    columns = trial.columns(small)
    for moment, expected in zip(trial._moments(small, y), (columns, trial._basis, y)):
        product = columns.T @ expected
        assert np.allclose(moment, product.T if expected is trial._basis else product)
