"""The report page: complete, self-contained, and true to the calibration that it shows."""

import json
import logging
import re
from types import SimpleNamespace

import numpy as np
import pytest

from datasets.recording import Recording
from robot_model import load_robot
from workbench.report import provenance, text
from workbench.report.calibration import errors as spread
from workbench.report.calibration import (
    history,
    parameters,
    residuals,
    scene,
    stages,
    summary_image,
)
from workbench.report.page import write_report

SECTIONS = ("stages", "spread", "parameters", "residuals", "scene", "history", "provenance")


def stage(name, held_out, earned=True, history=(900.0, 40.0, 12.0)):
    return SimpleNamespace(
        name=name,
        why=f"why {name} <is> there",
        free=30,
        identifiable=28,
        rms_mm=0.9 * held_out,
        held_out_rms_mm=held_out,
        earned=earned,
        outcome="converged: nothing moves",
        sentence=f"{name}: held-out {held_out} mm",
        history=history,
    )


def parameter(name, where, value, unit="mm", **more):
    row = {
        "name": name,
        "where": where,
        "value": value,
        "unit": unit,
        "std": 0.004,
        "nominal": 0.0,
        "identifiable": True,
        "tied_to": [],
        "free": True,
        "label": f"{where}'s {name}",
        "why": "",
        "status": "estimated",
        **more,
    }
    return row | {"deviation": None if where == "base" else value - row["nominal"]}


PARAMETERS = (
    parameter("x", "base", 1200.5),
    parameter("theta3", "joint-3", 0.0021, "rad", std=1.2e-5),
    parameter(
        "d3",
        "joint-3",
        0.013,
        identifiable=False,
        std=None,
        tied_to=["d2"],
        status="not identifiable",
    ),
    parameter("a3", "joint-3", 270.4, nominal=270.0, std=0.011),
    parameter(
        "beta3",
        "joint-3",
        0.0,
        "rad",
        free=False,
        std=None,
        why="held at its nominal value by the plan",
        identifiable=False,
        status="held",
    ),
    parameter("bending", "link-2", 3.1e-5, "rad/(N m)", std=2e-6),
)


def summary(residual, **more):
    distance = np.linalg.norm(residual[:, np.isfinite(residual).all(0)], axis=0)
    return {
        "rms_mm": float(np.sqrt(np.mean(distance**2))),
        "mean_mm": float(distance.mean()),
        "p95_mm": float(np.percentile(distance, 95)),
        "max_mm": float(distance.max()),
        **more,
    }


