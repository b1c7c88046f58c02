"""Standard deviations of effects next to a geometry of which the data leave a gauge freedom."""

import tomllib
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import tomli_w

import robot_model
from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.diagnosis.robot.bench import bench_of
from workbench.jobs.robot.simulate import simulate

SCENE = {
    "robot": "abb_irb120",
    "samples": 100,
    "sigma_mm": 0.005,
    "reflectors": [[0.0, 30.0, 120.0]],
    "share_of_limits": 0.6,
}

TWIST = np.array([0.2, -0.1, 0.05, -5e-5, 7e-5, 1.1e-4])


def test_a_warm_up_of_the_base_is_as_certain_as_the_data_make_it():
    """Base and joints may turn together by any angle: a freedom of the model, in which the drift is not less certain.

    The reference is the spread of the drift over recordings with other noise.
    """
    effect = CATALOGUE["base-warm-up"]("base", time_constant=100.0)
    made = []
    for seed in range(12):
        rows = bench_of(recorded(40 + seed, (effect,), TWIST)).parameters((effect,))
        made.append([(row["value"], row["std"]) for row in rows])
    value, std = np.moveaxis(np.array(made), 2, 0)
    z = (value - TWIST) / std
    assert 0.5 < (z**2).mean() < 1.6
    # significant, as it is
    assert (np.abs(value[:, 0]) > 3 * std[:, 0]).all()


def test_the_standard_deviation_of_a_compliance_has_the_uncertainty_of_stated_masses(tmp_path):
    """The file of the robot has every mass off by 5 % and every centre by 5 mm, as data sheets do."""
    file = Path(robot_model.__file__).parent / "robots" / "abb_irb120.toml"
    stated = tomllib.loads(file.read_text(encoding="utf-8"))
    values, path = {"joint-2": 6e-5, "joint-3": 8e-5}, tmp_path / "scene.toml"
    laws = [CATALOGUE["joint-compliance"](where) for where in values]
    effects = [
        {"effect": law.effect, "where": law.where, "values": {"compliance": values[law.where]}}
        for law in laws
    ]
    deviations, of_noise = [], []
    for seed in range(6):
        scene = SCENE | {"seed": seed, "effect": effects}
        path.write_text(tomli_w.dumps(scene), encoding="utf-8")
        rng, robot = np.random.default_rng(seed), deepcopy(stated)
        for joint in robot["joint"]:
            centre = np.array(joint["com_mm"]) + rng.normal(0, 5, 3)
            joint |= {"mass_kg": joint["mass_kg"] * (1 + rng.normal(0, 0.05))}
            joint |= {"com_mm": centre.tolist()}
        for row in bench_of(replace(simulate(path), robot=robot)).parameters(laws):
            if row["name"] == "compliance":
                deviations.append((row["value"] - values[row["where"]]) / row["std"])
                of_noise.append((row["value"] - values[row["where"]]) / row["conditional_std"])
    assert 0.4 < np.sqrt(np.mean(np.square(deviations))) < 1.6
    assert np.sqrt(np.mean(np.square(of_noise))) > 3
