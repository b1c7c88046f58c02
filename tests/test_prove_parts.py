"""A benchmark run in parts, its checks of itself, and the scoreboard as a page of Markdown."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from test_prove import row
from workbench.core.errors import InputError
from workbench.proving import (
    board,
    checks,
    figures,
    oracle,
    planting,
    protocol,
    prove,
    scoring,
    stages,
    tasks,
)
from workbench.proving.maps import Map


def test_suites_may_have_counts_of_their_own():
    pytest.importorskip("mujoco")
    plan = tasks.plan(["clean=3", "pairs"], 2, 1)
    assert plan.counts == {"clean": 3, "pairs": 2}
    for word in ("clean=", "clean=0", "clean=-1", "clean=few"):
        with pytest.raises(InputError, match="expected a number of cases from 1"):
            tasks.plan([word], None, 1)


def test_parts_of_a_benchmark_run_add_up(tmp_path):
    """With no time left, cases are created and committed but not diagnosed; later calls plan more."""
    pytest.importorskip("mujoco")
    folder = tmp_path / "exam"
    first = prove.prove(folder, ["clean=2"], seed=5, jobs=1, minutes=0)
    assert (
        not first.rows
        and first.planned == {"clean": 2}
        and len(protocol.BenchmarkRun(folder).names()) == 2
    )
    then = prove.prove(folder, ["library=1", "clean=1"], seed=5, jobs=1, minutes=0)
    assert then.planned == {"clean": 2, "library": 1}
    assert then.command == "workbench prove --suite clean=2 --suite library=1 --seed 5"
    assert len((folder / "SHA256SUMS").read_text().splitlines()) == 3
    result = json.loads((folder / "settings.json").read_text())
    assert result == {"seed": 5, "own": None, "planned": {"clean": 2, "library": 1}}


def exam_of_one(folder, truth='{"effects": []}\n'):
    exam = protocol.BenchmarkRun(folder)
    protocol.write_case(exam, "a", lambda place: place.mkdir(), lambda: truth)
    return exam, protocol.seal(exam)


def test_an_answer_stays_as_it_was_when_its_case_was_opened(tmp_path):
    exam, seals = exam_of_one(tmp_path, '{"effects": [], "measures": "", "baseline": "geometry"}\n')
    protocol.run(
        tmp_path, "a", lambda folder: {"verdict": "consistent", "effects": [], "located": []}, "p1"
    )
    oracle.weigh(tmp_path, "a")
    assert (
        stages.row_of(exam, "a", seals)["outcome"] == "right"
        and stages.row_of(exam, "a", seals)["program"] == "p1"
    )
    exam.answer("a").write_text(exam.answer("a").read_text().replace("consistent", "unexplained"))
    with pytest.raises(InputError, match="changed after its case was unblinded"):
        stages.row_of(exam, "a", seals)


def test_a_diagnosis_that_takes_too_long_is_no_answer(tmp_path, monkeypatch):
    exam_of_one(tmp_path)
    monkeypatch.setattr(protocol, "PATIENCE_S", 0.05)

    def forever(folder):
        while True:
            np.linalg.inv(np.eye(20))

    result = protocol.run(tmp_path, "a", forever)
    assert (
        result["answer"] is None
        and result["failed"].startswith("TimeoutError")
        and result["cpu_s"] < 5
    )


def test_one_changed_byte_of_each_truth_is_tried_and_the_makers_are_read(tmp_path, monkeypatch):
    exam, _ = exam_of_one(tmp_path)
    alone, committed, closed = checks.checks(exam, [{"case": "a", "opened": ["/x"]}])
    assert alone.reached and alone.cases > 20 and committed.reached and closed.reached is False
    monkeypatch.setattr(protocol, "check", lambda *_: None)
    assert checks.checks(exam, [{"case": "a"}])[1].reached is False


def test_a_maker_that_takes_from_the_model_is_seen(tmp_path, monkeypatch):
    for text in (
        "import workbench.core",
        "def f():\n    from robot_model import chain",
        "from sensors.scan import x",
    ):
        (tmp_path / "maker.py").write_text(text + "\n")
        monkeypatch.setattr(protocol, "MAKERS", (tmp_path / "maker.py",))
        assert checks.checks(protocol.BenchmarkRun(tmp_path), [])[0].reached is False


def test_the_program_has_one_checksum_in_one_process():
    assert checks.program() == checks.program() and len(checks.program()) == 12


def test_too_few_cases_reach_nothing():
    clean = [row("clean", "right", effects=[])] * 150
    alarms, upper = figures.table(clean)[:2]
    assert (alarms.value, alarms.within, alarms.reached, alarms.word) == (
        0.0,
        True,
        False,
        "too few cases",
    )
    assert upper.reached and upper.value == pytest.approx(3.8415 / 153.8415, abs=1e-4)
    assert figures.table(clean * 2)[0].word == "reached"


def test_no_finding_is_right_for_an_absorbed_effect_below_the_minimal_detectable_bias():
    small = row("swallowed", "missed", below_visible=True, wrong_name=False)
    rest = "named, or `unexplained`, or below the stated minimal detectable bias"

    def held(one):
        return next(f for f in figures.table([one]) if f.name == rest).reached

    assert (
        held(small)
        and not held(small | {"below_visible": False})
        and held(row("swallowed", "abstained"))
    )
    assert not held(small | {"outcome": "wrong", "wrong_name": True})


def test_the_minimal_detectable_bias_is_of_the_same_effect_and_order():
    one = {
        "effect": "transmission-harmonic",
        "where": "joint-2",
        "survives_sigma": 1.0,
        "detail": {"order": 2},
    }
    table = [
        {"effect": one["effect"], "where": "joint-2", "variant": f"order {n}", "surviving_mm": size}
        for n, size in ((1, 0.001), (2, 0.02))
    ]
    said = {"verdict": "consistent", "effects": [], "located": [], "smallest_visible": table}
    found = scoring.score_answer({"effects": [one], "sigma_mm": 0.01}, said)
    assert found["surviving_mm"] == pytest.approx(0.01 * np.sqrt(3)) and found["visible_mm"] == 0.02
    assert found["below_visible"] is True


def test_a_failed_case_gains_nothing():
    one = row(
        outcome="failed", before_mm=None, after_mm=None, oracle_before_mm=0.05, oracle_after_mm=0.03
    )
    assert figures.gain_share(one) == 0.0


def test_the_page_of_markdown_lists_figures_failures_and_images(tmp_path, monkeypatch):
    from workbench.report.scoreboard import markdown_page

    drawn = Map(
        "library 1: x", np.random.default_rng(1).normal(size=(3, 20)), np.ones(20), np.full(20, 0.5)
    )
    monkeypatch.setattr(markdown_page, "maps", lambda exam, rows: [drawn])
    rows = [
        row(case="good", beliefs=[(0.97, True)], before_mm=0.05, after_mm=0.03),
        row(case="bad", outcome="missed"),
    ]
    made = board.board(
        rows, {"sensor": "no images"}, 4, "workbench prove --seed 4", planned={"library": 5}
    )
    (tmp_path / "exam").mkdir()
    board.save(made, tmp_path / "exam")
    board.publish_seals(tmp_path / "exam", {"good": "0", "bad": "1"})
    text = markdown_page.write_page(made, tmp_path / "exam", tmp_path / "board.md").read_text()
    assert (
        "workbench prove --seed 4" in text
        and "| library | confidently wrong | ≤ 1 % | 0.0% | 0 of 2 |" in text
        and "| library | 2 | 5 |" in text
        and "skipped: no images" in text
    )
    assert "| real-withheld | 0 | not run |" in text and "the same call continues" in text
    assert (
        "`bad`" in text
        and "`good`" not in text
        and "good" in (tmp_path / "board" / "results.csv").read_text()
    )
    for name in (
        "figures.png",
        "seen.png",
        "gain.png",
        "effects.png",
        "places.png",
        "before-after.png",
        "maps.png",
    ):
        assert f"board/{name}" in text and (tmp_path / "board" / name).stat().st_size > 1000
    with pytest.raises(InputError, match="ends in .md"):
        markdown_page.write_page(made, tmp_path / "exam", tmp_path / "board.html")


def test_a_planted_case_without_the_set_as_it_is_proves_nothing():
    from workbench.proving import real

    said = {
        "verdict": "explained",
        "located": [],
        "effects": [{"effect": "backlash", "where": "joint-1"}],
    }
    mine = {"answer": said, "seconds": 1.0, "refused": "", "failed": "", "opened": []}
    bare = {"rule": "unplanted", "effects": [], "twin": "x"}
    assert real.score(bare, mine, None)["outcome"] == "reference"
    assert real.score(bare, mine, mine)["outcome"] == "right"
    other = mine | {"answer": said | {"effects": []}}
    assert real.score(bare, mine, other)["outcome"] == "false alarm"


def test_confounded_compliances_of_a_supported_term_predict_equally_well():
    def predicts(rms):
        return SimpleNamespace(rms=rms, beats=lambda other: other.rms > 1.1 * rms)

    rows = [
        ("joint-compliance", "joint-2"),
        ("link-compliance", "link-1"),
        ("bearing-compliance", "joint-3"),
        ("transmission-harmonic", "joint-4"),
    ]
    terms, tried = (
        [planting.Term(*row) for row in rows],
        [predicts(rms) for rms in (1.0, 1.05, 1.5, 1.02)],
    )
    assert planting._confounded(terms, tried, 0) == (("link-compliance", "link-1"),)
    assert planting._confounded(terms, tried, 3) == ()
