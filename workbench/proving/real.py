"""Real recordings in the examination: terms knocked out, effects planted into the readings, clues withheld.

The sets are other people's and no part of this project; where one is absent, its cases are left out and the
suite says so. What was made of them lies only in the folder of the examination.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from workbench.proving import planting

ROBOT_SETS = (
    "irb120_faro",
    "motoman_leica_ctu:right",
    "motoman_leica_ctu:left",
    "fanuc165f_innopolis",
    "irb120_wu_arm",
    "hilti_jaibot_tilt:flat",
)
PLANTED_SETS = ("irb120_faro", "motoman_leica_ctu:right", "motoman_leica_ctu:left", "irb120_wu_arm")
_FARO = "irb120_faro"
_THIN, _FIRST = 6, 200
"""Of the tracker's thousand configurations a case takes every sixth, or the first where one move follows another."""
WITHHELD = (
    ("elastic-first", _FARO, False, "commanded joints, base reflectors left out"),
    ("moves", f"{_FARO}:read-back", False, "joints as read back, base reflectors left out"),
    ("no-time", _FARO, True, "commanded joints, rows shuffled"),
    ("no-time", f"{_FARO}:read-back", True, "joints as read back, rows shuffled"),
)
"""Rule, set, whether the rows are shuffled, and what it is in words."""

_TIMES = (1.0, 1.0, 0.5, 2.0, 0.25)
"""What survives of planted effects over what is really left, one round of all sets after another."""

Made = tuple[Callable[[Path], None], Callable[[], str]]


def present(sets) -> list[str]:
    """Those of the sets whose files are here."""
    from datasets import find

    return [name for name in sets if find(name.partition(":")[0]) is not None]


def available(suite: str) -> tuple[int, str]:
    """Most cases of a real suite here, and why it has none."""
    reason = "its recordings are not on this machine: name their folder in WORKBENCH_RECORDINGS, or fetch them with "
    reason += "`workbench datasets get`"
    if suite == "real-withheld":
        count = len([1 for _, name, *_ in WITHHELD if present([name])])
    elif suite == "real-planted":
        count = 10**6 if present(PLANTED_SETS) else 0
    else:
        count = len(_knockable())
    return count, "" if count else reason


def made(suite: str, index: int, seed: int) -> Made:
    """How a case's recording is written, and its truth."""
    recording, truth = {
        "real-knocked-out": _knocked_out,
        "real-planted": _planted,
        "real-withheld": _withheld,
    }[suite](index, seed)
    truth = {
        "suite": suite,
        "index": index,
        "robot": recording.title or recording.name,
        "measures": recording.measures,
        "samples": recording.n,
        "sigma_mm": recording.sigma_mm,
        "noise": "real",
        "baseline": "geometry",
        **truth,
    }
    text = json.dumps(truth, indent=1, sort_keys=True) + "\n"
    return lambda folder: _write(recording, folder), lambda: text


def _write(recording, folder: Path) -> None:
    import datasets

    plain = replace(
        recording, title="An arm and its measured points", name="", source="", licence="", guess={}
    )
    datasets.write(plain, folder)


@lru_cache(maxsize=8)
def _moving(name: str):
    """The rows of a set that move with the arm: reflectors on the base are left out."""
    import datasets

    found = datasets.read(name)
    found = found.select(found.moving)
    return replace(found, columns={k: v for k, v in found.columns.items() if k != "fixed_to"})


@lru_cache(maxsize=8)
def _thinned(name: str):
    """Few enough rows for a diagnosis of minutes."""
    found = _moving(name)
    return found.select(found.poses % _THIN == 0) if name.startswith(_FARO) else found


# ------------------------------------------------------------------ knocked out


@lru_cache(maxsize=1)
def _knockable() -> tuple[tuple[str, int | None], ...]:
    """(set, number of the term) of every supported term; at None all of the terms are in."""
    rows = []
    for name in present(ROBOT_SETS):
        terms = planting.supported(_thinned(name), name)
        rows += [(name, k) for k in range(len(terms))] + ([(name, None)] if terms else [])
    return tuple(rows)


def _knocked_out(index: int, seed: int):
    """All supported terms but one are taken out of the readings; or all, and none may be named again."""
    name, term = _knockable()[index]
    recording = _thinned(name)
    terms = planting.supported(recording, name)
    kept = None if term is None else terms[term]
    corrected = planting.without(recording, name, tuple(t for t in terms if t != kept))
    told = {"terms": [[t.effect, t.where] for t in terms], "set": name}
    if kept is None:
        return corrected, {"rule": "not-again", "effects": [], **told}
    effect = {
        "effect": kept.effect,
        "where": kept.where,
        "detail": dict(kept.options),
        "accept": list(kept.twins),
        "places": [where for _, where in kept.twins],
    }
    return corrected, {"rule": "named", "effects": [effect], **told}


# --------------------------------------------------------------------- planted


