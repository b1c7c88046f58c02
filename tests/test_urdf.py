"""The arm of a URDF is its URDF's, to 1e-9 mm, and a broken URDF gets one sentence."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from plain_frames import frames_of, place
from robot_model import load_robot
from workbench.core.errors import InputError

ROUND = [
    (0, 0, 0),
    (np.pi / 2, 0, 0),
    (0, -np.pi / 2, 0),
    (0, 0, np.pi / 2),
    (np.pi, 0, 0),
    (1.5708, 0, 1.571),
    (3e-6, -2e-6, 1),
]


def element(parent, tag, **attributes):
    return ET.SubElement(
        parent,
        tag,
        {key: " ".join(map(str, np.atleast_1d(value))) for key, value in attributes.items()},
    )


def some_place(parent, rng):
    rpy = ROUND[rng.integers(len(ROUND))] if rng.random() < 0.7 else rng.uniform(-3, 3, 3)
    xyz = rng.uniform(-0.8, 0.8, 3) * rng.integers(0, 2, 3)
    element(parent, "origin", xyz=xyz, rpy=rpy)


def some_link(robot, name, rng):
    link = element(robot, "link", name=name)
    if rng.random() < 0.6:
        inertial = element(link, "inertial")
        some_place(inertial, rng)
        element(inertial, "mass", value=rng.uniform(0.1, 9))
        element(inertial, "inertia", ixx=1, ixy=0, ixz=0, iyy=1, iyz=0, izz=1)


def some_urdf(seed):
    """A chain of one to nine joints of any kind, with a fixed tip and branches that hang on it."""
    rng = np.random.default_rng(seed)
    robot = ET.Element("robot", name="some")
    some_link(robot, "l0", rng)
    kinds = list(
        rng.choice(
            ["revolute", "continuous", "prismatic", "fixed"],
            rng.integers(1, 10),
            p=[0.5, 0.1, 0.2, 0.2],
        )
    )
    kinds.insert(rng.integers(0, len(kinds) + 1), "revolute")
    for k, kind in enumerate([*kinds, "fixed"], 1):
        some_link(robot, f"l{k}", rng)
        joint = element(robot, "joint", name=f"j{k}", type=kind)
        element(joint, "parent", link=f"l{k - 1}")
        element(joint, "child", link=f"l{k}")
        some_place(joint, rng)
        axis = (
            rng.choice([-1, 1]) * np.eye(3)[rng.integers(3)]
            if rng.random() < 0.7
            else rng.normal(size=3)
        )
        # the peer moves a slide by its axis times the reading, so that one's length must be 1
        element(joint, "axis", xyz=axis / np.linalg.norm(axis) if kind == "prismatic" else axis)
        element(joint, "limit", lower=-1.5, upper=2.5, effort=1, velocity=1)
    hang(robot, f"l{rng.integers(len(kinds) + 1)}", rng)
    return robot


def hang(robot, link, rng):
    """A side branch: its mass belongs to the link that it hangs on."""
    some_link(robot, "side", rng)
    joint = element(robot, "joint", name="hinge", type="revolute")
    element(joint, "parent", link=link)
    element(joint, "child", link="side")
    some_place(joint, rng)


def numbers(parent, tag, key, otherwise):
    found = parent.find(tag)
    return (
        np.array(otherwise, float)
        if found is None or key not in found.attrib
        else np.array(found.get(key).split(), float)
    )


def origin(parent):
    return place(
        Rotation.from_euler("xyz", numbers(parent, "origin", "rpy", [0] * 3)),
        numbers(parent, "origin", "xyz", [0] * 3),
    )


def link_places(robot, values):
    """Every link (4, 4) in metres when joints stand at `values` (rad, m); parents come before children."""
    places = {"l0": np.eye(4)}
    for joint in robot.findall("joint"):
        q, axis = values.get(joint.get("name"), 0.0), numbers(joint, "axis", "xyz", [1, 0, 0])
        axis = axis / np.linalg.norm(axis)
        move = (
            place(shift=q * axis)
            if joint.get("type") == "prismatic"
            else place(Rotation.from_rotvec(q * axis))
        )
        parent, child = joint.find("parent").get("link"), joint.find("child").get("link")
        places[child] = places[parent] @ origin(joint) @ move
    return places


def last_link(robot):
    return max(
        int(link.get("name")[1:]) for link in robot.findall("link") if link.get("name") != "side"
    )


def moving(robot):
    return [
        j for j in robot.findall("joint") if j.get("type") != "fixed" and j.get("name") != "hinge"
    ]


def write(robot, folder):
    file = folder / "some.urdf"
    file.write_text(ET.tostring(robot, encoding="unicode"))
    return file


def some_pose(robot, seed):
    """Readings in mm and rad for the arm, and the same by name in m and rad for the URDF."""
    rng = np.random.default_rng(seed)
    values = {joint.get("name"): rng.uniform(-1.5, 1.5) for joint in moving(robot)}
    units = [1000.0 if joint.get("type") == "prismatic" else 1.0 for joint in moving(robot)]
    return np.array(list(values.values())) * units, values


def in_mm(frame):
    return np.block([[frame[:3, :3], 1000 * frame[:3, 3:]], [frame[3:]]])


def centre_of(masses, centres):
    return np.einsum("k,ki->i", masses, centres) if len(masses) else np.zeros(3)


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_urdfs_arm_is_its_urdfs(seed, tmp_path_factory):
    """Flange to 1e-9 mm, and the first moment of all that moves, in any pose."""
    urdf = some_urdf(seed)
    tip = last_link(urdf)
    robot = load_robot({"urdf": write(urdf, tmp_path_factory.getbasetemp()), "tip": f"l{tip}"})
    readings, values = some_pose(urdf, seed)
    frames, places = frames_of(robot, readings), link_places(urdf, values)
    expected = in_mm(places[f"l{tip}"])
    np.testing.assert_allclose(frames[-1][:3, 3], expected[:3, 3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(frames[-1][:3, :3], expected[:3, :3], rtol=0, atol=1e-12)
    first = min(int(joint.get("name")[1:]) for joint in moving(urdf))
    moved = [f"l{k}" for k in range(first, tip + 1)]
    hung = urdf.find("joint[@name='hinge']/parent").get("link")
    bodies = [urdf.find(f"link[@name='{name}']") for name in moved + ["side"] * (hung in moved)]
    bodies = [body for body in bodies if body.find("inertial") is not None]
    kg = np.array([numbers(body.find("inertial"), "mass", "value", [0])[0] for body in bodies])
    centres = [in_mm(places[b.get("name")] @ origin(b.find("inertial")))[:3, 3] for b in bodies]
    own = [(frame @ [*com, 1])[:3] for frame, com in zip(frames[1:], robot.com)]
    assert robot.mass.sum() == pytest.approx(kg.sum())
    np.testing.assert_allclose(
        centre_of(robot.mass, own), centre_of(kg, centres), rtol=0, atol=1e-7
    )


def test_parallel_axes_take_hayatis_form(tmp_path):
    """Also axes that a rounded angle of the URDF leaves parallel to a few microradians."""
    robot = ET.Element("robot", name="three")
    for k in range(5):
        element(robot, "link", name=f"l{k}")
    for k, rpy in enumerate([(0, 0, 0), (1.570796, 0, 0), (0, 0, 0.3), (3e-6, 0, 0)], 1):
        joint = element(robot, "joint", name=f"j{k}", type="revolute")
        element(joint, "parent", link=f"l{k - 1}")
        element(joint, "child", link=f"l{k}")
        element(joint, "origin", xyz=(0.3, 0.1, 0.05), rpy=rpy)
        element(joint, "axis", xyz=(0, 0, 1))
    arm = load_robot(write(robot, tmp_path))
    assert list(arm.hayati) == [False, True, True, False]
    assert np.abs(arm.geometry[:, [1, 2]]).max() < 1000
    assert arm.geometry[1, 1] == arm.geometry[2, 1] == 0


def test_an_upright_arm_needs_no_base_and_no_flange(tmp_path):
    robot = ET.Element("robot", name="one")
    for name in ("base", "l1", "tool"):
        element(robot, "link", name=name)
    for name, kind, parent, child, xyz in (
        ("j", "revolute", "base", "l1", (0, 0, 0.4)),
        ("f", "fixed", "l1", "tool", (0.2, 0, 0.1)),
    ):
        joint = element(robot, "joint", name=name, type=kind)
        element(joint, "parent", link=parent)
        element(joint, "child", link=child)
        element(joint, "origin", xyz=xyz)
        element(joint, "axis", xyz=(0, 0, 1))
    arm = load_robot(write(robot, tmp_path))
    assert np.array_equal(arm.base, np.eye(4)) and np.array_equal(arm.flange, np.eye(4))
    np.testing.assert_allclose(arm.geometry, [[0, 500, 200, 0, 0]], atol=1e-12)


def test_a_mimic_joint_follows_its_reading(tmp_path):
    """A column of two segments that share one reading, the second also over a spec of its own."""
    robot = ET.Element("robot", name="column")
    for k in range(4):
        element(robot, "link", name=f"l{k}")
    element(robot, "link", name="pseudo")
    for name, kind, parent, child in (
        ("lift", "prismatic", "l0", "pseudo"),
        ("low", "prismatic", "l0", "l1"),
        ("high", "prismatic", "l1", "l2"),
        ("turn", "revolute", "l2", "l3"),
    ):
        joint = element(robot, "joint", name=name, type=kind)
        element(joint, "parent", link=parent)
        element(joint, "child", link=child)
        element(joint, "axis", xyz=(0, 0, 1))
        element(joint, "limit", lower=0.5, upper=2, effort=1, velocity=1)
        if name in ("low", "high"):
            element(joint, "mimic", joint="lift", multiplier=0.5, offset=-0.1)
    arm = load_robot({"urdf": write(robot, tmp_path), "joints": ["turn", "lift"], "tip": "l3"})
    assert arm.mixing.tolist() == [[0, 0.5], [0, 0.5], [1, 0]]
    np.testing.assert_allclose(arm.limits, [[0.5, 2], [500, 2000]])
    flange = frames_of(arm, np.array([0.3, 1200.0]))[-1]
    expected = link_places(robot, {"low": 0.5, "high": 0.5, "turn": 0.3})["l3"]
    np.testing.assert_allclose(flange, in_mm(expected), atol=1e-9)
    spec = {
        "urdf": write(robot, tmp_path),
        "tip": "l3",
        "mimic": {"turn": {"joint": "lift", "ratio": 2.0}},
    }
    arm = load_robot(spec)
    np.testing.assert_allclose(arm.mixing, [[0.5], [0.5], [0.002]])


def test_joints_that_are_not_named_stand_still(tmp_path):
    urdf = some_urdf(11)
    names = [joint.get("name") for joint in moving(urdf)]
    tip = last_link(urdf)
    arm = load_robot({"urdf": write(urdf, tmp_path), "joints": names[-1:], "tip": f"l{tip}"})
    readings, values = some_pose(urdf, 11)
    flange = frames_of(arm, readings[-1:])[-1]
    expected = link_places(urdf, {names[-1]: values[names[-1]]})[f"l{tip}"]
    np.testing.assert_allclose(flange, in_mm(expected), atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_a_peer_reads_the_urdf_the_same_way(seed, tmp_path):
    yourdfpy = pytest.importorskip("yourdfpy")
    urdf = some_urdf(seed)
    tip = last_link(urdf)
    file = write(urdf, tmp_path)
    robot = load_robot({"urdf": file, "tip": f"l{tip}"})
    readings, values = some_pose(urdf, seed)
    peer = yourdfpy.URDF.load(str(file), load_meshes=False, load_collision_meshes=False)
    peer.update_cfg(values)
    np.testing.assert_allclose(
        frames_of(robot, readings)[-1], in_mm(peer.get_transform(f"l{tip}", "l0")), atol=1e-9
    )


def test_a_real_construction_robot_is_read(real):
    """A column of two mimic segments, an arm with rounded angles, masses and side branches."""
    file = real("hilti_jaibot_tilt") / "data" / "trailblazer.urdf"
    names = ["column_prismatic_joint", *(f"dsr_joint{k}" for k in range(1, 7))]
    robot = load_robot({"urdf": str(file), "joints": names, "tip": "prism"})
    urdf = ET.parse(file).getroot()
    reading = np.array([2100.0, 0.4, -0.6, 1.1, 0.3, -0.9, 2.0])
    values = dict(zip(names, [2.1, *reading[1:]])) | {
        "column_middle_joint": 2.1 / 2 - 0.706,
        "column_top_joint": 2.1 / 2 - 0.736,
    }
    expected = places_from(urdf, values)["prism"]
    np.testing.assert_allclose(frames_of(robot, reading)[-1], in_mm(expected), atol=1e-9)
    assert robot.mixing.shape == (8, 7)
    assert list(robot.prismatic) == [True, True] + [False] * 6
    assert list(robot.hayati) == [True, False, False, True, False, False, False, False]


def places_from(urdf, values):
    """As link_places, for a file whose joints stand in any order and whose root has its own name."""
    joints = {joint.find("child").get("link"): joint for joint in urdf.findall("joint")}
    links = {link.get("name") for link in urdf.findall("link")}

    def depth(joint):
        parent = joint.find("parent").get("link")
        return 0 if parent not in joints else 1 + depth(joints[parent])

    for joint in urdf.findall("joint"):
        if joint.find("parent").get("link") in links - set(joints):
            joint.find("parent").set("link", "l0")
    ordered = ET.Element("robot")
    ordered.extend(sorted(urdf.findall("joint"), key=depth))
    return link_places(ordered, values)


URDF = """<robot name="r"><link name="a"/><link name="b"/><link name="c"/>
<joint name="j1" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 1" rpy="0 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="j2" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 1 0"/></joint></robot>"""
BROKEN_URDF = {
    "not XML": ("</robot>", "", {}, "XML"),
    "not a robot": ('<robot name="r">', '<model name="r">', {}, "root element robot|XML"),
    "xacro": (
        '<link name="a"/>',
        '<link name="a"/><xacro xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arm/></xacro>',
        {},
        "xacro",
    ),
    "two numbers": ('xyz="0 0 1" rpy', 'xyz="0 1" rpy', {}, "joint j1, origin xyz: expected 3"),
    "words": ('rpy="0 0 0"', 'rpy="0 0 pi"', {}, "origin rpy.*pi"),
    "nan": ('rpy="0 0 0"', 'rpy="0 0 nan"', {}, "finite"),
    "no axis": ('xyz="0 1 0"', 'xyz="0 0 0"', {}, "joint j2: expected an axis"),
    "no child": ('<child link="c"/>', "", {}, "joint j2: expected name, type, parent and child"),
    "a ghost": (
        '<child link="c"/>',
        '<child link="d"/>',
        {},
        "joint j2: expected links of this file",
    ),
    "stray": ('<link name="c"/>', '<link name="c"/><link name="d"/>', {}, "tree"),
    "loop": ('<parent link="a"/>', '<parent link="c"/>', {}, "loop|tree"),
    "floating": (
        'name="j2" type="revolute"',
        'name="j2" type="floating"',
        {},
        "joint j2, type: .*floating",
    ),
    "rigid": ('type="revolute"', 'type="fixed"', {}, "a joint that moves"),
    "mimics a ghost": ('<axis xyz="0 1 0"/>', '<mimic joint="j9"/>', {}, "j9"),
    "mimics itself": ('<axis xyz="0 1 0"/>', '<mimic joint="j2"/>', {}, "circle"),
    "unknown tip": ("", "", {"tip": "z"}, "tip.*z; choose among a, b, c"),
    "unknown joint": ("", "", {"joints": ["j7"]}, "j7; choose among j1, j2"),
    "a joint twice": ("", "", {"joints": ["j1", "j1"]}, "once"),
    "an idle joint": ("", "", {"joints": ["j1", "j2"], "tip": "b"}, "move the tip.*j2"),
    "unknown key": ("", "", {"tool": "c"}, "key tool"),
    "joints in one text": ("", "", {"joints": "j1"}, "key joints.*a list"),
    "no gravity": ("", "", {"gravity": [0, 0, 0]}, "key gravity"),
    "odd mimic": ("", "", {"mimic": {"j2": {"ratio": 2}}}, "key mimic.j2"),
    "odd ratio": ("", "", {"mimic": {"j2": {"joint": "j1", "ratio": "2"}}}, "finite numbers"),
}


