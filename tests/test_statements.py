"""Sentences of findings."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from workbench.diagnosis.linear.problem import Alternative, Finding
from workbench.diagnosis.robot.mass_responses import LABEL
from workbench.diagnosis.search.constant_load import UNSTATED_LOAD
from workbench.explanation.reporter import with_numbered_samples
from workbench.explanation.result import Term
from workbench.explanation.sentences import statements


def test_noise_findings_are_described_in_words():
    hidden = Alternative("backlash", "joint-3", "", 0.5, 1.0, "", "approach")
    moving = Term(
        Finding("unknown", "joint-3", "", (), 1e-9, 1.0, 0.3, 40.0, (), (hidden,)), size=0.03
    )
    said = statements.statement(moving, "the ball", "mm")
    assert (
        "random error from sample to sample" in said
        and "the side from which each joint came" in said
    )
    spread = Term(
        Finding("noise-heteroscedastic", "noise", "", (), 1e-9, 1.0, 0.0, 0.0, ("range_mm",))
    )
    assert (
        statements.statement(spread, "the ball", "mm")
        == "The noise is not the same everywhere: its spread goes with the range."
    )


def test_the_first_result_has_the_most_probable_names():
    link = Alternative("link-compliance", "link-2", "", 0.93, 1.0, "")
    moved = Alternative("backlash", "joint-2", "", 0.96, 1.0, "", "approach")
    joint = Finding(
        "joint-compliance", "joint-2", "", (), 1e-9, 0.004, 0.3, 40.0, (), (link, moved)
    )
    said = statements.preliminary(SimpleNamespace(findings=(joint,)))
    assert "link-compliance at link 2 (0.93)" in said and "joint-compliance" not in said


def test_progress_names_the_samples_about_an_instant():
    lines = []
    state = SimpleNamespace(covariates={"row": np.arange(80.0)}, n=80)
    chain = SimpleNamespace(poses_per_sample=1, state=state)
    bench = SimpleNamespace(chain=chain, recording=SimpleNamespace(sample_ids=np.arange(1, 81)))
    with_numbered_samples(lines.append, bench)("shift at tool after row 49.5; backlash at joint-2")
    images = SimpleNamespace(chain=None)
    with_numbered_samples(lines.append, images)("board-bow at artefact")
    assert lines == [
        "shift at tool between samples 50 and 51; backlash at joint-2",
        "board-bow at artefact",
    ]


def test_moments_that_are_estimated_next_to_stated_masses_may_be_an_unrecorded_load():
    label = LABEL
    one = Finding("joint-compliance", "joint-6", label, (), 1e-9, 1.0, 0.3, 40.0)
    said = statements.statement(Term(one, size=0.03), "the ball", "mm")
    assert "masses or centres of mass in the robot file are wrong" in said
    assert "a load that is not recorded" in said and "weigh the tool" in said
    plain = Finding("joint-compliance", "joint-6", "", (), 1e-9, 1.0, 0.3, 40.0)
    assert "not recorded" not in statements.statement(Term(plain, size=0.03), "the ball", "mm")
    load = Alternative("payload", "tool", "constant", 0.01, 0.98, UNSTATED_LOAD)
    loaded = replace(plain, probability=0.9, alternatives=(load,))
    said = statements.statement(Term(loaded, size=0.03), "the ball", "mm")
    assert "If the tool carried a load that is not recorded" in said and "probability" not in said
