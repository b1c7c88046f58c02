"""Why balls of a scan were not found, in words."""

from collections.abc import Mapping, Sequence

import numpy as np

from datasets.recording import Recording
from sensors.ball.result import BallFit
from sensors.ball.search import Refusal
from sensors.ball.single_stripe import FEW_STRIPES, NOT_DISTINGUISHED, undetermined
from sensors.scanner.model import Scanner
from workbench.files.images.ball_names import by_sample


def nearest_candidates(refused: Sequence[Refusal], missing: int) -> list[Refusal]:
    """The refused candidates that are nearest to the balls that are `missing`, at least one.

    Those that a ball fits come first, and then those with most points: a floor or a table has many.
    """
    ordered = sorted(refused, key=lambda refusal: (not refusal.is_fitted, -refusal.points))
    return ordered[: max(missing, 1)]


def missing_balls(
    recording: Recording, row: Mapping, found: int, refused: Sequence[Refusal]
) -> str:
    """Which balls of the artefact were not found, and why; "" where all were, or the scan is of a single one."""
    reasons = "; ".join(refusal.sentence for refusal in refused)
    expected = len(recording.balls)
    if found >= expected or by_sample(recording, row) is not None:
        return reasons
    reason = reasons or "no other surface that curves like one of them was seen in its light planes"
    return f"{found} of the {expected} balls of artefact.csv were found; {reason}"


def seen_instead(points, steps, refused: Sequence[Refusal]) -> str:
    """Contents of a scan without a ball: its points, and the nearest of the refused candidates."""
    if not points.shape[1]:
        return ""
    low, high = np.quantile(points[2], [0.02, 0.98])
    seen = (
        f"{points.shape[1]} points in {len(np.unique(steps))} light planes were seen at depths of {low:.0f} to "
        f"{high:.0f} mm"
    )
    if not refused:
        return f"{seen}, and no surface that curves like a ball"
    return f"{seen}; the nearest candidate, {nearest_candidates(refused, 1)[0].sentence}"


def perhaps_cut(at_limit) -> str:
    """Hint where no ball is found: too little is visible of a ball that the field of view cuts."""
    if not at_limit.any():
        return ""
    return (
        f"{at_limit.sum()} of {at_limit.size} points lie at the field's limit: a ball there is cut by the field; "
        "move it to the middle"
    )


def line_width_missing(scanner: Scanner, refused: Sequence[Refusal]) -> str:
    """That a scanner of an earlier version does not find balls on single stripes, and what to do; "" for others."""
    is_indistinct = any(NOT_DISTINGUISHED in refusal.why for refusal in refused)
    if scanner.line is not None and is_indistinct and not scanner.line.is_scatter_known:
        return (
            "this scanner file lacks line_scatter, so that most balls on a single stripe are refused: calibrate the "
            "scanner again with `workbench scanner`"
        )
    if scanner.line is not None:
        return ""
    return (
        "the scanner does not state how wide the laser line is (its file was written by an earlier version), so that "
        "no ball is found on a single stripe: calibrate it again with `workbench scanner`"
    )


def undetermined_few(fit: BallFit, stripe: np.ndarray) -> str:
    """Why a ball on one or few of the stripes (k,) of its points does not count as found, "" for others."""
    is_known = fit.free is not None or fit.covariance[3, 3] == 0
    if len(fit.reason) != len(stripe) or not is_known:
        return ""
    has_few = len(np.unique(stripe[fit.inliers])) <= FEW_STRIPES
    return undetermined(fit) if has_few else ""
