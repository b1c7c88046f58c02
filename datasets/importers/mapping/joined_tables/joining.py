"""Tables of several files as one: by row number, by a column that both have, or by time.

The table with the fewest rows stays as it is (usually that of the tracker); numbers of a denser log are interpolated
at its times, because a log samples a continuous motion (`interpolation`). A log with one row for each stop gives its
nearest row.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datasets.errors import complaint
from datasets.importers.mapping.columns.sets import headers_of
from datasets.importers.mapping.joined_tables.interpolation import interpolated
from datasets.importers.mapping.joined_tables.reflector_rows import with_rows_of_reflectors
from datasets.importers.mapping.joined_tables.row_names import (
    OVERLAP,
    differing_names,
    match_share,
    names_in_both,
    other_keys,
    repeated_keys,
    shared_keys,
    unused_names,
)
from datasets.importers.mapping.joined_tables.time_stamps import times_of
from datasets.importers.mapping.model import Join
from datasets.importers.source import RawTable

_PAIR = 2  # tables, whose columns are named when they are joined
_GAP = 5.0
_MANY_TIMES = 3  # as many rows has a log of the motion, at least; one of poses has hardly more than the other table
_LEAST_GAP_S = 0.5
_STEP_OF_RANGE = (
    1e-3  # of a joint between two rows of a log: encoders of a joint at rest change by far less
)
_WITHOUT_HEADER = re.compile(r"column \d+")
_QUARTER_S, _DAY_S = 900.0, 86400.0
_MOST_ZONE_S = 26.5 * 3600
_LEAST_DATED_S = -1e9
"""Times of day without a date count from the year 1900."""
_CLOSE_CALL = 0.7
"""Ratio of the distances in time to the nearest stop and the second one from which on they are no clear choice."""
_SLOWEST_LOG_S = 1.0
"""Interval of a log between whose rows nothing is known of the motion."""


def join_tables(tables: Sequence[RawTable], join: Join) -> tuple[RawTable, Join, tuple[str, ...]]:
    """One table of several, how they were joined, and sentences on rows that were left out.

    The offset of a join by time is the one that was used, with the difference of two time zones.

    Raises InputError where nothing says which rows belong together.
    """
    if len(tables) > _PAIR:
        tables = _all_with_own_names(tables)
    joined, used, warnings = tables[0], join, []
    for table in tables[1:]:
        shorter, longer = (joined, table) if joined.n <= table.n else (table, joined)
        shorter, longer = with_own_names(shorter, longer)
        used = join if join.by else _choose(shorter, longer, join)
        if used.by == "index":
            joined, sentences = _by_index(shorter, longer)
            warnings += sentences
            warnings += [] if join.by else unused_names(shorter, longer)
            warnings += [] if join.by else _order_sentences(shorter, longer)
        elif used.by == "key":
            joined, sentences = _by_key(shorter, longer, used)
            warnings += sentences
        else:
            joined, used, sentences = _by_time(shorter, longer, used)
            warnings += sentences
    return joined, used, tuple(warnings)


def with_own_names(first: RawTable, second: RawTable) -> tuple[RawTable, RawTable]:
    """The tables with the stem of the file in front of columns that both have, and of all that have no header."""
    shared = set(first.columns) & set(second.columns)
    if any(map(_WITHOUT_HEADER.fullmatch, shared)):
        shared |= {*filter(_WITHOUT_HEADER.fullmatch, (*first.columns, *second.columns))}
    return _prefixed(first, shared, "1"), _prefixed(second, shared, "2")


def _all_with_own_names(tables: Sequence[RawTable]) -> list[RawTable]:
    """Three tables or more with the stem of the file in front of columns that several have, as `with_own_names`."""
    counts = Counter(name for table in tables for name in table.columns)
    shared = {name for name, count in counts.items() if count > 1}
    if any(map(_WITHOUT_HEADER.fullmatch, shared)):
        shared |= set(filter(_WITHOUT_HEADER.fullmatch, counts))
    return [_prefixed(table, shared, str(k)) for k, table in enumerate(tables, 1)]


def _prefixed(table: RawTable, shared: set[str], number: str) -> RawTable:
    stem = table.stem or number
    names = {name: f"{stem}: {name}" if name in shared else name for name in table.columns}
    return replace(
        table,
        columns={names[name]: cells for name, cells in table.columns.items()},
        units={names[name]: unit for name, unit in table.units.items()},
        conventions={names[name]: word for name, word in table.conventions.items()},
        time_name=names.get(table.time_name, ""),
    )


def _choose(shorter: RawTable, longer: RawTable, join: Join) -> Join:
    """The way of joining that the tables themselves offer."""
    has_times = seconds_of(shorter) is not None and seconds_of(longer) is not None
    for column, other_column in shared_keys(shorter, longer):
        if has_times and _are_counters_of_rows(
            shorter.columns[column], longer.columns[other_column]
        ):
            continue
        if match_share(shorter.columns[column], longer.columns[other_column]) >= OVERLAP:
            key, other = column.rpartition(": ")[2], other_column.rpartition(": ")[2]
            return replace(join, by="key", key=key if key == other else None)
    if shorter.n == longer.n:
        is_named = any(
            match_share(shorter.columns[column], longer.columns[other_column]) == 1.0
            for column, other_column in other_keys(shorter, longer)
        )
        return replace(join, by="key" if is_named else "index", key=None)
    if has_times:
        return replace(join, by="time")
    for column, other_column in [*other_keys(shorter, longer), *repeated_keys(shorter, longer)]:
        if match_share(shorter.columns[column], longer.columns[other_column]) >= OVERLAP:
            return replace(join, by="key", key=None)
    if with_rows_of_reflectors(shorter, longer) is not None:
        return replace(join, by="index", key=None)
    raise complaint(
        f"{shorter.file} and {longer.file}",
        "equally many rows, a column with the same numbers or names in both, or times in both",
        f"{shorter.n} and {longer.n} rows, {differing_names(shorter, longer) or 'no such column'}, and no times in "
        "both",
        'add the column, or write [join] by = "key" with key = "<column>" into a mapping file for --map',
    )


def _are_counters_of_rows(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether both columns count the rows of their own table, one of which has many times as many.

    The message numbers of two topics of ROS agree from 0 on, and name no common rows.
    """
    sizes = sorted((len(first), len(second)))
    is_log = sizes[1] >= _MANY_TIMES * sizes[0]
    return is_log and all(
        cells.dtype.kind == "f" and len(cells) > 1 and bool((np.diff(cells) == 1).all())
        for cells in (first, second)
    )


