"""The arm on torch gives what the arm in numpy gives: frames, derivatives and normal equations, in both precisions."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from datasets.recording import Recording
from robot_model import load_robot
from robot_model.effects import CATALOGUE
from robot_model.poses import pose_values
from robot_model.system import bind
from workbench.core.effect import make_effects
from workbench.core.least_squares import batched
from workbench.core.model import Model
from workbench.core.rigid import rotation_matrix, transform

pytestmark = pytest.mark.skipif(find_spec("torch") is None, reason="torch is not installed")
BASE = transform(rotation_matrix(np.array([0.1, -0.2, 2.0])), np.array([1500.0, 300.0, -200.0]))
TOOL = np.array([[0.0, 30.0, 120.0], [60.0, 0.0, 120.0]])
ARMS = ["distal", "craig", "sliding"]
N = 500


@pytest.fixture(scope="module")
def torch():
    """Loaded with the first test that needs it: that takes seconds."""
    return pytest.importorskip("torch")


def robot_of(kind):
    """An arm with errors in every number of its geometry; of the last kind its second joint slides."""
    rng = np.random.default_rng(5)
    arm = load_robot({"builtin": "abb_irb120"}, "robot")
    geometry = arm.geometry + rng.normal(size=arm.geometry.shape) * [0.01, 1, 1, 0.01, 0.01]
    slides = np.arange(6) == 1 if kind == "sliding" else arm.prismatic
    return replace(
        arm,
        geometry=geometry,
        prismatic=slides,
        convention="craig" if kind == "craig" else "distal",
    )


def model_of(kind):
    """The arm bound to points that are off, with the torsion of joint 3, and parameters at its true geometry."""
    arm, rng = robot_of(kind), np.random.default_rng(6)
    readings = rng.uniform(-2, 2, (N, 6)) * np.where(arm.prismatic, 80, 1)
    columns = {"sample": np.arange(N, dtype=float), "reflector": np.arange(N) % 2 + 1.0}
    columns |= {
        f"q{k}_{'mm' if s else 'deg'}": q if s else np.rad2deg(q)
        for k, (q, s) in enumerate(zip(readings.T, arm.prismatic), 1)
    }
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), rng.normal(size=(3, N)) * 500))
    start = np.concatenate([pose_values(BASE[:3, :3], BASE[:3, 3]), TOOL.ravel()])
    chain = bind(
        arm, Recording("external-point", columns, {"builtin": "abb_irb120"}, sigma_mm=0.05), start
    )
    model = Model(chain, make_effects(CATALOGUE, [("joint-compliance", "joint-3", {})]))
    key = "joint-3.joint-compliance.compliance"
    own = [k for k in model.parameters.keys if not k.startswith("base.")]
    return model, model.parameters.free(*own).update({key: 1e-4})


def torch_sums(model, single, where="cpu"):
    chain = model.chain
    arm = batched.Arm(
        chain.robot.geometry,
        chain.robot.prismatic,
        chain.robot.convention,
        chain.robot.base,
        chain.robot.flange,
    )
    bent = [batched.JointEffect(2, chain.state.torque[2], 1e-4)]
    index = chain.measurement.index
    return batched.normal_equations(
        arm,
        chain.variables,
        BASE,
        TOOL,
        index,
        chain.measurement.measured,
        0.05,
        bent,
        where,
        single,
    )


@pytest.mark.parametrize("kind", ARMS)
@pytest.mark.parametrize(("single", "bound"), [(False, 1e-9), (True, 1e-4)])
def test_normal_equations_are_those_of_the_arm_in_numpy(kind, single, bound):
    model, parameters = model_of(kind)
    residual, rows = model.linearise(parameters)
    flat = rows.reshape(len(rows), -1) / 0.05
    white = residual.ravel() / 0.05
    normal, gradient, squares = torch_sums(model, single)
    # columns of the base come first; those of the base's turn are about other axes than pose values
    scale = np.sqrt(np.diag(flat @ flat.T))
    assert np.abs((normal[6:, 6:] - flat @ flat.T) / np.outer(scale, scale)).max() < bound
    assert np.abs((gradient[6:] - flat @ white) / scale).max() < bound * np.linalg.norm(white)
    assert squares == pytest.approx(white @ white, rel=bound)


@pytest.mark.parametrize("kind", ARMS)
def test_columns_of_the_base_are_its_shift_and_turn(kind, torch):
    model, _ = model_of(kind)
    chain = model.chain
    arm = batched.Arm(
        chain.robot.geometry,
        chain.robot.prismatic,
        chain.robot.convention,
        chain.robot.base,
        chain.robot.flange,
    )
    variables, index = torch.as_tensor(chain.variables), torch.as_tensor(chain.measurement.index)

    def point(base):
        return batched.derivative(
            arm, batched.forward_kinematics(arm, variables, base), TOOL, index, base, []
        )

    rows = point(BASE)[1][:6].numpy()
    for k, step in enumerate(np.eye(6) * 1e-6):
        moved = []
        for sign in (1, -1):
            twist = sign * step
            turned = transform(rotation_matrix(twist[3:]) @ BASE[:3, :3], BASE[:3, 3] + twist[:3])
            moved.append(point(turned)[0].numpy())
        assert np.abs((moved[0] - moved[1]) / 2e-6 - rows[k]).max() < 1e-4


def test_sums_do_not_depend_on_the_chunks(monkeypatch):
    model, _ = model_of("distal")
    whole = torch_sums(model, False)
    monkeypatch.setattr(batched, "CHUNK", {"cpu": 64})
    parts = torch_sums(model, False)
    assert all(np.allclose(a, b, rtol=1e-12, atol=1e-6) for a, b in zip(whole, parts))


def test_a_graphics_card_gives_the_same(torch):
    if not torch.cuda.is_available():
        pytest.skip("torch finds no graphics card here")
    model, _ = model_of("distal")
    for single, bound in ((False, 1e-9), (True, 1e-4)):
        for here, there in zip(torch_sums(model, single), torch_sums(model, single, "cuda")):
            assert np.abs(np.asarray(here) - there).max() <= bound * np.abs(here).max()
