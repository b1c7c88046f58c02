"""Which parameters are determined one by one: posterior against prior, combinations named once, honest sigmas."""

import numpy as np
import pytest
from rich.console import Console

from workbench.commands.shared import tables
from workbench.core.least_squares.identifiability import identifiability
from workbench.core.least_squares.single_parameters import SingleParameters
from workbench.core.parameters import Parameter, Parameters


def judged(normal, priors, free=None, units=None):
    """The verdicts on parameters p0, p1, ... with these priors (None: none) and typical size 100 without, else prior / 3."""
    units = units or ["mm"] * len(priors)
    table = [
        Parameter(
            f"joint-1.p{k}", unit, 0.0, 100.0 if prior is None else prior / 3, f"number {k}", prior
        )
        for k, (prior, unit) in enumerate(zip(priors, units))
    ]
    parameters = Parameters.of(table)
    asked = parameters.only(np.ones(len(priors), bool))
    known = identifiability(np.asarray(normal, float), asked)
    return SingleParameters.of(known, asked if free is None else parameters.only(np.array(free)))


def weak_direction(count=8, share=0.15):
    """Rows that know p0 well in every direction but one, in which it has a small share."""
    direction = np.r_[share, np.ones(count - 1)] / np.linalg.norm(np.r_[share, np.ones(count - 1)])
    return 1e6 * (np.eye(count) - np.outer(direction, direction))


def test_a_small_share_in_a_weak_direction_does_not_make_a_parameter_unknown():
    """p0 has prior 3 and moves with the weak direction by 0.16: the raw null space marked it as not identifiable."""
    found = judged(weak_direction(), [3.0] + [1.0] * 7)
    assert not found.known.determined[0]
    assert found.determined[0] and 0.01 < found.sigma[0] < 0.2


def test_equal_members_of_a_gauge_are_not_determined():
    pair = judged([[1e6, 1e6], [1e6, 1e6]], [1.0, 1.0])
    assert not pair.determined.any() and pair.combinations == 1
    assert pair.tied() == {"joint-1.p0": ["joint-1.p1"], "joint-1.p1": ["joint-1.p0"]}
    assert "are confounded" in pair.sentences()[0] and len(pair.sentences()) == 1


def test_a_parameter_at_its_prior_is_not_determined():
    found = judged(np.diag([1e4, 0.5]), [1.0, 1.0])
    assert found.determined.tolist() == [True, False] and found.combinations == 1
    assert "number 1" in " ".join(found.sentences())


def test_a_base_coordinate_that_carries_a_held_length_is_uncertain_by_that_prior():
    """Base height and joint offset add up; the offset is held. A tenth of it goes into another coordinate."""
    rows = 1e3 * np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.1]])
    found = judged(rows.T @ rows, [None, None, 3.0], free=[True, True, False])
    assert found.determined.tolist() == [False, True, False]
    assert np.sqrt(found.from_held()["joint-1.p1"]) == pytest.approx(0.3, rel=0.01)
    assert np.sqrt(found.from_held()["joint-1.p0"]) == pytest.approx(3.0, rel=0.01)


def test_every_weak_combination_is_named_once():
    found = judged(1e-3 * np.ones((6, 6)) + 1e-4 * np.eye(6), [1.0] * 6)
    groups = found.groups()
    assert not found.determined.any()
    assert sum(map(len, groups)) == len({key for group in groups for key in group})
    said = " ".join(found.sentences())
    assert all(said.count(f"number {k}") == 1 for k in range(6))


def test_combinations_and_single_parameters_never_contradict():
    rng = np.random.default_rng(4)
    for _ in range(20):
        rows = rng.normal(size=(5, 6)) * 10 ** rng.uniform(-1, 2, 6)
        found = judged(rows.T @ rows, [1.0] * 6)
        assert found.determined.sum() <= found.combinations <= 6


def parameter(name, sure, deviation=0.1):
    return {
        "where": "joint-2",
        "name": name,
        "unit": "mm",
        "value": 1.0,
        "std": 0.01 if sure else None,
        "deviation": deviation,
        "identifiable": sure,
        "status": "estimated" if sure else "not identifiable",
    }


def test_no_table_without_rows():
    console = Console(record=True, width=80)
    tables._parameters(console, [parameter("a2", False)])
    assert "most significant" not in console.export_text()
    assert "0 of 1 parameters are estimated" in tables.unidentified([parameter("a2", False)])


def test_combinations_of_the_geometry_are_stated():
    stage = {"name": "geometry", "identifiable": 27, "free": 33}
    assert tables.combinations([stage]).startswith(
        "27 of 33 combinations of the geometry are identifiable."
    )
    assert tables.combinations([stage | {"free": 27}]) == ""
