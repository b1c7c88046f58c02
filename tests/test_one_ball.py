"""One ball of which nobody measured the place: no artefact.csv, and the same answer as with one."""

import pytest

from datasets import read, write
from scenes import BALLS, scene
from workbench.core.errors import InputError
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.poses import choose_poses


def folder(tmp_path, balls, artefact):
    """A ball-centre recording on disk, with its artefact.csv or without."""
    recording = scene("ball-centre", n=80, seed=5, balls=balls).recording
    made = write(recording, tmp_path / ("with" if artefact else "without"))
    if not artefact:
        (made / "artefact.csv").unlink()
        text = (made / "recording.toml").read_text(encoding="utf-8")
        (made / "recording.toml").write_text(
            text.replace('[artefact]\nfile = "artefact.csv"\n', ""), encoding="utf-8"
        )
    return read(made)


def test_a_ball_of_unknown_place_calibrates_as_one_of_known_place(tmp_path):
    ball = {3: BALLS[2]}
    known, unknown = (
        calibrate(folder(tmp_path, ball, artefact), folds=5) for artefact in (True, False)
    )
    assert unknown.recording.balls == {3: (0.0, 0.0, 0.0, 10.0)}
    assert unknown.held_out["rms_mm"] == pytest.approx(known.held_out["rms_mm"], rel=1e-2, abs=1e-4)
    found = [{row["name"]: row for row in c.parameters} for c in (known, unknown)]
    assert found[1]["a2"]["value"] == pytest.approx(found[0]["a2"]["value"], abs=1e-3)
    assert len(choose_poses(unknown.recording, 20).samples) == 20


def test_several_balls_need_the_artefact(tmp_path):
    with pytest.raises(
        InputError,
        match=r"key \[artefact\]: expected this section in a ball-centre recording, found none",
    ):
        folder(tmp_path, BALLS, False)


def test_points_on_a_ball_need_its_radius(tmp_path):
    one = scene("ball-centre", n=20, seed=5, balls={3: BALLS[2]}).recording
    made = write(one, tmp_path / "surface")
    text = (
        (made / "recording.toml").read_text(encoding="utf-8").replace("ball-centre", "ball-surface")
    )
    (made / "recording.toml").write_text(
        text.replace('[artefact]\nfile = "artefact.csv"\n', ""), encoding="utf-8"
    )
    with pytest.raises(InputError, match=r"key \[artefact\]"):
        read(made)
