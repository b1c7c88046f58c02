"""The Python API: every command is a function, and results can be looked at, kept and used."""

import inspect
import os
import pkgutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from conftest import ROOT
from datasets.samples.columns import misspelt
from workbench.api.functions import COMMANDS
from workbench.api.results import Table
from workbench.commands import cli

NOT_FUNCTIONS = {"open"}


@pytest.fixture(scope="module")
def recording():
    """A thinned bundled recording, which calibrates in seconds."""
    whole = wb.load_example("elastic-arm")
    return whole.select(np.arange(whole.n) % 3 == 0)


@pytest.fixture(scope="module")
def calibration(recording):
    return wb.calibrate(recording)


def test_import_loads_no_large_library():
    code = "import sys, workbench; dir(workbench); print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert not {"numpy", "torch", "cv2", "open3d", "pandas", "typer"} & set(done.stdout.split())


def test_a_module_of_the_reports_imports_no_pages():
    """Pages import plotly, scipy and the arm: 0.6 s for a function that formats numbers."""
    code = "import sys, workbench.report.text; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert not {"workbench.report.page", "plotly", "scipy"} & set(done.stdout.split())


def test_every_command_has_a_function():
    names = {info.name for info in cli.app.registered_commands}
    functions = {name.replace("_", "-") for name in COMMANDS}
    same = {"hand-eye": "handeye", "import-data": "import"}
    functions = {same.get(name, name) for name in functions}
    groups = {group.name for group in cli.app.registered_groups}
    assert (names | groups) - NOT_FUNCTIONS == functions


@pytest.mark.parametrize("name", COMMANDS)
def test_every_function_explains_its_arguments(name):
    call = getattr(wb, name)
    text = inspect.getdoc(call)
    for parameter in inspect.signature(call).parameters:
        assert f"{parameter}:" in text
    assert "json" not in inspect.signature(call).parameters


def test_no_module_hides_a_function_once_it_is_imported():
    modules = {module.name for module in pkgutil.iter_modules(wb.__path__)}
    assert not modules & set(wb.__all__)


def test_the_answer_is_reached_by_attributes(calibration):
    assert calibration.held_out.rms_mm == calibration.answer["held_out"]["rms_mm"]
    assert calibration.passed
    with pytest.raises(AttributeError, match="no 'helt_out'"):
        _ = calibration.helt_out


def test_tables_become_frames(calibration, recording):
    frame = calibration.parameters.to_frame()
    assert {"where", "name", "value", "std"} <= set(frame.columns)
    assert len(frame) == len(calibration.answer["parameters"])
    assert len(calibration.residuals.to_frame()) == recording.n


def test_a_frame_has_no_nested_objects():
    """Entries of objects are columns, a row is repeated for each of its parameters, lists of objects are left out."""
    size = {
        "name": "compliance",
        "value": 2e-5,
        "std": 1e-6,
        "unit": "rad/(N m)",
        "where": "joint-2",
    }
    found = {
        "effect": "joint-compliance",
        "where": "joint-2",
        "size_mm": 0.4,
        "found_again": {"folds": 8, "of": 9},
        "controls": [{"control": "permuted"}],
        "parameters": [size, size | {"name": "other", "size_mm": 0.1}],
    }
    frame = Table([found, found | {"parameters": []}]).to_frame()
    assert frame["name"].tolist()[:2] == ["compliance", "other"] and len(frame) == 3
    assert frame["found_again.folds"].tolist() == [8, 8, 8] and "controls" not in frame
    assert frame["size_mm"].tolist() == [0.4] * 3 and frame["parameter.size_mm"][1] == 0.1
    nested = frame.map(lambda cell: isinstance(cell, dict | list))
    assert not nested.to_numpy().any()


