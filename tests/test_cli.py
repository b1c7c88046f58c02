"""The command line: light to start, one sentence for a mistake, whole outputs or none."""

import json
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from rich.console import Console

from conftest import ROOT
from workbench.commands import cli
from workbench.commands.shared import answer, samples, tables
from workbench.commands.shared.help import GROUPS
from workbench.core.errors import InputError

HEAVY = (
    "torch",
    "open3d",
    "vtk",
    "vtkmodules",
    "scipy.optimize",
    "pyvista",
    "cv2",
    "kornia",
    "mujoco",
    "numpy",
)


COMMANDS = (
    "calibrate",
    "camera",
    "scanner",
    "scan",
    "handeye",
    "render",
    "simulate",
    "identifiability",
    "datasets",
    "doctor",
    "demo",
    "open",
)


def imported(*words) -> set[str]:
    """Every module that a Python process imports when it runs `words`."""
    done = subprocess.run(
        [sys.executable, "-X", "importtime", *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return {
        line.rsplit("|", 1)[1].strip() for line in done.stderr.splitlines() if line.count("|") == 2
    }


@pytest.mark.parametrize(
    "command", [(), *((name,) for name in COMMANDS)], ids=lambda words: " ".join(words) or "-"
)
def test_help_imports_nothing_heavy(command):
    modules = imported("-m", "workbench", *command, "--help")
    assert "workbench.commands.cli" in modules
    assert not {name for name in modules if name in HEAVY or name.split(".")[0] in HEAVY}


def test_importing_the_packages_is_light():
    modules = imported("-c", "import workbench, datasets, robot_model, sensors")
    assert {"workbench", "datasets", "robot_model", "sensors"} <= modules
    assert not {name for name in modules if name in HEAVY[:5] or name.split(".")[0] in HEAVY[:4]}


def test_help_answers_in_half_a_second():
    """Of processor time: what else the machine does meanwhile is not the command's."""

    def spent():
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    seconds = []
    for _ in range(5):
        start = spent()
        started = [sys.executable, "-m", "workbench", "--help"]
        subprocess.run(started, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        seconds.append(spent() - start)
    assert 0 < min(seconds) < 0.5


def test_help_names_every_command(workbench):
    said = workbench("--help").stdout
    assert [name for name in COMMANDS if name not in said] == []


def test_every_command_has_an_example_of_its_own_options_and_groups_of_options(workbench):
    program = typer.main.get_command(cli.app)
    options = set()
    for name, command in program.commands.items():
        if name == "datasets":
            continue
        own = {word for parameter in command.params for word in parameter.opts}
        options |= own
        words = command.epilog.split()
        assert words[:3] == ["Example:", "workbench", name]
        assert {word for word in words if word.startswith("--")} <= own
        said = workbench(name, "--help").stdout
        titles = [line[:-1] for line in said.splitlines() if re.match(r"[A-Z][a-z ]+:$", line)]
        shown = [title for title in titles if title in GROUPS]
        assert shown == sorted(shown, key=list(GROUPS).index)
        assert command.epilog in " ".join(said.split())
    assert {option for group in GROUPS.values() for option in group} <= options


def test_without_words_it_helps(workbench):
    done = workbench()
    assert done.returncode == 0 and "calibrate" in done.stdout


def test_version_is_the_distributions(workbench):
    from workbench import __version__

    assert workbench("--version").stdout.split() == ["vision-sensor-workbench", __version__]


WRONG_CALLS = {
    "unknown command": (("calibrat",), "calibrat"),
    "missing argument": (("calibrate",), "recording"),
    "unknown option": (("calibrate", "x", "--bogus"), "--bogus"),
    "folds": (("calibrate", "x", "--folds", "1"), "--folds"),
    "folds no number": (("calibrate", "x", "--folds", "many"), "--folds"),
    "option twice": (
        ("evaluate", "x", "y", "--refit", "base", "--refit", "tool"),
        "expected it once (--refit <none|base|tool|base-and-tool>)",
    ),
    "option of a folder twice": (("compensate", "x", "--out", "a", "--out=b"), "--out is given 2"),
    "too many": (("simulate", "a", "b"), "b"),
    "json folder": (("calibrate", "x", "--json", "nowhere/x.json"), "nowhere"),
    "no recording": (("calibrate", "no-such-recording"), "no-such-recording"),
    "no recording to look at": (("identifiability", "no-such-recording"), "no-such-recording"),
    "no scene": (("simulate", "no-such-scene.toml"), "no-such-scene.toml"),
    "no data set": (("datasets", "path", "no-such-set"), "no-such-set"),
    "no data set to get": (("datasets", "get", "no-such-set"), "no-such-set"),
    "no subcommand": (("datasets",), "ommand"),
}


@pytest.mark.parametrize("name", WRONG_CALLS)
def test_a_wrong_call_gets_one_sentence_and_status_2(name, workbench, tmp_path):
    words, names = WRONG_CALLS[name]
    done = workbench(*words)
    assert done.returncode == 2, done
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1 and done.stderr.endswith(".\n")
    assert names in done.stderr and "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_flags_and_repeatable_options_may_be_given_twice(workbench):
    words = "--no-report", "--no-report", "--tolerance", "1mm", "--tolerance", "0.1deg"
    done = workbench("calibrate", "no-such-recording", *words)
    assert "neither a folder nor such a name" in done.stderr


def test_a_bug_is_called_one_and_its_traceback_kept(monkeypatch, capsys):
    def broken(*_words, **_options):
        raise ZeroDivisionError("inside")

    monkeypatch.setattr(cli, "app", broken)
    assert cli.run(["doctor"]) == cli.BUG
    said = capsys.readouterr().err
    kept = Path(re.search(r"with the file (\S+\.txt),", said).group(1))
    assert "bug of the workbench" in said and "Traceback" not in said
    assert "ZeroDivisionError: inside" in kept.read_text()
    kept.unlink()


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (KeyboardInterrupt(), 130, "Interrupted"),
        (InputError("a.csv, row 3:\nexpected a number."), 2, "a.csv, row 3: expected a number.\n"),
        (PermissionError(13, "Permission denied", "a.csv"), 2, "a.csv cannot be used"),
    ],
)
def test_each_failure_has_its_status(error, status, words, monkeypatch, capsys):
    def fails(*_words, **_options):
        raise error

    monkeypatch.setattr(cli, "app", fails)
    assert cli.run(["doctor"]) == status
    assert words in capsys.readouterr().err


def test_json_is_strict_whatever_goes_in():
    import numpy as np

    given = {
        "a": np.float64(np.nan),
        "b": np.arange(3),
        "c": (1, np.int64(2)),
        "d": np.inf,
        "e": Path("x"),
        "f": np.bool_(True),
        1: None,
        "g": [{"h": float("nan")}],
    }
    assert json.loads(answer.as_text(given)) == {
        "a": None,
        "b": [0, 1, 2],
        "c": [1, 2],
        "d": None,
        "e": "x",
        "f": True,
        "1": None,
        "g": [{"h": None}],
    }


def test_json_reaches_file_and_standard_output(tmp_path, capsys):
    answer.deliver({"x": 1}, str(tmp_path / "a.json"))
    answer.deliver({"x": 2}, "-")
    answer.deliver({"x": 3}, None)
    assert json.loads((tmp_path / "a.json").read_text()) == {"x": 1}
    assert json.loads(capsys.readouterr().out) == {"x": 2}
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_json_into_a_pipe_leaves_it_a_pipe(tmp_path):
    import threading

    os.mkfifo(tmp_path / "pipe")
    read = []
    reader = threading.Thread(target=lambda: read.append((tmp_path / "pipe").read_text()))
    reader.start()
    answer.deliver({"x": 1}, str(tmp_path / "pipe"))
    reader.join(timeout=10)
    assert json.loads(read[0]) == {"x": 1}
    assert (tmp_path / "pipe").is_fifo()


def test_json_follows_a_link(tmp_path):
    (tmp_path / "real.json").write_text("old")
    (tmp_path / "link.json").symlink_to(tmp_path / "real.json")
    answer.deliver({"x": 1}, str(tmp_path / "link.json"))
    assert (
        json.loads((tmp_path / "real.json").read_text()) == {"x": 1}
        and (tmp_path / "link.json").is_symlink()
    )


KNOWN = frozenset(range(10))


@pytest.mark.parametrize("text", ["1\n2\n3\n", "1\r\n2\r\n3", "\ufeff1\n\n2\n 3 \n"])
def test_lists_of_samples_are_read(text, tmp_path):
    (tmp_path / "fit.txt").write_text(text, encoding="utf-8", newline="")
    assert samples.read_list(tmp_path / "fit.txt", KNOWN, "--fit-samples") == (1, 2, 3)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"1\ntwo\n", "line 2: expected one whole sample number, found 'two'"),
        (b"1,2\n", "line 1: expected one whole sample number, found '1,2'"),
        (b"1.5\n", "line 1"),
        (b"1\n2\n1\n", "line 3: expected each sample once, found 1 again"),
        (b"1\n\n99\n", "line 3: expected the number of a sample of the recording, found 99"),
        (b"", "is empty"),
        (b"\n\n", "is empty"),
        (b"\xff\xfe1\n", "not UTF-8"),
    ],
)
def test_a_broken_list_of_samples_is_named(content, said, tmp_path):
    (tmp_path / "fit.txt").write_bytes(content)
    with pytest.raises(InputError, match=re.escape(said)) as caught:
        samples.read_list(tmp_path / "fit.txt", KNOWN, "--fit-samples")
    assert "fit.txt" in str(caught.value)


