"""Denavit-Hartenberg tables as people keep them, and robot files that cannot be read as they are."""

import json

import pytest

from datasets.importers.sources.dh_tables import is_dh_table, read_dh_table
from workbench.core.errors import InputError
from workbench.recordings.importing.robots import robot_candidates

ROWS = [(0, 412, 63, -90), (-90, 0, 455, 0), (0, 0, 41, -90), (0, 437, 0, 90)]
KEYS = ("theta", "d", "a", "alpha")


def markdown():
    rows = "".join(
        f"| {k} | q{k}{theta or ''} | {d} | {a} | {alpha} |\n"
        for k, (theta, d, a, alpha) in enumerate(ROWS, 1)
    )
    return f"| Joint | theta | d (mm) | a (mm) | alpha (deg) |\n|---|---|--:|---|---|\n{rows}"


def in_metres():
    return [dict(zip(KEYS, (theta, d / 1000, a / 1000, alpha))) for theta, d, a, alpha in ROWS]


def yaml():
    rows = "".join(f"  - {json.dumps(row)}\n" for row in in_metres())
    return f"name: own arm\ndh:\n{rows}"


def toml():
    rows = "".join(
        "[[dh]]\n" + "".join(f"{key} = {value}\n" for key, value in row.items())
        for row in in_metres()
    )
    return f'convention = "as in the book"\n{rows}'


FILES = {
    "arm_standard.md": markdown,
    "arm_standard.yaml": yaml,
    "arm_standard.toml": toml,
    "arm_standard.json": lambda: json.dumps(in_metres()),
}


@pytest.mark.parametrize("name", FILES)
def test_a_table_of_any_format_is_read(tmp_path, name):
    (tmp_path / name).write_text(FILES[name]())
    assert is_dh_table(tmp_path / name)
    (robot,) = read_dh_table(tmp_path / name)
    found = [
        (joint["theta_deg"], joint["d_mm"], joint["a_mm"], joint["alpha_deg"])
        for joint in robot["joint"]
    ]
    assert found == [pytest.approx(row) for row in ROWS]


def test_a_robot_file_is_no_table(tmp_path):
    rows = "".join(f"[[joint]]\nd_mm = {k}\n" for k in range(3))
    (tmp_path / "robot.toml").write_text(f'name = "x"\n{rows}')
    assert not is_dh_table(tmp_path / "robot.toml")


@pytest.mark.parametrize("name", ["arm.urdf.xacro", "arm.urdf"])
def test_macros_of_xacro_are_refused_with_what_to_do(tmp_path, name):
    (tmp_path / name).write_text('<robot name="a"><xacro:arm prefix="$(arg p)"/></robot>')
    with pytest.raises(InputError, match=f"xacro {name} > robot.urdf"):
        robot_candidates(str(tmp_path / name), "t.csv")
