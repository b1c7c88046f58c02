"""docs/recording-format.md: its examples are read, and it names every key and column that the code knows."""

import re
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

import datasets
from datasets.recording_files import keys
from datasets.recording_files.images import ROLES
from datasets.samples.columns import BOOKKEEPING, FLANGE, KINDS
from good_recordings import write_good
from robot_model import builtin_robots, load_robot
from robot_model.measurements import samples_of
from robot_model.system import bind
from workbench.core.errors import InputError
from workbench.core.robot_files.robot_file import Joint, RobotFile

PAGE = (Path(__file__).parents[1] / "docs" / "recording-format.md").read_text(encoding="utf-8")
BOARD = {"kind": '"chessboard"', "columns": "11", "rows": "8", "square_mm": "5.0"}


def section(heading: str) -> str:
    """The text below a heading of the page, up to the next one of its level or above."""
    level = re.match("#+", heading)[0]
    rest = PAGE.split(f"\n{heading}\n", 1)[1]
    return re.split(rf"\n#{{1,{len(level)}}} ", rest, maxsplit=1)[0]


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, re.S)


def write_example(folder: Path, measures: str) -> None:
    """The example of one kind, with the robot and the artefact of the page."""
    (folder / "robot.toml").write_text(blocks(section("## robot.toml"), "toml")[0])
    (folder / "artefact.csv").write_text(blocks(section("## artefact.csv"), "csv")[0])
    tables = blocks(section(f"#### `{measures}`"), "csv")
    lines = [
        'format = "recording/1"',
        f'measures = "{measures}"',
        "[robot]",
        'file = "robot.toml"',
        "[artefact]",
        'file = "artefact.csv"',
        "[samples]",
        'file = "samples.csv"',
    ]
    if KINDS[measures].images:
        lines += [
            "[images]",
            'file = "images.csv"',
            "[board]",
            *(f"{k} = {v}" for k, v in BOARD.items()),
        ]
        write_images(folder, tables.pop(0))
    (folder / "samples.csv").write_text(tables[0])
    (folder / "recording.toml").write_text("\n".join(lines))


def write_images(folder: Path, table: str) -> None:
    (folder / "images").mkdir()
    (folder / "images.csv").write_text(table)
    for row in table.splitlines()[1:]:
        cv2.imwrite(str(folder / row.split(",")[0]), np.zeros((12, 16), np.uint8))


@pytest.mark.parametrize("measures", KINDS)
def test_the_example_of_every_kind_reads(tmp_path, measures):
    write_example(tmp_path, measures)
    recording = datasets.read(tmp_path)
    assert recording.n > 0 and recording.warnings == ()
    assert len(recording.images) == (
        0 if not KINDS[measures].images else {"board-images": 2, "scan-images": 5}[measures]
    )


def test_the_example_of_recording_toml_reads(tmp_path):
    write_example(tmp_path, "ball-centre")
    (tmp_path / "recording.toml").write_text(blocks(section("## recording.toml"), "toml")[0])
    assert datasets.read(tmp_path).sigma_mm == 0.02


def test_readings_become_joint_variables_as_the_page_says():
    robot = load_robot(tomllib.loads(blocks(section("## robot.toml"), "toml")[0]))
    np.testing.assert_allclose(robot.mixing @ [0.2, 0.3, 40.0], [0.2, -0.3 + 0.5 * 0.2, 40.0])


def test_the_page_names_every_key_and_column():
    known = {
        *keys.RECORDING,
        *RobotFile.model_fields,
        *Joint.model_fields,
        *BOOKKEEPING,
        *FLANGE,
        *ROLES,
        *KINDS,
        *builtin_robots(),
    }
    known |= {name for wanted in keys.SECTIONS.values() for name in wanted}
    known |= {name for kind in KINDS.values() for name in kind.columns}
    missing = [
        name
        for name in sorted(known - {"set"})
        if not re.search(rf"(?<!\w){re.escape(name)}(?!\w)", PAGE)
    ]
    assert missing == []


def test_a_key_of_the_robot_in_other_words_names_the_key(tmp_path):
    write_example(tmp_path, "external-point")
    text = (tmp_path / "robot.toml").read_text()
    (tmp_path / "robot.toml").write_text(text.replace('kind = "prismatic"', 'type = "prismatic"'))
    with pytest.raises(
        InputError, match="joint 3, key type is not known .* found type; rename it to kind"
    ):
        datasets.read(tmp_path)


