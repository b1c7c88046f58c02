"""Laws of the effects of real arms: compliance without masses, loads, steps, warm-up, friction and the instrument."""

import tomllib
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from robot_model import load_robot
from robot_model.effects import CATALOGUE
from robot_model.effects.friction import lattice_step
from robot_model.effects.instrument import sight_lines
from robot_model.effects.unknown_masses import bar_moments, base_columns
from robot_model.load_mass import load_masses
from robot_model.stiffness import LOADS_AND_MASSES, PRODUCT, stiffness_rows
from scenes import ABB, CRAIG, SLIDING, SLIDING_CRAIG, model_of, scene
from workbench.core.covariates import MotionHistory
from workbench.core.effect import numeric_derivative
from workbench.core.model import Model
from workbench.diagnosis.linear.hypotheses import ranked_hypotheses
from workbench.diagnosis.robot.bench import bench_of
from workbench.jobs.robot.calibrate import calibrate


def state_of(arm=ABB, n=60, measures="external-point", seed=4):
    """The state of a simulated recording."""
    return model_of(scene(measures, n=n, arm=arm, seed=seed)).chain.state


@pytest.mark.parametrize("arm", [ABB, CRAIG], ids=["abb", "craig"])
def test_base_moments_make_the_torque_of_any_masses(arm):
    """Every joint's torque under the true masses is a combination of the base columns, and no column is redundant."""
    state = state_of(arm)
    for joint in range(1, 6):
        effect = CATALOGUE["gravity-compliance"](f"joint-{joint + 1}")
        columns = effect.basis(state)[1:, 0].T
        torque = state.self_torque[joint]
        left = torque - columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]
        assert np.abs(left).max() <= 1e-9 * max(np.abs(torque).max(), 1.0)
        assert np.linalg.matrix_rank(columns, tol=1e-6) == len(base_columns(state.robot, joint))


def test_a_sag_is_that_of_the_stretched_arm():
    """Unit moments of bars are at most 1, and their shares add up to 1."""
    moments, shares = bar_moments(state_of(), 1)
    assert np.sqrt((moments**2).sum(1)).max() <= 1 + 1e-12
    assert shares.sum() == pytest.approx(1)


@pytest.mark.parametrize("name", ["bearing-compliance", "gravity-bearing-compliance"])
@pytest.mark.parametrize("arm", [ABB, CRAIG], ids=["abb", "craig"])
def test_a_bearing_turns_about_its_joint_axis(name, arm):
    """The point on the axis of joint 4 about which the moment is taken stays; the rotation is across the axis."""
    state = state_of(arm)
    effect, number = CATALOGUE[name]("joint-4"), 4
    twist = effect.basis(state)[0]
    link = state.frames.link[number]
    shift, turn = (np.einsum("cin,cn->in", link, part) for part in (twist[:3], twist[3:]))
    axis = state.frames.z[number - 1]
    assert np.abs((turn * axis).sum(0)).max() <= 1e-9 * np.abs(turn).max()
    point = state.frames.z_origin[number - 1]
    moved = shift + np.cross(turn, point - state.frames.pivot[number], axis=0)
    assert np.abs(moved).max() <= 1e-9 * max(np.abs(shift).max(), 1.0)


def without_masses(recording):
    """The recording with the masses taken out of its robot file."""
    robot = dict(recording.robot)
    if "builtin" in robot:
        file = resources.files("robot_model").joinpath("robots", f"{robot['builtin']}.toml")
        robot = tomllib.loads(file.read_text())
    robot.pop("payload", None)
    hidden = ("mass_kg", "com_mm")
    rows = robot.get("joint", [])
    robot["joint"] = [{k: v for k, v in row.items() if k not in hidden} for row in rows]
    return replace(recording, robot=robot)


