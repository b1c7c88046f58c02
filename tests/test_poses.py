"""Poses that are chosen can be driven to and seen from, tell more than random ones, and say what they leave open."""

from dataclasses import replace

import numpy as np
import pytest

from robot_model import load_robot
from robot_model.clearance import hidden_by_others, segment_distance, self_clearance
from scenes import scene
from workbench.core.errors import InputError
from workbench.poses import choose_poses, write_poses


@pytest.fixture(scope="module")
def candidates():
    made = scene("external-point", n=200, reflectors={1: (30.0, -40.0, 100.0)})
    low, high = made.robot.limits.T
    inside = ((made.recording.joints > low) & (made.recording.joints < high)).all(1)
    return made.recording.select(np.flatnonzero(inside)[:150])


def test_chosen_poses_are_candidates_and_better_than_random(candidates):
    found = choose_poses(candidates, 30, link_radius_mm=0)
    answer = found.as_json()
    assert len(set(found.samples)) == 30 and set(found.samples) <= set(candidates.sample_ids.tolist())
    assert answer["gain_over_random"] > 1.2 and answer["candidates"] == 150
    assert any("base" in sentence for sentence in answer["undetermined"])


def test_poses_of_several_reflectors_come_whole():
    recording = scene("external-point", n=90).recording
    columns = dict(recording.columns) | {"pose": np.repeat(np.arange(30.0), 3)}
    columns |= {k: np.repeat(v[::3], 3) for k, v in recording.columns.items() if k.startswith("q") and k.endswith("_deg")}
    found = choose_poses(replace(recording, columns=columns), 10, link_radius_mm=0)
    assert len(found.samples) == 30 and len(found.design.chosen) == 10


def test_what_cannot_be_driven_to_is_no_candidate(candidates):
    columns = dict(candidates.columns)
    columns["q2_deg"] = np.where(np.arange(150) < 20, 200.0, columns["q2_deg"])
    found = choose_poses(replace(candidates, columns=columns), 30, link_radius_mm=0)
    assert found.left_out["beyond a joint's limit"] == 20 and found.candidates == 130
    assert min(found.samples) > candidates.sample_ids[19]


def test_an_arm_folded_onto_itself_is_in_its_own_way():
    robot = load_robot({"name": "four links", "convention": "distal",
                        "joint": [{"theta_deg": 0.0, "d_mm": 0.0, "a_mm": 300.0, "alpha_deg": 0.0} for _ in range(4)]})  # fmt: skip
    readings = np.deg2rad([[0, 0, 0, 0], [0, 90, 90, 90], [0, 100, 100, 100]]).T
    clear = self_clearance(robot, readings, 30.0)
    assert clear[0] == pytest.approx(300) and clear[1] == pytest.approx(0, abs=1e-9) and clear[2] < 60


def test_segments_are_as_far_apart_as_a_fine_search_says():
    rng = np.random.default_rng(0)
    a, b, c, d = rng.normal(size=(4, 3, 50))
    s = np.linspace(0, 1, 201)
    one = a[..., None] + (b - a)[..., None] * s
    two = c[..., None] + (d - c)[..., None] * s
    gaps = np.linalg.norm(one[:, :, :, None] - two[:, :, None, :], axis=0).min((1, 2))
    np.testing.assert_allclose(segment_distance(a, b, c, d), gaps, atol=2e-2)
    assert (segment_distance(a, b, c, d) <= gaps + 1e-12).all()


def test_a_ball_behind_another_is_hidden():
    eye, target = np.zeros((3, 2)), np.array([[0, 0, 100.0], [0, 100.0, 0]]).T
    balls, radii = np.array([[0, 0, 100.0], [0, 100.0, 0], [2.0, 0, 50.0]]), np.full(3, 5.0)
    assert hidden_by_others(eye, target, balls, radii, np.array([0, 1])).tolist() == [True, False]


def test_ball_scenes_leave_out_what_cannot_be_seen():
    recording = scene("ball-centre", n=80).recording
    found = choose_poses(recording, 20, link_radius_mm=0)
    assert found.candidates + sum(found.left_out.values()) == 80


def test_the_chosen_poses_are_written(candidates, tmp_path):
    found = choose_poses(candidates, 12, link_radius_mm=0)
    lines = write_poses(found, tmp_path).read_text().splitlines()
    assert lines[0].startswith("sample,") and "q6_deg" in lines[0] and len(lines) == 13


@pytest.mark.parametrize(("n", "criterion"), [(500, "D"), (1, "D"), (30, "E"), (30, "task")])
def test_impossible_wishes_are_sentences(candidates, n, criterion):
    with pytest.raises(InputError, match="expected"):
        choose_poses(candidates, n, criterion, link_radius_mm=0)


def test_tasks_of_another_kind_or_tool_are_a_sentence(candidates):
    for other in (scene("ball-centre", n=30), scene("external-point", n=30, reflectors={1: (0, 0, 90.0), 2: (9.0, 0, 0)})):
        with pytest.raises(InputError, match="expected poses of the candidates' robot, tool and targets"):
            choose_poses(candidates, 30, "task", replace(other.recording, name="tasks"), link_radius_mm=0)
