"""The blind proof from end to end: cases concealed, sealed, diagnosed, opened, scored, and a scoreboard of them."""

import json
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from workbench import concealed, runs
from workbench.core.errors import InputError
from workbench.proving import board, stages, tasks

_SETTINGS = "settings.json"


def prove(
    folder: Path,
    suites: Sequence[str] = (),
    cases: int | None = None,
    seed: int = 1,
    own: Path | None = None,
    jobs: int | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> board.Board:
    """Hold the examination in `folder`, or go on with the one that lies there, and return its scoreboard.

    suites: names of `workbench.proving.tasks.COUNTS`, all where none is named. cases: of each suite; None: as many as
    the whole examination has. own: a folder of recordings and sealed answers of one's own, and then no suite is made.
    jobs: processes, one a core where not given. Raises InputError, also where a sealed truth was changed.
    """
    count = stages.workers(jobs)
    plan = tasks.Plan(()) if own else tasks.plan(suites, cases, seed)
    if own is None and not plan.tasks:
        raise InputError("prove: no case can be made here, because " + "; ".join(
            f"suite {suite}: {why}" for suite, why in plan.skipped.items()) + "; name another suite.")  # fmt: skip
    _settle(folder, {"suites": list(suites), "seed": seed, "own": str(own.resolve()) if own else None})
    exam = concealed.Examination(folder)
    if own is None:
        stages.conceal(folder, plan, count, say)
        names = sorted(task.name for task in plan.tasks)
    else:
        names = bring(exam, own)
        stages.publish(folder)
    digest = board.publish_seals(folder, concealed.published(exam))
    say(f"{len(names)} truths sealed, SHA-256 of all seals {digest[:16]}…")
    stages.run(folder, names, count, say)
    rows = stages.open_all(folder, names, count, say)
    made = board.board(rows, plan.skipped, seed, _command(suites, cases, seed, own))
    board.save(made, folder)
    return made


def default_folder(seed: int, own: Path | None) -> Path:
    """Where an examination lies when no folder is named, so that the same call goes on with it."""
    return runs.RUNS / (f"prove-seed-{seed}" if own is None else f"prove-{runs.slug(own)}")


def bring(exam: concealed.Examination, own: Path) -> list[str]:
    """Take over recordings and sealed answers of somebody's own: `recordings/<case>/` and `sealed/<case>.json`.

    Where the folder has a SHA256SUMS, every truth must fit it. Returns the names of the cases. Raises InputError.
    """
    truths = sorted((own / "sealed").glob("*.json"))
    if not truths:
        raise InputError(f"--folder {own}: sealed/<case>.json is expected for every recordings/<case>/, found none; "
                         "write them as {\"effects\": [{\"effect\": …, \"where\": …}]}.")  # fmt: skip
    told = _sums(own / "SHA256SUMS")
    for path in truths:
        name, source = path.stem, own / "recordings" / path.stem
        if not (source / "recording.toml").exists():
            raise InputError(f"--folder {own}: {path.name} is sealed, and recordings/{name}/recording.toml is not "
                             "there; add the recording or remove the answer.")  # fmt: skip
        if told and told.get(name) != concealed.checksum(path):
            raise InputError(f"{path}: SHA256SUMS of {own} has another checksum, so this truth was changed after it "
                             "was sealed; bring back the sealed one.")  # fmt: skip
        text = path.read_text(encoding="utf-8")
        _check_truth(path, text)
        copy = partial(shutil.copytree, source)
        concealed.conceal(exam, name, copy, lambda text=text: text)
    return [path.stem for path in truths]


def _check_truth(path: Path, text: str) -> None:
    try:
        effects = json.loads(text)["effects"]
        complete = all({"effect", "where"} <= set(one) for one in effects)
    except (ValueError, KeyError, TypeError):
        complete = False
    if not complete:
        raise InputError(f"{path}: expected an object with a list \"effects\" of objects with \"effect\" and \"where\" "
                         "(an empty list where nothing is concealed), found something else; correct it.")  # fmt: skip


def _sums(path: Path) -> dict[str, str]:
    if not path.exists():
        return {}
    rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    return {Path(name).stem: seal for seal, name in (row[:2] for row in rows)}


def _settle(folder: Path, settings: dict) -> None:
    """Begin an examination, or make sure that the one that lies there is of the same seed and source."""
    path = folder / _SETTINGS
    if path.exists():
        known = json.loads(path.read_text(encoding="utf-8"))
        if (known["seed"], known["own"]) != (settings["seed"], settings["own"]):
            raise InputError(f"{folder} holds an examination of seed {known['seed']}, found --seed "
                             f"{settings['seed']}; name another folder with --out.")  # fmt: skip
        return
    if folder.is_dir() and any(folder.iterdir()):
        raise InputError(f"{folder} already holds other files, where an examination expects a folder that is new, "
                         "empty or its own; name another one with --out.")  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    runs.replace_file(path, json.dumps(settings, indent=1) + "\n")


def _command(suites, cases, seed, own) -> str:
    words = ["workbench prove", *(f"--suite {suite}" for suite in suites)]
    words += [f"--cases {cases}"] if cases else []
    return " ".join(words + ([f"--folder {own}"] if own else [f"--seed {seed}"]))
