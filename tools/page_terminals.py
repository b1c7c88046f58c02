"""Terminals on pages of docs/: each shows commands and what they print today."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from terminal_image import ROOT, draw, run

IMAGES = ROOT / "docs" / "images"
ODD_UNITS = f"""
import shutil, subprocess, sys, pandas
shutil.copy({str(ROOT / "docs" / "scenes" / "elastic-tracker.toml")!r}, "scene.toml")
subprocess.run([sys.executable, "-m", "workbench", "simulate", "scene.toml", "--out", "simulated"])
samples = pandas.read_csv("simulated/samples.csv").query("reflector == 1")
table = samples.filter(regex="q._deg").rename(columns=lambda name: "A" + name[1])
for axis in "xyz":
    table[axis.upper() + " [in]"] = samples[axis + "_mm"] / 25.4
table.round(5).to_csv("tracker.csv", sep=";", decimal=",", index=False)
"""
IN_RADIANS = """
import shutil, numpy, pandas, workbench
shutil.copytree(workbench.load_example("elastic-arm").folder, "my-arm")
samples = pandas.read_csv("my-arm/samples.csv")
samples["q3_deg"] = numpy.deg2rad(samples["q3_deg"])
samples.to_csv("my-arm/samples.csv", index=False)
"""
INVERTED = """
import pandas
from scipy.spatial.transform import RigidTransform, Rotation
samples = pandas.read_csv("my-camera/samples.csv", comment="#")
place, turn = ["flange_x_mm", "flange_y_mm", "flange_z_mm"], ["flange_qx", "flange_qy", "flange_qz", "flange_qw"]
inverse = RigidTransform.from_components(samples[place], Rotation.from_quat(samples[turn])).inv()
samples[place], samples[turn] = inverse.translation, inverse.rotation.as_quat()
samples.to_csv("my-camera/samples.csv", index=False)
"""
SESSION = """import workbench as wb

calibration = wb.calibrate(wb.load_example("elastic-arm"), folds=4)
print(calibration.held_out.rms_mm)
print(calibration.parameters.to_frame()[["where", "name", "value", "unit", "std"]].head(4))
print(calibration.residuals.to_frame().iloc[:3, :5])
"""
USE = """import my_arm

readings = [[10.0, -20.0, 30.0, 0.0, 45.0, 0.0]]
load = {"payload_kg": [1.5], "time_s": [0.0]}
corrected, error_mm = my_arm.corrected_readings(readings, covariates=load)
print(corrected.round(4), error_mm)
"""
HALVES = """
import shutil, pandas, workbench
samples = pandas.read_csv(workbench.load_example("elastic-arm").folder / "samples.csv")
for first, name in enumerate(("even-samples", "odd-samples")):
    shutil.copytree(workbench.load_example("elastic-arm").folder, name)
    samples[first::2].to_csv(name + "/samples.csv", index=False)
"""
IMPORTED_ARM = (
    ODD_UNITS
    + """
workbench = [sys.executable, "-m", "workbench"]
subprocess.run([*workbench, "import", "tracker.csv", "--robot", "abb_irb120", "--out", "my-arm", "-y"], check=True)
subprocess.run([*workbench, "calibrate", "my-arm", "--no-report", "--out", "arm"], check=True)
"""
)
TRACKER_POINTS = """
import numpy, pandas
from scipy.spatial.transform import Rotation
rng = numpy.random.default_rng(3)
arm = rng.uniform(-400, 400, (8, 3)) + [600, 0, 500]
tracker = Rotation.from_euler("z", 30, degrees=True).apply(arm) + [2500, -300, 120] + rng.normal(0, 0.02, (8, 3))
tracker[5, 2] += 0.8
for name, points in (("arm", arm), ("tracker", tracker)):
    table = pandas.DataFrame(points.round(3), columns=["x_mm", "y_mm", "z_mm"])
    table.insert(0, "point", [f"P{k}" for k in range(1, 9)])
    table.to_csv(name + "-points.csv", index=False)
"""
PROGRAM = """MODULE job
  CONST robtarget p10 := [[302.5, 40.0, 420.0], [0.0, 0.0, 1.0, 0.0], [0, 0, 0, 0], [9E9, 9E9, 9E9, 9E9, 9E9, 9E9]];
  CONST robtarget p20 := [[310.0, -60.0, 380.0], [0.0, 0.0, 1.0, 0.0], [-1, 0, -1, 0], [9E9, 9E9, 9E9, 9E9, 9E9, 9E9]];
  PROC main()
    MoveJ p10, v200, fine, tool0;
    MoveL p20, v200, fine, tool0;
  ENDPROC