@pytest.mark.slow
def test_without_masses_the_held_out_error_is_nearly_that_with_masses(recording):
    """ABB IRB 120 with a probe arm: the product of compliance and first moment serves as well, within 10 %."""
    known = recording("irb120_wu_arm")
    hidden = without_masses(known)
    assert (
        not load_robot(hidden.robot, "robot").mass.any() and load_robot(known.robot, "r").mass.any()
    )
    with_masses, without = (calibrate(one) for one in (known, hidden))
    assert without.held_out["rms_mm"] <= 1.1 * with_masses.held_out["rms_mm"]
    compliance = next(stage for stage in without.stages if stage.name == "compliance")
    assert compliance.earned
    assert all(row["known_from"] == PRODUCT for row in without.as_json()["stiffness"])


def test_a_payload_adds_its_own_torque():
    state = state_of()
    effect = CATALOGUE["payload"]("tool")
    mass, centre = 2.0, np.array([10.0, -20.0, 50.0])
    p = np.append(mass, mass * centre)
    model = model_of(scene("external-point", n=60, seed=4))
    changed = state.altered([("mass", effect.port_indices(model.chain), effect.delta(p, state))])
    heavier = replace(state, payload=np.full(state.n, mass), load_centre=centre)
    expected = heavier.torque - replace(state, payload=np.zeros(state.n)).torque
    np.testing.assert_allclose(changed.torque - state.torque, expected, atol=1e-9)


def test_a_payload_after_an_instant_is_absent_before_it():
    state = state_of()
    effect = CATALOGUE["payload"]("tool", after=float(np.median(state.covariates["time_s"])))
    late = state.covariates["time_s"] > effect.after
    basis = effect.basis(state)
    assert not basis[..., ~late].any() and basis[..., late].any()


def test_a_change_of_load_deflects_every_joint_by_its_compliance_and_tells_the_mass():
    """The law with one number a joint and one centre makes exactly what a load makes of known compliances."""
    model = model_of(scene("external-point", n=60, seed=4))
    state = model.chain.state
    mass, offset = 2.5, np.array([40.0, -60.0, 30.0])
    compliance = np.array([2e-5, 3e-5, 4e-5, 9e-5, 8e-5, 1e-4])
    unloaded = replace(state, payload=np.zeros(state.n))
    loaded = replace(
        unloaded, payload=np.full(state.n, mass), load_centre=state.load_centre + offset
    )
    effect = CATALOGUE["load-deflection"]("tool", after=-1e9)
    p = np.concatenate([compliance * mass * 9.80665, offset])
    expected = compliance[:, None] * (loaded.torque - unloaded.torque)
    np.testing.assert_allclose(effect.delta(p, unloaded), expected, atol=1e-12)
    numeric = numeric_derivative(lambda x: effect.delta(x, unloaded), p, 1e-6)
    np.testing.assert_allclose(effect.derivative(p, unloaded), numeric, atol=1e-8)
    joints = [CATALOGUE["joint-compliance"](f"joint-{k}") for k in (2, 3)]
    whole = Model(model.chain, (*joints, effect))
    values = whole.parameters.values.copy()
    for number, span in zip((1, 2), whole.spans):
        values[span] = compliance[number]
    values[whole.spans[-1]] = p
    found = load_masses(whole, values, np.diag((1e-3 * np.abs(values) + 1e-12) ** 2))
    assert found[0].start == whole.spans[-1].start
    assert abs(found[0].kg - mass) < 1e-9 and 0 < found[0].std_kg < 0.01


def test_a_beam_is_a_flexure_where_its_root_and_tip_carry_the_same_moment():
    """Without weight beyond the link the moments at root and tip agree."""
    state = state_of()
    bare = replace(state.robot, mass=np.zeros(6))
    state = replace(state, robot=bare, payload=np.zeros(state.n))
    beam = CATALOGUE["link-beam"]("link-2").basis(state)
    assert not beam[0, :3].any()


def test_a_shift_is_zero_before_its_instant():
    state = state_of()
    after = float(np.median(state.covariates["time_s"]))
    basis = CATALOGUE["shift"]("base", after=after).basis(state)
    early = state.covariates["time_s"] <= after
    assert not basis[..., early].any() and (basis[range(6), range(6)][:, ~early] == 1).all()


