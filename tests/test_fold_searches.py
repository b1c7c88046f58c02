"""Searches inside folds that start while the search on all samples still runs."""

import os
import pickle
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.validation import held_out, proof
from workbench.diagnosis.validation.fold_searches import FoldSearches
from workbench.diagnosis.validation.held_out import Errors
from workbench.explanation import answer

PARTS = [np.arange(10) % 5 != k for k in range(5)]


def search(folder: str, part: np.ndarray) -> list:
    """A search that notes that it was made, and by which process."""
    name = "".join(map(str, part.astype(int)))
    with open(Path(folder) / name, "a") as file:
        file.write(f"{os.getpid()}\n")
    return [name]


def noted(folder: Path) -> dict[str, list[str]]:
    return {path.name: path.read_text().split() for path in folder.iterdir()}


def expected(parts) -> list[list[str]]:
    return [["".join(map(str, part.astype(int)))] for part in parts]


def test_one_job_searches_in_this_process_and_starts_nothing_early(tmp_path):
    with FoldSearches(search, 1) as searches:
        searches.start(str(tmp_path), PARTS)
        assert not noted(tmp_path)
        assert list(searches.results(str(tmp_path), PARTS)) == expected(PARTS)
    assert all(pids == [str(os.getpid())] for pids in noted(tmp_path).values())


def test_parts_that_were_started_early_are_searched_once_and_answered_in_order(tmp_path):
    bench = str(tmp_path)
    with FoldSearches(search, 2) as searches:
        searches.start(bench, PARTS)
        searches.start(bench, PARTS)
        assert list(searches.results(bench, PARTS[::-1])) == expected(PARTS[::-1])
    found = noted(tmp_path)
    assert len(found) == len(PARTS)
    assert all(len(pids) == 1 and pids != [str(os.getpid())] for pids in found.values())


def test_parts_that_nobody_asks_for_are_given_up(tmp_path):
    bench = str(tmp_path)
    with FoldSearches(search, 2) as searches:
        searches.start(bench, PARTS)
        assert list(searches.results(bench, PARTS[3:4])) == expected(PARTS[3:4])
    assert expected(PARTS[3:4])[0][0] in noted(tmp_path)


def test_another_bench_gets_processes_of_its_own(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    with FoldSearches(search, 2) as searches:
        searches.start(str(first), PARTS[:1])
        assert list(searches.results(str(second), PARTS[:2])) == expected(PARTS[:2])
    assert len(noted(second)) == 2


def test_a_diagnosis_with_folds_that_start_early_is_the_same(monkeypatch):
    monkeypatch.setattr(answer, "_LONG_S", 0.0)
    started = []
    start = FoldSearches.start

    def counted(self, bench, parts):
        started.append(len(parts))
        start(self, bench, parts)

    monkeypatch.setattr(FoldSearches, "start", counted)
    effects = CATALOGUE["joint-compliance"]("joint-2"), CATALOGUE["joint-compliance"]("joint-3")
    recording = recorded(35, effects, [2e-5, 2e-5], n=80)
    alone, together = (answer.diagnose(recording, jobs=jobs) for jobs in (1, 2))
    assert started and min(started) > 5
    names = [(t.finding.effect, t.finding.where, t.finding.label) for t in alone.terms]
    assert names == [(t.finding.effect, t.finding.where, t.finding.label) for t in together.terms]
    for a, b in zip(alone.proof.schemes, together.proof.schemes):
        assert a["after"] == pytest.approx(b["after"], rel=1e-9)
        assert a["t"] == pytest.approx(b["t"], rel=1e-9)


def test_the_core_of_a_search_that_ended_takes_one_more_part(tmp_path):
    bench = str(tmp_path)
    with FoldSearches(search, 2) as searches:
        searches.use_all_cores()
        assert not searches.has_begun  # what a short search found is not worth processes
        searches.start(bench, PARTS)
        searches.use_all_cores()
        assert list(searches.results(bench, PARTS)) == expected(PARTS)
    assert all(len(pids) == 1 for pids in noted(tmp_path).values())


def sent(calls: list):
    """Stands for the processes: what is submitted is made at once, of copies of its arguments as a process has them."""

    def submit(function, *arguments) -> Future:
        future: Future = Future()
        copies = pickle.loads(pickle.dumps(arguments))
        future.set_result(function(*copies))
        calls.append(function)
        return future

    return submit


@pytest.fixture(scope="module")
def two_compliances():
    effects = CATALOGUE["joint-compliance"]("joint-2"), CATALOGUE["joint-compliance"]("joint-3")
    return recorded(35, effects, [2e-5, 2e-5], n=80), effects


def test_errors_that_were_begun_elsewhere_are_the_same_to_the_last_digit(
    two_compliances, monkeypatch
):
    recording, effects = two_compliances
    folds = np.arange(80) // 16, np.arange(80) % 4
    bench = bench_of(recording)
    here, elsewhere = Errors(bench), Errors(bench)
    expected = [here(effects, fold) for fold in folds]
    calls: list = []
    elsewhere.begin(effects, folds, sent(calls))
    elsewhere.begin((), folds[:1], sent([]))
    assert len(calls) == 5 + 4
    monkeypatch.setattr(held_out, "hold_out", None)  # nothing more is fitted here
    found = [elsewhere(effects[::-1], fold) for fold in folds]
    np.testing.assert_array_equal(found, expected)
    assert np.isfinite(found).all()
    for ours, theirs in zip(found, expected):
        np.testing.assert_array_equal(elsewhere.components_of(ours), here.components_of(theirs))


def test_errors_that_are_known_are_not_begun_again(two_compliances):
    recording, effects = two_compliances
    fold = np.arange(80) // 16
    errors = Errors(bench_of(recording))
    errors.prepare(effects, fold == 2)
    calls: list = []
    errors.begin(effects, [fold], sent(calls))
    assert len(calls) == 4


def test_the_baseline_is_predicted_while_the_last_fold_is_searched(two_compliances):
    """In both kinds of folds, and before the last result is waited for."""
    recording, effects = two_compliances
    bench = bench_of(recording)
    tested_schemes = proof.schemes(bench.pose, bench.problem((), hypotheses=False))
    errors = Errors(bench)
    known = []

    class Searches:
        def results(self, bench, subsets):
            for _ in subsets:
                known.append(len(errors._blocks))
                yield []

    folds = [scheme.fold for scheme in tested_schemes]
    proof._search_nested(bench, Searches(), tested_schemes[:1], str, errors, folds)
    total = sum(len(scheme.folds) for scheme in tested_schemes)
    assert known[:-1] == list(range(len(known) - 1)) and known[-1] == total
