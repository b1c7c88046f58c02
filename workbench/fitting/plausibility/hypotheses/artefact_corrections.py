"""Mistakes in ball labels and in artefact.csv: swapped or permuted numbers, units, a left-handed frame."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, permutations

from workbench.fitting.plausibility.hypotheses.corrections import Correction, listed
from workbench.fitting.plausibility.hypotheses.point_corrections import LENGTH_UNITS

LABELS, ARTEFACT = "ball", "artefact"
_MOST_SWAPPED, _MOST_PERMUTED = 10, 5


def artefact_corrections(recording) -> Iterator[Correction]:
    """Every mistake that is common in the numbers and in the coordinates of the balls."""
    if recording.measures not in ("ball-centre", "ball-surface") or len(recording.balls) < 2:
        return
    yield from _permutations(sorted(recording.balls))
    for factor, unit in LENGTH_UNITS.items():
        yield _artefact(
            "artefact-unit",
            f"holds {unit}",
            f"multiply x, y and z by {factor:g}",
            lambda x, y, z, factor=factor: (factor * x, factor * y, factor * z),
        )
    yield _artefact(
        "artefact-left-handed",
        "is left-handed",
        "give one of its coordinates the opposite sign, or swap the two that are interchanged",
        lambda x, y, z: (-x, y, z),
    )


def _permutations(numbers):
    if len(numbers) <= _MOST_SWAPPED:
        for a, b in combinations(numbers, 2):
            yield _relabelled(
                f"numbers {a} and {b}",
                "are swapped",
                "swap them there or in artefact.csv",
                {a: b, b: a},
            )
    if len(numbers) <= _MOST_PERMUTED:
        for order in permutations(numbers):
            moved = {a: b for a, b in zip(numbers, order) if a != b}
            if len(moved) > 2:
                words = [f"{a} is {b}" for a, b in moved.items()]
                pairs = listed(words)
                yield _relabelled(
                    f"numbers {listed(moved)}",
                    f"are exchanged ({pairs})",
                    "correct them there or in artefact.csv",
                    moved,
                    mistake_count=len(moved) - 1,
                )


def _relabelled(subject, statement, remedy, moved, mistake_count=1) -> Correction:
    """Balls exchange their coordinates, which is the same as exchanging their numbers in every row."""

    def apply(robot, recording):
        balls = {k: recording.balls[moved.get(k, k)] for k in recording.balls}
        return robot, replace(recording, balls=balls)

    return Correction(
        "ball-labels",
        f"column ball, {subject}",
        statement,
        remedy,
        frozenset({LABELS}),
        apply,
        mistake_count=mistake_count,
    )


def _artefact(cause, statement, remedy, change) -> Correction:
    def apply(robot, recording):
        balls = {}
        for k, ball in recording.balls.items():
            balls[k] = (*change(*ball[:3]), ball[3])
        return robot, replace(recording, balls=balls)

    return Correction(cause, "artefact.csv", statement, remedy, frozenset({ARTEFACT}), apply)