def test_warming_up_starts_with_its_rate_and_ends_at_one():
    state = state_of()
    time = state.covariates["time_s"]
    effect = CATALOGUE["warm-up"]("joint-2", time_constant=1e6, start=float(time.min()))
    np.testing.assert_allclose(effect.basis(state)[0, 0], (time - time.min()) / 1e6, rtol=1e-3)
    quick = CATALOGUE["warm-up"]("joint-2", time_constant=1e-3, start=float(time.min()) - 1)
    np.testing.assert_allclose(quick.basis(state), 1)


def test_friction_is_fully_wound_up_by_long_moves():
    moves = np.array([[1.0, -2.0, 0.5, -0.7]])
    state = MotionHistory.of(moves, np.arange(4.0)).wound_up(1, 0.003)
    np.testing.assert_allclose(state, np.sign(moves[0]))


def test_friction_is_released_linearly_and_remembers_short_moves():
    """From fully wound up, a move back by half the width leaves half of it; then forward again to where it was."""
    moves = np.array([[5.0, -0.05, 0.05]])
    state = MotionHistory.of(moves, np.arange(3.0)).wound_up(1, 0.1)
    assert state[1] == pytest.approx(0.5)
    assert state[2] == pytest.approx(1 - 0.5 * np.exp(-0.5))


def test_rows_of_one_pose_share_the_state_of_friction():
    moves = np.array([[0.02, 0.02, 0.02, -0.01]])
    state = MotionHistory.of(moves, np.arange(4.0)).wound_up(1, 0.1)
    assert state[0] == state[1] == state[2] != state[3]


def test_some_samples_remember_the_moves_to_all_others():
    moves = np.array([[0.05, -0.02, 0.03, -0.07, 0.01]])
    history = MotionHistory.of(moves, np.arange(5.0))
    np.testing.assert_array_equal(
        history.at(np.array([1, 4])).wound_up(1, 0.04), history.wound_up(1, 0.04)[[1, 4]]
    )


@pytest.mark.parametrize(
    ("of_dahl", "slope"),
    [
        (False, lambda z, step: 1 - abs(z) * (1 + np.sign(z * step)) / 2),
        (True, lambda z, step: 1 - z * np.sign(step)),
    ],
    ids=["bouc-wen", "dahl"],
)
def test_the_state_of_friction_solves_its_differential_equation(of_dahl, slope):
    """Small steps of width dz/dq along the same moves."""
    moves, width = np.array([0.08, -0.05, -0.2, 0.3, -0.02]), 0.1
    z, expected = 0.0, []
    for move in moves:
        for step in np.full(20000, move / 20000):
            z += step * slope(z, step) / width
        expected.append(z)
    state = MotionHistory.of(moves[None], np.arange(5.0)).wound_up(1, width, of_dahl)
    np.testing.assert_allclose(state, expected, atol=1e-4)


@pytest.mark.parametrize("law", ["bouc-wen", "dahl"])
def test_the_law_by_which_friction_releases_is_found(law):
    """A joint that stays behind its reading by a state of friction that is computed here, move by move."""
    width, size, n = 0.3, 1e-3, 80
    made = scene("external-point", n=n, seed=8, sigma=0.02)
    angle = np.deg2rad(made.recording.columns["q3_deg"])
    z, states = 0.0, []
    for move in np.diff(angle, prepend=angle[0]):
        side = np.sign(move)
        along, length = z * side, abs(move) / width
        if law == "bouc-wen" and along < 0:
            released = min(-along, length)
            along, length = along + released, length - released
        if length:
            along = 1 - (1 - along) * np.exp(-length)
        z = along * side if side else z
        states.append(z)
    behind = np.rad2deg(size * np.array(states))
    columns = made.recording.columns | {"q3_deg": made.recording.columns["q3_deg"] + behind}
    columns = {k: x for k, x in columns.items() if not k.startswith(("approach", "qdot"))}
    problem = bench_of(replace(made.recording, columns=columns)).problem()
    first = ranked_hypotheses(problem)[0]
    assert (first.effect, first.where) == ("joint-hysteresis", "joint-3")
    assert first.effects[0].law == law and first.effects[0].width == pytest.approx(width)


