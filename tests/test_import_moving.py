"""Rows that were measured while the arm moved are counted where a log of joints is interpolated."""

import numpy as np
import pytest

from datasets.importers.mapping.joining import join_tables
from datasets.importers.mapping.model import Join
from datasets.importers.source import RawTable


def log_of(values):
    names = [f"J{k}" for k in range(1, 7)]
    columns = {"time": 0.1 * np.arange(len(values)), **{name: values.copy() for name in names}}
    return RawTable("log.csv", columns, np.arange(len(values)))


def measured_at(times):
    columns = {"time": np.array(times), **{axis: np.ones(len(times)) for axis in "XYZ"}}
    return RawTable("tracker.csv", columns, np.arange(len(times)))


@pytest.mark.parametrize("times, moving", [((0.51, 1.02, 3.03, 3.54), 0), ((0.51, 2.02, 3.03), 1)])
def test_rows_between_two_stations_are_counted(times, moving):
    """The joints rest at 0 until 1.8 s, move, and rest at 30 deg from 2.2 s on, with noise of the encoder."""
    values = np.interp(0.1 * np.arange(40), [1.8, 2.2], [0.0, 30.0])
    values += 1e-3 * np.random.default_rng(1).normal(size=40)
    joined, _, warnings = join_tables([measured_at(times), log_of(values)], Join())
    assert joined.n == len(times)
    found = [text for text in warnings if "joints of log.csv moved" in text]
    assert len(found) == bool(moving)
    assert not moving or f"{moving} of {len(times)} rows" in found[0]