def test_a_result_shows_itself(calibration):
    assert "held out" in calibration.summary()
    shown = calibration._repr_html_()
    assert shown.startswith("<p><b>Held-out RMS") and "data:image/png;base64," in shown
    assert "<th>where</th>" in shown and "<pre>" in shown
    assert {line.name for line in calibration.plot().data} == {"nominal", "fit", "held out"}


def test_a_recording_shows_itself_in_a_line(recording):
    shown = repr(recording)
    assert f"{recording.n} samples, {recording.measures}" in shown
    assert "q1_deg, q2_deg" in shown and "\n" not in shown


def test_nothing_is_printed(recording, capsys):
    wb.identifiability(recording)
    assert capsys.readouterr().out == ""


def test_a_result_is_kept_and_read_back(calibration, tmp_path):
    folder = calibration.save(tmp_path / "run")
    assert wb.load(folder).held_out.rms_mm == calibration.held_out.rms_mm
    with pytest.raises(wb.InputError, match="name a new folder"):
        calibration.save(folder)
    with pytest.raises(wb.InputError, match="name a run folder"):
        wb.load(tmp_path)


def test_targets_from_a_frame_are_corrected(calibration, recording):
    import pandas

    readings = {f"q{k + 1}_deg": column for k, column in enumerate(np.rad2deg(recording.joints.T))}
    targets = pandas.DataFrame({**readings, **recording.covariates}).head(5)
    corrected = calibration.compensate(targets).table("corrected")
    assert len(corrected) == 5
    assert np.abs(corrected["q1_deg"] - targets["q1_deg"]).max() < 1


def test_an_array_of_joint_readings_becomes_a_table_of_targets(tmp_path):
    from workbench.api.inputs import as_argument

    path = as_argument(np.array([[1.0, 2.0], [3.0, 4.5]]), "targets", tmp_path)
    assert path.read_text() == "q1_deg,q2_deg\n1.0,2.0\n3.0,4.5\n"
    with pytest.raises(wb.InputError, match="with one row for each"):
        as_argument(np.zeros(3), "targets", tmp_path)


def test_a_calibration_is_exported(calibration, tmp_path):
    calibration.export(tmp_path / "arm.urdf")
    assert "<robot" in (tmp_path / "arm.urdf").read_text()
    with pytest.raises(wb.InputError, match="does not follow from the suffix"):
        calibration.export(tmp_path / "arm.unknown")


def test_a_recording_from_arrays_is_that_of_the_file(recording):
    joints, points = np.rad2deg(recording.joints), recording.points
    made = wb.Recording.from_arrays(recording.robot, joints, points, 0.02, time_s=np.arange(100.0))
    assert made.measures == "external-point"
    np.testing.assert_allclose(made.joints, recording.joints)
    np.testing.assert_allclose(made.covariates["time_s"], np.arange(100.0))
    with pytest.raises(wb.InputError, match=r"points_mm \(n, 3\)"):
        wb.Recording.from_arrays("ur10", joints, points.T)


def test_an_unknown_robot_is_refused_with_the_nearest_names():
    joints, points = np.zeros((5, 6)), np.ones((5, 3))
    with pytest.raises(wb.InputError, match="found 'nosuch'; name one, or give a file"):
        wb.Recording.from_arrays("nosuch", joints, points)
    with pytest.raises(wb.InputError, match="did you mean ur10[?]"):
        wb.Recording.from_arrays("UR10", joints, points)
    with pytest.raises(
        wb.InputError, match="found 'ur20'; name one, or give a file"
    ):  # another arm
        wb.Recording.from_arrays("ur20", joints, points)
    with pytest.raises(wb.InputError, match="did you mean fanuc_lr_mate_200id"):
        wb.Recording.from_arrays({"builtin": "fanuc"}, joints, points)


