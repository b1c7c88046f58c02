"""The seed corpus of the fuzzing tests: a valid example for every reader and command, and the call that reads it."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import datasets
import workbench as wb
from fuzz_engine import Target
from fuzz_import_targets import import_command_targets, import_reader_targets
from good_recordings import write_good
from import_scenes import pose_scene
from study_scenes import TEXT as STUDY
from test_exports import BROWN, hand_eye_run
from workbench.commands import cli
from workbench.core.errors import InputError
from workbench.files.runs import PROVISIONAL, opened

PLAN = """[[stage]]
name = "geometry"
why = "lengths and angles differ from nominal"
free = ["base.*", "tool.*", "joint-*"]
loss = "huber"
[[stage]]
name = "compliance"
why = "gravity"
effects = [{ effect = "joint-compliance", where = "joint-2" }]
earn = true
"""
SCENE = (
    pose_scene("abb_irb120", 12, 3)
    + """[[effect]]
effect = "joint-compliance"
where = "joint-2"
values = { compliance = 3e-5 }
"""
)
SESSION = """format = 'session/1'
recording = 'elastic-arm'
folds = 5
changes = [
  { action = "exclude", kind = "samples", items = [3, 7], why = "large" },
]
"""
APRILGRID = "target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 6\ntagSize: 0.055\ntagSpacing: 0.3\n"
REPORT = """DIM LOC1= LOCATION OF POINT P1  UNITS=MM
AX    NOMINAL   MEAS    DEV
X     10.0000   10.013  0.013
Y     20.0000   20.001  0.001
Z     -5.0000   -5.002  -0.002
"""
DH_TABLE = (
    "joint,theta,d [mm],a [mm],alpha [deg]\n1,q1,290,0,-90\n2,q2-90,0,270,0\n3,q3 + pi/2,0,70,-90\n"
)
MAPPING = """format = "import/1"
measures = "external-point"
robot = "abb_irb120"
[joints]
columns = ["A1", "A2", "A3", "A4", "A5", "A6"]
unit = "deg"
[point]
columns = ["X", "Y", "Z"]
unit = "mm"
"""
KALIBR = """target_type: 'checkerboard'
targetCols: 6
targetRows: 7
rowSpacingMeters: 0.06
colSpacingMeters: 0.06
"""
OPENCV = """%YAML:1.0
---
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 600., 0., 320., 0., 600., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.1, 0.05, 0., 0., 0. ]
"""
KRL = """DEFDAT CALIB
DECL E6AXIS XP1={A1 10.0,A2 -80.0,A3 90.0,A4 1.0,A5 2.0,A6 3.0,E1 0.0}
DECL E6AXIS XP2={A1 20.0,A2 -70.0,A3 80.0,A4 4.0,A5 5.0,A6 6.0,E1 0.0}
DECL E6POS XP3={X 1.0,Y 2.0,Z 3.0,A 4.0,B 5.0,C 6.0}
ENDDAT
"""
FANUC = """/POS
P[1]{
   GP1:
  UF : 0, UT : 1,
  J1= 10.0 deg, J2= -20.0 deg, J3= 30.0 deg,
  J4= 1.0 deg, J5= 2.0 deg, J6= 3.0 deg
};
/END
"""
RAPID = """MODULE M
CONST jointtarget j1 := [[10,20,30,40,50,60],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST robtarget p1 := [[600,0,400],[0.7071068,0,0.7071068,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
ENDMODULE
"""
URDF = """<?xml version="1.0"?>
<robot name="two">
  <link name="base"/><link name="a"/><link name="b"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="a"/>
    <origin xyz="0 0 0.3" rpy="0 0 0"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="j2" type="revolute"><parent link="a"/><child link="b"/>
    <origin xyz="0.4 0 0" rpy="1.5708 0 0"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
</robot>
"""


class Crash(Exception):
    """A command that ended with the status of an internal error."""


def command(*words) -> None:
    """Run a command in this process; InputError for exit status 2, Crash for an internal error."""
    error = None

    def keep(problem):
        nonlocal error
        error = problem
        return Path("traceback")

    before, cli._traceback_file = cli._traceback_file, keep
    try:
        status = cli.run([str(word) for word in words])
    finally:
        cli._traceback_file = before
    if error is not None:
        raise error
    if status == 2:
        raise InputError("refused")
    if status not in (0, 1):
        raise Crash(f"exit status {status}")


def with_out(*words) -> Callable[[Path], None]:
    """A command whose words contain `{}` for the folder, and that writes into a folder that is removed."""

    def call(folder: Path) -> None:
        out = folder / "fuzz-out"
        try:
            command(*(str(word).replace("{}", str(folder)) for word in words), "--out", out)
        finally:
            shutil.rmtree(out, ignore_errors=True)
            out.unlink(missing_ok=True) if out.is_file() else None

    return call


def targets(home: Path, commands: bool = True) -> list[Target]:
    """Every target, its example written below `home`."""
    found = [*_text_targets(home), *_recording_targets(home), *import_reader_targets(home)]
    run = _calibrated_run(home)
    found += _run_targets(run)
    if commands:
        found += _command_targets(home, run)
    return found


def _one(home: Path, name: str, file: str, content: str | bytes, call) -> Target:
    folder = home / name
    folder.mkdir()
    data = content.encode("utf-8") if isinstance(content, str) else content
    (folder / file).write_bytes(data)
    return Target(name, folder, file, lambda folder: call(folder / file))


def _text_targets(home: Path) -> Iterator[Target]:
    import tomli_w

    from good_recordings import robot_toml
    from robot_model import load_robot
    from sensor_recordings import SCENE as RENDERING
    from sensors.camera.model import camera_keys
    from sensors.rendering.scene import read_scene as read_rendering
    from sensors.scanner.file import read_scanner, scanner_text
    from test_sensor_scanner import full_scanner
    from workbench.app.edits.session import read_session
    from workbench.files.exports.check import read_calibrated_camera
    from workbench.files.exports.hand_eye import read_hand_eye
    from workbench.files.scene import read_scene
    from workbench.fitting.calibration_plans.plans import read_plan
    from workbench.studies.spec import read_study

    hand_eye_run(home / "run-of-hand-eye")
    hand_eye = (home / "run-of-hand-eye" / "hand-eye.toml").read_bytes()
    camera = tomli_w.dumps({"format": "camera/1", **camera_keys(BROWN)})
    keys = RENDERING.replace("parts = [3, 2]\n", "")
    coupled = robot_toml().replace("ratio = 1.0", "ratio = -0.5, mechanical = true")
    yield _one(home, "robot-file", "robot.toml", robot_toml(), lambda p: load_robot(str(p)))
    yield _one(home, "coupled-robot", "robot.toml", coupled, lambda p: load_robot(str(p)))
    yield _one(home, "urdf", "arm.urdf", URDF, lambda p: load_robot(str(p)))
    yield _one(home, "scene", "scene.toml", SCENE, read_scene)
    yield _one(home, "rendering", "scene.toml", keys, read_rendering)
    yield _one(home, "plan", "plan.toml", PLAN, read_plan)
    yield _one(home, "study", "study.toml", STUDY, read_study)
    yield _one(home, "session", "session.toml", SESSION, read_session)
    yield _one(home, "camera", "camera.toml", camera, read_calibrated_camera)
    yield _one(home, "scanner", "scanner.toml", scanner_text(full_scanner()), read_scanner)
    yield _one(home, "hand-eye", "hand-eye.toml", hand_eye, read_hand_eye)
    yield from _import_targets(home)
    yield from _prove_targets(home)


def _import_targets(home: Path) -> Iterator[Target]:
    import cv2

    from datasets.importers.mapping.model import read_mapping
    from datasets.importers.sources.choice import read_sources
    from datasets.importers.sources.clouds import read_cloud
    from datasets.importers.sources.dh_tables import read_dh_table
    from datasets.importers.sources.storage import read_storage
    from sensors.images import read as read_image

    def sources(path):
        return read_sources([path], path.parent / "scratch")

    rng = np.random.default_rng(1)
    table = "A1;A2;A3;A4;A5;A6;X;Y;Z\n" + "\n".join(
        ";".join(f"{value:.3f}".replace(".", ",") for value in row)
        for row in rng.uniform(-90, 90, (8, 9))
    )
    image = rng.integers(0, 255, (12, 16), np.uint8)
    png, jpeg = (cv2.imencode(kind, image)[1].tobytes() for kind in (".png", ".jpg"))
    cloud = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    cloud += "property float z\nend_header\n0 0 0\n1 2 3\n4 5 6\n7 8 1\n"
    yield _one(home, "mapping", "import.toml", MAPPING, read_mapping)
    yield _one(home, "table", "log.csv", table, sources)
    yield _one(home, "kalibr", "target.yaml", KALIBR, read_storage)
    yield _one(home, "opencv", "camera.yml", OPENCV, sources)
    yield _one(home, "krl", "points.dat", KRL, sources)
    yield _one(home, "fanuc", "points.ls", FANUC, sources)
    yield _one(home, "rapid", "points.mod", RAPID, sources)
    yield _one(home, "aprilgrid", "grid.yaml", APRILGRID, read_storage)
    yield _one(home, "report", "report.txt", 3 * REPORT, sources)
    yield _one(home, "dh-table", "arm.csv", DH_TABLE, read_dh_table)
    records = [
        {"joints": row[:6].tolist(), "p": row[6:].tolist()} for row in rng.normal(size=(4, 9))
    ]
    yield _one(home, "records", "data.json", json.dumps(records), sources)
    yield _one(home, "parquet", "data.parquet", _parquet(home, rng), sources)
    yield _one(home, "matlab-7.3", "new.mat", _matlab_73(home, rng), sources)
    yield _one(
        home, "numpy", "data.npy", _bytes_of(home, np.save, rng.normal(size=(4, 9))), sources
    )
    yield _one(home, "matlab", "data.mat", _matlab(home, rng), sources)
    yield _one(home, "excel", "data.xlsx", _excel(home), sources)
    yield _one(home, "cloud", "scan.ply", cloud, lambda path: read_cloud(path, 1000))
    pcd = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\nHEIGHT 1\n"
    pcd += "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA ascii\n0 0 0\n1 2 3\n4 5 6\n7 8 1\n"
    yield _one(home, "pcd", "scan.pcd", pcd, lambda path: read_cloud(path, 1000))
    yield _one(home, "png", "image.png", png, read_image)
    yield _one(home, "jpeg", "image.jpg", jpeg, read_image)


def _bytes_of(home: Path, write, value) -> bytes:
    path = home / "value.npy"
    write(path, value)
    return path.read_bytes()


def _parquet(home: Path, rng) -> bytes:
    import pandas

    pandas.DataFrame(rng.normal(size=(4, 9)), columns=list("abcdefxyz")).to_parquet(
        home / "v.parquet"
    )
    return (home / "v.parquet").read_bytes()


def _matlab_73(home: Path, rng) -> bytes:
    import h5py

    with h5py.File(home / "new-value.mat", "w", userblock_size=512) as file:
        file["q"], file["xyz"] = rng.normal(size=(6, 4)), rng.normal(size=(3, 4))
    head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    return head + (home / "new-value.mat").read_bytes()[128:]


def _matlab(home: Path, rng) -> bytes:
    from scipy.io import savemat

    savemat(home / "value.mat", {"q": rng.normal(size=(4, 6)), "xyz": rng.normal(size=(4, 3))})
    return (home / "value.mat").read_bytes()


def _excel(home: Path) -> bytes:
    import pandas

    pandas.DataFrame({"A1": [1.0, 2.0], "X": [3.0, 4.0]}).to_excel(home / "value.xlsx", index=False)
    return (home / "value.xlsx").read_bytes()


def _prove_targets(home: Path) -> Iterator[Target]:
    from workbench.proving import protocol
    from workbench.proving.prove import _settings, bring

    settings = '{"seed": 1, "own": null, "planned": {"noise": 2}}'
    seals = '{"a": "' + "0" * 64 + '"}'
    yield _one(home, "prove-settings", "settings.json", settings, _settings)
    yield _one(
        home,
        "prove-seals",
        "seals.json",
        seals,
        lambda path: protocol.published(protocol.BenchmarkRun(path.parent)),
    )
    own = home / "own"
    write_good(own / "recordings" / "case", "ball-centre")
    (own / "sealed").mkdir()
    truth = own / "sealed" / "case.json"
    truth.write_text('{"effects": [{"effect": "joint-compliance", "where": "joint-2"}]}')
    (own / "SHA256SUMS").write_text(f"{protocol.checksum(truth)}  sealed/case.json\n")

    def bring_own(folder: Path) -> None:
        exam = folder.parent / "exam"
        try:
            bring(protocol.BenchmarkRun(exam), folder)
        finally:
            shutil.rmtree(exam, ignore_errors=True)

    yield Target("prove-sums", own, "SHA256SUMS", bring_own)
    bare = shutil.copytree(own, home / "own-bare")
    (bare / "SHA256SUMS").unlink()
    yield Target("prove-truth", bare, "sealed/case.json", bring_own)


def _recording_targets(home: Path) -> Iterator[Target]:
    kinds = {
        "ball-centre": ("recording.toml", "robot.toml", "samples.csv", "artefact.csv"),
        "external-pose": ("samples.csv",),
        "scan-images": ("images.csv", "images/a.png"),
    }
    for measures, files in kinds.items():
        folder = write_good(home / f"recording-{measures}", measures)
        for file in files:
            yield Target(f"recording {measures} {file}", folder, file, datasets.read)
    poses = datasets.read(home / "recording-external-pose")
    parquet = datasets.write(poses, home / "recording-parquet", "parquet")
    yield Target("recording parquet", parquet, "samples.parquet", datasets.read)


def _calibrated_run(home: Path) -> Path:
    """A run folder of `workbench calibrate` on 34 samples, with a list of samples, targets and a plan."""
    whole = wb.load_example("elastic-arm")
    recording = whole.select(np.arange(whole.n) % 9 == 0)
    place = datasets.write(recording, home / "recording")
    plan = home / "one-stage.toml"
    plan.write_text(PLAN.split('[[stage]]\nname = "compliance"')[0], encoding="utf-8")
    run = home / "run"
    command("calibrate", place, "--plan", plan, "--no-report", "--out", run)
    numbers = recording.sample_ids[:8]
    (run / "list.txt").write_text("".join(f"{n}\n" for n in numbers), encoding="utf-8")
    names = [f"q{k}_deg" for k in range(1, recording.joints.shape[1] + 1)]
    rows = [names, *np.rad2deg(recording.joints[:4]).round(3).tolist()]
    text = "\n".join(",".join(map(str, row)) for row in rows)
    (run / "targets.csv").write_text(text + "\n", encoding="utf-8")
    return run


def _run_targets(run: Path) -> Iterator[Target]:
    from workbench.app.data.opened import open_subject
    from workbench.files.solution_file import read_solution
    from workbench.files.targets import read_programme

    robot = read_solution(run).robot
    yield Target("solution", run, "solution.json", read_solution)
    yield Target("answer", run, "answer.json", wb.load)
    yield Target("open", run, "answer.json", lambda folder: open_subject(str(folder)))
    yield Target("targets", run, "targets.csv", lambda f: read_programme(f / "targets.csv", robot))
    yield _one(run.parent, "interrupted", PROVISIONAL, '{"provisional": true}', _started_again)


def _started_again(path: Path) -> None:
    """A run in the folder of an interrupted one, which holds its first result."""
    with opened("demo", "x", path.parent) as run:
        (run.partial / "result.txt").write_text("whole", encoding="utf-8")
    (path.parent / "result.txt").unlink()


def _command_targets(home: Path, run: Path) -> Iterator[Target]:
    """Commands that end in less than about a second on these examples."""
    recording, one_stage = home / "recording", home / "one-stage.toml"
    calibrate = ("calibrate", "{}", "--plan", one_stage, "--no-report")
    use = ("compensate", "{}", "{}/targets.csv", "--force")
    by_list = ("calibrate", recording, "--test-samples", "{}/list.txt", *calibrate[2:])
    by_plan = ("calibrate", recording, "--plan", "{}/plan.toml", "--no-report")
    robot = ("significance", "{}/robot.toml", "--points", "3")
    sources = ("import", "{}/samples.csv", "--robot", "abb_irb120", "--yes")
    writing = (
        ("compensate solution", run, "solution.json", use),
        ("compensate targets", run, "targets.csv", use),
        ("export urdf", run, "solution.json", ("export", "{}", "--to", "urdf", "--force")),
        ("stiffness", run, "solution.json", ("stiffness", "{}", "{}/targets.csv")),
        ("simulate", home / "scene", "scene.toml", ("simulate", "{}/scene.toml")),
        ("calibrate samples", recording, "samples.csv", calibrate),
        ("calibrate trusting", recording, "samples.csv", (*calibrate, "--trust-data")),
        ("calibrate plan", home / "plan", "plan.toml", by_plan),
        ("calibrate list", run, "list.txt", by_list),
        ("import", _simulated(home), "samples.csv", sources),
        ("significance", home / "robot-file", "robot.toml", robot),
    )
    for name, folder, file, words in writing:
        yield Target(name, folder, file, with_out(*words))
    yield from import_command_targets(home, with_out)
    yield Target("check", recording, "samples.csv", lambda f: command("check", f))
    yield Target("check toml", recording, "recording.toml", lambda f: command("check", f))
    yield Target(
        "identifiability", recording, "samples.csv", lambda f: command("identifiability", f)
    )


def _simulated(home: Path) -> Path:
    """A folder with a table of twelve poses that a simulated arm reached."""
    with_path = home / "simulated"
    command("simulate", home / "scene" / "scene.toml", "--out", with_path)
    return with_path
