"""Columns of a rotation whose values stand in another order than their names say: the import names the right order."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.mapping.model import Group, Mapping, read_mapping
from datasets.importers.source import RawTable
from datasets.recording import Recording
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, write_rows
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import nominal_scale, unexplainable_misfit_mm
from workbench.jobs.robot.compensation.compensate import nominal_poses
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.importing.board_images.board_poses import _refuse_other_order
from workbench.recordings.importing.board_images.reading_fits import BoardViews

JOINTS = [f"J{k}" for k in range(1, 7)]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def turns(truth) -> Rotation:
    return Rotation.from_quat(np.stack([truth.columns[f"q{axis}"] for axis in "xyzw"], axis=1))


def written(truth, folder, names, values):
    cells = np.column_stack([degrees(truth), truth.points, values])
    return write_rows(folder / "t.csv", [*JOINTS, "X", "Y", "Z", *names], cells)


@pytest.mark.parametrize("letters", ["wyxz", "zxyw", "xzwy"])
def test_a_quaternion_in_another_order_is_named(truth, letters, tmp_path):
    components = dict(zip("xyzw", turns(truth).as_quat().T))
    values = np.stack([components[letter] for letter in letters], axis=1)
    path = written(truth, tmp_path, ["qw", "qx", "qy", "qz"], values)
    with pytest.raises(InputError, match=r"columns qw, qx, qy, qz.* in the order '") as caught:
        import_recording([path], tmp_path / "out", UR10)
    order = ["qw", "qx", "qy", "qz"]
    right = [order[letters.index(letter)] for letter in "wxyz"]
    assert f"in the order {', '.join(map(repr, right))};" in str(caught.value)
    _imports_as_advised(str(caught.value), path, truth, tmp_path)


def test_euler_angles_in_another_order_are_named(truth, tmp_path):
    values = turns(truth).as_euler("xyz", degrees=True)[:, [1, 2, 0]]
    path = written(truth, tmp_path, ["Rx", "Ry", "Rz"], values)
    with pytest.raises(InputError, match=r"columns Rx, Ry, Rz.* in the order '") as caught:
        import_recording([path], tmp_path / "out", UR10)
    _imports_as_advised(str(caught.value), path, truth, tmp_path)


def _imports_as_advised(sentence, path, truth, folder):
    """The line that the sentence proposes makes the right recording."""
    line = sentence.split("or add ")[1].split(" to a mapping file")[0]
    section, _, keys = line.partition(" ")
    keys = keys.replace(", convention", "\nconvention").replace(", unit", "\nunit")
    mapping = folder / "map.toml"
    mapping.write_text(f'format = "import/1"\n{section}\n{keys}\n')
    made = import_recording(
        [path], folder / "out", ImportOptions(robot="ur10", mapping=read_mapping(mapping))
    )
    assert_same_rows(made.recording, truth)


def test_a_wrong_arm_is_no_order_of_columns(truth, tmp_path):
    values = turns(truth).as_quat(scalar_first=True)
    cells = np.column_stack([np.roll(degrees(truth), 7, axis=0), truth.points, values])
    header = [*JOINTS, "X", "Y", "Z", "qw", "qx", "qy", "qz"]
    path = write_rows(tmp_path / "t.csv", header, cells)
    with pytest.raises(InputError) as caught:
        import_recording([path], tmp_path / "out", UR10)
    assert "in the order '" not in str(caught.value)


def test_three_joints_in_a_cycle_are_named(truth, tmp_path):
    cells = np.column_stack([degrees(truth)[:, [2, 0, 1, 3, 4, 5]], truth.points])
    path = write_rows(tmp_path / "t.csv", [*JOINTS, "X", "Y", "Z"], cells)
    words = "exchanged in a cycle; name column 'J1' 'J3', column 'J2' 'J1' and column 'J3' 'J2'"
    with pytest.raises(InputError, match=words):
        import_recording([path], tmp_path / "out", UR10)


def test_the_readings_of_all_orders_differ():
    quaternions = Rotation.random(20, random_state=1).as_quat()
    made = {tuple(np.round(quaternions[:, list(one)], 9).ravel()) for one in permutations(range(4))}
    assert len(made) == 24


@pytest.mark.parametrize("name", ["ur10", "abb_irb120", "kuka_kr10_r1100", "staubli_tx60"])
def test_plausible_geometry_errors_are_not_hopeless(name):
    """Twice the prior standard deviation of every joint's zero and length, in the worst of 20 draws."""
    robot, rng = load_robot(name), np.random.default_rng(4)
    low, high = np.nan_to_num(robot.limits, nan=np.pi).T * 0.7
    readings = rng.uniform(np.maximum(low, -2.5), np.minimum(high, 2.5), (60, 6))
    columns = {f"q{k}_deg": np.rad2deg(column) for k, column in enumerate(readings.T, 1)}
    sizes = np.array([np.deg2rad(2.0), 3.0, 3.0, np.deg2rad(0.8), 0.0])
    ratios = []
    for _ in range(20):
        wrong = replace(robot, geometry=robot.geometry + sizes * rng.normal(size=(6, 5)))
        points = nominal_poses(wrong, readings)[:, :3, 3]
        measured = dict(zip(("x_mm", "y_mm", "z_mm"), points.T))
        sample = {"sample": np.arange(60)}
        recording = Recording("external-point", sample | columns | measured, {"builtin": name})
        ratios.append(nominal_scale(robot, recording) / unexplainable_misfit_mm(robot, recording))
    assert max(ratios) < 0.5


@pytest.mark.parametrize(
    "names, order", [(["qw", "qx", "qy", "qz"], "wyxz"), (["A", "B", "C"], "")]
)
def test_the_flange_poses_of_images_are_tested_in_other_orders(names, order):
    rng = np.random.default_rng(3)
    flange = Rotation.random(14, random_state=5)
    poses, tool, board = (np.tile(np.eye(4), (14, 1, 1)) for _ in range(3))
    poses[:, :3, :3], poses[:, :3, 3] = flange.as_matrix(), rng.uniform(-300, 300, (14, 3))
    tool[:, :3, :3] = Rotation.from_rotvec([0.2, -0.3, 1.0]).as_matrix()
    tool[:, :3, 3], board[:, :3, 3] = [30.0, -20, 90], [800.0, 100, -40]
    seen = np.linalg.inv(poses @ tool) @ board
    components = dict(zip("xyzw", flange.as_quat().T))
    angles = flange.as_euler("ZYX", degrees=True)[:, [1, 2, 0]]
    values = np.stack([components[one] for one in order], 1) if order else angles
    columns = dict(zip([*"XYZ", *names], np.column_stack([poses[:, :3, 3], values]).T))
    rows = RawTable("poses.csv", columns, np.arange(2, 16))
    convention = "quaternion wxyz" if order else None
    mapping = Mapping(
        flange_point=Group(("X", "Y", "Z"), "mm"),
        flange_rotation=Group(tuple(names), None if order else "deg", convention),
    )
    views = BoardViews(seen[None], np.arange(14))
    with pytest.raises(InputError, match="in the order '"):
        _refuse_other_order(rows, mapping, views, "in-hand")
    right = replace(views, seen=np.tile(np.eye(4), (1, 14, 1, 1)))
    _refuse_other_order(rows, mapping, right, "in-hand")  # no order explains these
