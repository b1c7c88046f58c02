"""Import of tables as instruments, controllers and scripts write them: read rightly, or refused with the right reason.

The variants were written before they were first imported; most of them were refused then.
"""

import gzip
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import import_recording

JOINTS = [f"J{k}" for k in range(1, 7)]
HEADER = [*JOINTS, "X", "Y", "Z"]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def numbers(truth) -> np.ndarray:
    """(n, 9) deg and mm."""
    return np.column_stack([degrees(truth), truth.points])


def text_of(header, rows, separator=",") -> str:
    lines = [separator.join(header)]
    for row in rows:
        lines.append(
            separator.join(cell if isinstance(cell, str) else f"{cell:.9g}" for cell in row)
        )
    return "\n".join(lines) + "\n"


def joints_file(folder, truth, names=None):
    if names is None:
        return write_rows(folder / "joints.csv", JOINTS, degrees(truth))
    rows = [(name, *row) for name, row in zip(names, degrees(truth))]
    return write_rows(folder / "joints.csv", ["Name", *JOINTS], rows)


def points_file(folder, truth):
    return write_rows(folder / "tracker.csv", ["X", "Y", "Z"], truth.points)


def polish_in_windows_1250(folder, truth):
    header = [*(f"Oś {k} [°]" for k in range(1, 7)), *(f"Położenie {axis} [mm]" for axis in "XYZ")]
    text = "Pomiar nr 3\n" + text_of(header, numbers(truth), ";")
    (folder / "pomiary.csv").write_bytes(text.encode("cp1250"))
    return [folder / "pomiary.csv"]


def utf16_without_mark(folder, truth):
    (folder / "t.txt").write_bytes(text_of(HEADER, numbers(truth), "\t").encode("utf-16-le"))
    return [folder / "t.txt"]


def degrees_minutes_seconds(folder, truth):
    def angle(value):
        rest = abs(value)
        minutes = int(rest * 60) % 60
        seconds = (rest - int(rest) - minutes / 60) * 3600
        return f"{'-' if value < 0 else ''}{int(rest)}°{minutes:02d}'{seconds:08.5f}\""

    rows = [[*map(angle, row[:6]), *map(float, row[6:])] for row in numbers(truth)]
    (folder / "t.csv").write_text(text_of(HEADER, rows, ";"), encoding="utf-8")
    return [folder / "t.csv"]


def fortran_exponents(folder, truth):
    rows = [[f"{value:.10E}".replace("E", "D") for value in row] for row in numbers(truth)]
    (folder / "out.txt").write_text(text_of(HEADER, rows, "  "))
    return [folder / "out.txt"]


def header_repeated_in_the_middle(folder, truth):
    parts = [text_of(HEADER, part) for part in np.array_split(numbers(truth), 2)]
    (folder / "t.csv").write_text("".join(parts))
    return [folder / "t.csv"]


def thousandths_of_an_inch(folder, truth):
    header = [*JOINTS, "X (mil)", "Y (mil)", "Z (mil)"]
    rows = [
        [*row[:6].tolist(), *(f'"{v:,.7f}"' for v in row[6:] / 0.0254)] for row in numbers(truth)
    ]
    (folder / "t.csv").write_text(text_of(header, rows))
    return [folder / "t.csv"]


def quaternion_from_q0_next_to_joints_from_q1(folder, truth):
    turn = Rotation.from_quat(np.stack([truth.columns[f"q{c}"] for c in "xyzw"], axis=1))
    scalar_first = turn.as_quat(scalar_first=True)
    tracker = ["Frame X [mm]", "Frame Y [mm]", "Frame Z [mm]", "Q0", "Qx", "Qy", "Qz"]
    log = write_rows(folder / "log.csv", [f"q{k}" for k in range(1, 7)], truth.joints)
    rows = np.column_stack([truth.points, scalar_first])
    return [log, write_rows(folder / "tmac.csv", tracker, rows, ";")]


def a_row_for_each_axis(folder, truth):
    lines = ["Name,Control,Nom,Meas,Tol,Test"]
    for number, point in enumerate(truth.points):
        for axis, value in zip("XYZ", point):
            lines.append(f"point {number},{axis},{round(value)},{value:.6f},±1.000,Pass")
    (folder / "polyworks.csv").write_text("\n".join(lines), encoding="utf-8")
    names = [f"point {number}" for number in range(truth.n)]
    return [joints_file(folder, truth, names), folder / "polyworks.csv"]


def a_column_for_each_sample(folder, truth):
    rows = [(name, *column) for name, column in zip(HEADER, numbers(truth).T)]
    header = ["quantity", *(f"P{k}" for k in range(truth.n))]
    (folder / "t.csv").write_text(text_of(header, rows))
    return [folder / "t.csv"]


