"""What an effect does to an arm does not depend on the convention of its file: distal, Craig's or URDF."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robot_model.effects import CATALOGUE
from robot_model.effects.load import LinkBeam
from robot_model.effects.nonparametric import SmoothFunction
from robot_model.effects.steps import LinkWarmUp, Shift
from robot_model.files.urdf import robot_from_urdf
from robot_model.system import bind
from scenes import ABB, SLIDING, scene
from workbench.core.model import Model

# beta stands on the other side of alpha and a in Craig's convention, so that an arm with it has no counterpart
PLAIN_SLIDING = SLIDING | {"joint": [{**row, "beta_deg": 0.0} for row in SLIDING["joint"]]}
SKEW = {
    "name": "six skew axes",
    "convention": "distal",
    "joint": [
        {"theta_deg": t, "d_mm": d, "a_mm": a, "alpha_deg": alpha, "mass_kg": m, "com_mm": c}
        for t, d, a, alpha, m, c in [
            (0, 410, 60, -75, 9, [10, 20, -30]),
            (-80, 30, 420, 12, 7, [-180, 5, 11]),
            (15, -25, 90, -85, 5, [20, 30, 40]),
            (0, 380, 15, 80, 3, [0, -150, 8]),
            (5, 12, 25, -70, 2, [4, 5, 6]),
            (0, 95, 0, 0, 1, [0, 3, -20]),
        ]
    ],
}


def _screw(theta, d):
    made = np.eye(4)
    made[:3, :3], made[2, 3] = Rotation.from_rotvec([0, 0, theta]).as_matrix(), d
    return made


def _normal(a, alpha):
    made = np.eye(4)
    made[:3, :3], made[0, 3] = Rotation.from_rotvec([alpha, 0, 0]).as_matrix(), a
    return made


def _place(pose, points):
    return np.array([pose[:3, :3] @ point + pose[:3, 3] for point in points])


def in_craigs_convention(robot):
    """The same arm (distal, without beta) with a and alpha of every row in the next one."""
    normals = [_normal(a, alpha) for _, _, a, alpha, _ in robot.geometry]
    rows = robot.geometry.copy()
    rows[0, 2:4], rows[1:, 2:4] = 0.0, robot.geometry[:-1, 2:4]
    com = np.array([_place(n, [c])[0] for n, c in zip(normals, robot.com)])
    flange = normals[-1] @ robot.flange
    return replace(robot, convention="craig", geometry=rows, com=com, flange=flange)


def as_urdf(robot, folder):
    """The same arm (distal, without beta) read from a URDF."""
    after = [_screw(t, d) @ _normal(a, alpha) for t, d, a, alpha, _ in robot.geometry]
    text = '<robot name="form"><link name="l0"/>'
    for k, pose in enumerate([np.eye(4), *after], 1):
        xyz = " ".join(map(repr, map(float, pose[:3, 3] / 1e3)))
        rpy = " ".join(map(repr, map(float, Rotation.from_matrix(pose[:3, :3]).as_euler("xyz"))))
        kind = (
            "fixed" if k > robot.joints else "prismatic" if robot.prismatic[k - 1] else "revolute"
        )
        text += f'<joint name="j{k}" type="{kind}"><parent link="l{k - 1}"/><child link="l{k}"/>'
        text += f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
        text += '<limit lower="-9" upper="9" effort="0" velocity="0"/></joint>'
        text += f'<link name="l{k}">'
        if k <= robot.joints:
            c = " ".join(map(repr, map(float, _place(after[k - 1], [robot.com[k - 1]])[0] / 1e3)))
            text += f'<inertial><origin xyz="{c}"/><mass value="{robot.mass[k - 1]}"/>'
            text += '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        text += "</link>"
    (folder / "arm.urdf").write_text(text + "</robot>")
    return robot_from_urdf({"urdf": folder / "arm.urdf", "tip": f"l{robot.joints + 1}"})


def effects_of(chain) -> dict:
    """Every variant of every effect that moves a frame or changes lengths."""
    made = {}
    for name, kind in CATALOGUE.items():
        if kind.port in ("frame", "geometry"):
            for one in kind.candidates(chain):
                made[name, one.effect.where, one.label] = one.effect
    half = float(np.median(chain.state.covariates["time_s"]))
    q1 = chain.variables[0]
    for where in chain.places("link"):
        made["shift", where] = Shift(where, half)
        made["warm-up", where] = LinkWarmUp(where, half)
        made["beam", where] = LinkBeam(where)
        sizes = ("link", "frame", ["q1"], [[q1.min(), q1.max()]], "mm", [1.0] * 6)
        made["unknown", where] = SmoothFunction(where, *sizes[1:])
    return made


def displacements(chain, effect) -> np.ndarray:
    """(P, N) motion of the measured points per unit of each parameter."""
    model = Model(chain, (effect,))
    evaluation = model.evaluate(model.parameters)
    rows = evaluation.rows(effect.port, np.asarray(effect.port_indices(chain)))
    basis = effect.basis(chain.state)
    return np.einsum("pkn,kmn->pmn", basis, rows).reshape(len(basis), -1)


def left_over(columns, others) -> float:
    """Largest part of one of the columns that the others do not make, as a share of the largest column."""
    largest = max(np.linalg.norm(columns, axis=1).max(), 1e-9)
    scale = np.linalg.norm(others, axis=1)
    basis = others[scale > 1e-9 * largest]
    basis = (basis / np.linalg.norm(basis, axis=1, keepdims=True)).T
    left = columns.T - basis @ np.linalg.lstsq(basis, columns.T, rcond=1e-10)[0]
    return float(np.linalg.norm(left, axis=0).max() / largest)


@pytest.mark.parametrize("masses", [True, False], ids=["masses", "no masses"])
@pytest.mark.parametrize("form", ["craig", "urdf"])
@pytest.mark.parametrize("arm", [ABB, PLAIN_SLIDING, SKEW], ids=["abb", "sliding", "skew"])
def test_an_effect_moves_the_points_alike_in_every_convention(arm, form, masses, tmp_path):
    made = scene("external-point", n=40, arm=arm, seed=3)
    recording, robot = made.recording, made.robot
    if not masses:
        robot = replace(robot, mass=robot.mass * 0, payload_mass=0.0)
        held = {k: v for k, v in recording.columns.items() if k != "payload_kg"}
        recording = replace(recording, columns=held)
    other = in_craigs_convention(robot) if form == "craig" else as_urdf(robot, tmp_path)
    if form == "urdf":
        load = {"payload_mass": robot.payload_mass, "payload_com": robot.payload_com}
        other = replace(other, mixing=robot.mixing, **load)
    chains = [bind(one, recording) for one in (robot, other)]
    effects = [effects_of(chain) for chain in chains]
    assert effects[0].keys() == effects[1].keys()
    # with "craig" what lies beyond the last axis is the flange's, and no length of the last row
    last = {
        ("link-thermal-growth", f"link-{robot.joints}", ""),
        ("warm-up", f"link-{robot.joints}"),
    }
    for name in effects[0].keys() - (last if robot.geometry[-1, 2] else set()):
        pair = [displacements(chain, one[name]) for chain, one in zip(chains, effects)]
        assert left_over(*pair) < 1e-6 and left_over(*pair[::-1]) < 1e-6, name
        if len(pair[0]) == 1:
            np.testing.assert_allclose(
                *pair, atol=1e-9 + 1e-6 * np.abs(pair[0]).max(), err_msg=str(name)
            )
