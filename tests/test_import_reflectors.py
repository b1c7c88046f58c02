"""Several sets of point columns in one row: a stated set is taken, and several reflectors become rows."""

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.importers.mapping.columns.reflectors import stacked
from datasets.importers.mapping.model import Group, Mapping, mapping_from_keys
from datasets.importers.mapping.proposal import propose
from datasets.importers.source import RawTable

FIRST = ("SMR1 X", "SMR1 Y", "SMR1 Z")
SECOND = ("SMR2 X", "SMR2 Y", "SMR2 Z")
KEYS = {"point": {"unit": "in", "SMR1": {"columns": [*FIRST]}, "SMR2": {"columns": [*SECOND]}}}


@pytest.fixture
def table():
    cells = np.arange(48.0).reshape(12, 4)
    names = [*(f"A{k}" for k in range(1, 7)), *FIRST, *SECOND]
    columns = dict(zip(names, cells))
    for name in SECOND:
        columns[name] = np.where(np.arange(4) == 1, np.nan, columns[name])
    return RawTable("wide.csv", columns, np.arange(2, 6))


def test_the_question_names_the_reflectors(table):
    with pytest.raises(InputError, match=r'several reflectors .* \[point\.SMR2\] columns = \["SM'):
        propose(table)


@pytest.mark.parametrize("names", [FIRST, SECOND])
def test_a_stated_set_settles_the_question(table, names):
    proposal = propose(table, stated=Mapping(point=Group(names)))
    assert proposal.mapping.point.columns == names
    assert set(proposal.unused) == {*FIRST, *SECOND} - {*names}


def test_reflectors_become_rows_of_one_pose(table):
    mapping = mapping_from_keys(KEYS, "map.toml")
    made = stacked(table, mapping)
    assert made.columns["reflector"].tolist() == [
        "SMR1", "SMR2", "SMR1", "SMR1", "SMR2", "SMR1", "SMR2"
    ]  # fmt: skip
    assert made.columns["pose"].tolist() == [1, 1, 2, 3, 3, 4, 4]
    assert made.lines.tolist() == [2, 2, 3, 4, 4, 5, 5]
    assert made.columns["SMR1 Y"][:2].tolist() == [
        table.columns[n][0] for n in (FIRST[1], SECOND[1])
    ]
    assert made.columns["A3"][3] == made.columns["A3"][4] == table.columns["A3"][2]
    assert "SMR2 in 3 of 4" in made.warnings[0]
    proposed = mapping.merged(propose(made, stated=mapping).mapping)
    assert proposed.columns == {"reflector": "reflector", "pose": "pose"}
    assert not set(made.columns) & {*SECOND}


def test_the_mapping_is_written_as_it_is_read():
    mapping = mapping_from_keys(KEYS, "map.toml")
    assert mapping.as_keys()["point"] == KEYS["point"]
    assert mapping_from_keys(mapping.as_keys(), "map.toml") == mapping


@pytest.mark.parametrize(
    "point", [{**KEYS["point"], "columns": [*FIRST]}, {"SMR1": {"columns": ["X"]}}]
)
def test_reflectors_that_contradict_each_other_are_refused(point):
    with pytest.raises(InputError, match=r"point\.SMR1"):
        mapping_from_keys({"point": point}, "map.toml")
