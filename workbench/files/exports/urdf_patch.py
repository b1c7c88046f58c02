"""The user's own URDF with corrected joint origins: only numbers change, byte for byte.

The calibration moves the axis of every joint. The frame of each link moves with its axis, and the origin of each joint
is the place of its link in the frame of the link before. Names, meshes, comments, limits and spacing stay.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from robot_model import load_robot
from robot_model.chain import forward
from robot_model.files.urdf_tree import Joint, Tree
from robot_model.measurements.closure import flange_matrices
from robot_model.robot import Robot, wrong
from workbench.core.rigid import transform
from workbench.files.exports.mdh import calibrated_geometry
from workbench.files.exports.urdf import around_joints
from workbench.files.solution_file import CalibratedArm

_SAME_MM, _SAME = 1e-7, 1e-10
_SAME_ARM_MM = 1e-2
_ATTRIBUTE = re.compile(r"([^\s=<>/\"']+)\s*=\s*(\"[^\"]*\"|'[^']*')")
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True)
class PatchedUrdf:
    """`content` of the file; `changed`: joints with other numbers; `left_out`: what the file cannot hold.

    `is_whole`: its flange stands where the calibrated one does.
    """

    content: bytes
    changed: tuple[str, ...]
    left_out: tuple[str, ...]
    is_whole: bool = True


def patched_urdf(arm: CalibratedArm, spec: dict) -> PatchedUrdf:
    """A URDF whose joint origins are those of the calibrated arm.

    spec: {"urdf": path, "joints": [...], "tip": link, ...} as of `robot_from_urdf`. The arm may have
    been calibrated with this file, or with another description of the same nominal kinematics.
    Raises InputError where the file describes another arm.
    """
    tree = Tree(spec, "--urdf")
    tip = spec.get("tip") or tree.farthest_leaf()
    path = tree.path(tip)
    moving = [joint for joint in path if tree.drive(joint) is not None]
    nominal = _described_arm(arm, spec, tree.file)
    moves = _moves(arm, nominal)
    if len(moves) != len(moving) + 1:
        raise wrong(
            tree.file, f"{len(moves) - 1} moving joints", len(moving), "name tip and joints"
        )
    origins = _origins(tree, path, moving, moves)
    content = tree.file.read_bytes()
    if content.startswith(_UTF_16):
        raise wrong(tree.file, "a text in UTF-8", "UTF-16", "save it as UTF-8")
    changed = [j for j in path if not _is_same(origins[j.name], j.origin)]
    content = _with_origins(content, {j.name: (j.origin, origins[j.name]) for j in changed})
    titles = tuple(effect.title for effect in arm.effects)
    flange_changes = _rest_at_flange(tree, path, moving, moves)
    names = tuple(joint.name for joint in changed)
    return PatchedUrdf(content, names, (*titles, *flange_changes), not flange_changes)


def _described_arm(arm: CalibratedArm, spec: dict, file: Path) -> np.ndarray:
    """(4, 4) T from the calibrated arm's root frame to the URDF's; InputError where the kinematics differ."""
    described_arm = load_robot(spec, str(file))
    if described_arm.mixing.shape != arm.robot.mixing.shape:
        raise wrong(
            file,
            f"an arm with {arm.robot.joints} joints",
            described_arm.joints,
            "name tip and joints",
        )
    readings = np.random.default_rng(0).uniform(-1, 1, (24, described_arm.mixing.shape[1]))
    readings = np.vstack([np.zeros(described_arm.mixing.shape[1]), readings])
    described_poses = _flanges(described_arm, readings)
    calibrated_poses = _flanges(arm.robot, readings)
    # T_urdf(q) = A T(q) B with constant A and B: relative motions are conjugate by A
    remainder = _conjugation(
        described_poses @ np.linalg.inv(described_poses[0]),
        calibrated_poses @ np.linalg.inv(calibrated_poses[0]),
    )
    right = np.linalg.inv(remainder @ calibrated_poses[0]) @ described_poses[0]
    deviation = np.abs(described_poses - remainder @ calibrated_poses @ right)[:, :3, 3].max()
    if not deviation < _SAME_ARM_MM:
        raise wrong(
            file,
            f"the nominal kinematics of {arm.robot.name}",
            f"flange poses that differ by up to {deviation:.3g} mm",
            "name the URDF of this arm, with the same zero pose",
        )
    return remainder


def _conjugation(described_poses: np.ndarray, calibrated_poses: np.ndarray) -> np.ndarray:
    """(4, 4) A with theirs = A ours A^-1 for relative motions (n, 4, 4): A X = X' A (Park & Martin 1994)."""
    rotations = [
        Rotation.from_matrix(m[:, :3, :3]).as_rotvec() for m in (described_poses, calibrated_poses)
    ]
    rotation = Rotation.align_vectors(*rotations)[0].as_matrix()
    rows = described_poses[:, :3, :3] - np.eye(3)
    right = np.einsum("ij,nj->ni", rotation, calibrated_poses[:, :3, 3]) - described_poses[:, :3, 3]
    shift = np.linalg.lstsq(rows.reshape(-1, 3), right.ravel(), rcond=None)[0]
    return transform(rotation, shift)


