"""When structure that the findings leave makes a diagnosis unexplained."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from test_diagnosis_answer import GAP, made, term
from workbench.diagnosis.linear.problem import Found
from workbench.diagnosis.robot.bench import bench_of
from workbench.explanation.result import Proof, has_unexplained_structure, verdict_of
from workbench.explanation.unexplained import contains_unexplained_structure, next_to_data_findings


@pytest.mark.parametrize("p_value, left", [(0.0069, False), (0.001, True)])
def test_structure_next_to_findings_counts_as_where_nothing_was_found(p_value, left):
    """Findings on the noise take nothing off the error, of which therefore everything seems to be left."""
    noise = term(0.99, effect="stated-noise")
    proof = Proof(0.2, 0.2, 0.2, 0.0, 5, 0.02, "stated", np.zeros((2, 1)), np.zeros(1))
    arm, found = SimpleNamespace(chain=object()), SimpleNamespace(p_remainder=p_value)
    assert contains_unexplained_structure(arm, found, [noise], proof, False) is left
    law = replace(term(0.99), finding=replace(term(0.99).finding, effects=(object(),)))
    assert contains_unexplained_structure(arm, found, [law], proof, False) is left


@pytest.mark.parametrize("after, left", [(0.03, False), (0.15, True), (0.2, True)])
def test_what_leaves_most_of_the_mismatch_has_not_explained_it(after, left):
    proof = Proof(0.2, after, after, 9.0, 5, 0.02, "stated", np.zeros((2, 1)), np.zeros(1))
    assert has_unexplained_structure(proof, 1e-9) == left and not has_unexplained_structure(
        proof, 0.5
    )
    assert (
        verdict_of((term(0.99),), 1e-9, has_unexplained_structure(proof, 1e-9)) == "unexplained"
    ) == left
    assert has_unexplained_structure(proof, 1e-9, is_above=True) and not has_unexplained_structure(
        proof, 0.5, is_above=True
    )


def test_uncertainty_of_the_parameters_is_no_remainder():
    """Noise of 0.02 mm and thirty parameters leave 0.0209 mm of a right model: that is all explained."""
    proof = Proof(0.022, 0.0209, 0.0209, 9.0, 5, 0.02, "stated", np.zeros((2, 1)), np.zeros(1))
    assert has_unexplained_structure(proof, 1e-9)
    assert not has_unexplained_structure(replace(proof, variance_factors=(1.09, 1.1)), 1e-9)


@pytest.mark.parametrize("gap", [True, False])
def test_outliers_alone_leave_the_structure_of_all_other_samples(gap, tmp_path):
    """What the search found and validation refused is in no retained term; outliers take nothing off it."""
    bench = bench_of(made(tmp_path, effect=[GAP] if gap else []))
    problem = bench.problem(())
    outliers = np.arange(problem.n) < 2
    found = Found((), problem, problem, 1e-9, 0.5, (), (), outliers)
    retained = [term(0.99, effect="outliers")]
    refused = [replace(term(0.99), kept=False)]
    proved = SimpleNamespace(t=0.0)
    left = next_to_data_findings(bench, found, retained, refused, proved)
    assert (left.p_remainder < 1e-3) is gap
    assert contains_unexplained_structure(bench, left, retained, proved, False) is gap
    assert next_to_data_findings(bench, found, retained, [], proved) is found
