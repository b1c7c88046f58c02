"""A step has the place with the highest evidence, and lists every other place that explains it about as well."""

from types import SimpleNamespace

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import SIGMA, recorded
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.noise.serial_correlation import log_evidence
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.validation.step_places import with_step_places
from workbench.diagnosis.validation.terms import Term

AFTER = 20.0 * 27.5
TWIST = np.array([10.0, -8.0, 6.0, 0.02, 0.03, -0.025]) * SIGMA


def compared(truth, values, named, more=None, seed=1):
    """The finding of a step at `named` in a recording with a step at `truth`; both (effect, place)."""
    step = CATALOGUE[truth[0]](truth[1], AFTER)
    made = recorded(seed, [step], values, n=60, more=more)
    wrong = CATALOGUE[named[0]](named[1], AFTER)
    finding = Finding(*named, "after 550 s", (wrong,), 1e-6, 0.99, 1.0, 30.0)
    (term,) = with_step_places(bench_of(made), [Term(finding)])
    return term.finding


@pytest.mark.parametrize(
    ("joint", "named"),
    [
        (1, "base"),
        (1, "link-1"),
        (2, "link-2"),
        (3, "link-3"),
        (4, "link-4"),
        (5, "link-5"),
        (6, "tool"),
    ],
)
@pytest.mark.parametrize("size", [4e-4, 4e-3])
def test_the_jump_of_a_zero_is_no_move_of_a_part_that_makes_it_with_more_numbers(
    joint, named, size
):
    found = compared(("zero-shift", f"joint-{joint}"), [size * (1 + joint // 4)], ("shift", named))
    assert (found.effect, found.where) == ("zero-shift", f"joint-{joint}")
    assert found.effects[0].after == AFTER and found.probability > 0.5


@pytest.mark.parametrize(
    ("where", "named"),
    [("base", "joint-1"), ("tool", "joint-6"), ("link-2", "joint-3"), ("link-4", "joint-4")],
)
def test_a_part_that_moved_is_no_jump_of_a_zero(where, named):
    found = compared(("shift", where), TWIST, ("zero-shift", named))
    assert (found.effect, found.where) == ("shift", where)


def test_parts_with_a_joint_between_them_that_hardly_moves_are_listed():
    """Joint 1 moves over a fifth of a degree: the base and the link behind it move the reflector alike."""
    rng = np.random.default_rng(4)
    more = {"q1_deg": 17.0 + rng.uniform(-0.1, 0.1, 60)}
    found = compared(("shift", "base"), TWIST, ("shift", "tool"), more)
    names = {(found.effect, found.where), *((a.effect, a.where) for a in found.alternatives)}
    assert {("shift", "base"), ("shift", "link-1")} <= names
    total = found.probability + sum(a.probability for a in found.alternatives)
    assert found.probability < 0.9 < total <= 1 + 1e-9


def test_a_tool_that_rotated_is_no_reflector_that_moved():
    """Means of poses show only the mean move of three reflectors; their differences show that all of them moved."""
    poses, n = np.repeat(np.arange(40), 3), 120
    reflector, is_after = np.tile(np.arange(3), 40), np.repeat(np.arange(40) >= 20, 3)
    known = np.stack([reflector == k for k in range(3)], 1).astype(float)
    known /= np.linalg.norm(known, axis=0)
    turn = np.stack([is_after * 1.0, is_after * np.array([1.0, -1.0, 0.0])[reflector]], 1)
    moved = (is_after & (reflector == 0))[:, None] * 1.0
    residual = turn @ [1.0, 6.0] + np.random.default_rng(2).normal(0, 1, n)

    def problem(columns):
        basis = np.linalg.qr(np.hstack([known, columns]))[0]
        return SimpleNamespace(
            n=n,
            pose=poses,
            order=np.arange(n),
            residual=residual,
            full_basis=basis,
            orthogonalise=lambda x: x - basis @ (basis.T @ x),
        )

    base = problem(np.zeros((n, 0)))
    gain = log_evidence(base, problem(turn)) - log_evidence(base, problem(moved))
    assert gain > 20
