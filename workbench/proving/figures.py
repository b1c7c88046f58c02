"""Figures of the scoreboard: rates with Wilson intervals and acceptance criteria, and curves over all cases."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np

from workbench.core.vocabulary import Place
from workbench.proving.scoring import NAMED

SEEN = 0.3
"""Effect size orthogonal to the baseline, in sigma of a coordinate, from which an effect must be detected."""
_Z = 1.959964  # two-sided 95 %


@dataclass(frozen=True)
class Figure:
    """`value`: a rate (hits of cases) or a median; `low`, `high`: its 95 % interval; `asked`: acceptance criterion.

    `within`: True if the value meets the limit, None without a criterion. `least`: required number of cases.
    """

    suite: str
    name: str
    hits: int | None
    cases: int
    value: float | None
    low: float | None
    high: float | None
    asked: str
    within: bool | None
    least: int = 0

    @property
    def reached(self) -> bool | None:
        """True if value and number of cases meet the criterion; None without a criterion."""
        if self.within is None:
            return None
        return self.within and self.cases >= self.least

    @property
    def word(self) -> str:
        """`reached`, `too few cases` or `short`; empty without a criterion."""
        return {None: "", True: "reached", False: "too few cases" if self.within else "short"}[
            self.reached
        ]

    def as_json(self) -> dict:
        return asdict(self) | {"reached": self.reached, "word": self.word}


def wilson(hits: int, cases: int) -> tuple[float, float]:
    """95 % interval of a rate: Wilson, J. Am. Stat. Assoc. 22 (1927). (0, 1) without cases."""
    if not cases:
        return 0.0, 1.0
    rate = hits / cases
    square = _Z**2 / cases
    middle = (rate + square / 2) / (1 + square)
    half = _Z / (1 + square) * np.sqrt(rate * (1 - rate) / cases + square / (4 * cases))
    return float(max(middle - half, 0.0)), float(min(middle + half, 1.0))


def rate(
    suite: str,
    name: str,
    rows: Sequence[Mapping],
    hit: Callable[[Mapping], bool],
    asked: str = "",
    limit: float | None = None,
    at_most: bool = False,
    min_cases: int = 0,
) -> Figure:
    """Share of rows for which `hit` is true. It is `within` if at least (`at_most`: at most) the limit."""
    hits = sum(bool(hit(row)) for row in rows)
    cases = len(rows)
    value = hits / cases if cases else None
    is_within = None
    if limit is not None and value is not None:
        is_within = value <= limit if at_most else value >= limit
    return Figure(
        suite, name, hits, cases, value, *wilson(hits, cases), asked, is_within, min_cases
    )


def table(rows: Sequence[Mapping]) -> list[Figure]:
    """All figures of the suites that have cases, in the order of the suites."""
    figures_of_suites: list[Figure] = []
    for suite, figures_of_suite in _SUITES.items():
        suite_rows = [row for row in rows if row["suite"] == suite]
        if suite_rows:
            figures_of_suites += figures_of_suite(suite_rows)
    return figures_of_suites + _asks_for_nothing(rows) + gain(rows)


def _clean(rows):
    alarms = rate(
        "clean",
        "false alarms",
        rows,
        lambda r: not _kept(r),
        "≤ 1 % of ≥ 300",
        0.01,
        at_most=True,
        min_cases=300,
    )
    upper = Figure(
        "clean",
        "upper 95 % limit of false alarms",
        None,
        len(rows),
        alarms.high,
        None,
        None,
        "≤ 2.5 %",
        alarms.high <= 0.025,
    )
    return [alarms, upper]


def _library(rows):
    large = [row for row in rows if (row["survives_sigma"] or 1.0) >= SEEN]
    found = [row for row in large if row.get("detected")]
    return [
        rate(
            "library",
            "detected, orthogonal size ≥ 0.3 σ",
            large,
            lambda r: r.get("detected"),
            "≥ 95 %",
            0.95,
        ),
        rate("library", "located, of detected", found, _located, "≥ 98 %", 0.98),
        rate(
            "library",
            "located, or place in the declared group",
            found,
            lambda r: r.get("located_in_group"),
        ),
        rate("library", "right name or declared group, of detected", found, _right, "≥ 90 %", 0.90),
        rate("library", "right name alone, of detected", found, lambda r: r["outcome"] == "exact"),
        rate(
            "library",
            "detected, of those above the stated minimal detectable bias",
            [r for r in rows if r.get("below_visible") is False],
            lambda r: r.get("detected"),
        ),
        rate(
            "library",
            "detected, orthogonal size < 0.3 σ",
            [r for r in rows if r not in large],
            lambda r: r.get("detected"),
        ),
        _confidently("library", rows, "≤ 1 %", 0.01),
    ]


def _absorbed(rows):
    partial = [r for r in rows if _part_gain(r) is not None]
    return [
        rate("swallowed", "right name or declared group", rows, _right, "≥ 85 %", 0.85),
        rate(
            "swallowed",
            "named, or `unexplained`, or below the stated minimal detectable bias",
            rows,
            lambda r: _right(r) or r["outcome"] == "abstained" or _silent(r),
            "all",
            1.0,
        ),
        rate("swallowed", "a wrong name", rows, lambda r: r.get("wrong_name")),
        rate(
            "swallowed",
            "error on the part not fitted falls by half of the oracle's gain or more",
            partial,
            lambda r: _part_gain(r) >= 0.5,
            "≥ half of the oracle's",
            0.85,
        ),
        _median(
            "swallowed",
            "share of the oracle's gain on the part not fitted",
            [_part_gain(r) for r in partial],
            0.5,
        ),
        _confidently("swallowed", rows, "", None),
    ]


def _pairs(rows):
    return [
        rate("pairs", "both exact", rows, lambda r: r["outcome"] == "exact", "≥ 85 %", 0.85),
        rate("pairs", "both exact or in declared groups", rows, _right),
        rate(
            "pairs",
            "a wrong name",
            rows,
            lambda r: r.get("wrong_name"),
            "≤ 3 %",
            0.03,
            at_most=True,
        ),
        _confidently("pairs", rows, "", None),
    ]


def _outside_catalogue(rows):
    return [
        rate(
            "outside",
            "`unexplained`",
            rows,
            lambda r: r["verdict"] == "unexplained",
            "≥ 95 %",
            0.95,
        ),
        rate("outside", "located", rows, _located, "≥ 90 %", 0.90),
        rate(
            "outside",
            "`unexplained`, located, and nothing named",
            rows,
            lambda r: r["outcome"] == "exact",
        ),
        rate("outside", "the right covariates", rows, lambda r: r.get("covariates_right")),
        _confidently("outside", rows, "", None),
    ]


def _withheld(rows):
    at_joints = [r for r in rows if Place.of(r["effects"][0]["where"]).kind == "joint"]
    return [
        rate(
            "covariate-withheld", "located, effects at joints", at_joints, _located, "≥ 90 %", 0.90
        ),
        _confidently("covariate-withheld", rows, "none", 0.0),
        rate(
            "covariate-withheld",
            "the missing covariate is asked for",
            rows,
            lambda r: r.get("asks_for_it"),
            "≥ 80 %",
            0.80,
        ),
        rate(
            "covariate-withheld",
            "the missing covariate is asked for, or the effect named without it",
            rows,
            lambda r: r.get("asks_for_it") or _right(r),
        ),
        rate(
            "covariate-withheld",
            "the missing covariate is asked for, and no other",
            rows,
            lambda r: r.get("asks_for_it") and r.get("asks") == 1,
        ),
        rate("covariate-withheld", "located, all effects", rows, _located),
    ]


def _sensor(rows):
    flawed = [r for r in rows if r["effects"]]
    flawless = [r for r in rows if not r["effects"]]
    return [
        rate("sensor", "right name or declared group", flawed, _right, "≥ 85 %", 0.85),
        rate("sensor", "located", flawed, _located, "≥ 95 %", 0.95),
        rate("sensor", "false alarms, flawless scanners", flawless, lambda r: not _kept(r)),
    ]


def _knocked_out(rows):
    out = [r for r in rows if r["effects"]]
    with_none = [r for r in rows if not r["effects"]]
    return [
        rate("real-knocked-out", "terms named again", out, _right, "all", 1.0),
        rate("real-knocked-out", "sets without a term named twice", with_none, _kept, "all", 1.0),
    ]


def _planted(rows):
    rows = [r for r in rows if r["outcome"] != "reference"]
    at_one = [r for r in rows if r["effects"] and r["effects"][0].get("times") == 1.0]
    found = [r for r in at_one if r.get("detected")]
    bare = [r for r in rows if not r["effects"]]
    return [
        rate(
            "real-planted",
            "detected at 1 × the real residual",
            at_one,
            lambda r: r.get("detected"),
            "≥ 95 %",
            0.95,
        ),
        rate("real-planted", "right name, of detected", found, _right, "≥ 95 %", 0.95),
        rate("real-planted", "unplanted copies: verdict unchanged", bare, _kept, "all", 1.0),
    ]


def _real_withheld(rows):
    return [
        rate(
            "real-withheld",
            "rules kept",
            rows,
            lambda r: r["outcome"] in ("exact", "right"),
            "all",
            1.0,
        )
    ]


_SUITES = {
    "clean": _clean,
    "library": _library,
    "swallowed": _absorbed,
    "pairs": _pairs,
    "outside": _outside_catalogue,
    "covariate-withheld": _withheld,
    "sensor": _sensor,
    "real-knocked-out": _knocked_out,
    "real-planted": _planted,
    "real-withheld": _real_withheld,
}


def gain(rows: Sequence[Mapping]) -> list[Figure]:
    """Median share of the oracle's held-out gain, over all cases in which this gain is large enough to measure."""
    shares = [share for share in map(gain_share, rows) if share is not None]
    stated = rate(
        "gain",
        "held-out error stated before and after, mm (px in suite sensor), of all cases answered",
        [r for r in rows if r["verdict"]],
        _states_errors,
        "every case",
        1.0,
    )
    gains = (
        [_median("gain", "held-out gain as a share of the oracle's, median", shares, 0.9)]
        if shares
        else []
    )
    return gains + [stated] if stated.cases else gains


