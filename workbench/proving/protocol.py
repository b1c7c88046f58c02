"""The protocol of the blind proof: conceal, seal, run, open. Enforced here, and not by promise.

An examination is a folder:

    seals.json            case -> SHA-256 of its sealed truth, written before any diagnosis starts
    cases/<case>/         recording/, the only thing a diagnosis is given, and answer.json, what it said
    sealed/<case>.json    the truth, which nobody opens before the answer is there

Names of cases are drawn from their numbers by a checksum, so that not even a path tells the suite.
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
from workbench.files.runs import replace_file

PATIENCE_S = 1200
"""A diagnosis that has not answered after so long, in time of its own processor, has not answered."""
_WAIT = 6  # times as long by the clock: others may use the machine


@dataclass(frozen=True)
class Examination:
    """Where everything of one examination lies."""

    folder: Path

    @property
    def seals(self) -> Path:
        return self.folder / "seals.json"

    def recording(self, name: str) -> Path:
        """The folder that a diagnosis of the case is given."""
        return self.folder / "cases" / name / "recording"

    def answer(self, name: str) -> Path:
        """What the diagnosis said, how long it took, and what it opened that it should not have."""
        return self.folder / "cases" / name / "answer.json"

    def weighed(self, name: str) -> Path:
        """Held-out errors of the fit that knows the truth, made after the case was opened."""
        return self.folder / "cases" / name / "oracle.json"

    def truth(self, name: str) -> Path:
        return self.folder / "sealed" / f"{name}.json"

    def names(self) -> list[str]:
        """Every case that has been concealed, in order of their names, which is an order by chance."""
        return sorted(path.stem for path in (self.folder / "sealed").glob("*.json"))


def name_of(suite: str, index: int, seed: int) -> str:
    """The name of a case's folder, which tells nothing."""
    return hashlib.sha256(f"{seed} {suite} {index}".encode()).hexdigest()[:12]


# ------------------------------------------------------------- conceal and seal


def conceal(
    exam: Examination, name: str, write: Callable[[Path], None], truth: Callable[[], str]
) -> None:
    """Put a case in its two places, whole or not at all. Kept where it is there.

    `write` makes the recording's folder, and `truth` then gives the text to be sealed. The recording comes first: a
    case without its truth is made again, one with it is complete.
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


def seal(exam: Examination) -> dict[str, str]:
    """Publish the checksum of every truth that has none yet, and return all of them.

    Call it before a diagnosis starts. Raises InputError where a published one no longer fits.
    """
    known = published(exam)
    check(exam, known)
    fresh = {name: checksum(exam.truth(name)) for name in exam.names() if name not in known}
    early = [name for name in fresh if exam.answer(name).exists()]
    if early:
        raise InputError(
            f"{exam.answer(early[0])} was written before its truth was sealed, where a seal comes first; "
            "remove that file, and the case is diagnosed again."
        )
    if fresh:
        replace_file(exam.seals, json.dumps(known | fresh, indent=1, sort_keys=True) + "\n")
    return known | fresh


def published(exam: Examination) -> dict[str, str]:
    """Case -> checksum, as published so far."""
    return json.loads(exam.seals.read_text(encoding="utf-8")) if exam.seals.exists() else {}


def checksum(path: Path) -> str:
    """SHA-256 of a file. Raises InputError where it is gone."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(
            f"{path} is expected to hold a sealed truth, found '{error.strerror}'; "
            "begin the examination again in a new folder."
        ) from error


def check(exam: Examination, seals: Mapping[str, str]) -> None:
    """Raise InputError where one byte of a sealed truth is not what was published."""
    for name, seal_of in seals.items():
        found = checksum(exam.truth(name))
        if found != seal_of:
            raise InputError(
                f"{exam.truth(name)} was changed after it was sealed: SHA-256 {seal_of[:12]}… was "
                f"published, found {found[:12]}…; this examination proves nothing, begin it again in "
                "a new folder."
            )


def opened(exam: Examination, name: str, seals: Mapping[str, str]) -> dict:
    """The truth of a case whose answer is there. Raises InputError where seal or answer is missing or broken."""
    if name not in seals or not exam.answer(name).exists():
        raise InputError(
            f"case {name} of {exam.folder} is to be opened, and has no seal or no answer yet; "
            "diagnose it first."
        )
    check(exam, {name: seals[name]})
    return json.loads(exam.truth(name).read_text(encoding="utf-8"))


# ----------------------------------------------------------------- run, watched


