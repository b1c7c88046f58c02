"""Report pages can be read: images with overlays, legends clear of curves, p-values, tables at 800 px."""

import base64
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import datasets
from app_access import CONTRAST
from workbench.core.solution import Stage
from workbench.report import style
from workbench.report.calibration import summary_image
from workbench.report.calibration.errors import errors_of
from workbench.report.calibration.parameters import _number
from workbench.report.calibration.residuals import (
    bin_residuals,
    group_ticks,
    overview,
    quantities,
)
from workbench.report.diagnosis import figures
from workbench.report.diagnosis.figures import covariate_name
from workbench.report.diagnosis.summary_image import _spread
from workbench.report.page import marked, write_report, write_sheet
from workbench.report.sensor.overlays import overlay, overlays
from workbench.report.text import column_label, joint_label, p_value, rounded

STAGES = (
    Stage("geometry", "lengths", free=("base.*", "sensor.*", "joint-*.theta*"), earn=False),
    Stage("compliance", "joints deflect", (("joint-compliance", "joint-2", {}),)),
)


@pytest.fixture(scope="module")
def calibration():
    from workbench.jobs.robot.calibrate import calibrate

    return calibrate(datasets.read("elastic-arm"), STAGES, folds=2)


def _overlaps(figure) -> list[str]:
    """Titles of plots whose legend covers a part of the plot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure).draw()
    found = []
    for axes in figure.axes:
        legend = axes.get_legend()
        if legend is not None and legend.get_window_extent().overlaps(axes.get_window_extent()):
            found.append(axes.get_title())
    return found


def test_no_legend_of_the_summary_covers_a_curve(calibration):
    assert _overlaps(summary_image.draw_summary(calibration, errors_of(calibration))) == []


def test_the_names_of_stages_are_inside_the_summary(calibration):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    stages = [replace(stage, name="transmission and compliance") for stage in calibration.stages]
    figure = summary_image.draw_summary(
        replace(calibration, stages=tuple(stages)), errors_of(calibration)
    )
    FigureCanvasAgg(figure).draw()
    for label in figure.axes[0].get_yticklabels():
        assert label.get_window_extent().x0 > 0, label.get_text()


@pytest.mark.parametrize("entries", [1, 3, 4, 12])
def test_a_legend_above_a_plot_is_clear_of_plot_and_title(entries):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 4))
    axes = figure.add_axes((0.15, 0.15, 0.8, 0.55))
    axes.set_title("title")
    for k in range(entries):
        axes.plot([0, 1], [0, k], label=f"curve {k}")
    style.legend_above(axes)
    assert _overlaps(figure) == []
    assert not axes.get_legend().get_window_extent().overlaps(axes.title.get_window_extent())


def test_p_values_below_a_millionth_are_not_written_out_in_sentences():
    from workbench.core.least_squares.adjustment_tests import p_text

    assert p_text(3e-9) == "p < 1e-6" and p_text(0.012) == "p = 0.012"


def test_p_values_below_a_millionth_are_not_written_out():
    assert p_value(0.0) == p_value(9.99e-7) == "< 1e-6"
    assert p_value(1e-6) != "< 1e-6" and p_value(0.25) == "0.25"


def test_named_groups_stand_at_the_axis_by_their_names():
    names = {"reflector": ("left", "right")}
    assert group_ticks("reflector (number)", np.array([1.0, 2.0, 3.0]), names) == [
        "left",
        "right",
        "3",
    ]
    assert group_ticks("ball (number)", np.array([1.0]), names) == ["1"]


def test_the_overview_names_groups(calibration):
    from dataclasses import replace

    errors = errors_of(calibration)
    found = [pair for pair in quantities(calibration.recording) if pair[0] == "ball (number)"]
    every = [bin_residuals(label, x, errors) for label, x in found]
    named = replace(calibration.recording, group_names={"ball": ("A", "B", "C", "D")})
    assert list(overview(every, errors, named.group_names).layout.xaxis.ticktext) == [
        "A",
        "B",
        "C",
        "D",
    ]


def test_axes_of_covariates_state_their_units():
    from workbench.report.diagnosis.figures import shown_covariate

    covariates = {"time": np.arange(3.0), "time_s": np.arange(3.0), "temperature_c": np.ones(3)}
    assert shown_covariate("time", covariates)[1] == "time (s)"
    assert shown_covariate("temperature_c", covariates)[1].endswith("(°C)")
    assert shown_covariate("time", {"time": np.arange(3.0)})[1] == "row number"


def test_a_column_is_titled_by_quantity_and_unit():
    from workbench.report.text import covariate_label

    titles = {
        "time_s": "time (s)",
        "payload_kg": "payload (kg)",
        "temperature_c": "temperature (°C)",
        "temperature_j2_c": "temperature of joint 2 (°C)",
        "temperature_artefact_c": "temperature of the artefact (°C)",
        "approach3": "direction of approach of joint 3",
        "tau2": "gravity torque of joint 2",
        "my_own_column": "my own column",
    }
    assert {name: covariate_label(name) for name in titles} == titles


def test_names_of_columns_in_a_text_are_quantities():
    from workbench.report.text import with_labels

    titles = {
        "noise-heteroscedastic, with range_mm the noise": "noise-heteroscedastic, with range (mm) the noise",
        "with temperature_j2_c and q3_deg": "with temperature of joint 2 (°C) and joint 3 (deg)",
        "joint-curve of 7 terms": "joint-curve of 7 terms",
    }
    assert {text: with_labels(text) for text in titles} == titles


@pytest.mark.parametrize(
    ("name", "path", "unit", "label"),
    [
        (
            "compliance_2",
            "scene.effect.1.values.compliance",
            "rad/(N m)",
            "compliance 2 (rad/(N m))",
        ),
        ("noise", "scene.sigma_mm", "", "noise (mm)"),
        ("sigma_mm", "scene.sigma_mm", "", "sigma (mm)"),
        ("warmest", "scene.temperature_c.2", "", "warmest (°C)"),
        ("boards", "scene.placements.count", "", "boards"),
    ],
)
def test_axes_of_a_study_have_the_unit_that_is_stated_or_at_the_end_of_a_name(
    name, path, unit, label
):
    from workbench.report.text import axis_label
    from workbench.studies.spec import Axis

    assert axis_label(Axis(name=name, path=path, unit=unit, values=[1.0, 2.0])) == label


def test_small_numbers_are_powers_of_ten():
    from workbench.explanation.sentences.words import measured

    assert measured(-3.39e-5, None, "") == "−3.39·10⁻⁵"
    assert measured(0.012, None, "rad") == "12 mrad"


def test_instants_have_a_unit_or_are_numbers_of_rows():
    from workbench.core.covariates import instant_format

    clocked = SimpleNamespace(covariates={"time_s": np.arange(3.0)})
    assert instant_format(clocked).format(3104.35) == "3104.35 s"
    assert instant_format(SimpleNamespace(covariates={})).format(12.0) == "row 12"


@pytest.fixture
def camera_run(tmp_path):
    """Two grey images with four corners each; those of the second are three times as far off."""
    import cv2

    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), np.full((120, 160), 60, np.uint8))
    corners = np.array([[30.0, 120, 30, 120], [30.0, 30, 90, 90]])
    residual = np.tile([[0.1], [0.0]], 8)
    residual[:, 4:] *= 3
    made = SimpleNamespace(
        camera=SimpleNamespace(size=(160, 120)),
        residual=residual,
        view=np.repeat([0, 1], 4),
        view_rms_px=np.array([0.1, 0.3]),
        views=[SimpleNamespace(image="a.png"), SimpleNamespace(image="b.png")],
        chain=SimpleNamespace(pixels=np.hstack([corners, corners])),
    )
    return SimpleNamespace(calibration=made, recording=SimpleNamespace(folder=tmp_path))


def _decoded(source: str) -> np.ndarray:
    import cv2

    code = base64.b64decode(source.removeprefix("data:image/jpeg;base64,"))
    return cv2.imdecode(np.frombuffer(code, np.uint8), cv2.IMREAD_COLOR)


def test_images_with_the_largest_errors_come_first_with_their_corners(camera_run):
    found = overlays(camera_run)
    assert [caption.partition(":")[0] for _, caption in found] == ["b.png", "a.png"]
    image = _decoded(found[0][0]).astype(int)
    coloured = np.abs(image[..., 2] - image[..., 0]) > 60
    assert coloured[20:40, 20:60].any() and not coloured[50:70, 60:100].any()


def test_an_arrow_is_as_long_as_the_caption_says(camera_run):
    image = _decoded(
        overlay(
            camera_run.recording.folder / "a.png",
            np.array([[40.0], [60]]),
            np.array([[0.5], [0]]),
            100,
        )
    )
    magenta = (image[..., 0].astype(int) > 120) & (image[..., 1] < 120)
    columns = np.flatnonzero(magenta.any(0))
    assert columns.max() == pytest.approx(90, abs=3)


def test_an_image_that_is_gone_is_left_out(camera_run):
    (camera_run.recording.folder / "b.png").unlink()
    assert overlays(camera_run)[0][0] == ""


@pytest.fixture
def narrow_page(browser, calibration, tmp_path):
    """The report of an arm in a window of 800 px, all groups of its tables unfolded."""
    page = browser.new_page(viewport={"width": 800, "height": 900})
    page.goto(write_report(calibration, tmp_path).as_uri())
    page.evaluate(
        "() => document.querySelectorAll('details').forEach((one) => { one.open = true; })"
    )
    assert page.locator("table").count() > 3
    yield page
    page.close()


@pytest.mark.slow
def test_no_table_is_clipped_at_800_px(narrow_page):
    clipped = narrow_page.evaluate(
        "() => [...document.querySelectorAll('.wide')].filter((one) => one.scrollWidth > one.clientWidth + 1)"
        ".map((one) => one.innerText.slice(0, 60))"
    )
    assert clipped == []


@pytest.mark.slow
def test_no_name_in_a_table_is_broken_within_a_word_at_800_px(narrow_page):
    """Each word of a name stands in one line; a name may break behind a hyphen or a point."""
    broken = narrow_page.evaluate(
        """() => [...document.querySelectorAll('.stages th, .plain th, .grid th, .values th')].filter((cell) =>
            [...cell.childNodes].filter((one) => one.nodeType === Node.TEXT_NODE).some((name) =>
                [...name.textContent.matchAll(/[^\\s.-]+/g)].some((word) => {
                    const range = document.createRange();
                    range.setStart(name, word.index);
                    range.setEnd(name, word.index + word[0].length);
                    return new Set([...range.getClientRects()].map((one) => Math.round(one.top))).size > 1;
                }))).map((cell) => cell.innerText)"""
    )
    assert broken == []


@pytest.mark.slow
def test_no_number_in_a_table_is_broken_or_cut_at_800_px(narrow_page):
    broken = narrow_page.evaluate(
        """() => [...document.querySelectorAll('td')].filter((cell) => {
            if (cell.scrollWidth > cell.clientWidth + 1) return true;
            if (!cell.classList.contains('n') || !cell.firstChild) return false;
            const range = document.createRange();
            range.selectNodeContents(cell);
            return new Set([...range.getClientRects()].map((one) => Math.round(one.top))).size > 1;
        }).map((cell) => cell.innerText)"""
    )
    assert broken == []


_INKS = """() => [...new Set([...document.querySelectorAll('.js-plotly-plot text')]
    .filter((one) => one.textContent.trim() && getComputedStyle(one).visibility !== 'hidden')
    .map((one) => getComputedStyle(one).fill))]"""
_LABELS = """(inks) => {
    const box = document.createElement('div');
    for (const ink of inks) {
        const line = document.createElement('p');
        line.textContent = `label in ${ink}`;
        line.style.color = ink;
        box.appendChild(line);
    }
    document.querySelector('main').appendChild(box);
}"""
"""Writes a line in each colour of the labels of figures, so that its contrast is measured like that of other texts."""


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_has_a_contrast_of_at_least_4_5(browser, calibration, tmp_path, scheme):
    page = browser.new_page(viewport={"width": 1280, "height": 900}, color_scheme=scheme)
    page.goto(write_report(calibration, tmp_path).as_uri())
    page.wait_for_function("() => document.querySelectorAll('.js-plotly-plot text').length > 100")
    inks = page.evaluate(_INKS)
    assert inks
    page.evaluate(_LABELS, inks)
    assert page.evaluate(CONTRAST) == []
    page.close()


@pytest.mark.slow
def test_all_numbers_of_the_headline_stand_in_one_row_at_800_px(narrow_page):
    tops = narrow_page.evaluate(
        "() => [...document.querySelectorAll('.numbers dd')].map((one) => one.getBoundingClientRect().bottom)"
    )
    assert len(tops) == 4 and max(tops) - min(tops) < 20


def test_words_between_backticks_are_set_as_code_and_markup_of_the_data_is_not():
    assert marked("Enough for `workbench <x>`, 5 > 4.") == (
        "Enough for <code>workbench &lt;x&gt;</code>, 5 &gt; 4."
    )
    assert marked("a ` alone & <b>") == "a ` alone &amp; &lt;b&gt;"


def test_joints_and_columns_have_names_and_units():
    assert [joint_label(name) for name in ("q1_deg", "q12_mm", "q3", "rail")] == [
        "joint 1 (deg)",
        "joint 12 (mm)",
        "joint 3",
        "rail",
    ]
    assert column_label("geometry_test_3kg_mm") == "geometry test 3kg (mm)"
    assert column_label("compliance_2") == "compliance 2"


def test_a_value_that_is_rounded_up_keeps_its_digits():
    assert [rounded(value) for value in (0.0999999, 0.1, 9.9996, -0.99999)] == [
        "0.100",
        "0.100",
        "10.0",
        "−1.00",
    ]


def test_rounding_in_the_file_of_a_robot_is_zero():
    assert _number(1.77636e-14, None) == _number(-2.8e-10, None) == "0"
    assert _number(2e-5, None) == "2e−05"


def test_a_move_and_its_direction_have_different_names():
    names = {covariate_name(name) for name in ("move1", "move1_side")}
    assert len(names) == 2 and all("joint 1" in name for name in names)


@pytest.mark.slow
def test_the_wheel_scrolls_the_page_and_buttons_zoom_a_scene(narrow_page):
    scene = narrow_page.locator("#space")
    scene.scroll_into_view_if_needed()
    eye = "(one) => one._fullLayout.scene._scene.getCamera().eye.x"
    before, top = scene.evaluate(eye), narrow_page.evaluate("() => window.scrollY")
    scene.hover()
    narrow_page.mouse.wheel(0, -300)
    narrow_page.wait_for_function("(top) => window.scrollY < top - 100", arg=top)
    assert scene.evaluate(eye) == pytest.approx(before)
    moved = "([id, old]) => Math.abs(document.getElementById(id)._fullLayout.scene._scene.getCamera().eye.x - old) %s 0.01"
    buttons = narrow_page.locator("#space + .view")
    buttons.get_by_role("button", name="Zoom in").press("Enter")
    narrow_page.wait_for_function(moved % ">", arg=["space", before])
    buttons.get_by_role("button", name="Reset view").press("Enter")
    narrow_page.wait_for_function(moved % "<", arg=["space", before])


@pytest.mark.parametrize(("place", "anchor"), [(0, "left"), (6, "center"), (12, "right")])
def test_labels_at_the_ends_of_the_chain_stay_in_the_figure(place, anchor):
    from workbench.report.diagnosis.chain import side

    assert side(place, 0, 12) == anchor


def test_samples_without_a_covariate_are_in_no_bin():
    x = np.array([0.0, 1.0, np.nan, 1.0, np.nan])
    centres, means = figures.binned(x, np.array([1.0, 2.0, 50.0, 4.0, np.nan]))
    assert list(centres) == [0.0, 1.0] and list(means) == [1.0, 3.0]


def test_a_component_without_any_value_of_a_covariate_has_no_spread():
    """The row of a corner next to a place along the stripe, which no corner has."""
    assert _spread(np.array([])) == 0.0 and _spread(np.array([1.0, 3.0])) == 2.0


def test_a_last_column_of_words_may_break_its_lines(tmp_path):
    from workbench.report.sections import Page, Section, table

    rows = [("a", "1.5 mm", "window-refraction at the camera")]
    part = table(["effect", "size", "most confounded effect"], rows, last_is_text=True)
    sheet = Page("kind", "title", (), lead=(), sections=(Section("id", "Section", (part,)),))
    html = write_sheet(sheet, tmp_path).read_text(encoding="utf-8")
    assert '<td class="n">1.5 mm</td><td>window-refraction at the camera</td>' in html
