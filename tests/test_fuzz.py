"""Fuzzing of every reader and command: nothing but a value or an InputError comes out of it.

`make fuzz` tries 20,000 inputs; here are a minute of it, and the inputs that once failed.
"""

import pytest

import fuzz_import_targets
from fuzz_engine import Fuzzer, Outcome, fuzz
from fuzz_targets import targets
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

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


def test_a_cloud_of_one_point_repeated_is_refused(tmp_path):
    """The ball was not determined, and the search for the rotation convention ended in an error of linear algebra."""
    fuzz_import_targets.write_scans(tmp_path / "scans")
    path = tmp_path / "scans" / "scan_1.xyz"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, *60 * [lines[3]]]) + "\n")
    poses = (tmp_path / "scans" / "poses.csv").rename(tmp_path / "poses.csv")
    options = ImportOptions(ball_radius_mm=fuzz_import_targets.RADIUS_MM)
    with pytest.raises(InputError, match="scan_1.xyz: expected points that determine a ball"):
        import_recording([tmp_path / "scans", poses], tmp_path / "out", options)


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
