"""Interpretation of a column header: quantity, component, object and unit.

English and German words, and the names that ROS, RTDE and the makers of robots and trackers use; `words` translates
those of other languages.
"""

import re
from dataclasses import dataclass, replace

from datasets.importers.mapping.columns.words import (
    LINKING,
    in_english,
    without_accents,
    without_east_asian,
)
from datasets.importers.units import ANGLES, COUNTS, LENGTHS, is_unit, unit_named

FLANGE_WORDS = frozenset(
    "flange flansch robot roboter tcp tool tool0 ee eef effector hand gripper werkzeug arm kuka abb fanuc "
    "yaskawa motoman staubli ur robotbase".split()
)
MEASURED_WORDS = frozenset(
    "tracker laser lasertracker lt smr tmac mess messung messpunkt measured measurement gemessen leica faro api "
    "hexagon reflector reflektor prism prisma target marker ball kugel sphere sensor scanner point punkt probe cmm "
    "kmg vicon camera kamera optitrack".split()
)
ACTUAL_WORDS = frozenset("actual act ist istwert istposition feedback state real".split())
NOMINAL_WORDS = frozenset(
    "soll sollwert nominal nom cmd commanded command setpoint ref reference desired theo programmed".split()
)
_POSITION_WORDS = frozenset(
    "position coordinate coordinates coord koordinate koordinaten value wert component komponente".split()
)
DEVIATION_WORDS = frozenset(
    "d dev deviation abweichung delta diff difference error fehler residual std stdev sigma rms min max speed velocity "
    "vel qd qdd acceleration current strom moment torque force effort geschwindigkeit".split()
)

_SPREADS = (("s",), ("u",))
_SUFFIX_UNITS = frozenset(
    "mm cm um m in inch inches zoll ft feet deg degree degrees grad rad radian radians gon mrad arcsec arcmin s ms us "
    "ns kg degc".split()
)
_BRACKETS = re.compile(r"^(.*?)[\[({<]\s*([^\])}>]*)\s*[\])}>]\s*$")
_INNER_BRACKETS = re.compile(r"^([^\[({<]*?)\s*[\[(]([^\])]*)[\])]\s+(\S.*)$")
_NUMBER_SIGN = re.compile(r"\bn[°º]|№", re.IGNORECASE)
_REPEATED = re.compile(r"(.+) (\(\d+\))")
_UR_JOINTS = {
    "shoulderpan": 1,
    "shoulderlift": 2,
    "elbow": 3,
    "wrist1": 4,
    "wrist2": 5,
    "wrist3": 6,
}
_PATTERNS = (
    ("rotvec", r"(?:rv|rvec|rotvec|rotationvector|rotationsvektor|rodrigues)([xyz123])"),
    ("matrix", r"(?:r|m|rot|t|a|h|rotation|matrix)([0-4])([0-4])"),
    ("qindex", r"(?:q|quat|quaternion)([0-4])"),
    ("qpart", r"(?:q|quat|quaternion)([rijk])"),
    ("turn", r"(?:q|quat|quaternion|orientation|orientierung)(?:v|vec|vector)?([wxyz])"),
    (
        "turn",
        r"(?:r|rot|rotation|rotate|drehung|drehungum|drehwinkel|drehwinkelum|rotationswinkel|rotationum|rotationabout|"
        r"winkel|winkelum|angle|ang|euler|ori)"
        r"([wxyz])",
    ),
    (
        "joint",
        r"(?:q|j|jt|rax|joint|joints|gelenk|achse|axis|axe|ax|a|theta|th|gelenkwinkel|achswinkel|achsenwinkel|jointangles?|angles|"
        r"jointpositions?|jointpos|jointvalues?|axisangle|axispos|axisposition|winkel|winkelachse|angle|jointa|position|"
        r"positions|pos)(\d{1,2})[a-z]?",
    ),
    (
        "xyz",
        r"(?:p|pos|position|punkt|point|coord|coordinate|koordinate|trans|translation|t|loc|location|center|centre|"
        r"mittelpunkt)?([xyz])",
    ),
    ("euler", r"(?:euler|eulerangle|eulerwinkel|e|rpy|eulerparameter)([0-6])"),
    ("posecomponent", r"(?:pose|frame|vec|vector)([0-6])"),
    ("axis", r"([noa])([xyz])"),
)
_OBJECTS = FLANGE_WORDS | MEASURED_WORDS | ACTUAL_WORDS | NOMINAL_WORDS
COMPONENTS = frozenset(
    "rotvec matrix qindex qpart turn joint xyz euler posecomponent axis word".split()
)
"""Kinds of headers that name one component of an object."""
_SHORTEST_REMARK = 4  # letters; shorter ones are units more often than words
_SCALAR_PART = re.compile(r"(?:q|quat|quaternion)(?:scalar|real|re|s)")
_LONGEST = 200  # letters of a header that can have a meaning
_NUMBERED = MEASURED_WORDS | frozenset(
    "p xyz pos position positions points coords coordinates translation translations center centre".split()
)
_WORDS = {
    "roll": ("rpy", "x"),
    "rollen": ("rpy", "x"),
    "pitch": ("rpy", "y"),
    "nicken": ("rpy", "y"),
    "yaw": ("rpy", "z"),
    "gieren": ("rpy", "z"),
    "alpha": ("greek", "1"),
    "beta": ("greek", "2"),
    "gamma": ("greek", "3"),
    "phi": ("phi", "1"),
    "theta": ("phi", "2"),
    "psi": ("phi", "3"),
    "omega": ("omega", "1"),
    "kappa": ("omega", "3"),
    "a": ("abc", "1"),
    "b": ("abc", "2"),
    "c": ("abc", "3"),
    "o": ("oat", "1"),
    "w": ("wpr", "1"),
    "p": ("wpr", "2"),
    "r": ("wpr", "3"),
    "s": ("slurbt", "1"),
    "l": ("slurbt", "2"),
    "u": ("slurbt", "3"),
}
_SINGLE = (
    (
        "time",
        r"time|timestamp|zeit|zeitstempel|t|uhrzeit|datetime|stamp|messzeit|clock|times|timestamps",
    ),
    ("date", r"date|datum"),
    (
        "sample",
        r"sample|nr|lp|no|num|number|nummer|id|index|idx|lfdnr|messung|meas|measurement|row|zeile|n|posenr",
    ),
    (
        "name",
        r"name|point|punkt|pointname|punktname|label|bezeichnung|pointid|positionname|positionsname|posname",
    ),
    ("pose", r"pose|poseid|posenumber|station"),
    ("repeat", r"repeat|wiederholung"),
    ("reflector", r"reflector|reflektor|smr|marker|target|reflectorid|targetid"),
    ("ball", r"ball|kugel|sphere|ballid|kugelnr"),
    (
        "image",
        r"image|bild|file|filename|datei|dateiname|img|picture|foto|imagename|imagefile|bilddatei",
    ),
    ("cloud", r"cloud|scan|punktwolke|scanfile|pointcloud"),
    (
        "temperature_c",
        r"(?:luft|air|room|raum|umgebungs|ambient)?(?:temp|temperature|temperatur|tempc|temperaturec)|ambient",
    ),
    ("payload_kg", r"payload|load|last|nutzlast|traglast"),
    ("length_mm", r"length|distance|laenge|abstand|dist"),
    ("pair", r"pair|paar"),
)


