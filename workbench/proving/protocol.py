"""Protocol of the blind benchmark: create the cases, commit the truths by hash, diagnose, unblind.

A benchmark run is a folder:

    seals.json            case -> SHA-256 of its truth, written before any diagnosis starts
    cases/<case>/         recording/, the only input of a diagnosis, and answer.json
    sealed/<case>.json    the truth, read only after the answer is written

The name of a case is a checksum of its number; it does not reveal the suite.
"""

import hashlib
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_json
from workbench.files.runs import replace_file

PATIENCE_S = 1200
"""Limit of processor time for a diagnosis; without an answer the case counts as failed."""
_WAIT = 6  # limit of wall-clock time, in multiples of PATIENCE_S: the machine may be shared


@dataclass(frozen=True)
class BenchmarkRun:
    """Paths of the files of a benchmark run."""

    folder: Path

    @property
    def seals(self) -> Path:
        return self.folder / "seals.json"

    def recording(self, name: str) -> Path:
        """The input folder of the diagnosis of a case."""
        return self.folder / "cases" / name / "recording"

    def answer(self, name: str) -> Path:
        """Answer of the diagnosis, its duration, and files that it opened against the rules."""
        return self.folder / "cases" / name / "answer.json"

    def weighed(self, name: str) -> Path:
        """Held-out errors of the oracle, computed after unblinding."""
        return self.folder / "cases" / name / "oracle.json"

    def truth(self, name: str) -> Path:
        return self.folder / "sealed" / f"{name}.json"

    def names(self) -> list[str]:
        """Names of all committed cases in alphabetical order, which is a random order of the cases."""
        return sorted(path.stem for path in (self.folder / "sealed").glob("*.json"))


def name_of(suite: str, index: int, seed: int) -> str:
    """The folder name of a case; it reveals neither suite nor number."""
    return hashlib.sha256(f"{seed} {suite} {index}".encode()).hexdigest()[:12]


# ------------------------------------------------------------- create and commit


def write_case(
    exam: BenchmarkRun, name: str, write: Callable[[Path], None], truth: Callable[[], str]
) -> None:
    """Write recording and truth of a case to their separate folders; a complete case is kept.

    `write` writes the recording's folder; `truth` then returns the text of the truth. The truth comes last: a case
    without a truth is incomplete and is written again.
    """
    if exam.truth(name).exists() and exam.recording(name).is_dir():
        return
    place = exam.recording(name)
    partial = place.with_name(f".partial-{os.getpid()}")
    partial.parent.mkdir(parents=True, exist_ok=True)
    exam.truth(name).parent.mkdir(exist_ok=True)
    try:
        write(partial)
        shutil.rmtree(place, ignore_errors=True)
        partial.rename(place)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    replace_file(exam.truth(name), truth())


def seal(exam: BenchmarkRun) -> dict[str, str]:
    """Publish the checksum of every truth that has none yet, and return all checksums.

    Call it before a diagnosis starts. Raises InputError if a truth does not match its published checksum.
    """
    known = published(exam)
    check(exam, known)
    fresh = {name: checksum(exam.truth(name)) for name in exam.names() if name not in known}
    early = [name for name in fresh if exam.answer(name).exists()]
    if early:
        raise InputError(
            f"{exam.answer(early[0])} was written before the hash of its truth was published, so the answer is not "
            "blind. Remove this file to diagnose the case again."
        )
    if fresh:
        replace_file(exam.seals, json.dumps(known | fresh, indent=1, sort_keys=True) + "\n")
    return known | fresh


def published(exam: BenchmarkRun) -> dict[str, str]:
    """Case -> published checksum."""
    if not exam.seals.exists():
        return {}
    seals = read_object(exam.seals)
    if not all(isinstance(seal, str) for seal in seals.values()):
        raise damaged(exam.seals, "an entry that is no checksum")
    return seals


