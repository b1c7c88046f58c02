"""External poses of any orientation spread: right ones are never doubted, a wrong joint column is named."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import mostly_slow, sizes
from pose_scenes import SPREADS_DEG, pose_scene
from workbench.core.errors import InputError
from workbench.fitting.checked_samples import check_samples

RECORDINGS, LEAST_NAMED = 200, 0.98
POSES, REGIONS_MM = (12, 25, 40, 100), (250.0, 120.0, 60.0)


def made(seed):
    """Recording `seed` of the set: all spreads, numbers of poses and sizes of the region in turn."""
    spread = SPREADS_DEG[seed % len(SPREADS_DEG)]
    return pose_scene(seed, spread, POSES[seed // 8 % 4], REGIONS_MM[seed // 32 % 3])


def with_column(recording, name, values):
    return replace(recording, columns={**recording.columns, name: values})


def negated(seed):
    """The recording with the opposite sign of one joint, and the name of its column; the joints take turns."""
    recording = made(seed).recording
    name = f"q{seed % 6 + 1}_deg"
    return with_column(recording, name, -recording.columns[name]), name


def assert_not_doubted(seed):
    checked = check_samples(made(seed).recording)
    assert checked.warnings == (), (seed, checked.warnings)


def is_named(seed) -> bool:
    recording, name = negated(seed)
    try:
        check_samples(recording)
    except InputError as refusal:
        return f"column {name}:" in str(refusal) and "opposite sign" in str(refusal)
    return False


@pytest.mark.parametrize("seed", mostly_slow(range(16), 4))
def test_right_recordings_are_not_doubted(seed):
    assert_not_doubted(seed)


@pytest.mark.parametrize("seed", mostly_slow([0, 3, 17, 23], 2))
def test_a_negated_joint_is_named(seed):
    assert is_named(seed)


COUNTS = sizes(12, RECORDINGS)


@pytest.mark.parametrize("count", COUNTS)
def test_no_right_recording_is_doubted(count):
    for seed in range(count):
        assert_not_doubted(seed)


@pytest.mark.parametrize("count", COUNTS)
def test_nearly_every_negated_joint_is_named(count):
    missed = [seed for seed in range(count) if not is_named(seed)]
    assert len(missed) <= (1 - LEAST_NAMED) * count, missed


@pytest.mark.parametrize("spread_deg", [1.0, 30.0, 180.0])
def test_the_last_joint_negated_is_refused(spread_deg):
    """Positions alone do not show it where the target is near the axis; orientations do."""
    recording = pose_scene(3, spread_deg).recording
    wrong = with_column(recording, "q6_deg", -recording.columns["q6_deg"])
    with pytest.raises(InputError, match="column q6_deg"):
        check_samples(wrong)


@pytest.mark.parametrize("spread_deg", mostly_slow([1.0, 30.0, 180.0], 0, 1))
def test_the_last_joint_stuck_is_a_warning_with_its_cause(spread_deg):
    recording = pose_scene(3, spread_deg).recording
    wrong = with_column(recording, "q6_deg", np.full(recording.n, 12.5))
    doubts = check_samples(wrong).suspicions
    assert any("q6_deg" in doubt and "constant" in doubt for doubt in doubts), doubts
