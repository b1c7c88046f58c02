"""Drives that move several joints: virtual work, derivatives, and what a recording decides about couplings."""

from dataclasses import replace

import numpy as np
import pytest

from coupled_arms import ARMS, CoupledArm
from robot_model.effects.elastic import JointCompliance
from robot_model.effects.transmission import Backlash, TransmissionHarmonic
from robot_model.effects.unknown_masses import GravityCompliance
from robot_model.files.loading import load_robot
from robot_model.measurements import samples_of
from robot_model.system import bind
from workbench.core.model import Model
from workbench.fitting.checked_samples import check_samples
from workbench.fitting.plausibility.joint_columns.coupled_drives import CAUSE

COMPLIANCES = {
    "parallelogram": (0.0, 4e-7, 5e-7, 2e-6, 2e-6, 0.0),
    "palletiser": (0.0, 2.5e-7, 3e-7, 0.0, 0.0),
    "wrist": (0.0, 4e-7, 5e-7, 4e-6, 8e-6, 8e-6),
}


def chain_of(arm: CoupledArm, n: int = 30):
    recording = samples_of(arm.recording(n))
    return bind(load_robot(recording.robot), recording)


@pytest.mark.parametrize("name", ARMS)
def test_the_torque_on_a_drive_is_the_fall_of_the_potential_energy_with_its_motion(name):
    arm = CoupledArm(name, says=True)
    chain = chain_of(arm)
    nominal = np.zeros((len(arm.rows), 4))
    steps = 1e-4 * np.eye(len(arm.rows))
    for sample in range(5):
        reading = np.linalg.solve(arm.mixing, chain.variables[:, sample])
        energies = [
            [arm.energy(arm.mixing @ (reading + side * h), nominal) for side in (-1, 1)]
            for h in steps
        ]
        torque = np.array([before - after for before, after in energies]) / 2e-4
        np.testing.assert_allclose(chain.state.torque[:, sample], torque, atol=1e-4)


@pytest.mark.parametrize("name", ARMS)
def test_the_virtual_work_of_the_drives_is_that_of_the_joints(name):
    robot = load_robot(CoupledArm(name, says=True).keys())
    rng = np.random.default_rng(1)
    motion, torque = rng.normal(size=(2, robot.joints, 7))
    by_drives = (robot.drive_torque(torque) * motion).sum(0)
    by_joints = (torque * (robot.coupling @ motion)).sum(0)
    np.testing.assert_allclose(by_drives, by_joints, rtol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_derivatives_by_drive_errors_agree_with_finite_differences(name):
    chain = chain_of(CoupledArm(name, says=True))
    effects = (
        TransmissionHarmonic("joint-2", 3.0),
        JointCompliance("joint-3"),
        Backlash("joint-2", "moves"),
        JointCompliance("joint-4"),
        Backlash("joint-5", "moves"),
    )
    model = Model(chain, effects)
    parameters = model.parameters
    parameters = parameters.only(np.array([key.count(".") > 1 for key in parameters.keys]))
    _, rows = model.linearise(parameters)
    steps = 1e-2 * parameters.typical[parameters.mask]
    for row, k, step in zip(rows, np.flatnonzero(parameters.mask), steps):
        sides = []
        for side in (-1, 1):
            values = parameters.values.copy()
            values[k] += side * step
            sides.append(model.residual(replace(parameters, values=values)))
        numeric = (sides[1] - sides[0]) / (2 * step)
        np.testing.assert_allclose(row, numeric, rtol=1e-5, atol=1e-5 * np.abs(row).max() + 1e-9)


@pytest.mark.parametrize("name", ["parallelogram", "palletiser"])
def test_the_deflection_of_unknown_masses_is_that_of_known_ones(name):
    known = chain_of(CoupledArm(name, says=True))
    unknown = chain_of(CoupledArm(name, says=True, with_masses=False))
    for number in (2, 3):
        columns = GravityCompliance(f"joint-{number}").basis(unknown.state)[:, 0]
        torque = known.state.torque[number - 1]
        rest = torque - np.linalg.lstsq(columns.T, torque, rcond=1e-10)[0] @ columns
        assert np.abs(rest).max() < 1e-9 * np.abs(torque).max()


def test_a_coupling_that_is_not_mechanical_changes_no_bit():
    stated = chain_of(CoupledArm("parallelogram", COMPLIANCES["parallelogram"], says=False))
    silent = chain_of(CoupledArm("parallelogram", COMPLIANCES["parallelogram"]))
    assert stated.robot.coupling is None
    effects = (JointCompliance("joint-2"), TransmissionHarmonic("joint-3", 2.0))
    rows = []
    for chain in (stated, silent):
        model = Model(chain, effects)
        values = model.parameters.values.copy()
        values[-3:] = 1e-6, 2e-4, -1e-4
        free = replace(model.parameters, values=values).only(np.ones(len(values), bool))
        rows.append(model.linearise(free))
    assert all(np.array_equal(*pair) for pair in zip(*rows))


@pytest.mark.parametrize("with_masses", [True, False])
@pytest.mark.parametrize("name", ["parallelogram", "palletiser"])
@pytest.mark.parametrize("is_mechanical", [True, False])
def test_the_recording_decides_which_joints_a_drive_moves(name, is_mechanical, with_masses):
    arm = CoupledArm(
        name,
        COMPLIANCES[name],
        ((2, 1.0, 2e-4, 1e-4), (2, 2.0, 1e-4, -1e-4)),
        is_mechanical=is_mechanical,
        with_masses=with_masses,
    )
    checked = check_samples(arm.recording())
    assert (checked.robot.coupling is not None) == is_mechanical
    assert any("mechanical = true" in sentence for sentence in checked.warnings) == is_mechanical
    if is_mechanical:
        assert checked.recording.robot["joint"][2]["coupled"]["mechanical"] is True


def test_what_the_file_states_is_not_asked_again():
    arm = CoupledArm("parallelogram", COMPLIANCES["parallelogram"], says=False)
    checked = check_samples(arm.recording())
    assert checked.robot.coupling is None
    assert not any("mechanical" in sentence for sentence in checked.warnings)


def test_an_arm_without_errors_of_its_drives_decides_nothing():
    checked = check_samples(CoupledArm("parallelogram").recording())
    assert checked.robot.coupling is None and CAUSE not in " ".join(checked.warnings)


@pytest.mark.parametrize("name", ["parallelogram", "palletiser"])
def test_errors_of_another_joint_do_not_decide_what_a_drive_moves(name):
    arm = CoupledArm(name, harmonics=((1, 1.0, 1e-3, 5e-4),), is_mechanical=False)
    checked = check_samples(arm.recording())
    assert checked.robot.coupling is None
    assert not any("mechanical = true" in sentence for sentence in checked.warnings)
