"""The import wizard: without its page, and in a browser from dropped files to an opened recording."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from app_access import CONTRAST, missed_controls
from app_browser import choose_option, opened_app, text_of, trace, wait_for_text
from import_tables import nearly_one_orientation
from robot_model import load_robot
from test_mjcf_files import cell
from workbench.app.wizard.draft import Draft, folder_of, positive
from workbench.app.wizard.files import Dropped, safe_name
from workbench.app.wizard.form import form_rows, other_rows, with_cell
from workbench.app.wizard.trial import Trial
from workbench.core.errors import InputError
from workbench.recordings.importing.robots import robot_keys

JOINTS = [f"Achse {k}" for k in range(1, 7)]
POINTS = [f"Messpunkt {axis}" for axis in "XYZ"]


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """Joint log in rad and tracker table in inches of the example rows of a UR10, and these rows in deg and mm."""
    import datasets
    from workbench.recordings.templates import write_template

    folder = tmp_path_factory.mktemp("tables")
    write_template("external-point", folder / "recording", "ur10")
    found = datasets.read(folder / "recording")
    joints = np.stack([found.columns[f"q{k}_deg"] for k in range(1, 7)], 1)
    points = np.stack([found.columns[f"{axis}_mm"] for axis in "xyz"], 1)
    target = found.columns["reflector"][:, None]
    _write(folder / "joints.csv", ["Nr", *JOINTS], np.deg2rad(joints))
    _write(folder / "tracker.csv", ["Nr", *POINTS, "Ziel"], np.hstack([points / 25.4, target]))
    return folder, joints, points


POSES = "poses.csv"


@pytest.fixture(scope="module")
def poses(tmp_path_factory):
    """Folder of a table of poses whose orientations hardly change, so that their convention stays open."""
    folder = tmp_path_factory.mktemp("poses")
    joints, points, turns = nearly_one_orientation(0.1)
    head = [*(f"J{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]", "E1", "E2", "E3"]
    angles = turns.as_euler("ZXZ", degrees=True)
    _write(folder / POSES, ["Nr", *head], np.hstack([joints, points, angles]))
    return folder


def _write(path, head, values):
    lines = [";".join(head)]
    for number, row in enumerate(values, 1):
        lines.append(";".join([str(number), *(f"{value:.9f}" for value in row)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def files_of(folder, *names):
    """Files as the browser sends them."""
    return [{"name": name, "content": (folder / name).read_bytes()} for name in names]


@pytest.fixture
def draft(tables):
    made = Draft()
    made.add(files_of(tables[0], "joints.csv", "tracker.csv"))
    made.edit("columns", "Ziel", "reflector")
    made.choose("robot", "ur10")
    return made


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("a.csv", "a.csv"),
        ("../../etc/passwd", "passwd"),
        ("C:\\x\\b.csv", "b.csv"),
        (".hidden.csv", "hidden.csv"),
        ("a\x00b.csv", "ab.csv"),
    ],
)
def test_dropped_files_keep_their_name_without_any_folder(name, kept):
    assert safe_name(name) == kept


@pytest.mark.parametrize("name", ["", "..", "/", "a/..", None, "..."])
def test_a_file_without_a_name_is_refused(name):
    with pytest.raises(InputError, match="file name"):
        safe_name(name)


def test_dropped_files_lie_in_a_folder_of_their_own(tmp_path):
    dropped = Dropped()
    dropped.add([{"name": "../x.csv", "content": [b"a,b\n", b"1,2\n"]}])
    assert (dropped.folder / "x.csv").read_bytes() == b"a,b\n1,2\n"
    assert not (dropped.folder.parent / "x.csv").exists()
    dropped.clear()
    assert list(dropped.folder.iterdir()) == []


def test_too_large_files_are_refused(monkeypatch):
    monkeypatch.setattr("workbench.app.wizard.files.MOST_BYTES", 10)
    with pytest.raises(InputError, match="workbench import"):
        Dropped().add([{"name": "x.csv", "content": b"12345678901"}])


def test_the_form_shows_what_the_headers_suggest(draft):
    rows = {row["name"]: row for row in form_rows(draft.keys, draft.table)}
    assert rows["joints"]["columns"] == JOINTS and rows["point"]["columns"] == POINTS
    assert rows["joints"]["unit"] == "" and rows["joints"]["cells"]
    others = {row["name"]: row["target"] for row in other_rows(draft.keys, draft.table)}
    assert others["Ziel"] == "reflector"


def test_the_preview_is_the_import_with_tested_units(draft, tables):
    trial = draft.test()
    assert trial.problem == "" and trial.question is None
    recording = trial.result.recording
    joints = np.stack([recording.columns[f"q{k}_deg"] for k in range(1, 7)], 1)
    points = np.stack([recording.columns[f"{axis}_mm"] for axis in "xyz"], 1)
    np.testing.assert_allclose(joints, tables[1], atol=1e-6)
    np.testing.assert_allclose(points, tables[2], atol=1e-5)
    assert trial.fits[0]["name"] == "joints in radians, point in inches"
    assert trial.samples[0][0] == "sample"


def test_a_wrong_unit_is_named_and_a_corrected_one_is_taken(draft):
    draft.edit("joints", "unit", "rad")
    draft.edit("point", "unit", "mm")
    assert "inches" in draft.test().problem
    draft.edit("point", "unit", "in")
    assert draft.test().result is not None


def test_a_column_belongs_to_one_quantity(draft):
    draft.edit("flange_point", "columns", [POINTS[0]])
    rows = {row["name"]: row["columns"] for row in form_rows(draft.keys, draft.table)}
    assert POINTS[0] not in rows["point"] and rows["flange_point"] == [POINTS[0]]


@pytest.mark.parametrize(
    ("name", "key", "value", "words"),
    [
        ("point", "unit", "furlong", "one of mm"),
        ("point", "columns", POINTS[:2], "expected 3 columns"),
        ("", "measures", "telepathy", "key measures"),
    ],
)
def test_a_mapping_that_cannot_be_is_named_and_can_be_corrected(draft, name, key, value, words):
    draft.edit(name, key, value)
    assert words in draft.test().problem
    draft.edit("point", "columns", POINTS)
    draft.edit("", "measures", "external-point")
    assert draft.test().result is not None


def test_a_quantity_that_does_not_exist_is_refused(draft):
    with pytest.raises(InputError, match="expected a quantity"):
        with_cell(draft.keys, "soul", "columns", ["a"])


def test_an_open_question_is_answered_with_a_click(poses):
    """Orientations that hardly change fit under several conventions, and the trial asks for the right one."""
    draft = Draft()
    draft.add(files_of(poses, POSES))
    draft.choose("robot", "ur10")
    with pytest.raises(InputError, match="no such answer"):
        draft.answer(0)
    draft.trial = draft.test()
    options = draft.trial.question.options
    assert len(options) >= 2, draft.trial.problem
    draft.answer(1)
    answered = draft.test()
    assert answered.result is not None, answered.problem
    assert answered.result.mapping.rotation.convention in options[1]


def test_a_column_of_reflectors_that_was_removed_is_found_again_by_its_fit(draft):
    """The points of several reflectors as those of one fit under no reading of the columns."""
    draft.edit("columns", "Ziel", "")
    trial = draft.test()
    assert set(trial.result.recording.columns["reflector"]) == {1, 2, 3}
    assert any("'Ziel' is read as the reflector" in text for text in trial.result.warnings)


@pytest.mark.parametrize("name", ["", "../x", "/etc/x", "a/b", ".", "x\\y", "a" * 90])
def test_a_recording_is_only_written_below_the_working_folder(name, tmp_path):
    with pytest.raises(InputError, match="Name of the recording"):
        folder_of(name, tmp_path)


@pytest.mark.parametrize("text", ["-1", "0", "nan", "x", "inf"])
def test_numbers_above_zero_are_expected(text):
    with pytest.raises(InputError, match="number above 0"):
        positive(text, "Ball radius (mm)")


def test_an_existing_folder_is_never_overwritten(draft, tmp_path):
    trial = draft.test()
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError, match="new folder"):
        trial.keep(tmp_path / "there")
    trial.keep(tmp_path / "new")
    assert (tmp_path / "new" / "import.toml").is_file()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_is_named(draft, tmp_path):
    trial = draft.test()
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="can be written"):
        trial.keep(tmp_path / "new")


def test_an_incomplete_import_cannot_be_kept(tmp_path):
    with pytest.raises(InputError, match="not complete"):
        Trial(problem="no").keep(tmp_path / "new")


# In a browser

pages = pytest.mark.slow


@pytest.fixture(scope="module")
def page(browser, tmp_path_factory):
    with opened_app(browser, None, tmp_path_factory.mktemp("wizard"), "Import") as page:
        yield page


@pytest.fixture(scope="module")
def served(page):
    return page.served


DROP = """async ([selector, files]) => {
    const transfer = new DataTransfer();
    for (const [name, text] of files) transfer.items.add(new File([text], name));
    const place = document.querySelector(selector);
    for (const type of ['dragenter', 'dragover', 'drop'])
        place.dispatchEvent(new DragEvent(type, {dataTransfer: transfer, bubbles: true, cancelable: true}));
}"""


def drop(page, folder, *names):
    """Drop files on the field for files."""
    files = [[name, (folder / name).read_text(encoding="utf-8")] for name in names]
    page.evaluate(DROP, ["[data-drop] label", files])


def _drop_tables(page, tables) -> None:
    """Drop joint log and tracker table, name robot and reflector, and wait until the import is ready."""
    drop(page, tables[0], "joints.csv", "tracker.csv")
    wait_for_text(page, "import-files", "joints.csv, tracker.csv")
    choose_option(page, "Robot", "ur10")
    target = page.get_by_label("Ziel is recorded as")
    target.fill("reflector")
    target.press("Tab")
    wait_for_text(page, "import", "Ready: external-point, 36 samples")


@pytest.fixture(scope="module")
def filled(page, tables):
    """The page with two tables and a robot, whichever of the tests below a worker begins with."""
    _drop_tables(page, tables)
    return page


@pages
def test_without_any_run_the_app_starts_with_the_import(page):
    assert "Nothing is open yet" in page.inner_text("header")
    for name in ("Recording", "Residuals", "Edit and rerun", "Sensor", "Diagnosis"):
        assert page.get_by_role("tab", name=name, exact=True).is_disabled()


@pages
def test_dropped_tables_are_read_and_their_units_found(filled, tables):
    fits = (
        filled.get_by_role("group", name="Fit with plausible geometry errors")
        .locator("tbody tr")
        .first
    )
    assert "joints in radians, point in inches" in fits.inner_text()
    first = filled.get_by_role("group", name="First samples of the recording").inner_text()
    assert f"{tables[2][0][0]:.6g}" in first


@pages
def test_every_control_of_a_filled_wizard_is_reached_by_the_tabulator_key(filled):
    assert missed_controls(filled) == []


@pages
def test_text_of_a_filled_wizard_has_a_contrast_of_at_least_4_5(filled):
    assert filled.evaluate(CONTRAST) == []


@pages
def test_a_changed_unit_is_tested_at_once(filled):
    choose_option(filled, "Unit of measured point", "mm")
    wait_for_text(filled, "import", "hold inches")
    assert filled.get_by_role("button", name="Import and open").is_disabled()
    choose_option(filled, "Unit of measured point", "tested on the robot")
    wait_for_text(filled, "import", "Ready")


@pages
def test_a_question_is_answered_by_a_button_of_the_page(filled, poses, tables):
    filled.get_by_role("button", name="Remove all files").click()
    wait_for_text(filled, "import-files", "No files yet.")
    drop(filled, poses, POSES)
    choose_option(filled, "Robot", "ur10")
    question = filled.get_by_role("group", name="Open question")
    question.get_by_role("button").nth(1).click()
    wait_for_text(filled, "import", "Ready: external-pose, 30 samples")
    assert question.count() == 0
    filled.get_by_role("button", name="Remove all files").click()
    wait_for_text(filled, "import-files", "No files yet.")
    _drop_tables(filled, tables)


def test_a_column_of_times_is_said_to_be_read_by_its_header(draft):
    table = replace(draft.table, columns={**draft.table.columns, "Zeit [s]": np.arange(36.0)})
    becomes = {row["name"]: row["unnamed"] for row in other_rows(draft.keys, table)}
    assert becomes.pop("Zeit [s]") == "time_s, by its header"
    assert set(becomes.values()) == {"not used"}
    named = with_cell(draft.keys, "time", "columns", ["Zeit [s]"])
    assert {row["unnamed"] for row in other_rows(named, table)} == {"not used"}


@pages
def test_columns_are_mapped_by_keyboard(filled):
    field = filled.get_by_role("combobox", name="Measured point", exact=True)
    for text in ("expected 3 columns", "Ready"):
        field.focus()
        filled.keyboard.press("Control+a")
        filled.keyboard.type("Messpunkt Z")
        filled.get_by_role("option", name="Messpunkt Z").wait_for()
        filled.keyboard.press("ArrowDown")
        filled.keyboard.press("Enter")
        filled.keyboard.press("Escape")
        wait_for_text(filled, "import", text)


@pages
def test_a_name_with_a_path_is_refused(filled):
    filled.get_by_label("Name of the recording").fill("../outside")
    filled.get_by_role("button", name="Import and open").click()
    filled.get_by_text("Name of the recording: expected letters").wait_for()


@pages
def test_the_import_ends_in_a_recording_that_opens_and_can_be_calibrated(filled, served):
    filled.get_by_label("Name of the recording").fill("my-robot")
    filled.get_by_role("button", name="Import and open").click()
    assert "Sample 1 (1 of 36)" in wait_for_text(filled, "row", "Sample 1")
    assert trace(filled, "scene", "arm at the current sample")
    assert (served.folder / "my-robot" / "import.toml").is_file()
    assert "joints.csv tracker.csv" in filled.get_by_role("heading", level=1).inner_text()
    filled.get_by_role("tab", name="Edit and rerun").click()
    filled.get_by_role("button", name="Calibrate").click()
    assert "Finished" in wait_for_text(filled, "job", "Finished after", 300_000)
    folders = list(served.folder.glob("runs/my-robot-session/calibrate-*"))
    answer = json.loads((folders[0] / "answer.json").read_text(encoding="utf-8"))
    assert answer["samples"] == 36
    assert "run of calibrate" in filled.inner_text("header")
    assert filled.get_by_role("link", name="Report page", exact=True).is_visible()


@pages
def test_no_script_error_occurred(page):
    assert page.problems == []
    assert "bug" not in (text_of(page, "job") if page.locator("[data-text=job]").count() else "")


def test_each_arm_of_a_file_is_a_choice():
    dropped = Dropped()
    text = cell([("left", 6), ("right", 6)]).encode()
    dropped.add(
        [{"name": "cell.xml", "content": text}, {"name": "t.csv", "content": b"a,b\n1,2\n"}]
    )
    assert dropped.robots == ["cell.xml#left/tcp", "cell.xml#right/tcp"]
    assert [path.name for path in dropped.sources([])] == ["t.csv"]
    chosen = Draft(dropped=dropped, robot="cell.xml#right/tcp").options().robot
    assert chosen == str(dropped.folder / "cell.xml#right/tcp")
    assert load_robot(robot_keys(chosen, "robot")).joints == 6
