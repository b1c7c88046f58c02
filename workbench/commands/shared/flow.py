"""Common sequence of the sensor commands: work in a run folder, answer, table, path of the results."""

from collections.abc import Callable, Mapping
from pathlib import Path

from workbench.commands.shared import answer
from workbench.files import runs

Work = Callable[[runs.Run, Callable[[str], None]], Mapping]


def run(
    command: str, subject: str, out: Path | None, json: str | None, work: Work, show: Callable
) -> None:
    """Call `work(run, say)` in a new run folder; its answer goes to the folder, to `--json` and to `show`.

    command, subject: name the run folder; out: this folder instead. show: called with console and answer. Warnings
    are printed first, the verdict last. Raises InputError, and then leaves no files. Exits with status 1 if the
    verdict fails.
    """
    answer.check_target(json)
    with (
        answer.progress(f"reading {subject}") as progress,
        runs.opened(command, subject, out) as folder,
    ):
        result = {
            "command": command,
            **work(folder, progress),
            "input": runs.input_name(subject),
            "run": folder.path,
        }
        runs.replace_file(folder.partial / "answer.json", answer.text_chunks(result))
    answer.deliver(result, json)
    console = answer.console(json)
    for sentence in result.get("warnings", ()):
        console.print(f"Warning: {sentence}", style="bold red", markup=False, soft_wrap=True)
    show(console, result)
    answer.conclude(console, result, folder.path)


def with_reading_warnings(result: Mapping, recording) -> dict:
    """The answer of a command with the warnings of reading its recording before its other warnings."""
    return {**result, "warnings": [*recording.warnings, *result.get("warnings", ())]}
