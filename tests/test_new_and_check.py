"""`workbench new` writes templates that calibrate as they are; `workbench check` judges recordings before any fit."""

import json
import tomllib
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import tomli_w

import datasets
from datasets.samples.columns import KINDS
from workbench.commands.cli import run
from workbench.jobs.robot.simulate import simulate
from workbench.recordings.inspection import inspect_recording
from workbench.recordings.inspection.needs import coverage_needs
from workbench.recordings.inspection.repeats import repeats_of
from workbench.recordings.templates import write_template
from workbench.recordings.templates.images import write_reachable_scene

TABLES = [kind for kind in KINDS if not KINDS[kind].images]
OF_ROBOTS = [kind for kind in TABLES if kind != "target-pose"]


@pytest.fixture(scope="module")
def templates(tmp_path_factory):
    """`templates(kind)`: the folder of the template of a kind, written once."""
    made = {}

    def folder(kind: str):
        if kind not in made:
            made[kind] = tmp_path_factory.mktemp("new") / kind
            write_template(kind, made[kind])
        return made[kind]

    return folder


@pytest.mark.parametrize("kind", TABLES)
def test_template_is_commented_and_sufficient(kind, templates):
    folder = templates(kind)
    recording = datasets.read(folder)
    assert recording.measures == kind and recording.n >= 10
    assert (folder / "recording.toml").read_text().count("#") >= 5
    if kind in OF_ROBOTS:
        assert "Nominal robot" in (folder / "robot.toml").read_text()
    made = inspect_recording(recording)
    assert made.is_sufficient, made.sentence


def calibrated(folder, tmp_path) -> dict:
    answer = tmp_path / "a.json"
    command = ["calibrate", str(folder), "--no-report", "--out", str(tmp_path / "out")]
    assert run([*command, "--json", str(answer)]) == 0
    return json.loads(answer.read_text())


@pytest.mark.parametrize(
    "kind",
    [
        "external-point",
        *(pytest.param(k, marks=pytest.mark.slow) for k in OF_ROBOTS if k != "external-point"),
    ],
)
def test_template_calibrates_as_it_is(kind, templates, tmp_path, capsys):
    result = calibrated(templates(kind), tmp_path)
    assert result["held_out"]["rms_mm"] < 0.1
    capsys.readouterr()


def test_template_of_target_poses_gives_a_hand_eye_transform(templates, tmp_path, capsys):
    answer = tmp_path / "a.json"
    command = ["handeye", str(templates("target-pose")), "--no-report", "--out"]
    assert run([*command, str(tmp_path / "out"), "--json", str(answer)]) == 0
    result = json.loads(answer.read_text())
    assert result["held_out"]["origin_mm"] < 0.3
    capsys.readouterr()


def test_template_of_another_robot(tmp_path):
    write_template("ball-centre", tmp_path / "r", "abb_irb120")
    assert "IRB 120" in (tmp_path / "r" / "robot.toml").read_text()
    assert datasets.read(tmp_path / "r").joints.shape[1] == 6


@pytest.mark.slow
def test_template_of_scans_is_rendered_and_sufficient(tmp_path):
    write_template("scan-images", tmp_path / "scans")
    made = inspect_recording(datasets.read(tmp_path / "scans"))
    assert made.job == "scanner" and made.is_sufficient


@pytest.mark.slow
def test_template_of_a_board_has_poses_and_is_judged_by_its_images(templates):
    recording = datasets.read(templates("board-images"))
    made = inspect_recording(recording)
    assert made.is_sufficient and made.images.found == 14
    assert recording.flange is not None
    lonely = replace(
        recording,
        columns={},
        images=tuple({"image": r["image"], "role": "board"} for r in recording.images),
    )
    needs = inspect_recording(lonely).needs
    assert [(need.command, need.is_required) for need in needs][0] == ("handeye", True)


# ---- check ----


def repeated(recording, noise_mm, seed=1):
    """Every pose three times, with noise."""
    rng = np.random.default_rng(seed)
    columns = {name: np.repeat(cells, 3) for name, cells in recording.columns.items()}
    columns["repeat"] = columns["sample"]
    columns["sample"] = np.arange(1.0, len(columns["sample"]) + 1)
    for axis in "xyz":
        columns[f"{axis}_mm"] = columns[f"{axis}_mm"] + noise_mm * rng.normal(
            size=len(columns["sample"])
        )
    return replace(recording, columns=columns)


