"""Import of 20 tables as laboratories of other countries write them: right, or a question; never silently wrong.

The variants were written before the code of the importer was read.
"""

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from import_scenes import pose_scene, simulated
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

ROBOT = "staubli_tx60"
ROWS = 40
SECONDS = 17.0 * np.arange(ROWS) + 3.25
CELSIUS = 21.0 + 2.0 * np.sin(np.arange(ROWS) / 7)
LOAD_KG = np.where(np.arange(ROWS) % 2, 2.5, 0.5)


@dataclass
class Case:
    """Files of one variant and what the recording has to hold."""

    tables: dict[str, bytes]
    robot: str = ROBOT
    rotation: bool = True
    covariates: dict[str, np.ndarray] = field(default_factory=dict)
    only_question: bool = False


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), pose_scene(ROBOT, ROWS, 411))


def rotation_of(recording) -> Rotation:
    return Rotation.from_quat(np.stack([recording.columns[f"q{c}"] for c in "xyzw"], axis=1))


def text_of(columns, separator=",", decimal=".", digits="{:.10g}") -> str:
    """One table; a column is an array of numbers or a list of texts."""
    lines = [separator.join(columns)]
    for row in zip(*columns.values(), strict=True):
        cells = []
        for cell in row:
            text = cell if isinstance(cell, str) else digits.format(cell)
            cells.append(text if isinstance(cell, str) else text.replace(".", decimal))
        lines.append(separator.join(cells))
    return "\n".join(lines) + "\n"


def named(pattern: str, values: np.ndarray, letters) -> dict[str, np.ndarray]:
    """Columns of a matrix (n, k) under the pattern filled with each letter."""
    return {pattern.format(letter): column for letter, column in zip(letters, values.T)}


def joints(truth, pattern: str, unit: float = 1.0) -> dict[str, np.ndarray]:
    return named(pattern, np.rad2deg(truth.joints) * unit, range(1, 7))


def points(truth, pattern: str, unit: float = 1.0, letters="XYZ") -> dict[str, np.ndarray]:
    return named(pattern, truth.points * unit, letters)


def euler(truth, sequence: str, names, unit: float = 1.0) -> dict[str, np.ndarray]:
    angles = rotation_of(truth).as_euler(sequence, degrees=True) * unit
    return dict(zip(names, angles.T))


def clock(form: str, start: datetime, seconds=SECONDS) -> list[str]:
    return [(start + timedelta(seconds=float(s))).strftime(form) for s in seconds]


def italian(truth) -> Case:
    when = {"Data e ora": clock("%d/%m/%Y %H:%M:%S", datetime(2025, 11, 3, 14, 22))}
    table = when | joints(truth, "Giunto {} [°]") | points(truth, "Posizione {} [mm]")
    table |= {"Temperatura [°C]": CELSIUS, "Carico [kg]": LOAD_KG}
    found = {"temperature_c": CELSIUS, "payload_kg": LOAD_KG}
    return Case({"misure.csv": text_of(table, ";", ",").encode()}, ROBOT, False, found)


def spanish(truth) -> Case:
    table = {"Tiempo (s)": SECONDS} | joints(truth, "Articulación {} (rad)", np.pi / 180)
    table |= points(truth, "Posición {} (m)", 0.001)
    table |= euler(truth, "zyx", ("Ángulo A", "Ángulo B", "Ángulo C"))
    return Case({"medidas.tsv": text_of(table, "\t").encode()}, covariates={"time_s": SECONDS})


def portuguese(truth) -> Case:
    table = points(truth, "Ponto {}") | joints(truth, "Junta {}")
    table |= {"Tempo (s)": SECONDS, "Carga (g)": 1000 * LOAD_KG}
    found = {"payload_kg": LOAD_KG}
    return Case({"medidas.csv": text_of(table, ";", ",").encode("cp1252")}, ROBOT, False, found)


def french_utf16(truth) -> Case:
    table = joints(truth, "Axe {}") | points(truth, "Cible {} (mm)")
    table |= euler(truth, "ZYX", ("Lacet", "Tangage", "Roulis")) | {"Charge [kg]": LOAD_KG}
    found = {"payload_kg": LOAD_KG}
    return Case({"mesures.txt": text_of(table, "\t", ",").encode("utf-16")}, covariates=found)


def chinese(truth) -> Case:
    table = {"时间": clock("%Y-%m-%d %H:%M:%S", datetime(2025, 11, 3, 9))}
    table |= joints(truth, "关节{} (度)") | points(truth, "位置{}(毫米)") | {"温度(℃)": CELSIUS}
    found = {"temperature_c": CELSIUS}
    return Case({"数据.csv": text_of(table).encode("utf-8-sig")}, ROBOT, False, found)


