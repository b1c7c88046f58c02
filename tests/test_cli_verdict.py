"""`--tolerance` on the command line: exit status, sentence, and the object `verdict` of every command."""

import json
from dataclasses import replace

import numpy as np
import pytest

import datasets
from noise_scenes import recorded
from workbench.commands import cli
from workbench.commands.shared import tables

PLAN = """
[[stage]]
name = "geometry"
why = "lengths and angles"
earn = false
free = ["base.*", "tool.*", "joint-*.theta*", "joint-*.a?"]
"""
KEYS = {"pass", "tolerance", "unit", "residual_over_noise", "sentence"}


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Folders of recordings, positions and poses, and a plan that is solved quickly."""
    folder = tmp_path_factory.mktemp("verdict")
    datasets.write(recorded(1, n=60), folder / "points")
    datasets.write(recorded(1, n=60, measures="external-pose"), folder / "pose")
    (folder / "plan.toml").write_text(PLAN, encoding="utf-8")
    return folder


def run(home, name, *words):
    """Exit status and answer of a command."""
    out = home / f"{name}-{len(list(home.iterdir()))}"
    target = out.with_suffix(".json")
    status = cli.run([*map(str, words), "--json", str(target)])
    answer = json.loads(target.read_text(encoding="utf-8")) if target.exists() else None
    return status, answer


def calibrate(home, recording, *words):
    plan = ("--plan", home / "plan.toml", "--folds", "2", "--no-report")
    out = home / f"run-{len(list(home.iterdir()))}"
    return run(home, "calibrate", "calibrate", home / recording, *plan, "--out", out, *words)


def test_a_tolerance_decides_the_exit_status(home, capsys):
    status, answer = calibrate(home, "points", "--tolerance", "100mm")
    assert (
        status == 0 and answer["verdict"]["pass"] is True and answer["verdict"]["tolerance"] == 100
    )
    said = capsys.readouterr().out.splitlines()
    assert any("meets the tolerance of 100" in line for line in said)
    assert "run-" in said[-1]
    status, answer = calibrate(home, "points", "--tolerance", "0.0001")
    assert status == 1 and answer["verdict"]["pass"] is False
    said = capsys.readouterr().out.splitlines()
    assert any("exceeds the" in line for line in said)
    assert "run-" in said[-1], "the run is written and named last, also where the verdict is no"


def test_without_a_tolerance_there_is_a_verdict_and_no_failure(home):
    status, answer = calibrate(home, "points")
    assert status == 0 and answer["verdict"]["pass"] is None
    assert KEYS <= set(answer["verdict"]) and answer["verdict"]["sentence"].endswith(".")
    assert {"stated_mm", "from_repeats_mm", "from_residuals_mm", "factor", "sentence"} <= set(
        answer["noise"]
    )


def test_a_plan_that_leaves_many_times_the_noise_says_so(home, capsys):
    _, answer = calibrate(home, "points")
    factor = answer["verdict"]["residual_over_noise"]
    assert factor > 5 and answer["converged"]
    assert answer["warnings"] and f"{factor:.3g} times the noise" in answer["verdict"]["sentence"]
    said = " ".join(capsys.readouterr().out.split())
    assert answer["warnings"][0][:60] in said


def test_poses_are_judged_in_mm_and_degrees(home):
    both = ("--tolerance", "100mm", "--tolerance", "0.000001deg")
    status, answer = calibrate(home, "pose", *both)
    assert status == 1
    assert [(one["unit"], one["pass"]) for one in answer["verdict"]["checks"]] == [
        ("mm", True),
        ("deg", False),
    ]
    status, answer = calibrate(home, "pose", "--tolerance", "100mm", "--tolerance", "90deg")
    assert status == 0 and answer["verdict"]["pass"] is True


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.1px", "unit 'px'"),
        ("1deg", "unit 'deg'"),
        ("much", "found 'much'"),
        ("-1", "above 0"),
    ],
)
def test_a_bad_tolerance_ends_with_status_2_and_one_sentence(home, capsys, text, expected):
    status, answer = calibrate(home, "points", f"--tolerance={text}")
    said = capsys.readouterr().err
    assert status == 2 and answer is None
    assert expected in said and said.count("\n") == 1


def test_compare_judges_the_best_plan(home):
    for limit, expected in (("100", 0), ("0.0001", 1)):
        out = home / f"compare-{limit}"
        plans = ("--plan", home / "plan.toml", "--folds", "2", "--out", out, "--tolerance", limit)
        status, answer = run(home, "compare", "compare", home / "points", *plans)
        assert status == expected and answer["verdict"]["sentence"].startswith("Best plan, plan:")
        assert KEYS <= set(answer["plans"][0]["verdict"])


def test_commands_without_a_residual_say_so(home):
    commands = {
        "identifiability": ("identifiability", home / "points"),
        "significance": (
            "significance",
            "abb_irb120",
            "--points",
            "3",
            "--out",
            home / "significance",
        ),
        "poses": (
            "poses",
            home / "points",
            "-n",
            "20",
            "--link-radius",
            "0",
            "--out",
            home / "poses",
        ),
    }
    for name, words in commands.items():
        status, answer = run(home, name, *words)
        assert status == 0 and answer["verdict"]["pass"] is None, name
        assert KEYS <= set(answer["verdict"])


def test_a_simulation_has_no_verdict(home):
    scene = home / "scene.toml"
    scene.write_text(
        'robot = "abb_irb120"\nsamples = 5\nreflectors = [[0.0, 30.0, 120.0]]\n', encoding="utf-8"
    )
    status, answer = run(home, "simulate", "simulate", scene, "--out", home / "simulated")
    assert (
        status == 0
        and answer["verdict"]["pass"] is None
        and "no residual" in answer["verdict"]["sentence"]
    )


def test_poses_for_a_task_are_judged_by_the_predicted_error(home):
    words = (
        "poses",
        home / "points",
        "-n",
        "20",
        "--link-radius",
        "0",
        "--criterion",
        "task",
        "--tasks",
    )
    for limit, expected in (("50mm", 0), ("0.00001mm", 1)):
        out = home / f"task-{limit}"
        status, answer = run(
            home, "task", *words, home / "points", "--out", out, "--tolerance", limit
        )
        assert status == expected and "predicted" in answer["verdict"]["sentence"].lower()


def test_poses_without_a_task_take_no_tolerance(home, capsys):
    status, _ = run(home, "poses", "poses", home / "points", "-n", "20", "--tolerance", "1")
    assert status == 2 and "--criterion task" in capsys.readouterr().err


class _Console:
    def __init__(self):
        self.lines = []

    def print(self, text, style=None, markup=True):
        self.lines.append((text.split(":")[0], style))


def test_findings_on_the_noise_are_notes_and_alarms_are_warnings():
    console = _Console()
    tables.warnings(console, {"warnings": ["alarm", "calm"], "noise": {"findings": ["calm"]}})
    assert console.lines == [("Warning", "bold red"), ("Note", "yellow")]


def test_the_status_says_whether_the_data_contain_a_mistake(home, capsys):
    """`check` ends with 1 where wrong rows are named; `calibrate` leaves them out and states them."""
    right = recorded(1, n=60)
    columns = {**right.columns, "y_mm": right.columns["y_mm"].copy()}
    columns["y_mm"][[4, 20, 41]] += (70.0, 110.0, -90.0)
    datasets.write(replace(right, columns=columns), home / "wrong-rows")
    for name, expected in (("points", 0), ("wrong-rows", 1)):
        words = ("check", home / name, "--no-report", "--out", home / f"check-{name}")
        status, answer = run(home, "check", *words)
        assert status == expected and answer["verdict"]["pass"] is not bool(expected)
    status, answer = calibrate(home, "wrong-rows")
    assert status == 0 and answer["verdict"]["pass"] is None
    assert answer["suspect_samples"] == [5, 21, 42]
    assert any("leaves them out" in text for text in answer["warnings"])


def test_a_recording_in_doubt_ends_with_status_1_unless_the_data_are_trusted(home):
    """The instrument moves by 2 mm after two thirds of the rows."""
    right = recorded(1, n=60)
    moved = {"x_mm": right.columns["x_mm"] + 2.0 * (np.arange(60) >= 40)}
    datasets.write(replace(right, columns={**right.columns, **moved}), home / "moved")
    status, answer = calibrate(home, "moved")
    assert status == 1 and answer["verdict"]["pass"] is False
    assert "the recording is in doubt" in answer["verdict"]["sentence"]
    status, answer = calibrate(home, "moved", "--trust-data")
    assert status == 0 and "the recording is in doubt" in answer["verdict"]["sentence"]
