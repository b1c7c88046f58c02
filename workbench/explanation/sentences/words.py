"""Findings in sentences that an engineer understands, with the figures in millimetres (or pixels).

What an effect is, its own class says in the first sentence of its docstring; here its place is put into that sentence,
and next to it what was found. There is no second catalogue.
"""

import math
import re
from collections.abc import Mapping, Sequence

from robot_model.effects import CATALOGUE as ROBOT
from sensors.effects import CATALOGUE as SENSOR
from workbench.core.text.uncertain import with_std
from workbench.core.vocabulary import Covariate, Place
from workbench.diagnosis.levels import CRITICAL_T, MAJORITY
from workbench.diagnosis.robot.derived import DEFLECTION, MOVE

TIPS = {
    "ball-centre": "the ball",
    "ball-surface": "the surface of the ball",
    "external-point": "the reflector",
}
_PLACES = {
    "time": "the clock",
    "noise": "the noise",
    "samples": "the samples",
    "world": "the floor",
}
_KINDS = {
    "approach": "the side from which {} came",
    "tau": "the gravity torque on {}",
    "q": "the position of {}",
    "qdot": "the speed of {}",
    "move": "the last move of {}",
    "temperature": "the temperature of {}",
}
_NAMES = {
    "sight_azimuth": "the azimuth of the instrument",
    "sight_elevation": "the elevation of the instrument",
    "sight_range": "the range of the instrument",
    "down_x": "gravity along the tool's x axis",
    "down_y": "gravity along the tool's y axis",
    "down_z": "gravity along the tool's z axis",
    "moment_x": "the overturning moment about x",
    "moment_y": "the overturning moment about y",
    "temperature_artefact_c": "the artefact's temperature",
    "time": "time",
    "time_s": "time",
    "row": "the order of the rows",
    "order": "the order of the rows",
    "temperature": "temperature",
    "temperature_c": "temperature",
    "payload": "the payload",
    "payload_kg": "the payload",
    "range": "the range",
    "range_mm": "the range",
    "u": "the column in the image",
    "v": "the row in the image",
    "approach": "the side from which each joint came",
    "speed": "the joints' speeds",
    "board_x": "the column of the board",
    "board_y": "the row of the board",
    "mirror": "the angle of the mirror",
    "along": "the place along the stripe",
    "line_brightness": "the brightness of the laser line",
    "line_width": "the width of the laser line",
    "incidence": "the angle of incidence",
    "ball": "which ball it is",
    "reflector": "which reflector it is",
}
_MAX_FIGURES = 3
_COEFFICIENTS = (
    12  # parameters of a law from which on single ones say nothing: those of a polynomial
)
_MASSES = "_mass_"  # in the name of a law's number for a first moment
_OTHER_JOINT = "joint J"
_MOVER = re.compile(r"from (joint \d+)")
_PART = "A part of the machine"  # in the sentence of an effect that may sit anywhere


def place(where: str) -> str:
    """'joint-3' as a sentence says it: 'joint 3'; 'base': 'the base'."""
    found = Place.of(where)
    if found.number is None:
        return _PLACES.get(where, f"the {where}")
    return f"{found.kind} {found.number}"


def covariate(name: str) -> str:
    """'approach3' as a sentence says it: 'the side from which joint 3 came'."""
    if name in _NAMES:
        return _NAMES[name]
    known = Covariate.of(name)
    if known.place is None or known.place.number is None:
        return name.replace("_", " ")
    element = f"{known.place.kind} {known.place.number}"
    if known.kind == "moment":
        return f"the bending moment of {element} about {known.component}"
    if known.kind in _KINDS:
        return _KINDS[known.kind].format(element)
    return name.replace("_", " ")


def listed(words: Sequence[str], last: str = "and") -> str:
    """'a', 'a and b', 'a, b and c'."""
    return f" {last} ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else list(words))


