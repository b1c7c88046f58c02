"""`python -m benchmarks.study [RUNS] [STUDY]`: a study on one process and on two, and what the engine itself costs.

Prints seconds on one and on two, their ratio, what the machine itself gives two processes at once on the same runs, the
overhead over the runs, and whether the tables are equal. All else that runs on the machine counts against the ratio.
"""

import sys
import tempfile
from functools import partial
from pathlib import Path

import pyarrow.parquet as pq

from workbench.studies import executors, tables
from workbench.studies.engine import carry_out, parts_of
from workbench.studies.study import read

RATIO, OVERHEAD = 1.8, 0.05


def main(words: list[str]) -> int:
    """The table; 1 where a required figure is missed."""
    runs, name = (
        int(words[0]) if words else 1000,
        words[1] if len(words) > 1 else "compliance-error",
    )
    study, _ = read(Path(name))
    study = study.model_copy(update={"vary": study.vary.model_copy(update={"runs": runs})})
    found = []
    for workers in (1, 2):
        with tempfile.TemporaryDirectory() as home:
            found.append(_done(study, Path(home), workers))
    (one, first), (two, second) = found
    ratio = one.wall / two.wall
    print(
        f"{runs} runs of {name}: {one.wall:.1f} s on one process, {two.wall:.1f} s on two: {ratio:.2f} times "
        f"(expected at least {RATIO})"
    )
    both = 2 * one.seconds / two.seconds
    print(
        f"the runs themselves: two at once are {both:.2f} times one after another, of which the engine keeps "
        f"{100 * ratio / both:.0f} %"
    )
    for done in (one, two):
        print(
            f"overhead with {done.workers}: {100 * done.overhead:.1f} % of {done.seconds:.1f} s of runs (expected "
            f"at most {100 * OVERHEAD:.0f} %)"
        )
    print("same rows" if first.equals(second) else "DIFFERENT ROWS")
    return int(
        ratio < RATIO or max(one.overhead, two.overhead) > OVERHEAD or not first.equals(second)
    )


def _done(study, place: Path, workers: int):
    (place / tables.PARTS_FOLDER).mkdir()
    done = carry_out(
        study, place, partial(executors.local, workers), workers, lambda done, total: None
    )
    tables.put_together(place, len(parts_of(study)))
    return done, pq.read_table(place / tables.TABLE)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
