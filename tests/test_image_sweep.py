"""The direction of a mirror's sweep follows from the order and the angles of the images."""

import numpy as np

from datasets.recording_files.rows import Rows
from workbench.files.images.columns import recorded_columns
from workbench.files.images.sweep import with_sweep


def rows(**more):
    """Board pose a swept up, b down, c with one image, listed out of order."""
    made = {
        "placement": np.array(["b", "a", "a", "b", "a", "b", "c"]),
        "mirror_deg": np.array([1.0, 0.0, 1.0, 2.0, 2.0, 0.0, 5.0]),
        "time_s": np.array([11.0, 1.0, 2.0, 10.0, 3.0, 12.0, 20.0]),
    }
    return Rows.of(made | {name: np.asarray(values, float) for name, values in more.items()})


def test_the_sweep_is_the_change_of_the_angle_within_a_board_pose_and_of_its_first_image_that_to_the_next():
    found = with_sweep(rows(), "placement")
    assert [row["sweep"] for row in found] == [-1, 1, 1, -1, 1, -1, 0]
    assert "sweep" in recorded_columns(found)
    some = with_sweep(rows()[np.array([3, 0, 5])], "placement")
    assert [row["sweep"] for row in some] == [-1, -1, -1]


def test_a_recorded_sweep_stays_and_without_times_or_angles_there_is_none():
    recorded = with_sweep(rows(sweep=np.zeros(7)), "placement")
    assert [row["sweep"] for row in recorded] == [0] * 7
    for name in ("time_s", "mirror_deg"):
        columns = {key: value for key, value in rows().columns.items() if key != name}
        left = Rows(columns, rows().texts, frozenset(), np.arange(7))
        assert "sweep" not in with_sweep(left, "placement").columns
    gap = with_sweep(rows(time_s=[11, 1, 2, np.nan, 3, 12, 20]), "placement")
    assert "sweep" not in gap.columns