def japanese_shift_jis(truth) -> Case:
    table = {"時刻": clock("%Y/%m/%d %H:%M:%S", datetime(2025, 11, 3, 9))}
    table |= joints(truth, "関節{}[deg]") | points(truth, "位置{}[mm]") | {"温度[℃]": CELSIUS}
    return Case({"data.csv": text_of(table).encode("shift_jis")}, ROBOT, False)


def reversed_axes_in_mrad(truth) -> Case:
    backwards = {name: truth.points.T[k] for name, k in (("z", 2), ("y", 1), ("x", 0))}
    angles = joints(truth, "th{}", 1000 * np.pi / 180)
    mixed = {"humidity": 40 + 0 * SECONDS} | backwards | {"operator id": 7 + 0 * SECONDS} | angles
    return Case({"log.csv": text_of(mixed).encode()}, rotation=False)


def yaw_pitch_roll(truth) -> Case:
    turns = euler(truth, "ZYX", ("yaw", "pitch", "roll"), np.pi / 180)
    table = joints(truth, "axis{}") | turns | points(truth, "{}")
    return Case({"poses.csv": text_of(table).encode()})


def greek_gon(truth) -> Case:
    turns = euler(truth, "YZX", ("alpha", "beta", "gamma"), 1 / 0.9)
    table = turns | points(truth, "T_{}", 1 / 25.4) | joints(truth, "A_{}", 1 / 0.9)
    return Case({"poses.csv": text_of(table, " ").encode()})


def rounded_quaternions(truth) -> Case:
    signs = np.where(np.arange(ROWS) % 3, 1.0, -1.0)
    quaternion = np.round(rotation_of(truth).as_quat() * signs[:, None], 5)
    turns = dict(zip(("qr", "qi", "qj", "qk"), quaternion[:, [3, 0, 1, 2]].T))
    table = turns | points(truth, "p{}", letters="xyz") | joints(truth, "joint{}_pos")
    return Case({"poses.csv": text_of(table).encode()})


def inverse_rotation(truth) -> Case:
    inverse = rotation_of(truth).inv().as_euler("XYZ", degrees=True)
    table = joints(truth, "J{}") | points(truth, "{}") | dict(zip(("A", "B", "C"), inverse.T))
    return Case({"poses.csv": text_of(table).encode()})


def controller_and_tracker(truth) -> Case:
    from robot_model import load_robot
    from workbench.recordings.templates.contact import TrueArm

    arm = TrueArm.of(load_robot(ROBOT), np.random.default_rng(3))
    flange = arm.flange(truth.joints)[1]
    table = joints(truth, "AxisPos{}") | named("CartPos {}", flange, "XYZ")
    table |= points(truth, "Leica {}")
    return Case({"both.csv": text_of(table).encode()}, rotation=False)


def dense(truth, pause=16.0) -> tuple[np.ndarray, np.ndarray]:
    """Log (seconds, degrees) of an arm that waits at each pose and moves on within a second."""
    degrees = np.rad2deg(truth.joints)
    times = np.sort(np.concatenate([SECONDS - 6.0, SECONDS + pause - 6.0]))
    waits = np.repeat(degrees, 2, axis=0)
    seconds = np.arange(times[0], times[-1], 0.5)
    rows = [np.interp(seconds, times, column) for column in waits.T]
    return seconds, np.array(rows).T


def two_tables(truth, first, second, separator=",", decimal=".") -> dict[str, bytes]:
    """A dense joint log and a tracker table, each with its own column of times."""
    log = {"Time": first} | named("J{}", dense(truth)[1], range(1, 7))
    tracker = {"Time": second} | points(truth, "{} [mm]")
    texts = {"robot_log.csv": log, "tracker.csv": tracker}
    return {name: text_of(t, separator, decimal).encode() for name, t in texts.items()}


def iso_times_of_two_zones(truth) -> Case:
    start = datetime(2025, 11, 23, 7, tzinfo=UTC)
    local = timezone(timedelta(hours=1))
    moments = [start + timedelta(seconds=float(s)) for s in dense(truth)[0]]
    first = [t.astimezone(local).isoformat(timespec="milliseconds") for t in moments]
    second = clock("%Y-%m-%dT%H:%M:%S.%fZ", start)
    return Case(two_tables(truth, first, second), rotation=False)


def epoch_in_milliseconds(truth) -> Case:
    first = [f"{1763881200000 + 1000 * s:.0f}" for s in dense(truth)[0]]
    second = [f"{1763881200 + s:.3f}" for s in SECONDS]
    return Case(two_tables(truth, first, second), rotation=False)


def times_of_the_day_with_commas(truth) -> Case:
    start = datetime(2025, 11, 23, 7)
    first = [t[:-3] for t in clock("%H:%M:%S,%f", start, dense(truth)[0])]
    second = [t[:-3] for t in clock("%H:%M:%S,%f", start)]
    return Case(two_tables(truth, first, second, ";", ","), rotation=False)