def _flanges(robot: Robot, readings: np.ndarray, geometry=None) -> np.ndarray:
    frames = forward(robot, robot.mixing @ readings.T, geometry)
    return transform(flange_matrices(frames), frames.end_origin.T)


def _moves(arm: CalibratedArm, remainder: np.ndarray) -> list[np.ndarray]:
    """J + 1 motions (4, 4) in the URDF root frame that take nominal links and flange to their calibrated places."""
    nominal = _links(arm, arm.robot.geometry)
    calibrated = _links(arm, calibrated_geometry(arm))
    inverse = np.linalg.inv(remainder)
    moves = []
    for new, old in zip(calibrated, nominal):
        moves.append(remainder @ new @ np.linalg.inv(old) @ inverse)
    return moves


def _links(arm: CalibratedArm, geometry) -> list[np.ndarray]:
    """J + 1 frames (4, 4) at zero readings in the root frame: on each joint's axis behind it, and the flange."""
    names = ("theta", "d", "a", "alpha", "beta")
    values = {
        f"joint-{k + 1}.{n}{k + 1}": geometry[k, c]
        for k in range(len(geometry))
        for c, n in enumerate(names)
    }
    arm_without_effects = CalibratedArm(
        arm.robot, (), values, (), np.zeros((0, 0)), np.zeros(3), 0.0, True, "", {}
    )
    before, after = around_joints(arm_without_effects)
    frame, links_placed = arm.robot.base, []
    for k in range(arm.robot.joints):
        frame = frame @ before[k]
        links_placed.append(frame @ _joint_rotation(geometry[k, 0]))
        frame = frame @ after[k]
    return [*links_placed, frame @ arm.robot.flange]


