"""Tables of the terminal: no word or number is broken, however narrow it is."""

import io

import pytest
from rich.console import Console

from workbench.commands.shared.tables import grid

STAGES = (
    ["stage", "free", "identified", "RMS mm", "held out mm", "RMS deg", "held out deg", ""],
    [
        ["geometry", 33, 27, 0.322345, 0.35071234, 0.0123456, 0.0145678, ""],
        ["joint curves", 75, 66, 0.03338, 0.04365, 0.0023456, 0.0033456, "not retained"],
    ],
)
WORDS = {"identified", "0.03338", "0.003346", "retained", "joint curves", "geometry"}


def printed(width, head, rows, left=1):
    console = Console(width=width, file=io.StringIO())
    grid(console, "Stages", head, rows, left)
    return console.file.getvalue()


@pytest.mark.parametrize("width", [40, 60, 80, 90, 120])
def test_numbers_and_words_stay_whole(width):
    text = printed(width, *STAGES)
    assert all(word in text for word in WORDS)


def test_a_table_fits_into_80_columns_with_headings_of_two_lines():
    lines = printed(80, *STAGES).splitlines()
    assert max(map(len, lines)) <= 80
    assert "held out mm" not in "\n".join(lines) and "held out mm" in printed(120, *STAGES)
    assert not any(line.endswith(" ") for line in lines)


def test_long_text_is_wrapped_between_words():
    rows = [["joints", "Axis 1 [deg], Axis 2 [deg], Axis 3 [deg], Axis 4 [deg]", "deg"]]
    lines = printed(50, ["quantity", "columns", "read as"], rows, 3).splitlines()
    assert max(map(len, lines)) <= 50
    assert sum("[deg]" in line for line in lines) >= 2


def test_a_word_that_is_too_long_keeps_the_table_wide():
    text = printed(
        30, ["name", "file"], [["a", 1.5], ["a-name-of-more-than-thirty-characters", 2.5]]
    )
    assert "a-name-of-more-than-thirty-characters" in text and "2.5" in text


@pytest.mark.parametrize("missing", [0, 1])
def test_a_table_that_just_fits_keeps_its_headings(missing):
    """Three columns of 60, 8 and 8 characters and two gaps of 2 are 80 wide."""
    rows = [["x" * (60 + missing), 0.009899, 0.01197], ["y", 0.05, 0.06]]
    lines = printed(80, ["", "fit", "held out"], rows, 1).splitlines()
    assert ("held out" in lines[1]) == (missing == 0)
    assert lines[1 if missing == 0 else 2].endswith("out")
