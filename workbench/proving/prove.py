"""The complete blind benchmark: cases are created, committed by hash, diagnosed, unblinded and scored."""

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_json
from workbench.files import runs
from workbench.proving import board, checks, protocol, stages, tasks

_SETTINGS = "settings.json"


def prove(
    folder: Path,
    suites: Sequence[str] = (),
    cases: int | None = None,
    seed: int = 1,
    own_data: Path | None = None,
    jobs: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
    minutes: float | None = None,
) -> board.Board:
    """Run the benchmark in `folder`, or continue the run that is there, and return its scoreboard.

    suites: names of `workbench.proving.tasks.COUNTS`, or `name=count`; all suites if empty. cases: number for each
    suite without a count; None: the full number. own: a folder with the user's recordings and truths, instead of the
    suites. jobs: number of processes; default: one per core. minutes: no diagnosis starts later. The scoreboard covers
    all diagnosed cases of the folder, of this and of earlier calls. Raises InputError, also if a truth was changed.
    """
    count = stages.workers(jobs)
    if own_data:
        plan = tasks.Plan(())
    else:
        plan = tasks.plan(suites, cases, seed)
    if own_data is None and not plan.tasks:
        raise InputError(
            "prove: no case can be created here: "
            + "; ".join(f"suite {suite}: {why}" for suite, why in plan.skipped.items())
            + ". Name another suite."
        )
    planned = _settle(folder, seed, str(own_data.resolve()) if own_data else None, plan.counts)
    exam = protocol.BenchmarkRun(folder)
    names = _commit(exam, plan, own_data, count, progress)
    stages.run(folder, names, count, progress, minutes)
    rows = stages.open_all(
        folder, [name for name in exam.names() if exam.answer(name).exists()], count, progress
    )
    scoreboard = board.board(
        rows,
        plan.skipped,
        seed,
        _command(planned, seed, own_data),
        checks.checks(exam, rows),
        planned,
    )
    board.save(scoreboard, folder)
    return scoreboard


def _commit(
    exam: protocol.BenchmarkRun, plan: tasks.Plan, own_data: Path | None, count: int, progress
) -> list[str]:
    """Create the cases of this call, publish the hashes of their truths, and return their names."""
    if own_data is None:
        stages.create_cases(exam.folder, plan, count, progress)
        names = sorted(task.name for task in plan.tasks)
    else:
        names = bring(exam, own_data)
        stages.publish(exam.folder)
    digest = board.publish_seals(exam.folder, protocol.published(exam))
    progress(f"hashes of {len(names)} truths published, SHA-256 of all hashes {digest[:16]}…")
    return names


def default_folder(seed: int, own_data: Path | None) -> Path:
    """Default folder of a benchmark run; the same call continues the run in the same folder.

    The name of a run on the user's recordings contains a checksum of their path.
    """
    if own_data is None:
        return runs.RUNS / f"prove-seed-{seed}"
    place = hashlib.sha256(
        str(Path(own_data).resolve()).encode("utf-8", "surrogatepass")
    ).hexdigest()[:8]
    return runs.RUNS / f"prove-{runs.slug(own_data)}-{place}"


def bring(exam: protocol.BenchmarkRun, own_data: Path) -> list[str]:
    """Copy the user's recordings and truths: `recordings/<case>/` and `sealed/<case>.json`.

    If the folder has a SHA256SUMS, every truth must match it. Returns the names of the cases. Raises InputError.
    """
    truths = sorted((own_data / "sealed").glob("*.json"))
    if not truths:
        raise InputError(
            f"--folder {own_data}: expected sealed/<case>.json for every recordings/<case>/, found none. "
            'Write them as {"effects": [{"effect": …, "where": …}]}.'
        )
    checksums = _sums(own_data / "SHA256SUMS")
    for path in truths:
        name = path.stem
        source = own_data / "recordings" / path.stem
        if not (source / "recording.toml").exists():
            raise InputError(
                f"--folder {own_data}: sealed/{path.name} has no recordings/{name}/recording.toml. "
                "Add the recording or remove the truth."
            )
        if checksums and checksums.get(name) != protocol.checksum(path):
            raise InputError(
                f"{path}: SHA256SUMS of {own_data} has another checksum: the truth was changed after its hash was "
                "published. Restore the original file."
            )
        text = _checked_truth(path)
        copy = partial(shutil.copytree, source)
        protocol.write_case(exam, name, copy, lambda text=text: text)
    return [path.stem for path in truths]


