"""`python -m benchmarks.app [SAMPLES ...]`: the app of `workbench open` on recordings of up to a million samples.

Each size in a process of its own. Prints, in seconds of processor time of the server: reading recording and run, the
first page of the tab Residuals, and each interaction; then what is sent and the peak memory. The residuals are random
numbers: their values make no difference to the app. The browser's own time is not part of it: it is sent at most about
4,000 points a figure, whatever the size.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

SIZES = (10_000, 100_000, 1_000_000)


def make_run(folder: Path, samples: int) -> None:
    """A run folder with residuals and arrows of all samples, and its recording."""
    import pyarrow as pa
    import pyarrow.csv as table
    import pyarrow.parquet as pq

    from benchmarks.large import long_recording

    long_recording(folder / "recording", samples)
    run = folder / "run"
    run.mkdir()
    rng = np.random.default_rng(3)
    names = [f"{kind}_{axis}_mm" for kind in ("fit", "held_out", "nominal") for axis in "xyz"]
    ids = np.arange(1, samples + 1)
    columns = {"sample": ids, "fold": ids % 10}
    columns |= {name: rng.normal(0, 0.05, samples).round(6) for name in names}
    table.write_csv(pa.table(columns), run / "residuals.csv")
    arrows = {"sample": ids, "pose": ids}
    arrows |= {f"{axis}_mm": rng.uniform(-500, 500, samples) for axis in "xyz"}
    arrows |= {f"d{axis}_mm": rng.normal(0, 0.05, samples) for axis in "xyz"}
    pq.write_table(pa.table(arrows), run / "residual-arrows.parquet")
    answer = {
        "command": "calibrate",
        "input": str(folder / "recording"),
        "samples": samples,
        "stages": [],
    }
    (run / "answer.json").write_text(json.dumps(answer), encoding="utf-8")


def measure(folder: Path) -> dict:
    """Seconds of processor time and bytes of everything that a person waits for."""
    from workbench.app.data.opened import open_subject
    from workbench.app.figures import residuals, robot
    from workbench.app.workspace import Workspace

    started = time.process_time()
    opened = open_subject(str(folder / "run"))
    _ = opened.residuals, opened.rows
    read = time.process_time() - started
    work = Workspace(opened, folder / "session" / "session.toml")

    def first():
        name = next(iter(work.quantities))
        made = (
            residuals.arrows(work),
            residuals.chart(work, name, ""),
            residuals.histogram_figure(work),
        )
        return sum(len(one.to_json()) for one in made)

    first_s, sent = _timed(first)
    interactions = _interactions(work, residuals, robot)
    slowest = max(interactions, key=interactions.get)
    return {
        "samples": work.count,
        "read_s": round(read, 2),
        "first_s": round(first_s, 2),
        "sent_kib": round(sent / 1024),
        "slowest": slowest,
        "slowest_s": round(interactions[slowest], 3),
        "interactions": {name: round(value, 3) for name, value in interactions.items()},
        "peak_mib": round(_peak_mib()),
    }


def _interactions(work, residuals, robot) -> dict[str, float]:
    """Processor time of each interaction, with the figures that it draws."""
    name = next(iter(work.quantities))

    def charts():
        return (
            residuals.chart(work, name, ""),
            residuals.histogram_figure(work),
            residuals.arrows(work),
        )

    def brush():
        work.select_box(name, (-20.0, 20.0), (0.1, 0.2))
        return charts()

    def exclude():
        work.select_lengths(0.2, 1.0)
        work.exclude_selected()
        return charts()

    def undo():
        work.undo()
        return charts()

    def click():
        work.select([work.count // 2])
        return charts()

    def scrub():
        work.go_to(work.current + 1)
        return robot.scene(work)

    def over():
        return residuals.chart(work, list(work.quantities)[-1], "fit")

    scrub()
    steps = {
        "click": click,
        "brush": brush,
        "exclude": exclude,
        "undo": undo,
        "scrub": scrub,
        "over": over,
    }
    return {label: _timed(step)[0] for label, step in steps.items()}


def _timed(work: Callable) -> tuple[float, object]:
    started = time.process_time()
    made = work()
    return time.process_time() - started, made


def _peak_mib() -> float:
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(words: list[str]) -> int:
    """Measure every size named, all of `SIZES` where none is."""
    if words[:1] == ["--measure"]:
        print(json.dumps(measure(Path(words[1]))))
        return 0
    for samples in map(int, words or SIZES):
        with tempfile.TemporaryDirectory() as folder:
            make_run(Path(folder), samples)
            command = [sys.executable, "-m", "benchmarks.app", "--measure", folder]
            print(
                subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip(),
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
