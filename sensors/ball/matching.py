"""Assignment of found balls to the balls of an artefact, by the distances between them."""

from dataclasses import dataclass

import numpy as np

from workbench.core.distributions import fisher as f_distribution
from workbench.core.rigid import nearest_rotation


@dataclass(frozen=True)
class Match:
    """Assignment of found balls to the balls of the artefact; false where that is not certain.

    `ball` (k,) int column of the artefact's centres, -1 for none; `rms` mm of the distances from the
    artefact's centres after a rigid fit; `others` further assignments (k,) that the distances allow as
    well.
    """

    ball: np.ndarray
    rms: float
    others: tuple[np.ndarray, ...]
    outcome: str

    def __bool__(self) -> bool:
        return bool((self.ball >= 0).sum() >= 3 and not self.others)


def match(found: np.ndarray, artefact: np.ndarray, tolerance: float = 0.5) -> Match:
    """Match found centres (3, k) mm with the artefact's (3, m) by their distances from one another.

    `tolerance` mm by which a distance may differ (scale and noise of the scanner; well below the
    differences between the artefact's own distances). Assignments of the most balls that agree in all distances are
    compared by the residual of their rigid fit, reflections excluded; those that an F test at 0.1 % cannot distinguish
    from the best are `others`.
    """
    found = np.asarray(found, float)
    artefact = np.asarray(artefact, float)
    assignments = _assignments(_pair_distances(found), _pair_distances(artefact), tolerance)
    fits = sorted(
        ((_rigid_rms(found, artefact, assignment), k) for k, assignment in enumerate(assignments))
    )
    fits = [(rms, assignments[k]) for rms, k in fits if rms <= tolerance]
    if not fits:
        why = "the distances fit only a mirror image of the artefact; check the signs of the axes"
        if not assignments:
            why = "no two found balls are as far apart as two of the artefact; check its file and the units"
        return Match(np.full(found.shape[1], -1), np.nan, (), why)
    best = fits[0][1]
    degrees = max(3 * int((fits[0][1] >= 0).sum()) - 6, 1)
    allowed = max(fits[0][0], 1e-9) * np.sqrt(f_distribution.isf(0.001, degrees, degrees))
    others = tuple(assignment for rms, assignment in fits[1:] if rms <= allowed)
    return Match(best, fits[0][0], others, _match_outcome(best, fits[0][0], others))


def _pair_distances(centres):
    return np.linalg.norm(centres[:, :, None] - centres[:, None], axis=0)


def _assignments(found, artefact, tolerance, max_count=50_000):
    """Every assignment (k,) of the largest number of balls whose distances all agree.

    Depth first, and no more than `max_count` partial ones: some of many balls without any order are still found.
    """
    k = len(found)
    complete = []
    size = 0
    stack = [np.zeros(0, int)]
    for _ in range(max_count):
        if not stack:
            break
        assignment = stack.pop()
        count = int((assignment >= 0).sum())
        if count + k - len(assignment) < max(size, 2):
            continue
        if len(assignment) == k:
            complete = (complete if count == size else []) + [assignment]
            size = count
            continue
        placed = np.flatnonzero(assignment >= 0)
        gap = np.abs(artefact[:, assignment[placed]] - found[len(assignment), placed])
        fitting = np.setdiff1d(np.flatnonzero((gap <= tolerance).all(1)), assignment[placed])
        stack += [np.append(assignment, ball) for ball in (-1, *fitting)]
    return complete


def _rigid_rms(found, artefact, ball):
    """RMS, mm, after the best rotation and shift (Kabsch); a reflection does not count."""
    chosen = ball >= 0
    detected = found[:, chosen]
    reference = artefact[:, ball[chosen]]
    detected = detected - detected.mean(1, keepdims=True)
    reference = reference - reference.mean(1, keepdims=True)
    aligned = nearest_rotation(detected @ reference.T) @ reference
    return float(np.sqrt(((detected - aligned) ** 2).sum(0).mean()))


def _match_outcome(ball, rms, others):
    count = int((ball >= 0).sum())
    distance = f"within {rms:.3g} mm"
    words = [f"{count} of {len(ball)} found balls belong to the artefact, {distance}"]
    if others or count < 3:
        words.append(
            f"which is which is ambiguous: {len(others) + 1} assignments agree with the distances; "
            "scan more balls, or an artefact whose distances differ"
        )
    return "; ".join(words)
