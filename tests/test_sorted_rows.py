"""Rows that are sorted by a joint reading are no clock; the diagnosis warns of it."""

from dataclasses import replace

import numpy as np
import pytest

from scenes import scene
from workbench.diagnosis.robot.bench import bench_of


def in_order(by: str | None, with_time: bool = False):
    """A recording whose rows are sorted by a column; without time where not `with_time`."""
    recording = scene("external-point", n=80).recording
    columns = recording.columns
    order = np.arange(80) if by is None else np.argsort(columns[by])[::-1]
    rows = {name: values[order] for name, values in columns.items() if name != "time_s"}
    rows["sample"] = columns["sample"]
    return replace(recording, columns=rows | ({"time_s": columns["time_s"]} if with_time else {}))


@pytest.mark.parametrize(
    ("by", "with_time", "warns"),
    [("q4_deg", False, True), ("q4_deg", True, False), (None, False, False)],
)
def test_rows_that_are_sorted_by_a_joint_raise_a_warning(by, with_time, warns):
    said = [w for w in bench_of(in_order(by, with_time)).warnings if "sorted" in w]
    assert bool(said) == warns
    assert not said or "joint 4" in said[0]
