"""Parameters of a finding that the data determine only in combination are said to be so."""

import pytest

from robot_model.effects import CATALOGUE
from workbench.core.parameters import Parameter
from workbench.diagnosis.linear.estimates import parameter_row
from workbench.explanation.sentences.words import figures

SHIFT = CATALOGUE["shift"]("tool", after=5.0)


def row(name, value, std, unit="mm", typical=0.1):
    parameter = Parameter(f"tool.shift.{name}", unit, typical=typical, label=f"the shift, {name}")
    return parameter_row(parameter, SHIFT, value, std)


@pytest.mark.parametrize(
    ("value", "std", "identifiable"),
    [
        (0.05, 0.01, True),
        (0.05, 0.5, True),  # uncertain, but no larger than what is plausible
        (0.05, 5.0, False),
        (30.0, 5.0, True),  # far from zero
        (-0.05, 5.0, False),
    ],
)
def test_a_parameter_that_could_be_anything_is_not_identifiable_by_itself(value, std, identifiable):
    assert row("x", value, std)["identifiable"] is identifiable


def test_no_number_is_stated_of_what_only_a_combination_determines():
    """One reflector shows three numbers of the six of a slipped tool."""
    rows = [row("x", 0.05, 5.6), row("y", 0.02, 5.4), row("rx", 1e-4, 0.02, "rad", 3e-4)]
    assert figures(rows) == "x, y and rx identifiable only in combination"


def test_identifiable_numbers_stand_before_the_others():
    said = figures([row("x", 0.052, 0.004), row("y", 0.02, 5.4)])
    assert said.startswith("the shift, x")
    assert said.endswith("(y identifiable only in combination)")
    assert "5.4" not in said
