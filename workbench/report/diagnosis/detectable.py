"""Table of the minimal detectable biases; many variants of one effect at one place are one row, with their range."""

from collections.abc import Callable, Sequence

import numpy as np

from workbench.explanation.minimal_detectable_bias import DetectableBias
from workbench.explanation.result import Diagnosis
from workbench.explanation.sentences import words as said
from workbench.report.sections import table, words
from workbench.report.text import rounded, with_labels

_SMALLEST = 40
_MANY_VARIANTS = 5  # of one effect at one place, as the rows and columns of a board, from which on they are one row


def detectable(diagnosis: Diagnosis):
    """Parts of the section on minimal detectable biases."""
    unit = diagnosis.unit
    yield words(
        "Minimal detectable bias (MDB) of each effect, as the RMS displacement of the measured point that the effect "
        "alone causes. Detectable: 95 % power at a family-wise false-alarm rate of 1 %. Orthogonal: share of its "
        "squared signature that the fitted baseline does not absorb. Distinguishable: identified with 95 % probability "
        "against the most confounded effect."
    )
    order = sorted(
        diagnosis.detectable,
        key=lambda bias: bias.size if bias.size is not None else np.inf,
    )
    folded = fold_variants(order)
    rows = [_detectable_row(variants) for variants in folded[:_SMALLEST]]
    yield table(
        [
            "effect",
            "where",
            f"detectable from ({unit})",
            "as parameter",
            "orthogonal",
            f"distinguishable from ({unit})",
            "most confounded effect",
        ],
        rows,
        left=2,
        last_is_text=True,
    )
    if len(folded) < len(order) or len(folded) > _SMALLEST:
        yield words(f"smallest-visible.csv lists all {len(order)} variants.", quiet=True)


def fold_variants(biases: Sequence[DetectableBias]) -> list[list[DetectableBias]]:
    """Groups of biases that are one row: many variants of one effect at one place, as the lines of a board."""
    groups = _variants(biases)
    folded = []
    for bias in biases:
        variants = groups[bias.effect, bias.where]
        if len(variants) < _MANY_VARIANTS:
            folded.append([bias])
        elif bias is variants[0]:
            folded.append(variants)
    return folded


def _variants(biases: Sequence[DetectableBias]) -> dict[tuple[str, str], list[DetectableBias]]:
    """(effect, where) -> its biases."""
    groups: dict[tuple[str, str], list[DetectableBias]] = {}
    for bias in biases:
        groups.setdefault((bias.effect, bias.where), []).append(bias)
    return groups


def _detectable_row(variants: Sequence[DetectableBias]) -> tuple:
    """One row of the table; of several variants with the range from the smallest to the largest."""
    first = variants[0]
    if len(variants) > 1:
        label = f"{len(variants)} variants"
    else:
        label = first.label
    representative = max(
        variants, key=lambda bias: sum(_has_same_alternative(bias, other) for other in variants)
    )
    return (
        with_labels(f"{first.effect}{f', {label}' if label else ''}"),
        said.place(first.where),
        _range([bias.size for bias in variants], lambda size: rounded(size, 2)),
        _range(
            [bias.parameter for bias in variants],
            lambda size: said.measured(size, None, first.unit),
        ),
        _range([bias.orthogonal_share for bias in variants], lambda share: f"{100 * share:.1f} %"),
        _range([bias.separable for bias in variants], lambda size: rounded(size, 2)),
        f"{representative.alternative} at {said.place(representative.alternative_where)}"
        if representative.alternative
        else "–",
    )


def _has_same_alternative(first: DetectableBias, second: DetectableBias) -> bool:
    """Whether two biases have the same most confounded effect."""
    return (first.alternative, first.alternative_where) == (
        second.alternative,
        second.alternative_where,
    )


def _range(values: Sequence[float | None], text: Callable[[float], str]) -> str:
    """The smallest and the largest value in words; "–" where there is none."""
    known = [value for value in values if value is not None]
    if not known:
        return "–"
    low = text(min(known))
    high = text(max(known))
    if low == high:
        return low
    return f"{low} to {high}"
