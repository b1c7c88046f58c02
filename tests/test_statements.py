"""Sentences of findings."""

from workbench.diagnosis.linear.problem import Alternative, Finding
from workbench.explanation.result import Term
from workbench.explanation.sentences import statements


def test_noise_findings_are_described_in_words():
    hidden = Alternative("backlash", "joint-3", "", 0.5, 1.0, "", "approach")
    moving = Term(
        Finding("unknown", "joint-3", "", (), 1e-9, 1.0, 0.3, 40.0, (), (hidden,)), size=0.03
    )
    said = statements.statement(moving, "the ball", "mm")
    assert (
        "random error from sample to sample" in said
        and "the side from which each joint came" in said
    )
    spread = Term(
        Finding("noise-heteroscedastic", "noise", "", (), 1e-9, 1.0, 0.0, 0.0, ("range_mm",))
    )
    assert (
        statements.statement(spread, "the ball", "mm")
        == "The noise is not the same everywhere: its spread goes with the range."
    )