@dataclass(frozen=True)
class Header:
    """A header in parts: `kind` of quantity ("" where unknown), `label` of the component, words before it, unit."""

    name: str
    kind: str
    label: str
    words: tuple[str, ...]
    unit: str | None
    core: str

    @property
    def is_nominal(self) -> bool:
        """Whether the value was commanded, not measured."""
        return bool(NOMINAL_WORDS & set(self.words))

    @property
    def is_deviation(self) -> bool:
        """Whether the value is a difference, a spread, a speed or a load.

        A last letter d is one of a series, as in "axis A" to "axis F": it means a difference where it stands in front
        of a component, or alone. So do s and u in front of an axis: sX is a standard deviation, uX an uncertainty.
        """
        if self.kind == "xyz" and self.words[-1:] in _SPREADS:
            return True
        series = {"d"} if len(self.words) > 1 and self.words[-1] == "d" else set()
        return bool(DEVIATION_WORDS & {*self.words, self.core} - series)


def read_header(name: str, unit: str | None = None) -> Header:
    """The parts of a header; unit: what a row of units or the format states for the column.

    A name that two tables have is "table: name"; the words of the table stand in front.
    """
    table, _, column = name.rpartition(": ")
    if table and (column_header := read_header(column, unit)).kind:
        return replace(
            column_header, name=name, words=(*_words(_plain(table)), *column_header.words)
        )
    repeated = _REPEATED.fullmatch(name)
    text, found = _split_unit(_plain(repeated[1] if repeated else name))
    words = [repeated[2], *_words(text)] if repeated else _words(text)
    if found is None and len(words) > 1 and words[-1] in _SUFFIX_UNITS:
        found = unit_named(words[-1])
        words = words[:-1]
        if len(words) > 1 and words[-1] == "in":
            words = words[:-1]
    if found is None and len(words) > 2 and words[-1].isdigit() and words[-2] in _SUFFIX_UNITS:
        found = unit_named(words.pop(-2))  # "point_mm 1", the first column of an array
    stated = unit_named(unit) if unit else None
    words = _without_position(_object_first(words))
    for count in range(min(4, len(words)), 0, -1):
        core = "".join(words[-count:])
        kind, label = _kind(core)
        if kind == "joint" and _has_foreign_unit(name, unit):
            return Header(name, "", "", tuple(words), None, core)
        if kind:
            return Header(name, kind, label, tuple(words[:-count]), found or stated, core)
    bracket = _BRACKETS.match(name)
    if bracket and bracket[1].strip() and _is_remark(bracket[2]):
        # such as "X (calibrated)": the object that the remark names comes first
        plain = read_header(bracket[1], unit)
        if plain.kind in COMPONENTS:
            remark = tuple(_words(_plain(bracket[2])))
            remark = () if len(remark) > 1 else remark  # a sentence names no object
            return replace(plain, name=name, words=(*plain.words, *remark))
    return Header(name, "", "", tuple(words), found or stated, "".join(words))