def _by_index(shorter: RawTable, longer: RawTable) -> tuple[RawTable, tuple[str, ...]]:
    sentences: tuple[str, ...] = ()
    by_reflector = None if shorter.n == longer.n else with_rows_of_reflectors(shorter, longer)
    if by_reflector is not None:
        shorter, longer, sentences = by_reflector
    if shorter.n != longer.n:
        raise complaint(
            f"{shorter.file} and {longer.file}",
            "equally many rows to join them by index",
            f"{shorter.n} and {longer.n}",
            "remove the surplus rows or join by key or time",
        )
    return _side_by_side(shorter, longer), sentences


def _order_sentences(shorter: RawTable, longer: RawTable) -> list[str]:
    """What times in both tables say about rows that are joined by their order: the difference of two time zones, or
    times that another order would have."""
    first, second = seconds_of(shorter), seconds_of(longer)
    if first is None or second is None or len(first) != len(second) or len(first) <= _PAIR:
        return []
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        return []
    late = first - second
    offset = float(np.median(late))
    interval = float(np.median(np.abs(np.diff(second))))
    zone = _QUARTER_S * round(offset / _QUARTER_S)
    is_displaced = np.abs(late - offset) > interval
    if is_displaced.any():
        return [
            f"{shorter.file} and {longer.file}: rows are joined by their order, but their times, which differ by "
            f"{offset:.3g} s in the median, differ otherwise by more than the interval of the rows ({interval:.3g} s) "
            f"in {int(is_displaced.sum())} of {len(late)} rows. If the order is wrong, write [join] "
            'by = "time" into a mapping file for --map.'
        ]
    is_zone = zone and abs(zone) <= _MOST_ZONE_S and abs(offset - zone) <= interval
    return [zone_sentence(shorter, longer, -zone)] if is_zone else []


