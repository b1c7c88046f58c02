"""Headings and messages name only what is there."""

import io

import numpy as np
import pytest
from rich.console import Console

from datasets.recording import Recording
from workbench.commands.shared import tables
from workbench.core.errors import InputError


@pytest.mark.parametrize(("known", "is_said"), [("stated masses", False), ("product only", True)])
def test_the_heading_explains_a_word_where_the_table_has_it(known, is_said):
    row = {"where": "joint-2", "known_from": known, "clear": True, "unit": "rad"}
    row |= {"stiffness": 2e4, "stiffness_std": 1e3, "value": None, "std": None}
    console = Console(file=io.StringIO(), width=120)
    tables._stiffness(console, [row], is_misfit=False)
    assert ("whose masses are not stated" in console.file.getvalue()) == is_said


def test_a_robot_file_that_is_not_there_is_a_sentence_without_a_number():
    with pytest.raises(InputError, match="correct the path") as found:
        Recording.from_arrays("nowhere.toml", np.zeros((3, 6)), np.zeros((3, 3)))
    assert "Errno" not in str(found.value)
