"""Effects and changes for people: options as words, angles in degrees, instants in the unit of the clock."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from datasets.samples.columns import joint_columns
from robot_model.effects.curve import JointCurve
from robot_model.effects.friction import JointHysteresis, JointTorque
from workbench.app.edits.changes import Change, effect_label

_LABEL = re.compile(r"(?P<name>\S+ at \S+)(?: \((?P<options>.*)\))?")
_OF_JOINT = (JointCurve.effect, JointTorque.effect, JointHysteresis.effect)
"""Effects whose options are readings of their joint: rad, mm of a slide."""
_OF_CLOCK = ("after", "start", "end", "time_constant")
_MOST_SHOWN = 4


@dataclass(frozen=True)
class Units:
    """Units of a recording: `slides`, places such as "joint-7" with readings in mm; `clock`, "s" or "rows"."""

    slides: frozenset[str] = frozenset()
    clock: str = "s"

    @classmethod
    def of(cls, samples) -> "Units":
        """Units of the samples of a recording."""
        names = joint_columns(samples.columns)
        slides = {f"joint-{name[1:-3]}" for name in names if name.endswith("_mm")}
        return cls(frozenset(slides), "s" if "time_s" in samples.columns else "rows")


def effect_title(label: str, units: Units) -> str:
    """An effect by its label as people read it.

    "joint-curve at joint-3 (end=2.2, start=-0.73, terms=7)" is "joint-curve at joint-3 (from -41.8 deg to 126 deg, 7
    terms)".
    """
    found = _LABEL.fullmatch(label)
    if found is None or not found["options"]:
        return label
    options_of_title = [part.partition("=") for part in found["options"].split(", ")]
    options = {key: value for key, _, value in options_of_title}
    words = []
    if {"start", "end"} <= options.keys():
        ends = [_value(key, options.pop(key), found["name"], units) for key in ("start", "end")]
        words.append(f"from {ends[0]} to {ends[1]}")
    words += [_option(key, value, found["name"], units) for key, value in options.items()]
    return f"{found['name']} ({', '.join(words)})"


def _option(key: str, value: str, name: str, units: Units) -> str:
    if key == "terms":
        return f"{value} terms"
    if key == "joint":
        return f"from joint {value}"
    return f"{key.replace('_', ' ')} {_value(key, value, name, units)}"


def _value(key: str, text: str, name: str, units: Units) -> str:
    """A value of an option with its unit: a reading of the joint of the effect, or an instant; else as it is."""
    try:
        value = float(text)
    except ValueError:
        return text
    effect, _, where = name.partition(" at ")
    if effect in _OF_JOINT:
        return f"{value:.4g} mm" if where in units.slides else f"{math.degrees(value):.4g} deg"
    return f"{value:.6g} {units.clock}" if key in _OF_CLOCK else text


def change_sentence(change: Change, units: Units) -> str:
    """A change of a session for people."""
    count = len(change.items)
    noun = change.kind if count != 1 else change.kind.removesuffix("s")
    because = f" ({change.why})" if change.why else ""
    return f"{change.action} {count} {noun}: {_listed(change.items, units)}{because}"


def _listed(items, units: Units) -> str:
    """The first items of a change, with an ellipsis where there are more."""
    shown = ", ".join(_shown(item, units) for item in items[:_MOST_SHOWN])
    return f"{shown}, …" if len(items) > _MOST_SHOWN else shown


def _shown(item: object, units: Units) -> str:
    label = effect_label(item) if isinstance(item, Mapping) else str(item)
    return effect_title(label, units)
