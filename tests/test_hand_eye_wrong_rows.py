"""Target poses of which many rows are wrong, as of a marker whose orientation is ambiguous: `check` names the rows."""

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.recording import Recording
from target_scenes import quaternions, target_scene
from workbench.recordings.inspection.hand_eye import inspect_target_poses


def _recording(wrong: int) -> Recording:
    """Rows of which `wrong` have the target turned and displaced, each in another way; the others scatter by 2 mm."""
    flange, seen, _ = target_scene(24, count=30)
    rng = np.random.default_rng(7)
    seen[:, :3, 3] += rng.normal(size=(len(seen), 3)) * 1.5
    for row in rng.choice(len(seen), wrong, replace=False):
        turn = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        seen[row, :3, :3] = turn @ seen[row, :3, :3]
        seen[row, :3, 3] += rng.normal(size=3) * 70
    columns = {"sample": np.arange(1.0, len(seen) + 1)}
    for prefix, poses in (("flange_", flange), ("", seen)):
        columns |= dict(zip((f"{prefix}{axis}_mm" for axis in "xyz"), poses[:, :3, 3].T))
        columns |= dict(zip((f"{prefix}q{part}" for part in "xyzw"), quaternions(poses).T))
    columns["fixed_to"] = np.full(len(seen), "base")
    return Recording(measures="target-pose", columns=columns, robot={}, name="markers")


def test_wrong_rows_are_named_also_where_they_are_a_third_of_all():
    ((sentence, _, _),) = inspect_target_poses(_recording(9)).findings
    assert "the flange poses of 9 of 30 rows do not fit those of the others" in sentence
    assert "image" not in sentence and "target seems to be displaced" in sentence
