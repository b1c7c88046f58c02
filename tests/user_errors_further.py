"""A third set of mistakes for the table of user errors, in recordings that the other sets do not use.

`FURTHER` are mistakes of daily work: a column copied twice, a tool or a zero that changes between rows, minus signs that
a spreadsheet dropped. `UNUSED` are the recordings. `WHOLE` are changes that are no mistakes: no check may raise an alarm.
"""

from functools import cache

import numpy as np

import datasets
import user_error_changes as changes
from datasets.samples.columns import POINT, joint_columns
from user_error_scenes import _scene
from user_errors import EXTERNAL, Mistake
from user_errors_more import large_blunders


def swapped_and_reversed(recording):
    return changes.scaled(-1, 0)(changes.swapped(recording))


def large_offsets(recording):
    a, b = changes.inner(recording, 0), changes.inner(recording, 1)
    columns = recording.columns
    return changes.changed(recording, **{a: columns[a] + 45, b: columns[b] - 30})


def second_blocks(recording):
    """(n,) bool: every second block of five rows."""
    return (np.arange(recording.n) // 5) % 2 == 1


def three_stations(recording):
    rows, third = np.arange(recording.n), recording.n // 3
    second = changes.stationed(recording, 5, 500.0, 30.0)
    last = changes.stationed(recording, 9, 800.0, 70.0)
    return changes.mixed(changes.mixed(recording, second, rows >= third), last, rows >= 2 * third)


def block_of_measurements_copied(recording):
    """Rows 50 % to 60 % hold the measurements of rows 20 % to 30 % once more."""
    count = recording.n // 10
    source = np.arange(recording.n)
    source[5 * count : 6 * count] = source[2 * count : 3 * count]
    names = changes.observed_columns(recording)
    return changes.changed(recording, **{n: recording.columns[n][source] for n in names})


def measurements_sorted(recording):
    order = np.argsort(recording.columns["x_mm"], kind="stable")
    names = changes.observed_columns(recording)
    return changes.changed(recording, **{n: recording.columns[n][order] for n in names})


def labels_wrong(share):
    def make(recording):
        labels = recording.columns.get("reflector")
        if labels is None or len(np.unique(labels)) < 2:
            return None
        rng, numbers = np.random.default_rng(6), np.unique(labels)
        rows = rng.choice(recording.n, int(share * recording.n), replace=False)
        changed = labels.copy()
        following = dict(zip(numbers, np.roll(numbers, 1)))
        changed[rows] = [following[one] for one in labels[rows]]
        return changes.changed(recording, reflector=changed)

    return make


def first_part_in_radians(recording):
    early = np.arange(recording.n) < 0.4 * recording.n
    names = [n for n in joint_columns(recording.columns) if n.endswith("_deg")]
    columns = {
        n: np.where(early, np.deg2rad(recording.columns[n]), recording.columns[n]) for n in names
    }
    return changes.changed(recording, **columns)


def measured_axis_frozen(recording):
    return changes.changed(recording, z_mm=np.full(recording.n, recording.columns["z_mm"][0]))


def coupled(sign):
    def make(recording):
        a, b = changes.inner(recording, 0), changes.inner(recording, 1)
        columns = recording.columns
        return changes.changed(recording, **{b: columns[b] + sign * columns[a]})

    return make


def minus_signs_lost(k):
    def make(recording):
        name = changes.inner(recording, k)
        if (recording.columns[name] > 0).mean() in (0.0, 1.0):
            return None
        return changes.changed(recording, **{name: np.abs(recording.columns[name])})

    return make


def column_copied_twice(recording):
    a, b = changes.inner(recording, 0), changes.inner(recording, 1)
    return changes.changed(recording, **{b: recording.columns[a]})


def typing_errors(recording):
    """In 4 % of the rows one reading has its decimal point one place further right."""
    rng = np.random.default_rng(7)
    names = [n for n in joint_columns(recording.columns) if n.endswith("_deg")]
    columns = {n: recording.columns[n].copy() for n in names}
    for row in rng.choice(recording.n, max(3, recording.n // 25), replace=False):
        columns[rng.choice(names)][row] *= 10
    return changes.changed(recording, **columns)


def decimal_point_lost(recording):
    """The thousandths of one joint column were read as whole numbers of a tenth: 12.5 became 125."""
    name = changes.inner(recording, 1)
    return changes.changed(recording, **{name: 10 * recording.columns[name]})


def readings_between_rows(recording):
    """Every reading is a mean of this row (70 %) and the row before it: a log that was interpolated at a wrong time."""
    names = [n for n in joint_columns(recording.columns) if n.endswith("_deg")]
    columns = {
        n: 0.7 * recording.columns[n] + 0.3 * np.roll(recording.columns[n], 1) for n in names
    }
    return changes.changed(recording, **columns).select(np.arange(1, recording.n))


def one_component(name):
    def make(recording):
        if name not in recording.columns:
            return None
        return changes.changed(recording, **{name: -recording.columns[name]})

    return make


def axes_swapped_later(recording):
    later = np.arange(recording.n) >= 0.6 * recording.n
    x, y = recording.columns["x_mm"], recording.columns["y_mm"]
    return changes.changed(recording, x_mm=np.where(later, y, x), y_mm=np.where(later, x, y))


def zero_changed_midway(degrees):
    def make(recording):
        name = changes.inner(recording, 1)
        later = np.arange(recording.n) >= 0.55 * recording.n
        return changes.changed(recording, **{name: recording.columns[name] + degrees * later})

    return make


def averaged_measurements(recording):
    columns = {n: (recording.columns[n] + np.roll(recording.columns[n], 1)) / 2 for n in POINT}
    return changes.changed(recording, **columns).select(np.arange(1, recording.n))


def rounded_points(step):
    def make(recording):
        columns = {n: np.round(recording.columns[n] / step) * step for n in POINT}
        return changes.changed(recording, **columns)

    return make


def one_station_in_metres(recording):
    early = np.where(np.arange(recording.n) < 0.3 * recording.n, 0.001, 1.0)
    return changes.changed(recording, **{n: early * recording.columns[n] for n in POINT})


def wrapped(recording):
    """The last joint is counted between 0 and 360 degrees."""
    name = [n for n in joint_columns(recording.columns) if n.endswith("_deg")][-1]
    return changes.changed(recording, **{name: np.mod(recording.columns[name], 360)})


def whole_turn(recording):
    """One joint in a part of the rows is a whole revolution further."""
    name = [n for n in joint_columns(recording.columns) if n.endswith("_deg")][-1]
    turned = recording.columns[name] + 360.0 * (np.arange(recording.n) % 7 == 0)
    return changes.changed(recording, **{name: turned})


def rows_in_another_order(recording):
    return recording.select(np.random.default_rng(2).permutation(recording.n))


def other_base(recording):
    return changes.stationed(recording, seed=21, size_mm=900.0, size_deg=110.0)


_MOVED = ("moved", "tool", "several-tools")
FURTHER = (
    Mistake(
        "two columns swapped and one sign",
        ("joint-order", "joint-sign"),
        swapped_and_reversed,
    ),
    Mistake("two joints offset by 45 and 30 degrees", ("joint-offset", "geometry"), large_offsets),
    Mistake(
        "another tool in every second block",
        _MOVED,
        changes.moved("tool", 80.0, 0.0, second_blocks),
    ),
    Mistake("another tool from the middle on", _MOVED, changes.moved("tool", 80.0, 0.0)),
    Mistake("tracker set up three times", ("moved",), three_stations, EXTERNAL),
    Mistake(
        "a block of measurements copied",
        ("rows-shifted", "rows-shuffled", "blunders", "rows-interchanged", "moved"),
        block_of_measurements_copied,
    ),
    Mistake(
        "measurements sorted by x", ("rows-shuffled", "rows-interchanged"), measurements_sorted
    ),
    Mistake(
        "10 % wrong labels",
        ("reflector-labels", "ball-labels"),
        labels_wrong(0.1),
        ("external-point",),
    ),
    Mistake("first 40 % in radians", ("joint-unit",), first_part_in_radians),
    Mistake("positions that the controller calculated", ("calculated",), changes.calculated),
    Mistake("one measured axis frozen", ("constant-coordinate",), measured_axis_frozen),
    Mistake(
        "reading of the elbow holds the shoulder's",
        ("coupled-joints", "coupled-drives"),
        coupled(1),
    ),
    Mistake("the same with the other sign", ("coupled-joints", "coupled-drives"), coupled(-1)),
    Mistake("minus signs of one joint lost", ("joint-sign", "minus-signs"), minus_signs_lost(0)),
    Mistake(
        "minus signs of a wrist joint lost", ("joint-sign", "minus-signs"), minus_signs_lost(2)
    ),
    Mistake(
        "a joint column copied twice",
        ("copied-column", "joint-order", "stuck-encoder"),
        column_copied_twice,
    ),
    Mistake("decimal points of 4 % of the readings", ("decimal-point", "blunders"), typing_errors),
    Mistake("one joint ten times too large", ("joint-unit",), decimal_point_lost),
    Mistake(
        "readings of a moment between two rows", ("rows-shifted", "time"), readings_between_rows
    ),
    Mistake(
        "qz of the opposite sign",
        ("quaternion-sign",),
        one_component("qz"),
        ("external-pose",),
    ),
    Mistake(
        "x and y swapped in the last 40 %",
        ("axis-order", "moved", "left-handed"),
        axes_swapped_later,
    ),
    Mistake(
        "zero of a joint changed by 3 degrees midway",
        ("joint-offset", "zero-changed", "moved"),
        zero_changed_midway(3.0),
    ),
    Mistake(
        "zero of a joint changed by 0.3 degrees midway",
        ("joint-offset", "zero-changed", "moved"),
        zero_changed_midway(0.3),
    ),
    Mistake(
        "each measurement averaged with the one before",
        ("rows-shifted", "rows-shuffled"),
        averaged_measurements,
    ),
    Mistake("positions rounded to 1 mm", ("rounding", "point-rounding"), rounded_points(1.0)),
    Mistake("positions rounded to 0.1 mm", ("rounding", "point-rounding"), rounded_points(0.1)),
    Mistake("3 % blunders of 5 mm", ("blunders",), large_blunders(0.03, 5.0)),
    Mistake("first 30 % in metres", ("length-unit", "moved"), one_station_in_metres),
)
WHOLE = (
    Mistake("last joint counted from 0 to 360 degrees", (), wrapped),
    Mistake("whole revolutions of the last joint", (), whole_turn),
    Mistake("rows in another order", (), rows_in_another_order),
    Mistake("another base frame", (), other_base, EXTERNAL),
)


def _pose():
    return _scene(
        "kuka_kr10_r1100",
        "external-pose",
        905,
        base={"xyz_mm": [-1700, 900, 120], "rpy_deg": [2, 4, 160]},
        tool={"xyz_mm": [70, 20, 150], "rpy_deg": [-15, 10, 35]},
        sigma_mm=0.03,
    )


def _reflectors():
    return _scene(
        "ur5e",
        "external-point",
        906,
        samples=150,
        reflectors=[[65, 5, 40], [-35, 60, 55], [-20, -70, 80]],
        base={"xyz_mm": [1800, -200, 500], "rpy_deg": [-3, 1, 15]},
    )


UNUSED = {
    "kuka_kr10 external-pose": _pose,
    "ur5e external-point": _reflectors,
    "motoman_leica_ctu:right": lambda: datasets.read("motoman_leica_ctu:right"),
    "irb120_wu_arm": lambda: datasets.read("irb120_wu_arm"),
}


@cache
def unused(name: str):
    return UNUSED[name]()
