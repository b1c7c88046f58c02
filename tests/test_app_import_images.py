"""The import wizard on what a camera on an arm leaves: images of a board, flange poses and a board file."""

import pytest
from scipy.spatial.transform import Rotation

from app_browser import opened_app, show_tab, trace, wait_for_text
from import_scenes import write_rows

pytestmark = pytest.mark.slow
BOARD = (
    "target_type: 'checkerboard'\ntargetCols: 9\ntargetRows: 6\n"
    "rowSpacingMeters: 0.012\ncolSpacingMeters: 0.012\n"
)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Images of the template of a hand-eye recording, its poses in inches and degrees, and its board."""
    import datasets
    from workbench.recordings.templates import write_template

    folder = tmp_path_factory.mktemp("images") / "board"
    write_template("board-images", folder)
    found = datasets.read(folder)
    angles = Rotation.from_matrix(found.flange[:, :3, :3]).as_euler("YZX", degrees=True)
    rows = []
    for pose, angle, row in zip(found.flange, angles, found.images):
        rows.append((*(pose[:3, 3] / 25.4), *angle, row["image"].rpartition("/")[2]))
    table = write_rows(folder / "poses.csv", ["X", "Y", "Z", "A", "B", "C", "image"], rows)
    (folder / "target.yaml").write_text(BOARD, encoding="utf-8")
    return [*sorted((folder / "images").iterdir()), table, folder / "target.yaml"]


@pytest.fixture(scope="module")
def page(browser, tmp_path_factory):
    with opened_app(browser, None, tmp_path_factory.mktemp("wizard"), "Import") as page:
        yield page


def test_images_and_poses_become_a_recording_that_opens_with_its_corners(page, files):
    page.locator("[data-tab=import] input[type=file]").set_input_files([str(one) for one in files])
    wait_for_text(page, "import", "Ready: board-images, 14 samples")
    page.get_by_role("button", name="Import and open").click()
    page.locator("[data-tab=recording]").wait_for()
    wait_for_text(page, "image", "54 corners detected")
    assert trace(page, "image", "54 corners")
    assert page.problems == []


def test_a_run_without_residuals_shows_no_empty_charts(page):
    show_tab(page, "Edit and rerun")
    page.get_by_role("button", name="Calibrate the camera").wait_for()
    assert page.locator("[data-tab=edit] [data-figure]").count() == 0
    show_tab(page, "Residuals")
    page.get_by_text("Residuals of a hand-eye calibration are here once its run is open").wait_for()
    assert page.get_by_label("Residual from (mm)").count() == 0
