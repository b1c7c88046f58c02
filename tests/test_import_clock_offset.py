"""The offset between the clocks of a joint log and a tracker is estimated from the motion of the arm."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from conftest import mostly_slow
from datasets.importers.mapping.model import read_mapping
from import_scenes import write_rows
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.select import find
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.templates.contact import TrueArm

NOISE_MM = 0.03


class Motion:
    """A robot that moves through random poses, seen by a tracker; `rest_s`: pause at each pose."""

    backlash_rad = 0.0

    def __init__(self, robot: str, seed: int, rest_s=0.6, move_s=1.5, stations=40):
        rng = np.random.default_rng(seed)
        self.arm = TrueArm.of(load_robot(robot), rng)
        low, high = self.arm.limits().T
        poses = low + (high - low) * rng.uniform(0.2, 0.8, (stations, len(low)))
        starts = (rest_s + move_s) * np.arange(stations)
        times = np.sort(np.concatenate([starts, starts + rest_s]))
        self.length = times[-1]
        self.path = (
            _with_soft_moves(times, np.repeat(poses, 2, axis=0))
            if rest_s
            else CubicSpline(times[1::2], poses)
        )
        self.base = Rotation.from_euler("xyz", [1, -2, 70], degrees=True)
        self.rng = rng

    def point(self, seconds: np.ndarray) -> np.ndarray:
        move = self.path(seconds + 1e-3) - self.path(seconds - 1e-3)
        way = np.where(np.abs(move) > 1e-6, np.sign(move), 0.0)
        turn, origin = self.arm.flange(self.path(seconds) + self.backlash_rad * way)
        points = origin + turn @ np.array([20.0, -35.0, 110.0])
        noise = NOISE_MM * self.rng.normal(size=points.shape)
        return self.base.apply(points) + [2300.0, -700.0, 400.0] + noise


def _with_soft_moves(times, poses):
    """Rest and moves of the fifth order between them."""

    def path(seconds):
        before = np.clip(np.searchsorted(times, seconds, "right") - 1, 0, len(times) - 2)
        share = np.clip((seconds - times[before]) / (times[before + 1] - times[before]), 0, 1)
        soft = (10 * share**3 - 15 * share**4 + 6 * share**5)[:, None]
        return poses[before] * (1 - soft) + poses[before + 1] * soft

    return path


def write(folder: Path, motion: Motion, ahead_s: float, log_s=0.008, tracker_s=0.11, when=None):
    """Joint log and tracker table; the clock of the tracker is ahead by `ahead_s`."""
    log = np.arange(0.0, motion.length, log_s)
    readings = motion.path(log) + 2e-6 * motion.rng.normal(size=motion.path(log).shape)
    seen = np.arange(0.5, motion.length - 0.5, tracker_s) if when is None else when
    joints = [f"J{k} [rad]" for k in range(1, readings.shape[1] + 1)]
    first = write_rows(folder / "log.csv", ["time [s]", *joints], np.column_stack([log, readings]))
    rows = np.column_stack([seen + ahead_s, motion.point(seen)])
    second = write_rows(folder / "tracker.csv", ["time [s]", "X [mm]", "Y [mm]", "Z [mm]"], rows)
    return [first, second]


def offset_in(folder: Path) -> float:
    return tomllib.loads((folder / "import.toml").read_text())["join"]["time_offset_s"]


@pytest.mark.parametrize(
    "robot, ahead_s, rest_s",
    mostly_slow(
        [
            ("abb_irb120", 0.002, 0.6),
            ("kuka_kr6_r900", -0.0073, 0.0),
            ("ur10e", 0.041, 0.3),
            ("staubli_tx60", -0.35, 0.6),
            ("abb_irb120", 1.27, 0.6),
        ],
        1,
        2,
    ),
)
def test_an_offset_is_estimated_and_corrected(robot, ahead_s, rest_s, tmp_path):
    motion = Motion(robot, 11, rest_s)
    sources = write(tmp_path, motion, ahead_s)
    made = import_recording(sources, tmp_path / "out", ImportOptions(robot=robot))
    found = made.clocks.estimate
    assert made.clocks.applied
    assert abs(found.seconds + ahead_s) < max(4 * found.sigma_s, 2e-5)
    assert found.sigma_s < 1e-4
    assert offset_in(tmp_path / "out") == pytest.approx(found.seconds, abs=1e-6)
    assert any("tracker.csv is" in text and "ms" in text for text in made.warnings)
    assert "qdot1_deg_s" in made.recording.columns


def test_clocks_that_agree_are_left_alone(tmp_path):
    sources = write(tmp_path, Motion("abb_irb120", 5), 0.0)
    made = import_recording(sources, tmp_path / "out", ImportOptions(robot="abb_irb120"))
    assert not made.clocks.applied and made.clocks.seconds == 0.0
    assert abs(made.clocks.estimate.seconds) < 4 * made.clocks.estimate.sigma_s
    assert not any("clock" in text and "ahead" in text for text in made.warnings)


def test_at_rest_the_offset_is_not_determined(tmp_path):
    motion = Motion("abb_irb120", 6, rest_s=1.0, stations=60)
    when = 2.5 * np.arange(58) + 0.5
    sources = write(tmp_path, motion, 0.012, when=when)
    made = import_recording(sources, tmp_path / "out", ImportOptions(robot="abb_irb120"))
    assert not made.clocks.applied and made.clocks.seconds == 0.0
    assert "not determined" in made.clocks.sentence
    assert "qdot1_deg_s" not in made.recording.columns


def test_outliers_do_not_move_the_estimate(tmp_path):
    motion = Motion("ur10e", 7)
    sources = write(tmp_path, motion, 0.006)
    lines = sources[1].read_text().splitlines()
    for k in range(20, 600, 60):
        time, x, y, z = lines[k].split(",")
        lines[k] = ",".join([time, f"{float(x) + 40:.6f}", y, z])
    sources[1].write_text("\n".join(lines) + "\n")
    made = import_recording(sources, tmp_path / "out", ImportOptions(robot="ur10e"))
    assert abs(made.clocks.estimate.seconds + 0.006) < 1e-4


def test_backlash_does_not_pass_for_an_offset(tmp_path):
    """0.15 mrad in the direction of motion would look like 0.15 to 0.25 ms where all moves are about as fast."""
    motion = Motion("kuka_kr6_r900", 21, rest_s=0.4)
    motion.backlash_rad = 1.5e-4
    sources = write(tmp_path, motion, 0.0)
    made = import_recording(sources, tmp_path / "out", ImportOptions(robot="kuka_kr6_r900"))
    assert not made.clocks.applied
    assert abs(made.clocks.estimate.seconds) < 8e-5


def test_a_stated_offset_is_kept_and_a_wrong_one_gives_a_warning(tmp_path):
    """The mapping of one import repeats it; on data with another offset it warns."""
    sources = write(tmp_path, Motion("abb_irb120", 8), 0.005)
    first = import_recording(sources, tmp_path / "a", ImportOptions(robot="abb_irb120"))
    repeated = ImportOptions(mapping=read_mapping(tmp_path / "a" / "import.toml"))
    second = import_recording(sources, tmp_path / "b", repeated)
    np.testing.assert_array_equal(first.recording.joints, second.recording.joints)
    assert not second.clocks.applied and not second.clocks.is_warning
    (tmp_path / "tuesday").mkdir()
    other = write(tmp_path / "tuesday", Motion("abb_irb120", 9), -0.02)
    with pytest.raises(InputError, match="--time-offset auto"):
        import_recording(other, tmp_path / "c", repeated)
    asked = ImportOptions(mapping=repeated.mapping, time_offset="auto")
    fourth = import_recording(other, tmp_path / "d", asked)
    assert fourth.clocks.seconds == pytest.approx(0.02, abs=2e-5)


def test_none_and_seconds_keep_what_is_asked_for(tmp_path):
    sources = write(tmp_path, Motion("abb_irb120", 10), 0.004)
    for mode, expected in (("none", 0.0), (-0.003, -0.003)):
        options = ImportOptions(robot="abb_irb120", time_offset=mode)
        made = import_recording(sources, tmp_path / f"out{mode}", options)
        assert made.clocks.seconds == expected and not made.clocks.applied
        assert any("--time-offset auto" in text for text in made.warnings)


def test_an_offset_without_times_is_refused(tmp_path):
    motion = Motion("abb_irb120", 3)
    seconds = np.linspace(0, motion.length, 40)
    rows = np.column_stack([np.rad2deg(motion.path(seconds)), motion.point(seconds)])
    names = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]
    table = write_rows(tmp_path / "one.csv", names, rows)
    with pytest.raises(InputError, match="--time-offset 0.01: expected two tables"):
        options = ImportOptions(robot="abb_irb120", time_offset=0.01)
        import_recording([table], tmp_path / "out", options)


def test_speeds_are_those_of_the_joints(tmp_path):
    motion = Motion("abb_irb120", 12)
    sources = write(tmp_path, motion, 0.003)
    made = import_recording(sources, tmp_path / "out", ImportOptions(robot="abb_irb120")).recording
    seconds = np.arange(0.5, motion.length - 0.5, 0.11)
    expected = (motion.path(seconds + 1e-4) - motion.path(seconds - 1e-4)) / 2e-4
    found = made.columns["qdot2_deg_s"]
    assert np.abs(found - np.rad2deg(expected[: made.n, 1])).max() < 2.0


def test_diagnose_names_an_offset_that_was_not_corrected(tmp_path):
    """The speeds that the import writes tell a clock offset from a lag of the readings, whatever its sign."""
    motion = Motion("abb_irb120", 13, stations=14)
    sources = write(tmp_path, motion, 0.002)
    options = ImportOptions(robot="abb_irb120", time_offset="none")
    made = import_recording(sources, tmp_path / "out", options).recording
    found = find(bench_of(made)).findings
    assert [(one.effect, one.where) for one in found] == [("time-offset", "time")]
