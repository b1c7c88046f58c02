"""Tables that belong together although their headers, names or clocks do not say so in the usual way."""

import numpy as np
import pytest

from datasets.importers.mapping.model import read_mapping
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

JOINTS = [f"J{k}" for k in range(1, 7)]
POINT = ["X", "Y", "Z"]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def write_pair(folder, truth, header, names, others, order=slice(None)):
    """A joint table and a tracker table with names of the rows in a column of one header."""
    joints = [(name, *row) for name, row in zip(names, degrees(truth))]
    points = [(name, *row) for name, row in zip(others, truth.points)]
    first = write_rows(folder / "joints.csv", [header, *JOINTS], joints)
    return [first, write_rows(folder / "tracker.csv", [header, *POINT], points[order])]


def stops(truth, step_s: float = 5.0):
    """s and deg of a log of 10 Hz in which the arm waits at each pose, and s of the measurements."""
    measured = step_s * np.arange(truth.n) + 2.0
    seconds = np.arange(0.0, measured[-1] + 3.0, 0.1)
    knots = np.ravel([measured - 1.0, measured + 1.0], order="F")
    waits = np.repeat(degrees(truth), 2, axis=0)
    log = np.stack([np.interp(seconds, knots, column) for column in waits.T], axis=1)
    return seconds, log, measured


@pytest.mark.parametrize(
    ("header", "first", "second"),
    [
        ("Punktkennung", "{}", "{}"),
        ("Point", "P{:03d}", "{}"),
        ("Point", "P{}", "p_{:04d}"),
        ("Point", "P{:03d}", "A::UR poses::P{:03d}"),
        ("Point", "P{}", "A::UR poses::p_{:04d}"),
    ],
)
def test_rows_are_matched_by_their_names(header, first, second, truth, tmp_path):
    names, others = ([form.format(k + 1) for k in range(truth.n)] for form in (first, second))
    sources = write_pair(tmp_path, truth, header, names, others, slice(None, 3, -1))
    made = import_recording(sources, tmp_path / "out", UR10)
    assert made.mapping.join.by == "key"
    assert_same_rows(made.recording, truth.select(np.arange(truth.n)[:3:-1]))


def test_names_with_groups_are_matched_where_all_rows_have_one(truth, tmp_path):
    """As many points as poses, in another order: the row number would join wrong rows."""
    names, others = ([f"{front}P{k:03d}" for k in range(truth.n)] for front in ("", "A::Poses::"))
    sources = write_pair(tmp_path, truth, "Point", names, others, slice(None, None, -1))
    made = import_recording(sources, tmp_path / "out", UR10)
    assert made.mapping.join.by == "key"
    assert_same_rows(made.recording, truth)


def test_tables_with_names_that_differ_say_that_the_row_number_joins_them(truth, tmp_path):
    names, others = ([f"P{first + k}" for k in range(truth.n)] for first in (1, 501))
    sources = write_pair(tmp_path, truth, "Point", names, others)
    made = import_recording(sources, tmp_path / "out", UR10)
    assert made.mapping.join.by == "index"
    (said,) = [text for text in made.warnings if "joined by row number" in text]
    assert "'P1'" in said and "'P501'" in said


def test_names_that_differ_are_quoted_where_they_prevent_a_join(truth, tmp_path):
    names, others = ([f"P{first + k}" for k in range(truth.n)] for first in (1, 501))
    sources = write_pair(tmp_path, truth, "Point", names, others, slice(None, -3))
    with pytest.raises(InputError, match="names differ .*'P501'.*'P1'"):
        import_recording(sources, tmp_path / "out", UR10)


def test_a_mapping_names_the_times_of_a_join(truth, tmp_path):
    seconds, log, measured = stops(truth)
    first = write_rows(tmp_path / "log.csv", ["czas_s", *JOINTS], np.column_stack([seconds, log]))
    rows = np.column_stack([measured, truth.points])
    second = write_rows(tmp_path / "tracker.csv", ["chwila", *POINT], rows)
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        'format = "import/1"\nrobot = "ur10"\n[join]\nby = "time"\n'
        '[columns]\n"czas_s" = "time_s"\n"chwila" = "time_s"\n'
    )
    options = ImportOptions(mapping=read_mapping(mapping))
    made = import_recording([first, second], tmp_path / "out", options)
    assert_same_rows(made.recording, truth, joints=1e-3)
    assert np.allclose(np.diff(made.recording.columns["time_s"]), 5.0)


def test_a_clock_without_a_date_takes_that_of_the_other(truth, tmp_path):
    seconds, log, measured = stops(truth)

    def clock(second: float) -> str:
        return f"{9 + int(second // 3600):02d}:{int(second // 60) % 60:02d}:{second % 60:06.3f}"

    rows = [(clock(second), *row) for second, row in zip(seconds, log)]
    first = write_rows(tmp_path / "log.csv", ["Time", *JOINTS], rows)
    rows = [(f"2026-11-24T{clock(second)}", *row) for second, row in zip(measured, truth.points)]
    second = write_rows(tmp_path / "tracker.csv", ["Time", *POINT], rows)
    made = import_recording([first, second], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth, joints=1e-3)
    assert any("Only one of the clocks" in said for said in made.warnings)