def test_a_list_of_samples_that_is_missing_is_named(tmp_path):
    assert samples.read_list(None, KNOWN, "--fit-samples") is None
    with pytest.raises(InputError, match="no.txt cannot be read as --fit-samples"):
        samples.read_list(tmp_path / "no.txt", KNOWN, "--fit-samples")


def test_no_sample_is_fitted_and_tested():
    samples.check_apart((1, 2), (3,), Path("t"))
    samples.check_apart(None, (3,), Path("t"))
    with pytest.raises(InputError, match="t lists sample 2"):
        samples.check_apart((1, 2), (2, 3), Path("t"))


def test_a_calibration_is_shown_in_numbers():
    errors = {"rms_mm": 0.02134, "mean_mm": 0.018, "p95_mm": 0.03, "max_mm": 0.05}
    row = {
        "name": "d",
        "where": "joint-3",
        "value": 0.013,
        "unit": "mm",
        "std": 0.004,
        "nominal": 0.0,
        "identifiable": True,
        "tied_to": [],
        "status": "estimated",
        "deviation": 0.013,
    }
    lost = {**row, "identifiable": False, "std": None, "status": "not identifiable"}
    result = {
        "recording": "r",
        "measures": "ball-centre",
        "samples": 200,
        "fit": errors,
        "held_out": errors,
        "nominal": {"rms_mm": 1.2},
        "parameters": [row, lost],
        "stages": [
            {
                "name": "geometry",
                "free": 30,
                "identifiable": 29,
                "rms_mm": 0.04,
                "held_out_rms_mm": 0.04,
            }
        ],
    }
    console = Console(record=True, width=100)
    tables.calibration(console, result)
    said = console.export_text()
    assert "0.02134" in said and "joint-3" in said and "1 of 2 parameters are estimated" in said


