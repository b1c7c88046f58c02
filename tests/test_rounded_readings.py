"""Readings that are rounded at all joints: their rounding errors are noise of a known size, and no effect of the arm."""

from dataclasses import replace

import numpy as np
import pytest

from noise_scenes import recorded
from workbench.explanation.answer import diagnose

_WITHOUT = ("accel", "approach", "qdot", "temperature", "payload", "range")


def rounded(step_deg):
    """Noise of 0.02 mm, and readings on a lattice."""
    made = recorded(3, n=100)
    columns = {k: v for k, v in made.columns.items() if not k.startswith(_WITHOUT)}
    for name in [name for name in columns if name.endswith("_deg")]:
        columns[name] = np.round(columns[name] / step_deg) * step_deg
    return replace(made, columns=columns)


@pytest.mark.parametrize("step_deg", [0.02, 0.05])
def test_all_joints_are_named_and_the_noise_contains_their_rounding(step_deg):
    found = diagnose(rounded(step_deg))
    assert found.verdict == "explained"
    assert {t.finding.effect for t in found.terms} == {"reading-lattice"}
    assert len(found.terms) == 6
    # 30 parameters from 300 numbers add a tenth to a fifth to the held-out error
    assert 0.75 < found.proof.noise / found.proof.after < 1.05


def test_a_lattice_too_fine_to_matter_is_not_named():
    found = diagnose(rounded(1e-4))
    assert found.verdict == "consistent" and not found.terms
