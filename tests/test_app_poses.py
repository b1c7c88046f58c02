"""The app on measured poses: residuals of the orientation, in degrees, next to those of the position."""

import numpy as np
import pytest

import datasets
from app_browser import (
    FRAMES,
    calibrate_arm,
    choose_option,
    click_bin,
    opened_app,
    plot,
    show_tab,
    text_of,
    trace,
)
from app_browser import wait_for_text as wait
from pose_scenes import pose_scene


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of `workbench calibrate` on 40 poses that an instrument measured."""
    folder = tmp_path_factory.mktemp("poses")
    datasets.write(pose_scene(2, 90.0).recording, folder / "recording")
    return calibrate_arm(str(folder / "recording"), folder, FRAMES)


def test_angles_of_the_orientation_are_read_with_the_positions(run):
    from workbench.app.data.residuals import read_columns, read_residuals, unit_of

    found, columns = read_residuals(run), read_columns(run / "residuals.csv")
    vectors = np.stack([columns[f"held_out_{axis}_deg"] for axis in ("rx", "ry", "rz")])
    assert np.allclose(found.lengths["held_out_deg"], np.linalg.norm(vectors, axis=0))
    assert (unit_of("held_out_deg"), unit_of("held_out")) == ("deg", "mm")


@pytest.fixture(scope="module")
def page(browser, run, tmp_path_factory):
    with opened_app(browser, run, tmp_path_factory.mktemp("session"), "Residuals") as page:
        yield page


def _title(page, figure: str, text: str) -> None:
    """Wait until an axis of a figure has a title."""
    axis = "yaxis" if figure == "chart" else "xaxis"
    page.wait_for_function(
        "([one, axis, text]) => one.layout[axis].title.text === text",
        arg=[plot(page, figure).element_handle(), axis, text],
    )


@pytest.mark.slow
def test_residuals_of_the_orientation_are_drawn_counted_and_selected(page):
    show_tab(page, "Residuals")
    choose_option(page, "Residual", "held out, orientation")
    _title(page, "chart", "residual, held out, orientation (deg)")
    _title(page, "histogram", "residual (deg)")
    bars = trace(page, "histogram", "held out")
    assert sum(bars["y"]) == 40
    click_bin(page, len(bars["y"]) - 1)
    wait(page, "selection", f"{bars['y'][-1]} of 40 samples selected")
    cells = page.get_by_role("group", name="Selected samples").locator("tbody tr").first
    low = trace(page, "histogram", "bins")["customdata"][-1][0]
    assert float(cells.locator("td").nth(4).inner_text()) >= low - 1e-4


@pytest.mark.slow
def test_before_and_after_compare_the_orientation_too(page):
    show_tab(page, "Edit and rerun")
    page.get_by_role("button", name="Calibrate").click()
    wait(page, "job", "Finished after", 300_000)
    table = page.get_by_role("group", name="Before and after").inner_text()
    assert "held-out orientation RMS (deg)" in table and "–" not in table
    assert text_of(page, "job") and page.problems == []
