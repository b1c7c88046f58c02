"""A first harmonic of a joint is named with the gravity compliance that makes the same in these poses."""

import pytest

from coupled_arms import CoupledArm
from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.findings import finding
from workbench.diagnosis.search.state import Search

WAVE, GRAVITY = ("transmission-harmonic", "joint-2"), ("gravity-compliance", "joint-2")


def named(recording):
    """The finding of a search that has accepted the first harmonic of joint 2."""
    search = Search(bench_of(recording), None, 0.005, lambda line: None)
    search.solve()
    search.accepted = tuple(h for h in search.table(()) if h.key == WAVE and h.label == "order 1")
    search.solve()
    return finding(search, 0)


def test_the_deflection_of_a_parallelogram_is_among_the_names_of_its_first_harmonic():
    arm = CoupledArm("parallelogram", compliances=(0, 4e-7, 0, 0, 0, 0), with_masses=False)
    found = named(arm.recording(90, 3))
    (gravity,) = (a for a in found.alternatives if (a.effect, a.where) == GRAVITY)
    assert gravity.probability == pytest.approx(found.probability)
    total = found.probability + sum(a.probability for a in found.alternatives)
    assert total <= 1 + 1e-9


def test_an_arm_of_stated_masses_has_a_torque_of_its_own():
    wave = CATALOGUE["transmission-harmonic"]("joint-2", order=1.0)
    found = named(recorded(5, (wave,), [4e-4, -3e-4]))
    assert not any((a.effect, a.where) == GRAVITY for a in found.alternatives)
    assert "another load" in found.effects[0].distinguished_by
