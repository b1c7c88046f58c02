"""The protocol of the blind benchmark: hash-committed truths, observed file access, an independent maker."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from workbench.core.errors import InputError
from workbench.proving import protocol

pytest.importorskip("mujoco")
ROOT = Path(__file__).resolve().parents[1]


def exam_of(folder, *names, truth='{"effects": []}\n'):
    exam = protocol.BenchmarkRun(folder)
    for name in names:
        protocol.write_case(exam, name, _written, lambda: truth)
    return exam


def _written(folder):
    folder.mkdir()
    (folder / "recording.toml").write_text("format = 'recording/1'\n")


def test_a_truth_that_was_changed_by_one_byte_fails(tmp_path):
    exam = exam_of(tmp_path, "a", "b")
    seals = protocol.seal(exam)
    protocol.check(exam, seals)
    path = exam.truth("b")
    path.write_bytes(path.read_bytes().replace(b"[]", b"[ ", 1))
    with pytest.raises(InputError, match="changed after its hash was published"):
        protocol.check(exam, seals)
    with pytest.raises(InputError, match="changed after its hash was published"):
        protocol.seal(exam)


def test_a_truth_is_committed_before_its_answer_and_read_after_it(tmp_path):
    exam = exam_of(tmp_path, "a")
    with pytest.raises(InputError, match="published hash or its answer is missing"):
        protocol.opened(exam, "a", protocol.seal(exam))
    protocol.run(tmp_path, "a", lambda folder: {})
    assert protocol.opened(exam, "a", protocol.published(exam)) == {"effects": []}
    exam_of(tmp_path, "b")
    exam.answer("b").write_text("{}")
    with pytest.raises(InputError, match="before the hash of its truth was published"):
        protocol.seal(exam)


def test_a_case_is_created_once_and_completely(tmp_path):
    exam = exam_of(tmp_path, "a")
    before = exam.truth("a").read_bytes()
    exam_of(tmp_path, "a", truth="{}")
    assert exam.truth("a").read_bytes() == before

    def breaks(folder):
        folder.mkdir()
        raise OSError("disk full")

    with pytest.raises(OSError):
        protocol.write_case(exam, "b", breaks, lambda: "{}")
    assert exam.names() == ["a"] and not list((tmp_path / "cases" / "b").iterdir())


CHILD = """
import sys
from pathlib import Path
from workbench.proving import protocol
folder, act = Path(sys.argv[1]), sys.argv[2]
def diagnose(recording):
    (recording / "recording.toml").read_text()
    if act == "truth":
        (folder / "sealed" / "a.json").read_text()
    if act == "other":
        (folder / "cases" / "b" / "recording" / "recording.toml").read_text()
    if act == "list":
        list((folder / "sealed").iterdir())
    if act == "outside":
        Path(sys.argv[3]).read_text()
    if act == "process":
        import subprocess
        subprocess.run(["true"])
    if act == "maker":
        (protocol.PROJECT / "datasets" / "makers" / "blind" / "case.py").read_text()
    return {}
print(protocol.run(folder, "a", diagnose)["opened"])
"""


@pytest.mark.parametrize(
    ("act", "word"),
    [
        ("nothing", "[]"),
        ("truth", "sealed/a.json"),
        ("other", "cases/b"),
        ("list", "sealed"),
        ("outside", "elsewhere.txt"),
        ("process", "subprocess.Popen"),
        ("maker", "case.py"),
    ],
)
def test_the_watch_sees_what_a_diagnosis_opens(tmp_path, act, word):
    exam_of(tmp_path / "exam", "a", "b")
    elsewhere = tmp_path / "elsewhere.txt"
    elsewhere.write_text("secret")
    made = subprocess.run(
        [sys.executable, "-c", CHILD, tmp_path / "exam", act, elsewhere],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    assert word in made.stdout and (act == "nothing") == (made.stdout.strip() == "[]")


def test_an_error_and_a_refusal_are_answers_too(tmp_path):
    exam_of(tmp_path, "a", "b")

    def refuses(folder):
        raise InputError("the file is wrong.")

    assert protocol.run(tmp_path, "a", refuses)["refused"] == "the file is wrong."
    assert protocol.run(tmp_path, "b", lambda folder: {}["x"])["failed"].startswith("KeyError")


ALONE = """
import sys
from datasets.makers.blind import case, writing, suites
assert len(suites.SUITES) == 6
for suite in ("clean", "library", "outside"):
    case.draw(suite, 0, 5)
