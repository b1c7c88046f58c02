"""`import --propose` of tables whose rows nothing joins: the mapping file has all but the join."""

import numpy as np
import pytest

from datasets.importers.mapping.model import read_mapping
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, write_rows
from workbench.commands.cli import run
from workbench.recordings.importing import ImportOptions, import_recording

JOINTS = [f"J{k} [deg]" for k in range(1, 7)]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def written(truth, folder, other_names):
    """A joint log, and a tracker table with fewer rows."""
    names = np.array([f"stop {k}" for k in range(truth.n)])
    log = write_rows(folder / "log.csv", ["Stop", *JOINTS], list(zip(names, *degrees(truth).T)))
    rows = np.arange(truth.n)[:-3]
    cells = zip(other_names[rows], *truth.points[rows].T)
    tracker = write_rows(
        folder / "tracker.csv", ["Target", "X [mm]", "Y [mm]", "Z [mm]"], list(cells)
    )
    return log, tracker


def test_the_open_join_is_a_comment(truth, tmp_path, capsys):
    strange = np.array([f"Alpha{k * 7}" for k in range(truth.n)])
    log, tracker = written(truth, tmp_path, strange)
    file = tmp_path / "map.toml"
    words = ["import", str(log), str(tracker), "--robot", "ur10", "--propose", str(file)]
    assert run(words) == 0
    assert "Warning: " in capsys.readouterr().out
    text = file.read_text()
    assert '# by = "key"' in text and "log.csv that are not used yet: 'Stop' (stop 0, ...)" in text
    assert "tracker.csv that are not used yet: 'Target' (Alpha0, ...)" in text
    mapping = read_mapping(file)
    assert mapping.joints.columns == tuple(JOINTS) and len(mapping.point.columns) == 3


def test_the_file_is_complete_with_the_join(truth, tmp_path):
    log, tracker = written(truth, tmp_path, np.array([f"x{k}" for k in range(truth.n)]))
    file = tmp_path / "map.toml"
    assert run(["import", str(log), str(tracker), "--propose", str(file)]) == 0
    tracker.write_text(tracker.read_text().replace("Target", "Stop").replace("x", "stop "))
    head = file.read_text().split("format =")[0]
    file.write_text(file.read_text().replace(head, "") + '\n[join]\nby = "key"\nkey = "Stop"\n')
    options = ImportOptions(robot=UR10.robot, mapping=read_mapping(file))
    made = import_recording([log, tracker], tmp_path / "out", options)
    assert_same_rows(made.recording, truth.select(np.arange(truth.n)[:-3]))


def test_one_table_with_a_mistake_is_refused_as_before(tmp_path, capsys):
    path = tmp_path / "t.csv"
    path.write_text("only one line")
    file = tmp_path / "map.toml"
    assert run(["import", str(path), "--propose", str(file)]) == 2 and not file.exists()
