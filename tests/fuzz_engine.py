"""Coverage-guided fuzzing of file readers and commands: mutations, coverage, and the loop.

An input that reaches a line of a reader for the first time joins the corpus, from which later inputs
are mutated. The only accepted outcomes of a call are a value, or an InputError of one sentence.
"""

import io
import random
import re
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path

from conftest import ROOT
from workbench.core.errors import InputError

HANG_S = 60
VALUES = (
    "nan inf -inf NaN Infinity -Infinity 1e999 -1e308 1e-320 -1 0 1 2147483648 18446744073709551616 "
    'true null None "" "x" [] {} [[1]] [1,2] {"a":1} "\\u0000" "\\ud800" "../../x" "~" "/" . .. * '
    "1979-05-27 1979-05-27T07:32:00Z 07:32 0x10 1_000 1,5 ½ ٣ =1+1 <script> %s {0} -0 1e5 360 1e-9"
).split()
LARGE = (
    "9" * 400,
    "9" * 5000,
    "[" * 3000,
    '{"a":' * 3000,
    "a." * 5000 + "a=1",
    '"' + "x" * 100_000 + '"',
    "1," * 20_000,
    "\n" * 1000,
)
_TOKEN = re.compile(rb"[-+]?[0-9][0-9.eE+-]*|\"[^\"\n]*\"|'[^'\n]*'|[A-Za-z_][\w-]*")


@dataclass(frozen=True)
class Target:
    """One reader or command: `call(folder)` reads `file` of a folder that holds a valid example."""

    name: str
    folder: Path
    file: str
    call: Callable[[Path], object]


@dataclass
class Outcome:
    """Counts of a run; `failures` maps a kind of failure to the first input that causes it."""

    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    failures: dict[str, bytes] = field(default_factory=dict)
    failed: int = 0


class HangError(BaseException):
    """A call that takes longer than HANG_S; no `except Exception` hides it."""


class Fuzzer:
    """The corpus of one target and the lines that it has reached."""

    def __init__(self, target: Target, seed: int):
        self.target, self.random = target, random.Random(f"{target.name} {seed}")
        self.original = (target.folder / target.file).read_bytes()
        self.corpus, self.lines = [self.original], set()

    def step(self, outcome: Outcome) -> None:
        """Try one mutated input."""
        content = mutated(self.random.choice(self.corpus), self.original, self.random)
        failure, reached = self.attempt(content, outcome)
        if failure:
            outcome.failures.setdefault(f"{self.target.name}: {failure}", content)
        elif not reached <= self.lines and len(content) < 200_000:
            self.corpus.append(content)
        self.lines |= reached

    def attempt(self, content: bytes, outcome: Outcome) -> tuple[str, set]:
        """What went wrong with `content` ("" for nothing), and the lines that it reached."""
        path = self.target.folder / self.target.file
        path.write_bytes(content)
        outcome.inputs += 1
        lines: set = set()
        try:
            with _quiet(), time_limit(HANG_S), traced(lines):
                self.target.call(self.target.folder)
            outcome.accepted += 1
        except InputError as problem:
            outcome.refused += 1
            sentence = str(problem)
            if "\n" in sentence or not sentence.endswith("."):
                return f"not one sentence: {sentence[:80]!r}", lines
        except (Exception, HangError) as problem:
            outcome.failed += 1
            return _kind_of(problem), lines
        finally:
            path.write_bytes(self.original)
        return "", lines


def mutated(content: bytes, original: bytes, rng: random.Random) -> bytes:
    """`content` after one to four random changes of bytes, tokens or lines."""
    for _ in range(rng.choice((1, 1, 1, 2, 3, 4))):
        content = rng.choice(_MUTATIONS)(content, original, rng)
    return content


def _change_bytes(content, original, rng):
    at = rng.randint(0, len(content))
    new = bytes(rng.randrange(256) for _ in range(rng.randint(0, 8)))
    return content[:at] + new + content[at + rng.randint(0, 8) :]


def _truncate(content, original, rng):
    return content[: rng.randint(0, len(content))]