def _asks_for_nothing(rows) -> list[Figure]:
    """Control for withheld covariates: share of answers that request a covariate although none is withheld."""
    without_effect = [
        r for r in rows if r["suite"] in ("clean", "library", "swallowed", "pairs") and r["verdict"]
    ]
    name = "control: something is asked for where nothing was withheld"
    if not without_effect or not any(r["suite"] == "covariate-withheld" for r in rows):
        return []
    return [rate("covariate-withheld", name, without_effect, lambda r: r.get("asks"))]


def _states_errors(row: Mapping) -> bool:
    """True if the answer states its held-out error before and after."""
    units = ("mm", "px") if row["suite"] == "sensor" else ("mm",)
    return any(None not in (row.get(f"before_{u}"), row.get(f"after_{u}")) for u in units)


def gain_share(row: Mapping) -> float | None:
    """Reduction of the held-out RMS over that of the oracle; None if the oracle gains less than 1.5 %.

    A case without an answer has gain 0.
    """
    before, after = row.get("before_mm"), row.get("after_mm")
    known, best = row.get("oracle_before_mm"), row.get("oracle_after_mm")
    if None in (known, best) or best > 0.985 * known or (row["survives_sigma"] or 0) < SEEN:
        return None
    if None in (before, after):
        return 0.0 if row["outcome"] == "failed" else None
    return (before - after) / (known - best)


