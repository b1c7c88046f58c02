"""Parameters: free and fixed by pattern, packed and unpacked, TOML both ways, sentences for mistakes."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workbench.core.errors import InputError
from workbench.core.parameters import Parameter, Parameters

TABLE = (
    Parameter("base.x", "mm", 0.0, 100.0, "base translation along x"),
    Parameter("joint-2.a2", "mm", 270.0, 1.0, "joint 2's length (a)", 3.0),
    Parameter("joint-2.alpha2", "rad", 0.0, 0.01, "joint 2's twist (alpha)", 0.03),
    Parameter("joint-3.backlash.half_gap", "rad", 0.0, 1e-3),
)


@pytest.fixture
def parameters():
    return Parameters.of(TABLE)


def test_they_start_at_their_nulls_and_fixed(parameters):
    assert parameters.values.tolist() == [0, 270, 0, 0]
    assert not parameters.mask.any() and parameters.pack().size == 0
    assert parameters.keys == tuple(p.key for p in TABLE) and len(parameters) == 4
    assert parameters.typical.tolist() == [100, 1, 0.01, 1e-3]
    np.testing.assert_allclose(parameters.precision, [0, 1 / 9, 1 / 0.0009, 0])


def test_patterns_free_and_fix(parameters):
    free = parameters.free("joint-2.*", "*.half_gap").fix("*.alpha2")
    assert free.mask.tolist() == [False, True, False, True]
    assert not parameters.mask.any()  # the first is as it was
    assert parameters.only([True, False, False, False]).mask.tolist() == [True, False, False, False]


def test_a_pattern_that_matches_nothing_is_a_sentence(parameters):
    for act in (parameters.free, parameters.fix, parameters.matching):
        with pytest.raises(
            InputError, match=r"no parameter matches 'joint-9\.\*': the model has base\.x"
        ):
            act("base.*", "joint-9.*")


def test_unpack_puts_back_what_pack_took(parameters):
    free = parameters.free("joint-2.*")
    moved = free.unpack(free.pack() + [1.5, -0.2])
    assert moved.values.tolist() == [0, 271.5, -0.2, 0]
    assert free.values.tolist() == [0, 270, 0, 0]
    assert moved["joint-2.a2"] == 271.5


def test_update_sets_by_key(parameters):
    assert parameters.update({"base.x": 7.0})["base.x"] == 7
    with pytest.raises(KeyError, match="base.y"):
        parameters.update({"base.y": 7.0})


def test_take_over_copies_what_both_have(parameters):
    other = Parameters.of(TABLE[1:3]).update({"joint-2.a2": 271.0}).free("*.alpha2")
    taken = parameters.free("base.x").take_over(other)
    assert taken.values.tolist() == [0, 271, 0, 0]
    assert taken.mask.tolist() == [True, False, True, False]


def test_two_of_one_name_are_a_sentence():
    with pytest.raises(InputError, match="two parameters are called base.x"):
        Parameters.of([TABLE[0], TABLE[1], TABLE[0]])


numbers = st.floats(allow_nan=False, allow_infinity=False)


@given(
    values=st.lists(numbers, min_size=4, max_size=4),
    mask=st.lists(st.booleans(), min_size=4, max_size=4),
)
def test_toml_brings_back_every_bit(values, mask):
    start = Parameters.of(TABLE)
    written = replace(start, values=np.array(values), mask=np.array(mask))
    rows = tomllib.loads(written.to_toml())["parameters"]
    assert list(rows) == list(start.keys)
    assert [row["value"] for row in rows.values()] == written.values.tolist()
    assert [row["free"] for row in rows.values()] == written.mask.tolist()
    assert [row["unit"] for row in rows.values()] == [p.unit for p in start.table]