def _side_by_side(shorter: RawTable, longer: RawTable) -> RawTable:
    return replace(
        shorter,
        file=f"{shorter.file} + {longer.file}",
        columns={**shorter.columns, **longer.columns},
        units={**shorter.units, **longer.units},
        conventions={**shorter.conventions, **longer.conventions},
        default_units={**shorter.default_units, **longer.default_units},
        warnings=(*shorter.warnings, *longer.warnings),
    )


def _key_columns(shorter: RawTable, longer: RawTable, key: str | None) -> tuple[str, str]:
    """The column of each table that names its rows: the stated one, else those that agree in most names."""
    pairs = [
        *shared_keys(shorter, longer),
        *other_keys(shorter, longer),
        *repeated_keys(shorter, longer),
    ]
    if key is not None:
        named = [
            [n for n in table.columns if n.rpartition(": ")[2] == key]
            for table in (shorter, longer)
        ]
        pairs = [(named[0][0], named[1][0])] if all(named) else []
    if not pairs:
        raise complaint(
            f"{shorter.file} and {longer.file}",
            "a column that names the same rows in both",
            "none",
            "add it",
        )
    return max(
        pairs, key=lambda pair: match_share(shorter.columns[pair[0]], longer.columns[pair[1]])
    )


def _by_key(shorter: RawTable, longer: RawTable, join: Join):
    column, other_column = _key_columns(shorter, longer, join.key)
    keys, others = names_in_both(shorter.columns[column], longer.columns[other_column])
    if len(set(others)) < len(others):  # the rows of `shorter` are looked up below
        shorter, longer = longer, shorter
        column, other_column = other_column, column
        keys, others = others, keys
    place = {value: row for row, value in enumerate(others)}
    columns = f"{shorter.file} and {longer.file}, columns {column} and {other_column}"
    if len(place) < longer.n:
        raise complaint(
            columns,
            "every value once in one of the tables",
            "values that repeat in both",
            "number the rows or join by index or time",
        )
    rows = [row for row, value in enumerate(keys) if value in place]
    if not rows:
        raise complaint(columns, "common values", "none", "correct it")
    order = [place[keys[row]] for row in rows]
    other = longer.take(np.array(order))
    sentences = []
    if shorter.n == longer.n and join.key is None and order != list(range(shorter.n)):
        sentences.append(
            f"The rows of {shorter.file} and {longer.file} are in different orders and are joined by the names in "
            f"{column} and {other_column}. If the rows belong together as they stand, write [join] by = "
            '"index" into a mapping file for --map.'
        )
    sentences += _key_sentences(
        (shorter, longer), (column, other_column), keys, (len(rows), len(set(order)))
    )
    return _side_by_side(shorter.take(np.array(rows)), other), sentences


def _key_sentences(tables, columns, keys, used) -> list[str]:
    """Sentences on rows with one name and on rows that have no partner.

    tables, columns: (2,) the first one's rows may repeat a name of the second one. keys: names of the first one's
    rows. used: (2,) rows that have a partner.
    """
    (shorter, longer), (column, other_column) = tables, columns
    sentences = []
    is_own_name = column.rpartition(": ")[2] != other_column.rpartition(": ")[2]
    if is_own_name and len(set(keys)) < len(keys):
        sentences.append(
            f"Rows of {shorter.file} with one name in '{column}' belong to one row of {longer.file} ('{other_column}')."
        )
    for table, partner, count in ((shorter, longer, used[0]), (longer, shorter, used[1])):
        if count < table.n:
            lost = f"{table.n - count} of {table.n} rows"
            sentences.append(
                f"{table.file}: {lost} have no row in {partner.file} and are left out."
            )
    return sentences