def names_with_and_without_zeros(folder, truth):
    named = [(f"P{k}", *row) for k, row in enumerate(degrees(truth), 1)]
    joints = write_rows(folder / "joints.csv", ["Name", *JOINTS], named)
    rows = [(f"p_{k:03d}", *point) for k, point in enumerate(truth.points, 1)]
    return [joints, write_rows(folder / "p.csv", ["Point", "X", "Y", "Z"], rows[::-1])]


def structure_array_of_matlab(folder, truth):
    from scipy.io import savemat

    made = np.zeros((1, truth.n), dtype=[("q", "O"), ("p", "O"), ("name", "O")])
    for k in range(truth.n):
        made[0, k] = (truth.joints[k][:, None], truth.points[k][:, None], f"P{k}")
    savemat(folder / "meas.mat", {"meas": made})
    return [folder / "meas.mat"]


def json_lines(folder, truth):
    lines = []
    for joints, point in zip(truth.joints, truth.points):
        record = {"joints": joints.tolist(), "tracker": dict(zip("xyz", point.tolist()))}
        lines.append(json.dumps(record))
    (folder / "run.jsonl").write_text("\n".join(lines))
    return [folder / "run.jsonl"]


def packed_with_gzip(folder, truth):
    (folder / "t.csv.gz").write_bytes(gzip.compress(text_of(HEADER, numbers(truth)).encode()))
    return [folder / "t.csv.gz"]


def text_that_is_called_xls(folder, truth):
    (folder / "t.xls").write_text(text_of(HEADER, numbers(truth), "\t"))
    return [folder / "t.xls"]


def urscript(folder, truth):
    moves = [
        f"  movej([{', '.join(map(str, row))}], a=1.2)  # pose" for row in truth.joints.tolist()
    ]
    (folder / "run.script").write_text("\n".join(["def run():", *moves, "end"]))
    return [folder / "run.script", points_file(folder, truth)]


def val3_data(folder, truth):
    lines = ['<Database xmlns="urn:x"><Datas>', '<Data name="j" xsi:type="array" type="joint">']
    for number, row in enumerate(degrees(truth)):
        cells = " ".join(f'j{k}="{value:.8f}"' for k, value in enumerate(row, 1))
        lines.append(f'<Value key="{number}" {cells} />')
    (folder / "cal.dtx").write_text("\n".join([*lines, "</Data></Datas></Database>"]))
    return [folder / "cal.dtx", points_file(folder, truth)]


def lists_in_cells(folder, truth):
    lines = ["joints;point [mm]"]
    for row in numbers(truth).tolist():
        lines.append(f"{row[:6]};({', '.join(map(str, row[6:]))})")
    (folder / "t.csv").write_text("\n".join(lines))
    return [folder / "t.csv"]


READ = [
    polish_in_windows_1250,
    utf16_without_mark,
    degrees_minutes_seconds,
    fortran_exponents,
    header_repeated_in_the_middle,
    thousandths_of_an_inch,
    quaternion_from_q0_next_to_joints_from_q1,
    a_row_for_each_axis,
    a_column_for_each_sample,
    names_with_and_without_zeros,
    structure_array_of_matlab,
    json_lines,
    packed_with_gzip,
    text_that_is_called_xls,
    urscript,
    val3_data,
    lists_in_cells,
]


@pytest.mark.parametrize("write", READ, ids=lambda write: write.__name__)
def test_table_is_read(write, truth, tmp_path):
    made = import_recording(write(tmp_path, truth), tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth, joints=1e-5, points=2e-3)
    if write is quaternion_from_q0_next_to_joints_from_q1:
        assert made.mapping.rotation.convention == "quaternion wxyz"


def test_rows_with_infinite_numbers_are_left_out(truth, tmp_path):
    rows = [[f"{value:.9g}" for value in row] for row in numbers(truth)]
    rows[4][7], rows[9][2] = "inf", "-1.#IND"
    path = write_rows(tmp_path / "t.csv", HEADER, rows)
    made = import_recording([path], tmp_path / "out", UR10)
    assert made.recording.n == truth.n - 2
    assert any("rows 6 and 11" in said or "rows 6, 11" in said for said in made.warnings)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("t.xls", bytes.fromhex("d0cf11e0a1b11ae1") + bytes(999), "a workbook of Excel 97"),
        ("job.jbi", b"/JOB\nC00000=1,2,3,4,5,6\nC00001=1,2,3,4,5,7\n", "pulses of the encoders"),
        ("t.csv.gz", b"no gzip", "a damaged one"),
        ("a.dtx", b"<a><b c='1'></a>", "expected XML"),
        ("a.dtx", b"<!DOCTYPE a [<!ENTITY b 'c'>]><a/>", "entities are not read"),
        ("a.jsonl", b'{"a": 1}\n{"a"\n', "row 2: expected JSON"),
        ("a.script", b"movel(p[0.1, 0.2, 0.3, 0, 0, 0])", "1 poses p"),
    ],
)
def test_file_is_refused_with_its_reason(name, content, reason, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=reason):
        import_recording([tmp_path / name], tmp_path / "out", UR10)
