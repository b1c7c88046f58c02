"""Fixed rules of scoring, the figures and the scoreboard of the blind benchmark, and a run from end to end."""

import json

import numpy as np
import pytest

from workbench.core.errors import InputError
from workbench.proving import board, figures, protocol, prove, scoring, stages, tasks

TRUE = {"effect": "backlash", "where": "joint-3"}


def claim(effect="backlash", where="joint-3", probability=0.99, alternatives=(), **more):
    rows = [{"effect": e, "where": w, "why": ""} for e, w in alternatives]
    return {
        "effect": effect,
        "where": where,
        "probability": probability,
        "alternatives": rows,
        **more,
    }


def record(*claims, verdict="explained", located=(), **more):
    answer = {
        "verdict": verdict,
        "effects": list(claims),
        "located": [{"where": w} for w in located],
        "held_out": {"before_mm": 0.05, "after_mm": 0.03, "noise_mm": 0.03, "folds": 5},
    }
    return {"answer": answer, "refused": "", "failed": "", "opened": [], "seconds": 1.0} | more


OUTCOMES = [
    ("exact", record(claim())),
    ("group", record(claim("zero-shift", probability=0.6, alternatives=[("backlash", "joint-3")]))),
    ("more", record(claim(), claim("base-drift", "base"))),
    ("more", record(claim(), claim("unknown", "base"), verdict="unexplained")),
    ("place", record(claim("zero-shift"))),
    ("place", record(verdict="unexplained", located=["joint-3"])),
    ("abstained", record(verdict="unexplained", located=["base"])),
    ("wrong", record(claim("base-drift", "base"))),
    ("missed", record(verdict="consistent")),
    ("failed", record() | {"answer": None, "failed": "TimeoutError: no answer"}),
    ("failed", record(claim(), opened=["/etc/passwd"])),
]


@pytest.mark.parametrize(("outcome", "said"), OUTCOMES)
def test_outcomes_of_one_planted_effect(outcome, said):
    assert scoring.score({"effects": [TRUE]}, said)["outcome"] == outcome


@pytest.mark.parametrize(
    ("outcome", "said"),
    [
        ("right", record(verdict="consistent")),
        ("false alarm", record(claim())),
        ("false alarm", record(verdict="unexplained")),
    ],
)
def test_outcomes_of_a_clean_case(outcome, said):
    assert scoring.score({"effects": []}, said)["outcome"] == outcome


def test_outcomes_of_two_effects():
    truth = {"effects": [TRUE, {"effect": "base-drift", "where": "base"}]}
    both, other = claim("base-drift", "base"), claim("zero-shift", "joint-1")
    assert scoring.score(truth, record(claim(), both))["outcome"] == "exact"
    assert scoring.score(truth, record(claim()))["outcome"] == "part"
    assert scoring.score(truth, record(claim(), both, other))["outcome"] == "more"
    assert scoring.score(truth, record(claim(), both, other))["wrong_name"]


def test_outcomes_of_what_has_no_name():
    one = {
        "effect": "unknown",
        "where": "joint-5",
        "places": [],
        "depends_on": ["q4_deg", "torque5"],
    }
    truth = {"effects": [one]}
    right = record(claim("unknown", "joint-5", depends_on=["q4"]), verdict="unexplained")
    scored = scoring.score(truth, right)
    assert scored["outcome"] == "exact" and scored["covariates_right"]
    assert (
        scoring.score(
            truth, record(claim("unknown", "base", depends_on=["time"]), verdict="unexplained")
        )["outcome"]
        == "abstained"
    )
    assert scoring.score(truth, record(claim()))["outcome"] == "wrong"
    assert (
        scoring.score(truth, record(claim(), claim("unknown", "joint-5"), verdict="unexplained"))[
            "outcome"
        ]
        == "more"
    )


def test_confidently_wrong_is_a_sure_name_that_declares_no_truth():
    def wrong(*claims):
        return scoring.score({"effects": [TRUE]}, record(*claims))["confidently_wrong"]

    assert wrong(claim("zero-shift", probability=0.95))
    assert not wrong(claim("zero-shift", probability=0.94))
    assert not wrong(claim("zero-shift", alternatives=[("backlash", "joint-3")]))
    assert not wrong(claim("unknown", "base"))
    assert wrong(claim(), claim("base-drift", "base"))


