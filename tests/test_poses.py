"""Poses that are chosen can be driven to and seen from, tell more than random ones, and say what they leave open."""

from dataclasses import replace
from itertools import combinations, combinations_with_replacement

import numpy as np
import pytest

from robot_model import load_robot
from robot_model.postures.clearance import hidden_by_others, segment_distance, self_clearance
from robot_model.system import bind, geometry_free
from scenes import scene
from workbench.core.errors import InputError
from workbench.core.least_squares.design import choose
from workbench.core.least_squares.identifiability import identifiability, independent
from workbench.core.least_squares.solver import normal_matrix
from workbench.core.model import Model
from workbench.fitting.calibration_plans.plans import geometry
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.poses import choose_poses, write_poses


@pytest.fixture(scope="module")
def candidates():
    made = scene("external-point", n=200, reflectors={1: (30.0, -40.0, 100.0)})
    low, high = made.robot.limits.T
    inside = ((made.recording.joints > low) & (made.recording.joints < high)).all(1)
    return made.recording.select(np.flatnonzero(inside)[:150])


def test_chosen_poses_are_candidates_and_better_than_random(candidates):
    found = choose_poses(candidates, 30, link_radius_mm=0)
    answer = found.as_json()
    assert len(set(found.samples)) == 30 and set(found.samples) <= set(
        candidates.sample_ids.tolist()
    )
    assert answer["gain_over_random"] > 1.2 and answer["candidates"] == 150
    assert any("base" in sentence for sentence in answer["undetermined"])


def test_poses_of_several_reflectors_come_whole():
    recording = scene("external-point", n=90).recording
    columns = dict(recording.columns) | {"pose": np.repeat(np.arange(30.0), 3)}
    columns |= {
        k: np.repeat(v[::3], 3)
        for k, v in recording.columns.items()
        if k.startswith("q") and k.endswith("_deg")
    }
    found = choose_poses(replace(recording, columns=columns), 10, link_radius_mm=0)
    assert len(found.samples) == 30 and len(found.design.chosen) == 10


def test_what_cannot_be_driven_to_is_no_candidate(candidates):
    columns = dict(candidates.columns)
    columns["q2_deg"] = np.where(np.arange(150) < 20, 200.0, columns["q2_deg"])
    found = choose_poses(replace(candidates, columns=columns), 30, link_radius_mm=0)
    assert found.left_out["beyond a joint's limit"] == 20 and found.candidates == 130
    assert min(found.samples) > candidates.sample_ids[19]


def test_an_arm_folded_onto_itself_is_in_its_own_way():
    robot = load_robot(
        {
            "name": "four links",
            "convention": "distal",
            "joint": [
                {"theta_deg": 0.0, "d_mm": 0.0, "a_mm": 300.0, "alpha_deg": 0.0} for _ in range(4)
            ],
        }
    )
    readings = np.deg2rad([[0, 0, 0, 0], [0, 90, 90, 90], [0, 100, 100, 100]]).T
    clear = self_clearance(robot, readings, 30.0)
    assert (
        clear[0] == pytest.approx(300) and clear[1] == pytest.approx(0, abs=1e-9) and clear[2] < 60
    )


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
    for other in (
        scene("ball-centre", n=30),
        scene("external-point", n=30, reflectors={1: (0, 0, 90.0), 2: (9.0, 0, 0)}),
    ):
        with pytest.raises(
            InputError, match="expected poses of the candidates' robot, tool and targets"
        ):
            choose_poses(
                candidates, 30, "task", replace(other.recording, name="tasks"), link_radius_mm=0
            )


def task_rows(seed):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(11, 2, 4)) * rng.uniform(0.2, 3, (11, 1, 1))
    return rows, rng.normal(size=(5, 3, 4)), np.diag(rng.uniform(0.01, 0.1, 4))


@pytest.mark.parametrize("repeats", [1, 2, 5])
@pytest.mark.parametrize("seed", range(3))
def test_no_set_at_all_is_below_the_bound_and_the_best_is_near_it(seed, repeats):
    rows, tasks, known = task_rows(seed)
    found = choose(rows, 5, "task", tasks, known=known, repeats=repeats, bounded=True)
    sets = (
        combinations(range(11), 5) if repeats == 1 else combinations_with_replacement(range(11), 5)
    )
    every = np.array([some for some in sets if np.bincount(some).max() <= repeats])
    grams = np.swapaxes(rows, 1, 2) @ rows
    inverse = np.linalg.inv(grams[every].sum(1) + known)
    values = np.einsum("tmf,sfg,tmg->s", tasks, inverse, tasks) / len(tasks)
    assert 0.8 * values.min() < found.bound <= values.min() * (1 + 1e-9)
    assert found.value <= np.sort(values)[4] and np.bincount(found.chosen).max() <= repeats


@pytest.fixture(scope="module")
def cell():
    """Some 830 candidates anywhere, and 30 tasks within 6 deg of one pose."""
    made = scene("external-point", n=1030, reflectors={1: (30.0, -40.0, 100.0)})
    rng, columns = np.random.default_rng(3), dict(made.recording.columns)
    for k, middle in enumerate((10.0, 15, -10, 5, 45, 0), 1):
        columns[f"q{k}_deg"] = np.concatenate(
            [middle + rng.uniform(-6, 6, 30), columns[f"q{k}_deg"][30:]]
        )
    return exact(made, columns)


