"""The page of the blind proof: figures beside what is asked, images, and every case, the failed ones first."""

from collections.abc import Mapping
from pathlib import Path

from workbench.proving.board import Board
from workbench.report.page import write_sheet
from workbench.report.scoreboard import figures as drawn
from workbench.report.sections import Page, Section, facts, note, pair, table, words

IMAGE = "summary.png"
_HEAD = [
    "case",
    "suite",
    "outcome",
    "concealed",
    "said",
    "size, σ",
    "before",
    "after",
    "oracle",
    "noise",
    "s",
]


def write_scoreboard(board: Board, folder: Path) -> Path:
    """Write `report.html` and `summary.png` into the folder of the examination; the page's path."""
    drawn.summary(board).savefig(folder / IMAGE, dpi=130)
    return write_sheet(page(board), folder)


def page(board: Board) -> Page:
    """The whole page."""
    asked = [figure for figure in board.figures if figure.reached is not None]
    numbers = (
        ("figures asked for and reached", f"{sum(f.reached for f in asked)} of {len(asked)}", ""),
        ("concealed cases", str(len(board.rows)), ""),
        ("confidently wrong", str(sum(bool(r.get("confidently_wrong")) for r in board.rows)), ""),
        ("median diagnosis", f"{_middle(board):.1f}", "s"),
    )
    lead = (
        "Recordings were made in which an effect is concealed, by an engine that shares no code with the model that "
        "looks for it; each truth was sealed, and its SHA-256 published, before the diagnosis was given the recording "
        "and nothing else. Then the seals were opened and the answers scored by fixed rules.",
        f"Made again by: {board.command}",
    )
    short = [
        f"{f.suite}: {f.name} {value(f)}, asked {f.asked}: {f.word}" for f in asked if not f.reached
    ]
    return Page(
        "Blind proof",
        f"Concealed effects, seed {board.seed}",
        numbers,
        lead,
        tuple(_sections(board, short)),
        warning=""
        if not short
        else f"{len(short)} of the figures asked for fall short; they are listed below.",
        caption="Figures with 95 % intervals",
        files=("answer.json", "results.csv", "results.parquet", "SHA256SUMS"),
    )


def _sections(board, short):
    yield Section("figures", "Figures", tuple(_figures(board, short)))
    yield Section(
        "detection",
        "What is seen, and how sure",
        (
            pair(drawn.detection(board), drawn.reliability(board)),
            pair(drawn.gain(board), drawn.runtimes(board)),
        ),
    )
    yield Section(
        "confusion",
        "What is taken for what",
        (
            drawn.confusion(board, "effect"),
            drawn.confusion(board, "where"),
        ),
    )
    yield Section("errors", "Held-out errors, before and after", (drawn.before_after(board),))
    yield Section("cases", "Every case, the failed ones first", tuple(_cases(board)))
    yield Section("seals", "Seals and seeds", tuple(_seals(board)))


def _figures(board, short):
    if short:
        yield note("Falls short", short)
    rows = [
        [
            f.suite,
            f.name,
            f"{f.hits} of {f.cases}" if f.hits is not None else "–",
            value(f),
            interval(f),
            f.asked,
            f.word,
        ]
        for f in board.figures
    ]
    yield table(["suite", "figure", "cases", "value", "95 %", "asked", ""], rows, left=2)
    for suite, why in board.skipped.items():
        yield words(f"Suite {suite} was left out: {why}.", quiet=True)
    yield words(
        "Sizes are what survives of an effect after the baseline has swallowed what it can: RMS of a measured "
        "coordinate, in its σ, by the maker's own numerical baseline. Intervals are Wilson's; those of medians "
        "come from order statistics.",
        quiet=True,
    )


def value(figure) -> str:
    """A figure's value in words, as a share where it is one."""
    if figure.value is None:
        return "–"
    return (
        f"{figure.value:.1%}"
        if figure.hits is not None or "limit" in figure.name
        else f"{figure.value:.2f}"
    )


def interval(figure) -> str:
    """Its 95 % interval in words; empty where it has none."""
    if figure.low is None or not figure.cases:
        return ""
    if figure.hits is None:
        return f"{figure.low:.2f} – {figure.high:.2f}"
    return f"{figure.low:.1%} – {figure.high:.1%}"


def _cases(board):
    yield table(_HEAD, [_row(r) for r in board.rows], left=5)


def _row(row: Mapping) -> list[str]:
    said = "; ".join(row["claims"]) or row.get("verdict") or "no answer"
    said = row["note"] if row["outcome"] == "failed" and row.get("note") else said
    outcome = row["outcome"] + (", confidently wrong" if row.get("confidently_wrong") else "")
    size = row.get("survives_sigma")
    concealed = "; ".join(row["concealed"]) or "nothing"
    lengths = [row.get(key) for key in ("before_mm", "after_mm", "oracle_after_mm", "noise_mm")]
    return [
        row["case"],
        f"{row['suite']} {row['index']}",
        outcome,
        concealed,
        said,
        "" if size is None else f"{size:.2f}",
        *("–" if v is None else f"{v:.4f}" for v in lengths),
        f"{row['seconds']:.1f}",
    ]


def _seals(board):
    yield facts([("seed", str(board.seed)), ("command", board.command)])
    yield words(
        "SHA-256 of every sealed truth, as published before the first diagnosis. A truth that no longer fits "
        "its seal fails the examination.",
        quiet=True,
    )
    rows = sorted([row["case"], row["seal"]] for row in board.rows)
    yield table(["case", "SHA-256"], rows, left=2)


def _middle(board) -> float:
    from statistics import median

    return median(row["seconds"] for row in board.rows) if board.rows else 0.0
