"""Stages of a benchmark run on all cores: create, commit, diagnose, unblind, score; interrupted runs can be resumed."""

import json
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from workbench.core.errors import InputError
from workbench.files.runs import replace_file
from workbench.machine import processes
from workbench.machine.progress import paced
from workbench.proving import checks, protocol, scoring, tasks

Progress = Callable[[str], None]
QUESTIONS = "questions.json"


def create_cases(folder: Path, plan: tasks.Plan, jobs: int, progress: Progress) -> None:
    """Create missing cases, and publish the hashes of all truths and the baseline of each case."""
    exam = protocol.BenchmarkRun(folder)
    missing = [t for t in plan.tasks if not exam.truth(t.name).exists()]
    tick = paced(progress, "creating case")
    for done, _ in enumerate(_spread(tasks.create_case, [(folder, t) for t in missing], jobs), 1):
        tick(done, len(missing))
    publish(folder)


def publish(folder: Path) -> dict[str, str]:
    """Publish the hashes of all truths, and the questions, which contain only the baseline of each case."""
    exam = protocol.BenchmarkRun(folder)
    seals = protocol.seal(exam)
    truths = {name: protocol.read_object(exam.truth(name)) for name in seals}
    questions = {name: tasks.baseline(truth) for name, truth in truths.items()}
    replace_file(folder / QUESTIONS, json.dumps(questions, indent=1, sort_keys=True) + "\n")
    return seals


def run(
    folder: Path, names: Iterable[str], jobs: int, progress: Progress, minutes: float | None = None
) -> None:
    """Diagnose every case without an answer; the hashes are checked before and after.

    minutes: no diagnosis starts later than this from now. Cases are diagnosed by name, a random order; an
    incomplete run is therefore a random sample of all suites.
    """
    if minutes is None:
        until = float("inf")
    else:
        until = time.time() + 60 * minutes
    exam = protocol.BenchmarkRun(folder)
    seals = protocol.published(exam)
    protocol.check(exam, seals)
    questions = protocol.read_object(folder / QUESTIONS)
    missing = [name for name in names if not exam.answer(name).exists()]
    work = [(folder, name, questions[name], until) for name in missing]
    tick = paced(progress, "diagnosing case")
    for done, _ in enumerate(_spread(diagnose, work, jobs), 1):
        tick(done, len(missing))
    protocol.check(exam, seals)


def diagnose(folder: Path, name: str, baseline: str, until: float) -> None:
    """Diagnose one case in a process that has read no truth, unless the time `until` has passed."""
    if time.time() < until:
        _warm()
        protocol.run(
            folder, name, lambda recording: answer_of(recording, baseline), checks.program()
        )


def answer_of(recording: Path, baseline: str) -> dict:
    """The JSON of the diagnosis of a recording's folder, in plain Python types. Raises InputError."""
    import datasets
    from workbench.explanation.answer import diagnose as look

    found = look(datasets.read(recording), baseline=baseline).as_json()
    return plain(found)


def plain(found) -> dict:
    """The same object without numpy types; numbers that are not finite become null."""
    text = json.dumps(
        found, default=lambda value: value.tolist() if hasattr(value, "tolist") else str(value)
    )
    return json.loads(text, parse_constant=lambda word: None)


def open_all(folder: Path, names: Iterable[str], jobs: int, progress: Progress) -> list[dict]:
    """Rows of the scoreboard: unblind the cases, check their hashes, score them, and compare with the oracle."""
    from workbench.proving import oracle

    exam = protocol.BenchmarkRun(folder)
    seals = protocol.published(exam)
    protocol.check(exam, seals)
    names = list(names)
    missing = [(folder, name) for name in names if not exam.weighed(name).exists()]
    tick = paced(progress, "scoring case")
    for done, _ in enumerate(_spread(oracle.weigh, missing, jobs), 1):
        tick(done, len(missing))
    return [row_of(exam, name, seals) for name in names]


def row_of(exam: protocol.BenchmarkRun, name: str, seals) -> dict:
    """Row of an unblinded case: truth, claims, score."""
    truth = protocol.opened(exam, name, seals)
    record = protocol.read_object(exam.answer(name))
    known = {
        key: truth.get(key)
        for key in ("suite", "index", "robot", "measures", "samples", "sigma_mm", "noise")
    }
    sizes = [effect.get("survives_sigma") for effect in truth["effects"]]
    known |= {
        "concealed": [f"{effect['effect']} at {effect['where']}" for effect in truth["effects"]],
        "effects": truth["effects"],
        "survives_sigma": min((s for s in sizes if s is not None), default=None),
    }
    weighed = protocol.read_object(exam.weighed(name))
    if weighed.pop("answer_seal", None) not in (None, protocol.checksum(exam.answer(name))):
        raise InputError(
            f"{exam.answer(name)} was changed after its case was unblinded. This benchmark run is invalid. "
            "Start it again in a new folder."
        )
    if "rule" not in truth:
        scored = scoring.score(truth, record)
    else:
        scored = _by_rule(exam, truth, record)
    took = {"cpu_s": record.get("cpu_s", record["seconds"]), "program": record.get("program", "")}
    return {
        "case": name,
        "seal": seals[name],
        **known,
        **took,
        "opened": record["opened"],
        **scored,
        **weighed,
    }


def _by_rule(exam, truth, record) -> dict:
    from workbench.proving import real

    path = exam.answer(truth["twin"]) if "twin" in truth else None
    exists = path is not None and path.exists()
    original = protocol.read_object(path) if exists else None
    return real.score(truth, record, original)


def workers(jobs: int | None) -> int:
    """Number of processes: `jobs`, or one per core. Raises InputError."""
    if jobs is not None and jobs < 1:
        raise InputError(f"--jobs: expected a number from 1, found {jobs}. Correct or omit it.")
    return jobs or processes.cores()


def _spread(function: Callable, work: list[tuple], jobs: int) -> Iterator:
    """Results of the calls in order of completion, from new single-threaded processes; the first error is raised."""
    if not work:
        return
    from concurrent.futures import as_completed

    with processes.local(min(jobs, len(work)), "workbench.explanation.answer") as pool:
        running = [pool.submit(function, *arguments) for arguments in work]
        for done in as_completed(running):
            yield done.result()


def _warm() -> None:
    """Load libraries before the watch starts, and suppress numpy's warnings, which would hide the progress."""
    import warnings

    import datasets.reading  # noqa: F401
    import workbench.explanation.answer  # noqa: F401

    warnings.simplefilter("ignore")
