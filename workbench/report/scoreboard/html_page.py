"""Page of the blind benchmark: figures and acceptance criteria, images, and all cases, failed ones first."""

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
    "truth",
    "stated",
    "size, σ",
    "before",
    "after",
    "oracle",
    "noise",
    "s",
]


def write_scoreboard(board: Board, folder: Path) -> Path:
    """Write `report.html` and `summary.png` into the folder of the benchmark run. Returns the path of the page."""
    drawn.summary(board).savefig(folder / IMAGE, dpi=130)
    return write_sheet(page(board), folder)


def page(board: Board) -> Page:
    """The whole page."""
    asked = [figure for figure in board.figures if figure.reached is not None]
    numbers = (
        ("acceptance criteria met", f"{sum(f.reached for f in asked)} of {len(asked)}", ""),
        ("blind cases", str(len(board.rows)), ""),
        ("confidently wrong", str(sum(bool(r.get("confidently_wrong")) for r in board.rows)), ""),
        ("median diagnosis", f"{_middle(board):.1f}", "s"),
    )
    lead = (
        "An engine that shares no code with the diagnosis simulates recordings with a planted effect. The SHA-256 of "
        "each truth is published before the diagnosis receives the recording, and only the recording. The truths are "
        "then unblinded and the answers are scored by fixed rules.",
        f"To repeat: {board.command}",
    )
    short = [
        f"{f.suite}: {f.name} {value(f)}, criterion {f.asked}: not met"
        for f in asked
        if not f.reached
    ]
    return Page(
        "Blind benchmark",
        f"Blind benchmark, seed {board.seed}",
        numbers,
        lead,
        tuple(_sections(board, short)),
        warning=""
        if not short
        else f"{len(short)} acceptance criteria are not met; they are listed below.",
        caption="Figures with 95 % intervals",
        files=("answer.json", "results.csv", "results.parquet", "SHA256SUMS"),
    )


def _sections(board, short):
    yield Section("figures", "Figures", tuple(_figures(board, short)))
    yield Section(
        "detection",
        "Detection and reliability",
        (
            pair(drawn.detection(board), drawn.reliability(board)),
            pair(drawn.gain(board), drawn.runtimes(board)),
        ),
    )
    yield Section(
        "confusion",
        "Confusion",
        (
            drawn.confusion(board, "effect"),
            drawn.confusion(board, "where"),
        ),
    )
    yield Section("errors", "Held-out errors, before and after", (drawn.before_after(board),))
    yield Section("cases", "All cases, failed ones first", tuple(_cases(board)))
    yield Section("seals", "Hashes and seeds", tuple(_hashes(board)))


def _figures(board, short):
    if short:
        yield note("Criteria not met", short)
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
    head = ["suite", "figure", "cases", "value", "95 %", "criterion", ""]
    yield table(head, rows, left=2)
    for suite, why in board.skipped.items():
        yield words(f"Suite {suite} was skipped: {why}.", quiet=True)
    yield words(
        "Sizes are those of the part of an effect that the fitted baseline does not absorb: RMS of a measured "
        "coordinate in units of its σ, from an independent numerical baseline. Intervals of shares are Wilson "
        "intervals; those of medians come from order statistics.",
        quiet=True,
    )


def value(figure) -> str:
    """The value of a figure as text; shares in per cent."""
    if figure.value is None:
        return "–"
    if figure.hits is not None or "limit" in figure.name:
        return f"{figure.value:.1%}"
    return f"{figure.value:.2f}"


def interval(figure) -> str:
    """The 95 % interval of a figure as text; empty without one."""
    if figure.low is None or not figure.cases:
        return ""
    if figure.hits is None:
        return f"{figure.low:.2f} – {figure.high:.2f}"
    return f"{figure.low:.1%} – {figure.high:.1%}"


def _cases(board):
    yield table(_HEAD, [_row(r) for r in board.rows], left=5)


def _row(row: Mapping) -> list[str]:
    claim = "; ".join(row["claims"]) or row.get("verdict") or "no answer"
    if row["outcome"] == "failed" and row.get("note"):
        claim = row["note"]
    outcome = row["outcome"] + (", confidently wrong" if row.get("confidently_wrong") else "")
    size = row.get("survives_sigma")
    truth = "; ".join(row["concealed"]) or "nothing"
    lengths = [row.get(key) for key in ("before_mm", "after_mm", "oracle_after_mm", "noise_mm")]
    return [
        row["case"],
        f"{row['suite']} {row['index']}",
        outcome,
        truth,
        claim,
        "" if size is None else f"{size:.2f}",
        *("–" if v is None else f"{v:.4f}" for v in lengths),
        f"{row['seconds']:.1f}",
    ]


def _hashes(board):
    yield facts([("seed", str(board.seed)), ("command", board.command)])
    yield words(
        "SHA-256 of every truth, published before the first diagnosis. A truth that no longer matches its hash "
        "invalidates the benchmark run.",
        quiet=True,
    )
    rows = sorted([row["case"], row["seal"]] for row in board.rows)
    yield table(["case", "SHA-256"], rows, left=2)


def _middle(board) -> float:
    from statistics import median

    if board.rows:
        return median(row["seconds"] for row in board.rows)
    return 0.0
