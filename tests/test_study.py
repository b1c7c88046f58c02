"""A study's table is the same however it is made: in one go, stopped and resumed, on any executor, run by run."""

from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import study_scenes as scenes
from workbench.core.errors import InputError, Stopped
from workbench.studies import executors, folder, tables
from workbench.studies.engine import carry_out, do_part, given, part_size, parts_of
from workbench.studies.runs import row_of, seed_of
from workbench.studies.spec import read_study, study_names
from workbench.studies.study import carried_out, read
from workbench.studies.variation import BLOCK, count, unit_of, values_of


def quiet(*_):
    """Progress that nobody reads."""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return read(scenes.written(tmp_path_factory.mktemp("study")))[0]


def table_of(study, place: Path, executor, workers=2, work=do_part):
    """The whole table of a study done in `place`."""
    (place / tables.PARTS_FOLDER).mkdir(parents=True, exist_ok=True)
    carry_out(study, place, executor, workers, quiet, work)
    tables.put_together(place, len(parts_of(study)))
    return pq.read_table(place / tables.TABLE)


def threads(count=2):
    pool = ThreadPoolExecutor(count)
    return partial(given, pool)


@pytest.fixture(scope="module")
def reference(study, tmp_path_factory):
    return table_of(study, tmp_path_factory.mktemp("reference"), threads())


def test_every_run_can_be_made_again_alone_from_its_number(study, reference):
    for run in (40, 7, 23):
        assert row_of(study, run) == reference.to_pylist()[run - 1]


def test_the_table_holds_every_run_once_and_in_order(study, reference):
    assert reference.column("run").to_pylist() == list(range(1, 41))
    assert set(reference.column("outcome").to_pylist()) == {"done"}


def test_processes_and_threads_make_the_same_rows_bit_for_bit(study, reference, tmp_path):
    assert table_of(study, tmp_path, partial(executors.local, 2)).equals(reference)


def test_a_stopped_study_goes_on_and_does_nothing_twice(study, reference, tmp_path):
    marks = tmp_path / "marks"
    marks.mkdir()
    (tmp_path / tables.PARTS_FOLDER).mkdir()

    def stop(done, total):
        if done >= 15:
            raise KeyboardInterrupt

    work = partial(scenes.noted, str(marks), 0.0)
    with pytest.raises(KeyboardInterrupt), ThreadPoolExecutor(1) as pool:
        carry_out(study, tmp_path, partial(given, pool), 1, stop, work)
    kept = tables.parts_done(tmp_path)
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / tables.PARTS_FOLDER).iterdir()}
    assert 5 <= len(kept) < len(parts_of(study))
    resumed = table_of(study, tmp_path, threads(1), 1, work)
    assert resumed.equals(reference)
    assert all(path.stat().st_mtime_ns == when for path, when in written.items())
    for k in kept:
        assert all(
            len((marks / f"run-{run}").read_text().split()) == 1 for run in parts_of(study)[k]
        )


def test_a_process_that_dies_takes_no_run_with_it(study, reference, tmp_path):
    work = partial(scenes.dying_once, str(tmp_path))
    assert table_of(study, tmp_path, partial(executors.local, 2), work=work).equals(reference)
    assert (tmp_path / "died").exists()


def test_a_process_that_always_dies_ends_in_one_sentence(study, tmp_path):
    class Broken:
        def submit(self, *_):
            raise BrokenProcessPool

    (tmp_path / tables.PARTS_FOLDER).mkdir()
    with pytest.raises(InputError, match="the process of these runs died 3 times"):
        carry_out(study, tmp_path, partial(given, Broken()), 1, quiet)


def test_few_parts_are_in_flight_however_many_runs_there_are(study, tmp_path):
    long = study.model_copy(update={"vary": study.vary.model_copy(update={"runs": 600}), "part": 1})
    (tmp_path / tables.PARTS_FOLDER).mkdir()
    most = []

    class Counting(ThreadPoolExecutor):
        def submit(self, work, *words):
            most.append(self._work_queue.qsize())
            return super().submit(work, *words)

    def nothing(study, runs):
        return [{"run": run, "outcome": "done"} for run in runs], 0.0

    with Counting(2) as pool:
        carry_out(long, tmp_path, partial(given, pool), 2, quiet, nothing)
    assert max(most) <= 5 and len(tables.parts_done(tmp_path)) == 600


def test_parts_are_the_same_on_any_machine_and_not_too_many(study):
    for runs in (1, 40, 1000, 10**6, 10**8):
        long = study.model_copy(
            update={"vary": study.vary.model_copy(update={"runs": runs}), "part": None}
        )
        assert 1 <= part_size(long) <= 500
    assert [len(part) for part in parts_of(study)] == [3] * 13 + [1]


def test_a_study_is_whole_or_not_there_and_is_found_again(study, tmp_path):
    path, messages = scenes.written(tmp_path, ("runs = 40", "runs = 6")), []
    first = carried_out(path, tmp_path / "out", 1, None, messages.append)
    assert first.path == tmp_path / "out" and first.done.made == 6
    assert {p.name for p in first.path.iterdir()} == {"study.json", "table.parquet", "table.csv"}
    assert any("run 6 of 6" in line for line in messages)
    again = carried_out(path, tmp_path / "out", 1, None, quiet)
    assert again.done is None and again.path == first.path
    changed = scenes.written(tmp_path, ("runs = 40", "runs = 7"))
    with pytest.raises(InputError, match="contains other files"):
        carried_out(changed, tmp_path / "out", 1, None, quiet)