def test_noise_is_estimated_from_repeats_and_compared_with_the_statement(templates):
    recording = datasets.read(templates("external-point"))
    sound = repeated(recording, 0.02)
    found = repeats_of(sound)
    assert found.groups == recording.n and found.rows == 3 * recording.n
    assert found.noise_mm == pytest.approx(0.02, rel=0.2)
    assert not any("stated sigma" in need.what for need in inspect_recording(sound).needs)
    wrong = replace(sound, sigma_mm=0.1)
    assert any("stated sigma" in need.what for need in inspect_recording(wrong).needs)


def test_copies_of_rows_are_no_repeats(templates):
    recording = datasets.read(templates("external-point"))
    copies = repeated(recording, 0.0)
    assert repeats_of(copies).groups == 0


def test_too_few_poses_a_still_joint_and_one_orientation_are_named(templates):
    recording = datasets.read(templates("external-pose"))
    few = inspect_recording(recording.select(np.arange(4)))
    assert not few.is_sufficient and "4 poses" in few.sentence
    still = replace(recording, columns={**recording.columns, "q4_deg": np.full(recording.n, 12.0)})
    assert any("q4_deg does not move" in need.what for need in inspect_recording(still).needs)
    joints = [dict(joint) for joint in still.robot["joint"]]
    joints[3]["coupled"] = {"joint": 3, "ratio": -1.0}
    passive = replace(still, robot={**still.robot, "joint": joints})
    assert not any("does not move" in need.what for need in coverage_needs(passive))
    small = {
        name: cells * 0.02 if name.startswith("q") and name.endswith("_deg") else cells
        for name, cells in recording.columns.items()
    }
    named = [need.what for need in inspect_recording(replace(recording, columns=small)).needs]
    assert any("orientation" in what for what in named)
    assert any("q1_deg moves over" in what for what in named)


def test_command_writes_a_page_and_the_contract_keys(templates, tmp_path, capsys):
    out, answer = tmp_path / "out", tmp_path / "a.json"
    assert (
        run(["check", str(templates("ball-centre")), "--out", str(out), "--json", str(answer)]) == 0
    )
    result = json.loads(answer.read_text())
    assert {"coverage", "repeats", "noise_from_repeats_mm", "missing", "verdict"} <= set(result)
    assert len(result["coverage"]["joints"]) == 6
    page = (out / "report.html").read_text()
    for words in ("What is missing", "Range of the joints", "Poses in space"):
        assert words in page
    capsys.readouterr()


def test_command_ends_with_status_1_where_the_recording_is_not_enough(templates, tmp_path, capsys):
    from datasets.formats.recording1_writer import write

    recording = datasets.read(templates("external-point")).select(np.arange(5))
    write(recording, tmp_path / "few")
    command = ["check", str(tmp_path / "few"), "--no-report", "--out", str(tmp_path / "out")]
    assert run(command) == 1
    assert "Not enough for `workbench calibrate`" in " ".join(capsys.readouterr().out.split())


def test_the_page_states_a_failing_verdict_once(tmp_path):
    import datasets
    from workbench.recordings.inspection import inspect_recording
    from workbench.report import inspection

    write_template("external-point", tmp_path / "few", robot="ur10")
    few = datasets.read(tmp_path / "few").select(np.arange(4))
    made = inspect_recording(few)
    page = inspection.page(made)
    assert page.warning == made.sentence
    assert made.sentence not in page.lead


@pytest.mark.parametrize("name", ["abb_irb120", "kuka_kr6_r900"])
def test_the_balls_of_the_scanner_are_within_reach_of_the_named_robot(name, tmp_path):
    keys = tomllib.loads(resources.files("robot_model").joinpath(f"robots/{name}.toml").read_text())
    scene = resources.files("workbench").joinpath("files/demo_scenes/scanner-on-arm.arm.toml")
    text = scene.read_text().replace('"abb_irb120"', '"robot.toml"')
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(keys))
    write_reachable_scene(tmp_path / "scene.toml", text, keys)
    written = (tmp_path / "scene.toml").read_text()
    assert (written == text) == (name == "abb_irb120")  # the example's own arm stays where it is
    assert simulate(tmp_path / "scene.toml").n == 30
