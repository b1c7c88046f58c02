"""Any serial chain of a URDF as an arm in distal Denavit-Hartenberg form with Hayati's beta.

A URDF places each joint freely; the chain wants five numbers a joint. The joints' axes are taken
as lines at the zero pose, and each row carries one frame's z axis onto the next line: along the
common normal where the axes differ, by Hayati and Mirmirani's (1985) plane where they are nearly
parallel and the common normal is ill-defined. What the first and the last frame cannot take goes
into `Robot.base` and `Robot.flange`, so that the flange stands where the URDF puts it, exactly.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from robot_model.chain import THETA, D
from robot_model.files.mjcf import MjcfTree, is_mjcf
from robot_model.files.urdf_tree import NAMELESS, Joint, Tree
from robot_model.robot import PARALLEL, Robot, coupling_of, wrong

LOAD = "load"
"""Name of the link or body at which recorded loads hang."""


def robot_from_urdf(spec: Mapping, where: str = "robot") -> Robot:
    """The arm of {"urdf": path, "joints": [...], "tip": link, "mimic": {...}, "gravity": [x, y, z]}.

    joints: names of the joints that have a reading, in the order of the q columns; left out: all
    that move. A joint of the chain that is neither named nor mimics a named one stands still at
    zero. tip: link whose frame is the flange; left out: the leaf beyond most joints. mimic: joint
    -> {"joint": parent, "ratio": r, "offset": o}, in the URDF's units (m, rad), over the URDF's
    own. gravity: direction in the root link's frame; that of the file, else (0, 0, -1), if left out. Also name,
    source. The file may also be MJCF (MuJoCo); then tip may be a body or a site.

    A body's mass is that of all links that move with its joint, side branches at their zero. Recorded loads hang at
    the link or body `load` on the flange, or at the flange's origin where there is none.
    Raises InputError where the file or a name does not serve.
    """
    tree = tree_of(spec, where)
    tip = spec.get("tip") or tree.farthest_leaf()
    drives = {joint.name: tree.drive(joint) for joint in tree.path(tip)}
    moving = [tree.joints[name] for name, drive in drives.items() if drive is not None]
    if not moving:
        raise wrong(tree.file, f"a joint that moves before link {tip}", "none", "name another tip")
    frames, rows, hayati = _denavit(tree, moving, tip)
    readings, mixing, offsets = _mixing(tree, moving, drives, spec.get("joints"))
    prismatic = np.array([joint.kind == "prismatic" for joint in moving])
    rows[np.arange(len(rows)), np.where(prismatic, D, THETA)] += offsets
    mass, com = _masses(tree, moving, frames)
    gravity = np.array(spec.get("gravity", tree.gravity), float)
    return Robot(
        name=spec.get("name", tree.name),
        source=spec.get("source", f"{tree.language} {tree.file.name}"),
        convention="distal",
        geometry=rows,
        hayati=hayati,
        prismatic=prismatic,
        mixing=mixing,
        coupling=coupling_of(mixing, _own_joints(readings, moving, mixing)),
        limits=np.array([tree.joints[name].limits for name in readings]),
        gear_ratio=np.full(len(rows), np.nan),
        gravity=gravity / np.linalg.norm(gravity),
        mass=mass,
        com=com,
        payload_mass=0.0,
        payload_com=_load_centre(tree, tip),
        base=frames[0],
        flange=_flange(frames[-1], tree.places[tip]),
        joint_names=_names(moving),
    )


def _names(moving: list[Joint]) -> tuple[str, ...]:
    """Names of the joints; () where one of them has none."""
    names = tuple(joint.name for joint in moving)
    if any(name.endswith(NAMELESS) for name in names):
        return ()
    return names


def tree_of(spec: Mapping, where: str) -> Tree:
    """The tree of links and joints of a URDF or MJCF file, recognised by its root element. Raises InputError."""
    file = spec.get("urdf")
    is_other = isinstance(file, str | Path) and is_mjcf(Path(file))
    if is_other:
        return MjcfTree(spec, where)
    return Tree(spec, where)


def _denavit(
    tree: Tree, moving: list[Joint], tip: str
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Frames (J + 1 of (4, 4), root frame, zero pose), rows (J, 5) and Hayati flags (J,)."""
    lines = []
    for joint in moving:
        place = tree.places[joint.child]
        lines.append((place[:3, 3], place[:3, :3] @ joint.axis))
    end = tree.places[tip]
    lines.append((end[:3, 3], end[:3, 2]))
    frames = [_first_frame(*lines[0])]
    rows = []
    hayati = []
    for point, axis in lines[1:]:
        frame = frames[-1]
        inward = frame[:3, :3].T
        is_last = len(rows) == len(moving) - 1
        if is_last:
            hint = end[:3, 0]
        else:
            hint = frame[:3, 0]
        offset = inward @ (point - frame[:3, 3])
        row, is_parallel = link_row(offset, inward @ axis, inward @ hint, is_last)
        rows.append(row)
        hayati.append(is_parallel and not is_last)
        frames.append(frame @ _transform(row))
    return frames, np.array(rows), np.array(hayati)


