"""The scoreboard: every case, the failed ones first, every figure beside what is asked, and the files of both."""

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
    """`rows` of all cases, the failed ones first; `figures`; `skipped` suite -> why; `command` that makes it again.

    `planned`: suite -> cases concealed and sealed, of which those are rows that have been diagnosed.
    """

    rows: tuple[Mapping, ...]
    figures: tuple[figures.Figure, ...]
    skipped: Mapping[str, str]
    seed: int
    command: str
    planned: Mapping[str, int] = field(default_factory=dict)

    @property
    def held(self) -> dict[str, int]:
        """Suite -> cases diagnosed, of every suite that was planned."""
        count = Counter(dict.fromkeys(self.planned, 0))
        count.update(row["suite"] for row in self.rows)
        return {suite: count[suite] for suite in sorted(count, key=_place)}

    @property
    def programs(self) -> list[str]:
        """Checksums of the programs that gave the answers; of one examination it should be one."""
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
            "suites": self.held,
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
    """The scoreboard of opened cases; checks: figures of the examination itself."""
    ordered = sorted(rows, key=lambda row: (_rank(row), row["suite"], row["index"]))
    return Board(
        tuple(ordered), (*figures.table(ordered), *checks), skipped, seed, command, planned or {}
    )


def _rank(row) -> tuple:
    """Failed ones first; a confident wrong name stands before all others of its outcome."""
    place = _ORDER.index(row["outcome"]) if row["outcome"] in _ORDER else len(_ORDER)
    return (0 if row.get("confidently_wrong") else 1, place)


def _place(suite: str) -> int:
    """Where a suite stands in the examination; one of somebody's own stands last."""
    return [*COUNTS, suite].index(suite)


def save(made: Board, folder: Path) -> None:
    """Write results.csv and results.parquet, one row a case, and the summary image."""
    import pyarrow as pa
    from pyarrow import csv, parquet

    table = pa.Table.from_pylist([_flat(row) for row in made.rows], schema=_schema(pa))
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
_WHOLE = {"index", "samples", "group_size"}
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
        | dict.fromkeys(_WHOLE, pa.int64())
        | dict.fromkeys(_YES_NO, pa.bool_())
    )
    return pa.schema([(name, kinds.get(name, pa.float64())) for name in _COLUMNS])


def _flat(row) -> dict:
    out = {name: row.get(name) for name in _COLUMNS}
    for name in ("concealed", "claims"):
        out[name] = "; ".join(out[name] or ())
    return out


def publish_seals(folder: Path, seals: Mapping[str, str]) -> str:
    """A page of its own that holds every seal before anything is diagnosed; the checksum of all of them together."""
    import hashlib

    lines = [f"{seal}  {name}" for name, seal in sorted(seals.items())]
    text = "\n".join(lines) + "\n"
    replace_file(folder / "SHA256SUMS", text)
    return hashlib.sha256(text.encode()).hexdigest()