def _by_time(shorter: RawTable, longer: RawTable, join: Join):
    """The joined table, the join with the offset that was used, and sentences on time zone and rows left out."""
    stated = join.time_offset_s or 0.0
    short_seconds, long_seconds = seconds_of(shorter), seconds_of(longer)
    for table, seconds in ((shorter, short_seconds), (longer, long_seconds)):
        if seconds is None:
            raise complaint(
                table.file,
                "a column with times to join by",
                "none",
                "name it time or join by index",
            )
    wanted = short_seconds + stated
    order = np.argsort(long_seconds, kind="stable")
    times = long_seconds[order]
    is_covered = _covered(wanted, times)
    sentences = []
    zone = 0.0 if is_covered.any() or stated else _time_zone(wanted, times)
    if zone:
        wanted = wanted + zone
        is_covered = _covered(wanted, times)
        sentences.append(zone_sentence(shorter, longer, zone))
    if is_covered.mean() < 0.5:
        raise complaint(
            f"{shorter.file} and {longer.file}",
            "clocks that agree",
            f"times {short_seconds.min():.3f} to {short_seconds.max():.3f} s and {times[0]:.3f} to {times[-1]:.3f} s",
            "add time_offset_s = <seconds to add to the first> under [join] to a mapping file for --map",
        )
    rows = np.flatnonzero(is_covered)
    other = _interpolated(longer, order, times, wanted[rows])
    moving = _count_moving(longer, order, times, wanted[rows])
    if moving and is_dense(times):
        sentences.append(
            f"{shorter.file}: {moving} of {len(rows)} rows were measured while joints of {longer.file} moved. Their "
            "joint readings are interpolated: a clock error of 1 ms displaces a point that moves at 1 m/s by 1 mm. All "
            "rows are kept, and columns such as qdot1_deg_s hold the joint speeds. If the arm also stood still, check "
            "the result with these rows alone: `workbench calibrate --fit-samples` takes a list of the samples at rest."
        )
    if not is_dense(times):
        sentences += _stop_sentences(shorter, longer, times, wanted[rows])
    lost = shorter.n - len(rows)
    if lost:
        sentences.append(
            f"{shorter.file}: {lost} of {shorter.n} rows lie outside the times of {longer.file} and are left out."
        )
    used = replace(join, time_offset_s=stated + zone)
    return _side_by_side(shorter.take(rows), other), used, sentences


def _stop_sentences(
    shorter: RawTable, longer: RawTable, times: np.ndarray, wanted: np.ndarray
) -> list[str]:
    """Sentences on the assignment of rows to the stops of a log, and on rows that are about as near to two of them."""
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    sides = np.sort(np.abs(np.stack([wanted - times[after - 1], times[after] - wanted])), axis=0)
    interval = float(np.median(np.diff(times)))
    sentences = [
        f"{longer.file} has a row every {interval:.3g} s, which are taken for stops: each row of {shorter.file} takes "
        f"the readings of the stop that is nearest in time, at most {sides[0].max():.3g} s away."
    ]
    doubtful = int((sides[0] > _CLOSE_CALL * sides[1]).sum())
    if doubtful:
        sentences.append(
            f"{shorter.file}: {doubtful} of {len(wanted)} rows lie about as near to a second stop of {longer.file}. If "
            "the clocks differ by some seconds, state it with --time-offset, or number the stops in both files."
        )
    return sentences


def is_dense(times: np.ndarray) -> bool:
    """Whether a log with these times (n,) s samples the motion, and not only the stops."""
    steps = np.diff(np.sort(times))
    return bool(np.median(steps[steps > 0]) < _SLOWEST_LOG_S) if (steps > 0).any() else False