def _part_gain(row: Mapping) -> float | None:
    before, best, after = (row.get(f"part_{key}_mm") for key in ("before", "oracle", "after"))
    if None in (before, best, after) or best > 0.97 * before:
        return None
    return (before - after) / (before - best)


def _silent(row: Mapping) -> bool:
    """True if nothing is named and the effect is below the minimal detectable bias that the answer states."""
    return (
        bool(row.get("below_visible")) and not row.get("wrong_name") and row["outcome"] != "failed"
    )


def _median(suite, name, values, limit) -> Figure:
    """A median with its 95 % interval from order statistics."""
    values = np.sort(np.asarray(values, float))
    n = len(values)
    if not n:
        return Figure(suite, name, None, 0, None, None, None, f"≥ {limit:g}", None)
    half_width = _Z * np.sqrt(n) / 2
    low = values[max(int(n / 2 - half_width), 0)]
    high = values[min(int(np.ceil(n / 2 + half_width)), n - 1)]
    middle = float(np.median(values))
    return Figure(
        suite, name, None, n, middle, float(low), float(high), f"≥ {limit:g}", middle >= limit
    )


def _confidently(suite, rows, asked, limit) -> Figure:
    return rate(
        suite,
        "confidently wrong",
        rows,
        lambda r: r.get("confidently_wrong"),
        asked,
        limit,
        at_most=True,
    )


