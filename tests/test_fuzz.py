"""Fuzzing of every reader and command: nothing but a value or an InputError comes out of it.

`make fuzz` tries 20,000 inputs; here are a minute of it, and the inputs that once failed.
"""

import pytest

from fuzz_engine import Fuzzer, Outcome, fuzz
from fuzz_targets import targets

SECONDS = 20
FORMER_FAILURES = {
    "camera": b"width_px = inf",
    "opencv": b"%YAML:1.0\n---\na: !!opencv-matrix\n   rows: -3\n   cols: 3\n   dt: d\n   data: [1]\n",
    "hand-eye": b"std_mm = 3",
    "numpy": b"",
    "cloud": b"ply\nformat ascii 1.0\n" + b"x" * 3000,
    "pcd": b"SIZE 4 4 4\nSIZE 4 4 4\nDATA 4 4 =1+1\nDATA ascii\n",
    "prove-sums": b"abc",
    "rapid": b'"' + b"1," * 100_000,
    "plan": b"a = " + b"[" * 4000,
    "dh-table": b"1e5,q2-90,0,270,1e999\n3,q3}x,0,5,0x10\n",
}


@pytest.fixture(scope="module")
def readers(tmp_path_factory):
    return targets(tmp_path_factory.mktemp("fuzz"), commands=False)


def test_every_example_of_the_corpus_is_accepted(readers):
    """A reader that refuses its example would be fuzzed in its first lines only."""
    for target in readers:
        target.call(target.folder)


@pytest.mark.parametrize("name", FORMER_FAILURES)
def test_inputs_that_once_failed(readers, name):
    target = next(target for target in readers if target.name == name)
    outcome = Outcome()
    for content in (FORMER_FAILURES[name], Fuzzer(target, 0).original + FORMER_FAILURES[name]):
        failure, _ = Fuzzer(target, 0).attempt(content, outcome)
        assert not failure


def test_the_fuzzer_finds_a_planted_fault(readers, monkeypatch):
    """The check can fail: a reader that raises another error is reported with its place."""
    import workbench.fitting.calibration_plans.plans as plans

    monkeypatch.setattr(plans, "_stage", lambda *_: {}["missing"])
    target = next(target for target in readers if target.name == "plan")
    failure, _ = Fuzzer(target, 0).attempt(Fuzzer(target, 0).original, Outcome())
    assert failure.startswith("KeyError")


@pytest.mark.slow
def test_random_inputs_end_in_a_value_or_one_sentence(tmp_path):
    outcome = fuzz(targets(tmp_path), 2_000, SECONDS, seed=11)
    assert outcome.inputs > 100
    assert not outcome.failures
