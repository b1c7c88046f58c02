"""What an MJCF file (MuJoCo) says of an arm: bodies, joints, masses, limits and what moves them.

It is read as the tree of a URDF: a body is a link, a joint carries one link. No mesh is needed. A joint that no servo
drives stands still at zero, where the file has servos. Included files, ball and free joints are refused.
"""

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from robot_model.robot import wrong
from robot_model.urdf_tree import Joint, Tree

TERMS = "workbench-terms"
"""Name of the <text> element in which an exported file holds the terms of its model, as JSON."""
_KINDS = {"hinge": "revolute", "slide": "prismatic"}
_TIPS = ("flange", "attachment_site")
_DENSITY = 1000.0  # kg/m^3, MuJoCo's default
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
    root = ET.parse(path).getroot()
    said = []
    springs = [e.get("name", "") for e in root.iter("joint") if float(e.get("stiffness", 0)) != 0]
    if springs:
        said.append(
            f"{Path(path).name}: springs of the joints {', '.join(springs)} are taken as rigid; state them as effects "
            "of a scene to compare them, too."
        )
    if root.find("actuator") is not None:
        said.append(
            f"{Path(path).name}: servos are taken as rigid, since their gain is that of a controller and not of a gear."
        )
    if any(e.get("frictionloss") for e in root.iter("joint")):
        said.append(
            f"{Path(path).name}: friction of joints is left out, since the arm stands still."
        )
    return said