ENDMODULE
"""
POSES = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n0,0,0,0,45,0\n30,40,-20,0,60,0\n-60,70,-40,90,30,0\n"
CALIBRATE = "workbench calibrate elastic-arm --no-report --out arm"


@dataclass(frozen=True)
class Terminal:
    """Image of a terminal: hidden preparation, shown commands, and how many lines of output are kept."""

    commands: tuple[str, ...]
    hidden: tuple[str, ...] = ()
    script: str = ""
    files: Mapping[str, str] = field(default_factory=dict)
    lines: int | None = None


TERMINALS = {
    "commands": Terminal(("workbench --help",)),
    "import": Terminal(
        ("head -3 tracker.csv", "workbench import tracker.csv --robot abb_irb120 --out my-arm"),
        script=ODD_UNITS,
    ),
    "scripts": Terminal(
        (
            "workbench calibrate elastic-arm --no-report --tolerance 0.04mm --json answer.json > log.txt;"
            ' echo "exit status $?"',
            'python3 -c \'import json; print(json.load(open("answer.json"))["held_out"]["rms_mm"])\'',
        )
    ),
    "poses": Terminal(("workbench poses elastic-arm -n 20",), lines=24),
    "identifiability": Terminal(("workbench identifiability elastic-arm",), lines=19),
    "tables": Terminal((CALIBRATE,), lines=24),
    "recording": Terminal(
        (
            'ls "$(workbench datasets path elastic-arm)"',
            'head -3 "$(workbench datasets path elastic-arm)/samples.csv" | cut -d, -f1-12',
            "workbench check elastic-arm --no-report",
        )
    ),
    "user-errors": Terminal(("workbench calibrate my-arm",), script=IN_RADIANS),
    "user-errors-hand-eye": Terminal(
        ("workbench handeye my-camera",),
        hidden=("workbench new board-images my-camera",),
        script=INVERTED,
    ),
    "study": Terminal(("workbench study compliance-error",), lines=30),
    "python-model": Terminal(
        (
            "workbench export arm --to python --out my_arm.py",
            "cat use.py",
            "python3 use.py",
        ),
        hidden=(CALIBRATE,),
        files={"use.py": USE},
    ),
    "model": Terminal((CALIBRATE.replace(" --no-report", ""), "ls arm"), lines=18),
    "evaluate": Terminal(
        (
            "workbench calibrate even-samples --no-report --out arm > log.txt",
            "workbench evaluate arm odd-samples --tolerance 0.1mm --no-report --out checked",
        ),
        script=HALVES,
    ),
    "robot-program": Terminal(
        ("cat job.mod", "workbench compensate arm job.mod --out corrected"),
        script=IMPORTED_ARM,
        files={"job.mod": PROGRAM},
    ),
    "stiffness": Terminal(
        ("workbench stiffness arm poses.csv --wrench 100 0 0 0 0 0 --out stiff",),
        hidden=(CALIBRATE,),
        files={"poses.csv": POSES},
    ),
    "register": Terminal(
        (
            "head -3 arm-points.csv",
            "workbench register arm-points.csv tracker-points.csv --out registered",
        ),
        script=TRACKER_POINTS,
    ),
    "api": Terminal(("cat session.py", "python3 session.py"), files={"session.py": SESSION}),
}


def write(name: str) -> Path:
    """docs/images/NAME.svg from its commands."""
    terminal = TERMINALS[name]
    with TemporaryDirectory() as folder:
        place = Path(folder)
        for command in terminal.hidden:
            run(command, place).check_returncode()
        for file, text in terminal.files.items():
            (place / file).write_text(text, encoding="utf-8")
        if terminal.script:
            (place / "prepare.py").write_text(terminal.script, encoding="utf-8")
            run("python3 prepare.py", place).check_returncode()
        shown = [_shown(command, place, terminal.lines) for command in terminal.commands]
    path = IMAGES / f"{name}.svg"
    path.write_text(draw(name, "\n".join(shown)), encoding="utf-8")
    return path


def _shown(command: str, folder: Path, lines: int | None) -> str:
    done = run(command, folder)
    output = (done.stdout + done.stderr).replace(f"{folder}/", "").replace(f"{ROOT}/", "")
    kept = output.rstrip().splitlines()
    if lines is not None and len(kept) > lines:
        kept = [*kept[:lines], "..."]
    return "\n".join([f"$ {command}", *kept, ""])
