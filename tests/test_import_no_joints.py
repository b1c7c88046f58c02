"""Points and poses without joint readings: the refusal says what the data lack, and which command needs none."""

from dataclasses import replace

import numpy as np
import pytest

from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.source import RawTable
from datasets.importers.sources import read_sources
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.importing.sources.no_joints import refuse_without_joints

RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(12, 3)) * 300
ANGLES = RNG.uniform(-180, 180, (12, 3))


def refusal(folder, robot=None, **tables) -> InputError:
    paths = []
    for name, (head, cells) in tables.items():
        paths.append(folder / f"{name}.csv")
        rows = [",".join(f"{value:.3f}" for value in row) for row in cells]
        paths[-1].write_text("\n".join([head, *rows]) + "\n")
    with pytest.raises(InputError) as caught:
        import_recording(paths, folder / "out", ImportOptions(robot=robot))
    return caught.value


def test_two_lists_of_points_name_register(tmp_path):
    said = refusal(tmp_path, nominal=("X,Y,Z", POINTS), measured=("X,Y,Z", POINTS + 3))
    assert "`workbench register nominal.csv measured.csv`" in str(said)
    assert len(str(said)) < 300 and not said.example


def test_poses_alone(tmp_path):
    said = refusal(tmp_path, poses=("X,Y,Z,A,B,C", np.hstack([POINTS, ANGLES])))
    assert "found poses (X, Y, Z, ...)" in str(said) and "`workbench handeye` needs" in str(said)
    assert not said.example


def test_flange_poses_and_points_of_other_rows(tmp_path):
    cells = np.hstack([POINTS, ANGLES, RNG.normal(size=(12, 3)) * 200])
    said = refusal(tmp_path, poses=("X,Y,Z,A,B,C,Tracker X,Tracker Y,Tracker Z", cells))
    assert "flange poses that one transform connects with the measurements" in str(said)
    assert not said.example


def test_columns_that_may_be_joints_keep_the_proposal(tmp_path):
    cells = np.hstack([ANGLES, ANGLES[::-1], POINTS])
    said = refusal(tmp_path, log=("f1,f2,f3,f4,f5,f6,X,Y,Z", cells))
    assert "[joints]" in said.example


def test_with_a_robot_the_proposal_stays(tmp_path):
    said = refusal(tmp_path, robot="ur10", measured=("X,Y,Z", POINTS))
    assert "[joints]" in said.example


def without_headers(folder, **tables) -> list:
    paths = [folder / f"{name}.txt" for name in tables]
    for path, cells in zip(paths, tables.values()):
        np.savetxt(path, cells, "%.3f")
    return paths


@pytest.mark.parametrize("head", ["X,Y,Z", ""])
def test_two_lists_of_points_whatever_their_names(tmp_path, head):
    if head:
        said = refusal(tmp_path, a=(head, POINTS), b=(head, POINTS[::-1]))
        assert "`workbench register a.csv b.csv`" in str(said)
        return
    paths = without_headers(tmp_path, a=POINTS, target=POINTS + 3)
    with pytest.raises(InputError, match="workbench register a.txt target.txt"):
        import_recording(paths, tmp_path / "out", ImportOptions())


def test_positions_that_agree_without_the_rotations_name_register():
    moved = np.roll(POINTS, 1, axis=1) * 0.001 + RNG.normal(size=POINTS.shape) * 0.01
    cells = np.hstack([POINTS, ANGLES, moved])
    names = [f"column {k}" for k in range(1, 10)]
    table = RawTable("poses.txt", dict(zip(names, cells.T)), np.arange(1, 13))
    groups = [Group(tuple(names[k : k + 3])) for k in (0, 3, 6)]
    mapping = Mapping(flange_point=groups[0], flange_rotation=groups[1], point=groups[2])
    files = ["robot.txt", "camera.txt"]
    with pytest.raises(InputError, match="the positions alone agree after one rigid") as found:
        refuse_without_joints(table, mapping, None, files)
    assert "`workbench register robot.txt camera.txt`" in str(found.value)
    shuffled = replace(table, columns={**table.columns, names[6]: moved[::-1, 0]})
    with pytest.raises(InputError, match="check that the rows belong together"):
        refuse_without_joints(shuffled, mapping, None, files)


@pytest.mark.parametrize("names", [("a", "target"), ("q", "marker"), ("pose", "j")])
def test_the_name_of_a_file_decides_no_columns_of_poses(tmp_path, names):
    """Files of seven numbers: neither joint readings a 1 ... a 7 nor a point target 1 ... target 3."""
    tables = {name: np.hstack([POINTS, ANGLES[:, [0]], ANGLES]) for name in names}
    for path in without_headers(tmp_path, **tables):
        columns = read_sources([path], tmp_path).tables[0].columns
        assert list(columns) == [f"column {k}" for k in range(1, 8)]
