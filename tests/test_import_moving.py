"""Rows that were measured while the arm moved are counted where a log of joints is interpolated."""

import numpy as np
import pytest

from datasets.importers.mapping.joined_tables.interpolation import interpolated
from datasets.importers.mapping.joined_tables.joining import join_tables
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


def test_the_acceleration_is_followed_between_the_samples_of_a_log():
    """A move of the fifth order over 1.2 s, sampled every 20 ms: linear interpolation misses it by 0.3 mrad."""
    times = np.arange(0, 1.5, 0.02)
    wanted = np.arange(0.005, 1.45, 0.0173)

    def path(seconds):
        share = np.clip(seconds / 1.2, 0, 1)
        return 1.5 * (10 * share**3 - 15 * share**4 + 6 * share**5)

    linear = np.abs(np.interp(wanted, times, path(times)) - path(wanted)).max()
    cubic = np.abs(interpolated(times, path(times), wanted) - path(wanted)).max()
    assert linear > 2e-4 and cubic < 1.5e-5


def test_steps_do_not_overshoot_and_equal_times_are_allowed():
    times = np.array([0.0, 1.0, 1.0, 2.0, 3.0, 4.0])
    values = np.array([0.0, 0.0, 5.0, 5.0, 9.0, 9.0])
    wanted = np.linspace(-1, 5, 121)
    found = interpolated(times, values, wanted)
    assert np.isfinite(found).all() and found.min() == 0.0 and found.max() == 9.0
    np.testing.assert_array_equal(interpolated(times[2:], values[2:], times[2:]), values[2:])
    even = np.arange(5.0)
    between = np.linspace(0, 4, 41)
    np.testing.assert_allclose(interpolated(even, 2 * even, between), 2 * between)
