"""The scoreboard: all cases (failed ones first), all figures with their acceptance criteria, and the files of both."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from workbench.core.text.csv_text import protect_text_columns
from workbench.files.runs import replace_file
from workbench.proving import figures
from workbench.proving.tasks import COUNTS

_ORDER = (
    "failed",
    "false alarm",
    "wrong",
    "missed",
    "abstained",
    "more",
    "part",
    "place",
    "group",
    "reference",
)
_COLUMNS = (
    "case",
    "suite",
    "index",
    "outcome",
    "concealed",
    "survives_sigma",
    "verdict",
    "claims",
    "confidently_wrong",
    "detected",
    "located",
    "located_in_group",
    "group_size",
    "covariates_right",
    "asks_for_it",
    "surviving_mm",
    "visible_mm",
    "below_visible",
    "before_mm",
    "after_mm",
    "noise_mm",
    "oracle_before_mm",
    "oracle_after_mm",
    "part_before_mm",
    "part_after_mm",
    "part_oracle_mm",
    "robot",
    "measures",
    "samples",
    "sigma_mm",
    "noise",
    "seconds",
    "cpu_s",
    "note",
    "program",
    "seal",
)


@dataclass(frozen=True)
class Board:
    """`rows` of all cases, failed ones first; `figures`; `skipped` suite -> reason; `command` that repeats the run.

    `planned`: suite -> number of committed cases; the diagnosed ones among them are rows.
    """

    rows: tuple[Mapping, ...]
    figures: tuple[figures.Figure, ...]
    skipped: Mapping[str, str]
    seed: int
    command: str
    planned: Mapping[str, int] = field(default_factory=dict)

    @property
    def case_counts(self) -> dict[str, int]:
        """Suite -> number of diagnosed cases, for every planned suite."""
        count = Counter(dict.fromkeys(self.planned, 0))
        count.update(row["suite"] for row in self.rows)
        return {suite: count[suite] for suite in sorted(count, key=_place)}

    @property
    def programs(self) -> list[str]:
        """Checksums of the programs that gave the answers; a consistent benchmark run has one."""
        return sorted({row.get("program", "") for row in self.rows})

    def as_json(self) -> dict:
        """The answer of `workbench prove`."""
        asked = [figure for figure in self.figures if figure.reached is not None]
        return {
            "command": "prove",
            "cases": len(self.rows),
            "seed": self.seed,
            "made_by": self.command,
            "asked": len(asked),
            "reached": sum(figure.reached for figure in asked),
            "suites": self.case_counts,
            "planned": dict(self.planned),
            "programs": self.programs,
            "skipped": dict(self.skipped),
            "figures": [figure.as_json() for figure in self.figures],
            "detection": figures.detection(self.rows),
            "reliability": figures.reliability(self.rows),
            "seals": {row["case"]: row["seal"] for row in self.rows},
            "results": [dict(row) for row in self.rows],
        }


def board(
    rows: Sequence[Mapping],
    skipped: Mapping[str, str],
    seed: int,
    command: str,
    checks: Sequence[figures.Figure] = (),
    planned: Mapping[str, int] | None = None,
) -> Board:
    """The scoreboard of unblinded cases; checks: figures on the benchmark run itself."""
    ordered = sorted(rows, key=lambda row: (_rank(row), row["suite"], row["index"]))
    return Board(
        tuple(ordered), (*figures.table(ordered), *checks), skipped, seed, command, planned or {}
    )


def _rank(row) -> tuple:
    """Sort key: confidently wrong cases first, then by outcome, failed ones first."""
    if row["outcome"] in _ORDER:
        place = _ORDER.index(row["outcome"])
    else:
        place = len(_ORDER)
    return (0 if row.get("confidently_wrong") else 1, place)


def _place(suite: str) -> int:
    """Position of a suite in the benchmark; a user's own suite comes last."""
    return [*COUNTS, suite].index(suite)


def save(scoreboard: Board, folder: Path) -> None:
    """Write results.csv and results.parquet, one row per case."""
    import pyarrow as pa
    from pyarrow import csv, parquet

    table = pa.Table.from_pylist([_flat(row) for row in scoreboard.rows], schema=_schema(pa))
    as_csv = ("results.csv", csv.write_csv, protect_text_columns(table))
    as_parquet = ("results.parquet", parquet.write_table, table)
    for name, write, content in (as_csv, as_parquet):
        partial = folder / f".partial-{name}"
        write(content, partial)
        partial.replace(folder / name)


_TEXT = {
    "case",
    "suite",
    "outcome",
    "concealed",
    "verdict",
    "claims",
    "robot",
    "measures",
    "noise",
    "note",
    "seal",
    "program",
}
_INTEGER_COLUMNS = {"index", "samples", "group_size"}
_YES_NO = {
    "confidently_wrong",
    "detected",
    "located",
    "located_in_group",
    "covariates_right",
    "asks_for_it",
    "below_visible",
}


def _schema(pa):
    kinds = (
        dict.fromkeys(_TEXT, pa.string())
        | dict.fromkeys(_INTEGER_COLUMNS, pa.int64())
        | dict.fromkeys(_YES_NO, pa.bool_())
    )
    return pa.schema([(name, kinds.get(name, pa.float64())) for name in _COLUMNS])


def _flat(row) -> dict:
    out = {name: row.get(name) for name in _COLUMNS}
    for name in ("concealed", "claims"):
        out[name] = "; ".join(out[name] or ())
    return out


def publish_seals(folder: Path, seals: Mapping[str, str]) -> str:
    """Write SHA256SUMS, the hashes of all truths, before any diagnosis. Returns the checksum of this file."""
    import hashlib

    lines = [f"{seal}  {name}" for name, seal in sorted(seals.items())]
    text = "\n".join(lines) + "\n"
    replace_file(folder / "SHA256SUMS", text)
    return hashlib.sha256(text.encode()).hexdigest()
