"""Held-out errors by sample, with the baseline and with the claimed effects, for a few cases."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from workbench.proving import protocol

_SUITES = ("library", "swallowed", "pairs", "covariate-withheld")
_LARGEST = 600  # samples: more take long, and an image does not show them


@dataclass(frozen=True)
class Map:
    """One case: measured `points` (3, n) mm, 3-D held-out errors `before` and `after` (n,) mm, `title`."""

    title: str
    points: np.ndarray
    before: np.ndarray
    after: np.ndarray


def maps(exam: protocol.BenchmarkRun, rows: Sequence[Mapping]) -> list[Map]:
    """A map for each suite of named effects: the correctly named case of median effect size.

    Only cases with points in the frame of an external instrument are used.
    """
    chosen = (_chosen([row for row in rows if row["suite"] == suite]) for suite in _SUITES)
    return [_map(exam, row) for row in chosen if row is not None]


def _chosen(rows) -> Mapping | None:
    able = [
        r
        for r in rows
        if r["outcome"] == "exact"
        and r["survives_sigma"]
        and r["samples"] <= _LARGEST
        and r["measures"] == "external-point"
        and r.get("after_mm")
        and r["after_mm"] < 0.9 * r["before_mm"]
    ]
    able.sort(key=lambda row: row["survives_sigma"])
    return able[len(able) // 2] if able else None


def _map(exam, row) -> Map:

    import datasets
    from workbench.proving.oracle import Bench, claimed_rows

    answer = protocol.read_object(exam.answer(row["case"]))["answer"]
    bench = Bench(datasets.read(exam.recording(row["case"])), answer["baseline"])
    before = bench.predicted(())
    after = bench.predicted(claimed_rows(answer))
    title = f"{row['suite']} {row['index']}: {'; '.join(row['concealed'])}, {row['survives_sigma']:.1f} σ"
    return Map(title, bench.recording.points.T, np.sqrt(before.squares), np.sqrt(after.squares))
