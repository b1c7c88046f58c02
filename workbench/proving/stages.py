"""Conceals, seals, diagnoses, opens and weighs all cases, on all cores, and goes on where it was interrupted."""

import json
import os
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from workbench.core.errors import InputError
from workbench.files.runs import replace_file
from workbench.machine import processes
from workbench.proving import checks, protocol, scoring, tasks

Say = Callable[[str], None]
QUESTIONS = "questions.json"


def conceal(folder: Path, plan: tasks.Plan, jobs: int, say: Say) -> None:
    """Make what is not there yet and publish all seals, and with them the question of each case: its baseline."""
    exam = protocol.Examination(folder)
    missing = [t for t in plan.tasks if not exam.truth(t.name).exists()]
    for done, _ in enumerate(_spread(tasks.conceal, [(folder, t) for t in missing], jobs), 1):
        say(f"concealing {done} of {len(missing)}")
    publish(folder)


def publish(folder: Path) -> dict[str, str]:
    """Seals of all truths; and the questions, which hold nothing that the answer could use but the baseline."""
    exam = protocol.Examination(folder)
    seals = protocol.seal(exam)
    truths = {name: json.loads(exam.truth(name).read_text(encoding="utf-8")) for name in seals}
    questions = {name: tasks.baseline(truth) for name, truth in truths.items()}
    replace_file(folder / QUESTIONS, json.dumps(questions, indent=1, sort_keys=True) + "\n")
    return seals


def run(
    folder: Path, names: Iterable[str], jobs: int, say: Say, minutes: float | None = None
) -> None:
    """Diagnose every case that has no answer; the seals are checked before and after.

    minutes: no diagnosis begins later than so long from now. Cases go by their names, an order by chance, so that
    what the time allows is a fair sample of all suites.
    """
    until = float("inf") if minutes is None else time.time() + 60 * minutes
    exam = protocol.Examination(folder)
    seals = protocol.published(exam)
    protocol.check(exam, seals)
    questions = json.loads((folder / QUESTIONS).read_text(encoding="utf-8"))
    missing = [name for name in names if not exam.answer(name).exists()]
    work = [(folder, name, questions[name], until) for name in missing]
    for done, _ in enumerate(_spread(diagnose, work, jobs), 1):
        say(f"diagnosing {done} of {len(missing)}")
    protocol.check(exam, seals)


def diagnose(folder: Path, name: str, baseline: str, until: float = float("inf")) -> None:
    """One case, in a process that has seen no truth; not when the time `until` has passed."""
    if time.time() < until:
        _warm()
        protocol.run(
            folder, name, lambda recording: answer_of(recording, baseline), checks.program()
        )


def answer_of(recording: Path, baseline: str) -> dict:
    """The JSON of the diagnosis of a recording's folder, as plain numbers. Raises InputError."""
    import datasets
    from workbench.diagnosis.answer import diagnose as look

    found = look(datasets.read(recording), baseline=baseline).as_json()
    return plain(found)


def plain(found) -> dict:
    """The same object without numpy's numbers; what is not finite becomes null."""
    text = json.dumps(
        found, default=lambda value: value.tolist() if hasattr(value, "tolist") else str(value)
    )
    return json.loads(text, parse_constant=lambda word: None)


def open_all(folder: Path, names: Iterable[str], jobs: int, say: Say) -> list[dict]:
    """Rows of the scoreboard: every case opened against its seal, scored, and weighed against the oracle."""
    from workbench.proving import oracle

    exam = protocol.Examination(folder)
    seals = protocol.published(exam)
    protocol.check(exam, seals)
    names = list(names)
    missing = [(folder, name) for name in names if not exam.weighed(name).exists()]
    for done, _ in enumerate(_spread(oracle.weigh, missing, jobs), 1):
        say(f"weighing {done} of {len(missing)}")
    return [row_of(exam, name, seals) for name in names]


def row_of(exam: protocol.Examination, name: str, seals) -> dict:
    """One opened case: what was concealed, what was said, what it is worth."""
    truth = protocol.opened(exam, name, seals)
    record = json.loads(exam.answer(name).read_text(encoding="utf-8"))
    known = {
        key: truth.get(key)
        for key in ("suite", "index", "robot", "measures", "samples", "sigma_mm", "noise")
    }
    sizes = [one.get("survives_sigma") for one in truth["effects"]]
    known |= {
        "concealed": [f"{one['effect']} at {one['where']}" for one in truth["effects"]],
        "effects": truth["effects"],
        "survives_sigma": min((s for s in sizes if s is not None), default=None),
    }
    weighed = json.loads(exam.weighed(name).read_text(encoding="utf-8"))
    if weighed.pop("answer_seal", None) not in (None, protocol.checksum(exam.answer(name))):
        raise InputError(
            f"{exam.answer(name)} was changed after its case was opened, where an answer comes first; "
            "this examination proves nothing, begin it again in a new folder."
        )
    scored = scoring.score(truth, record) if "rule" not in truth else _by_rule(exam, truth, record)
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

    other = exam.answer(truth["twin"]) if "twin" in truth else None
    twin = (
        json.loads(other.read_text(encoding="utf-8"))
        if other is not None and other.exists()
        else None
    )
    return real.score(truth, record, twin)


def workers(jobs: int | None) -> int:
    """As many processes as asked for, else one a core. Raises InputError."""
    if jobs is not None and jobs < 1:
        raise InputError(f"--jobs expects a number from 1, found {jobs}; give one or leave it out.")
    return jobs or processes.cores()


def _spread(function: Callable, work: list[tuple], jobs: int) -> Iterator:
    """Results of the calls as they come, from fresh processes of one thread each; the first error is raised."""
    if not work:
        return
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    for name in processes.THREADS:
        os.environ.setdefault(
            name, "1"
        )  # before numpy is loaded there: a thread a process, a process a core
    with ProcessPoolExecutor(min(jobs, len(work)), mp_context=get_context("spawn")) as pool:
        running = [pool.submit(function, *arguments) for arguments in work]
        try:
            for done in as_completed(running):
                yield done.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _warm() -> None:
    """What libraries load on first use, before anything is watched; numpy's asides would bury the progress."""
    import warnings

    import datasets.reading  # noqa: F401
    import workbench.diagnosis.answer  # noqa: F401

    warnings.simplefilter("ignore")
