"""Joint positions in the notations of controllers: programs, variable files and logs, from an own table of readings."""

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.importers.sources.choice import read_sources

READINGS = np.round(np.random.default_rng(8).uniform(-170, 170, (5, 6)), 3)
NO_AXES = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"


def joined(row, separator=", "):
    return separator.join(f"{value:.3f}" for value in row)


def keyed(letter, row, form="{}{} {:.3f}", separator=", "):
    return separator.join(form.format(letter, k, value) for k, value in enumerate(row, 1))


def registers(row, number):
    cells = [f"J{k} = {value:9.3f} deg" for k, value in enumerate(row, 1)]
    lines = f"  {'   '.join(cells[:3])}\n  {'   '.join(cells[3:])} \n\n"
    return f"    [1,{number}] =   'pt {number}'   Group: 1\n{lines}"


def each(form):
    return "".join(form(row, number) for number, row in enumerate(READINGS, 1))


FILES = {
    "array.dat": "DECL E6AXIS P[5]\n" + each(lambda q, k: f"P[{k}]={{{keyed('A', q)},E1 0.0}}\n"),
    "krc.log": each(
        lambda q, k: f"2026-03-02 10:0{k}:05 $AXIS_ACT={{E6AXIS: {keyed('A', q)}, E1 0.0}}\n"
    ),
    "Data.mod": "CONST jointtarget jt{5}:=["
    + each(lambda q, k: f"{',' * (k > 1)}[[{joined(q)}],{NO_AXES}]\n")
    + "];\n",
    "joints.log": each(lambda q, k: f"jpos{k}: [[{joined(q)}],{NO_AXES}]\n"),
    "posreg.va": "[*POSREG*]$POSREG  Storage: CMOS  Access: RW  : ARRAY[1,9] OF Position Reg\n"
    + each(registers)
    + "    [1,6] =   '' Uninitialized\n",
    "cal.prg": "1 Mov J1\n2 End\n"
    + each(lambda q, k: f"J{k}=({joined(q, ',')},+0.00,+0.00)\n")
    + "P1=(1.0,2.0,3.0,4.0,5.0,6.0)(7,0)\n",
    "cal.as": ".JOINTS\n" + each(lambda q, k: f"#p{k} {joined(q, ' ')}\n") + ".END\n",
    "poses.drl": each(lambda q, k: f"p{k} = posj({joined(q)})\n") + "movej(p1, v=30, a=30)\n",
    "tm.txt": each(lambda q, k: f'PTP("JPP",{joined(q)},100,200,0,false)\n'),
}


@pytest.mark.parametrize("name", FILES)
def test_joint_positions_are_read_in_degrees(tmp_path, name):
    (tmp_path / name).write_text(FILES[name])
    (table,) = read_sources([tmp_path / name], tmp_path).tables
    joints = [column for column in table.columns if column.startswith("J")]
    assert joints == [f"J{k} [deg]" for k in range(1, 7)]
    assert np.allclose(np.stack([table.columns[one] for one in joints], 1), READINGS, atol=1e-9)
    assert ("time" in table.columns) == (name == "krc.log")


def test_external_axis_that_moves_is_kept_without_a_unit(tmp_path):
    lines = [f"P[{k}]={{{keyed('A', q)},E1 {100 * k}.5,E2 7.0}}" for k, q in enumerate(READINGS)]
    (tmp_path / "track.dat").write_text("\n".join(lines))
    (table,) = read_sources([tmp_path / "track.dat"], tmp_path).tables
    assert list(table.columns)[-1] == "E1"
    assert table.columns["E1"][2] == 200.5


def test_poses_of_the_tool_are_counted(tmp_path):
    (tmp_path / "cal.prg").write_text(FILES["cal.prg"])
    (table,) = read_sources([tmp_path / "cal.prg"], tmp_path).tables
    assert table.warnings == ("cal.prg: poses of the tool are not read (1 of them).",)


def test_frames_of_a_tool_are_no_positions(tmp_path):
    (tmp_path / "config.dat").write_text(
        "".join(f"TOOL_DATA[{k}]={{X 0.0,Y 0.0,Z {k}.0,A 0.0,B 0.0,C 0.0}}\n" for k in range(1, 9))
    )
    with pytest.raises(InputError):
        read_sources([tmp_path / "config.dat"], tmp_path)
