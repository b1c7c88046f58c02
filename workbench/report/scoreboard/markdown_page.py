"""The scoreboard as a page of Markdown with small images, a table of every case and the seals beside it."""

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

_BESIDE = ("results.csv", "SHA256SUMS")
_GOOD = (*NAMED, "right", "reference")
_RULES = (
    "`exact`: the right effect at the right place and nothing else. `group`: the truth stands among the alternatives "
    "that the answer declares. `more`: right, and something else beside it. `part`: one of two. `place`: the right "
    "place under a wrong name or none. `abstained`: unexplained, at another place. `wrong`: a wrong name at a wrong "
    "place. `missed`: nothing seen. Confidently wrong: a name stated with a probability of 0.95 or more that is not "
    "true and declares no truth. Sizes are what survives of an effect after the fitted baseline has swallowed what it "
    "can: RMS of a coordinate in its σ, by the maker's own numerical baseline."
)


def write_page(board: Board, exam: Path, path: Path) -> Path:
    """Write `path` (ending in .md) and the folder of the same name beside it, with images, results.csv and seals.

    exam: folder of the examination. Raises InputError where the page cannot be written.
    """
    if path.suffix != ".md":
        raise InputError(
            f"--page {path}: a file that ends in .md is expected; name one, as in docs/scoreboard.md."
        )
    folder = path.with_suffix("")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        images = write_images(board, maps(protocol.Examination(exam), board.rows), folder)
        for name in _BESIDE:
            shutil.copyfile(exam / name, folder / name)
    except OSError as error:
        raise InputError(
            f"--page {path}: cannot be written there ('{error.strerror}'); name another place."
        ) from error
    runs.replace_file(path, "\n".join(_lines(board, folder.name, images)) + "\n")
    return path


def _lines(board: Board, folder: str, images: Mapping[str, str]) -> Iterator[str]:
    yield from _head(board)
    yield from (
        "",
        "## What is asked",
        "",
        *_asked(board),
        "",
        "## What else was counted",
        "",
        *_others(board),
        "",
    )
    for name, words in images.items():
        yield from (f"![{words}]({folder}/{name})", "", f"*{words}*", "")
    yield from (
        "## Every case that is not right, the worst first",
        "",
        _RULES,
        "",
        *_cases(board),
        "",
    )
    right = sum(_fine(row) for row in board.rows)
    yield (
        f"The other {right} cases are right. All {len(board.rows)}, the failed ones first, with held-out errors in "
        f"mm before, after and of the oracle: [results.csv]({folder}/results.csv); the seals as they were published "
        f"before the first diagnosis: [SHA256SUMS]({folder}/SHA256SUMS)."
    )


def _head(board: Board) -> Iterator[str]:
    asked = [figure for figure in board.figures if figure.reached is not None]
    yield "# Scoreboard of the blind proof"
    yield ""
    yield (
        "Made by `workbench prove`. Recordings were made in which an effect is concealed, by an engine that shares "
        "no code with the model that looks for it; each truth was sealed, and its SHA-256 published, before the "
        "diagnosis was given the recording and nothing else. Then the seals were opened and the answers scored by "
        "fixed rules."
    )
    yield ""
    yield (
        f"**{sum(f.reached for f in asked)} of {len(asked)} figures asked for are reached**, on {len(board.rows)} "
        f"cases of seed {board.seed}. Made again by"
    )
    yield from ("", "```sh", " \\\n    --suite".join(board.command.split(" --suite")), "```", "")
    yield from _run(board)


def _run(board: Board) -> Iterator[str]:
    yield "| suite | cases diagnosed | of sealed |"
    yield "|---|---|---|"
    for suite, count in board.held.items():
        yield f"| {suite} | {count} | {board.planned.get(suite, count)} |"
    for suite, why in board.skipped.items():
        yield f"| {suite} | 0 | left out: {why} |"
    for suite in COUNTS:
        if board.planned and suite not in {**board.planned, **board.skipped}:
            yield f"| {suite} | 0 | not held |"
    if sum(board.planned.values()) > len(board.rows):
        yield from (
            "",
            "Cases are diagnosed in an order by chance. Where fewer were diagnosed than sealed, the time "
            "was up; the same call goes on with the others.",
        )
    if len(board.programs) > 1:
        yield from (
            "",
            f"The answers come from {len(board.programs)} states of the program "
            f"({', '.join(board.programs)}); the column `program` says which.",
        )


_MARKS = {"reached": "✓ ", "short": "✗ "}


def _asked(board: Board) -> Iterator[str]:
    yield "| suite | figure | must reach | reached | cases | 95 % | |"
    yield "|---|---|---|---|---|---|---|"
    for f in (one for one in board.figures if one.asked):
        word = f"{_MARKS.get(f.word, '')}{f.word}" or "no case"
        yield f"| {f.suite} | {f.name} | {f.asked} | {value(f)} | {_counted(f)} | {interval(f)} | {word} |"


def _others(board: Board) -> Iterator[str]:
    yield "| suite | figure | value | cases | 95 % |"
    yield "|---|---|---|---|---|"
    for f in (one for one in board.figures if not one.asked):
        yield f"| {f.suite} | {f.name} | {value(f)} | {_counted(f)} | {interval(f)} |"


def _counted(figure) -> str:
    return f"{figure.hits} of {figure.cases}" if figure.hits is not None else str(figure.cases)


def _fine(row: Mapping) -> bool:
    return row["outcome"] in _GOOD and not row.get("confidently_wrong")


def _cases(board: Board) -> Iterator[str]:
    yield "| case | suite | outcome | concealed | size, σ | said | before, mm | after | oracle | noise |"
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for row in board.rows:
        if not _fine(row):
            yield f"| {' | '.join(_cells(row))} |"


def _cells(row: Mapping) -> list[str]:
    said = "; ".join(row["claims"]) or row.get("verdict") or "no answer"
    said = row["note"] if row["outcome"] == "failed" and row.get("note") else said
    outcome = row["outcome"] + (", **confidently wrong**" if row.get("confidently_wrong") else "")
    size = row.get("survives_sigma")
    lengths = [row.get(key) for key in ("before_mm", "after_mm", "oracle_after_mm", "noise_mm")]
    return [
        f"`{row['case']}`",
        f"{row['suite']} {row['index']}",
        outcome,
        "; ".join(row["concealed"]) or "nothing",
        "" if size is None else f"{size:.2f}",
        said.replace("|", "/"),
        *("–" if v is None else f"{v:.4f}" for v in lengths),
    ]
