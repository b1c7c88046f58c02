"""The course of the sensor's commands: work into a run folder, the answer, a table, the place written."""

from collections.abc import Callable, Mapping
from pathlib import Path

from workbench.commands.shared import answer
from workbench.files import runs

Work = Callable[[runs.Run, Callable[[str], None]], Mapping]


def run(
    command: str, subject: str, out: Path | None, json: str | None, work: Work, show: Callable
) -> None:
    """Do `work(run, say)` in a new run folder; its answer goes to the folder, to `--json` and to `show`.

    command, subject: name the run folder; out: that folder instead. show: takes console and answer. Warnings of the
    answer come first, its verdict comes last. Raises InputError, and nothing is left behind then; ends with status 1
    where the verdict fails.
    """
    answer.check_target(json)
    with answer.progress(f"reading {subject}") as say, runs.opened(command, subject, out) as folder:
        result = {
            "command": command,
            **work(folder, say),
            "input": runs.input_name(subject),
            "run": folder.path,
        }
        runs.replace_file(folder.partial / "answer.json", answer.parts(result))
    answer.deliver(result, json)
    console = answer.console(json)
    for sentence in result.get("warnings", ()):
        console.print(f"Warning: {sentence}", style="bold red", markup=False, soft_wrap=True)
    show(console, result)
    answer.conclude(console, result, folder.path)


def with_reading_warnings(result: Mapping, recording) -> dict:
    """The answer of a command with what reading its recording found unusual, before its own warnings."""
    return {**result, "warnings": [*recording.warnings, *result.get("warnings", ())]}
