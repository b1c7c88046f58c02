"""`workbench compare`: the same splits for every plan, and a p only where it means something."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from scenes import scene
from workbench.core.errors import InputError
from workbench.jobs.robot.compare import CHOSEN, SAME, TOO_FEW_BLOCKS, Comparison, compare, save

WAVE = """
[[stage]]
name = "geometry"
why = "base and tool"
free = ["base.*", "tool.*"]
earn = false

[[stage]]
name = "gear"
why = "joint 2's gear errs"
effects = [{ effect = "transmission-harmonic", where = "joint-2" }]
earn = false
"""
PLAIN = WAVE.partition('\n[[stage]]\nname = "gear"')[0]


@pytest.fixture(scope="module")
def plans(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plans")
    (folder / "plain.toml").write_text(PLAIN)
    (folder / "wave.toml").write_text(WAVE)
    return [str(folder / "plain.toml"), str(folder / "wave.toml")]


@pytest.fixture(scope="module")
def recording():
    """An arm whose joint 2 errs by a wave, with noise of 0.02 mm."""
    made = scene("external-point", n=60).recording
    q2, rng = made.joints[:, 1], np.random.default_rng(0)
    columns = dict(made.columns) | {
        f"{a}_mm": made.columns[f"{a}_mm"] + rng.normal(0, 0.02, 60) for a in "xyz"
    }
    columns["q2_deg"] = np.rad2deg(q2 - 4e-4 * np.cos(q2))
    return replace(made, columns=columns, sigma_mm=0.02, name="wavy")


def test_the_plan_that_holds_the_truth_wins_on_the_same_rows(recording, plans):
    found = compare(recording, plans)
    plain, wave = found.rows()
    assert (
        plain["ratio"] == 1
        and wave["ratio"] == wave["held_out_rms_mm"] / plain["held_out_rms_mm"] < 0.9
    )
    assert (plain["free"], wave["free"], wave["identifiable"]) == (15, 17, 17)
    assert all(np.array_equal(c.fold, found.calibrations[0].fold) for c in found.calibrations)
    assert plain["p"] is None and 0 < wave["p"] < 0.05
    assert wave["held_out_rms_mm"] == pytest.approx(np.sqrt((found.distances[1] ** 2).mean()))


def test_test_samples_give_blocks_and_the_others_are_fitted(recording, plans):
    found = compare(recording, plans, test_samples=recording.sample_ids[30:])
    answer = found.as_json()
    assert (
        answer["held_out_by"] == "test samples"
        and answer["held_out_samples"] == 30
        and answer["blocks"] == 10
    )
    assert not (found.block[:30] >= 0).any() and answer["plans"][1]["p"] < 0.05


@pytest.mark.slow
def test_no_p_where_a_plan_chose_its_stages_on_the_folds(recording, plans):
    assert compare(recording, [plans[0], "default"]).rows()[1]["test"] == CHOSEN
    row = compare(recording, [plans[0], "default"], test_samples=recording.sample_ids[30:]).rows()[
        1
    ]
    assert row["plan"] == "default" and 0 <= row["p"] <= 1


def test_no_p_from_too_few_folds_or_from_equal_plans(recording, plans, tmp_path):
    assert compare(recording, plans, folds=3).rows()[1]["test"] == TOO_FEW_BLOCKS
    (tmp_path / "again.toml").write_text(PLAIN)
    equal = compare(recording, [plans[0], str(tmp_path / "again.toml")])
    assert equal.rows()[1]["test"] == SAME
    assert equal.as_json()["verdict"]["sentence"].startswith("No difference between the plans: ")


def test_the_verdict_of_different_plans_names_the_best(recording, plans):
    sentence = compare(recording, plans).as_json()["verdict"]["sentence"]
    assert sentence.startswith("Best plan, ") and "wave" in sentence.partition(":")[0]


def made_of(differences, apart):
    """A comparison whose second plan errs by the root of 1 + a difference in every block of one row."""
    rows = len(differences)

    class Calibrated:
        def __init__(self, squares):
            self.held_out_residual = np.sqrt(np.stack([squares, 0 * squares, 0 * squares]))

    both = Calibrated(np.ones(rows)), Calibrated(1 + np.array(differences))
    return Comparison(None, ("a", "b"), both, np.arange(rows), apart, (False, False))


def test_p_is_uniform_over_blocks_of_equal_plans():
    """Blocks of test samples: under no difference 5 % of the p are below 5 %; folds are judged more strictly."""
    rng = np.random.default_rng(1)
    draws = rng.normal(0, 0.1, (800, 10))
    apart = np.array([made_of(d, True)._paired(1)["p"] for d in draws])
    folds = np.array([made_of(d, False)._paired(1)["p"] for d in draws])
    assert 0.03 < (apart < 0.05).mean() < 0.07 and abs(apart.mean() - 0.5) < 0.04
    assert (folds >= apart).all() and (folds < 0.05).mean() < 0.03


def test_what_is_saved_says_what_is_answered(recording, plans, tmp_path):
    found = compare(recording, plans)
    save(found, tmp_path)
    rows = list(csv.DictReader((tmp_path / "table.csv").open()))
    assert [row["plan"] for row in rows] == ["plain", "wave"]
    assert float(rows[1]["held_out_rms_mm"]) == pytest.approx(found.rows()[1]["held_out_rms_mm"])
    errors = np.loadtxt(tmp_path / "held-out.csv", delimiter=",", skiprows=1)
    assert errors[:, 1:].T == pytest.approx(found.distances, rel=1e-5)
    assert (tmp_path / "comparison.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("names", "word"),
    [([], "no plan"), (["ye-mdh", "ye-mdh"], "ye-mdh twice"), (["nowhere"], "nowhere")],
)
def test_what_is_wrong_is_said(recording, names, word):
    with pytest.raises(InputError, match=word):
        compare(recording, names)


@pytest.mark.slow
def test_the_command(workbench, tmp_path, plans):
    """Table on standard output, the report page last, JSON with the same numbers."""
    done = workbench(
        "compare",
        "elastic-arm",
        "--plan",
        "ye-mdh",
        "--plan",
        "ye-ntm",
        "--out",
        "run",
        "--json",
        "a.json",
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1].endswith("run/report.html") and "held out" in done.stdout
    answer = json.loads((tmp_path / "a.json").read_text())
    assert [row["plan"] for row in answer["plans"]] == ["ye-mdh", "ye-ntm"]
    assert {p.name for p in (tmp_path / "run").iterdir()} >= {
        "answer.json",
        "table.csv",
        "comparison.png",
    }
    wrong = workbench("compare", "elastic-arm", "--plan", "nowhere")
    assert wrong.returncode == 2 and len(wrong.stderr.strip().splitlines()) == 1
