"""Terminal dialogue of `workbench import`."""

import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from workbench.commands.shared import tables
from workbench.core.errors import InputError

_YEAR_S = 365 * 86400.0
_PREVIEWED = 4
_FAR_WORSE = 20.0  # times the RMS of the best reading: further ones are counted only
_SHOWN_FITS = 8


def asker() -> Callable | None:
    """Asks a person where standard input and standard error are a terminal; None elsewhere."""
    if not (sys.stdin and sys.stdin.isatty() and sys.stderr.isatty()):
        return None
    return _ask


def _ask(question) -> int:
    import typer

    typer.echo(question.sentence + ".", err=True)
    for number, option in enumerate(question.options, 1):
        typer.echo(f"  {number}  {option}", err=True)
    count = len(question.options)
    chosen = typer.prompt(f"Which one is right (1 to {count})", type=int, err=True)
    if not 1 <= chosen <= count:
        raise InputError(
            f"The answer {chosen} is none of the options 1 to {count}; nothing was written."
        )
    return chosen - 1


def is_confirmed() -> bool:
    """Whether the person accepts the preview."""
    import typer

    return typer.confirm("Is this right?", default=True, err=True)


def next_command(recording, folder: Path) -> str:
    """The command that calibrates an imported recording, in full."""
    has_poses = any("sample" in row for row in recording.images) or recording.flange is not None
    commands = {"board-images": "handeye" if has_poses else "camera", "scan-images": "scanner"}
    name = commands.get(recording.measures, "calibrate")
    if recording.measures == "target-pose":
        name = "handeye"
    of_points = ("ball-surface", "ball-centre", "external-point")
    if recording.measures in of_points and not recording.joints.shape[1]:
        name = "handeye"
    target = f"{folder.name}-{name}"
    return shlex.join(["workbench", name, str(folder), "--out", target])


def next_lines(result, sources: Sequence[Path], folder: Path, options) -> list[str]:
    """Next actions: first those that the warnings require, then the command that calibrates.

    options: `ImportOptions`.
    """
    command = next_command(result.recording, folder)
    if not result.suspicions:
        return [f"Next: {command}"]
    count = len(result.suspicions)
    warned = "the warning" if count == 1 else f"each of the {count} warnings"
    from workbench.recordings.importing.chain import repeated_options

    same_options = repeated_options(options, folder / "import.toml")
    repeat_command = shlex.join(["workbench", "import", *map(str, sources), *same_options])
    return [
        f"First: do what {warned} above asks for, and repeat the import "
        f"({repeat_command} --out NEW-DIR), or make sure that the data are right. "
        f"`workbench check {folder}` shows them.",
        f"Then: {command}",
    ]


def show(console, answer: Mapping, result) -> None:
    """Warnings, mapping, fit of each candidate and the first rows."""
    warnings = answer.get("doubts", ())
    for sentence in answer["warnings"]:
        if sentence not in warnings:
            console.print(f"Note: {sentence}", markup=False, soft_wrap=True)
    for sentence in warnings:
        console.print(f"Warning: {sentence}", style="bold red", markup=False, soft_wrap=True)
    images = f", {answer['images']} images" if answer["images"] else ""
    head = f"{answer['measures']}, {answer['samples']} samples{images}"
    rows = [list(row) for row in _mapping_rows(answer["mapping"])]
    for name, link in answer.get("links", {}).items():
        rows.append([name, ", ".join(link["columns"]), link["read as"]])
    tables.grid(console, head, ["quantity", "columns", "read as"], rows, left=3)
    clocks = answer.get("time_offset")
    if clocks and clocks["sentence"] not in answer["warnings"]:
        console.print(clocks["sentence"], markup=False, soft_wrap=True)
    if answer["conventions"]:
        _fits(console, answer["conventions"], answer["measures"])
    _preview(console, result.recording)
    if answer["unused_columns"]:
        unused = ", ".join(f"'{name}'" for name in answer["unused_columns"])
        console.print(f"Columns that are not used: {unused}", markup=False)


def _fits(console, conventions: Sequence[Mapping], measures: str) -> None:
    """The interpretations of the columns that fit best and the next one, and how many more were tested.

    Flange and target poses are compared with one another, without a robot whose geometry may err. Degrees only where
    orientations were compared.
    """
    worst = _FAR_WORSE * conventions[0]["rms_mm"]
    close = [fit for fit in conventions[2:_SHOWN_FITS] if fit["rms_mm"] <= worst]
    shown = [*conventions[:2], *close]
    keys = {"interpretation": "name", "RMS mm": "rms_mm", "RMS deg": "rms_deg"}
    if all(fit["rms_deg"] is None for fit in shown):
        del keys["RMS deg"]
    fits = [[fit[key] for key in keys.values()] for fit in shown]
    is_of_targets = measures == "target-pose"
    head = (
        "Fit of one hand-eye transform" if is_of_targets else "Fit with plausible geometry errors"
    )
    tables.grid(console, head, list(keys), fits)
    if len(conventions) > len(fits):
        unlisted_count = len(conventions) - len(fits)
        console.print(
            f"{unlisted_count} other interpretations fit worse; --json lists all.", markup=False
        )


def _mapping_rows(mapping: Mapping):
    for name, value in mapping.items():
        if not isinstance(value, Mapping):
            continue
        if isinstance(value.get("columns"), list):
            read = [value.get("convention"), _units(value)]
            read.append("inverse rotation" if value.get("inverse") else None)
            yield name, ", ".join(value["columns"]), ", ".join(filter(None, read))
        elif name == "columns":
            for column, target in value.items():
                yield target, column, ""
        elif name == "join":
            offset = value.get("time_offset_s")
            shifted = f", offset {_duration(offset)}" if offset else ""
            yield "join", str(value.get("key") or ""), f"{value.get('by')}{shifted}"


def _duration(seconds: float) -> str:
    """An offset in the unit that suits its size; clocks without a date count from another century."""
    size = abs(seconds)
    if size >= _YEAR_S:
        return "of the missing date"
    for unit_seconds, unit in ((86400.0, "d"), (3600.0, "h"), (1.0, "s")):
        if size >= unit_seconds:
            return f"{seconds / unit_seconds:.6g} {unit}"
    return f"{1e3 * seconds:.4g} ms"


def _units(group: Mapping) -> str | None:
    """The unit of a group in words."""
    from datasets.importers.mapping.columns.column_units import unit_words

    if "counts_per_deg" in group:
        counts = ", ".join(f"{count:g}" for count in group["counts_per_deg"])
        return f"pulses ({counts} in one degree)"
    unit = group.get("unit")
    return unit_words(tuple(unit), group["columns"], str) if isinstance(unit, list) else unit


def _preview(console, recording) -> None:
    """The first samples as the recording holds them."""
    if not recording.columns:
        return
    rows = [[name, *map(_short, column[:_PREVIEWED])] for name, column in recording.columns.items()]
    samples = range(1, len(rows[0]))
    tables.grid(console, "", ["first samples", *map(str, samples)], rows)


def _short(cell) -> str:
    return cell if isinstance(cell, str) else f"{float(cell):.6g}"
