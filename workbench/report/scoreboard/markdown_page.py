"""The scoreboard as a Markdown page with images, a table of all cases and the published hashes."""

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

from workbench.core.errors import InputError
from workbench.files import runs
from workbench.proving import protocol
from workbench.proving.board import Board
from workbench.proving.maps import maps
from workbench.proving.scoring import NAMED
from workbench.proving.tasks import COUNTS
from workbench.report.scoreboard.html_page import interval, value
from workbench.report.scoreboard.images import write_images

_COPIED_FILES = ("results.csv", "SHA256SUMS")
_GOOD = (*NAMED, "right", "reference")
_RULES = (
    "`exact`: the true effect at the true place and no other finding. `group`: the truth is one of the declared "
    "alternatives. `more`: correct, with a further finding. `part`: one of two effects. `place`: the true place with a "
    "wrong name or none. `abstained`: unexplained, at another place. `wrong`: a wrong name at a wrong place. `missed`: "
    "no finding. Confidently wrong: a wrong name stated with a probability of at least 0.95, without the truth among "
    "its alternatives. Sizes are those of the part of an effect that the fitted baseline does not absorb: RMS of a "
    "coordinate in units of its σ, from an independent numerical baseline."
)


def write_page(board: Board, exam: Path, path: Path) -> Path:
    """Write `path` (ending in .md) and a folder of the same name with images, results.csv and the hashes.

    exam: folder of the benchmark run. Raises InputError if the page cannot be written.
    """
    if path.suffix != ".md":
        raise InputError(
            f"--page {path}: expected a file name that ends in .md, such as docs/scoreboard.md."
        )
    folder = path.with_suffix("")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        images = write_images(board, maps(protocol.BenchmarkRun(exam), board.rows), folder)
        for name in _COPIED_FILES:
            shutil.copyfile(exam / name, folder / name)
    except OSError as error:
        raise InputError(
            f"--page {path}: the page cannot be written ('{error.strerror}'). Name another path."
        ) from error
    runs.replace_file(path, "\n".join(_lines(board, folder.name, images)) + "\n")
    return path


def _lines(board: Board, folder: str, images: Mapping[str, str]) -> Iterator[str]:
    yield from _head(board)
    yield from (
        "",
        "## Acceptance criteria",
        "",
        *_asked(board),
        "",
        "## Further figures",
        "",
        *_others(board),
        "",
    )
    for name, words in images.items():
        yield from (f"![{words}]({folder}/{name})", "", f"*{words}*", "")
    yield from (
        "## Cases that are not correct, worst first",
        "",
        _RULES,
        "",
        *_cases(board),
        "",
    )
    right = sum(_is_correct(row) for row in board.rows)
    yield (
        f"The other {right} cases are correct. [results.csv]({folder}/results.csv) lists all {len(board.rows)} cases "
        "with held-out errors in mm before, after and of the oracle, failed cases first. "
        f"[SHA256SUMS]({folder}/SHA256SUMS) lists the hashes that were published before the first diagnosis."
    )


def _head(board: Board) -> Iterator[str]:
    asked = [figure for figure in board.figures if figure.reached is not None]
    yield "# Scoreboard of the blind benchmark"
    yield ""
    yield (
        "This page states how often the diagnosis detects, locates and identifies effects in simulated recordings "
        "whose true effects it does not know ([method](concepts/blind-benchmark.md)). An engine that shares no code "
        "with the diagnosis simulates the recordings. The SHA-256 of each truth is published before the diagnosis "
        "receives the recording, and only the recording. The truths are then unblinded and the answers are scored by "
        "fixed rules. `workbench prove` writes this page."
    )
    yield ""
    yield (
        f"**{sum(f.reached for f in asked)} of {len(asked)} acceptance criteria are met**, on {len(board.rows)} "
        f"cases of seed {board.seed}. To repeat the benchmark:"
    )
    yield from ("", "```sh", " \\\n    --suite".join(board.command.split(" --suite")), "```", "")
    yield from _run(board)


def _run(board: Board) -> Iterator[str]:
    yield "| suite | cases diagnosed | cases committed |"
    yield "|---|---|---|"
    for suite, count in board.case_counts.items():
        yield f"| {suite} | {count} | {board.planned.get(suite, count)} |"
    for suite, why in board.skipped.items():
        yield f"| {suite} | 0 | skipped: {why} |"
    for suite in COUNTS:
        if board.planned and suite not in {**board.planned, **board.skipped}:
            yield f"| {suite} | 0 | not run |"
    if sum(board.planned.values()) > len(board.rows):
        yield from (
            "",
            "Cases are diagnosed in random order. If fewer cases are diagnosed than committed, the time limit was "
            "reached; the same call continues with the others.",
        )
    if len(board.programs) > 1:
        yield from (
            "",
            f"The answers come from {len(board.programs)} versions of the program "
            f"({', '.join(board.programs)}); the column `program` names the version of each.",
        )


_MARKS = {"reached": "✓ met", "short": "✗ not met"}


def _asked(board: Board) -> Iterator[str]:
    yield "| suite | figure | criterion | value | cases | 95 % | |"
    yield "|---|---|---|---|---|---|---|"
    for f in (criterion for criterion in board.figures if criterion.asked):
        word = _MARKS.get(f.word, f.word) or "no case"
        yield f"| {f.suite} | {f.name} | {f.asked} | {value(f)} | {_counted(f)} | {interval(f)} | {word} |"


def _others(board: Board) -> Iterator[str]:
    yield "| suite | figure | value | cases | 95 % |"
    yield "|---|---|---|---|---|"
    for f in (criterion for criterion in board.figures if not criterion.asked):
        yield f"| {f.suite} | {f.name} | {value(f)} | {_counted(f)} | {interval(f)} |"


def _counted(figure) -> str:
    if figure.hits is not None:
        return f"{figure.hits} of {figure.cases}"
    return str(figure.cases)


def _is_correct(row: Mapping) -> bool:
    return row["outcome"] in _GOOD and not row.get("confidently_wrong")


def _cases(board: Board) -> Iterator[str]:
    yield "| case | suite | outcome | truth | size, σ | stated | before, mm | after | oracle | noise |"
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for row in board.rows:
        if not _is_correct(row):
            yield f"| {' | '.join(_cells(row))} |"


def _cells(row: Mapping) -> list[str]:
    claim = "; ".join(row["claims"]) or row.get("verdict") or "no answer"
    if row["outcome"] == "failed" and row.get("note"):
        claim = row["note"]
    outcome = row["outcome"] + (", **confidently wrong**" if row.get("confidently_wrong") else "")
    size = row.get("survives_sigma")
    lengths = [row.get(key) for key in ("before_mm", "after_mm", "oracle_after_mm", "noise_mm")]
    return [
        f"`{row['case']}`",
        f"{row['suite']} {row['index']}",
        outcome,
        "; ".join(row["concealed"]) or "nothing",
        "" if size is None else f"{size:.2f}",
        claim.replace("|", "/"),
        *("–" if v is None else f"{v:.4f}" for v in lengths),
    ]
