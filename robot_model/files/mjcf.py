"""Arm from an MJCF file (MuJoCo): bodies, joints, masses, limits and actuators.

It is read as the tree of a URDF: a body is a link, a joint carries one link. No mesh is needed. A joint that no servo
drives stands still at zero, where the file has servos. Ball and free joints are refused on the way to the flange;
other bodies may have them.
"""

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from robot_model.files.mjcf_file import Defaults, compiler_of, numbers
from robot_model.files.mjcf_shapes import shape_ends, shape_mass
from robot_model.files.urdf_tree import NAMELESS, Joint, Tree
from robot_model.robot import wrong
from workbench.core.robot_files.robot_description import read_included

TERMS = "workbench-terms"
"""Name of the <text> element in which an exported file holds the terms of its model, as JSON."""
_KINDS = {"hinge": "revolute", "slide": "prismatic"}
_TIPS = ("flange", "attachment_site")
_MM = 1000.0


def is_mjcf(path: Path) -> bool:
    """Whether a file is MJCF: its root element is <mujoco>."""
    try:
        return ET.parse(path).getroot().tag == "mujoco"
    except (OSError, ET.ParseError, ValueError, LookupError):
        return False


def terms_of(path: Path) -> dict:
    """{"effects": [...], "values": {...}} that an exported file holds; {} where it is not ours."""
    for text in ET.parse(path).getroot().iter("text"):
        if text.get("name") == TERMS:
            return json.loads(text.get("data"))
    return {}


def unread(path: Path) -> list[str]:
    """Sentences for what a foreign MJCF file says and an arm of this workbench does not take over."""
    tree = MjcfTree({"urdf": str(path)}, str(path))
    texts = []
    if tree.springs:
        texts.append(
            f"{Path(path).name}: springs of the joints {', '.join(tree.springs)} are taken as rigid; state them as "
            "effects of a scene to compare them, too."
        )
    if tree.has_servos:
        texts.append(
            f"{Path(path).name}: servos are taken as rigid, since their gain is that of a controller and not of a gear."
        )
    if tree.has_friction:
        texts.append(
            f"{Path(path).name}: friction of joints is left out, since the arm stands still."
        )
    return texts


