"""Recordings with flange poses in place of joints: read, and every mistake in them named."""

import numpy as np
import pytest

import datasets
from broken_recordings import (
    CSV,
    TOML,
    Case,
    assert_sentence,
    both,
    cell,
    drop,
    sub,
    with_flange,
)
from datasets.errors import InputError
from datasets.recording import Recording
from datasets.samples.columns import FLANGE
from good_recordings import real_set, write_good


def test_flange_poses_instead_of_joints(tmp_path):
    found = datasets.read(with_flange(tmp_path / "good"))
    assert found.flange.shape == (12, 4, 4) and found.joints.shape == (12, 0) and found.robot == {}
    np.testing.assert_allclose(
        found.flange[3],
        [[0, -1, 0, 500.5], [0, 0, -1, -20], [1, 0, 0, 310], [0, 0, 0, 1]],
        atol=1e-12,
    )
    assert not set(found.covariates) & set(FLANGE)
    assert datasets.read(write_good(tmp_path / "joints")).flange is None


def test_rows_of_one_flange_pose_are_one_pose():
    columns = {
        name: np.array([value] * 4) for name, value in zip(FLANGE, (500.0, 0, 300, 1, 0, 0, 0))
    }
    columns["flange_x_mm"] = np.array([500.0, 500.0, 510.0, 500.00001])
    assert list(Recording("ball-surface", columns, {}).poses) == [0, 0, 1, 0]


FLANGES = [
    Case(
        "flange without a quaternion",
        drop("flange_qz"),
        (CSV, "column flange_qz", "no such column", "add it next to"),
    ),
    Case("flange without a place", drop("flange_y_mm"), (CSV, "column flange_y_mm", "add it")),
    Case(
        "flange named in metres",
        sub(CSV, "flange_x_mm", "flange_x_m"),
        (CSV, "column flange_x_mm", "flange_x_m", "convert"),
    ),
    Case(
        "flange in metres",
        both(
            *(
                both(*(cell(row, name, value) for row in range(2, 14)))
                for name, value in zip(FLANGE, ("0.5", "-0.02", "0.3"))
            )
        ),
        (CSV, "flange_x_mm", "as if in metres", "multiply them by 1000"),
    ),
    Case(
        "flange turned by no rotation",
        cell(3, "flange_qw", "0.9"),
        (CSV, "row 3", "flange_qw", "length 1", "divide"),
    ),
    Case(
        "flange not finite",
        cell(4, "flange_z_mm", "nan"),
        (CSV, "row 4", "flange_z_mm", "nan", "correct"),
    ),
    Case(
        "neither joints nor flange",
        both(*map(drop, FLANGE)),
        (CSV, "q1_deg", "or flange poses", "add them"),
    ),
]


@pytest.mark.parametrize("case", FLANGES, ids=lambda case: case.name)
def test_mistake_in_flange_poses_gets_its_sentence(tmp_path, case):
    assert_sentence(with_flange(tmp_path / "cell-4"), case)


def test_robot_is_needed_for_joints_only(tmp_path):
    folder = write_good(tmp_path / "cell-4", "ball-surface")
    sub(TOML, r"\[robot\]\nfile.*\n", "")(folder)
    with pytest.raises(InputError, match=r"key \[robot\]: expected this section"):
        datasets.read(folder)


def test_real_flange_poses_turn_rightly(real):
    """The hand's camera looks down on its board: so does the flange's z axis, within 20 degrees; samples name images."""
    found = real_set(real, "handeye_open3dv:in-hand")
    assert np.all(found.flange[:, 2, 2] < -0.93) and [
        row["sample"] for row in found.images
    ] == list(found.sample_ids)
    assert (
        found.board["square_mm"] == 10.0
        and real_set(real, "handeye_open3dv:to-hand").board["fixed_to"] == "tool"
    )
