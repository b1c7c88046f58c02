"""Tool and frame that only the controller knows (FANUC UT : 2, KUKA TOOL_DATA[5]), stated by a mapping."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.mapping.model import mapping_from_keys, read_mapping, write_mapping
from datasets.importers.sources.programs.program_frames import StatedFrames
from datasets.importers.sources.programs.program_patch import patched_program
from datasets.importers.user_tables import frames_of, read_targets
from datasets.recording_files.schemas import mapping_schema
from robot_model import load_robot
from robot_model.state import sliding
from workbench.core.errors import InputError
from workbench.core.text.sections import Placement

SLIDING = sliding(load_robot("abb_irb120")).tolist()
TOOL = Placement(xyz_mm=[12.0, -30.0, 145.0], rpy_deg=[20.0, -35.0, 50.0])
USER = Placement(xyz_mm=[700.0, 150.0, -90.0], rpy_deg=[1.0, -2.0, 30.0])
FLANGE = Placement(xyz_mm=[410.0, -120.0, 530.0], rpy_deg=[170.0, 10.0, -60.0]).matrix
SEEN = np.linalg.inv(USER.matrix) @ FLANGE @ TOOL.matrix
"""(4, 4) pose of the tool in the user frame, as the controller stores it."""


def keys(name, sequence, pose=SEEN) -> str:
    angles = Rotation.from_matrix(pose[:3, :3]).as_euler(sequence, degrees=True)
    between, unit, end = (" = ", " mm", " deg") if name == "FANUC" else (" ", "", "")
    letters = "XYZWPR" if name == "FANUC" else "XYZABC"
    units = [unit] * 3 + [end] * 3
    numbers = [*pose[:3, 3], *angles]
    return ", ".join(f"{a}{between}{v:.6f}{u}" for a, v, u in zip(letters, numbers, units))


def fanuc(user=3, tool=2, pose=SEEN) -> str:
    body = keys("FANUC", "xyz", pose)
    return f"/POS\nP[1]{{\n GP1:\n UF : {user}, UT : {tool}, CONFIG : 'N U T, 0, 0, 0',\n {body}\n}};\n/END\n"


def krl(*lines) -> str:
    return "\n".join(["DEF p()", *lines, f"LIN {{{keys('KUKA', 'ZYX')}}}", "END"])


def as_keys(placement):
    """The section of one placement, or of several by number."""
    if isinstance(placement, dict):
        return {number: one.model_dump() for number, one in placement.items()}
    return placement.model_dump()


def mapping(**placements):
    made = {name: as_keys(one) for name, one in placements.items()}
    return mapping_from_keys({"format": "import/1", **made}, "map.toml")


KRL = ["$TOOL=TOOL_DATA[5]", "$BASE=BASE_DATA[1]"]
CASES = [("job.ls", fanuc()), ("p.src", krl(*KRL))]


@pytest.mark.parametrize("name, text", CASES)
def test_stated_frames_give_the_pose_of_the_flange(name, text, tmp_path):
    path = tmp_path / name
    path.write_text(text)
    (table,) = read_targets(path, SLIDING, mapping(tool=TOOL, frame=USER))
    place = [table.columns[axis][0] for axis in ("x_mm", "y_mm", "z_mm")]
    turn = [table.columns[part][0] for part in ("qw", "qx", "qy", "qz")]
    np.testing.assert_allclose(place, FLANGE[:3, 3], atol=1e-4)
    found = Rotation.from_quat(turn, scalar_first=True).as_matrix()
    np.testing.assert_allclose(found, FLANGE[:3, :3], atol=1e-6)


@pytest.mark.parametrize("name, text", CASES)
def test_what_nobody_states_is_asked_for(name, text, tmp_path):
    path = tmp_path / name
    path.write_text(text)
    for stated in (None, mapping(tool=TOOL), mapping(frame=USER)):
        with pytest.raises(
            InputError, match=r"expected poses of the flange.*\[tool\] and \[frame\]"
        ):
            read_targets(path, SLIDING, stated)


def test_a_frame_of_the_file_needs_no_statement(tmp_path):
    path = tmp_path / "job.ls"
    path.write_text(fanuc(user=0, pose=FLANGE @ TOOL.matrix))
    (table,) = read_targets(path, SLIDING, mapping(tool=TOOL))
    np.testing.assert_allclose(table.columns["x_mm"], FLANGE[0, 3], atol=1e-4)


@pytest.mark.parametrize(
    "name, text",
    [
        ("job.ls", fanuc() + fanuc(tool=4)),
        ("p.src", krl(*KRL, "$TOOL=TOOL_DATA[6]")),
    ],
)
def test_one_statement_does_not_hold_for_two_tools(name, text, tmp_path):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match="expected poses of the flange"):
        read_targets(path, SLIDING, mapping(tool=TOOL, frame=USER))


def test_a_patched_program_holds_poses_of_the_stated_tool(tmp_path):
    """The flange moves by 1 mm: so does the tool, in the axes of the user frame."""
    path = tmp_path / "job.ls"
    path.write_text(fanuc())
    moved = FLANGE.copy()
    moved[:3, 3] += USER.matrix[:3, :3] @ [1.0, 0.0, 0.0]
    stated = StatedFrames({"": TOOL.matrix}, {"": USER.matrix})
    made = patched_program(path, "FANUC", np.zeros((1, 6)), moved[None], stated)
    path.write_bytes(made.content)
    (table,) = read_targets(path, SLIDING, mapping(tool=TOOL, frame=USER))
    np.testing.assert_allclose(table.columns["x_mm"], moved[0, 3], atol=2e-3)
    assert f"X = {SEEN[0, 3] + 1:.3f}" in made.content.decode()


def test_a_mapping_file_keeps_its_frames(tmp_path):
    stated = mapping(tool=TOOL, frame=USER)
    write_mapping(stated, tmp_path / "map.toml")
    again = read_mapping(tmp_path / "map.toml")
    np.testing.assert_array_equal(frames_of(again).tools[""], TOOL.matrix)
    assert {"tool", "frame"} <= set(mapping_schema()["properties"])


def test_each_position_of_fanuc_has_the_tool_of_its_number(tmp_path):
    other = Placement(xyz_mm=[0.0, 50.0, 210.0], rpy_deg=[0.0, 90.0, 0.0])
    seen = np.linalg.inv(USER.matrix) @ FLANGE @ other.matrix
    path = tmp_path / "job.ls"
    path.write_text(fanuc() + fanuc(tool=4, pose=seen).replace("P[1]", "P[2]"))
    stated = mapping(tool={"2": TOOL, "4": other}, frame=USER)
    (table,) = read_targets(path, SLIDING, stated)
    place = np.stack([table.columns[axis] for axis in ("x_mm", "y_mm", "z_mm")], 1)
    np.testing.assert_allclose(place, np.tile(FLANGE[:3, 3], (2, 1)), atol=1e-4)
    write_mapping(stated, tmp_path / "map.toml")
    assert read_mapping(tmp_path / "map.toml") == stated
    with pytest.raises(InputError, match="UT : 4"):
        read_targets(path, SLIDING, mapping(tool={"2": TOOL}, frame=USER))


def test_a_number_of_kuka_is_that_of_its_tool_data(tmp_path):
    path = tmp_path / "p.src"
    path.write_text(krl(*KRL))
    (table,) = read_targets(path, SLIDING, mapping(tool={"5": TOOL}, frame={"1": USER}))
    np.testing.assert_allclose(table.columns["x_mm"], FLANGE[0, 3], atol=1e-4)
    with pytest.raises(InputError, match=r"TOOL_DATA\[5\] without a value"):
        read_targets(path, SLIDING, mapping(tool={"6": TOOL}, frame=USER))


@pytest.mark.parametrize(
    "keys_of_tool", [{}, {"xyz": [0, 0, 1]}, {"xyz_mm": [0, 0]}, {"rpy_deg": "90"}, 7]
)
def test_placements_that_cannot_be_are_refused(keys_of_tool):
    with pytest.raises(InputError, match=r"map.toml, \[tool\].*expected"):
        mapping_from_keys({"format": "import/1", "tool": keys_of_tool}, "map.toml")


def test_frames_belong_to_robot_programs(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("x_mm,y_mm,z_mm,qw,qx,qy,qz\n1,2,3,1,0,0,0\n4,5,6,1,0,0,0\n")
    with pytest.raises(InputError, match="for a robot program"):
        read_targets(path, SLIDING, mapping(tool=TOOL))