def _columns(q, points):
    n = len(q)
    columns = {f"q{k + 1}_deg": q[:, k] for k in range(6)} | dict(
        zip(("x_mm", "y_mm", "z_mm"), points)
    )
    columns |= {
        "time_s": np.arange(n) * 2.5,
        "payload_kg": np.full(n, 1.5),
        "pose": np.repeat(np.arange(n // 2), 2) * 1.0,
    }
    return columns


STIFFNESS = {
    "where": "joint-2",
    "known_from": "recorded loads",
    "value": 4e-5,
    "std": 2e-6,
    "unit": "rad/(N m)",
    "clear": True,
    "stiffness": 24912.3,
    "stiffness_std": 1123.4,
    "centre_per_mm": 0.012,
    "load_centre_mm": (0.0, 0.0, 60.0),
}


def fake(n=240, sigma=0.02, points=None, seed=5):
    """What `workbench.jobs.robot.calibrate` returns, with joint 3 still wrong by a sine and one row never held out."""
    random = np.random.default_rng(seed)
    q = random.uniform(-80, 80, (n, 6))
    residual = random.normal(0, 0.02, (3, n)) + np.outer(
        [0.04, -0.02, 0], np.sin(np.deg2rad(4 * q[:, 2]))
    )
    held_out = np.where(np.arange(n) == 0, np.nan, residual)
    points = (
        random.normal(0, 250, (3, n)) + np.array([[300], [0], [600]]) if points is None else points
    )
    columns = _columns(q, points)
    recording = Recording(
        "external-point",
        columns,
        {"builtin": "abb_irb120"},
        title="A </script> & B",
        sigma_mm=sigma,
        name="fake",
        source="made for a test",
    )
    nominal = 10 * residual
    return SimpleNamespace(
        recording=recording,
        robot=load_robot("abb_irb120"),
        parameters=PARAMETERS,
        solution=SimpleNamespace(
            null_sentences=("joint 3's d and joint 2's d are one here",),
            converged=True,
            outcome="converged: another step would move nothing",
        ),
        stages=(
            stage("geometry", 0.3),
            stage("transmission", 0.31, earned=False),
            stage("compliance", 0.05),
        ),
        fit=summary(residual),
        held_out=summary(held_out, folds=10),
        nominal=summary(nominal),
        fit_residual=residual,
        held_out_residual=held_out,
        nominal_residual=nominal,
        fold=np.arange(n) % 10,
        points=points,
        residual_in_root=residual,
        suspects=(17,),
        warnings=(),
        provenance={"seed": 1, "versions": {"numpy": "2"}, "command": "calibrate fake"},
        rotation={},
        stiffness=[STIFFNESS],
    )


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    path = write_report(fake(), folder)
    return path, path.read_text(encoding="utf-8")


def own_text(page):
    """The page without the library in it."""
    return re.sub(r"<script>.*?</script>", "", page, flags=re.S)


def figures(page):
    found = re.findall(
        r'<script type="application/json" data-for="(\w+)">(.*?)</script>', page, flags=re.S
    )
    return {name: json.loads(data) for name, data in found}


def test_page_and_image_stand_in_the_folder_and_nothing_else_does(written):
    path, _ = written
    assert sorted(p.name for p in path.parent.iterdir()) == ["report.html", "summary.png"]
    assert (path.parent / "summary.png").read_bytes().startswith(b"\x89PNG")


def test_page_loads_nothing_from_the_network(written):
    page = own_text(written[1])
    assert not re.search(r"<script[^>]+src=|<link[^>]+href=\"http|@import|url\(", page)
    assert page.count("https://") == 0 and page.count("http://") == 0


def test_library_is_there_once(written):
    assert len(re.findall(r"\* plotly\.js v", written[1])) == 1


def test_every_section_and_its_figures_are_there(written):
    page = written[1]
    assert all(f'<section id="{name}">' in page for name in SECTIONS)
    assert set(figures(page)) == {
        "chart",
        "histogram",
        "cumulative",
        "overview",
        "detail",
        "space",
        "walk",
    }
    assert all(figure["data"] for figure in figures(page).values())


def test_every_axis_has_a_title_with_its_unit(written):
    for name in ("chart", "histogram", "cumulative", "detail"):
        titles = [
            axis.get("title", {}).get("text", "")
            for key, axis in figures(written[1])[name]["layout"].items()
            if key.startswith("xaxis")
        ]
        assert re.search(r"\((mm|deg|s|mm, logarithmic|row number)\)", titles[-1]), (name, titles)


def test_headline_says_the_held_out_numbers_poses_and_folds(written):
    page, made = own_text(written[1]), fake()
    assert f"<dd>{text.rounded(made.held_out['rms_mm'])}<span> mm</span></dd>" in page
    assert "239 samples in 120 poses" in page and "10 folds" in page and "3-D distance" in page


def test_text_of_a_recording_cannot_become_markup(written):
    assert "A </script> & B" not in written[1] and "A &lt;/script&gt; &amp; B" in written[1]
    assert "Why geometry &lt;is&gt; there" in written[1]


def test_stage_that_is_not_retained_is_grey_and_named(written):
    made = stages.chart(fake())
    grey = [trace for trace in made.data if trace.name == "held out, not retained"]
    assert list(grey[0].y) == ["transmission"] and list(grey[0].x) == [0.31]
    assert "1 stage is not retained" in written[1] and "<small>not retained</small>" in written[1]


def test_retention_of_all_stages_is_stated():
    assert stages.left_out([stage("geometry", 0.3)]).startswith("Every stage lowers")


def test_solve_that_did_not_converge_is_a_warning(tmp_path):
    made = fake()
    made.solution = SimpleNamespace(
        null_sentences=(), converged=False, outcome="did not converge: allow more steps"
    )
    page = own_text(write_report(made, tmp_path).read_text(encoding="utf-8"))
    assert '<p class="warning">The solver did not converge: allow more steps.</p>' in page


def test_the_page_has_the_stiffness_of_the_joints(written):
    assert "<td>24,900 ± 1,100 N m/rad</td><td>12 %</td>" in written[1]
    assert (
        "holds for a load whose centre is at 0, 0, 60 mm in the flange frame (<code>com_mm</code>"
        in written[1]
    )


def test_parameters_are_shown_in_degrees_to_two_digits_of_their_sigma():
    row = parameters.row(PARAMETERS[1])
    assert (row["unit"], row["std"], row["value"]) == ("deg", "0.00069", "0.12032")


def test_small_compliances_are_shown_in_micro():
    row = parameters.row(PARAMETERS[5])
    assert (row["unit"], row["value"], row["std"], row["sigmas"]) == (
        "µrad/(N m)",
        "31.0",
        "2.0",
        "16",
    )


def test_undetermined_parameter_has_no_sigma_and_says_with_what_it_is_tied():
    row = parameters.row(PARAMETERS[2])
    assert (
        row["std"] == "–"
        and row["sigmas"] == "–"
        and row["state"] == "Not identifiable: tied to d2."
    )


def test_held_parameter_says_why():
    assert parameters.row(PARAMETERS[4])["state"] == "Held at its nominal value by the plan."


def test_base_pose_has_no_nominal():
    row = parameters.row(PARAMETERS[0])
    assert row["nominal"] == "–" and row["change"] == "–"


def test_noise_sentence_compares_with_the_rms_of_noise_in_three_directions():
    words = spread.noise_sentence(0.02, {"rms_mm": 2 * np.sqrt(3) * 0.02})
    assert "0.0346 mm" in words and "2.00 times" in words


def test_recording_without_sigma_says_so(tmp_path):
    page = write_report(fake(sigma=None), tmp_path).read_text(encoding="utf-8")
    assert "states no noise" in page and "noise alone" not in json.dumps(
        figures(page)["cumulative"]
    )


def test_joint_that_the_residual_depends_on_is_named():
    made = fake()
    found = residuals.section(made, spread.errors_of(made))
    assert found["kinds"][0]["most"].startswith("joint 3 (deg)") and found["constant"] == [
        "payload (kg)"
    ]
    assert (
        found["menu"][:6] == [f"joint {k} (deg)" for k in range(1, 7)]
        and "time (s)" in found["menu"]
    )


def test_share_of_variance_is_that_which_was_put_in_and_nothing_on_noise():
    random = np.random.default_rng(3)
    x, noise = random.uniform(-1, 1, 6000), random.normal(0, 1, (3, 6000))
    step = np.where(x > 0, 1.0, -1.0)
    dependent = spread.Errors(noise + step, np.ones(6000, bool), None)
    assert residuals.bin_residuals("x", x, dependent).share == pytest.approx(0.5, abs=0.02)
    assert (
        residuals.bin_residuals("x", x, spread.Errors(noise, np.ones(6000, bool), None)).share
        < 0.005
    )


def test_row_never_held_out_shows_its_fit_residual():
    errors = spread.errors_of(fake())
    assert (
        errors.is_held_out.sum() == 239
        and not errors.is_held_out[0]
        and np.isfinite(errors.residual).all()
    )


def test_more_than_five_thousand_points_are_thinned_and_the_page_says_so(tmp_path):
    page = write_report(fake(n=6000), tmp_path).read_text(encoding="utf-8")
    menu = json.loads(re.search(r'id="against">(.*?)</script>', page, flags=re.S)[1])
    assert {len(entry["x"]) for entry in menu} == {5000}
    assert page.count("5,000 of 6,000 samples are drawn") == 2


def test_arrows_are_the_residual_times_the_stated_scale():
    made = fake()
    found = scene.scene_of(made)
    assert np.allclose(found.tips - found.feet, found.scale * made.residual_in_root)
    assert f"{found.scale:,.0f}" == scene.section(made, spread.errors_of(made))["scale"]
    mantissa = float(f"{found.scale:e}".split("e")[0])
    assert mantissa in (1.0, 2.0, 5.0)


def test_arrows_have_the_colours_of_their_points():
    made = fake()
    errors = spread.errors_of(made)
    arrows, points = scene.figure(scene.scene_of(made), errors).data[:2]
    assert np.array_equal(np.asarray(arrows.line.color)[::3], np.asarray(points.marker.color))
    assert (arrows.line.cmin, arrows.line.cmax) == (points.marker.cmin, points.marker.cmax)
    assert arrows.line.colorscale == points.marker.colorscale


def test_arm_of_the_scene_has_the_nominal_reach():
    lengths = np.linalg.norm(np.diff(scene.scene_of(fake()).links, axis=1), axis=0)
    assert lengths[0] == pytest.approx(290) and lengths[1] == pytest.approx(270)


def test_one_ball_in_the_world_hangs_the_arrows_on_the_flange(tmp_path):
    found = scene.scene_of(fake(points=np.full((3, 240), 400.0)))
    assert "flange" in found.anchor and np.ptp(found.feet, axis=1).max() > 200


def test_history_goes_on_from_stage_to_stage():
    made = history.figure(fake().stages)
    assert [list(trace.x) for trace in made.data] == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]


def test_provenance_shows_nested_tables_flat():
    assert provenance.flat({"versions": {"numpy": "2"}, "seed": 1}) == [
        ("versions: numpy", "2"),
        ("seed", "1"),
    ]


def test_page_is_complete_where_the_image_cannot_be_drawn(tmp_path, monkeypatch, caplog):
    def no_library(*_):
        raise ImportError("No module named 'matplotlib'")

    monkeypatch.setattr(summary_image, "draw_summary", no_library)
    with caplog.at_level(logging.WARNING):
        path = write_report(fake(), tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name] and "was not drawn:" in caplog.text


@pytest.mark.parametrize(
    "value, shown",
    [
        (0.06843, "0.0684"),
        (1.234, "1.23"),
        (0.0, "0"),
        (-12.5, "−12.5"),
        (None, "–"),
        (float("nan"), "–"),
        (3.14e-6, "3.14·10⁻⁶"),
        (1234.6, "1235"),
    ],
)
def test_numbers_are_shown_with_three_digits(value, shown):
    assert text.rounded(value) == shown


def test_long_list_of_ties_is_cut_and_says_how_much():
    keys = [f"joint-{k}.a{k}" for k in range(1, 8)]
    tied = parameter(
        "d3",
        "joint-3",
        0.01,
        identifiable=False,
        std=None,
        tied_to=keys,
        why="not identifiable: confounded with " + ", ".join(keys),
    )
    assert parameters.row(tied)["state"].endswith(
        "with joint-1.a1, joint-2.a2, joint-3.a3, joint-4.a4 and 3 more."
    )
    words = "a is confounded with " + ", ".join("bcdefghijklm") + " and n"
    assert (
        parameters.shortened(words)
        == "a is confounded with b, c, d, e, f, g, h, i and 5 more (listed in the JSON)"
    )


def test_verdict_and_warnings_of_the_terminal_are_on_the_page(tmp_path):
    made = fake()
    made.warnings = (
        "samples.csv: the zero of joint 3 has moved; find it with `workbench diagnose`",
    )
    verdict = "Held-out RMS position error 0.18 mm; it is 5.1 times the noise."
    page = own_text(write_report(made, tmp_path, verdict=verdict).read_text(encoding="utf-8"))
    header = page[: page.index("<nav>")]
    assert verdict in header
    assert (
        '<p class="warning">Warning: samples.csv: the zero of joint 3 has moved; find it with '
        "<code>workbench diagnose</code>.</p>"
    ) in header
