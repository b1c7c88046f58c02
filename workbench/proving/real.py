"""Real recordings in the benchmark: fitted terms removed, effects planted into the readings, covariates withheld.

The recordings are public data of third parties and not part of this project. If one is absent, its cases are skipped
and the suite states this. Derived recordings are written only to the folder of the benchmark run.
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
"""A case uses every sixth of the tracker's configurations, or the first 200 if the sequence of moves matters."""
WITHHELD = (
    ("elastic-first", _FARO, False, "commanded joints, base reflectors left out"),
    ("moves", f"{_FARO}:read-back", False, "joints as read back, base reflectors left out"),
    ("no-time", _FARO, True, "commanded joints, rows shuffled"),
    ("no-time", f"{_FARO}:read-back", True, "joints as read back, rows shuffled"),
)
"""Rule, recording, whether the rows are shuffled, and description."""

_TIMES = (1.0, 1.0, 0.5, 2.0, 0.25)
"""RMS of planted effects over the RMS of the real residual; the index advances after each round of all recordings."""

Made = tuple[Callable[[Path], None], Callable[[], str]]


def present(names) -> list[str]:
    """The recordings whose files are present."""
    from datasets import find

    return [name for name in names if find(name.partition(":")[0]) is not None]


def available(suite: str) -> tuple[int, str]:
    """Largest number of cases of a real suite here, and the reason if it has none."""
    reason = "its recordings are not on this machine: set WORKBENCH_RECORDINGS to their folder, or download them with "
    reason += "`workbench datasets get`"
    if suite == "real-withheld":
        count = len([1 for _, name, *_ in WITHHELD if present([name])])
    elif suite == "real-planted":
        count = 10**6 if present(PLANTED_SETS) else 0
    else:
        count = len(_knockable())
    return count, "" if count else reason


def made(suite: str, index: int, seed: int) -> Made:
    """A function that writes the recording of a case, and one that returns its truth."""
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
    """The samples of a recording that move with the arm, without reflectors on the base."""
    import datasets

    found = datasets.read(name)
    found = found.select(found.moving)
    columns = {k: v for k, v in found.columns.items() if k != "fixed_to"}
    return replace(found, columns=columns)


@lru_cache(maxsize=8)
def _thinned(name: str):
    """A recording thinned to a size that is diagnosed in minutes."""
    found = _moving(name)
    if name.startswith(_FARO):
        return found.select(found.poses % _THIN == 0)
    return found


# ------------------------------------------------------------------ removed terms


@lru_cache(maxsize=1)
def _knockable() -> tuple[tuple[str, int | None], ...]:
    """(recording, number of the term) of every supported term; None stands for all terms removed."""
    rows = []
    for name in present(ROBOT_SETS):
        terms = planting.supported(_thinned(name), name)
        rows += [(name, k) for k in range(len(terms))] + ([(name, None)] if terms else [])
    return tuple(rows)


def _knocked_out(index: int, seed: int):
    """All supported terms but one are removed from the readings; or all, and none of them may be named."""
    name, term = _knockable()[index]
    recording = _thinned(name)
    terms = planting.supported(recording, name)
    retained_terms = None if term is None else terms[term]
    corrected = planting.without_contribution(
        recording, name, tuple(t for t in terms if t != retained_terms)
    )
    common = {"terms": [[t.effect, t.where] for t in terms], "set": name}
    if retained_terms is None:
        return corrected, {"rule": "not-again", "effects": [], **common}
    effect = {
        "effect": retained_terms.effect,
        "where": retained_terms.where,
        "detail": dict(retained_terms.options),
        "accept": list(retained_terms.confounded),
        "places": [where for _, where in retained_terms.confounded],
    }
    return corrected, {"rule": "named", "effects": [effect], **common}


# --------------------------------------------------------------------- planted


