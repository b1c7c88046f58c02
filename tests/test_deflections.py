"""Stated deflections of parts whose masses are unknown: determined where their parameters are not."""

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from test_real_arm_effects import without_masses
from workbench.core.model import NOISE, STATE_PORTS
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.robot.derived import deflection_row
from workbench.explanation.sentences.words import figures

COMPLIANCES = {"joint-2": 8e-6, "joint-3": 1.2e-5}  # rad/(N m)


@pytest.fixture(scope="module")
def deflections():
    """Rows of the deflection of each joint, and its true standard deviation over the poses in rad."""
    laws = [CATALOGUE["joint-compliance"](where) for where in COMPLIANCES]
    recording = recorded(71, laws, list(COMPLIANCES.values()), n=120)
    state = bench_of(recording).chain.state
    true = {law.where: COMPLIANCES[law.where] * law.basis(state).std() for law in laws}
    bench = bench_of(without_masses(recording))
    fitted = [CATALOGUE["gravity-compliance"](where) for where in COMPLIANCES]
    return bench.parameters(fitted), true


@pytest.mark.parametrize("where", COMPLIANCES)
def test_the_deflection_is_known_where_its_parameters_are_not(deflections, where):
    rows, true = deflections
    own = [row for row in rows if row["where"] == where]
    (whole,) = [row for row in own if row["name"] == "deflection"]
    assert abs(whole["value"] - true[where]) <= 4 * whole["std"]
    assert whole["std"] < 0.2 * true[where]
    sag = next(row for row in own if row["name"] == "sag")
    assert whole["std"] / whole["value"] < 0.2 * sag["std"] / abs(sag["value"])


def test_a_sentence_states_the_deflection_instead_of_its_shares(deflections):
    rows, _ = deflections
    said = figures([row for row in rows if row["where"] == "joint-2"])
    assert said.startswith("deflection (standard deviation over these poses) ") and "rad" in said
    assert "first moment" not in said and "," not in said


def test_what_does_not_deflect_is_no_significant_deflection():
    """The square of noise is no deflection: estimates and their standard deviations are of the same size."""
    bench = bench_of(without_masses(recorded(73, n=60)))
    ratios = []
    for where in ("joint-2", "joint-3", "joint-5"):
        rows = bench.parameters([CATALOGUE["gravity-compliance"](where)])
        (whole,) = [row for row in rows if row["name"] == "deflection"]
        ratios.append(whole["value"] / whole["std"])
    assert max(ratios) < 3


def test_only_effects_with_first_moments_have_the_row():
    """Every kind of effect, at each place where it may act, is asked for it."""
    bench = bench_of(without_masses(recorded(74, n=40)))
    chain, made = bench.chain, []
    offered = [v.effect for kind in CATALOGUE.values() for v in list(kind.candidates(chain))[:2]]
    for effect in [*offered, CATALOGUE["mount-tilt"]("base")]:
        if effect.port in (*STATE_PORTS, NOISE) or not effect.linear:
            continue
        values = np.full(len(effect.parameters(chain)), 1e-4)
        row = deflection_row(effect, values, np.diag(values**2), chain)
        assert (row is not None) == effect.estimates_moments
        made.append(row)
    keys = [row["key"] for row in made if row is not None]
    assert len(keys) == len(set(keys)) >= 4


def test_one_compliance_with_its_unit_has_no_row_of_its_own():
    law = CATALOGUE["joint-compliance"]("joint-2")
    bench = bench_of(recorded(72, [law], [8e-6], n=60))
    names = [row["name"] for row in bench.parameters([law])]
    assert names == ["compliance"] and np.isfinite(bench.parameters([law])[0]["std"])
