"""Tables whose headers do not say enough: every mistake at once, and a mapping file to complete."""

import tomllib

import numpy as np
import pytest

from import_scenes import SCENE, assert_same_rows, degrees, simulated, write_rows
from workbench.commands.cli import run
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

HEADER = ["run", *(f"f{k}" for k in range(1, 7)), "val1", "val2", "val3", "hall", "op"]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("truth"), SCENE)


@pytest.fixture
def table(truth, tmp_path):
    count = np.arange(truth.n)
    op = np.where(count == 7, "pause", count.astype(str))
    cells = [count, *degrees(truth).T, *truth.points.T, 20 + count % 5, op]
    return write_rows(tmp_path / "log.csv", HEADER, list(zip(*cells)))


def test_all_mistakes_are_reported_at_once(table, tmp_path):
    with pytest.raises(InputError) as refused:
        import_recording([table], tmp_path / "made", ImportOptions(robot="ur11"))
    said = str(refused.value)
    for words in (
        "expected columns with joint readings",
        "Also: log.csv: expected columns with a measured point",
        "Also: --robot ur11: expected one of ",
        "Also: log.csv, column op: expected numbers in all rows, found text (row 9: 'pause')",
    ):
        assert words in said
    assert len(said.splitlines()) == 1


def test_the_example_is_complete_once_the_robot_is_filled_in(table, truth, tmp_path, capsys):
    assert run(["import", str(table), "--robot", "ur11", "--out", str(tmp_path / "a")]) == 2
    text = capsys.readouterr().err
    text = text[text.index("# A mapping file") :]
    keys = tomllib.loads(text)
    assert keys["joints"]["columns"] == [f"f{k}" for k in range(1, 7)]
    assert keys["point"]["columns"] == ["val1", "val2", "val3"]
    assert '# "hall": numbers from 20 to 24' in text
    assert "# counts_per_deg = [...]" in text
    assert text.count("CHECK: taken by the order") == 2
    mapping = tmp_path / "map.toml"
    mapping.write_text(text.replace('robot = "?"', 'robot = "ur10"'), encoding="utf-8")
    made = tmp_path / "made"
    assert run(["import", str(table), "--map", str(mapping), "--out", str(made)]) == 0
    import datasets

    assert_same_rows(datasets.read(made), truth)


def test_what_the_headers_say_stands_in_the_example(truth, tmp_path):
    header = [*(f"J{k} [rad]" for k in range(1, 7)), "a", "b", "c"]
    rows = np.column_stack([truth.joints, truth.points + 1e3 * np.sin(np.arange(36))[:, None]])
    path = write_rows(tmp_path / "t.csv", header, rows)
    with pytest.raises(InputError) as refused:
        import_recording([path], tmp_path / "made", ImportOptions(robot="ur10"))
    keys = tomllib.loads(refused.value.example)
    assert keys["robot"] == "ur10"
    assert keys["joints"] == {"columns": header[:6], "unit": "rad"}
    assert keys["point"]["columns"] == ["a", "b", "c"]


def test_the_proposal_is_the_example_where_nothing_fits_the_robot(table, tmp_path, capsys):
    path = tmp_path / "map.toml"
    assert run(["import", str(table), "--robot", "ur10", "--propose", str(path)]) == 0
    capsys.readouterr()
    text = path.read_text(encoding="utf-8")
    keys = tomllib.loads(text)
    assert keys["robot"] == "ur10" and "CHECK" in text
    assert keys["joints"]["columns"] == ["f1", "f2", "f3", "f4", "f5", "f6"]
