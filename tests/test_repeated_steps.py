"""Two steps of one part of a machine: both are found, each with its instant and parameters of its own."""

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from scenes import model_of, scene
from test_diagnosis_engine import recorded
from workbench.core.errors import InputError
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.select import find
from workbench.explanation.answer import diagnose

TIMES = (815.0, 2015.0)  # of 150 samples every 20 s


def steps(name, where):
    first, second = TIMES
    return CATALOGUE[name](where, after=first), CATALOGUE[name](where, after=second, occurrence=2)


@pytest.mark.parametrize(
    ("name", "where", "values"),
    [
        ("shift", "base", [0.1, -0.05, 0.08, 1e-4, 0, -1e-4, -0.06, 0.1, 0.05, 0, 1e-4, 1e-4]),
        ("shift", "tool", [0.08, 0.06, -0.08, 0, 2e-4, 0, 0.05, -0.1, 0.1, 3e-4, 0, 0]),
        ("zero-shift", "joint-2", [1.5e-4, -2.5e-4]),
    ],
)
def test_both_steps_of_one_place_are_named(name, where, values):
    """The second one was a function of time without a name, next to the first one with little probability."""
    found = find(bench_of(recorded(41, steps(name, where), values, n=150)))
    assert [(f.effect, f.where) for f in found.findings] == [(name, where)] * 2
    assert all(f.probability > 0.95 for f in found.findings)
    instants = sorted(f.instant.value for f in found.findings)
    assert np.abs(np.subtract(instants, TIMES)).max() <= 60


def test_the_answer_has_the_parameters_of_each_step():
    values = [0.1, -0.05, 0.08, 0, 0, 0, -0.06, 0.1, 0.05, 0, 0, 0]
    made = diagnose(recorded(41, steps("shift", "base"), values, n=150))
    terms = [term for term in made.terms if term.kept]
    assert [(t.finding.effect, t.finding.where) for t in terms] == [("shift", "base")] * 2
    by_time = sorted(terms, key=lambda t: t.finding.instant.value)
    for term, expected in zip(by_time, (values[:3], values[6:9])):
        rows = {row["key"].rpartition(".")[2].rstrip("_2"): row for row in term.parameters}
        found = [rows[axis]["value"] for axis in "xyz"]
        spread = [rows[axis]["std"] for axis in "xyz"]
        assert (np.abs(np.subtract(found, expected)) < 5 * np.array(spread)).all()


def test_a_drift_of_the_base_is_no_row_of_steps():
    drift = [CATALOGUE["base-drift"]("base", start=0.0, end=2980.0)]
    count = len(drift[0].table(model_of(scene("external-point", n=20)).chain))
    values = np.zeros(count)
    values[: count // 2] = 0.1
    found = find(bench_of(recorded(42, drift, values, n=150)))
    assert not [f for f in found.findings if f.effect == "shift"]


def test_steps_of_one_place_need_different_numbers():
    made = scene("external-point", n=20)
    rows = [("shift", "base", {"after": after}) for after in TIMES]
    with pytest.raises((InputError, ValueError), match="base.shift.r?x"):
        len(model_of(made, *rows).parameters)
    rows[1][2]["occurrence"] = 2
    keys = [p.key for p in model_of(made, *rows).parameters.table]
    assert {"base.shift.x", "base.shift.x_2"} <= set(keys)
