"""Rows that are sorted by a joint reading are no clock; rows in the order of a measurement stay as they are."""

from dataclasses import replace

import numpy as np

from scenes import scene
from workbench.fitting.checked_samples import check_samples
from workbench.fitting.cross_validation import blocks
from workbench.fitting.row_order import sorting_joint, without_sorted_rows
from workbench.recordings.inspection.inspect import inspect_recording


def recorded(n=60, **columns):
    """Points of a nominal arm without times and labels of poses."""
    recording = scene(
        "external-point", n=n, seed=17, reflectors={1: (30.0, -40.0, 100.0)}
    ).recording
    kept = {k: v for k, v in recording.columns.items() if k != "time_s"}
    return replace(recording, columns={**kept, **columns})


def sorted_by(recording, name, sign=1):
    return recording.select(np.argsort(sign * recording.columns[name]))


def test_a_sorted_table_is_used_in_a_random_order():
    for sign in (1, -1):
        table = sorted_by(recorded(), "q4_deg", sign)
        assert sorting_joint(table) == "q4_deg"
        checked = check_samples(table)
        used = checked.recording
        (warning,) = [text for text in checked.warnings if "sorted by joint 4" in text]
        assert "is no clock" in warning and "time_s" in warning
        order = [list(table.sample_ids).index(k) for k in used.sample_ids]
        assert sorted(order) == list(range(table.n)) != order
        assert np.array_equal(used.points, table.points[order])
        fold = blocks(used.poses, 5)
        for k in range(5):  # no block is a range of joint 4
            assert np.ptp(used.columns["q4_deg"][fold == k]) > 0.5 * np.ptp(table.columns["q4_deg"])
        assert any(
            "sorted by joint 4" in text for text in inspect_recording(table).recording.warnings
        )


def test_several_reflectors_of_a_pose_stay_together():
    table = sorted_by(recorded(), "q4_deg")
    rows = np.repeat(np.arange(table.n), 3)
    several = table.select(rows)
    several = replace(
        several,
        columns={**several.columns, "sample": np.arange(len(rows)) + 1.0, "pose": rows + 1.0},
    )
    used = without_sorted_rows(several)
    assert len(used.warnings) == 1
    assert (used.columns["pose"].reshape(-1, 3) == used.columns["pose"][::3, None]).all()


def test_an_order_that_may_be_that_of_the_measurement_is_kept():
    random = recorded()
    assert without_sorted_rows(random) is random
    timed = sorted_by(recorded(time_s=10.0 * np.arange(60)), "q4_deg")
    assert sorting_joint(timed) is None
    steps = np.arange(60.0)
    sweep = recorded(q4_deg=steps, q2_deg=30 * np.sin(steps / 15), q3_deg=20 * np.cos(steps / 20))
    still = {f"q{k}_deg": np.zeros(60) for k in (1, 5, 6)}
    assert sorting_joint(replace(sweep, columns={**sweep.columns, **still})) is None
    grid = sorted_by(recorded(q1_deg=np.repeat(np.arange(6.0), 10)), "q1_deg")
    assert sorting_joint(grid) is None