def _replace_token(content, original, rng):
    tokens = list(_TOKEN.finditer(content[:100_000]))
    if not tokens:
        return content
    token = rng.choice(tokens)
    new = rng.choice(LARGE if rng.random() < 0.05 else VALUES).encode("utf-8")
    return content[: token.start()] + new + content[token.end() :]


def _swap_tokens(content, original, rng):
    tokens = [match.group() for match in _TOKEN.finditer(original[:100_000])]
    places = list(_TOKEN.finditer(content[:100_000]))
    if not tokens or not places:
        return content
    place = rng.choice(places)
    return content[: place.start()] + rng.choice(tokens) + content[place.end() :]


def _change_lines(content, original, rng):
    lines = content.split(b"\n")
    at, kind = rng.randrange(len(lines)), rng.randrange(3)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(rng.randrange(len(lines)), rng.choice(lines))
    else:
        lines[at:at] = [lines[at]] * rng.choice((2, 50))
    return b"\n".join(lines)


_MUTATIONS = (
    _change_bytes,
    _truncate,
    _replace_token,
    _replace_token,
    _replace_token,
    _swap_tokens,
    _change_lines,
)


@contextmanager
def traced(lines: set) -> Iterator[None]:
    """Add (file, line) of every line of the project's readers that is executed inside the block."""
    known: dict = {}

    def on_line(frame, event, arg):
        if event == "line":
            lines.add((frame.f_code, frame.f_lineno))
        return on_line

    def on_call(frame, event, arg):
        code = frame.f_code
        if code not in known:
            known[code] = _is_reader(code.co_filename)
        return on_line if known[code] else None

    before = sys.gettrace()
    sys.settrace(on_call)
    try:
        yield
    finally:
        sys.settrace(before)


_READERS = (
    "file",
    "read",
    "scene",
    "plan",
    "spec",
    "session",
    "import",
    "format",
    "check",
    "target",
)


def _is_reader(name: str) -> bool:
    if not name.startswith(str(ROOT)):
        return False
    inner = name[len(str(ROOT)) :]
    return "/tests/" not in inner and any(word in inner for word in _READERS)


@contextmanager
def time_limit(seconds: int) -> Iterator[None]:
    """Raise HangError inside the block after `seconds` of processor time, or ten times as long altogether.

    Where other programs use the processors a call may take minutes that are not its own.
    """

    def stop(*_):
        raise HangError(f"no result within {seconds} s")

    limits = (
        (signal.SIGPROF, signal.ITIMER_PROF, seconds),
        (signal.SIGALRM, signal.ITIMER_REAL, 10 * seconds),
    )
    before = [signal.signal(number, stop) for number, _, _ in limits]
    for _, timer, limit in limits:
        signal.setitimer(timer, limit)
    try:
        yield
    finally:
        for (number, timer, _), handler in zip(limits, before):
            signal.setitimer(timer, 0)
            signal.signal(number, handler)


@contextmanager
def _quiet() -> Iterator[None]:
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _kind_of(problem: BaseException) -> str:
    """Type and innermost line of the project: two inputs with the same kind have the same cause."""
    frames = traceback.extract_tb(problem.__traceback__)
    own = [f for f in frames if _is_ours(f.filename)]
    place = f"{Path(own[-1].filename).relative_to(ROOT)}:{own[-1].lineno}" if own else "?"
    return f"{type(problem).__name__} at {place}: {str(problem)[:80]!r}"


def _is_ours(name: str) -> bool:
    return name.startswith(str(ROOT)) and "/tests/" not in name and "/.venv/" not in name


def fuzz(targets: list[Target], inputs: int, seconds: float, seed: int, say=print) -> Outcome:
    """Try `inputs` inputs in all, the targets in turn, for at most `seconds`."""
    outcome, until = Outcome(), time.monotonic() + seconds
    fuzzers = [Fuzzer(target, seed) for target in targets]
    turn = 0
    while outcome.inputs < inputs and time.monotonic() < until:
        fuzzers[turn % len(fuzzers)].step(outcome)
        turn += 1
        if turn % 1000 == 0:
            say(f"{turn} inputs, {outcome.failed} failures of {len(outcome.failures)} kinds")
    return outcome