def _checked_truth(path: Path) -> str:
    """The text of a truth of the user. Raises InputError where it lacks what the scoring reads."""
    try:
        truth = read_json(path)
        found = "something else"
    except (OSError, ContentError) as problem:
        truth, found = None, str(problem)
    effects = truth.get("effects") if isinstance(truth, dict) else None
    if not isinstance(effects, list) or not all(_is_effect(effect) for effect in effects):
        raise InputError(
            f'{path}: expected an object with a list "effects" of objects with "effect" and "where" '
            f"(an empty list if no effect is planted), found {found}. Correct the file."
        )
    return json.dumps(truth)


def _is_effect(effect) -> bool:
    if not isinstance(effect, dict):
        return False
    names = isinstance(effect.get("effect"), str) and isinstance(effect.get("where"), str)
    size = effect.get("survives_sigma")
    return names and (size is None or isinstance(size, int | float))


def _sums(path: Path) -> dict[str, str]:
    """Case -> checksum of a SHA256SUMS file, {} without one. Raises InputError."""
    if not path.exists():
        return {}
    rows = [line.split(maxsplit=1) for line in _read_lines(path) if line.strip()]
    if bad := [number for number, row in enumerate(rows, 1) if len(row) != 2]:
        raise InputError(
            f"{path}, row {bad[0]}: expected a checksum and a file name, found one word. "
            "Write the file with sha256sum."
        )
    return {Path(name.strip().lstrip("*")).stem: seal for seal, name in rows}


def _read_lines(path: Path) -> list[str]:
    """The lines of a UTF-8 text file. Raises InputError."""
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as problem:
        raise InputError(
            f"{path}: expected readable UTF-8 text, found {problem}. Correct or remove the file."
        ) from None


def _settle(
    folder: Path, seed: int, own_data: str | None, counts: Mapping[str, int]
) -> dict[str, int]:
    """Start a benchmark run, or continue one of the same seed and source. Returns the planned cases of each suite."""
    path = folder / _SETTINGS
    known = _settings(path)
    if known is None and folder.is_dir() and any(folder.iterdir()):
        raise InputError(
            f"{folder} contains other files. A benchmark run needs a new folder, an empty one, or its own. "
            "Name another folder with --out."
        )
    if known and (known["seed"], known["own"]) != (seed, own_data):
        raise InputError(
            f"{folder} contains a benchmark run of seed {known['seed']}, found --seed {seed}. "
            "Name another folder with --out."
        )
    before = known["planned"] if known else {}
    planned = {
        suite: max(counts.get(suite, 0), before.get(suite, 0)) for suite in {**before, **counts}
    }
    folder.mkdir(parents=True, exist_ok=True)
    runs.replace_file(
        path, json.dumps({"seed": seed, "own": own_data, "planned": planned}, indent=1) + "\n"
    )
    return planned


def _settings(path: Path) -> dict | None:
    """Settings of an earlier call, None in a new folder. Raises InputError where they are damaged."""
    if not path.exists():
        return None
    known = protocol.read_object(path)
    planned = known.get("planned")
    is_whole = isinstance(known.get("seed"), int) and isinstance(planned, dict) and "own" in known
    if not is_whole or not all(isinstance(count, int) for count in planned.values()):
        raise protocol.damaged(path, "incomplete settings")
    return known


def _command(planned, seed, own_data) -> str:
    if own_data:
        return f"workbench prove --folder {own_data}"
    return " ".join(
        [
            "workbench prove",
            *(f"--suite {suite}={n}" for suite, n in planned.items()),
            f"--seed {seed}",
        ]
    )
