"""Recordings during which the zero of a joint jumps: lost encoder counts are no motion of the instrument."""

from dataclasses import replace

import numpy as np
import pytest

from import_scenes import pose_scene, simulated
from robot_model import load_robot
from robot_model.measurements import samples_of
from workbench.fitting.plausibility import check_plausibility


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    scene = pose_scene("abb_irb120", 60, 4, "share_of_limits = 0.6")
    made = simulated(tmp_path_factory.mktemp("zeros"), scene)
    return samples_of(replace(made, measures="external-point"))


def change_of(recording):
    found = check_plausibility(load_robot(recording.robot), recording)
    return next(one.sentence for one in found if one.cause == "moved")


@pytest.mark.parametrize(("joint", "jump_deg"), [(2, 0.4), (3, -0.25), (4, 3.0), (5, 1.0)])
def test_the_joint_whose_zero_jumps_is_named(joint, jump_deg, recording):
    name = f"q{joint}_deg"
    readings = recording.columns[name] - jump_deg * (np.arange(60) >= 25)
    said = change_of(replace(recording, columns={**recording.columns, name: readings}))
    assert f"zero of joint {joint}" in said
    before, after = recording.sample_ids[[24, 25]]
    assert f"samples {before} and {after}" in said


@pytest.mark.parametrize(
    ("moved", "words"),
    [
        (np.array([1.5, -0.8, 0.6]), "the instrument or the robot's base"),
        (None, "the target on the flange"),
    ],
)
def test_a_moved_base_or_target_is_no_jump_of_a_zero(moved, words, recording):
    late = np.arange(60) >= 25
    if moved is None:  # 2 mm in the frame of the measured tool
        from scipy.spatial.transform import Rotation

        turns = np.stack([recording.columns[f"q{c}"] for c in "xyzw"], 1)
        moved = Rotation.from_quat(turns).apply([1.2, -1.0, 1.3])
    points = recording.points + late[:, None] * moved
    columns = {**recording.columns, **dict(zip(("x_mm", "y_mm", "z_mm"), points.T))}
    said = change_of(replace(recording, columns=columns))
    assert words in said and "zero" not in said.partition(";")[0]
    assert ("another number in column reflector" in said) == (words == "the target on the flange")