def _right(row) -> bool:
    return row["outcome"] in NAMED


def _kept(row) -> bool:
    """True if a case without a planted effect, or a case with a rule, has a correct answer."""
    return row["outcome"] == "right"


def _located(row) -> bool:
    return bool(row.get("located"))


# ---------------------------------------------------------------------- curves


def detection(
    rows: Sequence[Mapping], edges: Sequence[float] = (0, 0.15, 0.2, 0.3, 0.5, 1, 2, 4, 20)
) -> list[dict]:
    """Share detected and share correctly named, by effect size in sigma; one row per bin with cases."""
    single = [r for r in rows if r["suite"] in ("library", "sensor") and r["survives_sigma"]]
    rows_of_size = []
    for low, high in pairwise(edges):
        in_bin = [r for r in single if low <= r["survives_sigma"] < high]
        if in_bin:
            count = len(in_bin)
            seen = sum(bool(r.get("detected")) for r in in_bin)
            named = sum(map(_right, in_bin))
            log_sizes = np.log([r["survives_sigma"] for r in in_bin])
            rows_of_size.append(
                {
                    "from_sigma": low,
                    "to_sigma": high,
                    "cases": count,
                    "middle_sigma": float(np.exp(np.mean(log_sizes))),
                    "detected": seen / count,
                    "detected_interval": wilson(seen, count),
                    "named": named / count,
                    "named_interval": wilson(named, count),
                }
            )
    return rows_of_size


def reliability(rows: Sequence[Mapping]) -> list[dict]:
    """Share of correct claims by their stated probability; one row per bin with claims."""
    beliefs = [pair for row in rows for pair in row.get("beliefs", ())]
    rows_of_probability = []
    for low, high in pairwise((0, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99, 2)):
        in_bin = [(p, right) for p, right in beliefs if low <= p < high]
        if in_bin:
            hits = sum(bool(right) for _, right in in_bin)
            stated = float(np.mean([p for p, _ in in_bin]))
            rows_of_probability.append(
                {
                    "from": low,
                    "to": min(high, 1.0),
                    "claims": len(in_bin),
                    "right": hits / len(in_bin),
                    "interval": wilson(hits, len(in_bin)),
                    "stated": stated,
                }
            )
    return rows_of_probability


def confusion(rows: Sequence[Mapping], key: str) -> tuple[list[str], list[str], np.ndarray]:
    """Confusion matrix (counts) of truths (rows) and claims (columns), cases with one effect; key: "effect" or "where".

    The claim is the first one; a declared group counts as the truth that it contains.
    """
    single = [r for r in rows if len(r["effects"]) == 1 and r.get("first") is not None]
    pairs = [(r["effects"][0][key], _claimed(r, key)) for r in single]
    truths = sorted({true for true, _ in pairs})
    claims = truths + sorted({claim for _, claim in pairs} - set(truths))
    counts = np.zeros((len(truths), len(claims)), int)
    for true, claim in pairs:
        counts[truths.index(true), claims.index(claim)] += 1
    return truths, claims, counts


def _claimed(row, key) -> str:
    if row["outcome"] in NAMED or (key == "where" and row.get("located")):
        return row["effects"][0][key]
    return row["first"][key]
