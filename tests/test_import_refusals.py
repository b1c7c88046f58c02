"""What the import refuses or asks about, and that nothing is written then."""

import os

import numpy as np
import pytest

from datasets.importers.mapping.columns import headers
from datasets.importers.mapping.model import read_mapping
from datasets.importers.sources.tables.text_tables import is_number_text, read_text_table
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, tracker, write_rows
from import_tables import nearly_one_orientation
from workbench.commands.cli import run
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def test_orientations_that_hardly_change_lead_to_a_question(tmp_path):
    joints, points, turns = nearly_one_orientation(0.1)
    angles = turns.as_euler("ZXZ", degrees=True)
    header = [*(f"J{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]", "E1", "E2", "E3"]
    path = write_rows(tmp_path / "t.csv", header, np.column_stack([joints, points, angles]))
    with pytest.raises(InputError, match="fit about equally well.*--map"):
        import_recording([path], tmp_path / "out", UR10)
    assert not (tmp_path / "out").exists()
    asked = []

    def ask(question):
        asked.append(question)
        return len(question.options) - 1

    made = import_recording([path], tmp_path / "out", ImportOptions(robot="ur10", ask=ask))
    (question,) = asked
    assert made.mapping.rotation.convention in question.options[-1]


def test_too_few_rows_for_a_test_are_refused(truth, tmp_path):
    few = truth.select(np.arange(3))
    header = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]
    path = write_rows(tmp_path / "t.csv", header, np.column_stack([degrees(few), few.points]))
    with pytest.raises(InputError, match="--map"):
        import_recording([path], tmp_path / "out", UR10)


def test_a_stated_unit_that_is_wrong_is_refused(truth, tmp_path):
    header = [*(f"J{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"]
    path = write_rows(
        tmp_path / "t.csv", header, np.column_stack([degrees(truth), truth.points / 1000])
    )
    with pytest.raises(InputError, match="point in metres"):
        import_recording([path], tmp_path / "out", UR10)


def test_a_stated_quaternion_order_that_is_wrong_is_refused(truth, tmp_path):
    quaternions = np.stack([truth.columns[f"q{c}"] for c in "xyzw"], axis=1)
    header = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z", "qw", "qx", "qy", "qz"]
    path = write_rows(
        tmp_path / "t.csv", header, np.column_stack([degrees(truth), truth.points, quaternions])
    )
    with pytest.raises(InputError, match="quaternion xyzw"):
        import_recording([path], tmp_path / "out", UR10)


def test_another_robot_is_refused(truth, tmp_path):
    header = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]
    path = write_rows(tmp_path / "t.csv", header, np.column_stack([degrees(truth), truth.points]))
    with pytest.raises(InputError) as caught:
        import_recording([path], tmp_path / "out", ImportOptions(robot="staubli_tx60"))
    sentence = str(caught.value)
    assert "does not describe this arm, which is a Universal Robots UR10" in sentence
    assert "use the robot 'ur10'" in sentence
    assert "about equally well" not in sentence


def test_clocks_without_common_times_are_refused(truth, tmp_path):
    times = np.arange(truth.n) * 1.0
    a = write_rows(
        tmp_path / "a.csv",
        ["time", *(f"J{k}" for k in range(1, 7))],
        np.column_stack([times, degrees(truth)]),
    )
    rows = np.column_stack([times + 1e6, truth.points])[:-2]
    b = write_rows(tmp_path / "b.csv", ["time", "X", "Y", "Z"], rows)
    with pytest.raises(InputError, match="time_offset_s"):
        import_recording([a, b], tmp_path / "out", UR10)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a;b\n1,5;2.5\n1.5;2\n", "one decimal sign"),
        ("a,b\n1,2\n3,4,5\n6,7\n", "row 3"),
        ("only text\nno table\n", "a table of numbers"),
    ],
)
def test_broken_tables_are_refused_with_a_place(text, words, tmp_path):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        read_text_table(tmp_path / "t.csv")


def test_a_table_without_joints_or_header_says_which_line_to_add(truth, tmp_path):
    with pytest.raises(InputError, match=r"\[joints\]"):
        import_recording([tracker(tmp_path / "t.csv", truth)], tmp_path / "out", UR10)
    np.savetxt(
        tmp_path / "plain.csv", np.column_stack([degrees(truth), truth.points]), delimiter=","
    )
    made = import_recording([tmp_path / "plain.csv"], tmp_path / "found", UR10)
    assert_same_rows(made.recording, truth)
    assert made.warnings[0].startswith("No header names joint readings or the measured point.")
    noise = np.random.default_rng(0).normal(size=(truth.n, 3)) * 500
    np.savetxt(tmp_path / "plain.csv", np.column_stack([degrees(truth), noise]), delimiter=",")
    with pytest.raises(InputError, match=r"\[joints\]"):
        import_recording([tmp_path / "plain.csv"], tmp_path / "out", UR10)