def test_three_sigmas_state_the_noise_without_sigma_mm(tmp_path):
    folder = write_good(tmp_path / "good", "external-point")
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(text.replace("sigma_mm = 0.02\n", ""))
    head, *rows = (folder / "samples.csv").read_text().splitlines()
    cells = [head + ",sigma_x_mm,sigma_y_mm,sigma_z_mm", *(f"{row},0.1,0.1,0.4" for row in rows)]
    (folder / "samples.csv").write_text("\n".join(cells))
    recording = datasets.read(folder)
    np.testing.assert_allclose(recording.sigma, np.sqrt(0.06))
    chain = bind(load_robot(recording.robot), samples_of(recording))
    assert not chain.sigma_unknown
    np.testing.assert_allclose(chain.sigma[:, 0], [0.1, 0.1, 0.4])


def test_the_complete_axis_of_a_partial_pose_is_taken(tmp_path):
    folder = write_good(tmp_path / "good", "partial-pose")
    head, *rows = (folder / "samples.csv").read_text().splitlines()
    head = head.replace(",nx,ny,nz", ",ox,oy,oz") + ",nx"
    (folder / "samples.csv").write_text("\n".join([head, *(f"{row},0.5" for row in rows)]))
    recording = datasets.read(folder)
    assert bind(load_robot(recording.robot), samples_of(recording)).measurement.axis_number == 1


URDF = """<robot name="a"><link name="b"/><link name="c"/>
<joint name="j" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/></joint></robot>"""


def with_urdf(folder: Path, gravity: str, file: str = 'file = "robot.urdf"') -> Path:
    folder = write_good(folder, "board-images")
    (folder / "robot.urdf").write_text(URDF)
    (folder / "samples.csv").write_text("sample,q1_deg\n1,10\n")
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(
        text.replace('file = "robot.toml"', f"{file}\ngravity = {gravity}")
    )
    return folder


def test_gravity_of_a_urdf_is_read(tmp_path):
    recording = datasets.read(with_urdf(tmp_path / "good", "[0.0, 0.0, 1.0]"))
    np.testing.assert_allclose(load_robot(recording.robot).gravity, [0, 0, 1])


@pytest.mark.parametrize("file", ['file = "robot.toml"', 'builtin = "ur10"'])
def test_gravity_of_another_robot_belongs_to_its_file(tmp_path, file):
    with pytest.raises(
        InputError, match=r"key robot.gravity: expected this key for a URDF only, .* robot.toml"
    ):
        datasets.read(with_urdf(tmp_path / "good", "[0.0, 0.0, 1.0]", file))


def with_payload(folder: Path, robot: str, section: str) -> Path:
    folder = write_good(folder, "external-point")
    text = (folder / "recording.toml").read_text()
    payload = f"[{section}]\nmass_kg = 0.5\ncom_mm = [0.0, 0.0, 150.0]\n"
    (folder / "recording.toml").write_text(
        text.replace('file = "robot.toml"', robot) + f"\n{payload}"
    )
    return folder


def test_a_built_in_robot_has_the_tool_that_the_recording_states(tmp_path):
    recording = datasets.read(
        with_payload(tmp_path / "good", 'builtin = "kuka_kr10_r1100"', "robot.payload")
    )
    robot = load_robot(recording.robot)
    plain = load_robot("kuka_kr10_r1100")
    assert robot.payload_mass == 0.5 and robot.payload_com.tolist() == [0, 0, 150]
    np.testing.assert_array_equal(robot.geometry, plain.geometry)


@pytest.mark.parametrize(
    ("robot", "section", "words"),
    [
        ('builtin = "ur10"', "payload", r"\[payload\]: expected this section in robot.toml"),
        ('file = "robot.toml"', "payload", r"\[payload\]: expected this section in robot.toml"),
        ('file = "robot.toml"', "robot.payload", r"write \[payload\] into the robot file"),
    ],
)
def test_a_payload_where_it_has_no_effect_is_refused(tmp_path, robot, section, words):
    with pytest.raises(InputError, match=words):
        datasets.read(with_payload(tmp_path / "good", robot, section))
