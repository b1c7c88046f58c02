"""Minimal detectable biases: many variants of one effect at one place are one row of the table, with their range."""

from types import SimpleNamespace

from workbench.explanation.minimal_detectable_bias import DetectableBias
from workbench.report.diagnosis.detectable import detectable, fold_variants


def bias(label: str, size: float | None, effect: str = "board-point-errors") -> DetectableBias:
    other = ("lens-residual", "camera")
    return DetectableBias(
        effect, "artefact", label, size, size, 0.3, size, "mm", None, None, *other
    )


def test_lines_of_a_board_are_one_row_with_the_range():
    lines = [bias(f"row at {10 * k} mm", 0.02 + 0.01 * k) for k in range(6)]
    few = [bias("", 0.05, "board-bow"), bias("", None, "artefact-expansion")]
    folded = fold_variants([*lines[:2], *few, *lines[2:]])
    assert [len(group) for group in folded] == [6, 1, 1]
    parts = list(detectable(SimpleNamespace(unit="px", detectable=(*lines, *few))))
    text = str(parts)
    assert "6 variants" in text and "0.020 to 0.070" in text and "row at" not in text
    assert "lists all 8 variants" in text