def excel_days(truth) -> Case:
    first = [f"{45984 + s / 86400:.9f}" for s in dense(truth)[0]]
    second = clock("%Y-%m-%d %H:%M:%S.%f", datetime(2025, 11, 23))
    return Case(two_tables(truth, first, second), rotation=False)


def swiss_thousands(truth) -> Case:
    cells = [[f"{v:,.4f}".replace(",", "'") for v in column] for column in truth.points.T]
    table = joints(truth, "Achse {}") | dict(zip(("Punkt X", "Punkt Y", "Punkt Z"), cells))
    return Case({"punkte.csv": text_of(table, ";").encode()}, rotation=False)


def revolutions(truth) -> Case:
    table = joints(truth, "motor{}", 1 / 360) | points(truth, "target {}", 1000.0)
    return Case({"turns.csv": text_of(table).encode()}, rotation=False)


def left_handed_tracker(truth) -> Case:
    mirrored = truth.points * [1.0, -1.0, 1.0]
    table = joints(truth, "J{}") | named("{}", mirrored, "XYZ")
    return Case({"left.csv": text_of(table).encode()}, rotation=False, only_question=True)


def fixed_width_transforms_in_feet(truth) -> Case:
    turns = rotation_of(truth).as_matrix()
    transforms = np.concatenate([turns, truth.points[:, :, None] / 304.8], axis=2)
    names = [f"T{i}{j}" for i in range(3) for j in range(4)]
    table = joints(truth, "q[{}]", np.pi / 180) | dict(zip(names, transforms.reshape(-1, 12).T))
    head = "".join(f"{name:>18}" for name in table)
    rows = ["".join(f"{v:>18.9E}" for v in row) for row in zip(*table.values(), strict=True)]
    return Case({"poses.txt": ("! run 7\n" + head + "\n" + "\n".join(rows)).encode()})


CASES = [
    italian,
    spanish,
    portuguese,
    french_utf16,
    chinese,
    japanese_shift_jis,
    reversed_axes_in_mrad,
    yaw_pitch_roll,
    greek_gon,
    rounded_quaternions,
    inverse_rotation,
    controller_and_tracker,
    iso_times_of_two_zones,
    epoch_in_milliseconds,
    times_of_the_day_with_commas,
    excel_days,
    swiss_thousands,
    revolutions,
    left_handed_tracker,
    fixed_width_transforms_in_feet,
]


def mistakes(made, case: Case, truth) -> list[str]:
    """What the recording holds wrongly; a covariate may be left out."""
    wrong = []
    if np.abs(np.rad2deg(made.joints - truth.joints)).max() > 1e-3:
        wrong.append("joints")
    if np.abs(made.points - truth.points).max() > 2e-2:
        wrong.append("points")
    if case.rotation and "qw" in made.columns:
        if (rotation_of(made).inv() * rotation_of(truth)).magnitude().max() > 1e-4:
            wrong.append("rotation")
    for name, values in case.covariates.items():
        held = made.columns.get(name)
        if held is not None and np.abs(held - held[0] - values + values[0]).max() > 1e-2:
            wrong.append(name)
    return wrong


def outcome(case: Case, truth, folder: Path) -> str:
    """`right`, `question: ...`, or `wrong: ...`."""
    for name, content in case.tables.items():
        (folder / name).write_bytes(content)
    sources = [folder / name for name in case.tables]
    try:
        made = import_recording(sources, folder / "out", ImportOptions(robot=case.robot))
    except InputError as question:
        return f"question: {question}"
    wrong = mistakes(made.recording, case, truth)
    if case.only_question:
        return "wrong: taken"
    left_out = [name for name in case.covariates if name not in made.recording.columns]
    if case.rotation and "qw" not in made.recording.columns:
        left_out.append("rotation")
    if wrong:
        return "wrong: " + ", ".join(wrong)
    return "right" + (f", without {', '.join(left_out)}" if left_out else "")


def test_there_are_20_variants():
    assert len(CASES) == 20


QUESTIONS = {
    reversed_axes_in_mrad,
    excel_days,
    revolutions,
    left_handed_tracker,
    fixed_width_transforms_in_feet,
}
"""Variants that the import refuses with a sentence that says what to state; all others are read rightly."""


@pytest.mark.parametrize("make", CASES, ids=lambda make: make.__name__)
def test_variant_is_right_or_a_question(make, truth, tmp_path):
    result = outcome(make(truth), truth, tmp_path)
    if make in QUESTIONS:
        assert result.startswith("question: ")
        assert any(name in result for name in make(truth).tables)
    else:
        assert result == "right"
