"""The mutation table: mistakes that no check was developed on, a few of them in the fast tests.

`python tools/mutation_table.py` makes all of them in all five recordings and prints the shares; here every sixteenth.
"""

import sys
from argparse import Namespace
from pathlib import Path

import pytest

from test_user_errors import assert_right_cause
from user_error_scenes import simulated
from user_errors_more import EVERY, FRESH

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))
import mutation_table  # noqa: E402

NAMED = {mistake.name: mistake for mistake in EVERY}
SEARCHED = (
    "one joint in arc minutes",
    "positions in feet",
    "measurements two rows late",
    "joint columns moved on by two places",
    "all joints of the opposite sign",
    "instrument set up again midway",
)


def test_the_table_has_more_than_75_mistakes_and_five_recordings():
    assert len(NAMED) == len(EVERY) > 75 and len(FRESH) == 5


@pytest.mark.parametrize("mistake", SEARCHED)
def test_mistakes_that_the_search_once_missed(mistake):
    assert_right_cause(NAMED[mistake], simulated("external-pose"))


def test_a_robot_file_in_metres_is_refused_with_its_cause():
    assert_right_cause(NAMED["robot file in m"], simulated("external-pose"))


@pytest.mark.slow
@pytest.mark.parametrize("name", FRESH)
def test_every_sixteenth_mistake_in_a_recording(name):
    rows = list(mutation_table.outcomes(name, Namespace(seed=71, every=16, only="")))
    assert mutation_table.summary(rows) == 0, rows


@pytest.mark.long
@pytest.mark.parametrize("name", FRESH)
def test_every_mistake_in_a_recording(name):
    rows = list(mutation_table.outcomes(name, Namespace(seed=71, every=1, only="")))
    assert mutation_table.summary(rows) == 0, rows
