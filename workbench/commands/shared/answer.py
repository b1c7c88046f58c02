"""Shared parts of the commands: JSON answer, console, progress line.

With `--json -` standard output holds only the JSON object; all text for the user then goes to
standard error.
"""

import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from workbench.core.errors import InputError
from workbench.files.runs import replace_file
from workbench.machine.progress import at_most_every

RECORDING = typer.Argument(help="Folder of a recording, or a name of `workbench datasets list`.")
RecordingName = Annotated[str, RECORDING]
JsonTarget = Annotated[
    str | None,
    typer.Option(
        "--json", metavar="FILE|-", help="Write the answer as JSON; - is standard output."
    ),
]
OutFolder = Annotated[
    Path | None,
    typer.Option(
        "--out", metavar="DIR", help="Run folder to write; default: a new folder under runs/."
    ),
]

Jobs = Annotated[
    int | None, typer.Option("--jobs", min=1, help="Number of processes; default: one per core.")
]
TrustData = Annotated[
    bool,
    typer.Option(
        "--trust-data", help="Continue with a warning if the recorded data are implausible."
    ),
]
NoReport = Annotated[bool, typer.Option("--no-report", help="Do not write a report page.")]
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
        help="Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; exit status 1 if it is exceeded. "
        "Once per unit.",
    ),
]


def console(target: str | None):
    """The rich console: standard output, or standard error if the JSON goes to standard output."""
    from rich.console import Console

    return Console(stderr=target == "-", highlight=False)


_PRINTED_S = 60.0
"""Seconds between progress texts in a log: short commands print none."""
_JSON = json.JSONEncoder(indent=2, ensure_ascii=False, allow_nan=False)


@contextmanager
def progress(first: str) -> Iterator["Progress"]:
    """A progress line on standard error; call the result to change its text, or its `note` to print a line.

    If the environment variable WORKBENCH_PROGRESS is "lines", every text is printed on its own line, for programs
    that start a command and show its progress. Where standard error is no terminal, one text a minute is printed.
    """
    if os.environ.get("WORKBENCH_PROGRESS") == "lines":
        _print_progress(first)
        yield Progress(_print_progress, _print_progress)
        return
    line = _live_line()
    if not line.console.is_interactive:  # rich would end the line that it did not show
        yield Progress(at_most_every(_PRINTED_S, _print_progress), line.console.print)
        return
    with line:
        task = line.add_task(first, total=None)

        def update(text: str) -> None:
            line.update(task, description=" ".join(text.split()))

        yield Progress(update, line.console.print)


def _live_line():
    """One line on standard error: a spinner, a text that is cut where the terminal ends, and the elapsed time."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    text = Column(no_wrap=True, overflow="ellipsis", ratio=1)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False, table_column=text),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True, highlight=False)
    return Progress(*columns, console=console, transient=True, expand=True)


@dataclass(frozen=True)
class Progress:
    """Changes the progress line when it is called; `note` prints a line that stays."""

    update: Callable[[str], None]
    note: Callable[[str], None]

    def __call__(self, text: str) -> None:
        self.update(text)


def _print_progress(text: str) -> None:
    print(" ".join(text.split()), file=sys.stderr, flush=True)


def check_target(target: str | None, option: str = "--json") -> None:
    """Raise InputError before the computation if the file of `option` cannot be written."""
    if target in (None, "-"):
        return
    path = Path(target)
    if path.is_dir():
        raise InputError(
            f"{option} {target} expects a file, found a folder; name a file, such as {path / 'name'}."
        )
    if not path.parent.is_dir():
        raise InputError(
            f"{option} {target} expects a file in a folder that exists; make {path.parent} first or name another file."
        )


def as_text(answer: Mapping[str, Any]) -> str:
    """Strict JSON: numpy types become plain numbers and lists; numbers that are not finite become null."""
    return "".join(text_chunks(answer))


def text_chunks(answer: Mapping[str, Any]) -> Iterator[str]:
    """The text of `as_text` in parts; lazily read elements of a long session are never all in memory."""
    yield from _value_chunks(answer, "\n")
    yield "\n"


def _value_chunks(value: Any, line: str) -> Iterator[str]:
    """The text of a value, element by element; further lines begin with `line`."""
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
        yield from _value_chunks(inner[1] if keyed else inner, line + "  ")
    yield line + end if before == "," else first + end


def deliver(answer: Mapping[str, Any], target: str | None) -> None:
    """Write the answer to the target of `--json`; None writes nothing."""
    if target == "-":
        sys.stdout.writelines(text_chunks(answer))
        sys.stdout.flush()
    elif target is not None:
        replace_file(Path(target), text_chunks(answer))


def last_line(console, folder: Path) -> None:
    """Print the path of the report page, or of the folder without a page, as the last line."""
    page = folder / "report.html"
    console.print(str(page if page.exists() else folder), soft_wrap=True, markup=False)


def read_tolerances(values: Sequence[str] | None, measures: str):
    """Tolerances that the calibration of a recording of kind `measures` can judge. Raises InputError for others."""
    from workbench.fitting.verdicts.calibration_verdict import units_of
    from workbench.fitting.verdicts.verdict import parse_tolerances

    return parse_tolerances(values, units_of(measures))


def show_verdict(console, verdict: Mapping[str, Any] | None) -> None:
    """Print the sentence of a verdict (its JSON object); a failed verdict is highlighted."""
    if verdict is None:
        return
    style = "bold red" if verdict["pass"] is False else None
    console.print(f"Verdict: {verdict['sentence']}", style=style, markup=False)


def exit_on_fail(verdict: Mapping[str, Any] | None) -> None:
    """Exit with status 1 if a tolerance is not met. Call it last, after the path of the run is printed."""
    if verdict is not None and verdict["pass"] is False:
        raise typer.Exit(1)


def conclude(console, result: Mapping[str, Any], folder: Path) -> None:
    """The end of a command with a run folder: the verdict's sentence, the path as last line, the exit status.

    The verdict is `verdict_details` if `verdict` is a word (`diagnose`).
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