def test_a_place_counts_when_it_is_named_or_located_first():
    def located(said, groups=False):
        return scoring.place_right(TRUE, said["answer"], groups)

    assert located(record(verdict="unexplained", located=["joint-3", "base"]))
    assert not located(record(verdict="unexplained", located=["base", "joint-3"]))
    other = record(claim("zero-shift", "joint-2", alternatives=[("backlash", "joint-3")]))
    assert not located(other) and located(other, groups=True)


def test_what_is_the_same_in_these_data_is_accepted():
    truth = {"effects": [TRUE | {"accept": [["zero-shift", "joint-3"]]}]}
    assert scoring.score(truth, record(claim("zero-shift")))["outcome"] == "exact"


def test_a_withheld_covariate_is_asked_for_by_one_of_its_words():
    truth = {"effects": [TRUE], "words": ["approach", "last motion"]}
    said = record(claim("unknown"), verdict="unexplained")
    assert scoring.score(truth, said)["asks_for_it"] is False
    said["answer"]["next_experiment"] = "Record the side of the last motion of joint 3."
    assert scoring.score(truth, said)["asks_for_it"] is True
    assert scoring.score({"effects": [TRUE]}, said)["asks_for_it"] is None
    said["answer"]["not_recorded"] = ["speed", "temperature"]
    assert scoring.score(truth, said)["asks"] == 2


def test_to_ask_where_nothing_was_withheld_is_counted():
    rows = [
        row("covariate-withheld", asks_for_it=True, asks=1),
        row(asks=1),
        row("clean", "right", effects=[], asks=0),
    ]
    result = {
        f.name: (f.hits, f.cases) for f in figures.table(rows) if f.suite == "covariate-withheld"
    }
    assert result["the missing covariate is asked for, and no other"] == (1, 1)
    assert result["control: something is asked for where nothing was withheld"] == (1, 2)


def test_a_mistake_in_the_file_may_be_refused_with_a_sentence():
    said = record() | {"answer": None, "refused": "samples.csv: q4_deg …"}
    assert (
        scoring.score({"effects": [{"effect": "unit-or-frame", "where": "samples"}]}, said)[
            "outcome"
        ]
        == "exact"
    )
    assert scoring.score({"effects": [TRUE]}, said)["outcome"] == "failed"


def test_wilson_against_published_values():
    """Newcombe, Stat. Med. 17 (1998), table I: 81/263, 15/148, 0/20 and 1/29."""
    for hits, cases, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        assert figures.wilson(hits, cases) == pytest.approx((low, high), abs=1e-4)
    assert figures.wilson(0, 0) == (0.0, 1.0)


def row(suite="library", outcome="exact", **more):
    base = {
        "case": "c",
        "seal": "s",
        "suite": suite,
        "index": 0,
        "outcome": outcome,
        "effects": [TRUE],
        "concealed": ["x"],
        "survives_sigma": 2.0,
        "detected": outcome != "missed",
        "located": outcome != "missed",
        "verdict": "explained",
        "claims": [],
        "seconds": 1.0,
        "confidently_wrong": False,
        "samples": 100,
        "beliefs": [],
        "first": {"effect": "backlash", "where": "joint-3"},
        "note": "",
    }
    return base | more


def test_figures_say_what_was_reached():
    rows = (
        [row() for _ in range(95)]
        + [row(outcome="missed") for _ in range(5)]
        + [row(outcome="missed", survives_sigma=0.2)]
    )
    result = {f.name: f for f in figures.table(rows)}
    seen = result["detected, orthogonal size ≥ 0.3 σ"]
    assert (seen.hits, seen.cases, seen.reached) == (95, 100, True)
    assert (
        result["confidently wrong"].reached
        and result["right name or declared group, of detected"].value == 1.0
    )
    clean = [row("clean", "right", effects=[])] * 98 + [row("clean", "false alarm", effects=[])] * 2
    result = figures.table(clean)
    assert (
        result[0].value == 0.02
        and result[0].reached is False
        and result[1].value == pytest.approx(0.0700, abs=1e-3)
    )