@pytest.mark.parametrize("step", [0.01, 0.0137, 0.5])
def test_a_lattice_is_recognised_from_the_readings(step):
    readings = step * np.random.default_rng(1).integers(-4000, 4000, 400)
    assert lattice_step(readings) == pytest.approx(step, rel=1e-6)


def test_readings_that_are_not_rounded_show_no_lattice():
    rng = np.random.default_rng(2)
    assert lattice_step(rng.uniform(-90, 90, 400)) is None
    assert lattice_step(np.repeat([0.0, 90.0], 50)) is None


def test_refraction_shifts_across_the_sight_line_with_the_square_of_the_range():
    state = state_of()
    sight, distance = sight_lines(state)
    moved = CATALOGUE["sight-line-refraction"]("instrument").basis(state)
    assert np.abs(np.einsum("pin,in->pn", moved, sight)).max() < 1e-9
    far = replace(state, measured=2 * state.measured)
    twice = CATALOGUE["sight-line-refraction"]("instrument").basis(far)
    np.testing.assert_allclose(twice, 4 * moved, rtol=1e-9)


def test_stiffness_is_stated_only_where_masses_are_known():
    made = scene("external-point", n=60, seed=4)
    terms = [("joint-compliance", "joint-2", {}), ("gravity-compliance", "joint-3", {})]
    model = model_of(made, *terms)
    values = model.parameters.values.copy()
    first = [span.start for span in model.spans]
    values[first] = 2e-5, 3e-4
    parameters = replace(model.parameters, values=values, mask=np.ones(len(values), bool))
    std = {parameters.table[k].key: 1e-6 for k in first}
    known, product = stiffness_rows(model, parameters, std)
    assert known.known_from == LOADS_AND_MASSES and known.stiffness == pytest.approx(5e4)
    assert product.known_from == PRODUCT and product.stiffness is None and product.unit == "rad"


@pytest.mark.parametrize("arm", [SLIDING, SLIDING_CRAIG], ids=["standard", "modified"])
def test_base_moments_and_carried_masses_make_the_moments_of_an_arm_with_slides(arm):
    """What a slide carries loads the base and the joints before it by its mass times a lever that changes."""
    state = state_of(arm, n=80)
    state = replace(state, payload=np.zeros(state.n))
    laws = [("gravity-compliance", f"joint-{k}", state.self_torque[k - 1]) for k in (1, 3, 5)]
    for name, where, torque in laws:
        columns = CATALOGUE[name](where).basis(state)[1:, 0].T
        left = torque - columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]
        assert np.abs(left).max() <= 1e-7 * max(np.abs(torque).max(), 1.0)
    pairs = [
        ("gravity-pedestal-compliance", "base", "pedestal-compliance"),
        ("gravity-bearing-compliance", "joint-1", "bearing-compliance"),
        ("gravity-link-compliance", "link-1", "link-compliance"),
    ]
    for gravity, where, stated in pairs:
        law = CATALOGUE[gravity](where)
        twist = CATALOGUE[stated](where).basis(state).sum(0)
        columns = law.basis(state)[1:].reshape(-1, twist.size).T
        # about another fixed point the moment differs by a constant, which the base follows
        constant = np.kron(np.eye(len(twist)), np.ones((state.n, 1)))
        columns = np.hstack([columns, constant]) if where == "base" else columns
        left = twist.ravel() - columns @ np.linalg.lstsq(columns, twist.ravel(), rcond=None)[0]
        assert np.abs(left).max() <= 1e-6 * np.abs(twist).max()
        chain = model_of(scene("external-point", n=20, arm=arm, seed=4)).chain
        assert any(row.key.endswith("_mass") for row in law.table(chain))