def law(effect: str, where: str, label: str = "", kind: type | None = None) -> str:
    """Describe an effect in words, with its place in it and without a full stop; its class says it."""
    if kind not in (*ROBOT.values(), *SENSOR.values()):  # a wrapper of one of them, or none known
        kind = _kind(effect, where)
    if kind is None:
        return f"{effect} at {place(where)}"
    sentence = (
        " ".join((kind.__doc__ or "").split("\n\n")[0].split())
        .rstrip(".")
        .replace(_PART, _capital(place(where)))
    )
    mover = _MOVER.fullmatch(label)
    if _OTHER_JOINT in sentence:  # the label says which one it is
        sentence = sentence.replace(_OTHER_JOINT, mover[1] if mover else "another joint")
    is_said = label.removeprefix("of its ").strip() in sentence or (mover and mover[1] in sentence)
    return _placed(sentence, where) + (f" ({label})" if label and not is_said else "")


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _kind(effect, where):
    """The class of a word of the vocabulary: the robot's where it sits on the arm, else the scanner's."""
    kinds = [
        kind
        for catalogue in (ROBOT, SENSOR)
        for kind in catalogue.values()
        if kind.effect == effect
    ]
    fitting = [kind for kind in kinds if Place.of(where).kind in kind.places]
    return (fitting or kinds or [None])[0]


def _placed(text: str, where: str) -> str:
    known = Place.of(where)
    if known.number is None:
        return text
    kind = known.kind
    number = known.number
    element = f"{kind} {number}"
    text = re.sub(
        rf"\b(?:the {kind}|an? {kind}|this {kind}|{kind} K)\b", element, text, flags=re.IGNORECASE
    )
    text = re.sub(rf"\b{kind.capitalize()} {number}\b|\b{kind} {number}\b", element, text)
    return text[0].upper() + text[1:]


def measured(value: float, std: float | None, unit: str) -> str:
    """'0.130 ± 0.010 mrad': value and its sigma with two digits of the sigma, in a unit that leaves no row of zeros."""
    size = abs(value) or (std or 0.0)
    name, factor = _unit(unit, size)
    ending = f" {name}" if name else ""
    scaled = value * factor
    scaled_std = 0.0 if std is None else std * factor
    has_std = scaled_std > 0 and math.isfinite(scaled_std)
    if not has_std:
        return _power(_signed(f"{scaled:.3g}")) + ending
    return _signed(with_std(scaled, scaled_std)) + ending


