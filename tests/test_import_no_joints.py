"""Points and poses without joint readings: the refusal says what the data lack, and which command needs none."""

import numpy as np
import pytest

from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

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