@pytest.mark.parametrize("case", BROKEN_URDF)
def test_a_broken_urdf_gets_one_sentence(case, tmp_path):
    old, new, spec, words = BROKEN_URDF[case]
    file = tmp_path / "r.urdf"
    file.write_text(URDF.replace(old, new, 2 if case == "rigid" else 1) if old else URDF)
    with pytest.raises(InputError, match=words) as caught:
        load_robot({"urdf": str(file)} | spec)
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".")


def test_a_urdf_that_is_not_there_gets_one_sentence():
    with pytest.raises(
        InputError, match="nowhere.urdf: expected a readable URDF, found No such file"
    ):
        load_robot("nowhere.urdf")


def test_several_last_links_are_named(tmp_path):
    file = tmp_path / "r.urdf"
    extra = '<link name="d"/><joint name="j3" type="fixed"><parent link="b"/><child link="d"/></joint></robot>'
    file.write_text(URDF.replace("</robot>", extra))
    assert load_robot(file).joints == 2, "c lies beyond more joints than d"
    file.write_text(URDF.replace("</robot>", extra.replace('type="fixed"', 'type="continuous"')))
    with pytest.raises(InputError, match="several last links, c, d; name one of them"):
        load_robot(file)


def test_a_robot_file_may_name_a_urdf_next_to_it(tmp_path):
    (tmp_path / "r.urdf").write_text(URDF)
    (tmp_path / "robot.toml").write_text('urdf = "r.urdf"\ntip = "b"\n')
    assert load_robot(tmp_path / "robot.toml").joints == 1