def exact(made, columns):
    """Tasks and candidates with the points that an arm of slightly other lengths and angles reaches."""
    recording = replace(made.recording, columns=columns, name="cell")
    start = bind(made.robot, made.recording).start
    chain = bind(made.robot, recording, start)
    model = Model(chain)
    free = model.parameters.free(*geometry_free(made.robot))
    off = np.random.default_rng(8).normal(0, 0.1, int(free.mask.sum())) * free.typical[free.mask]
    reached = recording.points.T + model.residual(free.unpack(free.pack() + off))
    columns = columns | dict(zip(("x_mm", "y_mm", "z_mm"), reached))
    recording, (low, high) = replace(recording, columns=columns), made.robot.limits.T
    inside = ((recording.joints > low) & (recording.joints < high)).all(1)
    return recording.select(np.arange(30)), recording.select(30 + np.flatnonzero(inside[30:]))


def measured(tasks, candidates, rows, rng):
    """(3, 30) mm errors at the exact tasks after a calibration on some candidates measured with noise."""
    columns = {
        key: np.concatenate([own[rows], tasks.columns[key]])
        for key, own in candidates.columns.items()
    }
    for key in ("x_mm", "y_mm", "z_mm"):
        columns[key][: len(rows)] += rng.normal(0, candidates.sigma_mm, len(rows))
    columns["sample"] = ids = np.arange(1.0, len(rows) + tasks.n + 1)
    both = replace(candidates, columns=columns)
    done = calibrate(
        both, [geometry(load_robot(both.robot))], ids[: len(rows)], ids[len(rows) :], folds=2
    )
    return done.held_out_residual[:, len(rows) :]


@pytest.mark.slow
def test_forty_for_a_cell_beat_eighty_random_ones_once_measured_and_err_as_predicted(cell):
    tasks, candidates = cell
    found = choose_poses(candidates, 40, "task", tasks, link_radius_mm=0)
    rows = np.searchsorted(candidates.sample_ids, found.samples)
    prediction, rng, squares = found.predicted(), np.random.default_rng(1), []
    for _ in range(80):
        random = rng.choice(candidates.n, 80, replace=False)
        squares.append(
            [(measured(tasks, candidates, some, rng) ** 2).sum(0).mean() for some in (rows, random)]
        )
    mine, twice = np.sqrt(np.mean(squares, 0))
    assert found.candidates == candidates.n and prediction["share_of_twice_beaten"] > 0.95
    assert mine < 0.95 * twice
    assert mine == pytest.approx(prediction["chosen_mm"], rel=0.12)
    assert twice == pytest.approx(prediction["random_twice_mm"], rel=0.12)


def test_a_pose_may_be_measured_again_where_asked(candidates, cell, tmp_path):
    tasks, anywhere = cell
    few = anywhere.select(np.arange(60))
    once, often = (
        choose_poses(few, 40, "task", tasks, link_radius_mm=0, repeats=k) for k in (1, 3)
    )
    counts = np.unique(often.samples, return_counts=True)[1]
    assert (
        1 < counts.max() <= 3
        and len(often.samples) == 40
        and often.design.value < once.design.value
    )
    assert once.predicted()["random_twice_mm"] is None
    lines = [
        line.split(",")[0] for line in write_poses(often, tmp_path).read_text().splitlines()[1:]
    ]
    assert sorted(map(float, lines)) == sorted(often.samples)
    assert choose_poses(candidates, 40, link_radius_mm=0).predicted() is None


def test_poses_without_tasks_say_which_option_predicts_an_error():
    from workbench.commands.robot.poses import _verdict

    assert _verdict({"predicted": None}, ()).sentence == (
        "No error is predicted; --criterion task --tasks predicts one."
    )


def test_candidates_that_are_alike_are_reported_as_such(cell):
    """All within the cell itself: which of them are taken matters little, and the bound says that no choice will do."""
    tasks, _ = cell
    prediction = choose_poses(tasks, 15, "task", tasks, link_radius_mm=0).predicted()
    assert (
        prediction["bound_mm"] > prediction["random_twice_mm"]
        and prediction["chosen_mm"] >= prediction["bound_mm"]
    )


def test_the_predicted_error_is_that_of_a_calibrations_covariance(cell):
    tasks, candidates = cell
    model = Model(bind(load_robot(candidates.robot), candidates))
    free = model.parameters.free("base.*", "tool.*", *geometry_free(model.chain.robot))
    free, _ = independent(normal_matrix(model, free), free)
    covariance = identifiability(normal_matrix(model, free), free).covariance
    at_tasks = Model(bind(model.chain.robot, tasks, model.chain.start))
    rows = at_tasks.linearise(at_tasks.parameters.only(free.mask))[1]
    expected = np.sqrt(np.einsum("fmt,fg,gmt->", rows, covariance, rows) / tasks.n)
    assert choose_poses(candidates, 40, "task", tasks, link_radius_mm=0).predicted()[
        "all_mm"
    ] == pytest.approx(expected)


def test_candidates_that_tell_nothing_or_must_all_be_taken_break_no_bound():
    rows, tasks, known = task_rows(0)
    rows[3:] = 0
    for n, repeats in ((5, 1), (11, 1), (7, 2), (5, 9)):
        found = choose(rows, n, "task", tasks, known=known, repeats=repeats, bounded=True)
        assert np.bincount(found.chosen).max() <= repeats and len(found.chosen) == n
        assert 0 < found.bound <= found.value * (1 + 1e-9)
    assert choose(rows, 11, "task", tasks, known=known, bounded=True).bound == pytest.approx(
        found.everything, rel=1e-3
    )


def test_a_refused_count_names_the_scene_and_the_reasons(tmp_path):
    from workbench.commands.robot.poses import _read

    scene_file = tmp_path / "cell.toml"
    scene_file.write_text(
        'robot = "abb_irb120"\nmeasures = "external-point"\nsamples = 20\n', encoding="utf-8"
    )
    candidates = _read(str(scene_file), False)
    assert candidates.name == str(scene_file)
    with pytest.raises(InputError, match=r"poses of .*cell\.toml that can be used \(excluded: "):
        choose_poses(candidates, 300)
