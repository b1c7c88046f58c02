"""Images of a board on a turntable need no name of the board pose."""

from types import SimpleNamespace

import numpy as np

from workbench.jobs.sensor import turntables


def test_an_unnamed_view_of_the_board_has_the_pose_of_its_own_corners(monkeypatch):
    seen = np.diag([1.0, -1.0, -1.0, 1.0])
    monkeypatch.setattr(turntables, "board_poses", lambda *given: [seen])
    monkeypatch.setattr(turntables, "calibrate_turntable", lambda *given: given)
    views = [
        SimpleNamespace(
            row={"table_deg": angle}, placement=name, index=np.arange(4), pixels=np.zeros((2, 4))
        )
        for angle, name in ((0.0, "first"), (20.0, ""), (40.0, ""))
    ]
    board = SimpleNamespace(points=np.zeros((3, 4)))
    camera = SimpleNamespace(views=views, board=board, covariance=np.eye(4))
    known = SimpleNamespace(values=np.zeros(4))
    first = np.array([[10.0, 20.0, 300.0, 0.0, 0.0, 0.0]])
    calibration = SimpleNamespace(placements=("first",), poses=first, camera=known)
    poses = turntables.turntable_of(camera, calibration, lambda text: None)[3]
    assert np.array_equal(poses[0][:3, 3], first[0, :3])
    assert np.array_equal(poses[1], seen) and np.array_equal(poses[2], seen)