def _power(text: str) -> str:
    """'3.4e-05' as '3.4·10⁻⁵'."""
    number, exponent, power = text.partition("e")
    if not exponent:
        return text
    raised = str(int(power)).translate(str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻"))
    return f"{number}·10{raised}"


def _signed(text: str) -> str:
    return re.sub(r"(?<![\de])-", "−", text)


def _unit(unit: str, size: float) -> tuple[str, float]:
    """The unit with the prefix that brings a value of `size` between 0.1 and 1000, and the factor to it."""
    if unit in ("1/K", "1/h"):
        return "ppm" + unit[1:], 1e6
    first = unit.split("/")[0]
    steps = {
        "rad": (("rad", 1.0), ("mrad", 1e3), ("µrad", 1e6)),
        "mm": (("mm", 1.0), ("µm", 1e3)),
        "s": (("s", 1.0), ("ms", 1e3), ("µs", 1e6)),
    }.get(first)
    if steps is None:
        return ("" if unit == "1" else unit), 1.0
    name, factor = next(((n, f) for n, f in steps if size * f >= 0.1), steps[-1])
    return name + unit[len(first) :], factor


def length(value: float | None, unit: str = "mm") -> str:
    """'0.081 mm': two or three digits, in micrometres below 10 µm."""
    if value is None or not math.isfinite(value):
        return "no size"
    if unit == "mm" and abs(value) < 0.00995:
        return f"{value * 1e3:.2g} µm"
    if abs(value) < 1:
        return f"{value:.2g} {unit}"
    return f"{value:.3g} {unit}"


def figures(rows: Sequence[Mapping]) -> str:
    """The parameters of a finding: pairs of cosine and sine as amplitudes, at most three, the surest first."""
    if rows and "cycles" in rows[0]:
        others = [row for row in rows if row.get("effect") != rows[0].get("effect")]
        return _spectrum(rows[0], [row for _, row in _waves(others)])
    rows = _drop_shares_of_deflection([row for row in rows if row.get("acts", True)])
    masses = [row for row in rows if _MASSES in row["name"]]
    has_deflection = any(row["name"] == DEFLECTION for row in rows)
    vague = [row for row in rows if row not in masses and not row.get("identifiable", True)]
    rows = [row for row in rows if row not in masses and row not in vague]
    named_rows = list(_waves(rows)) or [
        (_name(row), row)
        for row in sorted(rows, key=lambda row: (not row.get("derived"), -_surety(row)))
    ]
    text = _listed_figures(named_rows)
    if vague:
        combined = f"{listed([row['name'] for row in vague])} identifiable only in combination"
        text = f"{text} ({combined})" if text else combined
    return text + (
        f" (with {len(masses)} numbers for masses that the data sheet does not know)"
        if masses and not has_deflection
        else ""
    )


def _drop_shares_of_deflection(rows: Sequence[Mapping]) -> list[Mapping]:
    """The rows without those that other rows state as a whole: shares of a deflection, and a tool's twist."""
    if any(row["name"].startswith(f"{MOVE}_") for row in rows):
        return [row for row in rows if row.get("derived")]
    units = {row["unit"] for row in rows if row["name"] == DEFLECTION}
    return [row for row in rows if row.get("derived") or row["unit"] not in units]


def _listed_figures(named_rows: Sequence[tuple[str, Mapping]]) -> str:
    """Values of named parameters; of many only significant ones, since others say nothing each by itself."""
    shown = named_rows
    if len(named_rows) > _COEFFICIENTS:
        return f"{len(named_rows)} coefficients"
    if len(named_rows) > _MAX_FIGURES:
        shown = [(name, row) for name, row in named_rows if _surety(row) >= CRITICAL_T]
        if not shown:
            return f"{len(named_rows)} parameters of which only combinations are identifiable"
    texts = [
        f"{name} {measured(row['value'], row['std'], row['unit'])}"
        for name, row in shown[:_MAX_FIGURES]
    ]
    unlisted_count = len(named_rows) - len(texts)
    return ", ".join(texts) + (f" and {unlisted_count} more" if unlisted_count else "")


def _spectrum(row: Mapping, harmonics: Sequence[Mapping] = ()) -> str:
    """Size of an error curve and its dominant cycles per revolution with their amplitudes.

    harmonics: amplitudes of harmonics that belong to the curve, named cosN.
    """
    unit = row["unit"]
    size = f"RMS {measured(row['curve_rms'], None, unit)}"
    if "reading_scale" in row:
        factor = with_std(*row["reading_scale"])
        return (
            f"{size}, a straight line: the reading is {factor} times the motion of the joint; correct the counts per "
            "degree or the gear constant"
        )
    if row["periodic_share"] < MAJORITY:
        return f"{size}, not periodic on the visited angles"
    per = "per revolution" if unit == "rad" else "per mm"
    waves = []
    for order, amplitude, of_motor in row["cycles"]:
        motor = f", {of_motor} per revolution of the motor" if of_motor else ""
        waves.append(f"{order:.3g} ({measured(amplitude, None, unit)}{motor})")
    for harmonic in harmonics:
        waves.append(
            f"{harmonic['name'].removeprefix('cos')} ({measured(harmonic['value'], None, unit)})"
        )
    return f"{size}, cycles {per}: {listed(waves)}"


def _name(row) -> str:
    return str(row.get("label") or row["name"]).replace("_", " ")


def _surety(row) -> float:
    if row["std"]:
        return abs(row["value"]) / row["std"]
    return 0.0


def _waves(rows):
    """(name, row) of the amplitude of each pair cosN, sinN; none where the rows are no such pairs."""
    known = {row["name"]: row for row in rows}
    pairs = [(name, f"sin{name[3:]}") for name in known if name.startswith("cos")]
    if 2 * len(pairs) != len(known) or not all(other in known for _, other in pairs):
        return
    for first, second in pairs:
        a = known[first]
        b = known[second]
        size = math.hypot(a["value"], b["value"])
        # the phase depends on an estimated order, the amplitude to first order not
        widths = [row.get("conditional_std", row["std"]) for row in (a, b)]
        if size:
            std = math.hypot(a["value"] * widths[0], b["value"] * widths[1]) / size
        else:
            std = widths[0]
        yield "amplitude", {"name": first, "value": size, "std": std, "unit": a["unit"]}


def errors(before: float, after: float, noise: float, source: str, unit: str) -> str:
    """The held-out errors in one sentence."""
    if after < before:
        shown = f"{length(before, unit)} to {length(after, unit)}"
    else:
        shown = f"{length(before, unit)}"
    verb = "falls from" if after < before else "stays at"
    return (
        f"Held-out error {verb} {shown} RMS; noise alone leaves {length(noise, unit)} ({source})."
    )
