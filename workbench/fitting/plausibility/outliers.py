"""Rows that differ from all others by far more than these scatter: blunders, wrong labels, interchanged rows."""

from dataclasses import dataclass, replace

import numpy as np

from workbench.fitting.plausibility.columns_at_rest import longest_run
from workbench.fitting.plausibility.fitting import POSITION, row_mismatch, row_residual
from workbench.fitting.plausibility.hypotheses.corrections import listed, observed_columns

_FAR = 10.0
"""Times the median mismatch, which is about 15 standard deviations of one coordinate."""
_NEAR = 4.0
_NEARLY_ALL = 0.8
_NAMED = 12


@dataclass(frozen=True)
class Outliers:
    """Row numbers that are far off, the mismatch (n,) mm of all rows, and its median."""

    rows: np.ndarray
    mismatch: np.ndarray
    median: float


def find_outliers(robot, recording, fit, floor: float) -> Outliers | None:
    """Rows far off the fit, of all rows of the recording; None where there are none.

    floor: mm by which unmodelled effects may put a single row off.
    """
    mismatch = row_mismatch(robot, recording, fit)
    median = float(np.median(mismatch))
    rows = np.flatnonzero(mismatch > max(_FAR * median, floor))
    if not len(rows):
        return None
    return Outliers(rows, mismatch, median)


@dataclass(frozen=True)
class Reason:
    """Why rows are outliers: a part of a sentence, the cause in one term, and whether the rows prove it."""

    sentence: str
    cause: str
    is_specific: bool = True


def outlier_reason(robot, recording, fit, outliers: Outliers) -> Reason:
    """The most specific reason that the outlying rows agree with."""
    near = _NEAR * outliers.median
    for explain in (_stuck, _other_labels, _shifted, _interchanged):
        reason = explain(robot, recording, fit, outliers, near)
        if reason is not None:
            return reason
    return _wrong_target(recording, outliers) or Reason(
        "gross errors of single measurements are the likely cause", "blunders", False
    )


def _wrong_target(recording, outliers) -> Reason | None:
    """Nearly all rows of one ball or reflector are outliers."""
    label = "ball" if recording.measures in ("ball-centre", "ball-surface") else "reflector"
    numbers = recording.columns.get(label)
    if numbers is None or len(np.unique(numbers)) < 2:
        return None
    for number in np.unique(numbers[outliers.rows]):
        if np.isin(np.flatnonzero(numbers == number), outliers.rows).mean() > _NEARLY_ALL:
            sentence = (
                f"nearly all rows of {label} {number:.0f} are among them: its coordinates or its number are "
                "probably wrong"
            )
            return Reason(sentence, "wrong-target", False)
    return None


def named_samples(recording, rows) -> str:
    """'sample 5, 9 and 12', at most a dozen numbers."""
    ids = [str(i) for i in recording.sample_ids[rows[:_NAMED]]]
    more = [f"{len(rows) - _NAMED} more"] if len(rows) > _NAMED else []
    return f"sample{'s' * (len(rows) > 1)} {listed([*ids, *more])}"


def _other_labels(robot, recording, fit, outliers, near):
    """Rows that fit another ball or another reflector."""
    label = "ball" if recording.measures == "ball-centre" else "reflector"
    known = sorted(recording.balls) if label == "ball" else np.unique(recording.reflector).tolist()
    if (
        recording.measures not in ("ball-centre", "external-point")
        or len(known) < 2
        or label not in recording.columns
    ):
        return None
    seen = np.unique(recording.columns[label].astype(int)).tolist()
    wrong = recording.select(outliers.rows)
    distances = np.full((len(known), len(outliers.rows)), np.inf)
    for k, number in enumerate(known):
        if label == "ball" or number in seen:
            columns = {**recording.columns, label: recording.columns[label].copy()}
            columns[label][outliers.rows] = number
            relabelled = replace(recording, columns=columns)
            if len(np.unique(columns[label])) == len(seen) or label == "ball":
                distances[k] = row_mismatch(robot, relabelled, fit)[outliers.rows]
    better = distances.min(0) < near
    if better.mean() < 0.7:
        return None
    numbers = np.array(known)[distances.argmin(0)]
    old = wrong.columns[label].astype(int)
    pairs = [f"{i} ({label} {a} for {b})" for i, a, b in zip(wrong.sample_ids, old, numbers)]
    more = [f"{len(pairs) - _NAMED} more"] if len(pairs) > _NAMED else []
    return Reason(
        f"they fit with another number in column {label}: sample {listed([*pairs[:_NAMED], *more])}",
        f"{label}-labels",
    )


def _stuck(robot, recording, fit, outliers, near):
    """Outlying rows in which one joint column stays at one value while the others change."""
    run = longest_run(recording)
    if run is None:
        return None
    name, first, last = run
    within = (outliers.rows >= first) & (outliers.rows <= last)
    if within.mean() < 0.8:
        return None
    ids = recording.sample_ids
    return Reason(
        f"column {name} stays at {recording.columns[name][first]:.5g} from sample {ids[first]} to {ids[last]} "
        "while the other joints move, as of a stuck encoder",
        "stuck-encoder",
    )


def _shifted(robot, recording, fit, outliers, near):
    """Outlying rows whose measurement fits the joint readings of a neighbouring row."""
    names = observed_columns(recording)
    if recording.measures == "distance" or not names:
        return None
    for step, side in ((1, "after"), (-1, "before")):
        rows = outliers.rows[(outliers.rows + step >= 0) & (outliers.rows + step < recording.n)]
        if len(rows) < 3:
            continue
        source = np.arange(recording.n)
        source[rows] += step
        columns = {c: v if c in names else v[source] for c, v in recording.columns.items()}
        fitting = row_mismatch(robot, replace(recording, columns=columns), fit)[rows] < near
        if fitting.mean() > 0.7:
            first, last = recording.sample_ids[rows[fitting][[0, -1]]]
            return Reason(
                f"from sample {first} to {last}, rows hold the measurement of the row {side}: a row is missing "
                "or doubled there",
                "rows-shifted",
            )
    return None


def _interchanged(robot, recording, fit, outliers, near):
    """Outlying rows whose measurements fit one another's joint readings."""
    if (
        "x_mm" not in recording.columns
        or recording.measures == "ball-surface"
        or len(outliers.rows) < 2
    ):
        return None
    rows = outliers.rows
    measured = recording.points
    predicted = measured + row_residual(robot, recording, fit)[:POSITION].T
    gaps = np.linalg.norm(measured[rows][:, None] - predicted[rows][None], axis=2)
    partner = gaps.argmin(1)
    fitting = (gaps.min(1) < near) & (partner != np.arange(len(rows)))
    if fitting.sum() >= max(2, 0.6 * len(rows)):
        ids = recording.sample_ids
        pairs = [
            f"{ids[rows[k]]} holds that of {ids[rows[partner[k]]]}" for k in np.flatnonzero(fitting)
        ]
        more = [f"{len(pairs) - _NAMED} more"] if len(pairs) > _NAMED else []
        return Reason(
            f"their measurements are interchanged: sample {listed([*pairs[:_NAMED], *more])}",
            "rows-interchanged",
        )
    return None