def test_an_interrupt_says_what_is_kept_and_the_next_start_ends_it(study, tmp_path, monkeypatch):
    path = scenes.written(tmp_path)

    def stop(line):
        if "run 15 of" in line:
            raise KeyboardInterrupt

    with pytest.raises(Stopped, match=r"15 of 40 runs are saved in .*. The same command continues"):
        carried_out(path, tmp_path / "out", 1, None, stop)
    assert not (tmp_path / "out").exists() and (tmp_path / ".partial-out").is_dir()
    done = carried_out(path, tmp_path / "out", 1, None, quiet)
    assert done.done.made == 25 and not (tmp_path / ".partial-out").exists()
    assert pq.read_table(done.path / tables.TABLE).num_rows == 40


def test_only_one_process_works_at_a_study(study, tmp_path):
    place = folder.place_of("small", study, "", tmp_path / "out")
    with folder.opened(place, study, ""):
        with (
            pytest.raises(InputError, match="being written by another process"),
            folder.opened(place, study, ""),
        ):
            pass
        assert place.partial.is_dir()


@pytest.mark.parametrize("method", ["random", "latin-hypercube", "sobol"])
def test_samples_fill_the_range_and_do_not_depend_on_the_order(study, method):
    runs = BLOCK + 100
    long = study.model_copy(
        update={"vary": study.vary.model_copy(update={"runs": runs, "method": method})}
    )
    backwards = [values_of(long, run)["c2"] for run in range(runs, 0, -1)]
    unit = unit_of(long.vary.parameter[0], np.array(backwards[::-1]))
    assert [values_of(long, run)["c2"] for run in (1, BLOCK, BLOCK + 1)] == [
        backwards[-1],
        backwards[-BLOCK],
        backwards[-BLOCK - 1],
    ]
    assert len(set(backwards)) == runs and (0 <= unit).all() and (unit < 1).all()
    # Kolmogorov's distance from the uniform distribution that one sample in a thousand exceeds, much less for the others
    gap = np.abs(np.sort(unit) - (np.arange(runs) + 0.5) / runs).max()
    assert gap < (1.95 / np.sqrt(runs) if method == "random" else 0.01)


def test_a_latin_hypercube_has_one_run_in_every_slice(study):
    made = study.model_copy(
        update={"vary": study.vary.model_copy(update={"runs": 64, "method": "latin-hypercube"})}
    )
    unit = unit_of(
        made.vary.parameter[0], np.array([values_of(made, run)["c2"] for run in range(1, 65)])
    )
    assert sorted((unit * 64).astype(int)) == list(range(64))


def test_a_grid_has_every_combination_and_repeats_have_other_noise(tmp_path):
    text = scenes.TEXT.replace(
        'method = "sobol"\nruns = 40', 'method = "grid"\nrepeats = 2'
    ).replace("low = 1e-5\nhigh = 1e-4", "values = [1e-5, 1e-4]")
    text = text.replace(
        "[test]",
        '[[vary.parameter]]\nname = "noise"\npath = "scene.sigma_mm"\nlow = 0.01\nhigh = 0.03\nlevels = 3\n[test]',
    )
    made = read(scenes.written(tmp_path, text=text))[0]
    assert count(made) == 12
    pairs = [tuple(values_of(made, run).values()) for run in range(1, 13, 2)]
    assert sorted(pairs) == [
        (c, pytest.approx(s)) for c in (1e-5, 1e-4) for s in (0.01, 0.02, 0.03)
    ]
    assert values_of(made, 1) == values_of(made, 2) and seed_of(made, 1) != seed_of(made, 2)
    same = made.model_copy(update={"vary": made.vary.model_copy(update={"same_noise": True})})
    assert seed_of(same, 1) == seed_of(same, 3) != seed_of(same, 2)


def test_every_study_that_comes_along_can_be_read():
    assert len(study_names()) >= 4
    for name in study_names():
        assert count(read_study(name)) >= 1


def test_a_run_that_cannot_be_done_says_why_and_the_others_go_on(tmp_path):
    path = scenes.written(
        tmp_path,
        ("part = 3", "part = 3\nfolds = 5"),
        ('do = ["simulate"]', 'do = ["simulate", "calibrate"]'),
        ("runs = 40", "runs = 4"),
        ("samples = 20\n", "samples = 20\n"),
    )
    text = path.read_text().replace(
        "[[vary.parameter]]",
        '[[vary.parameter]]\nname = "poses"\npath = "design.count"\nvalues = [2, 18]\n[[vary.parameter]]',
    )
    made = read(scenes.written(tmp_path, text=text))[0]
    rows = [row_of(made, run) for run in range(1, 5)]
    bad = [row for row in rows if row["outcome"] != "done"]
    assert 0 < len(bad) < 4 and all("expected at least 4 poses" in row["outcome"] for row in bad)
    (tmp_path / tables.PARTS_FOLDER).mkdir()
    made_table = table_of(made, tmp_path, threads())
    assert made_table.column("outcome").to_pylist() == [row["outcome"] for row in rows]
    assert made_table.column("geometry_test_mm").null_count == len(bad)