class MjcfTree(Tree):
    """An MJCF file as a tree of links and joints; `gravity` (3,) direction in the world. Raises InputError.

    `springs`: names of joints with a spring; `has_servos`, `has_friction`: whether the file states any.
    """

    language = "MJCF"

    def _read(self, spec: Mapping, where: str) -> None:
        root = read_included(self.file)
        self.name = root.get("model", self.file.stem)
        compiler = compiler_of(root)
        if compiler.get("angle", "degree") == "radian":
            self._angle = 1.0
        else:
            self._angle = np.pi / 180
        self._sequence = compiler.get("eulerseq", "xyz")
        self._from_geoms = compiler.get("inertiafromgeom", "auto")
        self._defaults = Defaults(root)
        self._sites: list[str] = []
        self._references: dict[str, float] = {}
        self.links = {"world": None}
        self.joints: dict[str, Joint] = {}
        self._bodies: dict[str, tuple[float, np.ndarray]] = {"world": (0.0, np.zeros(3))}
        self._count = 0
        self.springs: list[str] = []
        self.has_friction = False
        self.has_servos = root.find("actuator") is not None
        for world in root.findall("worldbody"):
            self._children(world, "world", np.eye(4), "main")
        self.gravity = _gravity(root)
        self._couple(root)
        if self.named is None:
            self.named = self._driven(root)

    def _children(self, element, link: str, frame: np.ndarray, kind: str) -> None:
        """Bodies, frames and sites below an element; frame (4, 4) mm: its frame in that of the link."""
        for child in element:
            class_name = child.get("childclass", kind)
            if child.tag == "frame":
                self._children(child, link, frame @ self._place(child, child.attrib), class_name)
            elif child.tag == "body":
                self._body(child, link, frame @ self._place(child, child.attrib), class_name)
            elif child.tag == "site" and child.get("name"):
                name = child.get("name")  # a site may be called as a body is
                name = f"{name}/site" if name in self.links else name
                self._sites.append(name)
                self._link(name, link, frame @ self._place(child, self._defaults.of(child, kind)))

    def _body(self, body, link: str, place: np.ndarray, kind: str) -> None:
        """A link for each joint of a body, each on the axis of its joint, and one where it has none."""
        name = body.get("name") or self._unnamed("body")
        joints = [j for j in body if j.tag in ("joint", "freejoint")]
        shift = np.eye(4)
        for number, element in enumerate(joints, 1):
            keys = self._defaults.of(element, kind)
            anchor = np.eye(4)
            anchor[:3, 3] = _MM * numbers(keys.get("pos", "0 0 0"), 3, self._where(body))
            child = name if number == len(joints) else f"{name}/{number}"
            self._moving(keys, element, (link, child), place @ np.linalg.inv(shift) @ anchor)
            link = child
            place = np.eye(4)
            shift = anchor
        if not joints:
            self._link(name, link, place)
        inward = np.linalg.inv(shift) if joints else np.eye(4)
        link = name
        mass, centre = self._inertial(body, kind)
        self._bodies[name] = mass, (inward @ np.append(centre, 1))[:3]
        self._children(body, link, inward, kind)

    def _moving(self, keys, element, links, origin) -> None:
        parent, child = links
        name = keys.get("name") or self._unnamed("joint")
        where = f"{self.file}: joint {name}"
        kind = "free" if element.tag == "freejoint" else keys.get("type", "hinge")
        axis = numbers(keys.get("axis", "0 0 1"), 3, where)
        axis = axis / max(np.linalg.norm(axis), 1e-9)
        unit = _MM if kind == "slide" else self._angle
        limits = (np.nan, np.nan)
        if kind in _KINDS and "range" in keys and keys.get("limited", "auto") != "false":
            low, high = numbers(keys["range"], 2, where) * unit
            limits = (low, high) if low < high else limits
        reference = numbers(keys.get("ref", "0"), 1, where)[0] * unit
        origin = origin @ _moved(axis, -reference, kind)  # the file draws the arm at its reference
        self._references[name] = reference / (_MM if kind == "slide" else 1.0)
        if float(keys.get("stiffness", "0").split()[0]) != 0:
            self.springs.append(name)
        self.has_friction |= "frictionloss" in keys
        self.links[child] = None
        self._bodies.setdefault(child, (0.0, np.zeros(3)))
        kind = _KINDS.get(kind, kind)
        self.joints[name] = Joint(name, kind, parent, child, origin, axis, limits, None)

    def _wrong_kind(self, joint: Joint) -> Exception:
        where = f"{self.file}: joint {joint.name}"
        return wrong(where, f"type {' or '.join(_KINDS)}", joint.kind, "replace it")

    def _link(self, name: str, parent: str, place: np.ndarray) -> None:
        """A link that does not move on its parent."""
        self.links[name] = None
        self._bodies.setdefault(name, (0.0, np.zeros(3)))
        joint = Joint(
            f"{name}/fixed", "fixed", parent, name, place, np.eye(3)[2], (np.nan, np.nan), None
        )
        self.joints[joint.name] = joint

    def _unnamed(self, noun: str) -> str:
        self._count += 1
        return f"({noun} {self._count} {NAMELESS}"

    def _where(self, body) -> str:
        return f"{self.file}: body {body.get('name', '')}"

    def _place(self, element, keys: Mapping[str, str]) -> np.ndarray:
        """(4, 4) mm of the frame that an element states; keys: its attributes with those of its class."""
        where = f"{self.file}: {element.tag} {element.get('name', '')}"
        place = np.eye(4)
        place[:3, 3] = _MM * numbers(keys.get("pos", "0 0 0"), 3, where)
        place[:3, :3] = self._rotation(keys, where)
        return place

    def _rotation(self, keys: Mapping[str, str], where: str) -> np.ndarray:
        from scipy.spatial.transform import Rotation

        if "quat" in keys:
            quaternion = numbers(keys.get("quat"), 4, where)
            return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
        if "euler" in keys:
            angles = numbers(keys.get("euler"), 3, where) * self._angle
            # MuJoCo: lower case letters are axes that turn with the body, which are scipy's upper case
            return Rotation.from_euler(self._sequence.swapcase(), angles).as_matrix()
        if "axisangle" in keys:
            *axis, angle = numbers(keys.get("axisangle"), 4, where)
            unit = np.array(axis) / np.linalg.norm(axis)
            return Rotation.from_rotvec(unit * angle * self._angle).as_matrix()
        if "xyaxes" in keys or "zaxis" in keys:
            return _by_axes(keys, where)
        return np.eye(3)

    def _inertial(self, body, kind: str) -> tuple[float, np.ndarray]:
        """kg of a body and its centre (3,) mm in the body's frame: stated, or that of its simple shapes."""
        stated = body.find("inertial")
        if stated is not None and self._from_geoms != "true":
            where = self._where(body)
            centre = _MM * numbers(stated.get("pos", "0 0 0"), 3, where)
            return float(numbers(stated.get("mass", "0"), 1, where)[0]), centre
        if self._from_geoms == "false":
            return 0.0, np.zeros(3)
        shapes = [self._shape(geom, body, kind) for geom in body.findall("geom")]
        total = sum(mass for mass, _ in shapes)
        if not total > 0:
            return 0.0, np.zeros(3)
        return total, sum(mass * centre for mass, centre in shapes) / total

    def _shape(self, geom, body, kind: str) -> tuple[float, np.ndarray]:
        """kg of a shape of a body and its centre (3,) mm in the body's frame."""
        keys = self._defaults.of(geom, kind)
        where = self._where(body)
        ends = shape_ends(keys, where)
        if ends is None:
            centre = self._place(geom, keys)[:3, 3]
        else:
            centre = _MM * ends.mean(0)
        return shape_mass(keys, where), centre

    def _couple(self, root) -> None:
        """Joints that an equality constraint ties linearly to another one."""
        for tie in root.iter("equality"):
            for element in tie.findall("joint"):
                first = element.get("joint1")
                second = element.get("joint2")
                poly = numbers(element.get("polycoef", "0 1 0 0 0"), 5, f"{self.file}: equality")
                if poly[2:].any() or second is None:
                    raise wrong(
                        f"{self.file}: equality of joint {first}",
                        "a linear tie to another joint",
                        "another one",
                        "take it out",
                    )
                ratio = float(poly[1])
                zeros = self._references
                offset = zeros.get(first, 0.0) + float(poly[0]) - ratio * zeros.get(second, 0.0)
                self.mimic.setdefault(first, (second, ratio, offset))

    def _driven(self, root) -> list[str] | None:
        """Joints that servos drive, base first; None where the file has no servo."""
        driven = {e.get("joint") for part in root.findall("actuator") for e in part}
        names = [name for name in self.joints if name in driven]
        return names or None

    def flanges(self) -> list[str]:
        """The site `flange`, else the last links of every arm; a site goes before bodies."""
        stated = [name for name in _TIPS if name in self.links]
        return stated[:1] or super().flanges()

    def _ends_of(self, leaves: list[str]) -> list[str]:
        sites = [name for name in leaves if name in self._sites]
        return sites or leaves

    def inertial(self, link: str) -> tuple[float, np.ndarray]:
        """Mass (kg) of a link, and its centre of mass (3,) in the root frame (mm) with all joints at zero."""
        mass, centre = self._bodies[link]
        return mass, (self.places[link] @ np.append(centre, 1))[:3]