def test_a_table_without_known_headers_is_named_where_its_columns_are_missing(truth, tmp_path):
    header = [f"f{k}" for k in range(1, 7)]
    first = write_rows(tmp_path / "osie.csv", header, degrees(truth)[:20])
    second = write_rows(tmp_path / "tracker.csv", POINT, truth.points)
    with pytest.raises(InputError, match="not read: osie.csv"):
        import_recording([first, second], tmp_path / "out", UR10)
    shuffled = np.random.default_rng(1).permutation(
        degrees(truth)
    )  # rows that do not fit the points
    first = write_rows(tmp_path / "osie.csv", header, shuffled)
    with pytest.raises(InputError, match="osie.csv . tracker.csv: .* found f1, f2") as refused:
        import_recording([first, second], tmp_path / "out", UR10)
    assert 'columns = ["f1", "f2", "f3", "f4", "f5", "f6"]' in refused.value.example


def test_pairs_of_joint_and_tracker_tables_become_one_recording(truth, tmp_path):
    half = truth.n // 2
    sources = []
    for name, rows in (("tue", slice(half, None)), ("mon", slice(0, half))):
        sources.append(write_rows(tmp_path / f"{name}_tracker.csv", POINT, truth.points[rows]))
    for name, rows in (("mon", slice(0, half)), ("tue", slice(half, None))):
        sources.append(write_rows(tmp_path / f"{name}_joints.csv", JOINTS, degrees(truth)[rows]))
    made = import_recording(sources, tmp_path / "out", UR10)
    order = np.r_[half : truth.n, 0:half]
    assert_same_rows(made.recording, truth.select(order))
    assert made.recording.columns["session"].tolist() == [1.0] * half + [2.0] * half
    assert made.mapping.join.by == "append"


def stop_log(truth, folder, header: str, delays_s):
    """A log with one row for each pose every 24 s, and a tracker table some seconds later, with foreign headers."""
    at = 24.0 * np.arange(truth.n)
    rows = [(clock_text(t), *q) for t, q in zip(at, degrees(truth))]
    first = write_rows(folder / "log.csv", [header, *JOINTS], rows)
    points = [
        (f"SMR_{k + 40}", *p, clock_text(t))
        for k, (t, p) in enumerate(zip(at + delays_s, truth.points))
    ]
    second = write_rows(folder / "tracker.csv", ["Cible", *POINT, "Moment du tir"], points[3:])
    return [first, second]


def clock_text(second: float) -> str:
    return (
        f"2026-11-24 {9 + int(second // 3600):02d}:{int(second // 60) % 60:02d}:{second % 60:06.3f}"
    )


def test_rows_of_a_log_of_stops_are_not_interpolated(truth, tmp_path):
    delays = np.random.default_rng(3).uniform(2.0, 8.0, truth.n)
    sources = stop_log(truth, tmp_path, "Zaznamenano v", delays)
    made = import_recording(sources, tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth.select(np.arange(3, truth.n)))
    assert not any(name.startswith("qdot") for name in made.recording.columns)
    assert "taken for stops" in " ".join(made.warnings) and not made.suspicions
    assert made.clocks.estimate is None and "half their interval (12 s)" in made.clocks.sentence


def test_stops_that_lie_between_two_rows_are_counted(truth, tmp_path):
    delays = np.full(truth.n, 4.0)
    delays[[5, 9]] = 11.0
    made = import_recording(stop_log(truth, tmp_path, "time", delays), tmp_path / "out", UR10)
    assert f"2 of {truth.n - 3} rows lie about as near to a second stop" in " ".join(made.warnings)


def test_numbers_of_rows_match_names_of_points_where_nothing_else_does(truth, tmp_path):
    joints = [(k + 1, *row) for k, row in enumerate(degrees(truth))]
    points = [(f"P{k + 1:03d}", *row) for k, row in enumerate(truth.points)][:4:-1]
    first = write_rows(tmp_path / "joints.csv", ["Lp.", *JOINTS], joints)
    second = write_rows(tmp_path / "tracker.csv", ["Punkt", *POINT], points)
    made = import_recording([first, second], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth.select(np.arange(truth.n)[:4:-1]))


def test_groups_of_several_reflectors_belong_to_the_pose_of_one_name(truth, tmp_path):
    """Two reflectors for each pose, some of them not seen: as many rows as poses in neither table."""
    joints = [(f"P{k:02d}", *row) for k, row in enumerate(degrees(truth), 1)]
    seen = [k for k in range(truth.n) if k % 5]
    points = [(f"P{k + 1:02d}", 1, *truth.points[k]) for k in seen for _ in range(1 + k % 2)]
    log = write_rows(tmp_path / "log.csv", ["POSE", *JOINTS], joints)
    tracker = write_rows(tmp_path / "tracker.csv", ["Group", "Station", *POINT], points)
    made = import_recording([log, tracker], tmp_path / "out", UR10)
    rows = [k for k in seen for _ in range(1 + k % 2)]
    assert made.recording.n == len(rows)
    assert np.allclose(made.recording.points, truth.points[rows], atol=1e-6)
    assert np.allclose(np.rad2deg(made.recording.joints), degrees(truth)[rows])
    assert any("one name in 'Group' belong to one row of log.csv" in text for text in made.warnings)
