"""A diagnosis from its answer.json, place by place: what was found there, what else it may be, and the evidence."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from workbench.core.errors import InputError
from workbench.core.text.csv_text import csv_text
from workbench.explanation.sentences.words import measured
from workbench.report.text import p_value

_NO_ELEMENTS = ("time", "noise", "samples")
_SENSOR = ("artefact", "camera", "laser", "mirror", "sensor")
PIXELS = "px"
NEXT_POSES = "next-experiment-poses.csv"
"""Table of the poses of the next experiment in the folder of a diagnosis."""
_CONTROLS = {"permuted": "permutation control", "circular shift": "circular-shift control"}


@dataclass(frozen=True)
class Place:
    """A place of the measuring chain: `share` of the mismatch that acts there, and what was found.

    `found` and `refused`: rows of the answer's effects and refused terms at this place.
    """

    name: str
    share: float
    found: tuple[Mapping, ...]
    refused: tuple[Mapping, ...]


def places(answer: Mapping, joints: int) -> list[Place]:
    """The chain from base to target in order, then places that are no part of it.

    A diagnosis of images has the chain of the sensor, which holds no part of the arm.
    """
    rows = [*answer["effects"], *answer["refused"], *answer["located"]]
    named = {row["where"] for row in rows}
    if answer.get("unit") == PIXELS:
        arm = []
        order = list(_SENSOR)
    else:
        pairs = [(f"joint-{k}", f"link-{k}") for k in range(1, joints + 1)]
        arm = ["base", *(name for pair in pairs for name in pair)]
        order = [*arm, "flange", "tool", "sensor", "artefact", "external"]
    chain = [name for name in order if name in named or name in arm]
    unordered = sorted(named - set(order), key=lambda name: (name in _NO_ELEMENTS, name))
    return [_place(answer, name) for name in [*chain, *unordered]]


def _place(answer: Mapping, name: str) -> Place:
    shares = [row["share_of_mismatch"] for row in answer["located"] if _is_significant(row, name)]
    found = tuple(row for row in answer["effects"] if row["where"] == name)
    refused = tuple(row for row in answer["refused"] if row["where"] == name)
    return Place(name, max(shares, default=0.0), found, refused)


def _is_significant(row: Mapping, name: str) -> bool:
    return row["where"] == name and row["p_value"] < 0.01


def candidates(place: Place) -> list[dict]:
    """One row for each explanation at a place: effect, place, probability, size, decision and why."""
    rows = []
    for term, decision in [(t, "kept") for t in place.found] + [
        (t, "not kept") for t in place.refused
    ]:
        rows.append(_candidate(term, decision, term.get("reason", "")))
        rows += [_alternative(other) for other in term["alternatives"][:8]]
    return rows


def _candidate(term: Mapping, decision: str, why: str) -> dict:
    return {
        "effect": _name(term),
        "where": term["where"],
        "probability": _rounded(term["probability"], 2),
        "size": _size(term),
        "decision": decision,
        "why": why,
    }


def _size(term: Mapping) -> str:
    """Size of an effect with its unit: mm of an arm, px of a camera."""
    size = next((term[key] for key in ("size_mm", "size_px") if term.get(key) is not None), None)
    if size is None:
        return "–"
    unit = "mm" if "size_mm" in term else "px"
    return f"{size:.3g} {unit}"


def _alternative(other: Mapping) -> dict:
    missing = other.get("not_recorded")
    return {
        "effect": _name(other),
        "where": other["where"],
        "probability": _rounded(other["probability"], 2),
        "size": "–",
        "decision": "alternative",
        "why": f"{missing} is not recorded" if missing else other["why"],
    }


def _name(row: Mapping) -> str:
    return f"{row['effect']} ({row['variant']})" if row.get("variant") else row["effect"]


def _rounded(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def evidence(term: Mapping) -> list[tuple[str, str]]:
    """Name and value of what speaks for a term."""
    unit = "mm" if "held_out_gain_mm" in term else "px"
    gain = term.get(f"held_out_gain_{unit}")
    reselection = term.get("found_again") or term.get("reselected") or {}
    rows = [
        ("p-value", p_value(term.get("p_value"))),
        ("reduction of the held-out RMS error", "–" if gain is None else f"{gain:.3g} {unit}"),
        ("t over poses", _rounded(term.get("t"), 1)),
        ("reselected in folds", f"{reselection.get('folds', '–')} of {reselection.get('of', '–')}"),
    ]
    for control in term.get("controls", ()):
        passed = {True: "passed", False: "failed", None: "cannot decide"}[control["passed"]]
        name = _CONTROLS.get(control["control"], f"{control['control']} control")
        rows.append((name, f"{passed} (p-value {p_value(control['p_value'])})"))
    for row in term.get("parameters", ()):
        value = measured(row["value"], row.get("std"), row["unit"])
        rows.append((row.get("label") or row["name"], value))
    return [(name, value) for name, value in rows if value]


def term_label(term: Mapping) -> str:
    """Effect, its variant and its place."""
    return f"{_name(term)} at {term['where']}"


def plan_row(term: Mapping) -> dict:
    """A term of a diagnosis as an effect of a plan. Raises InputError for an effect that no plan can hold."""
    from robot_model.effects import CATALOGUE
    from workbench.core.effect import make_effects

    options = {k: value for k, value in term.get("options", {}).items() if k != "masses_found"}
    problems = []
    for name in _plan_names(term["effect"]):
        try:
            make_effects(CATALOGUE, [(name, term["where"], options)])
        except InputError as problem:
            problems.append(problem)
        else:
            return {"effect": name, "where": term["where"], **options}
    raise problems[0]


def _plan_names(effect: str) -> list[str]:
    """Names in the catalogue that a plan may give an effect: "warm-up" is another class at the base and at a link."""
    from robot_model.effects import CATALOGUE

    others = [name for name, kind in CATALOGUE.items() if kind.effect == effect and name != effect]
    return [effect, *others]


def plan_problem(term: Mapping) -> str:
    """Why a term cannot join the plan of `workbench calibrate`, "" where it can."""
    from robot_model.effects import CATALOGUE

    try:
        plan_row(term)
    except InputError as problem:
        is_known = term["effect"] in CATALOGUE
        return (
            str(problem) if is_known else "the plan of a calibration holds effects of the arm only"
        )
    return ""


def plan_effects(answer: Mapping, ticked: Sequence[int]) -> list[dict]:
    """Ticked terms of the answer as effects for a plan, each once; terms that no plan can hold are left out.

    ticked: places in the list of `effects` followed by `refused`.
    """
    terms = [*answer["effects"], *answer["refused"]]
    rows: list[dict] = []
    for term in (terms[k] for k in ticked if 0 <= k < len(terms)):
        row = {} if plan_problem(term) else plan_row(term)
        if row and row not in rows:
            rows.append(row)
    return rows


def pixel_residuals(folder: Path) -> dict[str, np.ndarray]:
    """Kind ("before", "after") -> (m,) px, length of the residuals of a diagnosis of images; {} where there are none.

    A residual of a stripe has one coordinate. Rows without any finite coordinate are left out.
    """
    from workbench.app.data.residuals import TABLE, read_columns

    path = folder / TABLE
    columns = read_columns(path) if path.is_file() else {}
    found = {}
    for kind in ("before", "after"):
        names = [f"{kind}_{axis}_px" for axis in "uv"]
        if all(name in columns for name in names):
            found[kind] = _lengths(np.stack([columns[name] for name in names]))
    return found


def _lengths(residual: np.ndarray) -> np.ndarray:
    """(m,) lengths of those residuals (2, n) that have a finite coordinate."""
    known = residual[:, np.isfinite(residual).any(0)]
    return np.sqrt(np.nansum(known**2, axis=0))


def write_plan(rows: Sequence[Mapping], path: Path) -> None:
    """Write a plan.toml for `workbench calibrate --plan`: base, tool and geometry, then the chosen effects."""
    import tomli_w

    from workbench.files.runs import replace_file

    stage = {
        "name": "diagnosis",
        "why": "effects that were chosen from a diagnosis",
        "effects": [dict(row) for row in rows],
    }
    replace_file(
        path,
        "# Effects alone; the app adds them to the default plan.\n"
        + tomli_w.dumps({"stage": [stage]}),
    )


@dataclass(frozen=True)
class NextPoses:
    """Poses of the next experiment: `names` of the joint readings with units, `readings` (k, J) in file units."""

    names: tuple[str, ...]
    readings: np.ndarray

    @property
    def rows(self) -> list[dict]:
        """One row a pose for a table: its number from 1, and its readings as text."""
        return [
            {"number": k, "readings": [f"{value:.2f}" for value in row]}
            for k, row in enumerate(self.readings.tolist(), 1)
        ]

    @property
    def as_csv(self) -> str:
        """The table as text to copy: a head with units, then one line a pose."""
        numbered = enumerate(self.readings.tolist(), 1)
        rows = [[k, *(f"{value:.10g}" for value in row)] for k, row in numbered]
        return csv_text(["pose", *self.names], rows)


def next_poses(folder: Path, robot) -> NextPoses | None:
    """Poses of the next experiment of a run; None where it has none. Raises InputError for a broken file.

    robot: the arm, whose slides are in mm and whose other joints in degrees; None for degrees alone.
    """
    path = folder / NEXT_POSES
    if not path.is_file():
        return None
    with path.open(encoding="utf-8", newline="") as file:
        head, *lines = [line for line in csv.reader(file) if line] or [[]]
    if not lines:
        return None
    return NextPoses(_with_units(head, robot), _numbers(lines, path))


def _numbers(lines: list[list[str]], path: Path) -> np.ndarray:
    """(k, J) readings of the rows of a file of poses. Raises InputError."""
    try:
        return np.array(lines, float)
    except ValueError as problem:
        raise InputError(
            f"{path}: expected one number for each joint in every row, found that {problem}; diagnose again"
        ) from None


def _with_units(head: Sequence[str], robot) -> tuple[str, ...]:
    slides = [] if robot is None else np.asarray(robot.prismatic).tolist()
    is_slide = [k < len(slides) and slides[k] for k in range(len(head))]
    return tuple(f"{name} ({'mm' if slide else 'deg'})" for name, slide in zip(head, is_slide))
