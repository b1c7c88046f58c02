"""Rows of a pose table at which unit or rotation convention change, found on board poses without any images."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.mapping.proposal import propose
from datasets.importers.source import RawTable
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, transform
from workbench.recordings.importing.board_images.board_poses import _pose_readings
from workbench.recordings.importing.board_images.pose_readings import flange_readings
from workbench.recordings.importing.board_images.reading_fits import BoardViews
from workbench.recordings.importing.segments.pose_segments import refuse_changed_poses

COUNT = 20
HEADERS = ("X", "Y", "Z", "A", "B", "C")


@pytest.fixture(scope="module")
def scene():
    """Flange poses (n, 4, 4) over a board, and board poses (n, 4, 4) in a camera on the flange, both with noise."""
    rng = np.random.default_rng(8)
    tilt = Rotation.from_euler("xyz", rng.uniform(-35, 35, (COUNT, 3)), degrees=True)
    turns = tilt * Rotation.from_euler("x", 180, degrees=True)
    places = np.array([550.0, 60.0, 350.0]) + rng.uniform(-80, 80, (COUNT, 3))
    flange = transform(turns.as_matrix(), places)
    sensor = transform(np.eye(3), np.array([35.0, -20.0, 90.0]))
    board = transform(np.eye(3), np.array([500.0, 0.0, 0.0]))
    seen = inverse(flange @ sensor) @ board
    seen[:, :3, 3] += 0.2 * rng.normal(size=(COUNT, 3))
    return flange, seen


def table_of(flange, changed=slice(0, 0), scale=1.0, sequence="ZYX", unit=1.0) -> RawTable:
    """The poses as a table, some of its rows in another unit of length, order of angles or unit of angles."""
    angles = Rotation.from_matrix(flange[:, :3, :3]).as_euler("ZYX", degrees=True)
    cells = np.column_stack([flange[:, :3, 3], angles])
    turns = Rotation.from_matrix(flange[changed, :3, :3]) if changed != slice(0, 0) else None
    if turns is not None:
        cells[changed, :3] *= scale
        cells[changed, 3:] = unit * turns.as_euler(sequence, degrees=True)
    return RawTable("poses.csv", dict(zip(HEADERS, cells.T)), np.arange(2, COUNT + 2))


def check(table, seen) -> None:
    mapping = propose(table, has_images=True).mapping
    views = BoardViews(seen[None], np.arange(COUNT))
    readings = flange_readings(table, mapping)
    refuse_changed_poses(_pose_readings(readings, views, "in-hand"), table)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"scale": 0.001}, "columns X, Y, Z: .*found mm in rows 2 to 13 and m in rows 14 to 21"),
        ({"unit": np.pi / 180}, "intrinsic ZYX in deg in rows 2 to 13 and intrinsic ZYX in rad in"),
        ({"sequence": "XYZ"}, "intrinsic ZYX in deg in rows 2 to 13 and intrinsic XYZ in deg in"),
    ],
)
def test_the_rows_of_a_change_are_named(change, reason, scene):
    flange, seen = scene
    table = table_of(flange, slice(12, None), **change)
    with pytest.raises(InputError, match=reason):
        check(table, seen)


def test_equal_readings_and_a_single_wrong_row_are_no_change(scene):
    flange, seen = scene
    check(table_of(flange), seen)
    check(table_of(flange, slice(7, 8), scale=0.001), seen)