def test_gain_is_a_share_of_the_oracles():
    one = row(before_mm=0.05, after_mm=0.03, oracle_before_mm=0.05, oracle_after_mm=0.03)
    assert figures.gain_share(one) == pytest.approx(1.0)
    assert figures.gain_share(one | {"after_mm": 0.05}) == pytest.approx(0.0)
    assert figures.gain_share(one | {"oracle_after_mm": 0.05}) is None
    assert figures.gain_share(row()) is None


def test_reliability_and_detection_count_cases():
    rows = [row(beliefs=[(0.97, True), (0.6, False)]), row(outcome="missed", survives_sigma=0.25)]
    bins = figures.reliability(rows)
    assert [(b["from"], b["claims"], b["right"]) for b in bins] == [(0.5, 1, 0.0), (0.95, 1, 1.0)]
    curve = figures.detection(rows)
    assert [(b["from_sigma"], b["detected"]) for b in curve] == [(0.2, 0.0), (2, 1.0)]
    truths, said, counts = figures.confusion(rows, "effect")
    assert truths == ["backlash"] and counts.sum() == 2


def test_the_failed_cases_stand_first_and_every_case_is_in_the_files(tmp_path):
    from pyarrow import parquet

    rows = [
        row(case="a"),
        row(case="b", outcome="missed"),
        row(case="c", outcome="exact", confidently_wrong=True),
        row(case="d", outcome="failed"),
    ]
    made = board.board(rows, {"sensor": "why"}, 1, "workbench prove")
    assert [r["case"] for r in made.rows] == ["c", "d", "b", "a"]
    board.save(made, tmp_path)
    assert parquet.read_table(tmp_path / "results.parquet")["case"].to_pylist() == [
        "c",
        "d",
        "b",
        "a",
    ]
    assert (tmp_path / "results.csv").read_text().count("\n") == 5
    result = json.loads(json.dumps(stages.plain(made.as_json())))
    assert (
        result["command"] == "prove"
        and len(result["results"]) == 4
        and result["skipped"] == {"sensor": "why"}
    )


def test_the_page_is_written_from_the_board_alone(tmp_path):
    from workbench.report.scoreboard.html_page import write_scoreboard

    rows = [
        row(
            case=f"c{k}",
            before_mm=0.05,
            after_mm=0.03,
            noise_mm=0.03,
            oracle_before_mm=0.05,
            oracle_after_mm=0.031,
            beliefs=[(0.97, True)],
        )
        for k in range(3)
    ] + [row("clean", "right", effects=[], concealed=[])]
    text = write_scoreboard(
        board.board(rows, {}, 4, "workbench prove --seed 4"), tmp_path
    ).read_text()
    assert (
        "workbench prove --seed 4" in text and "c2" in text and (tmp_path / "summary.png").exists()
    )


