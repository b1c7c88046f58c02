"""Rows that differ from all others by far more than these scatter: blunders, wrong labels, interchanged rows."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from datasets.importers.units import LENGTHS
from datasets.samples.columns import POINT, joint_columns
from workbench.fitting.plausibility.fitting import POSITION, row_mismatch, row_residual
from workbench.fitting.plausibility.hypotheses.corrections import listed, observed_columns
from workbench.fitting.plausibility.hypotheses.row_corrections import (
    place_of_measurement,
    shift_steps,
)
from workbench.fitting.plausibility.joint_columns.columns_at_rest import longest_run
from workbench.fitting.plausibility.rows.group_corrections import (
    copied_readings,
    corrected_columns,
    held_measurements,
)
from workbench.fitting.plausibility.rows.row_groups import (
    MIN_SHARE,
    Reason,
    another_frame,
    interchanged_columns,
    lost_signs,
    readings_in_other_unit,
)
from workbench.fitting.plausibility.rows.single_values import (
    moving_arm,
    wrong_coordinate,
    wrong_reading,
)

OUTLIER_FACTOR = 10.0
"""Times the median mismatch, which is about 15 standard deviations of one coordinate."""
_MOST_ISOLATED, _GAP = 0.2, 2.0
"""Share of the rows that may be isolated, and how many times the next smaller mismatch they reach at least."""
_LEAST_SPARE_DEGREES = 30.0
_FEW_VALUES, _RARE = 8, 0.25
_SEVERAL, _CHANCE = 3, 0.01
_NUMBERS = ("sample", "pose", "repeat")
_TARGETS = {"ball", "reflector"}
_FITTING_FACTOR = 4.0
_UNIT_DIGITS = 1e-3
"""Of a unit: half a step of a coordinate with three digits, and more for three coordinates."""
_NEARLY_ALL = 0.8
_LEAST_OF_RUN = 0.5
_EQUAL_RATIO = 1.05
_NAMED = 12
_LOST_DIGITS = (-3, -2, -1, 1, 2, 3, 4, 5, 6)
"""Places by which a decimal point may be too far to the right."""


@dataclass(frozen=True)
class Outliers:
    """Row numbers that are far off, the mismatch (n,) mm of all rows, and its median.

    `is_small`: the rows are no farther off than an unmodelled effect may put a row, but a gap separates them.
    """

    rows: np.ndarray
    mismatch: np.ndarray
    median: float
    is_small: bool = False

    @property
    def likely_cause(self) -> str:
        """General cause of outlying rows, for which no specific one is found."""
        if self.is_small:
            return (
                "gross errors of these measurements, or a load or another condition that is not recorded, are the "
                "likely cause"
            )
        return "gross errors of single measurements are the likely cause"


def find_outliers(
    robot, recording, fit, floor: float, factor: float = OUTLIER_FACTOR
) -> Outliers | None:
    """Rows far off the fit, of all rows of the recording; None where there are none.

    floor: mm by which unmodelled effects may put a single row off. Below it, rows are outliers only where a gap
    separates them from all others: unmodelled effects fill the range between the typical and the largest mismatch.
    factor: times the median mismatch that an outlier reaches at least.
    """
    mismatch = row_mismatch(robot, recording, fit)
    median = float(np.median(mismatch))
    is_far = mismatch > factor * median * _stated_uncertainty(recording)
    rows = np.flatnonzero(is_far & (mismatch > floor))
    is_small = not len(rows)
    if is_small and fit.degrees >= _LEAST_SPARE_DEGREES:
        rows = np.flatnonzero(is_far & _is_isolated(mismatch))
        if len(rows) and _is_condition(recording, rows):
            return None
    if not len(rows):
        return None
    return Outliers(rows, mismatch, median, is_small)


def _stated_uncertainty(recording) -> np.ndarray | float:
    """(n,) stated sigma of a row over its median, at least 1: rows that are stated to be less certain may be off more.

    1 where all rows have one sigma, or none.
    """
    stated = recording.sigma
    if stated is None or not np.median(stated) > 0:
        return 1.0
    return np.maximum(stated / np.median(stated), 1.0)


def _is_isolated(mismatch: np.ndarray) -> np.ndarray:
    """(n,) True for the largest mismatches above the largest gap, in ratio, among the largest ones."""
    ordered = np.sort(mismatch)[::-1]
    count = int(_MOST_ISOLATED * len(ordered))
    ratios = ordered[:count] / np.maximum(ordered[1 : count + 1], 1e-300)
    if not count or ratios.max() < _GAP:
        return np.zeros(len(mismatch), bool)
    return mismatch >= ordered[int(ratios.argmax())]


def _is_condition(recording, rows: np.ndarray) -> bool:
    """Whether outlying rows were measured under a condition of their own, such as a load or a span of time.

    An unmodelled effect of that condition is then as likely as gross errors of the rows. Outliers at random places
    would lie within the range of the condition with the probability (share of the rows)^(number of outlying poses).
    A quantity that takes few values, such as a load, needs less evidence: one outlier at a rare value.
    """
    own_names = {*observed_columns(recording), *joint_columns(recording.columns), *_NUMBERS}
    conditions = [recording.columns[name] for name in set(recording.columns) - own_names]
    count = len(np.unique(recording.poses[rows]))
    for values in [np.arange(recording.n), *conditions]:
        category_values = values[rows]
        share = float(
            ((values >= category_values.min()) & (values <= category_values.max())).mean()
        )
        is_rare = share < _RARE and len(np.unique(values)) <= _FEW_VALUES
        if is_rare or (count >= _SEVERAL and share**count < _CHANCE):
            return True
    return False


def outlier_reason(robot, recording, fit, outliers: Outliers) -> Reason:
    """The most specific reason that the outlying rows agree with."""
    tolerance = _FITTING_FACTOR * outliers.median
    for explain in (
        _stuck,
        _of_group(held_measurements),
        _other_labels,
        _other_unit,
        _of_group(readings_in_other_unit),
        _of_group(lost_signs),
        _of_group(interchanged_columns),
        _most_lost_points,
        _shifted,
        _interchanged,
        _of_group(corrected_columns),
        _of_group(wrong_coordinate),
        _of_group(moving_arm),
        _of_group(wrong_reading),
        _wrong_target,
        _of_group(another_frame),
        _of_group(copied_readings),
        _lost_decimal_points,
    ):
        reason = explain(robot, recording, fit, outliers, tolerance)
        if reason is not None:
            return reason
    return Reason(outliers.likely_cause, "blunders", False)


def _of_group(explain):
    """An explanation of a group of rows as one of outliers."""
    return lambda robot, recording, fit, outliers, tolerance: explain(
        robot, recording, fit, outliers.rows, tolerance
    )


def _wrong_target(robot, recording, fit, outliers, tolerance) -> Reason | None:
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


def named_samples(recording, rows, mismatch) -> str:
    """'samples 5 (2.1 mm), 9 (1.8 mm) and 12 (30 mm)', at most a dozen, without sizes that are alike.

    mismatch: (n,) mm of all rows.
    """
    shown = rows[:_NAMED]
    ids = [str(i) for i in recording.sample_ids[shown]]
    if mismatch[rows].max() > _EQUAL_RATIO * mismatch[rows].min():
        ids = [f"{name} ({distance:.3g} mm)" for name, distance in zip(ids, mismatch[shown])]
    unlisted = _unlisted(len(rows))
    return f"sample{'s' * (len(rows) > 1)} {listed([*ids, *unlisted])}"


def _unlisted(count: int) -> list[str]:
    """How many of `count` rows or pairs a sentence does not list; nothing where it lists all."""
    return [f"{count - _NAMED} more"] if count > _NAMED else []


def _other_labels(robot, recording, fit, outliers, tolerance):
    """Rows that fit another ball or another reflector."""
    label = "ball" if recording.measures == "ball-centre" else "reflector"
    if label == "ball":
        known = sorted(recording.balls)
    else:
        known = np.unique(recording.reflector).tolist()
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
    better = distances.min(0) < tolerance
    if better.mean() < 0.7:
        return None
    numbers = np.array(known)[distances.argmin(0)]
    old = wrong.columns[label].astype(int)
    pairs = []
    for i, a, b in zip(wrong.sample_ids, old, numbers):
        pairs.append(f"{i} ({label} {a} for {b})")
    unlisted = _unlisted(len(pairs))
    return Reason(
        f"they fit with another number in column {label}: sample {listed([*pairs[:_NAMED], *unlisted])}",
        f"{label}-labels",
    )


def _stuck(robot, recording, fit, outliers, tolerance):
    """Outlying rows in which one joint column stays at one value while the others change."""
    run = longest_run(recording)
    if run is None:
        return None
    name, first, last = run
    is_in_run = (outliers.rows >= first) & (outliers.rows <= last)
    # a joint that rests in most rows, as the axis of a track may, explains no few outliers among them
    if is_in_run.mean() < _NEARLY_ALL or is_in_run.sum() < _LEAST_OF_RUN * (last - first + 1):
        return None
    ids = recording.sample_ids
    return Reason(
        f"column {name} stays at {recording.columns[name][first]:.5g} from sample {ids[first]} to {ids[last]} "
        "while the other joints move, as of a stuck encoder",
        "stuck-encoder",
    )


def _other_unit(robot, recording, fit, outliers, tolerance):
    """Outlying rows whose points fit in another unit of length; its digits may be coarser."""
    if not set(POINT) <= set(recording.columns) or len(outliers.rows) < 2:
        return None
    rows = outliers.rows
    for unit in ("in", "m", "cm", "ft"):
        size = LENGTHS[unit]
        columns = {n: size * v if n in POINT else v for n, v in recording.columns.items()}
        scaled = row_mismatch(robot, replace(recording, columns=columns), fit)[rows]
        if (scaled < max(tolerance, _UNIT_DIGITS * size)).mean() > 0.7:
            return Reason(
                f"their coordinates fit in the unit {unit} instead of mm, so that units are mixed",
                "length-unit",
            )
    return None


def _most_lost_points(robot, recording, fit, outliers, tolerance):
    """As `_lost_decimal_points`, where that explains most of the rows: one of many rows fits so by chance."""
    return _lost_decimal_points(robot, recording, fit, outliers, tolerance, MIN_SHARE)


def _lost_decimal_points(robot, recording, fit, outliers, tolerance, least_share=0.0):
    """Outlying rows that fit if the decimal point of one cell is at another place; at least a share of the rows."""
    # a fit has the parameters of every target, so that one row of each is needed
    targets = [
        np.unique(recording.columns[c], return_index=True)[1]
        for c in _TARGETS & set(recording.columns)
    ]
    rows = np.union1d(outliers.rows, np.concatenate([np.zeros(0, int), *targets]))
    wrong = recording.select(rows)
    cells = {}
    is_outlying = np.isin(rows, outliers.rows)
    names = [*joint_columns(recording.columns), *(c for c in POINT if c in recording.columns)]
    for name, digits in product(names, _LOST_DIGITS):
        values = wrong.columns[name] / 10.0**digits
        moved = replace(wrong, columns={**wrong.columns, name: values})
        fits = is_outlying & (row_mismatch(robot, moved, fit) < tolerance) & (values != 0)
        for k in np.flatnonzero(fits):
            cells.setdefault(k, (name, values[k]))
    if not cells or len(cells) < least_share * len(outliers.rows):
        return None
    sentences = [
        f"sample {wrong.sample_ids[k]} fits with {name} {value:.8g} in place of {wrong.columns[name][k]:.8g}"
        for k, (name, value) in sorted(cells.items())
    ]
    unlisted = _unlisted(len(sentences))
    other_count = len(outliers.rows) - len(cells)
    others = f"; for the other {other_count}, {outliers.likely_cause}" if other_count else ""
    return Reason(
        f"a decimal point is lost or misplaced: {listed([*sentences[:_NAMED], *unlisted])}{others}",
        "decimal-point",
    )


def _shifted(robot, recording, fit, outliers, tolerance):
    """Outlying rows whose measurement fits the joint readings of a neighbouring row."""
    names = observed_columns(recording)
    if recording.measures == "distance" or not names:
        return None
    for step in shift_steps(recording):
        # the joint readings of these rows belong to the measurement `step` rows above
        rows = outliers.rows[(outliers.rows - step >= 0) & (outliers.rows - step < recording.n)]
        if len(rows) < 3:
            continue
        source = np.arange(recording.n)
        source[rows] -= step
        columns = {c: v if c in names else v[source] for c, v in recording.columns.items()}
        fitting = row_mismatch(robot, replace(recording, columns=columns), fit)[rows] < tolerance
        if fitting.mean() > 0.7:
            first, last = recording.sample_ids[rows[fitting][[0, -1]]]
            count = "a row is" if abs(step) == 1 else f"{abs(step)} rows are"
            return Reason(
                f"from sample {first} to {last}, rows hold the measurement of {place_of_measurement(step)}: {count} "
                "missing or doubled there",
                "rows-shifted",
            )
    return None


def _interchanged(robot, recording, fit, outliers, tolerance):
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
    fitting = (gaps.min(1) < tolerance) & (partner != np.arange(len(rows)))
    if fitting.sum() >= max(2, 0.6 * len(rows)):
        ids = recording.sample_ids
        pairs = []
        for k in np.flatnonzero(fitting):
            pairs.append(f"{ids[rows[k]]} holds that of {ids[rows[partner[k]]]}")
        unlisted = _unlisted(len(pairs))
        return Reason(
            f"their measurements are interchanged: sample {listed([*pairs[:_NAMED], *unlisted])}",
            "rows-interchanged",
        )
    return None
