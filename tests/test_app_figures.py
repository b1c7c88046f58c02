"""Figures of the app without their page: needles, charts, the arm, and which of many samples are drawn."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from workbench.app.data import decimate
from workbench.app.data.arm import arm_pose, joint_coverage
from workbench.app.data.memo import Memo
from workbench.app.data.numbers import rows_of
from workbench.app.data.opened import open_subject
from workbench.app.data.sensor import camera_of
from workbench.app.figures import residuals, robot, style
from workbench.app.figures.arrows import CORNERS, corners, shafts
from workbench.app.workspace import Workspace


@pytest.fixture
def work(solved_arm, tmp_path):
    return Workspace(open_subject(str(solved_arm)), tmp_path / "session" / "session.toml")


def test_a_needle_is_wide_at_the_measured_point_and_pointed_at_the_predicted_one():
    rng = np.random.default_rng(4)
    points, vectors = rng.normal(0, 100, (2, 3, 50))
    vectors[:, 0], vectors[:, 1] = 0.0, (0.0, 0.0, 3.0)
    found = corners(points, vectors, 2.0).reshape(3, 50, CORNERS)
    assert np.allclose(found[:, :, 3], points + vectors)
    around = found[:, :, :3] - points[:, :, None]
    assert np.allclose(np.linalg.norm(around, axis=0), 2.0)
    assert np.allclose((around * vectors[:, :, None]).sum(axis=0), 0, atol=1e-9)
    drawn = shafts(*found.reshape(3, -1)).reshape(3, 50, 3)
    assert np.allclose(drawn[:, :, 0], points) and np.allclose(drawn[:, :, 1], points + vectors)
    assert np.isnan(drawn[:, :, 2]).all()


def test_arrows_of_a_large_run_are_few_triangles(work):
    needles = next(one for one in residuals.arrows(work).data if one.name == "residuals")
    assert needles.type == "mesh3d" and len(needles.i) == 4 * 300


def test_figures_hold_every_row_of_a_small_run(work):
    arrows = residuals.arrows(work)
    needles = next(one for one in arrows.data if one.name == "residuals")
    assert list(needles.customdata[::CORNERS]) == list(range(300))
    chart = residuals.chart(work, next(iter(work.quantities)), "")
    assert [len(one.x) for one in chart.data if one.name == "samples"] == [300]
    counts = {one.name: sum(one.y) for one in residuals.histogram_figure(work).data}
    assert counts["fit"] == counts["held out"] == 300


def test_excluded_samples_are_marked_and_not_counted(work):
    work.select(range(10))
    work.exclude_selected()
    name = next(iter(work.quantities))
    marks = {one["name"]: one for one in residuals.chart_marks(work, name, "").traces}
    assert marks["excluded"]["x"].tolist() == work.quantities[name][:10].tolist()
    assert marks["excluded"]["y"].tolist() == work.lengths()[:10].tolist()
    assert len(marks["selected"]["x"]) == 0
    assert sum(residuals.histogram_figure(work).data[0].y) == 290


def test_excluded_arrows_are_covered_from_their_point_to_their_tip(work):
    arrows = residuals.arrows(work)
    needles = next(one for one in arrows.data if one.name == "residuals")
    work.select([3, 7])
    work.exclude_selected()
    assert residuals.arrows(work).to_json() == arrows.to_json()  # the scene is not drawn again
    traces = residuals.arrow_marks(work).traces
    (ring,) = [one for one in traces if one.get("name") == "excluded"]
    assert np.allclose(ring["x"], work.opened.residuals.points[0, [3, 7]], atol=0.01)
    cover = next(one for one in traces if one.get("line", {}).get("color") == "white")
    tips = np.array([cover[axis] for axis in "xyz"]).reshape(3, -1, 3)[:, :, 1]
    drawn = np.array([needles.x, needles.y, needles.z]).reshape(3, -1, CORNERS)
    assert np.allclose(tips, drawn[:, [3, 7], 3], atol=0.01)


def test_the_arm_ends_at_the_flange_and_looks_at_the_measured_ball(work):
    for row in (0, 17):
        pose = arm_pose(work.opened, row)
        assert np.allclose(pose.links[:, -1], pose.flange[:3, 3])
        point = pose.sensor[:3, :3] @ work.opened.samples.points[row] + pose.sensor[:3, 3]
        # The nominal arm and the fitted hand-eye put it there up to the arm's own errors.
        assert np.linalg.norm(point - work.opened.residuals.points[:, row]) < 20


def test_the_scene_shows_arm_sensor_and_artefact(work):
    scene = robot.scene(work)
    names = {one.name for one in scene.data}
    assert {"arm at the current sample", "field of the sensor", "balls of the artefact"} <= names
    (balls,) = [one for one in scene.data if one.name == "balls of the artefact"]
    assert len(balls.x) == 4
    marks = {one["name"]: one for one in robot.scene_marks(work).traces}
    arm = np.array([marks["arm at the current sample"][axis] for axis in "xyz"])
    assert np.allclose(arm, arm_pose(work.opened, work.opened.rows[work.current]).links, atol=0.01)
    work.go_to(17)
    (moved,) = [one for one in robot.scene_marks(work).traces if one["name"] == "current sample"]
    assert np.allclose(
        [moved[axis][0] for axis in "xyz"], work.opened.residuals.points[:, 17], atol=0.01
    )


def test_coverage_counts_every_reading(work):
    rows = joint_coverage(work.opened)
    assert [row["counts"].sum() for row in rows] == [300] * 6
    assert all(row["limits"][0] <= row["low"] <= row["high"] <= row["limits"][1] for row in rows)


def test_decimation_keeps_the_largest_and_the_selected():
    values = np.random.default_rng(1).random(100_000)
    drawn = decimate.thinned(len(values), 1000, values, always=[7, 11])
    assert len(drawn) <= 1100 and {7, 11} <= set(drawn)
    assert set(np.argsort(values)[-500:]) <= set(drawn)
    assert decimate.thinned(50, 1000).tolist() == list(range(50))


def test_histograms_count_all_samples_whatever_is_drawn():
    values = {"fit": np.random.default_rng(2).random(10_000), "held_out": np.full(10_000, np.nan)}
    counted = decimate.histogram(values)
    assert counted.counts["fit"].sum() == 10_000 and counted.counts["held_out"].sum() == 0


@pytest.mark.parametrize("left_out", [[], [0], [9, 8, 8], [3, 9], list(range(10)), [1, 2, 2, 5]])
def test_a_histogram_without_some_values_is_that_of_the_others(left_out):
    rng = np.random.default_rng(3)
    many = np.append(rng.random(500), [3.0, 3.0, np.nan])
    rows = np.argsort(many)[
        [-2 - k for k in sorted(set(left_out))]
    ]  # the largest first; nan is last
    rows = np.append(rows, len(many) - 1) if 9 in left_out else rows
    kept = np.delete(many, rows)
    values = {"fit": many, "held_out": 2 * many}
    ordered = {kind: np.sort(row[np.isfinite(row)]) for kind, row in values.items()}
    found = decimate.histogram_without(ordered, {kind: row[rows] for kind, row in values.items()})
    expected = decimate.histogram({"fit": kept, "held_out": 2 * kept})
    assert np.allclose(found.edges, expected.edges)
    for kind, counts in expected.counts.items():
        assert found.counts[kind].tolist() == counts.tolist()


def test_a_histogram_without_all_values_is_empty():
    found = decimate.histogram_without({"fit": np.arange(9.0)}, {"fit": np.arange(9.0)[::-1]})
    assert found.counts["fit"].sum() == 0 and np.isfinite(found.edges).all()


@pytest.mark.parametrize("share", [0.1, 0.7])
def test_counts_and_means_leave_out_what_is_excluded(work, share):
    rows = np.random.default_rng(5).permutation(300)[: int(share * 300)]
    work.select(rows)
    work.exclude_selected()
    kept = np.delete(np.arange(300), rows)
    assert work.excluded_rows.tolist() == sorted(rows.tolist())
    counted = work.counts(["fit", "held_out"])
    expected = decimate.histogram({kind: work.lengths(kind)[kept] for kind in counted.counts})
    assert all((counted.counts[kind] == expected.counts[kind]).all() for kind in counted.counts)
    name = next(iter(work.quantities))
    place, x, y = decimate.bins_of(work.quantities[name]), work.quantities[name], work.lengths()
    centres, means = work.means(name)
    filled = [k for k in range(place.max() + 1) if (place[kept] == k).any()]
    assert np.allclose(centres, [x[kept][place[kept] == k].mean() for k in filled])
    assert np.allclose(means, [y[kept][place[kept] == k].mean() for k in filled])


def test_rows_are_found_by_number_in_any_order():
    for ids in (np.array([2, 4, 9, 30]), np.array([30, 2, 9, 4]), np.zeros(0, int)):
        wanted = np.array([9, 3, 30, 99, 2])
        rows, is_there = rows_of(ids, wanted)
        assert is_there.tolist() == [number in ids for number in wanted]
        assert ids[rows[is_there]].tolist() == wanted[is_there].tolist()


def test_a_memo_keeps_the_latest_results():
    memo, made = Memo(2), []
    for key in ("a", "b", "a", "c", "b", "a"):
        memo.get((key,), partial(made.append, key))
    assert made == ["a", "b", "c", "a"]


def test_bin_means_are_those_of_all_samples():
    x = np.repeat(np.arange(4.0), 100)
    y = x**2
    centres, means = decimate.bin_means(x, y)
    assert np.allclose(means, centres**2)
    assert decimate.bin_means(np.full(5, np.nan), np.ones(5))[0].size == 0


def test_a_rectangle_holds_its_edges_in_any_order():
    x = y = np.arange(5.0)
    assert decimate.is_within_ranges(x, y, (3, 1), (1, 9)).tolist() == [
        False,
        True,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize("high", [(100, 100, 900), (900, 900, 100), (1000, 20, 20)])
def test_a_framed_scene_fits_the_default_view_with_equal_scales(high):
    made = style.framed(style.space("any"), (0, 0, 0), high)
    ratio = np.array([made.layout.scene.aspectratio[axis] for axis in "xyz"])
    assert np.linalg.norm(ratio) <= 1.61 and ratio[2] <= 1.2
    shares = np.array(high) / max(high)
    assert np.allclose(ratio / ratio.max(), np.maximum(shares, 0.05 / ratio.max()))
    ticks = [made.layout.scene[f"{axis}axis"].nticks for axis in "xyz"]
    assert max(ticks) == 6 and min(ticks) >= 2


def test_the_camera_of_a_hand_eye_calibration_is_read_from_its_answer(tmp_path):
    keys = {
        "fx_px": 750.0,
        "fy_px": 749.0,
        "cx_px": 240.0,
        "cy_px": 188.0,
        "distortion": [-0.15, 0.16, 0.0, 0.0, -0.4],
        "width_px": 480,
        "height_px": 384,
    }
    answers = ({"camera": keys}, {"camera": None}, {}, None)
    runs = [SimpleNamespace(folder=tmp_path, answer=answer) for answer in answers]
    found = [camera_of(run) for run in runs]
    assert (found[0].fx, found[0].cy, tuple(found[0].size)) == (750.0, 188.0, (480, 384))
    assert found[1:] == [None, None, None]