def _first_frame(point: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The frame on the first axis that is nearest to the root frame: for most arms the root frame."""
    x = np.eye(3)[0 if abs(axis[0]) < 0.9 else 1]
    x = x - axis * (x @ axis)
    x = x / np.linalg.norm(x)
    frame = np.eye(4)
    frame[:3, :3] = np.column_stack([x, np.cross(axis, x), axis])
    frame[:3, 3] = point - axis * (point @ axis)
    return frame


def link_row(
    point: np.ndarray, axis: np.ndarray, hint: np.ndarray, last: bool = False
) -> tuple[np.ndarray, bool]:
    """theta, d, a, alpha, beta (mm, rad) that carry the z axis onto a line, and whether by Hayati.

    point (3,) mm, axis (3,) unit: the line, in the frame whose z axis is carried; hint (3,): where
    the new x axis should point if it has the choice; last: d is free on parallel axes too, because
    no joint follows that could take it. Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta).
    """
    sine = np.hypot(axis[0], axis[1])
    if sine < PARALLEL:
        return _hayati_row(point, axis, hint, point[2] if last else 0.0), True
    normal = np.array([-axis[1], axis[0]]) / sine
    a = point[:2] @ normal
    d = point[2] - axis[2] * (point[:2] @ axis[:2]) / sine**2
    # axes that meet, but for rounding, leave the sign of the normal free
    if abs(a) > 1e-3:
        side = np.sign(a)
    else:
        side = 1.0 if normal @ hint[:2] > -1e-6 else -1.0
    theta = np.arctan2(side * normal[1], side * normal[0])
    return np.array([theta, d, side * a, np.arctan2(side * sine, axis[2]), 0.0]), False


def _hayati_row(point: np.ndarray, axis: np.ndarray, hint: np.ndarray, d: float) -> np.ndarray:
    """Through where the line meets the plane z = d; alpha and beta turn z onto its direction."""
    meets = (point + axis * (d - point[2]) / axis[2])[:2]
    a = np.hypot(*meets)
    x, y = meets if a > 1e-10 else hint[:2]
    theta = np.arctan2(y, x)
    c = np.cos(theta)
    s = np.sin(theta)
    beta = np.arcsin(c * axis[0] + s * axis[1])
    return np.array([theta, d, a, np.arctan2(s * axis[0] - c * axis[1], axis[2]), beta])


def _transform(row: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    theta, d, a, alpha, beta = row
    place = np.eye(4)
    place[:3, :3] = Rotation.from_euler("ZXY", [theta, alpha, beta]).as_matrix()
    place[:3, 3] = a * np.cos(theta), a * np.sin(theta), d
    return place


def _flange(last: np.ndarray, tip: np.ndarray) -> np.ndarray:
    flange = np.linalg.inv(last) @ tip
    # an identity but for rounding saves the chain a step when it is exact
    if np.allclose(flange, np.eye(4), rtol=0, atol=1e-12):
        return np.eye(4)
    return flange


def _load_centre(tree: Tree, tip: str) -> np.ndarray:
    """(3,) mm in the flange frame: where a link called `load` stands on the flange, else the flange's origin.

    Recorded loads (column payload_kg) hang there. A file that `workbench export --to mjcf` writes has such a body.
    """
    before = [joint.name for joint in tree.path(tip) if joint.kind != "fixed"]
    if LOAD not in tree.places:
        return np.zeros(3)
    if [joint.name for joint in tree.path(LOAD) if joint.kind != "fixed"] != before:
        return np.zeros(3)
    return (np.linalg.inv(tree.places[tip]) @ tree.places[LOAD])[:3, 3]


def _mixing(
    tree: Tree, moving: list[Joint], drives: dict, stated: Sequence[str] | None
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names of the R readings, (J, R) joint variables of readings, (J,) the mimics' offsets, rad and mm.

    stated: the readings that the user names. Servos of an MJCF file may drive another arm and a gripper, too.
    """
    used = list(dict.fromkeys(drives[joint.name][0] for joint in moving))
    readings = list(stated or [name for name in tree.named or used if name in used])
    idle = [name for name in readings if name not in used]
    if idle:
        raise wrong(
            f"{tree.file}: joints", "joints that move the tip", ", ".join(idle), "leave them out"
        )
    mixing = np.zeros((len(moving), len(readings)))
    offsets = np.zeros(len(moving))
    for k, joint in enumerate(moving):
        name, ratio, offset = drives[joint.name]
        mixing[k, readings.index(name)] = ratio * joint.unit / tree.joints[name].unit
        offsets[k] = offset * joint.unit
    return readings, mixing, offsets


def _own_joints(readings: list[str], moving: list[Joint], mixing: np.ndarray) -> np.ndarray:
    """(R,) index of the joint of each reading: that of its name, else the first that it moves.

    A mimic joint is moved by the same drive through a linkage.
    """
    names = [joint.name for joint in moving]
    first = np.argmax(mixing != 0, axis=0)
    joint_numbers = [names.index(name) if name in names else k for name, k in zip(readings, first)]
    return np.array(joint_numbers)


def _masses(
    tree: Tree, moving: list[Joint], frames: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """(J,) kg and (J, 3) mm in frame k of everything that moves with joint k."""
    number = {joint.name: k for k, joint in enumerate(moving, 1)}
    body = {tree.root: 0}
    mass = np.zeros(len(frames))
    moment = np.zeros((len(frames), 3))
    for link in tree.places:
        if link in tree.into:
            body[link] = number.get(tree.into[link].name, body[tree.into[link].parent])
        kg, centre = tree.inertial(link)
        mass[body[link]] += kg
        moment[body[link]] += kg * centre
    centres = moment / np.where(mass > 0, mass, 1)[:, None]
    com = [frame[:3, :3].T @ (centre - frame[:3, 3]) for frame, centre in zip(frames, centres)]
    return mass[1:], np.where(mass[1:, None] > 0, com[1:], 0.0)