def read_object(path: Path) -> dict:
    """The JSON object in a file of a benchmark run. Raises InputError where it is damaged."""
    try:
        value = read_json(path)
    except (OSError, ContentError) as problem:
        raise damaged(path, str(problem)) from None
    if not isinstance(value, dict):
        raise damaged(path, f"a {type(value).__name__}")
    return value


def damaged(path: Path, found: str) -> InputError:
    """The error for a file of a benchmark run that has been changed or is incomplete."""
    return InputError(
        f"{path}: expected a file that `workbench prove` has written, found {found}. This benchmark run "
        "cannot be continued. Start it again in a new folder."
    )


def checksum(path: Path) -> str:
    """SHA-256 of a file. Raises InputError if the file is not readable."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(
            f"{path}: expected the truth of a case, found '{error.strerror}'. "
            "Start the benchmark again in a new folder."
        ) from error


def check(exam: BenchmarkRun, seals: Mapping[str, str]) -> None:
    """Raise InputError if a truth does not match its published checksum."""
    for name, seal_of in seals.items():
        found = checksum(exam.truth(name))
        if found != seal_of:
            raise InputError(
                f"{exam.truth(name)} was changed after its hash was published: expected SHA-256 {seal_of[:12]}…, "
                f"found {found[:12]}…. This benchmark run is invalid. Start it again in a new folder."
            )


def opened(exam: BenchmarkRun, name: str, seals: Mapping[str, str]) -> dict:
    """The truth of an answered case. Raises InputError if hash or answer is missing, or the hash does not match."""
    if name not in seals or not exam.answer(name).exists():
        raise InputError(
            f"case {name} of {exam.folder} cannot be unblinded: its published hash or its answer is missing. "
            "Diagnose it first."
        )
    check(exam, {name: seals[name]})
    return read_object(exam.truth(name))


# ----------------------------------------------------------------- run, watched


@dataclass
class Watch:
    """Files that a process may open: its recording, the Python installation, the project and system files.

    `given` is the recording. `barred` takes precedence: folders inside the allowed ones that are forbidden, such as
    the other files of the benchmark run and the code of the case generators. `found` lists violations.
    """

    given: Path
    barred: tuple[Path, ...]
    found: list[str] = field(default_factory=list)
    active: bool = False

    def see(self, event: str, arguments: tuple) -> None:
        """Check an audit event: opening and listing files, starting processes, using the network."""
        if event in _FORBIDDEN:
            self.found.append(f"{event} {arguments[0]!r}")
        elif event in _FILES and isinstance(arguments[0], str | bytes | os.PathLike):
            path = os.path.abspath(os.fsdecode(arguments[0]))
            if not self.allowed(path) and not (event != "open" and self.searched(path)):
                self.found.append(path)

    def searched(self, path: str) -> bool:
        """True if the import system lists this folder in its search for modules; this reads no file content."""
        return path in {os.path.abspath(place) for place in sys.path} and not self._is_barred(
            os.path.realpath(path)
        )

    def _is_barred(self, real: str) -> bool:
        return any(_is_inside(real, place) for place in self.barred)

    def allowed(self, path: str) -> bool:
        """True if an absolute path may be opened."""
        real = os.path.realpath(path)
        if _is_inside(real, self.given):
            return True
        return not self._is_barred(real) and any(_is_inside(real, place) for place in _ALLOWED)


_FILES = {"open", "os.listdir", "os.scandir"}
_FORBIDDEN = {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "socket.connect"}
PROJECT = Path(__file__).resolve().parents[2]
MAKERS = tuple((PROJECT / "datasets" / "makers").glob("blind*"))
_ALLOWED = tuple(
    Path(os.path.realpath(p))
    for p in (
        sys.prefix,
        sys.base_prefix,
        sys.exec_prefix,
        os.path.dirname(os.__file__),
        PROJECT,
        "/usr",
        "/lib",
        "/lib64",
        "/etc",
        "/proc",
        "/sys",
        "/dev",
    )
)
_watch: list[Watch] = []


def _is_inside(path: str, place: Path) -> bool:
    place = str(place)
    return path == place or path.startswith(place.rstrip(os.sep) + os.sep)


def _hook(event: str, arguments: tuple) -> None:
    if _watch and _watch[0].active:
        watch = _watch[0]
        watch.active = False  # file accesses of the check itself do not count
        try:
            watch.see(event, arguments)
        finally:
            watch.active = True


@contextmanager
def watched(given: Path, barred: Iterable[Path]) -> Iterator[list[str]]:
    """Inside the block, violations by this process are appended to the yielded list.

    An audit hook of the interpreter (PEP 578) reports files that Python opens. It does not report files that a
    compiled library opens.
    """
    if not _watch:
        sys.addaudithook(_hook)
        _watch.append(Watch(given, ()))
    _watch[0] = Watch(
        Path(os.path.realpath(given)), tuple(Path(os.path.realpath(p)) for p in barred), active=True
    )
    try:
        yield _watch[0].found
    finally:
        _watch[0].active = False


def run(folder: Path, name: str, diagnose: Callable[[Path], Mapping], program: str = "") -> dict:
    """Diagnose a case under watch and write its answer, the return value of `diagnose` for the recording's folder.

    The record holds "answer", the JSON, or None with "refused" (a message to the user) or "failed" (an error);
    "seconds" of wall-clock time and "cpu_s" of processor time; "opened", files opened against the rules; and
    "program", the checksum of the program. An answered case is not diagnosed again.
    """
    exam = BenchmarkRun(folder)
    if not exam.answer(name).exists():
        barred = (exam.folder, *MAKERS)
        began, used = time.monotonic(), time.process_time()
        with watched(exam.recording(name), barred) as found:
            record = _answered(diagnose, exam.recording(name))
        record |= {"seconds": time.monotonic() - began, "cpu_s": time.process_time() - used}
        record |= {"opened": sorted(set(found)), "program": program}
        replace_file(exam.answer(name), json.dumps(record, indent=1, allow_nan=False) + "\n")
    return read_object(exam.answer(name))


def _answered(diagnose, recording: Path) -> dict:
    try:
        with _patience():
            return {"answer": diagnose(recording), "refused": "", "failed": ""}
    except InputError as sentence:
        return {"answer": None, "refused": str(sentence), "failed": ""}
    except Exception as error:  # any error counts as no answer
        return {
            "answer": None,
            "refused": "",
            "failed": f"{type(error).__name__}: {error}{_place(error)}",
        }


def _place(error: BaseException) -> str:
    """Innermost source line of this project in the traceback of an error."""
    import traceback

    lines = [
        f for f in traceback.extract_tb(error.__traceback__) if f.filename.startswith(str(PROJECT))
    ]
    return f" ({Path(lines[-1].filename).name}:{lines[-1].lineno})" if lines else ""


@contextmanager
def _patience() -> Iterator[None]:
    """Raise TimeoutError after PATIENCE_S of processor time, or _WAIT times this wall-clock time.

    Without effect if the system has no interval timers or this is not the main thread.
    """
    import signal
    import threading

    if (
        not hasattr(signal, "setitimer")
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return
    processor = (signal.SIGPROF, signal.ITIMER_PROF)
    clock = (signal.SIGALRM, signal.ITIMER_REAL)
    alarms = ((*processor, PATIENCE_S), (*clock, _WAIT * PATIENCE_S))
    before = [signal.signal(kind, _too_long) for kind, *_ in alarms]
    for _, timer, seconds in alarms:
        signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        for (kind, timer, _), handler in zip(alarms, before):
            signal.setitimer(timer, 0)
            signal.signal(kind, handler)


def _too_long(*_):
    raise TimeoutError(f"no answer within {PATIENCE_S} s of processor time")