def test_plans_name_what_they_leave_out_and_refuse_unknown_suites(monkeypatch, tmp_path):
    with pytest.raises(InputError, match="found .dirty."):
        tasks.plan(["dirty"], 1, 1)
    monkeypatch.setenv("WORKBENCH_RECORDINGS", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    plan = tasks.plan(["real-planted", "clean"], 2, 1)
    assert [t.suite for t in plan.tasks] == ["clean", "clean"]
    assert "not on this machine" in plan.skipped["real-planted"]


def test_clean_cases_are_at_least_three_in_ten():
    assert (
        tasks.COUNTS["clean"] >= 300 and tasks.COUNTS["clean"] / sum(tasks.COUNTS.values()) >= 0.3
    )


# ------------------------------------------------------------- end to end


def own_folder(tmp_path, truth='{"effects": []}'):
    pytest.importorskip("mujoco")
    from datasets.makers.blind import case, writing

    own = tmp_path / "own"
    (own / "sealed").mkdir(parents=True)
    writing.recording(case.draw("clean", 0, 3), own / "recordings" / "mine")
    (own / "sealed" / "mine.json").write_text(truth)
    return own


def test_a_folder_of_ones_own_is_checked(tmp_path):
    own = own_folder(tmp_path)
    exam = protocol.BenchmarkRun(tmp_path / "exam")
    (own / "SHA256SUMS").write_text(f"{'0' * 64}  sealed/mine.json\n")
    with pytest.raises(InputError, match="changed after its hash was published"):
        prove.bring(exam, own)
    (own / "SHA256SUMS").unlink()
    assert prove.bring(exam, own) == ["mine"]
    (own / "sealed" / "other.json").write_text("{}")
    with pytest.raises(InputError, match="has no recordings/other/recording.toml"):
        prove.bring(exam, own)
    (own / "sealed" / "other.json").unlink()
    (own / "sealed" / "mine.json").write_text('{"effects": [{"effect": "backlash"}]}')
    with pytest.raises(InputError, match='with "effect" and "where"'):
        prove.bring(protocol.BenchmarkRun(tmp_path / "again"), own)


def test_a_benchmark_run_is_not_mixed_with_another(tmp_path):
    (tmp_path / "exam").mkdir()
    (tmp_path / "exam" / "settings.json").write_text(
        json.dumps({"seed": 1, "own": None, "planned": {}})
    )
    with pytest.raises(InputError, match="contains a benchmark run of seed 1"):
        prove.prove(tmp_path / "exam", ["clean"], 1, seed=2)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("dear")
    with pytest.raises(InputError, match="contains other files"):
        prove.prove(tmp_path / "full", ["clean"], 1)


@pytest.mark.slow
def test_a_few_cases_from_end_to_end_and_again_from_where_they_were(tmp_path):
    """Committed first, diagnosed from the recording only, scored; a second call repeats nothing.

    The seed is one whose cases have few samples.
    """
    pytest.importorskip("mujoco")
    folder = tmp_path / "exam"
    said = []
    made = prove.prove(folder, ["clean", "library"], 1, seed=53, jobs=1, progress=said.append)
    assert len(made.rows) == 2 and all(r["outcome"] != "failed" for r in made.rows), [
        r["note"] for r in made.rows
    ]
    assert not any(json.loads(p.read_text())["opened"] for p in folder.glob("cases/*/answer.json"))
    stamps = {p: p.stat().st_mtime_ns for p in folder.glob("cases/*/*.json")}
    again = prove.prove(folder, ["clean", "library"], 1, seed=53, jobs=1)
    assert [r["outcome"] for r in again.rows] == [r["outcome"] for r in made.rows]
    assert stamps == {p: p.stat().st_mtime_ns for p in folder.glob("cases/*/*.json")}
    truth = next((folder / "sealed").glob("*.json"))
    truth.write_bytes(truth.read_bytes().replace(b"0", b"1", 1))
    with pytest.raises(InputError, match="changed after its hash was published"):
        prove.prove(folder, ["clean", "library"], 1, seed=53, jobs=1)


@pytest.mark.parametrize(
    "plan",
    [
        pytest.param("clean=1 library=2 swallowed=1 outside=1", marks=pytest.mark.slow),
        pytest.param("clean=2 library=3 swallowed=1 outside=1", marks=pytest.mark.long),
    ],
)
def test_the_proof_in_small(tmp_path, plan):
    """Few cases: no confident wrong name, no false alarm, and most planted effects are found.

    The seed is one whose cases have few samples.
    """
    pytest.importorskip("mujoco")
    rows = prove.prove(tmp_path / "exam", plan.split(), seed=68).rows
    hidden = [r for r in rows if r["effects"]]
    assert not any(r.get("confidently_wrong") for r in rows)
    assert not any(r["outcome"] == "false alarm" for r in rows)
    found = [r for r in hidden if r["outcome"] in ("exact", "group") or r["located"]]
    assert len(found) >= 0.75 * len(hidden), [(r["concealed"], r["claims"]) for r in hidden]
    assert np.median([s for s in map(figures.gain_share, rows) if s is not None]) > 0.85