@pytest.mark.parametrize(
    "arguments",
    [
        ["import", "nothing.csv", "--out", "o"],
        ["import", "t.csv"],
        ["import", "t.csv", "--out", "o"],
        ["import", "t.csv", "--out", "o", "--robot", "r2d2"],
        ["import", "t.csv", "--out", "o", "--map", "t.csv"],
        ["import", "t.csv", "--out", "o", "--board", "big"],
        ["import", "t.csv", "--out", "o", "--sigma", "-1"],
        ["new", "nonsense", "o"],
        ["check", "nothing"],
    ],
)
def test_wrong_calls_end_with_one_sentence_and_status_2(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "t.csv").write_text("J1,J2,X,Y,Z\n1,2,3,4,5\n2,3,4,5,6\n")
    assert run(arguments) == 2
    said = capsys.readouterr().err.strip()
    assert "\n" not in said and said.endswith(".")
    assert not (tmp_path / "o").exists()


def joints_and_points(recording, path):
    header = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]
    return write_rows(path, header, np.column_stack([degrees(recording), recording.points]))


def test_a_built_in_robot_is_found_where_none_is_named(tmp_path):
    recording = simulated(tmp_path, SCENE.replace('"ur10"', '"staubli_tx60"'))
    path = joints_and_points(recording, tmp_path / "t.csv")
    made = import_recording([path], tmp_path / "out", ImportOptions())
    assert made.recording.robot == {"builtin": "staubli_tx60"}
    assert any("'Staubli TX60' is a guess" in sentence for sentence in made.warnings)


@pytest.mark.slow
def test_two_built_in_robots_that_are_nearly_equal_lead_to_a_question(truth, tmp_path):
    path = joints_and_points(truth, tmp_path / "t.csv")
    with pytest.raises(InputError, match="ur10.*ur10e"):
        import_recording([path], tmp_path / "out", ImportOptions())


@pytest.mark.slow
def test_no_built_in_robot_is_forced_on_another_arm(truth, tmp_path):
    rows = np.column_stack([degrees(truth) * 0.7 + 11, truth.points])
    path = write_rows(tmp_path / "t.csv", [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"], rows)
    with pytest.raises(InputError, match="robot.toml, a URDF"):
        import_recording([path], tmp_path / "out", ImportOptions())


def test_ball_centres_in_the_frame_of_the_sensor_are_not_taken_for_tracker_points(tmp_path):
    from workbench.recordings.templates.examples import ball_centre

    truth = ball_centre({"builtin": "ur10"})
    path = joints_and_points(truth.select(truth.ball == 1), tmp_path / "t.csv")
    with pytest.raises(InputError, match='measures = "ball-centre"'):
        import_recording([path], tmp_path / "out", UR10)
    (tmp_path / "map.toml").write_text('measures = "ball-centre"\n')
    options = ImportOptions(robot="ur10", mapping=read_mapping(tmp_path / "map.toml"))
    assert import_recording([path], tmp_path / "out", options).recording.measures == "ball-centre"


def spoil_sign(joints, points):
    joints[:, 2] *= -1


def spoil_hand(joints, points):
    points[:, 1] *= -1


def spoil_rows(joints, points):
    points[:] = np.roll(points, 1, axis=0)


def spoil_order(joints, points):
    joints[:, [3, 4]] = joints[:, [4, 3]]


@pytest.mark.parametrize("spoil", [spoil_sign, spoil_hand, spoil_rows, spoil_order])
def test_mistakes_in_the_table_are_refused_and_nothing_is_written(spoil, truth, tmp_path):
    joints, points = degrees(truth).copy(), truth.points.copy()
    spoil(joints, points)
    path = write_rows(
        tmp_path / "t.csv",
        [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"],
        np.column_stack([joints, points]),
    )
    with pytest.raises(InputError):
        import_recording([path], tmp_path / "out", UR10)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_at_a_terminal_the_preview_is_confirmed(truth, tmp_path):
    """A person sees the preview and answers; "n" keeps nothing."""
    import pty
    import subprocess
    import sys

    path = joints_and_points(truth, tmp_path / "t.csv")
    for answer, status, exists in (("n", 2, False), ("y", 0, True)):
        master, slave = pty.openpty()
        words = ["import", str(path), "--robot", "ur10", "--out", str(tmp_path / "out")]
        process = subprocess.Popen(
            [sys.executable, "-m", "workbench", *words],
            stdin=slave,
            stdout=subprocess.PIPE,
            stderr=slave,
        )
        os.write(master, f"{answer}\n".encode())
        said = process.communicate(timeout=120)[0].decode()
        os.close(slave)
        os.close(master)
        assert process.returncode == status
        assert "Fit with plausible geometry errors" in said
        assert (tmp_path / "out").exists() == exists


def test_cells_and_headers_of_a_million_characters_are_judged_at_once():
    """With a time that grows with the square of the length these two take many minutes."""
    assert not is_number_text("9" * 1_000_000 + "x")
    assert is_number_text("9" * 1_000_000 + ".5e3")
    assert headers._kind("a1" * 500_000) == ("", "")
