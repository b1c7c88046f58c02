"""The sensor's commands: the JSON contract to the letter, files that are read back, one sentence for bad input."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from sensor_recordings import handeye_recording, scanner_recording
from workbench.commands import cli


def run(*words) -> int:
    """One command line in this process; its exit status."""
    return cli.run([str(word) for word in words])


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def answers(tmp_path_factory):
    """`answers(command)`: the answer of each command on the rendered recording, and the folder it was written to."""
    home, made = tmp_path_factory.mktemp("answers"), {}

    def of(command) -> tuple[dict, Path]:
        if command not in made:
            folder = scanner_recording()[0]
            words = {
                "camera": ["camera", folder, "--out", home / "camera"],
                "scanner": ["scanner", folder, "--out", home / "scanner.toml"],
                "scan": [
                    "scan",
                    folder,
                    "--out",
                    home / "scan",
                    "--scanner",
                    of_scanner(home, folder),
                ],
                "handeye": ["handeye", handeye_recording()[0], "--out", home / "handeye"],
            }[command]
            if not (home / f"{command}.json").exists():
                assert run(*words, "--json", home / f"{command}.json", "--no-report") == 0
            made[command] = json.loads((home / f"{command}.json").read_text())
        return made[command], home

    return of


def of_scanner(home: Path, folder: Path) -> Path:
    if not (home / "scanner.toml").exists():
        assert (
            run(
                "scanner",
                folder,
                "--out",
                home / "scanner.toml",
                "--json",
                home / "scanner.json",
                "--no-report",
            )
            == 0
        )
    return home / "scanner.toml"


@pytest.fixture(autouse=True)
def runs_elsewhere(tmp_path, monkeypatch):
    from workbench.files import runs

    monkeypatch.setattr(runs, "RUNS", tmp_path / "runs")


def test_camera_answers_to_the_letter(answers):
    found, home = answers("camera")
    wanted = {
        "command",
        "fx_px",
        "fy_px",
        "cx_px",
        "cy_px",
        "distortion",
        "rms_px",
        "views",
        "rejected",
        "std",
    }
    assert wanted <= found.keys() and found["command"] == "camera" and len(found["distortion"]) == 5
    assert found["views"] == 9 and found["rejected"] == []
    assert found["run"] == str(home / "camera") and Path(found["camera_file"]).is_file()
    assert found["rms_px"] == pytest.approx(np.sqrt(2) * found["rms_coordinate_px"])


def test_camera_finds_the_camera_that_was_rendered(answers):
    found, truth = answers("camera")[0], scanner_recording()[1]["camera"]
    for key in ("fx_px", "fy_px", "cx_px", "cy_px"):
        assert abs(found[key] - truth[key]) < 4 * found["std"][key] + 0.05
    assert found["std"]["fx_px"] < 2 and found["rms_coordinate_px"] < 0.1


def test_camera_file_is_read_back(answers):
    from workbench.jobs.sensor.camera import read

    found, _ = answers("camera")
    camera = read(Path(found["camera_file"]))
    assert (
        camera.fx == found["fx_px"]
        and list(camera.distortion) == found["distortion"]
        and camera.size == (400, 320)
    )


def test_scanner_answers_to_the_letter(answers):
    found, home = answers("scanner")
    assert {"command", "camera", "planes", "mirror", "plane_rms_mm"} <= found.keys()
    assert {"fx_px", "distortion", "rms_px", "views", "rejected", "std"} <= found["camera"].keys()
    for plane in found["planes"]:
        assert {"step", "normal", "offset_mm", "rms_mm"} <= plane.keys()
        assert np.linalg.norm(plane["normal"]) == pytest.approx(1)
    assert {"axis", "angle_law"} <= found["mirror"].keys()
    assert (
        found["scanner_file"] == str(home / "scanner.toml")
        and (Path(found["run"]) / "scanner.toml").is_file()
    )


def test_scanner_finds_the_planes_that_were_rendered(answers):
    found, truth = answers("scanner")[0], {p["step"]: p for p in scanner_recording()[1]["planes"]}
    at = np.array([0.0, 0.0, 125.0])  # in the middle of the working volume
    for plane in found["planes"]:
        true = truth[plane["step"]]
        sign = np.sign(np.dot(plane["normal"], true["normal"]))
        here, there = (
            np.dot(plane["normal"], at) + plane["offset_mm"],
            np.dot(true["normal"], at) + true["offset_mm"],
        )
        assert abs(sign * here - there) < 0.1
    assert found["plane_rms_mm"] < 0.03


def test_scanner_file_is_read_back(answers):
    from workbench.jobs.sensor.scanner import read

    found, home = answers("scanner")
    scanner = read(home / "scanner.toml")
    assert scanner.steps.tolist() == [plane["step"] for plane in found["planes"]]
    assert np.allclose(scanner.planes[:3].T, [plane["normal"] for plane in found["planes"]])


def test_scan_answers_to_the_letter_and_writes_clouds(answers):
    import open3d

    found, home = answers("scan")
    assert found["command"] == "scan" and [one["scan"] for one in found["scans"]] == ["1", "2"]
    for one in found["scans"]:
        assert {"scan", "points", "balls"} <= one.keys()
        cloud = np.asarray(open3d.io.read_point_cloud(one["cloud"]).points)
        assert len(cloud) == one["points"] and str(home / "scan") in one["cloud"]
        for ball in one["balls"]:
            assert {"x_mm", "y_mm", "z_mm", "radius_mm", "rms_mm", "std_mm"} <= ball.keys() and len(
                ball["std_mm"]
            ) == 3


def test_scan_finds_the_ball_where_it_was_rendered(answers):
    found, truth = answers("scan")[0], scanner_recording()[1]["scans"]
    for one, true in zip(found["scans"], truth):
        ball = one["balls"][0]
        assert ball["ball"] == 1 and ball["radius_mm"] == 12 and ball["rms_mm"] < 0.05
        # the frame of the camera itself is known to some hundredths of a millimetre only
        assert (
            np.linalg.norm(
                np.subtract(
                    [ball[k] for k in ("x_mm", "y_mm", "z_mm")], true["balls"][0]["centre_mm"]
                )
            )
            < 0.15
        )


def test_scan_states_acceptance_figures(answers):
    found = {one["name"]: one for one in answers("scan")[0]["acceptance"]}
    assert found["probing_rms"]["value"] in [
        ball["rms_mm"] for one in answers("scan")[0]["scans"] for ball in one["balls"]
    ]
    assert (
        found["sphere_spacing"]["value"] is None and "two balls" in found["sphere_spacing"]["why"]
    )
    assert (
        found["probing_form"]["symbol"].startswith("P_Form.Sph")
        and "no limit" in found["probing_form"]["verdict"]
    )


def test_hand_eye_is_found(answers):
    found, true = answers("handeye")[0], handeye_recording()[1]
    assert {"command", "kind", "hand_eye", "fit", "held_out", "poses", "run"} <= found.keys()
    assert (
        found["kind"] == "in-hand"
        and found["transform"] == "T_flange_sensor"
        and found["poses"] == 9
    )
    assert np.allclose(found["hand_eye"]["xyz_mm"], true[:3, 3], atol=0.3)
    assert np.allclose(np.array(found["hand_eye"]["matrix"])[:3, :3], true[:3, :3], atol=3e-3)
    assert found["held_out"]["origin_mm"] < 0.3


def test_hand_eye_takes_a_calibrated_camera(answers, here):
    camera = answers("camera")[0]["camera_file"]
    assert (
        run(
            "handeye", handeye_recording()[0], "--camera", camera, "--no-report", "--json", "a.json"
        )
        == 0
    )
    found = json.loads(Path("a.json").read_text())
    assert found["camera"]["fx_px"] == pytest.approx(answers("camera")[0]["fx_px"], rel=1e-2)
    assert np.allclose(found["hand_eye"]["xyz_mm"], handeye_recording()[1][:3, 3], atol=0.3)


def test_the_run_folder_is_the_last_line(workbench, tmp_path):
    done = workbench("camera", scanner_recording()[0], "--out", "out")
    assert done.returncode == 0, done.stderr
    assert done.stdout.rstrip().endswith(str(tmp_path / "out" / "report.html"))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "answer.json",
        "camera.toml",
        "report.html",
        "summary.png",
    ]


def copied(folder: Path, to: Path) -> Path:
    """A copy of the rendered recording, to be spoilt."""
    return Path(shutil.copytree(folder, to / "spoilt"))


def with_text(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def black(folder: Path) -> None:
    import cv2

    for path in (folder / "images").glob("board-00?.png"):
        cv2.imwrite(str(path), np.zeros((320, 400), np.uint8))


def few(folder: Path) -> None:
    lines = (folder / "images.csv").read_text().splitlines()
    boards = [line for line in lines if ",board," in line]
    (folder / "images.csv").write_text("\n".join([lines[0], *boards[:2]]) + "\n")


def cut(folder: Path) -> None:
    path = folder / "images" / "board-003.png"
    path.write_bytes(path.read_bytes()[:2000])


SPOILT = {
    "black": ("camera", black, "black"),
    "wrong board": (
        "camera",
        lambda f: with_text(f / "recording.toml", "columns = 7", "columns = 11"),
        "columns",
    ),
    "broken image": ("camera", cut, "board-003.png"),
    "two images": ("camera", few, "board poses"),
    "no board": (
        "camera",
        lambda f: with_text(f / "images.csv", ",board,", ",board-laser,"),
        "board",
    ),
    "no laser": ("scanner", few, "board-laser"),
    "no scan": ("scan", few, "scan"),
    "no flange": ("handeye", lambda f: None, "flange"),
    "not an arm": ("calibrate", lambda f: None, "[robot]"),
}


@pytest.mark.parametrize("name", SPOILT)
def test_bad_input_gets_one_sentence_and_nothing_is_written(name, here, capsys):
    command, spoil, names = SPOILT[name]
    folder = copied(scanner_recording()[0], here)
    spoil(folder)
    kept = sorted(here.iterdir())
    assert run(command, folder) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and said.err.endswith(".\n"), said.err
    assert names in said.err and "Traceback" not in said.err and "expected" in said.err
    assert sorted(here.iterdir()) == kept


WRONG = {
    "model": (("camera", "x", "--model", "thin-lens"), "--model"),
    "kind": (("handeye", "x", "--kind", "on-foot"), "--kind"),
    "scanner file": (("scan", "{folder}", "--scanner", "no-such.toml"), "no-such.toml"),
    "camera file": (("handeye", "{hand}", "--camera", "no-such.toml"), "no-such.toml"),
    "scanner out": (("scanner", "{folder}", "--out", "nowhere/s.toml"), "nowhere"),
    "truth": (("render", "{folder}/../scene.toml", "--truth", "nowhere/t.json"), "nowhere"),
    "scene": (("render", "no-such.toml"), "no-such.toml"),
    "no images": (("camera", "elastic-arm"), "elastic-arm"),
    "no scans": (("scan", "elastic-arm"), "elastic-arm"),
    "scanner for a table": (("calibrate", "elastic-arm", "--scanner", "s.toml"), "--scanner"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_call_gets_one_sentence_and_status_2(name, here, capsys):
    words, names = WRONG[name]
    places = {"folder": scanner_recording()[0], "hand": handeye_recording()[0]}
    assert run(*(word.format(**places) for word in words)) == 2
    said = capsys.readouterr()
    assert (
        said.out == ""
        and said.err.count("\n") == 1
        and names in said.err
        and said.err.endswith(".\n")
    )
    assert list(here.iterdir()) == []


def test_a_image_without_the_board_is_named_and_the_rest_is_used(here):
    import cv2

    folder = copied(scanner_recording()[0], here)
    cv2.imwrite(str(folder / "images" / "board-005.png"), np.full((320, 400), 255, np.uint8))
    assert run("camera", folder, "--json", "a.json", "--out", "out") == 0
    found = json.loads(Path("a.json").read_text())
    assert found["views"] == 8
    assert [one["image"] for one in found["rejected"]] == [
        "images/board-005.png"
    ] and "saturated" in found["rejected"][0]["why"]
    page = Path("out/report.html").read_text(encoding="utf-8")
    assert "board-005.png: saturated" in page and "data:image/jpeg;base64," in page


def test_a_rendered_scene_is_a_recording_with_its_truth(workbench, tmp_path):
    import datasets

    small = (
        (ROOT / "tests" / "sensor_recordings.py")
        .read_text()
        .split('"""')[3]
        .replace("count = 9", "count = 1")
        .replace("laser = 4", "laser = 0")
    )
    (tmp_path / "scene.toml").write_text(
        small.replace("count = 2\nrange_mm = [126", "count = 0\nrange_mm = [126")
    )
    done = workbench("render", "scene.toml", "--out", "out", "--truth", "truth.json", "--json", "-")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (
        found["command"] == "render"
        and found["images"] == 1
        and found["measures"] == "board-images"
    )
    assert datasets.read(tmp_path / "out").images[0]["role"] == "board"
    assert json.loads((tmp_path / "truth.json").read_text())["camera"]["fx_px"] == 620
    assert done.stderr.rstrip().endswith(str(tmp_path / "out"))