@dataclass
class Watch:
    """What a process may open: nothing but its recording, the Python installation, the project and the system's own.

    `given` is the recording; `barred` come first: places inside what is allowed that are not, such as the
    rest of the examination and the code of the makers. `found` is what was opened in spite of it.
    """

    given: Path
    barred: tuple[Path, ...]
    found: list[str] = field(default_factory=list)
    active: bool = False

    def see(self, event: str, arguments: tuple) -> None:
        """An event of the interpreter: opening and listing files, starting processes, using the network."""
        if event in _FORBIDDEN:
            self.found.append(f"{event} {arguments[0]!r}")
        elif event in _FILES and isinstance(arguments[0], str | bytes | os.PathLike):
            path = os.path.abspath(os.fsdecode(arguments[0]))
            if not self.allowed(path) and not (event != "open" and self.searched(path)):
                self.found.append(path)

    def searched(self, path: str) -> bool:
        """Whether the import system lists this folder when it looks for a module, which tells no file's content."""
        return path in {os.path.abspath(place) for place in sys.path} and not self._is_barred(
            os.path.realpath(path)
        )

    def _is_barred(self, real: str) -> bool:
        return any(_inside(real, place) for place in self.barred)

    def allowed(self, path: str) -> bool:
        """Whether an absolute path may be opened."""
        real = os.path.realpath(path)
        if _inside(real, self.given):
            return True
        return not self._is_barred(real) and any(_inside(real, place) for place in _ALLOWED)


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


def _inside(path: str, place: Path) -> bool:
    place = str(place)
    return path == place or path.startswith(place.rstrip(os.sep) + os.sep)


def _hook(event: str, arguments: tuple) -> None:
    if _watch and _watch[0].active:
        watch = _watch[0]
        watch.active = False  # what the watch itself looks up is no fault of the watched
        try:
            watch.see(event, arguments)
        finally:
            watch.active = True


@contextmanager
def watched(given: Path, barred: Iterable[Path]) -> Iterator[list[str]]:
    """Inside the block, everything that this process opens against the rules is put on the list.

    An audit hook of the interpreter (PEP 578) sees what Python opens; files that a compiled library
    opens by itself it does not see.
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
    """Diagnose a case, watched, and write its answer; what `diagnose` returns for the recording's folder is the answer.

    One answer: "answer" the JSON, or None with "refused" (a sentence to the user) or "failed" (an error);
    "seconds" by the clock and "cpu_s" of its processor; "opened", the files that it should not have opened; and
    "program", a checksum of what gave the answer. A case is not diagnosed twice.
    """
    exam = Examination(folder)
    if not exam.answer(name).exists():
        barred = (exam.folder, *MAKERS)
        began, used = time.monotonic(), time.process_time()
        with watched(exam.recording(name), barred) as found:
            told = _answered(diagnose, exam.recording(name))
        told |= {"seconds": time.monotonic() - began, "cpu_s": time.process_time() - used}
        told |= {"opened": sorted(set(found)), "program": program}
        replace_file(exam.answer(name), json.dumps(told, indent=1, allow_nan=False) + "\n")
    return json.loads(exam.answer(name).read_text(encoding="utf-8"))


def _answered(diagnose, recording: Path) -> dict:
    try:
        with _patience():
            return {"answer": diagnose(recording), "refused": "", "failed": ""}
    except InputError as sentence:
        return {"answer": None, "refused": str(sentence), "failed": ""}
    except Exception as error:  # whatever it is, the case counts as not answered
        return {
            "answer": None,
            "refused": "",
            "failed": f"{type(error).__name__}: {error}{_place(error)}",
        }


def _place(error: BaseException) -> str:
    """Where an error came from: the innermost line of ours."""
    import traceback

    lines = [
        f for f in traceback.extract_tb(error.__traceback__) if f.filename.startswith(str(PROJECT))
    ]
    return f" ({Path(lines[-1].filename).name}:{lines[-1].lineno})" if lines else ""


@contextmanager
def _patience() -> Iterator[None]:
    """TimeoutError after PATIENCE_S of the process's own time, or _WAIT times as long by the clock.

    Where the system has such alarms and this is the main thread.
    """
    import signal
    import threading

    if (
        not hasattr(signal, "setitimer")
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return
    own, clock = (signal.SIGPROF, signal.ITIMER_PROF), (signal.SIGALRM, signal.ITIMER_REAL)
    alarms = ((*own, PATIENCE_S), (*clock, _WAIT * PATIENCE_S))
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