def test_a_recording_from_arrays_is_checked_like_a_file(recording):
    joints, points = np.rad2deg(recording.joints), recording.points.copy()
    points[3, 1] = np.nan
    where = r"from_arrays, row 3 \(sample 4\), column y_mm: expected a finite number, found nan"
    with pytest.raises(wb.InputError, match=where):
        wb.Recording.from_arrays(recording.robot, joints, points)
    with pytest.raises(wb.InputError, match="column q7_deg|7 joint"):
        seven = np.column_stack([joints, joints[:, 0]])
        wb.Recording.from_arrays(recording.robot, seven, recording.points)
    with pytest.raises(wb.InputError, match=r"payload_kg: expected one number or 100 of them"):
        wb.Recording.from_arrays(recording.robot, joints, recording.points, payload_kg=[1.0, 2.0])


@pytest.mark.parametrize(
    ("columns", "found"),
    [
        ({"reflector": np.array(["a", None] * 50, dtype=object)}, "reflector: .*both"),
        ({"payload_kg": ["2.0"] * 100}, "payload_kg: expected numbers, found text"),
        ({"payload_kg": np.ones(100) * 1j}, "payload_kg: expected real numbers, found complex"),
        ({"payload_kg": [[1], [1, 2]]}, "payload_kg: expected rows of one length"),
        ({"payload_kg": np.array([{}] * 100, dtype=object)}, "expected numbers, found other obj"),
        ({"sample": [f"p{k}" for k in range(100)]}, "sample: expected numbers, found text"),
        ({"x_mm": np.zeros(100)}, "x_mm: expected a further column"),
        ({"sigma_mm": -0.02}, "sigma_mm: expected a number above zero"),
        ({"sigma_mm": float("nan")}, "sigma_mm: expected a number above zero"),
        ({"sigma_mm": "0.02"}, "sigma_mm: expected a number above zero"),
        (
            {"sigma_mm": np.full(100, 0.02)},
            "sigma_mm: .* state the sigma of each row as sigma_x_mm",
        ),
    ],
)
def test_wrong_values_of_arrays_are_a_sentence(recording, columns, found):
    joints = np.rad2deg(recording.joints)
    with pytest.raises(wb.InputError, match=f"from_arrays, .*{found}"):
        wb.Recording.from_arrays(recording.robot, joints, recording.points, **columns)


@pytest.mark.parametrize(
    ("joints", "found"),
    [
        ([["a"] * 6] * 2, "joints_deg: expected numbers, found text"),
        ([[1, 2], [1]], "joints_deg: expected rows of one length"),
    ],
)
def test_wrong_joints_of_arrays_are_a_sentence(joints, found):
    with pytest.raises(wb.InputError, match=found):
        wb.Recording.from_arrays("ur10", joints, np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("robot", "shapes", "found"),
    [
        (None, ((5, 6), (5, 3)), "robot: expected the name of a built-in robot, .* found None"),
        ("ur10", ((5, 7), (5, 3)), "column q7_deg: expected 6 joints"),
        ("ur10", ((5, 5), (5, 3)), "column q5_deg: expected 6 joints"),
        ("ur10", ((0, 6), (0, 3)), "expected at least one row, found none"),
    ],
)
def test_arrays_that_no_robot_can_give_are_a_sentence(robot, shapes, found):
    random = np.random.default_rng(0)
    with pytest.raises(wb.InputError, match=f"from_arrays, .*{found}"):
        wb.Recording.from_arrays(robot, *(random.uniform(-80, 80, shape) for shape in shapes))


@pytest.mark.parametrize(
    ("call", "found"),
    [
        (lambda: wb.read(5), "recording: expected a folder or a known name, found 5"),
        (lambda: wb.scan("a", scanner=3), "scanner: expected Path | str.*, found 3"),
        (lambda: wb.camera("a", tolerance=0.3), "tolerance: expected Sequence.*, found 0.3"),
        (lambda: wb.calibrate("a", folds="four"), "folds: expected int.*, found 'four'"),
    ],
)
def test_a_value_of_another_type_is_a_sentence(call, found):
    with pytest.raises(wb.InputError, match=found.replace("|", "[|]")):
        call()