@pytest.mark.slow
def test_images_become_a_calibrated_arm(here):
    import datasets
    from workbench.commands.data.demo import scene

    assert run("render", scene(), "--out", "cell", "--truth", "truth.json") == 0
    assert run("calibrate", "cell", "--out", "whole", "--json", "whole.json") == 0
    found = json.loads(Path("whole.json").read_text())
    assert found["command"] == "calibrate" and found["measures"] == "ball-centre"
    assert found["held_out"]["rms_mm"] < 0.05 < found["nominal"]["rms_mm"] / 4
    from workbench.files.images.ground_truth import centre_errors

    errors = centre_errors(found["sensor"]["scans"], json.loads(Path("truth.json").read_text()))
    assert errors["balls"] >= 25 and errors["rms_mm"] < 0.02
    centres = datasets.read("whole/ball-centres")
    assert centres.measures == "ball-centre" and centres.n == found["samples"]
    page = Path("whole/report.html").read_text(encoding="utf-8")
    assert all(
        f'<section id="{name}">' in page
        for name in ("stages", "acceptance", "balls", "planes", "camera-images")
    )
    # the same balls, from the scanner's file and from the recording of centres
    assert (
        run(
            "calibrate",
            "cell",
            "--scanner",
            "whole/scanner.toml",
            "--no-report",
            "--json",
            "again.json",
        )
        == 0
    )
    again = json.loads(Path("again.json").read_text())
    assert again["held_out"]["rms_mm"] == pytest.approx(found["held_out"]["rms_mm"], rel=0.2)
    fit = [int(number) for number in centres.sample_ids[: centres.n // 2]]
    Path("fit.txt").write_text("\n".join(map(str, fit)))
    assert run("calibrate", "whole/ball-centres", "--no-report", "--json", "centres.json") == 0
    third = json.loads(Path("centres.json").read_text())
    assert third["held_out"]["rms_mm"] == pytest.approx(found["held_out"]["rms_mm"], rel=1e-3)


@pytest.mark.slow
def test_the_demo_ends_in_one_page_that_leads_to_both(workbench, tmp_path):
    done = workbench("demo", "--bundled", "--out", "out", "--json", "demo.json", timeout=900)
    assert done.returncode == 0, done.stderr
    assert done.stdout.rstrip().endswith(str(tmp_path / "out" / "report.html"))
    found = json.loads((tmp_path / "demo.json").read_text())
    assert found["command"] == "demo" and found["from_pictures"]["against_truth"]["rms_mm"] < 0.02
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for link in ("from-pictures/report.html", "tracker/report.html", "from-pictures/truth.json"):
        assert f'href="{link}"' in page and (tmp_path / "out" / link).is_file()


@pytest.mark.parametrize(
    ("command", "units"),
    [
        ("camera", ["px"]),
        ("scanner", ["mm", "px"]),
        ("scan", ["mm"]),
        ("handeye", ["mm", "deg", "px"]),
    ],
)
def test_every_sensor_command_compares_its_residual_with_the_noise(answers, command, units):
    """Without a tolerance nothing passes or fails; a rendered recording is near its noise and warns of nothing."""
    found = answers(command)[0]
    verdict = found["verdict"]
    parts = verdict.get("checks", [verdict])
    assert (
        verdict["pass"] is None
        and [part["unit"] for part in parts] == units
        and found["warnings"] == []
    )
    for part in parts:
        assert part["residual_over_noise"] > 0 and "noise" in part["sentence"]


def test_a_tolerance_that_is_not_met_ends_with_status_1(here):
    folder = scanner_recording()[0]
    words = ("camera", folder, "--no-report", "--json", "answer.json", "--tolerance")
    assert run(*words, "0.0001px") == 1
    assert json.loads((here / "answer.json").read_text())["verdict"]["pass"] is False
    assert run(*words, "5px") == 0
    assert run(*words, "1mm") == 2
