"""The MuJoCo arm obeys textbook kinematics and statics, and the bundled recording is what it makes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip(
    "mujoco", reason="the independent engine needs the package mujoco (extra proof)"
)

from datasets.makers import elastic_arm, folder, ye
from datasets.makers.mujoco_arm import (
    STANDARD_GRAVITY,
    Arm,
    Gap,
    Harmonic,
    Slip,
    StaticsError,
    arm_from_robot,
    ball_points,
    drive_errors,
    pose,
    reflector_points,
    static_equilibria,
)

BUNDLED = Path(__file__).parent.parent / "datasets" / "bundled" / "elastic-arm"


def dh_flange(geometry, joints):
    """Plain distal Denavit-Hartenberg chain of one configuration, written out by hand."""
    out = np.eye(4)
    for (theta, d, a, alpha, beta), q in zip(geometry, joints):
        c, s, ca, sa, cb, sb = *_cs(q + theta), *_cs(alpha), *_cs(beta)
        turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        shift = np.array([[1, 0, 0, a], [0, 1, 0, 0], [0, 0, 1, d], [0, 0, 0, 1]])
        twist = np.array([[1, 0, 0, 0], [0, ca, -sa, 0], [0, sa, ca, 0], [0, 0, 0, 1]])
        lean = np.array([[cb, 0, sb, 0], [0, 1, 0, 0], [-sb, 0, cb, 0], [0, 0, 0, 1]])
        out = out @ turn @ shift @ twist @ lean
    return out


def _cs(angle):
    return np.cos(angle), np.sin(angle)


@pytest.fixture
def arm():
    return elastic_arm.true_arm(np.random.default_rng(3))


@pytest.fixture
def readings():
    return np.random.default_rng(4).uniform(-1.5, 1.5, (12, 6))


def rigid(arm):
    return replace(arm, joint_compliance=0.0, link_compliance=0.0, pedestal_compliance=(0.0, 0.0))


def place(flange):
    return flange[:, :3, 3]


def test_rigid_arm_is_plain_dh(arm, readings):
    expected = [dh_flange(arm.geometry, q) for q in readings]
    np.testing.assert_allclose(static_equilibria(rigid(arm), readings).flange, expected, atol=1e-9)


def test_vanishing_compliance_tends_to_rigid(arm, readings):
    soft = replace(rigid(arm), joint_compliance=1e-12)
    np.testing.assert_allclose(
        place(static_equilibria(soft, readings).flange),
        place(static_equilibria(rigid(arm), readings).flange),
        atol=1e-6,
    )


def test_mixing_couples_readings(arm, readings):
    mixing = np.eye(6)
    mixing[2, 1], mixing[5, 5] = 1.0, -1.0
    coupled = static_equilibria(rigid(replace(arm, mixing=mixing)), readings).flange
    expected = [dh_flange(arm.geometry, mixing @ q) for q in readings]
    np.testing.assert_allclose(coupled, expected, atol=1e-9)


def test_pendulum_sags_by_its_weight_times_lever():
    geometry = np.array([[0.0, 0, 500, 0, 0]])
    arm = Arm(
        geometry,
        np.array([3.0]),
        np.array([[-200.0, 0, 0]]),
        np.eye(1),
        1.0,
        (0, 0, 0),
        joint_compliance=1e-5,
        gravity=(0, -1, 0),
    )
    still = static_equilibria(arm, np.array([[0.4]]), payload_kg=0.5)
    angle = 0.4 + still.deflection[0, 2]
    torque = -STANDARD_GRAVITY * np.cos(angle) * (3.0 * 0.3 + 1.5 * 0.5)
    assert still.deflection[0, 2] == pytest.approx(1e-5 * torque, rel=1e-9)


def test_cantilever_bends_at_its_middle():
    arm = Arm(
        np.array([[0.0, 0, 400, 0, 0]]),
        np.zeros(1),
        np.zeros((1, 3)),
        np.eye(1),
        2.0,
        link_compliance=1e-5,
        gravity=(0, 0, -1),
    )
    still = static_equilibria(arm, np.zeros((1, 1)))
    # a weight at the tip, 200 mm from the hinge at mid-link
    assert place(still.flange)[0, 2] == pytest.approx(
        -200 * 1e-5 * 2.0 * STANDARD_GRAVITY * 0.2, rel=1e-6
    )


def test_pedestal_leans_toward_the_load():
    arm = Arm(
        np.array([[0.0, 500, 300, 0, 0]]),
        np.zeros(1),
        np.zeros((1, 3)),
        np.eye(1),
        2.0,
        pedestal_compliance=(0.0, 1e-5),
    )
    moved = place(static_equilibria(arm, np.zeros((1, 1))).flange)[0] - [300, 0, 500]
    tilt = 1e-5 * 2.0 * STANDARD_GRAVITY * 0.3
    np.testing.assert_allclose(moved, [500 * tilt, 0, -300 * tilt], rtol=1e-3, atol=1e-9)


def test_deflection_doubles_with_compliance(arm, readings):
    stiff = replace(
        arm,
        joint_compliance=arm.joint_compliance / 100,
        link_compliance=arm.link_compliance / 100,
        pedestal_compliance=tuple(np.array(arm.pedestal_compliance) / 100),
    )
    soft = replace(
        arm,
        joint_compliance=arm.joint_compliance / 50,
        link_compliance=arm.link_compliance / 50,
        pedestal_compliance=tuple(np.array(arm.pedestal_compliance) / 50),
    )
    still = place(static_equilibria(rigid(arm), readings).flange)
    one, two = (place(static_equilibria(a, readings).flange) - still for a in (stiff, soft))
    np.testing.assert_allclose(two, 2 * one, atol=1e-3 * np.abs(two).max())


def test_springs_balance_gravity(arm, readings):
    still = static_equilibria(arm, readings, payload_kg=np.linspace(0, 2, 12))
    assert still.imbalance.max() < 1e-9
    springs = still.deflection[:, 2::3] / arm.joint_compliance
    np.testing.assert_allclose(springs, still.torque[:, 2::3], rtol=1e-6, atol=1e-6)


def test_gravity_torque_is_the_slope_of_potential_energy(arm, readings):
    """Power balance: the torque at joint k is minus the change of m g h with its angle."""
    payload, h = 1.7, 1e-5
    arm = replace(rigid(arm), mass=np.zeros(6), tool_mass=0.4)
    torque = static_equilibria(arm, readings, payload_kg=payload).torque[:, 2::3]

    def energy(q):
        flange = static_equilibria(arm, q).flange
        height = (flange[:, :3, :3] @ np.array(arm.tool_com) + place(flange))[:, 2] / 1e3
        return (payload + 0.4) * STANDARD_GRAVITY * height

    slope = np.column_stack(
        [(energy(readings + h * u) - energy(readings - h * u)) / (2 * h) for u in np.eye(6)]
    )
    np.testing.assert_allclose(torque, -slope, atol=1e-6)


def test_rest_is_a_minimum_of_energy(readings):
    """Total energy, springs and weight, is stationary at rest for a load on elastic joints."""
    arm = replace(
        elastic_arm.true_arm(np.random.default_rng(3)),
        mass=np.zeros(6),
        link_compliance=0.0,
        pedestal_compliance=(0.0, 0.0),
    )
    still = static_equilibria(arm, readings)
    bend, h = still.deflection[:, 2::3], 1e-5

    def energy(b):
        flange = static_equilibria(rigid(arm), readings, b).flange
        height = (flange[:, :3, :3] @ np.array(arm.tool_com) + place(flange))[:, 2] / 1e3
        return arm.tool_mass * STANDARD_GRAVITY * height + 0.5 * np.sum(
            b**2 / arm.joint_compliance, axis=1
        )

    slope = np.column_stack(
        [(energy(bend + h * u) - energy(bend - h * u)) / (2 * h) for u in np.eye(6)]
    )
    assert np.abs(slope).max() < 1e-5 * np.abs(still.torque).max()


def test_too_soft_an_arm_is_refused(arm, readings):
    with pytest.raises(StaticsError, match="too soft"):
        static_equilibria(replace(arm, joint_compliance=1.0), readings)


def test_other_conventions_are_refused():
    with pytest.raises(ValueError, match="distal"):
        arm_from_robot(elastic_arm.robot() | {"convention": "craig"})


def test_drive_errors_follow_their_laws():
    q = np.deg2rad([[10.0, 20], [30, 40], [50, 60]])
    approach = np.array([[1.0, 1], [-1, -1], [0, 1]])
    error = drive_errors(
        q, [Harmonic(2, 2, 1e-3, 2e-3)], [Slip(1, 1, 5e-4)], [Gap(1, 1e-4)], approach
    )
    np.testing.assert_allclose(error[:, 0], [1e-4, 5e-4 - 1e-4, 5e-4])
    np.testing.assert_allclose(error[:, 1], 1e-3 * np.cos(2 * q[:, 1]) + 2e-3 * np.sin(2 * q[:, 1]))


def test_a_gap_needs_the_approach():
    with pytest.raises(ValueError, match="last motion"):
        drive_errors(np.zeros((2, 3)), gaps=[Gap(1, 1e-4)])


def test_points_are_seen_in_their_frames(arm, readings):
    """A ball seen in the sensor and carried back by hand lies at its place on the artefact."""
    flange = static_equilibria(arm, readings).flange
    artefact, hand_eye = pose((5, 6, 7), (10, 20, 30)), pose((1, 2, 3), (-5, 15, 25))
    ball = np.tile([100.0, 50, 25], (12, 1))
    seen = ball_points(flange, ball, artefact, hand_eye)
    back = [artefact @ f @ hand_eye @ [*p, 1] for f, p in zip(flange, seen)]
    np.testing.assert_allclose(np.array(back)[:, :3], ball, atol=1e-9)
    origin = reflector_points(flange, hand_eye[:3, 3], artefact)
    np.testing.assert_allclose(
        origin, [(artefact @ f @ hand_eye)[:3, 3] for f in flange], atol=1e-9
    )


def test_ye_arm_has_the_torques_of_equation_25():
    table = ye.SECOND
    arm = replace(rigid(ye.true_arm(table)), tool_mass=0.0)
    exact = arm.geometry.copy()
    exact[:, [0, 3]] = np.deg2rad([row[::3] for row in ye._NOMINAL])
    q = np.random.default_rng(1).uniform(-1, 1, (5, 6))
    torque = static_equilibria(replace(arm, geometry=exact), q).torque
    lever1 = table.s1_mm * np.sin(q[:, 1])
    lever2 = table.s2_mm * np.sin(q[:, 1] - q[:, 2])
    newton = ye.LOAD_N / 1e3
    np.testing.assert_allclose(torque[:, 5], newton * (lever1 + lever2), rtol=1e-9)
    np.testing.assert_allclose(torque[:, 8], -newton * lever2, rtol=1e-9)
    np.testing.assert_allclose(torque[:, 2], 0, atol=1e-9)


def test_ye_second_experiment_is_reproducible_and_as_noisy_as_stated():
    quiet, noisy = (ye.ye_second_experiment(200, seed=5, noise_mm=s) for s in (1e-9, 0.02))
    points = [
        np.column_stack([m.columns[c] for c in ("x_mm", "y_mm", "z_mm")]) for m in (quiet, noisy)
    ]
    assert np.std(points[1] - points[0]) == pytest.approx(0.02, rel=0.1)
    assert np.ptp(quiet.columns["q2_deg"]) > 40
    again = ye.ye_second_experiment(200, seed=5, noise_mm=0.02)
    assert folder.files(again) == folder.files(noisy)


def test_ye_first_experiment_sees_every_ball_at_working_distance():
    made = ye.ye_first_experiment(80)
    z = made.columns["z_mm"]
    assert set(made.columns["ball"]) == {1, 2, 3, 4}
    assert 110 < z.min() and z.max() < 140


def test_bundled_recording_is_made_again_exactly():
    texts = folder.files(elastic_arm.make())
    assert set(texts) == {path.name for path in BUNDLED.iterdir()}
    for name, text in texts.items():
        assert (BUNDLED / name).read_text(encoding="utf-8") == text, name


def test_bundled_recording_is_small_and_holds_no_answer():
    assert sum(path.stat().st_size for path in BUNDLED.iterdir()) < 150_000
    words = " ".join(path.read_text(encoding="utf-8").lower() for path in BUNDLED.iterdir())
    assert not any(word in words for word in ("seed", "slip", "backlash", "gap", "compliance"))
