"""A bent link moves rigidly: one constant motion in the frame of the link, whatever the convention and the kind of joint."""

from types import SimpleNamespace

import numpy as np
import pytest

from robot_model.effects.steps import Shift
from scenes import ABB, CRAIG, SLIDING, model_of, scene
from workbench.diagnosis.search import instants


@pytest.mark.parametrize("arm", [ABB, CRAIG, SLIDING], ids=["abb", "craig", "sliding"])
def test_the_step_of_a_link_is_one_motion_of_its_frame_in_all_poses(arm):
    state = model_of(scene("ball-centre", arm=arm)).chain.state
    for number in range(1, state.robot.joints):
        twists = Shift(f"link-{number}", after=-1.0).basis(state)
        frames = state.frames
        lever = frames.origin[number - 1] - frames.pivot[number]
        lever = np.einsum("cin,in->cn", frames.link[number], lever)
        # of the origin of frame K, which is fixed to link K, in the axes of frame K
        shifts = twists[:, :3] + np.cross(twists[:, 3:], lever[None], axis=1)
        assert np.ptp(twists[:, 3:], axis=-1).max() == 0
        assert np.ptp(shifts, axis=-1).max() < 1e-9 * max(np.abs(lever).max(), 1.0)


def test_two_steps_at_one_place_never_come_to_begin_at_one_instant(monkeypatch):
    def step(after):
        return SimpleNamespace(effects=(Shift("tool", after),))

    accepted = (step(10.0), step(20.0))
    search = SimpleNamespace(
        accepted=accepted,
        accepted_indices=(0, 1),
        other_indices=lambda i: (1 - i,),
        solve_feasible=lambda: None,
    )
    monkeypatch.setattr(instants, "_refined", lambda search, i: step(15.0))
    instants.refine_instants(search)
    assert [one.effects[0].after for one in search.accepted] == [15.0, 20.0]
