"""What the commands share: the JSON answer, the console for people, the progress line.

With `--json -` standard output carries the JSON object and nothing else; all that is meant for a
person then goes to standard error.
"""

import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from workbench.core.errors import InputError
from workbench.files.runs import replace_file

JsonTarget = Annotated[
    str | None,
    typer.Option(
        "--json", metavar="FILE|-", help="Write the answer as JSON; - is standard output."
    ),
]
OutFolder = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Write here instead of a new folder under runs/."),
]

Jobs = Annotated[int | None, typer.Option("--jobs", min=1, help="Processes; one a core otherwise.")]
TrustData = Annotated[
    bool,
    typer.Option(
        "--trust-data", help="Go on with a warning where the recorded data are found implausible."
    ),
]
NoReport = Annotated[bool, typer.Option("--no-report", help="Write no page.")]
ScannerFile = Annotated[
    Path | None,
    typer.Option(
        "--scanner",
        metavar="FILE",
        help="Use this calibrated scanner (scanner.toml of `workbench scanner`).",
    ),
]

Tolerance = Annotated[
    list[str] | None,
    typer.Option(
        "--tolerance",
        metavar="VALUE[UNIT]",
        help="Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; exit status 1 where it is exceeded. "
        "Once per unit.",
    ),
]


def console(target: str | None):
    """The rich console for people: standard output, unless JSON has it."""
    from rich.console import Console

    return Console(stderr=target == "-", highlight=False)


_JSON = json.JSONEncoder(indent=2, ensure_ascii=False, allow_nan=False)


@contextmanager
def progress(first: str) -> Iterator[Callable[[str], None]]:
    """A line on standard error that says what is being done; call what it yields to change it.

    Where the environment variable WORKBENCH_PROGRESS is "lines", every text is printed as a line of its own, for
    programs that start a command and show its progress.
    """
    if os.environ.get("WORKBENCH_PROGRESS") == "lines":
        _print_progress(first)
        yield _print_progress
        return
    from rich.console import Console

    with Console(stderr=True, highlight=False).status(first) as status:
        yield status.update


def _print_progress(text: str) -> None:
    print(" ".join(text.split()), file=sys.stderr, flush=True)


def check_target(target: str | None, option: str = "--json") -> None:
    """Raise InputError now, and not after a long solve, where the file of `option` cannot be written."""
    if target in (None, "-"):
        return
    path = Path(target)
    if path.is_dir():
        raise InputError(
            f"{option} {target} expects a file, found a folder; name a file, {path / 'name'} for one."
        )
    if not path.parent.is_dir():
        raise InputError(
            f"{option} {target} expects a file in a folder that exists; make {path.parent} first or name another file."
        )


def as_text(answer: Mapping[str, Any]) -> str:
    """Strict JSON: numpy's scalars and arrays become plain ones, what is not finite null."""
    return "".join(parts(answer))


def parts(answer: Mapping[str, Any]) -> Iterator[str]:
    """The same in parts: what is made or read anew for every element of a session is never all in memory."""
    yield from _parts(answer, "\n")
    yield "\n"


def _parts(value: Any, line: str) -> Iterator[str]:
    """A value, element by element, whose further lines begin with `line`."""
    keyed = isinstance(value, Mapping)
    if not keyed and (not isinstance(value, Sequence) or isinstance(value, str)):
        yield _JSON.encode(_plain(value)).replace("\n", line)
        return
    first, end = "{}" if keyed else "[]"
    before = first
    for inner in value.items() if keyed else value:
        yield before + line + "  "
        before = ","
        if keyed:
            yield _JSON.encode(str(inner[0])) + ": "
        yield from _parts(inner[1] if keyed else inner, line + "  ")
    yield line + end if before == "," else first + end


def deliver(answer: Mapping[str, Any], target: str | None) -> None:
    """Write the answer where `--json` says; None writes nothing."""
    if target == "-":
        sys.stdout.writelines(parts(answer))
        sys.stdout.flush()
    elif target is not None:
        replace_file(Path(target), parts(answer))


def last_line(console, folder: Path) -> None:
    """Name what was written, as the last line: the page, or the folder where there is none."""
    page = folder / "report.html"
    console.print(str(page if page.exists() else folder), soft_wrap=True, markup=False)


def read_tolerances(values: Sequence[str] | None, measures: str):
    """Tolerances that the calibration of a recording of kind `measures` can judge. Raises InputError for others."""
    from workbench.fitting.verdicts.calibration_verdict import units_of
    from workbench.fitting.verdicts.verdict import parse_tolerances

    return parse_tolerances(values, units_of(measures))


def show_verdict(console, verdict: Mapping[str, Any] | None) -> None:
    """Print the sentence of a verdict (its JSON object); one that fails stands out."""
    if verdict is None:
        return
    style = "bold red" if verdict["pass"] is False else None
    console.print(f"Verdict: {verdict['sentence']}", style=style, markup=False)


def exit_on_fail(verdict: Mapping[str, Any] | None) -> None:
    """End with status 1 where a tolerance was given and is not met. Call it last, after the run's path is printed."""
    if verdict is not None and verdict["pass"] is False:
        raise typer.Exit(1)


def conclude(console, result: Mapping[str, Any], folder: Path) -> None:
    """The end of a command with a run folder: the verdict's sentence, the path as last line, the exit status.

    The verdict is `verdict_details` where `verdict` is a word (`diagnose`).
    """
    verdict = result.get("verdict_details", result.get("verdict"))
    show_verdict(console, verdict)
    last_line(console, folder)
    exit_on_fail(verdict)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, Sequence | set) and not isinstance(value, str):
        return [_plain(inner) for inner in value]
    if hasattr(value, "tolist"):  # numpy, without importing it
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value
