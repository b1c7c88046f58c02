"""Configuration data of KUKA and ABB programs choose the joint readings that a pose takes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robot_model import load_robot
from robot_model.configuration import configuration_signs
from scenes import ABB
from workbench.files.targets import doubts, read_programme
from workbench.jobs.robot.compensate import nominal_poses
from workbench.jobs.robot.stated_configuration import with_stated_configuration

ROBOT = load_robot(ABB)
# axis 3 of the IRB 120 stretches the arm near -77 deg (forearm offset 70 mm, length 302 mm)
STRETCHED = -np.rad2deg(np.arctan2(302, 70))


def drawn(n):
    """(n, 6) deg within the joint limits, away from singular postures."""
    rng = np.random.default_rng(5)
    low, high = np.rad2deg(ROBOT.limits).T
    found = rng.uniform(0.8 * low, 0.8 * high, (40 * n, 6))
    found[:, 5] = rng.uniform(-170, 170, 40 * n)
    clear = (np.abs(found) > 8).all(1) & (np.abs(found[:, 2] - STRETCHED) > 8)
    regular = (configuration_signs(ROBOT, np.deg2rad(found)) != 0).all(1)
    return found[clear & regular][:n]


def is_behind(readings):
    """(n,) bool: wrist centre behind axis 1, from the place of the wrist in the frame that axis 1 rotates."""
    signs = configuration_signs(ROBOT, np.deg2rad(readings))[:, 0]
    ahead = configuration_signs(ROBOT, np.deg2rad([[0.0, 0, 0, 0, 30, 0]]))[0, 0]
    return signs != ahead


def kuka(readings, name="XP"):
    poses = nominal_poses(ROBOT, np.deg2rad(readings))
    lines = ["$TOOL=$NULLFRAME", "$BASE=$NULLFRAME"]
    for k, (pose, q, behind) in enumerate(zip(poses, readings, is_behind(readings)), 1):
        x, y, z = pose[:3, 3]
        a, b, c = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX", degrees=True)
        status = int(behind) + 2 * int(q[2] >= STRETCHED) + 4 * int(q[4] < 0)
        turn = sum(1 << j for j in range(6) if q[j] < 0)
        lines.append(
            f"DECL E6POS {name}{k}={{X {x:.6f},Y {y:.6f},Z {z:.6f},A {a:.6f},B {b:.6f},C {c:.6f},"
            f"S {status},T {turn}}}"
        )
    return "job.dat", "\n".join([*lines, ""])


def abb(readings):
    poses = nominal_poses(ROBOT, np.deg2rad(readings))
    lines = ["MODULE job"]
    for k, (pose, q, behind) in enumerate(zip(poses, readings, is_behind(readings)), 1):
        place = ",".join(f"{v:.6f}" for v in pose[:3, 3])
        turn = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
        cf = [int(np.floor(q[j] / 90)) for j in (0, 3, 5)]
        cfx = 4 * int(behind) + 2 * int(q[2] < STRETCHED) + int(q[4] < 0)
        lines += [
            f"CONST robtarget p{k}:=[[{place}],[{','.join(f'{v:.9f}' for v in turn)}],"
            f"[{cf[0]},{cf[1]},{cf[2]},{cfx}],[9E9,9E9,9E9,9E9,9E9,9E9]];",
            f"MoveL p{k}, v100, fine, tool0;",
        ]
    return "job.mod", "\n".join([*lines, "ENDMODULE", ""])


@pytest.mark.parametrize("maker", [kuka, abb])
def test_the_readings_are_those_that_the_program_was_taught_with(maker, tmp_path):
    taught = drawn(12)
    name, text = maker(taught)
    (tmp_path / name).write_text(text)
    programme = read_programme(tmp_path / name, ROBOT)
    made, (sentence,) = with_stated_configuration(programme, ROBOT)
    np.testing.assert_allclose(np.rad2deg(made.readings), taught, atol=1e-2)
    assert "12 of 12 positions" in sentence and not made.anywhere and not doubts(made, ROBOT)


def test_data_that_no_readings_fulfil_are_named(tmp_path):
    name, text = kuka(drawn(3))
    lines = text.split("\n")
    # axis 1 on the other side of the arm, and the rest as it was
    turn = int(lines[3].split("T ")[1].rstrip("}"))
    lines[3] = lines[3].replace(f"T {turn}}}", f"T {turn ^ 0b001001}}}")
    (tmp_path / name).write_text("\n".join(lines))
    programme = read_programme(tmp_path / name, ROBOT)
    made, said = with_stated_configuration(programme, ROBOT)
    assert made.anywhere and "2 of 3 positions" in said[0]
    assert "reach position 2: another configuration is taken" in said[1]
