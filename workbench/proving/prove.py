"""The blind proof from end to end: cases concealed, sealed, diagnosed, opened, scored, and a scoreboard of them."""

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from workbench.core.errors import InputError
from workbench.files import runs
from workbench.proving import board, checks, protocol, stages, tasks

_SETTINGS = "settings.json"


def prove(
    folder: Path,
    suites: Sequence[str] = (),
    cases: int | None = None,
    seed: int = 1,
    own: Path | None = None,
    jobs: int | None = None,
    say: Callable[[str], None] = lambda text: None,
    minutes: float | None = None,
) -> board.Board:
    """Hold the examination in `folder`, or go on with the one that lies there, and return its scoreboard.

    suites: names of `workbench.proving.tasks.COUNTS`, all where none is named; `name=count` for so many of one.
    cases: of each suite without a count; None: as many as the whole examination has. own: a folder of recordings and
    sealed answers of one's own, and then no suite is made. jobs: processes, one a core where not given. minutes: no
    diagnosis begins later. The scoreboard is of every case of the folder that has been diagnosed, in this call or in
    an earlier one. Raises InputError, also where a sealed truth was changed.
    """
    count = stages.workers(jobs)
    plan = tasks.Plan(()) if own else tasks.plan(suites, cases, seed)
    if own is None and not plan.tasks:
        raise InputError(
            "prove: no case can be made here, because "
            + "; ".join(f"suite {suite}: {why}" for suite, why in plan.skipped.items())
            + "; name another suite."
        )
    planned = _settle(folder, seed, str(own.resolve()) if own else None, plan.counts)
    exam = protocol.Examination(folder)
    names = _sealed(exam, plan, own, count, say)
    stages.run(folder, names, count, say, minutes)
    rows = stages.open_all(
        folder, [name for name in exam.names() if exam.answer(name).exists()], count, say
    )
    made = board.board(
        rows, plan.skipped, seed, _command(planned, seed, own), checks.checks(exam, rows), planned
    )
    board.save(made, folder)
    return made


def _sealed(
    exam: protocol.Examination, plan: tasks.Plan, own: Path | None, count: int, say
) -> list[str]:
    """Names of the cases of this call, concealed and with their seals published."""
    if own is None:
        stages.conceal(exam.folder, plan, count, say)
        names = sorted(task.name for task in plan.tasks)
    else:
        names = bring(exam, own)
        stages.publish(exam.folder)
    digest = board.publish_seals(exam.folder, protocol.published(exam))
    say(f"{len(names)} truths sealed, SHA-256 of all seals {digest[:16]}…")
    return names


def default_folder(seed: int, own: Path | None) -> Path:
    """Where an examination lies when no folder is named, so that the same call goes on with it.

    Folders of one's own that share their last name have examinations of their own.
    """
    if own is None:
        return runs.RUNS / f"prove-seed-{seed}"
    place = hashlib.sha256(str(Path(own).resolve()).encode("utf-8", "surrogatepass")).hexdigest()[
        :8
    ]
    return runs.RUNS / f"prove-{runs.slug(own)}-{place}"


def bring(exam: protocol.Examination, own: Path) -> list[str]:
    """Take over recordings and sealed answers of somebody's own: `recordings/<case>/` and `sealed/<case>.json`.

    Where the folder has a SHA256SUMS, every truth must fit it. Returns the names of the cases. Raises InputError.
    """
    truths = sorted((own / "sealed").glob("*.json"))
    if not truths:
        raise InputError(
            f"--folder {own}: sealed/<case>.json is expected for every recordings/<case>/, found none; "
            'write them as {"effects": [{"effect": …, "where": …}]}.'
        )
    told = _sums(own / "SHA256SUMS")
    for path in truths:
        name, source = path.stem, own / "recordings" / path.stem
        if not (source / "recording.toml").exists():
            raise InputError(
                f"--folder {own}: {path.name} is sealed, and recordings/{name}/recording.toml is not "
                "there; add the recording or remove the answer."
            )
        if told and told.get(name) != protocol.checksum(path):
            raise InputError(
                f"{path}: SHA256SUMS of {own} has another checksum, so this truth was changed after it "
                "was sealed; bring back the sealed one."
            )
        text = path.read_text(encoding="utf-8")
        _check_truth(path, text)
        copy = partial(shutil.copytree, source)
        protocol.conceal(exam, name, copy, lambda text=text: text)
    return [path.stem for path in truths]


def _check_truth(path: Path, text: str) -> None:
    try:
        effects = json.loads(text)["effects"]
        complete = all({"effect", "where"} <= set(one) for one in effects)
    except (ValueError, KeyError, TypeError):
        complete = False
    if not complete:
        raise InputError(
            f'{path}: expected an object with a list "effects" of objects with "effect" and "where" '
            "(an empty list where nothing is concealed), found something else; correct it."
        )


def _sums(path: Path) -> dict[str, str]:
    if not path.exists():
        return {}
    rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    return {Path(name).stem: seal for seal, name in (row[:2] for row in rows)}


def _settle(folder: Path, seed: int, own: str | None, counts: Mapping[str, int]) -> dict[str, int]:
    """Begin an examination, or go on with one of the same seed and source; cases of each suite in all calls so far."""
    path = folder / _SETTINGS
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
    if known is None and folder.is_dir() and any(folder.iterdir()):
        raise InputError(
            f"{folder} already holds other files, where an examination expects a folder that is new, "
            "empty or its own; name another one with --out."
        )
    if known and (known["seed"], known["own"]) != (seed, own):
        raise InputError(
            f"{folder} holds an examination of seed {known['seed']}, found --seed {seed}; "
            "name another folder with --out."
        )
    before = known["planned"] if known else {}
    planned = {
        suite: max(counts.get(suite, 0), before.get(suite, 0)) for suite in {**before, **counts}
    }
    folder.mkdir(parents=True, exist_ok=True)
    runs.replace_file(
        path, json.dumps({"seed": seed, "own": own, "planned": planned}, indent=1) + "\n"
    )
    return planned


def _command(planned, seed, own) -> str:
    if own:
        return f"workbench prove --folder {own}"
    return " ".join(
        [
            "workbench prove",
            *(f"--suite {suite}={n}" for suite, n in planned.items()),
            f"--seed {seed}",
        ]
    )