def zone_sentence(shorter: RawTable, longer: RawTable, zone_s: float) -> str:
    """Sentence on clocks of two time zones, or of which one has no date."""
    if abs(zone_s) > _MOST_ZONE_S:
        return (
            f"Only one of the clocks of {shorter.file} and {longer.file} states a date, which is taken for both"
            f"{_difference(zone_s)}."
        )
    return (
        f"The clocks of {shorter.file} and {longer.file} differ by {zone_s / 3600:g} h, which is taken for a time "
        "zone."
    )


def _difference(zone_s: float) -> str:
    """The difference of the times of day, in words."""
    remainder_s = (zone_s + _DAY_S / 2) % _DAY_S - _DAY_S / 2
    return f"; the times of day differ by {remainder_s / 3600:g} h" if remainder_s else ""


def _count_moving(log: RawTable, order: np.ndarray, times: np.ndarray, wanted: np.ndarray) -> int:
    """Number of times between two rows of a log over which a joint moves by more than a share of its range."""
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    is_moving = np.zeros(len(wanted), bool)
    for name, header in headers_of(log).items():
        values = log.columns[name]
        if header.kind == "joint" and values.dtype.kind == "f":
            steps = np.abs(np.diff(values[order]))
            is_moving |= steps[after - 1] > _STEP_OF_RANGE * np.ptp(values)
    return int(is_moving.sum())


def _covered(wanted: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(n,) whether a time lies inside the log, and in no gap of it. times: of the log, ascending, s.

    The first and the last stop of a log of stops also hold for half an interval before and after them.
    """
    interval = float(np.median(np.diff(times)))
    margin = 0.0 if is_dense(times) else interval / 2
    is_in_log = (wanted >= times[0] - margin) & (wanted <= times[-1] + margin)
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    gap = times[after] - times[after - 1]
    is_edge = (wanted < times[0]) | (wanted > times[-1])
    return is_in_log & (is_edge | (gap <= max(_GAP * interval, _LEAST_GAP_S)))


def _time_zone(wanted: np.ndarray, times: np.ndarray) -> float:
    """s between clocks of two time zones: the only multiple of 15 minutes by which the log covers all times.

    0 where no multiple or several do. No time zone differs by more than 26 hours from another. Where only one of the
    clocks has a date, the day of the other is that of the date.
    """
    days = 0.0
    if (wanted[0] < _LEAST_DATED_S) != (times[0] < _LEAST_DATED_S):
        days = _DAY_S * round((times.mean() - wanted.mean()) / _DAY_S)
    shifts = days + _QUARTER_S * np.arange(-104, 105)
    fitting = [shift for shift in shifts if _covered(wanted + shift, times).mean() >= OVERLAP]
    if days:  # the smallest difference of the times of day: a log may cover several zones
        fitting = sorted(fitting, key=lambda shift: abs(shift - days))[:1]
    return float(fitting[0]) if len(fitting) == 1 else 0.0


def _interpolated(
    table: RawTable, order: np.ndarray, times: np.ndarray, wanted: np.ndarray
) -> RawTable:
    """Rows of a log at other times: numbers interpolated, text and rotations from the nearest row.

    A log with one row for each stop is not interpolated: the arm stood where the nearest row says.
    """
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    nearest = order[np.where(wanted - times[after - 1] < times[after] - wanted, after - 1, after)]
    taken = table.take(nearest)
    if not is_dense(times):
        return taken
    columns = dict(taken.columns)
    for name, header in headers_of(table).items():
        if table.columns[name].dtype.kind == "f" and header.kind in (
            "joint",
            "xyz",
            "qindex",
            "temperature_c",
        ):
            is_joint_set = header.kind != "qindex" or header.words
            if is_joint_set:
                columns[name] = interpolated(times, table.columns[name][order], wanted)
    return replace(taken, columns=columns)


def seconds_of(table: RawTable) -> np.ndarray | None:
    """(n,) times of the rows in s; None where the table has no times, or some that cannot be read."""
    return times_of(table)[0]


def time_columns(table: RawTable) -> tuple[str, ...]:
    """Names of the columns that `seconds_of` reads; () where it finds no times."""
    seconds, names = times_of(table)
    return () if seconds is None else names
