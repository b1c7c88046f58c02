"""Fixed scoring rules: they read only the JSON of the answer and the truth.

Outcomes of a case with planted effects:

| outcome | when |
|---|---|
| exact | the true effect at the true place for every planted effect, and no further claim |
| group | as exact, but at least one truth is only among the declared alternatives of a claim |
| more | every truth is named or in a declared group, and there is a further claim |
| part | some of several truths are named |
| place | the true place, with a wrong name or none |
| abstained | `unexplained`, at another place or none |
| wrong | a wrong name at a wrong place |
| missed | `consistent` |
| failed | no answer, or a forbidden file was opened |

Outcomes of a clean case: right, or false alarm. In addition to the outcome, a case is confidently wrong if a wrong
claim has a probability of at least 0.95 and does not declare the truth among its alternatives.
"""

from collections.abc import Mapping, Sequence

CONFIDENT = 0.95
NAMED = ("exact", "group")
NOISE_CLAIMS = {"stated-noise": "wrong sigma stated", "noise-heavy-tailed": "heavy-tailed"}
"""Findings on the noise, and the words of a case's noise of which each is the correct claim."""
"""In the truth's words for the noise."""


def score(truth: Mapping, record: Mapping) -> dict:
    """One row of the scoreboard. truth: as committed; record: written by `workbench.proving.protocol.run`."""
    answer = record["answer"]
    row = {
        "outcome": "failed",
        "verdict": answer["verdict"] if answer else None,
        "claims": claims(answer),
        "seconds": record["seconds"],
        "note": record["refused"] or record["failed"],
    }
    if record["opened"]:
        return row | {"note": "opened " + ", ".join(record["opened"][:3])}
    if answer is None:
        refused = record["refused"] and _is(truth, "unit-or-frame")
        return row | ({"outcome": "exact", "detected": True, "located": True} if refused else {})
    return row | score_answer(truth, answer)


def score_answer(truth: Mapping, answer: Mapping) -> dict:
    """Outcome, place, confidence and held-out errors of an answer."""
    true = truth["effects"]
    answer = without_noise_claims(truth, answer)
    found = {
        "detected": _is_detected(answer),
        "first": _first(answer),
        "confidently_wrong": any(_confidently_wrong(effect, true) for effect in answer["effects"]),
        "wrong_name": any(
            effect["effect"] != "unknown" and not _stands_for(effect, true)
            for effect in answer["effects"]
        ),
        "beliefs": [
            (effect["probability"], _right(effect, true))
            for effect in answer["effects"]
            if effect.get("probability") is not None
        ],
        "asks": len(answer.get("not_recorded") or ()),
        **errors(answer),
    }
    if not true:
        return found | {"outcome": "false alarm" if found["detected"] else "right", "located": None}
    found |= {
        "located": all(place_right(effect, answer) for effect in true),
        "located_in_group": all(place_right(effect, answer, groups=True) for effect in true),
        "group_size": max(
            (1 + len(c.get("alternatives", ())) for c in answer["effects"] if _stands_for(c, true)),
            default=None,
        ),
        "covariates_right": covariates_right(true[0], answer),
        **_detectable(truth, answer),
        "asks_for_it": names_words(truth.get("words", ()), answer),
    }
    unnamed = all(effect["effect"] == "unknown" for effect in true)
    if unnamed:
        outcome = _outside_catalogue(true, answer, found)
    else:
        outcome = _named(true, answer, found)
    return found | {"outcome": outcome}


def without_noise_claims(truth: Mapping, answer: Mapping) -> Mapping:
    """The answer without correct claims on the noise: that the stated sigma is wrong, that it is heavy-tailed.

    They say nothing of the effects; an answer that claims nothing else counts as `consistent`.
    """
    noise = truth.get("noise", "")
    correct = {effect for effect, words in NOISE_CLAIMS.items() if words in noise}
    others = [claim for claim in answer["effects"] if claim["effect"] not in correct]
    if len(others) == len(answer["effects"]):
        return answer
    is_explained = answer["verdict"] == "explained" and not others
    return {
        **answer,
        "effects": others,
        "verdict": "consistent" if is_explained else answer["verdict"],
    }