def _planted(index: int, seed: int):
    """First every set as it is, then a copy of each with nothing planted, then effects planted into them in turn."""
    from workbench.proving.protocol import name_of

    here = present(PLANTED_SETS)
    which = index % len(here)
    recording, twin = _thinned(here[which]), name_of("real-planted", which, seed)
    rng = np.random.default_rng([seed, 77, index])
    if index < len(here):
        return recording, {"rule": "as-it-is", "effects": [], "set": here[which]}
    if index < 2 * len(here):
        copy = planting.jittered(recording, rng)
        return copy, {"rule": "unplanted", "effects": [], "set": here[which], "twin": twin}
    times = _TIMES[(index // len(here) - 2) % len(_TIMES)]
    planted, effect = planting.plant(recording, rng, times)
    return planted, {
        "rule": "planted",
        "effects": [effect],
        "set": here[which],
        "twin": twin,
        "times": times,
    }


# -------------------------------------------------------------------- withheld


def _withheld(index: int, seed: int):
    rule, name, shuffled, words = [row for row in WITHHELD if present([row[1]])][index]
    recording = _moving(name)
    recording = recording.select(recording.poses < _FIRST)
    if shuffled:
        order = np.random.default_rng([seed, 78, index]).permutation(recording.n)
        recording = recording.select(order)
        columns = recording.columns | {"sample": np.arange(1, recording.n + 1, dtype=float)}
        recording = replace(recording, columns={k: v for k, v in columns.items() if k != "pose"})
    return recording, {"rule": rule, "effects": [], "set": name, "what": words}


# --------------------------------------------------------------------- scoring


_CLOCKED = ("time", "approach", "step", "last")


def score(truth: Mapping, record: Mapping, twin: Mapping | None = None) -> dict:
    """One row of the scoreboard for a case that goes by a rule; twin: the record of the same set as it is."""
    from workbench.proving import scoring

    answer = record["answer"]
    row = {
        "outcome": "failed",
        "verdict": answer["verdict"] if answer else None,
        "claims": scoring.claims(answer),
        "seconds": record["seconds"],
        "note": record["refused"] or record["failed"],
    }
    if record["opened"] or answer is None:
        return row
    row |= {"detected": answer["verdict"] != "consistent", **scoring.errors(answer)}
    row["note"] = truth.get("what", "")
    if "twin" in truth and not (twin and twin["answer"]):
        return row | {
            "outcome": "reference",
            "note": "the same set as it is has no answer to compare with",
        }
    return row | _RULES[truth["rule"]](truth, answer, twin["answer"] if twin else None)


def _pairs(answer) -> set[tuple[str, str]]:
    return {(c["effect"], c["where"]) for c in answer["effects"]} if answer else set()


def _named(truth, answer, twin) -> dict:
    from workbench.proving import scoring

    one = truth["effects"][0]
    if any(scoring.same(c, one) for c in answer["effects"]):
        outcome = "exact"
    elif any(scoring.in_group(c, one) for c in answer["effects"]):
        outcome = "group"
    else:
        outcome = (
            "place"
            if scoring.place_right(one, answer)
            else "wrong"
            if answer["effects"]
            else "missed"
        )
    return {"outcome": outcome, "located": scoring.place_right(one, answer)}


def _planted_found(truth, answer, twin) -> dict:
    found = _named(truth, answer, twin)
    fresh = bool(_pairs(answer) - _pairs(twin))
    detected = fresh or found["outcome"] in ("exact", "group")
    return found | {"detected": detected, "outcome": found["outcome"] if detected else "missed"}


def _not_again(truth, answer, twin) -> dict:
    again = _pairs(answer) & {(t[0], t[1]) for t in truth["terms"]}
    return {"outcome": "false alarm" if again else "right", "located": None}


def _unplanted(truth, answer, twin) -> dict:
    unchanged = answer["verdict"] == twin["verdict"] and _pairs(answer) == _pairs(twin)
    return {"outcome": "right" if unchanged else "false alarm", "located": None}


def _elastic_first(truth, answer, twin) -> dict:
    first = answer["effects"][0]["effect"] if answer["effects"] else "none"
    return {"outcome": "exact" if first in _deflecting() else "wrong", "located": None}


def _deflecting() -> set[str]:
    """Names of effects that are deflections under gravity, in every variant."""
    from robot_model.effects import CATALOGUE

    others = {kind.effect for kind in CATALOGUE.values() if kind.elastic is not True}
    return {kind.effect for kind in CATALOGUE.values()} - others


def _moves(truth, answer, twin) -> dict:
    from workbench.proving import scoring

    said = {scoring.plain(n) for c in answer["effects"] for n in c.get("depends_on") or ()}
    said |= {name for c in answer["effects"] for name in _read_by(c)}
    found = any(name.startswith(("approach", "step", "last", "move")) for name in said)
    return {"outcome": "exact" if found else "missed", "located": found}


def _no_time(truth, answer, twin) -> dict:
    of_time = [
        c
        for c in answer["effects"]
        if any(name in ("time", "move") for name in _read_by(c))
        or any(n.startswith(_CLOCKED) for n in c.get("depends_on") or ())
    ]
    return {"outcome": "false alarm" if of_time else "right", "located": None}


def _read_by(claim) -> tuple[str, ...]:
    """Names or kinds of the covariates that a claimed effect is a function of; () where that is not known."""
    from robot_model.effects import CATALOGUE
    from workbench.core.effect import make_effects
    from workbench.proving.oracle import claimed_rows

    made = make_effects(CATALOGUE, claimed_rows({"effects": [claim]}))
    if made:
        return made[0].reads
    reads = getattr(CATALOGUE.get(claim["effect"]), "reads", ())
    return reads if isinstance(reads, tuple) else ()


_RULES = {
    "named": _named,
    "not-again": _not_again,
    "planted": _planted_found,
    "unplanted": _unplanted,
    "as-it-is": lambda truth, answer, twin: {"outcome": "reference", "located": None},
    "elastic-first": _elastic_first,
    "moves": _moves,
    "no-time": _no_time,
}