def _object_first(words: list[str]) -> list[str]:
    """Words with the object in front of its component: "x of the flange" and "x flange" as "flange x"."""
    kept = [word for word in words if word not in LINKING] if len(words) > 2 else words
    count = 0
    while count < len(kept) - 1 and kept[-1 - count] in _OBJECTS:
        count += 1
    front = kept[: len(kept) - count]
    if count == 0 or not any(_kind("".join(front[-k:]))[0] in COMPONENTS for k in (1, 2, 3)):
        return kept if count == 0 else words
    return [*kept[len(kept) - count :], *front]


def _without_position(words: list[str]) -> list[str]:
    """Words without a noun after their component: "x coordinate" and "x position" as "x"."""
    if len(words) > 1 and words[-1] in _POSITION_WORDS and words[-2] in ("x", "y", "z"):
        return words[:-1]
    return words


def _plain(name: str) -> str:
    """The name without umlauts and accents."""
    text = (
        without_east_asian(_NUMBER_SIGN.sub(" nr ", name))
        .replace("°C", " degc")
        .replace("ä", "ae")
        .replace("ö", "oe")
        .replace("ü", "ue")
        .replace("ß", "ss")
        .replace("°", "deg")
    )
    text = text.replace("Ä", "Ae").replace("Ö", "Oe").replace("Ü", "Ue").replace("µ", "u")
    for letter, word in (
        ("α", "alpha"),
        ("β", "beta"),
        ("γ", "gamma"),
        ("θ", "theta"),
        ("φ", "phi"),
        ("ψ", "psi"),
    ):
        text = text.replace(letter, word)
    return without_accents(text)


def _split_unit(text: str) -> tuple[str, str | None]:
    match = _BRACKETS.match(text)
    if match and match[1].strip():
        unit = None if _is_index(text, match) else unit_named(match[2])
        return (match[1], unit) if unit else (f"{match[1]} {match[2]}", None)
    inner = _INNER_BRACKETS.match(text)
    if inner and not inner[2].strip().isdigit() and unit_named(inner[2]):
        return f"{inner[1]} {inner[3]}", unit_named(inner[2])  # "X (mm) flange"
    return text, None


def _has_foreign_unit(name: str, unit: str | None) -> bool:
    """Whether brackets or a row of units state a unit that no joint reading has, as of a current or a temperature."""
    bracket = _BRACKETS.match(name)
    texts = [unit or "", bracket[2] if bracket else ""]
    return any(
        is_unit(text) and unit_named(text) not in (*ANGLES, *LENGTHS, COUNTS) for text in texts
    )


def _is_remark(text: str) -> bool:
    """Whether brackets hold words that are no unit, not even one that columns of forces or currents have."""
    words = text.split()
    return all(map(str.isalpha, words)) and len(text) >= _SHORTEST_REMARK and not is_unit(text)


def _is_index(text: str, match: re.Match) -> bool:
    """Whether brackets hold the index of an array, as in "q[1]", and not the unit 1, as in "qw [1]"."""
    is_attached = not text[: match.end(1)].endswith(" ")
    return match[2].isdigit() and is_attached and not _kind(match[1].strip().lower())[0]


def _words(text: str) -> list[str]:
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    words = re.split(r"[^A-Za-z0-9]+", spaced.lower().replace("A-Z", ""))
    return in_english([part for part in words if part])


def _kind(core: str) -> tuple[str, str]:
    """(kind, label) of the last words of a header, run together; ("", "") where they mean nothing."""
    if len(core) > _LONGEST:  # the patterns take a time that grows with the square of the length
        return "", ""
    plain = core.removesuffix("joint")
    if plain in _UR_JOINTS:
        return "joint", str(_UR_JOINTS[plain])
    if _SCALAR_PART.fullmatch(core):
        return "turn", "w"
    for kind, pattern in _PATTERNS:
        match = re.fullmatch(pattern, core)
        if match:
            return kind, "".join(match.groups())
    match = re.fullmatch(
        r"[a-z0-9]*?(?:joint|achse|gelenk)a?(\d{1,2})(?:[a-z]|pos|position|angle|value)?", core
    )
    match = match or re.fullmatch(r"axis(\d{1,2})(?:pos|position|angle|value)", core)
    if match:
        return "joint", match[1]
    if core in _WORDS:
        return "word", core
    match = re.fullmatch(r"([a-z]+)(\d)", core)
    if match and match[1] in _NUMBERED:
        return "numbered", match[2]
    for kind, pattern in _SINGLE:
        if re.fullmatch(pattern, core):
            return kind, ""
    return "", ""