def _joint_rotation(theta: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec([0, 0, theta]).as_matrix()
    return matrix


def _origins(tree: Tree, path: list[Joint], moving: list[Joint], moves) -> dict[str, np.ndarray]:
    """Origin (4, 4) mm of every joint on the path to the tip.

    A fixed joint keeps its origin, but for the last one before the tip, which takes what the flange moves by.
    """
    place = {tree.root: np.eye(4)}
    origins = {}
    number = {joint.name: k for k, joint in enumerate(moving)}
    if path[-1].name not in number:
        fixed_after = path[-1]
    else:
        fixed_after = None
    for joint in path:
        if joint.name in number:
            target = moves[number[joint.name]] @ tree.places[joint.child]
            origins[joint.name] = np.linalg.inv(place[joint.parent]) @ target
        elif joint is fixed_after:
            target = moves[-1] @ tree.places[joint.child]
            origins[joint.name] = np.linalg.inv(place[joint.parent]) @ target
        else:
            origins[joint.name] = joint.origin
        place[joint.child] = place[joint.parent] @ origins[joint.name]
    return origins


def _rest_at_flange(tree: Tree, path, moving, moves) -> tuple[str, ...]:
    """Displacement of the flange beyond the last axis, where no fixed joint follows that could include it."""
    if path[-1] is not moving[-1]:
        return ()
    tip = tree.places[path[-1].child]
    flange_change = np.linalg.inv(moves[-2] @ tip) @ moves[-1] @ tip
    if _is_same(flange_change, np.eye(4)):
        return ()
    shift = float(np.linalg.norm(flange_change[:3, 3]))
    angle = float(np.rad2deg(Rotation.from_matrix(flange_change[:3, :3]).magnitude()))
    return (
        f"{shift:.3g} mm and {angle:.3g} deg between the last axis and the flange, since no fixed joint follows it",
    )


def _is_same(matrix_a: np.ndarray, other: np.ndarray) -> bool:
    return bool(
        np.abs(matrix_a[:3, 3] - other[:3, 3]).max() < _SAME_MM
        and np.abs(matrix_a[:3, :3] - other[:3, :3]).max() < _SAME
    )


def _with_origins(content: bytes, origins: dict[str, tuple[np.ndarray, np.ndarray]]) -> bytes:
    """The file with other numbers in the <origin> of some joints; origins: name -> (as it was, as it shall be)."""
    places = _origin_tags(content)
    for name, (start, end, has_tag) in sorted(places.items(), key=lambda item: -item[1][0]):
        if name not in origins:
            continue
        tag = content[start:end].decode("latin-1") if has_tag else "<origin/>"
        patched_tag = _tag_with(tag, *origins[name]).encode("latin-1")  # every byte as it was
        content = content[:start] + patched_tag + content[end:]
    return content


def _tag_with(tag: str, old: np.ndarray, new: np.ndarray) -> str:
    """The tag with xyz (m) and rpy (rad) of a transform; an attribute whose numbers do not change stays as it is."""
    if np.abs(new[:3, 3] - old[:3, 3]).max() >= _SAME_MM:
        tag = _attribute(tag, "xyz", new[:3, 3] / 1000)
    if np.abs(new[:3, :3] - old[:3, :3]).max() >= _SAME:
        tag = _attribute(tag, "rpy", Rotation.from_matrix(new[:3, :3]).as_euler("xyz"))
    return tag


def _attribute(tag: str, name: str, numbers) -> str:
    """The tag with other numbers inside of the quotes of an attribute, or with this attribute at its end."""
    text = " ".join(f"{number:.12g}" for number in numbers)
    for found in _ATTRIBUTE.finditer(tag):
        if found.group(1) == name:
            start = found.start(2) + 1
            end = found.end(2) - 1
            return tag[:start] + text + tag[end:]
    return re.sub(r"\s*/?>$", lambda end: f' {name}="{text}"{end.group()}', tag, count=1)


def _origin_tags(content: bytes) -> dict[str, tuple[int, int, bool]]:
    """Joint -> first byte, end and presence of its <origin> tag; without one, the place behind the joint's own tag."""
    found: dict[str, tuple[int, int, bool]] = {}
    stack: list[tuple[str, str | None]] = []
    parser = expat.ParserCreate()

    def opened(name, attributes):
        start = parser.CurrentByteIndex
        end = _end_of_tag(content, start)
        parent = stack[-1] if stack else ("", None)
        if name == "joint" and parent[0] == "robot":
            found[attributes.get("name")] = (end, end, False)
        elif name == "origin" and parent[0] == "joint" and len(stack) == 2:
            found[parent[1]] = (start, end, True)
        stack.append((name, attributes.get("name")))

    def closed(name):
        stack.pop()

    parser.StartElementHandler, parser.EndElementHandler = opened, closed
    parser.Parse(content, True)
    return found


def _end_of_tag(content: bytes, start: int) -> int:
    """The byte behind a tag; a > inside of quotes does not end it."""
    quote = 0
    for place in range(start, len(content)):
        byte = content[place]
        if quote:
            quote = 0 if byte == quote else quote
        elif byte in b"\"'":
            quote = byte
        elif byte == ord(">"):
            return place + 1
    return len(content)