def test_the_doctor_says_what_is_missing(workbench):
    done = workbench("doctor", "--json", "-")
    found = json.loads(done.stdout)
    required = [check for check in found["checks"] if check["required"]]
    assert found["healthy"] == all(check["ok"] for check in required)
    assert done.returncode == (0 if found["healthy"] else 1)
    assert {"Python", "torch", "open3d", "cv2", "write permission"} <= {
        check["name"] for check in found["checks"]
    }
    assert all(check["advice"] for check in required if not check["ok"])


def test_the_doctor_names_the_packages_to_install():
    from workbench.machine.doctor import Check, apt_command

    checks = [
        Check("libusb-1.0.so.0", False, "absent"),
        Check("libGL.so.1", True, "loads"),
        Check("libEGL.so.1", False, "absent"),
    ]
    assert apt_command(checks).endswith("apt-get install -y libusb-1.0-0 libegl1")
    assert apt_command(checks[1:2]) is None


def test_a_bundled_recording_is_calibrated_from_end_to_end(workbench, tmp_path):
    done = workbench("calibrate", "elastic-arm", "--folds", "5", "--json", "-", "--out", "out")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["command"] == "calibrate" and found["recording"] == "elastic-arm"
    assert found["held_out"]["rms_mm"] < found["nominal"]["rms_mm"]
    assert found["held_out"]["folds"] == 5
    assert {"fit", "stages", "parameters", "measures", "samples"} <= found.keys()
    assert found["run"] == str(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "answer.json").read_text()) == found
    assert done.stderr.rstrip().endswith(str(tmp_path / "out" / "report.html"))
    assert "plotly" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_samples_named_for_the_fit_and_the_test_are_used(workbench, tmp_path):
    import datasets

    numbers = datasets.read("elastic-arm").sample_ids
    half = len(numbers) // 2
    (tmp_path / "fit.txt").write_text("\n".join(map(str, numbers[:half])))
    (tmp_path / "test.txt").write_text("\n".join(map(str, numbers[half:])))
    done = workbench(
        "calibrate",
        "elastic-arm",
        "--no-report",
        "--fit-samples",
        "fit.txt",
        "--test-samples",
        "test.txt",
        "--json",
        "answer.json",
    )
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "answer.json").read_text())
    assert found["held_out"]["rms_mm"] < found["nominal"]["rms_mm"]
    assert "report.html" not in done.stdout and done.stdout.rstrip().endswith(found["run"])
    assert not list(Path(found["run"]).glob("*.html"))


def test_what_a_bundled_recording_determines_is_said(workbench, tmp_path):
    done = workbench(
        "identifiability", "elastic-arm", "--json", "-", "--out", str(tmp_path / "run")
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (
        found["command"] == "identifiability"
        and found["recording"] == "elastic-arm"
        and len(found) > 3
    )


@pytest.mark.slow
def test_the_demo_says_which_recording_it_takes(workbench, tmp_path):
    done = workbench("demo", "--bundled", "--no-pictures", "--out", "out", "--json", "demo.json")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Recording: elastic-arm, bundled")
    assert done.stdout.rstrip().endswith(str(tmp_path / "out" / "report.html"))
    assert json.loads((tmp_path / "demo.json").read_text())["command"] == "demo"


def test_known_recordings_are_listed_and_found(workbench):
    rows = json.loads(workbench("datasets", "list", "--json", "-").stdout)["datasets"]
    assert {"elastic-arm", "irb120_faro"} <= {row["name"] for row in rows}
    assert all(row["licence"] and row["measures"] for row in rows)
    place = Path(workbench("datasets", "path", "elastic-arm").stdout.rstrip("\n"))
    assert (place / "recording.toml").is_file()


def test_every_public_name_is_there():
    import workbench

    assert [name for name in workbench.__all__ if getattr(workbench, name, None) is None] == []
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = workbench.nothing