print(sorted(m for m in sys.modules if m.split(".")[0] in ("robot_model", "sensors", "workbench")))
"""


def test_the_maker_runs_without_any_module_of_the_workbench():
    made = subprocess.run(
        [sys.executable, "-c", ALONE], capture_output=True, text=True, cwd=ROOT, check=True
    )
    assert made.stdout.strip() == "[]"


def test_names_of_suites_draw_different_numbers():
    from datasets.makers.blind import suites

    assert len({sum(map(ord, suite)) for suite in suites.SUITES}) == len(suites.SUITES)


LONGER = [
    pytest.param(suite, marks=pytest.mark.slow)
    for suite in ("swallowed", "outside", "covariate-withheld")
]


@pytest.mark.parametrize("suite", ["clean", "library", "pairs", *LONGER])
def test_a_case_is_the_same_for_the_same_seed_and_its_recording_tells_nothing(suite, tmp_path):
    import datasets
    from datasets.makers.blind import case, writing

    one, two = case.draw(suite, 3, 8), case.draw(suite, 3, 8)
    assert writing.files(one) == writing.files(two) and writing.truth(one, "x") == writing.truth(
        two, "x"
    )
    text = "".join(writing.files(one).values())
    for effect in one.truth["effects"]:
        assert effect["effect"] not in text
    assert suite not in text
    writing.recording(one, tmp_path / "case")
    garbled = any(e["effect"] == "unit-or-frame" for e in one.truth["effects"])
    assert garbled or datasets.read(tmp_path / "case").n == one.truth["samples"]


@pytest.mark.slow
def test_what_is_withheld_is_not_in_the_file():
    from datasets.makers.blind import case

    for index in range(5):
        made = case.draw("covariate-withheld", index, 2)
        prefix = {
            "approach": "approach",
            "payload": "payload_kg",
            "temperature": "temp",
            "speed": "qdot",
        }
        for kind in set(made.truth["withheld"]) - {"time"}:
            assert not [name for name in made.columns if name.startswith(prefix[kind])]
        assert made.truth["words"]


def test_rows_of_a_withheld_approach_stand_in_no_order_that_tells_it():
    """Neither rows, poses nor time say which pose came before which."""
    from datasets.makers.blind import case

    for index in (0, 5):
        made = case.draw("covariate-withheld", index, 2)
        assert made.truth["effects"][0]["effect"] == "backlash" and "time_s" not in made.columns
        joint = int(made.truth["effects"][0]["where"][-1])
        reading = made.columns[f"q{joint}_deg"]
        if "pose" in made.columns:
            assert np.all(np.diff(made.columns["pose"]) >= 0)
            first = np.flatnonzero(np.diff(made.columns["pose"], prepend=0))
            assert all(np.ptp(part) == 0 for part in np.split(reading, first[1:]))


def test_the_size_is_that_of_the_part_orthogonal_to_the_makers_own_baseline():
    """Nothing of a clean case remains; the baseline absorbs a displacement along itself completely."""
    from datasets.makers.blind import baseline_span, workplace
    from datasets.makers.blind.world import Perturbation

    world = workplace.draw(
        np.random.default_rng(4), workplace.Requirements("ball-centre", samples=(120, 140))
    )
    base = baseline_span.basis(world)
    assert np.allclose(base.T @ base, np.eye(base.shape[1]), atol=1e-9)
    offset = np.zeros((world.n, world.joints))
    offset[:, 2] = 1e-5
    change = world.measured(Perturbation(joint=offset)) - world.clean
    assert baseline_span.rms(baseline_span.left(base, change)) < 2e-3 * baseline_span.rms(change)
    sine = offset * np.sin(3 * world.angles)
    change = world.measured(Perturbation(joint=sine)) - world.clean
    assert baseline_span.rms(baseline_span.left(base, change)) > 0.3 * baseline_span.rms(change)


def test_pushes_add_up_and_nothing_is_nothing():
    from datasets.makers.blind import workplace
    from datasets.makers.blind.world import Perturbation

    world = workplace.draw(np.random.default_rng(6), workplace.Requirements(samples=(100, 110)))
    twist = np.zeros((world.n, 6))
    twist[:, 0] = 0.3
    whole = world.measured(
        Perturbation(base=twist) + Perturbation(joint_compliance=np.full(world.joints, 1e-6))
    )
    assert np.abs(whole - world.clean).max() > 0.01
    assert np.array_equal(world.measured(Perturbation()), world.clean)
    if world.measures == "external-point":
        moved = world.measured(Perturbation(base=twist)) - world.clean
        assert np.allclose(np.linalg.norm(moved, axis=1), 0.3, atol=1e-9)


def test_a_mistake_in_the_file_is_a_mistake_in_the_file():
    from datasets.makers.blind.effects import data

    columns = {
        **{f"q{k}_deg": np.full(3, float(k)) for k in range(1, 7)},
        **{a: np.arange(3.0) + 1 for a in ("x_mm", "y_mm", "z_mm")},
    }
    detail = {"kind": "joints-permuted", "joint": 2, "axis": "x_mm"}
    assert data.garbled(columns, detail)["q2_deg"][0] == 3
    flipped = data.garbled(columns, detail | {"kind": "axis-flipped"})
    assert np.array_equal(flipped["x_mm"], -columns["x_mm"])
    assert columns["x_mm"][0] == 1


def test_the_import_rules_keep_the_maker_apart():
    rules = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"][
        "contracts"
    ]
    mine = [rule for rule in rules if "datasets.makers.blind" in rule.get("source_modules", ())]
    assert len(mine) == 1 and mine[0]["type"] == "forbidden" and "ignore_imports" not in mine[0]
    assert set(mine[0]["forbidden_modules"]) == {"robot_model", "sensors", "workbench"}


def test_seals_are_the_checksums_of_the_files(tmp_path):
    import hashlib

    exam = exam_of(tmp_path, "a")
    protocol.seal(exam)
    hashes = json.loads(exam.seals.read_text())
    assert hashes == {"a": hashlib.sha256(exam.truth("a").read_bytes()).hexdigest()}
