"""Figures of the app without their page: needles, charts, the arm, and which of many samples are drawn."""

from types import SimpleNamespace

import numpy as np
import pytest

from workbench.app.data import decimate
from workbench.app.data.arm import arm_pose, joint_coverage
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


def test_the_arm_ends_at_the_flange_and_looks_at_the_measured_ball(work):
    for row in (0, 17):
        pose = arm_pose(work.opened, row)
        assert np.allclose(pose.links[:, -1], pose.flange[:3, 3])
        point = pose.sensor[:3, :3] @ work.opened.samples.points[row] + pose.sensor[:3, 3]
        # The nominal arm and the fitted hand-eye put it there up to the arm's own errors.
        assert np.linalg.norm(point - work.opened.residuals.points[:, row]) < 20


def test_the_scene_shows_arm_sensor_and_artefact(work):
    names = {one.name for one in robot.scene(work).data}
    assert {"arm at the current sample", "field of the sensor", "balls of the artefact"} <= names


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


def test_bin_means_are_those_of_all_samples():
    x = np.repeat(np.arange(4.0), 100)
    y = x**2
    centres, means = decimate.bin_means(x, y)
    assert np.allclose(means, centres**2)
    assert decimate.bin_means(np.full(5, np.nan), np.ones(5))[0].size == 0


def test_a_rectangle_holds_its_edges_in_any_order():
    x = y = np.arange(5.0)
    assert decimate.within(x, y, (3, 1), (1, 9)).tolist() == [False, True, True, True, False]


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
