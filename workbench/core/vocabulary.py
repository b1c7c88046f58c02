"""Places and covariates: what their names in files and answers say, read in one place.

A place is written "base" or "joint-3". A covariate is written as its column in samples.csv ("q3_deg",
"temperature_j2_c", "time_s") or as what is derived from the readings ("tau3", "move3", "moment2_x").
"""

import re
from dataclasses import dataclass
from functools import cache

CLOCKS = ("time", "row", "order")
SIGNED = ("approach", "sweep")
_NUMBERED = {
    "q": "joint",
    "qdot": "joint",
    "move": "joint",
    "approach": "joint",
    "tau": "joint",
    "torque": "joint",
    "current": "joint",
    "moment": "link",
}
_PLACE = re.compile(rf"({'|'.join(_NUMBERED)})(\d+)(?:_(\w+))?")
_VECTOR = re.compile(r"(moment|down|seen)(\d*)_([xyz])")
_TEMPERATURE = re.compile(r"temperature(?:_(\w+))?_c")
_ACCELERATION = re.compile(r"accel_(\w+)_([xyz])_m_s2")
_PART = re.compile(r"(j|joint|link)_?(\d+)")
_UNIT = re.compile(r"(\w+?)_(deg_s|mm_s|deg|rad|mm|px|kg|nm|s|c)")


@dataclass(frozen=True)
class Place:
    """Place of an effect: `kind` ("joint", "base", ...) and its `number`, None where there is only one."""

    kind: str
    number: int | None = None

    @classmethod
    def of(cls, where: str) -> "Place":
        """Of its name: "joint-3", "base"."""
        kind, _, number = where.rpartition("-")
        if kind and number.isdecimal():
            return cls(kind, int(number))
        return cls(where)

    def __str__(self) -> str:
        if self.number is None:
            return self.kind
        return f"{self.kind}-{self.number}"


@dataclass(frozen=True)
class Covariate:
    """Kind of a covariate: its `kind`, the `place` that it belongs to, and its `unit`.

    `component`: axis of a vector ("x"); "" of a scalar.
    `is_signed`: a direction of motion, of which only the sign counts. `unit` "" where the name has none.
    """

    kind: str
    place: Place | None = None
    unit: str = ""
    component: str = ""

    @classmethod
    def of(cls, name: str) -> "Covariate":
        """Of its name; one that is not known is a kind of its own."""
        return _read(name)

    @property
    def is_signed(self) -> bool:
        return self.kind in SIGNED

    @property
    def is_reading(self) -> bool:
        """Whether it is the reading of a joint as it stands in samples.csv."""
        return self.kind == "q" and self.unit in ("deg", "mm")

    @property
    def is_angle(self) -> bool:
        """Whether it is the reading of a revolute joint as it stands in samples.csv."""
        return self.is_reading and self.unit == "deg"


@cache
def _read(name: str) -> Covariate:
    if found := _VECTOR.fullmatch(name):
        place = Place("link", int(found[2])) if found[2] else None
        return Covariate(found[1], place, component=found[3])
    if found := _PLACE.fullmatch(name):
        return Covariate(found[1], Place(_NUMBERED[found[1]], int(found[2])), found[3] or "")
    if found := _TEMPERATURE.fullmatch(name):
        return Covariate("temperature", _part(found[1]), "c")
    if found := _ACCELERATION.fullmatch(name):
        return Covariate("acceleration", Place(found[1]), "m_s2", found[2])
    if found := _UNIT.fullmatch(name):
        return Covariate(found[1], unit=found[2])
    return Covariate(name)


def _part(word: str | None) -> Place | None:
    """The place that a thermometer stands at: "j2" is joint 2; None for the room."""
    if not word:
        return None
    found = _PART.fullmatch(word)
    if not found:
        return Place(word)
    return Place("link" if found[1] == "link" else "joint", int(found[2]))
