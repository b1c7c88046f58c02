"""Joint readings as counts of the encoders: recognised and named, and converted where the mapping states their size."""

import re

import numpy as np
import pytest

from datasets.importers.mapping.model import read_mapping
from datasets.recording_files.schemas import mapping_schema
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

SIZES = np.array([1500.5, -2210.25, 1801.0, -990.75, 1204.0, 655.5])
"""Counts in one degree; two joints are counted the other way round."""


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def counts(truth) -> np.ndarray:
    return np.round(degrees(truth) * SIZES)


def table(path, truth, names=tuple("SLURBT")):
    cells = np.column_stack([counts(truth), truth.points])
    return write_rows(path, [*names, "X", "Y", "Z"], cells)


def job(path, truth, names="C{:05d}"):
    rows = [",".join(f"{v:.0f}" for v in row) for row in counts(truth)]
    lines = [f"{names.format(k)}={row}" for k, row in enumerate(rows)]
    head = ["/JOB", "//NAME PROBE", "//POS", "///TOOL 0", "///POSTYPE PULSE", "///PULSE"]
    path.write_text("\r\n".join([*head, *lines, "//INST", "NOP", "MOVJ C00000 VJ=5.00", "END"]))
    return path


def mapping_file(path, names=tuple("SLURBT"), sizes=tuple(SIZES)):
    columns = ", ".join(f'"{name}"' for name in names)
    path.write_text(
        f'format = "import/1"\n[joints]\ncolumns = [{columns}]\n'
        f"counts_per_deg = [{', '.join(map(str, sizes))}]\n"
    )
    return read_mapping(path)


@pytest.mark.parametrize("names", [tuple("SLURBT"), tuple(f"J{k} [pulse]" for k in range(1, 7))])
def test_counts_are_named_with_the_lines_that_the_mapping_needs(names, truth, tmp_path):
    path = table(tmp_path / "t.csv", truth, names)
    with pytest.raises(InputError, match="pulses of the encoders, whole numbers up to") as refusal:
        import_recording([path], tmp_path / "out", UR10)
    lines = "columns = [" + ", ".join(f'"{name}"' for name in names) + "] and counts_per_deg = ["
    assert re.search(re.escape(lines), str(refusal.value))


@pytest.mark.parametrize("names", [tuple("SLURBT"), tuple(f"J{k} [pulse]" for k in range(1, 7))])
def test_the_mapping_states_the_counts_of_a_degree(names, truth, tmp_path):
    path = table(tmp_path / "t.csv", truth, names)
    options = ImportOptions(robot="ur10", mapping=mapping_file(tmp_path / "map.toml", names))
    made = import_recording([path], tmp_path / "out", options)
    assert_same_rows(made.recording, truth, joints=1e-3)
    assert "time_s" not in made.recording.columns  # T is a joint
    again = ImportOptions(mapping=read_mapping(tmp_path / "out" / "import.toml"))
    repeated = import_recording([path], tmp_path / "again", again)
    np.testing.assert_array_equal(repeated.recording.joints, made.recording.joints)


def test_a_job_of_the_controller_next_to_a_tracker_table(truth, tmp_path):
    path = job(tmp_path / "PROBE.JBI", truth)
    rows = [[f"C{k:05d}", *point] for k, point in enumerate(truth.points)]
    points = write_rows(tmp_path / "tracker.csv", ["Name", "X", "Y", "Z"], rows[::-1])
    with pytest.raises(InputError, match="PROBE.JBI.*pulses of the encoders"):
        import_recording([path, points], tmp_path / "out", UR10)
    options = ImportOptions(robot="ur10", mapping=mapping_file(tmp_path / "map.toml"))
    made = import_recording([path, points], tmp_path / "out", options)
    assert_same_rows(made.recording, truth, joints=1e-3)


def test_whole_degrees_and_stated_units_are_no_counts(truth, tmp_path):
    seconds = np.round(degrees(truth) * 3600)  # arc seconds, up to 10^6, and whole
    names = [*(f"J{k} [arcsec]" for k in range(1, 7)), "X", "Y", "Z"]
    path = write_rows(tmp_path / "t.csv", names, np.column_stack([seconds, truth.points]))
    made = import_recording([path], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth, joints=1e-3)


@pytest.mark.parametrize(
    "line, words",
    [
        ("counts_per_deg = [1, 2]", "expected one number, or 6 numbers"),
        ("counts_per_deg = [1, 2, 3, 4, 5, 0]", "none of them 0"),
        ('counts_per_deg = 10\nunit = "deg"', "no unit next to counts_per_deg"),
        ('counts_per_deg = "many"', "expected one number"),
    ],
)
def test_counts_that_cannot_be_are_refused(line, words, tmp_path):
    columns = ", ".join(f'"{name}"' for name in "SLURBT")
    path = tmp_path / "map.toml"
    path.write_text(f'format = "import/1"\n[joints]\ncolumns = [{columns}]\n{line}\n')
    with pytest.raises(InputError, match=words):
        read_mapping(path)


def test_counts_belong_to_joints_alone(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text('format = "import/1"\n[point]\ncolumns = ["X", "Y", "Z"]\ncounts_per_deg = 5\n')
    with pytest.raises(InputError, match="key counts_per_deg: expected columns, unit"):
        read_mapping(path)
    groups = mapping_schema()["properties"]
    assert "counts_per_deg" in groups["joints"]["properties"]
    assert "counts_per_deg" not in groups["point"]["properties"]
