"""Registration against a tracker: the published figures of Gubankov & Yukhimets, ICP, and wrong calls as sentences."""

import json
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets import papers
from workbench.core.errors import InputError
from workbench.files.points import read_points
from workbench.jobs.robot.register import register, suspicions

CLOUDS = ("identified", "controller", "nominal")


def clouds():
    table = papers.load("gubankov-2022")["table_1"]
    return papers.cloud(table, "tracker"), {name: papers.cloud(table, name) for name in CLOUDS}


def write(path, points, names=None):
    head = "x_mm,y_mm,z_mm" + (",point" if names else "")
    rows = [
        ",".join(map(repr, map(float, row))) + (f",{names[k]}" if names else "")
        for k, row in enumerate(points)
    ]
    path.write_text("\n".join([head, *rows]) + "\n")


@pytest.mark.parametrize("matched", [True, False], ids=["by row", "nearest"])
@pytest.mark.parametrize("cloud", CLOUDS)
def test_table_1_of_the_paper_is_reproduced(cloud, matched):
    tracker, points = clouds()
    published = papers.load("gubankov-2022")["registration"][f"{cloud}_mm"]
    found = register(points[cloud], tracker, matched).as_json()
    assert found["rms_mm"] == pytest.approx(published, abs=5e-4)
    assert found["left_one_out_rms_mm"] > found["rms_mm"]


def test_a_known_transform_is_found():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(12, 3)) * [300, 200, 80]
    turn = Rotation.from_rotvec([0.3, -2.0, 1.0]).as_matrix()
    moved = points @ turn.T + [100.0, -50, 20]
    order = rng.permutation(12)
    found = register(points, moved[order], matched=False)
    np.testing.assert_allclose(found.matrix[:3, :3], turn, atol=1e-9)
    np.testing.assert_array_equal(order[found.target_row], np.arange(12))
    assert found.distances.max() < 1e-9


def test_a_point_far_off_is_named_and_noise_is_not():
    rng = np.random.default_rng(3)
    points = rng.uniform(-400, 400, (20, 3))
    measured = points + rng.normal(0, 0.03, points.shape)
    assert register(points, measured).outliers() == []
    assert register(points, points).outliers() == []
    measured[7] += [2.0, 0.0, 0.0]
    assert register(points, measured).outliers() == [7]


READINGS = {
    "mirror image": lambda points: points * [1, -1, 1],
    "source in inches": lambda points: points / 25.4,
    "target in metres": lambda points: points * 1000,
    "are 0.8 times": lambda points: points / 0.8,
}


@pytest.mark.parametrize("matched", [True, False], ids=["by row", "nearest"])
@pytest.mark.parametrize("words", READINGS)
def test_a_mirror_image_and_another_unit_are_suspected(words, matched):
    rng = np.random.default_rng(8)
    target = rng.normal(0, 1, (10, 3)) * [300, 200, 100]
    source = READINGS[words](target) + rng.normal(0, 1e-3, target.shape)
    found = suspicions(source, target, register(source, target, matched), matched)
    assert len(found) == 1 and words in found[0]


@pytest.mark.parametrize("count", [4, 5, 8, 30])
def test_noise_scale_errors_and_unrelated_points_are_no_mirror_image(count):
    """Few points, points near a plane, an arm with a scale error of 0.2 %, and points that have nothing in common."""
    rng = np.random.default_rng(count)
    for _ in range(25):
        points = rng.normal(size=(count, 3)) * [300, 200, 1]
        for target in (
            points + rng.normal(0, 0.3, points.shape),
            points * 1.002 + rng.normal(0, 0.01, points.shape),
            rng.normal(size=(count, 3)) * 100,
        ):
            assert suspicions(points, target, register(points, target)) == ()


def test_points_on_a_line_determine_no_rotation():
    line = np.outer(np.arange(5.0), [1, 2, 3])
    with pytest.raises(InputError, match="one line"):
        register(line, line)
    with pytest.raises(InputError, match="at least 3"):
        register(line[:2], line[:2])


def test_the_command_matches_points_by_name(workbench, tmp_path):
    tracker, points = clouds()
    names = [f"P{k}" for k in range(13)]
    order = np.random.default_rng(1).permutation(13)
    write(tmp_path / "arm.csv", points["identified"], names)
    write(tmp_path / "tracker.csv", tracker[order], [names[k] for k in order])
    done = workbench("register", "arm.csv", "tracker.csv", "--out", "out", "--json", "a.json")
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "a.json").read_text())
    assert result["rms_mm"] == pytest.approx(0.2262, abs=5e-4) and result["points"] == 13
    assert len((tmp_path / "out" / "residuals.csv").read_text().splitlines()) == 14
    assert "leave-one-out" in (tmp_path / "out" / "report.html").read_text()
    write(tmp_path / "other.csv", tracker, [*names[:-1], "Q"])
    for target, words in (
        ("other.csv", "found P12; rename"),
        ("absent.csv", "absent.csv"),
    ):
        done = workbench("register", "arm.csv", target)
        assert done.returncode == 2 and words in " ".join(done.stderr.split()), done.stderr


def test_lists_without_headers_take_their_unit_from_the_command(workbench, tmp_path):
    rng = np.random.default_rng(4)
    points = rng.normal(size=(9, 3))
    angles = rng.uniform(-3, 3, (9, 3))
    np.savetxt(tmp_path / "robot.txt", np.hstack([points, angles]), "%.6f")
    np.savetxt(tmp_path / "tracker.txt", np.hstack([np.arange(1, 10)[:, None], points + 2]), "%.6f")
    done = workbench("register", "robot.txt", "tracker.txt")
    assert done.returncode == 2 and "add --unit" in " ".join(done.stderr.split())
    done = workbench("register", "robot.txt", "tracker.txt", "--unit", "m", "--json", "a.json")
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "a.json").read_text())
    assert result["points"] == 9 and result["rms_mm"] < 0.01
    done = workbench("register", "robot.txt", "tracker.txt", "--unit", "yd")
    assert done.returncode == 2 and "found yd" in done.stderr


@pytest.mark.parametrize(
    ("columns", "place"),
    [("xyz", 0), ("xyzq", 0), ("qxyz", 4), ("nxyz", 1), ("nxyzabc", 1), ("nxyzq", 1)],
)
def test_the_position_of_a_list_without_headers_is_not_its_quaternion_or_row_number(
    columns, place, tmp_path
):
    """Positions in a grid may count like the numbers of rows: a quaternion and the width decide."""
    rng = np.random.default_rng(4)
    parts = {
        "n": np.arange(1.0, 9.0)[:, None],
        "xyz": np.column_stack([np.arange(8.0), rng.normal(0, 300, (8, 2))]),
        "q": Rotation.random(8, random_state=rng).as_quat(),
        "abc": rng.uniform(-3, 3, (8, 3)),
    }
    cells = np.hstack([parts[name] for name in re.findall("n|xyz|q|abc", columns)])
    np.savetxt(tmp_path / "list.txt", cells, "%.4f")
    names, points = read_points(tmp_path / "list.txt", "mm")
    assert names is None and np.allclose(points, cells[:, place : place + 3], atol=1e-4)


def test_columns_without_headers_of_which_nothing_says_the_position_are_refused(tmp_path):
    cells = np.random.default_rng(4).normal(0, 300, (8, 7))
    cells[:, 0] = np.arange(8)
    np.savetxt(tmp_path / "list.txt", np.delete(cells, 6, axis=1), "%.4f")
    with pytest.raises(InputError, match="expected x_mm"):
        read_points(tmp_path / "list.txt", "mm")
