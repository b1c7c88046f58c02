"""Held-out errors of real arms are those that the documentation states: a loss of a stage is noticed."""

import re

import pytest

from conftest import ROOT
from workbench.jobs.robot.calibrate import calibrate

TABLE = ROOT / "docs" / "reference" / "real-recordings.md"
SAME = 0.02
"""Relative difference: figures are printed with two or three digits, and machines round differently."""


def documented(name: str) -> float:
    """mm, the result in the row of a recording."""
    rows = [line for line in TABLE.read_text(encoding="utf-8").splitlines() if f"`{name}`" in line]
    return float(re.search(r"\*\*([\d.]+)\*\*", rows[0])[1])


LONG = [pytest.param(name, marks=pytest.mark.long) for name in ("irb120_faro", "ur10_ipa_tmac_A")]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "irb120_wu_arm",
        "motoman_leica_ctu:right",
        "motoman_leica_ctu:left",
        "fanuc165f_innopolis",
        *LONG,
    ],
)
def test_the_held_out_error_of_a_real_arm_is_the_documented_one(recording, name):
    found = calibrate(recording(name)).held_out["rms_mm"]
    assert found == pytest.approx(documented(name), rel=SAME)
