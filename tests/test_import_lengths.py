"""Tables of lengths between two poses of an arm, such as those of a ball bar or a laser tracer."""

import numpy as np
import pytest

from import_scenes import degrees, pose_scene, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

SCENE = pose_scene("ur5", 120, 6, "share_of_limits = 0.5")
JOINTS = [f"Achse {k} [deg]" for k in range(1, 7)]
OPTIONS = ImportOptions(robot="ur5", sigma_mm=0.03)


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("lengths"), SCENE)


def lengths_of(truth) -> np.ndarray:
    """(n,) mm between each measured point and the next one, for every second row."""
    points = truth.points
    return np.linalg.norm(points[1::2] - points[::2], axis=1)


def rows_of(truth, unit=1.0):
    """Number of the length, length, joint readings: two rows for each length."""
    lengths = np.repeat(lengths_of(truth), 2)
    return [
        [k // 2 + 1, length * unit, *readings]
        for k, (length, readings) in enumerate(zip(lengths.round(6), degrees(truth)))
    ]


@pytest.mark.parametrize(("header", "unit"), [("Laenge [mm]", 1.0), ("bar length [in]", 1 / 25.4)])
def test_two_rows_with_one_length_and_one_number_are_a_pair(header, unit, truth, tmp_path):
    table = write_rows(tmp_path / "bar.csv", ["Messung", header, *JOINTS], rows_of(truth, unit))
    made = import_recording([table], tmp_path / "made", OPTIONS)
    assert made.recording.measures == "distance"
    np.testing.assert_allclose(
        made.recording.columns["length_mm"][::2], lengths_of(truth), atol=1e-4
    )
    assert (made.recording.columns["pair"] == np.repeat(np.arange(1, 61), 2)).all()
    assert not any("too few" in said for said in made.warnings)


def test_lengths_that_do_not_belong_to_the_readings_are_refused(truth, tmp_path):
    rows = rows_of(truth)
    lengths = np.roll([row[1] for row in rows], 10)
    wrong = [[row[0], length, *row[2:]] for row, length in zip(rows, lengths)]
    table = write_rows(tmp_path / "bar.csv", ["Messung", "Laenge [mm]", *JOINTS], wrong)
    with pytest.raises(InputError, match="repeat with --trust-data"):
        import_recording([table], tmp_path / "made", OPTIONS)


def test_a_length_without_a_pair_names_the_form_that_is_read(truth, tmp_path):
    wide = [[n, row[1], *row[2:]] for n, row in enumerate(rows_of(truth)[::2], 1)]
    table = write_rows(tmp_path / "bar.csv", ["Nr", "Laenge [mm]", *JOINTS], wide)
    with pytest.raises(
        InputError, match='with one number in a column pair, as measures = "distance"'
    ):
        import_recording([table], tmp_path / "made", OPTIONS)


@pytest.mark.parametrize("names", ["A{k} start,A{k} end", "q{k}_a,q{k}_b"])
def test_one_row_for_each_length_becomes_two(names, truth, tmp_path):
    header = [name.format(k=k) for name in names.split(",") for k in range(1, 7)]
    readings = degrees(truth)
    cells = np.column_stack([readings[::2], readings[1::2], lengths_of(truth)])
    table = write_rows(tmp_path / "bar.csv", [*header, "Length [mm]"], cells)
    made = import_recording([table], tmp_path / "made", OPTIONS)
    assert made.recording.measures == "distance"
    assert made.mapping.joints.unit == "deg"
    assert np.allclose(np.rad2deg(made.recording.joints), readings, atol=1e-6)
    assert (made.recording.columns["pair"] == np.repeat(np.arange(1, 61), 2)).all()
