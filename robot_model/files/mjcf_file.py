"""Settings of the compiler and classes of defaults of an MJCF file, as MuJoCo reads them."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np

from robot_model.robot import wrong

_MAIN = "main"


def compiler_of(root: ET.Element) -> dict[str, str]:
    """Attributes of <compiler>; of several such elements the last one counts."""
    settings: dict[str, str] = {}
    for element in root.findall("compiler"):
        settings |= element.attrib
    return settings


class Defaults:
    """Attributes that the classes of <default> give to elements, by class and tag."""

    def __init__(self, root: ET.Element):
        self._held: dict[str, dict[str, dict]] = {_MAIN: {}}
        for element in root.findall("default"):
            self._read(element, self._held[_MAIN], element.get("class", _MAIN))

    def _read(self, element: ET.Element, inherited: Mapping[str, dict], name: str) -> None:
        settings = {tag: dict(keys) for tag, keys in inherited.items()}
        for child in element:
            if child.tag != "default":
                settings[child.tag] = settings.get(child.tag, {}) | dict(child.attrib)
        self._held[name] = settings
        for inner in element.findall("default"):
            self._read(inner, settings, inner.get("class", ""))

    def of(self, element: ET.Element, kind: str = _MAIN) -> dict[str, str]:
        """An element's attributes over those of its class; kind: the class of the body around it."""
        defaults = self._held.get(element.get("class", kind), {})
        return defaults.get(element.tag, {}) | dict(element.attrib)


def numbers(text: str, count: int, where: str) -> np.ndarray:
    """(count,) finite numbers of a text. Raises InputError."""
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise wrong(where, f"{count} finite number(s)", repr(text), "correct it")
    return values
