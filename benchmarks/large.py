"""`python -m benchmarks.large [SAMPLES ...]`: a recording of up to a million samples calibrated in chunks.

Each size in a process of its own; prints seconds of processor time, peak memory and the exponent of time over samples.
"""

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.formats.recording1_writer import write
from robot_model import load_robot
from robot_model.system import bind
from workbench.core.model import Model
from workbench.core.solution import Stage
from workbench.files.scene import Cause, Scene
from workbench.fitting.calibration_plans.plans import geometry
from workbench.jobs.robot.simulate import truth_from

BLOCK = 50_000
SIZES = (1000, 10_000, 100_000, 1_000_000)
SCENE = Scene(
    robot="abb_irb120",
    samples=BLOCK,
    seed=7,
    sigma_mm=0.02,
    payload_kg=(0.0, 2.0),
    share_of_limits=0.6,
    reflectors=[[0.0, 30.0, 120.0], [60.0, 0.0, 120.0], [-60.0, 0.0, 120.0]],
    errors={"length_mm": 0.3, "angle_deg": 0.1},
    effect=[
        Cause(effect="joint-compliance", where=f"joint-{k}", values={"compliance": c})
        for k, c in ((2, 1e-4), (3, 2e-4))
    ],
)


def long_recording(folder: Path, samples: int, seed: int = 1) -> None:
    """A recording folder of one robot at `samples` random poses, written block by block."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    truth = truth_from(SCENE.model_copy(update={"samples": min(samples, BLOCK)}), Path("benchmark"))
    rng, written = np.random.default_rng(seed), 0
    writer = None
    while written < samples:
        columns = _block(truth, rng, written)
        columns = {name: values[: samples - written] for name, values in columns.items()}
        if writer is None:
            write(
                replace(
                    truth.shown, columns={name: values[:9] for name, values in columns.items()}
                ),
                folder,
            )
            (folder / "samples.csv").unlink()
            keys = folder / "recording.toml"
            keys.write_text(keys.read_text().replace("samples.csv", "samples.parquet"))
            writer = pq.ParquetWriter(folder / "samples.parquet", pa.table(columns).schema)
        writer.write_table(pa.table(columns), row_group_size=10_000)
        written += len(columns["sample"])
    writer.close()


def _block(truth, rng, first: int) -> dict[str, np.ndarray]:
    """Columns of the same robot at shuffled readings, with noise."""
    shown, n = truth.shown, truth.shown.n
    drawn = {
        name: values for name, values in shown.columns.items() if name.startswith(("q", "payload"))
    }
    mixed = {name: rng.permutation(values) for name, values in drawn.items()}
    blank = dict.fromkeys(("x_mm", "y_mm", "z_mm"), np.zeros(n))
    rows = replace(shown, columns=shown.columns | mixed | blank)
    model = Model(bind(truth.model.chain.robot, rows, truth.model.chain.start), truth.model.effects)
    residual = model.residual(model.parameters.take_over(truth.parameters))
    seen = model.chain.measurement.columns(
        residual + rng.normal(size=residual.shape) * SCENE.sigma_mm
    )
    number = np.arange(first, first + n, dtype=float)
    return rows.columns | seen | {"sample": number + 1, "time_s": 10 * number}


def one(samples: int) -> dict:
    """Seconds of the processor, peak memory (MiB) and errors of one calibration in this process."""
    import resource

    from workbench.jobs.robot.calibrate_large import calibrate_chunks

    with tempfile.TemporaryDirectory() as home:
        subprocess.run(
            [sys.executable, "-m", "benchmarks.large", "--make", str(samples), home], check=True
        )
        start = time.process_time()
        made = calibrate_chunks(Path(home), plan(), folds=5)
        seconds = time.process_time() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        "samples": samples,
        "seconds": seconds,
        "peak_mib": peak,
        "held_out_mm": made.held_out["rms_mm"],
        "converged": made.solution.converged,
    }


def plan() -> tuple[Stage, ...]:
    """Geometry, and the torsion of the joints that gravity loads."""
    robot = load_robot({"builtin": SCENE.robot}, "benchmark")
    torsion = tuple(("joint-compliance", f"joint-{k}", {}) for k in (2, 3, 4, 5))
    return geometry(robot), Stage("torsion", "joints yield", torsion, earn=False)


def main(words: list[str]) -> int:
    """All sizes, or one, or one recording made."""
    if words[:1] == ["--make"]:
        long_recording(Path(words[2]), int(words[1]))
    elif words[:1] == ["--one"]:
        print(json.dumps(one(int(words[1]))))
    else:
        _table([int(word) for word in words] or SIZES)
    return 0


def _table(sizes) -> None:
    print(f"{'samples':>9} {'seconds':>9} {'us/sample':>10} {'peak MiB':>9} {'held out mm':>12}")
    rows = []
    for samples in sizes:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.large", "--one", str(samples)],
            check=True,
            capture_output=True,
            text=True,
        )
        rows.append(json.loads(done.stdout.splitlines()[-1]))
        row = rows[-1]
        print(
            f"{samples:9,} {row['seconds']:9.1f} {1e6 * row['seconds'] / samples:10.1f} {row['peak_mib']:9.0f} "
            f"{row['held_out_mm']:12.5f}",
            flush=True,
        )
    if len(rows) > 1:
        logs = np.log([[row["samples"], row["seconds"]] for row in rows]).T
        print(
            f"time grows with samples to the power {np.polyfit(*logs, 1)[0]:.3f}, at the end to the power "
            f"{np.diff(logs[1][-2:])[0] / np.diff(logs[0][-2:])[0]:.3f} (at most 1.05)"
        )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
