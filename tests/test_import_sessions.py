"""Import of several tables with the same columns as one recording."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.mapping.model import read_mapping
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

NAMES = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]
HALF = 18


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("truth"), SCENE)


def write_day(path, truth, rows, joints=1.0, points=1.0, more=None):
    """A table of some rows; joints, points: factors. more: header -> cells (n,) of all rows."""
    cells = {f"J{k + 1}": joints * degrees(truth)[rows, k] for k in range(6)}
    cells |= {axis: points * truth.points[rows, k] for k, axis in enumerate("XYZ")}
    for name, values in (more or {}).items():
        cells[name] = values[rows]
    return write_rows(path, list(cells), list(zip(*cells.values())))


@pytest.mark.parametrize("joints, points", [(1.0, 1.0), (np.pi / 180, 0.001), (1 / 0.9, 1 / 25.4)])
def test_two_days_become_one_recording(truth, tmp_path, joints, points):
    first = write_day(tmp_path / "monday.csv", truth, slice(0, HALF))
    second = write_day(tmp_path / "tuesday.csv", truth, slice(HALF, None), joints, points)
    made = import_recording([first, second], tmp_path / "made", UR10)
    assert_same_rows(made.recording, truth)
    assert made.recording.columns["session"].tolist() == [1.0] * HALF + [2.0] * (truth.n - HALF)
    said = " ".join(made.warnings)
    assert "session 2: samples 19 to 36 of tuesday.csv" in said
    assert ("differ in their units" in said) == (joints != 1.0)
    assert ("J1 ... J6 in radians, X, Y, Z in metres" in said) == (points == 0.001)


def test_the_mapping_repeats_the_import_and_imports_one_table(truth, tmp_path):
    days = [
        write_day(tmp_path / "monday.csv", truth, slice(0, HALF)),
        write_day(tmp_path / "tuesday.csv", truth, slice(HALF, None), np.pi / 180, 0.001),
    ]
    import_recording(days, tmp_path / "made", UR10)
    mapping = read_mapping(tmp_path / "made" / "import.toml")
    assert mapping.join.by == "append"
    again = import_recording(days, tmp_path / "again", ImportOptions(mapping=mapping))
    assert_same_rows(again.recording, truth)
    alone = import_recording(days[1:], tmp_path / "alone", ImportOptions(mapping=mapping))
    assert alone.recording.n == truth.n - HALF


def test_a_short_table_has_the_units_of_the_largest(truth, tmp_path):
    first = write_day(tmp_path / "monday.csv", truth, slice(0, 30))
    second = write_day(tmp_path / "short.csv", truth, slice(30, None))
    made = import_recording([second, first], tmp_path / "made", UR10)
    assert np.allclose(made.recording.points[:6], truth.points[30:], atol=1e-3)


def test_other_units_in_a_short_table_are_refused(truth, tmp_path):
    first = write_day(tmp_path / "monday.csv", truth, slice(0, 30))
    second = write_day(tmp_path / "short.csv", truth, slice(30, None), points=0.001)
    with pytest.raises(InputError, match="metres in rows 2 to 7 of short.csv"):
        import_recording([first, second], tmp_path / "made", UR10)


def test_tables_of_two_set_ups_are_refused(truth, tmp_path):
    first = write_day(tmp_path / "monday.csv", truth, slice(0, HALF))
    moved = Rotation.from_euler("z", 25, degrees=True).apply(truth.points) + [100.0, 50.0, 0.0]
    rows = np.column_stack([degrees(truth), moved])[HALF:]
    second = write_rows(tmp_path / "tuesday.csv", NAMES, rows)
    with pytest.raises(
        InputError, match="rows 2 to 19 of tuesday.csv fit the robot each by itself"
    ):
        import_recording([first, second], tmp_path / "made", UR10)


def test_groups_times_and_units_of_covariates(truth, tmp_path):
    rows = np.arange(truth.n)
    load = {"pose": rows % HALF, "time [s]": 2.0 * (rows % HALF), "payload [kg]": 1.0 + rows % 3}
    first = write_day(tmp_path / "monday.csv", truth, slice(0, HALF), more=load)
    load["payload [g]"] = 1000 * load.pop("payload [kg]")
    second = write_day(tmp_path / "tuesday.csv", truth, slice(HALF, None), more=load)
    made = import_recording([first, second], tmp_path / "made", UR10)
    columns = made.recording.columns
    assert len(set(columns["pose"])) == truth.n
    assert columns["payload_kg"].tolist() == (1.0 + rows % 3).tolist()
    assert "time_s" not in columns
    assert any("overlap" in said for said in made.warnings)


def test_times_that_follow_each_other_are_kept(truth, tmp_path):
    stamps = np.array(
        [f"2026-09-{14 + k // HALF:02d} 08:00:{k % HALF:02d}" for k in range(truth.n)]
    )
    first = write_day(tmp_path / "monday.csv", truth, slice(0, HALF), more={"Time": stamps})
    second = write_day(tmp_path / "tuesday.csv", truth, slice(HALF, None), more={"Time": stamps})
    made = import_recording([first, second], tmp_path / "made", UR10)
    times = made.recording.columns["time_s"]
    assert times[0] == 0
    assert times[HALF] == 86400


def test_append_needs_tables_with_the_same_columns(truth, tmp_path):
    first = write_day(tmp_path / "monday.csv", truth, slice(0, HALF))
    second = write_rows(tmp_path / "tracker.csv", NAMES[6:], truth.points)
    mapping = tmp_path / "map.toml"
    mapping.write_text('format = "import/1"\nrobot = "ur10"\n[join]\nby = "append"\n')
    options = ImportOptions(mapping=read_mapping(mapping))
    with pytest.raises(InputError, match="expected several tables with the same columns"):
        import_recording([first, second], tmp_path / "made", options)