def _named(true: Sequence[Mapping], answer: Mapping, found: Mapping) -> str:
    claims = answer["effects"]
    if not found["detected"]:
        return "missed"
    exact = [any(same(c, effect) for c in claims) for effect in true]
    group = [any(in_group(c, effect) for c in claims) for effect in true]
    extra = any(not _stands_for(c, true) for c in claims)
    if all(a or b for a, b in zip(exact, group)):
        return "more" if extra else "exact" if all(exact) else "group"
    if len(true) > 1 and any(a or b for a, b in zip(exact, group)):
        return "part"
    if found["located"]:
        return "place"
    return "abstained" if answer["verdict"] == "unexplained" else "wrong"


def _outside_catalogue(true: Sequence[Mapping], answer: Mapping, found: Mapping) -> str:
    """Outcome for an effect outside the catalogue.

    exact: `unexplained` at the true place, without a name; or an effect of the catalogue that is equivalent in these
    data, where the truth accepts one.
    """
    if not found["detected"]:
        return "missed"
    if all(any(same(claim, effect) for claim in answer["effects"]) for effect in true):
        return "more" if found["wrong_name"] else "exact"
    if answer["verdict"] != "unexplained":
        return "wrong"
    if found["wrong_name"]:
        return "more"
    return "exact" if found["located"] else "abstained"


def same(claim: Mapping, planted: Mapping) -> bool:
    """True if a claim, or an alternative, is the truth `one` or an effect that is equivalent in these data."""
    pairs = {
        (planted["effect"], planted["where"]),
        *(tuple(pair) for pair in planted.get("accept", ())),
    }
    return (claim["effect"], claim["where"]) in pairs


def in_group(claim: Mapping, planted: Mapping) -> bool:
    """True if the claim declares the truth as a confounded alternative."""
    return any(same(other, planted) for other in claim.get("alternatives", ()))


def _stands_for(claim: Mapping, true: Sequence[Mapping]) -> bool:
    return any(same(claim, effect) or in_group(claim, effect) for effect in true)


def _right(claim: Mapping, true: Sequence[Mapping]) -> bool:
    """True if a claim is correct; an unnamed claim is correct at the place of an effect outside the catalogue."""
    if claim["effect"] != "unknown":
        return any(same(claim, effect) for effect in true)
    return any(
        effect["effect"] == "unknown" and claim["where"] in _places(effect) for effect in true
    )


def _confidently_wrong(claim: Mapping, true: Sequence[Mapping]) -> bool:
    sure = (claim.get("probability") or 0.0) >= CONFIDENT and claim["effect"] != "unknown"
    return sure and not _stands_for(claim, true)


def _places(planted: Mapping) -> set[str]:
    return {planted["where"], *planted.get("places", ())}


def place_right(planted: Mapping, answer: Mapping, groups: bool = False) -> bool:
    """True if the answer states the place of the truth, as the place of a claim or as the first located place.

    groups: the places of declared alternatives count as well.
    """
    stated = {claim["where"] for claim in answer["effects"]}
    stated |= {row["where"] for row in answer["located"][:1]}
    if groups:
        for claim in answer["effects"]:
            stated |= {other["where"] for other in claim.get("alternatives", ())}
    return bool(stated & _places(planted))


def covariates_right(planted: Mapping, answer: Mapping) -> bool | None:
    """True if a stated covariate of an unnamed effect is one of its true covariates; None without a truth."""
    if not planted.get("depends_on"):
        return None
    known = {plain(name) for name in planted["depends_on"]}
    claims = [c for c in answer["effects"] if c["effect"] == "unknown"] + list(
        answer["located"][:1]
    )
    claimed_names = {plain(name) for claim in claims for name in claim.get("depends_on") or ()}
    return bool(claimed_names) and bool(claimed_names & known)


