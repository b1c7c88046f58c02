"""Which ball of the artefact each ball of a scan is: by the sample that says so, by radius, by distances."""

from collections.abc import Mapping, Sequence

import numpy as np

from datasets.recording import Recording
from sensors.ball.matching import match

_SAME_RADIUS = 0.05  # radii closer than this share of one another are no name
_NEAR_MM = 1.0  # by which a distance between balls may differ from the certificate's


def named(
    recording: Recording, row: Mapping, radii: Sequence[float], centres: Sequence[np.ndarray]
) -> tuple[list[int | None], str]:
    """The artefact's number of each ball found in a scan, None where it is unknown, and a message about it.

    row: of images.csv; radii (k) mm; centres (k) of (3,) mm, the ball that is seen best first.
    """
    known = recording.balls
    if not known or not len(radii):
        return [None] * len(
            radii
        ), "no ball was found" if known else "there is no artefact.csv to name balls by"
    if (number := by_sample(recording, row)) is not None:
        return by_distance(known, number, centres), ""
    if (numbers := by_radius(known, radii)) is not None:
        return numbers, ""
    if len(radii) >= 3:
        found = match(np.transpose(centres), np.array([ball[:3] for ball in known.values()]).T)
        keys = list(known)
        return [keys[k] if found and k >= 0 else None for k in found.ball], found.outcome
    return [None] * len(
        radii
    ), "balls of one size: which they are takes three of them, or a column ball in samples.csv"


def by_sample(recording: Recording, row: Mapping) -> int | None:
    """The ball that the scan's row of samples.csv says it looks at."""
    if "sample" not in row or "ball" not in recording.columns:
        return None
    place = np.flatnonzero(recording.sample_ids == int(row["sample"]))
    number = int(recording.ball[place[0]]) if place.size else None
    return number if number in recording.balls else None


def by_radius(known: Mapping[int, tuple], radii: Sequence[float]) -> list[int] | None:
    """Numbers of balls no two of which are of one size; None where some are."""
    numbers = []
    for radius in radii:
        candidates = _balls_of_radius(known, radius)
        if len(candidates) != 1:
            return None
        numbers += candidates
    return numbers if len(set(numbers)) == len(numbers) else None


def _balls_of_radius(known: Mapping[int, tuple], radius: float) -> list[int]:
    """Numbers of the balls (x, y, z, radius) that have about this radius, mm."""
    return [
        number
        for number, (*_, certified) in known.items()
        if abs(certified - radius) < _SAME_RADIUS * certified
    ]


def by_distance(
    known: Mapping[int, tuple], first: int, centres: Sequence[np.ndarray]
) -> list[int | None]:
    """The first ball is `first`; the others by how far they are from it, where one ball alone is as far."""
    places = {number: np.array(ball[:3]) for number, ball in known.items()}
    numbers: list[int | None] = [first]
    for centre in centres[1:]:
        distances = np.linalg.norm(centre - centres[0])
        fits = [
            number
            for number, place in places.items()
            if number not in numbers
            and abs(np.linalg.norm(place - places[first]) - distances) < _NEAR_MM
        ]
        numbers.append(fits[0] if len(fits) == 1 else None)
    return numbers