class MjcfTree(Tree):
    """An MJCF file as a tree of links and joints; `gravity` (3,) direction in the world. Raises InputError."""

    language = "MJCF"

    def _read(self, spec: Mapping, where: str) -> None:
        root = _parse(self.file)
        self.name = root.get("model", self.file.stem)
        compiler = root.find("compiler")
        held = {} if compiler is None else dict(compiler.attrib)
        self._angle = 1.0 if held.get("angle", "degree") == "radian" else np.pi / 180
        self._sequence = held.get("eulerseq", "xyz")
        self._from_geoms = held.get("inertiafromgeom", "auto")
        self._defaults = _defaults(root)
        self.links = {"world": None}
        self.joints: dict[str, Joint] = {}
        self._bodies: dict[str, tuple[float, np.ndarray]] = {"world": (0.0, np.zeros(3))}
        self._count = 0
        for world in root.findall("worldbody"):
            self._children(world, "world", np.eye(4), "main")
        self.gravity = _gravity(root)
        self._couple(root)
        if self.named is None:
            self.named = self._driven(root)

    def _children(self, element, link: str, here: np.ndarray, kind: str) -> None:
        """Bodies, frames and sites below an element; here (4, 4) mm: its frame in that of the link."""
        for child in element:
            place = here @ self._place(child)
            own = child.get("childclass", kind)
            if child.tag == "frame":
                self._children(child, link, place, own)
            elif child.tag == "body":
                self._body(child, link, place, own)
            elif child.tag == "site" and child.get("name"):
                name = child.get("name")  # a site may be called as a body is
                self._link(f"{name}/site" if name in self.links else name, link, place)

    def _body(self, body, link: str, place: np.ndarray, kind: str) -> None:
        """A link for each joint of a body, each on the axis of its joint, and one where it has none."""
        name = body.get("name") or self._unnamed("body")
        joints = [j for j in body if j.tag in ("joint", "freejoint")]
        shift = np.eye(4)
        for number, element in enumerate(joints, 1):
            keys = self._attributes(element, kind)
            anchor = np.eye(4)
            anchor[:3, 3] = _MM * _vector(keys.get("pos", "0 0 0"), 3, self._where(body))
            child = name if number == len(joints) else f"{name}/{number}"
            self._moving(keys, element, (link, child), place @ np.linalg.inv(shift) @ anchor)
            link, place, shift = child, np.eye(4), anchor
        if not joints:
            self._link(name, link, place)
        inward = np.linalg.inv(shift) if joints else np.eye(4)
        link = name
        mass, centre = self._inertial(body, kind)
        self._bodies[name] = mass, (inward @ np.append(centre, 1))[:3]
        self._children(body, link, inward, kind)

    def _moving(self, keys, element, links, origin) -> None:
        parent, child = links
        name = element.get("name") or self._unnamed("joint")
        where = f"{self.file}: joint {name}"
        kind = "free" if element.tag == "freejoint" else keys.get("type", "hinge")
        if kind not in _KINDS:
            raise wrong(where, f"type {' or '.join(_KINDS)}", kind, "replace it")
        axis = _vector(keys.get("axis", "0 0 1"), 3, where)
        unit = _MM if kind == "slide" else self._angle
        limits = (np.nan, np.nan)
        if "range" in keys and keys.get("limited", "auto") != "false":
            low, high = _vector(keys["range"], 2, where) * unit
            limits = (low, high) if low < high else limits
        self.links[child] = None
        self._bodies.setdefault(child, (0.0, np.zeros(3)))
        axis = axis / max(np.linalg.norm(axis), 1e-9)
        self.joints[name] = Joint(name, _KINDS[kind], parent, child, origin, axis, limits, None)

    def _link(self, name: str, parent: str, place: np.ndarray) -> None:
        """A link that does not move on its parent."""
        self.links[name] = None
        self._bodies.setdefault(name, (0.0, np.zeros(3)))
        joint = Joint(
            f"{name}/fixed", "fixed", parent, name, place, np.eye(3)[2], (np.nan, np.nan), None
        )
        self.joints[joint.name] = joint

    def _attributes(self, element, kind: str) -> dict:
        """A joint's attributes over those of its class."""
        return self._defaults.get(element.get("class", kind), {}) | dict(element.attrib)

    def _unnamed(self, what: str) -> str:
        self._count += 1
        return f"{what}{self._count}"

    def _where(self, body) -> str:
        return f"{self.file}: body {body.get('name', '')}"

    def _place(self, element) -> np.ndarray:
        """(4, 4) mm of the frame that an element states."""
        where = f"{self.file}: {element.tag} {element.get('name', '')}"
        place = np.eye(4)
        place[:3, 3] = _MM * _vector(element.get("pos", "0 0 0"), 3, where)
        place[:3, :3] = self._rotation(element, where)
        return place

    def _rotation(self, element, where: str) -> np.ndarray:
        from scipy.spatial.transform import Rotation

        if "quat" in element.attrib:
            quaternion = _vector(element.get("quat"), 4, where)
            return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
        if "euler" in element.attrib:
            angles = _vector(element.get("euler"), 3, where) * self._angle
            # MuJoCo: lower case letters are axes that turn with the body, which are scipy's upper case
            return Rotation.from_euler(self._sequence.swapcase(), angles).as_matrix()
        if "axisangle" in element.attrib:
            *axis, angle = _vector(element.get("axisangle"), 4, where)
            unit = np.array(axis) / np.linalg.norm(axis)
            return Rotation.from_rotvec(unit * angle * self._angle).as_matrix()
        if "xyaxes" in element.attrib or "zaxis" in element.attrib:
            return _by_axes(element, where)
        return np.eye(3)

    def _inertial(self, body, kind: str) -> tuple[float, np.ndarray]:
        """kg of a body and its centre (3,) mm in the body's frame: stated, or that of its simple shapes."""
        stated = body.find("inertial")
        if stated is not None and self._from_geoms != "true":
            where = self._where(body)
            centre = _MM * _vector(stated.get("pos", "0 0 0"), 3, where)
            return float(_vector(stated.get("mass", "0"), 1, where)[0]), centre
        if self._from_geoms == "false":
            return 0.0, np.zeros(3)
        parts = [
            (_geom_mass(g, self._where(body)), self._place(g)[:3, 3]) for g in body.findall("geom")
        ]
        total = sum(mass for mass, _ in parts)
        if not total > 0:
            return 0.0, np.zeros(3)
        return total, sum(mass * centre for mass, centre in parts) / total

    def _couple(self, root) -> None:
        """Joints that an equality constraint ties linearly to another one."""
        for tie in root.iter("equality"):
            for element in tie.findall("joint"):
                first, second = element.get("joint1"), element.get("joint2")
                poly = _vector(element.get("polycoef", "0 1 0 0 0"), 5, f"{self.file}: equality")
                if poly[2:].any() or second is None:
                    raise wrong(
                        f"{self.file}: equality of joint {first}",
                        "a linear tie to another joint",
                        "another one",
                        "take it out",
                    )
                self.mimic.setdefault(first, (second, float(poly[1]), float(poly[0])))

    def _driven(self, root) -> list[str] | None:
        """Joints that servos drive, base first; None where the file has no servo."""
        driven = {e.get("joint") for part in root.findall("actuator") for e in part}
        names = [name for name in self.joints if name in driven]
        return names or None

    def farthest_leaf(self) -> str:
        """The site `flange`, else the leaf beyond most joints that move."""
        for name in _TIPS:
            if name in self.links:
                return name
        return super().farthest_leaf()

    def inertial(self, link: str) -> tuple[float, np.ndarray]:
        """kg of a link and its centre (3,) in the root frame at zero, mm."""
        mass, centre = self._bodies[link]
        return mass, (self.places[link] @ np.append(centre, 1))[:3]