def plain(name: str) -> str:
    """Name of a covariate without unit or component: q4 for q4_deg, tau2 for torque2 and moment2_x."""
    for unit in ("_deg", "_s", "_nm", "_mm", "_kg", "_c", "_x", "_y", "_z"):
        name = name.removesuffix(unit)
    return name.replace("torque", "tau").replace("moment", "tau").replace("move", "approach")


def names_words(words: Sequence[str], answer: Mapping) -> bool | None:
    """True if the answer requests the withheld covariate by one of its names; None if none was withheld.

    A request is in `not_recorded`, in the next experiment, in the reasons of alternatives, or in a statement that
    contains "record".
    """
    if not words:
        return None
    texts = [answer.get("next_experiment") or "", *answer.get("not_recorded", ())]
    for claim in answer["effects"]:
        statement = claim.get("statement") or ""
        texts += [statement] if "record" in statement else []
        texts += [
            str(a.get(key) or "")
            for a in claim.get("alternatives", ())
            for key in ("why", "not_recorded")
        ]
    text = " ".join(map(str, texts)).lower()
    return any(word in text for word in words)


def _detectable(truth: Mapping, answer: Mapping) -> dict:
    """Size of one planted effect orthogonal to the baseline, and the stated minimal detectable bias; 3-D RMS, mm.

    `below_visible`: True if the effect is smaller; None if the answer has no row for it.
    """
    planted = truth["effects"][0]
    sigma = truth.get("sigma_mm")
    if len(truth["effects"]) > 1 or planted.get("survives_sigma") is None or sigma is None:
        return {}
    order = planted.get("detail", {}).get("order")
    rows = [
        row
        for row in answer.get("smallest_visible", ())
        if same(row, planted) and row.get("surviving_mm")
    ]
    rows = [row for row in rows if order is None or row.get("variant") == f"order {order}"] or rows
    size = planted["survives_sigma"] * sigma * 3**0.5
    smallest = min((row["surviving_mm"] for row in rows), default=None)
    return {
        "surviving_mm": size,
        "visible_mm": smallest,
        "below_visible": None if smallest is None else size < smallest,
    }


def errors(answer: Mapping) -> dict:
    """Held-out errors that the answer states: mm, and also px for recordings of images."""
    held_out = answer.get("held_out") or {}
    keys = [f"{key}_{unit}" for unit in ("mm", "px") for key in ("before", "after", "noise")]
    return {key: held_out.get(key) for key in keys if key.endswith("mm") or key in held_out}


def claims(answer) -> list[str]:
    """Short texts of the claims of an answer, with their probabilities."""
    if not answer:
        return []
    return [
        f"{c['effect']}{' ' + c['variant'] if c.get('variant') else ''} at {c['where']} "
        f"({c['probability']:.2f})"
        if c.get("probability") is not None
        else f"{c['effect']} at {c['where']}"
        for c in answer["effects"]
    ]


def _is_detected(answer: Mapping) -> bool:
    """Whether an answer claims anything; next to findings on the noise alone the verdict is `consistent`."""
    return answer["verdict"] != "consistent" or bool(answer["effects"])


def _first(answer) -> dict:
    """Effect and place of the first claim; "nothing" without one."""
    for claim in answer["effects"][:1]:
        return {"effect": claim["effect"], "where": claim["where"]}
    if answer["located"] and answer["verdict"] != "consistent":
        where = answer["located"][0]["where"]
    else:
        where = "nothing"
    return {"effect": "nothing" if answer["verdict"] == "consistent" else "unknown", "where": where}


def _is(truth: Mapping, effect: str) -> bool:
    return any(planted["effect"] == effect for planted in truth["effects"])