def _planted(index: int, seed: int):
    """First every recording unchanged, then a copy of each without a planted effect, then planted effects in turn."""
    from workbench.proving.protocol import name_of

    available = present(PLANTED_SETS)
    number = index % len(available)
    recording = _thinned(available[number])
    original = name_of("real-planted", number, seed)
    rng = np.random.default_rng([seed, 77, index])
    if index < len(available):
        return recording, {"rule": "as-it-is", "effects": [], "set": available[number]}
    if index < 2 * len(available):
        copy = planting.jittered(recording, rng)
        return copy, {
            "rule": "unplanted",
            "effects": [],
            "set": available[number],
            "twin": original,
        }
    times = _TIMES[(index // len(available) - 2) % len(_TIMES)]
    planted, effect = planting.plant(recording, rng, times)
    return planted, {
        "rule": "planted",
        "effects": [effect],
        "set": available[number],
        "twin": original,
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


def score(truth: Mapping, record: Mapping, original: Mapping | None = None) -> dict:
    """One row of the scoreboard for a case with a rule; original: the record of the unchanged recording."""
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
    if "twin" in truth and not (original and original["answer"]):
        return row | {
            "outcome": "reference",
            "note": "the unchanged recording has no answer to compare with",
        }
    return row | _RULES[truth["rule"]](truth, answer, original["answer"] if original else None)


def _pairs(answer) -> set[tuple[str, str]]:
    if answer:
        return {(c["effect"], c["where"]) for c in answer["effects"]}
    return set()


def _named(truth, answer, original) -> dict:
    from workbench.proving import scoring

    planted = truth["effects"][0]
    if any(scoring.same(c, planted) for c in answer["effects"]):
        outcome = "exact"
    elif any(scoring.in_group(c, planted) for c in answer["effects"]):
        outcome = "group"
    else:
        outcome = (
            "place"
            if scoring.place_right(planted, answer)
            else "wrong"
            if answer["effects"]
            else "missed"
        )
    return {"outcome": outcome, "located": scoring.place_right(planted, answer)}


def _planted_found(truth, answer, original) -> dict:
    found = _named(truth, answer, original)
    has_new_claim = bool(_pairs(answer) - _pairs(original))
    detected = has_new_claim or found["outcome"] in ("exact", "group")
    return found | {"detected": detected, "outcome": found["outcome"] if detected else "missed"}


def _not_again(truth, answer, original) -> dict:
    renamed = _pairs(answer) & {(t[0], t[1]) for t in truth["terms"]}
    return {"outcome": "false alarm" if renamed else "right", "located": None}


def _unplanted(truth, answer, original) -> dict:
    same_verdict = answer["verdict"] == original["verdict"]
    unchanged = same_verdict and _pairs(answer) == _pairs(original)
    return {"outcome": "right" if unchanged else "false alarm", "located": None}


def _elastic_first(truth, answer, original) -> dict:
    first = answer["effects"][0]["effect"] if answer["effects"] else "none"
    return {"outcome": "exact" if first in _deflecting() else "wrong", "located": None}


def _deflecting() -> set[str]:
    """Names of effects that are deflections under gravity in all variants."""
    from robot_model.effects import CATALOGUE

    others = {kind.effect for kind in CATALOGUE.values() if kind.elastic is not True}
    return {kind.effect for kind in CATALOGUE.values()} - others


def _moves(truth, answer, original) -> dict:
    from workbench.proving import scoring

    claimed_columns = {
        scoring.plain(n) for c in answer["effects"] for n in c.get("depends_on") or ()
    }
    claimed_columns |= {name for c in answer["effects"] for name in _read_by(c)}
    found = any(name.startswith(("approach", "step", "last", "move")) for name in claimed_columns)
    return {"outcome": "exact" if found else "missed", "located": found}


def _no_time(truth, answer, original) -> dict:
    of_time = [
        c
        for c in answer["effects"]
        if any(name in ("time", "move") for name in _read_by(c))
        or any(n.startswith(_CLOCKED) for n in c.get("depends_on") or ())
    ]
    return {"outcome": "false alarm" if of_time else "right", "located": None}


def _read_by(claim) -> tuple[str, ...]:
    """Names or kinds of the covariates of a claimed effect; () if unknown."""
    from robot_model.effects import CATALOGUE
    from workbench.core.effect import make_effects
    from workbench.proving.oracle import claimed_rows

    effects_of_claim = make_effects(CATALOGUE, claimed_rows({"effects": [claim]}))
    if effects_of_claim:
        return effects_of_claim[0].reads
    reads = getattr(CATALOGUE.get(claim["effect"]), "reads", ())
    return reads if isinstance(reads, tuple) else ()


_RULES = {
    "named": _named,
    "not-again": _not_again,
    "planted": _planted_found,
    "unplanted": _unplanted,
    "as-it-is": lambda truth, answer, original: {"outcome": "reference", "located": None},
    "elastic-first": _elastic_first,
    "moves": _moves,
    "no-time": _no_time,
}
