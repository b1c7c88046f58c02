"""Compensation from a diagnosis, executed by MuJoCo: `python tools/study_compensation.py` prints a row a scene.

Each scene is an arm that differs from its nominal file (`datasets.makers.planted`). Its recording is diagnosed, targets
are compensated with the run of the diagnosis, and the true arm is sent to the corrected readings. The error of the
measured point in the instrument's frame is compared with the uncertainty that the model predicts of it.
"""

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from datasets.makers import planted  # noqa: E402
from workbench.core.rigid import rotation_matrix  # noqa: E402
from workbench.explanation.answer import diagnose  # noqa: E402
from workbench.explanation.corrected_model import write_model  # noqa: E402
from workbench.files.solution_file import CalibratedArm, read_solution  # noqa: E402
from workbench.jobs.robot.compensate import compensate  # noqa: E402

FIRST_SEED, SCENES, TARGETS = 4000, 10, 60
COMBINATIONS = ((2, 1, False), (1, 2, False), (0, 1, False), (2, 0, False), (1, 3, False))


@dataclass(frozen=True)
class Executed:
    """RMS 3-D errors (mm) of the measured point at the targets, and the RMS uncertainty that the model predicts."""

    seed: int
    before: float
    after: float
    predicted: float

    @property
    def ratio(self) -> float:
        """Error after compensation over the predicted uncertainty."""
        return self.after / self.predicted


def execute(seed: int, combination) -> Executed:
    """Make, diagnose and compensate one scene, and send the true arm to the corrected readings."""
    truth = planted.make(seed, *combination)
    recording = truth.made.recording()
    with tempfile.TemporaryDirectory() as name:
        write_model(diagnose(recording), recording, Path(name))
        arm = read_solution(Path(name))
    joints, approach, payload = truth.unseen(TARGETS, seed=2)
    count = float(len(recording.sample_ids))
    columns = {f"approach{k}": side for k, side in enumerate(approach.T, 1)}
    columns |= {"payload_kg": payload, "time_s": np.full(TARGETS, 10.0 * count)}
    columns |= {"row": np.full(TARGETS, count)}
    found = compensate(arm, np.deg2rad(joints), covariates=columns)
    kept = found.reached
    sides = approach[kept], payload[kept]
    wanted = in_instrument(arm, found.poses[kept])
    after = truth.true_points(np.rad2deg(found.readings[kept]), *sides)
    before = truth.true_points(joints[kept], *sides)
    sigma = found.sigma_mm[kept]
    return Executed(seed, _rms(before - wanted), _rms(after - wanted), _rms(sigma[:, None]))


def in_instrument(arm: CalibratedArm, flange: np.ndarray) -> np.ndarray:
    """(n, 3) mm: the calibrated reflector of flange poses (n, 4, 4) in the frame of the instrument."""
    reflector = [arm.values[f"tool.reflector1_{axis}"] for axis in "xyz"]
    base = np.array([arm.values[key] for key in arm.values if key.startswith("base.")][:6])
    in_root = flange[:, :3, :3] @ reflector + flange[:, :3, 3]
    return in_root @ rotation_matrix(base[3:]).T + base[:3]


def _rms(rows: np.ndarray) -> float:
    return float(np.sqrt((rows**2).sum(1).mean()))


if __name__ == "__main__":
    first, count = (
        (int(word) for word in sys.argv[1:3]) if len(sys.argv) > 2 else (FIRST_SEED, SCENES)
    )
    for k in range(count):
        row = execute(first + k, COMBINATIONS[k % len(COMBINATIONS)])
        print(f"{row} ratio {row.ratio:.3f}", flush=True)