def _gravity(root) -> np.ndarray:
    """(3,) direction; downward where the file has none or switches it off."""
    option = root.find("option")
    text = "0 0 -9.81" if option is None else option.get("gravity", "0 0 -9.81")
    vector = np.array([float(word) for word in text.split()])
    length = np.linalg.norm(vector)
    if length > 1e-9:
        return vector / length
    return np.array([0.0, 0.0, -1.0])


def _moved(axis: np.ndarray, amount: float, kind: str) -> np.ndarray:
    """(4, 4) of a joint of an MJCF kind that has moved by an amount, rad or mm, about or along its axis (3,)."""
    from scipy.spatial.transform import Rotation

    motion = np.eye(4)
    if kind == "slide":
        motion[:3, 3] = amount * axis
    elif kind == "hinge":
        motion[:3, :3] = Rotation.from_rotvec(amount * axis).as_matrix()
    return motion


def _by_axes(keys: Mapping[str, str], where: str) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    if "zaxis" in keys:
        z = numbers(keys.get("zaxis"), 3, where)
        return Rotation.align_vectors([z / np.linalg.norm(z)], [[0, 0, 1]])[0].as_matrix()
    six = numbers(keys.get("xyaxes"), 6, where)
    x = six[:3] / np.linalg.norm(six[:3])
    y = six[3:] - x * (x @ six[3:])
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])