def test_names_of_reflectors_in_arrays_are_numbered_as_in_a_file(recording):
    joints, names = np.rad2deg(recording.joints), ["b", "a"] * 50
    made = wb.Recording.from_arrays(recording.robot, joints, recording.points, reflector=names)
    assert made.columns["reflector"][:3].tolist() == [1, 2, 1]
    assert made.group_names["reflector"] == ("b", "a")


def test_masked_values_of_arrays_are_missing(recording):
    points = np.ma.masked_greater(recording.points, recording.points.max() - 1)
    with pytest.raises(wb.InputError, match="expected a finite number, found nan"):
        wb.Recording.from_arrays(recording.robot, np.rad2deg(recording.joints), points)


def test_a_recording_from_arrays_is_read_by_a_command(recording):
    joints = np.rad2deg(recording.joints)
    made = wb.Recording.from_arrays(recording.robot, joints, recording.points, 0.02)
    assert wb.check(made).answer["samples"] == recording.n


def test_linear_algebra_uses_one_thread_in_a_function_and_the_former_number_after_it():
    code = """
import numpy, scipy.linalg
from threadpoolctl import threadpool_info, threadpool_limits
from workbench.api.functions import run
from workbench.machine.processes import one_blas_thread

one_blas_thread()  # what a command line in the same process leaves in the environment states nothing

def threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

threadpool_limits(3, user_api="blas")
inside = []
run(lambda: inside.append(threads()), {})
print(inside[0], threads())
"""
    environment = {name: value for name, value in os.environ.items() if "THREADS" not in name}
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == "{1} {3}\n"


def test_a_wrong_call_raises_the_sentence(tmp_path):
    with pytest.raises(wb.InputError):
        wb.calibrate(tmp_path / "nothing")
    with pytest.raises(TypeError):
        wb.calibrate("elastic-arm", no_such_option=1)


def test_a_misspelt_parameter_is_named():
    with pytest.raises(TypeError, match=r"calibrate\(\): .*'fold'; did you mean folds\?"):
        wb.calibrate("elastic-arm", fold=4)


def test_a_recording_from_arrays_is_saved(recording, tmp_path):
    degrees = np.rad2deg(recording.joints)
    made = wb.Recording.from_arrays("ur10", degrees, recording.points, temperature_c=20.0)
    folder = made.save(tmp_path / "kept")
    assert np.array_equal(wb.read(folder).points, made.points)
    with pytest.raises(wb.InputError, match="expected a new or empty folder"):
        made.save(folder)


@pytest.mark.parametrize("name", ["paylod_kg", "payload", "temperatur_c"])
def test_a_misspelt_column_is_refused_and_warned_of(name, recording, tmp_path):
    degrees = np.rad2deg(recording.joints)
    with pytest.raises(wb.InputError, match=f"{name}: .* nearly is"):
        wb.Recording.from_arrays("ur10", degrees, recording.points, **{name: 1.0})
    made = wb.Recording.from_arrays("ur10", degrees, recording.points)
    columns = {**made.columns, name: np.ones(made.n)}
    read = wb.read(replace(made, columns=columns).save(tmp_path / "kept"))
    assert any(f"column {name}: " in said for said in read.warnings)


@pytest.mark.parametrize(
    "name", ["humidity", "temperature2_c", "qdot1_deg_s", "sigma_x_mm", "load_a"]
)
def test_other_columns_are_no_misspelt_ones(name):
    assert misspelt(name) is None


def test_a_run_keeps_a_recording_that_was_in_memory_alone(recording, tmp_path):
    from workbench.app.data.opened import open_subject

    wb.check(recording, out=tmp_path / "checked")
    opened = open_subject(str(tmp_path / "checked"))
    np.testing.assert_allclose(opened.recording.joints, recording.joints)
    assert opened.recording.n == recording.n