def _parse(file: Path) -> ET.Element:
    try:
        root = ET.parse(file).getroot()
    except OSError as problem:
        raise wrong(file, "a readable MJCF file", problem.strerror, "check the path") from None
    except (ET.ParseError, ValueError, LookupError) as problem:
        raise wrong(file, "XML", f"a mistake ({problem})", "correct it there") from None
    if root.find(".//include") is not None:
        raise wrong(
            file,
            "one whole MJCF file",
            "an <include>",
            "save the compiled model as one file (mujoco.mj_saveLastXML)",
        )
    return root


def _defaults(root) -> dict[str, dict]:
    """Class -> attributes of its joints, each with those of the classes around it."""
    found: dict[str, dict] = {}

    def read(element, above: dict, name: str) -> None:
        own = element.find("joint")
        found[name] = above | (dict(own.attrib) if own is not None else {})
        for inner in element.findall("default"):
            read(inner, found[name], inner.get("class", ""))

    for element in root.findall("default"):
        read(element, {}, element.get("class", "main"))
    return found


def _gravity(root) -> np.ndarray:
    """(3,) direction; downward where the file has none or switches it off."""
    option = root.find("option")
    text = "0 0 -9.81" if option is None else option.get("gravity", "0 0 -9.81")
    vector = np.array([float(word) for word in text.split()])
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-9 else np.array([0.0, 0.0, -1.0])


def _by_axes(element, where: str) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    if "zaxis" in element.attrib:
        z = _vector(element.get("zaxis"), 3, where)
        return Rotation.align_vectors([z / np.linalg.norm(z)], [[0, 0, 1]])[0].as_matrix()
    six = _vector(element.get("xyaxes"), 6, where)
    x = six[:3] / np.linalg.norm(six[:3])
    y = six[3:] - x * (x @ six[3:])
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def _geom_mass(geom, where: str) -> float:
    """kg of a simple shape; a mesh has none, since it is not read."""
    if geom.get("mass") is not None:
        return float(_vector(geom.get("mass"), 1, where)[0])
    kind = geom.get("type", "sphere")
    if "size" not in geom.attrib or kind in ("mesh", "plane", "hfield", "sdf"):
        return 0.0
    size = [float(word) for word in geom.get("size").split()]
    volumes = {
        "sphere": lambda r, *_: 4 / 3 * np.pi * r**3,
        "box": lambda x, y, z, *_: 8 * x * y * z,
        "ellipsoid": lambda x, y, z, *_: 4 / 3 * np.pi * x * y * z,
        "cylinder": lambda r, h, *_: 2 * np.pi * r**2 * h,
        "capsule": lambda r, h, *_: np.pi * r**2 * (2 * h + 4 / 3 * r),
    }
    if kind not in volumes:
        return 0.0
    return float(geom.get("density", _DENSITY)) * volumes[kind](*size)


def _vector(text: str, count: int, where: str) -> np.ndarray:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise wrong(where, f"{count} finite number(s)", repr(text), "correct it")
    return values
