"""Times of rows in s: numbers in their unit, time stamps in the usual notations, and dates in a column of their own.

One notation is chosen for a whole column: 04/05/2026 alone may be April or May.
"""

from collections.abc import Iterable, Sequence
from datetime import datetime

import numpy as np

from datasets.importers.mapping.columns.sets import find_sets, headers_of
from datasets.importers.source import RawTable
from datasets.importers.units import TIMES

_CLOCKS = ("%H:%M:%S.%f", "%H:%M:%S", "%H:%M")
_PLAIN_DATES = ("%d.%m.%Y", "%Y/%m/%d")
_MONTH_FIRST = ("%m/%d/%Y", "%m-%d-%Y")
_DAY_FIRST = ("%d/%m/%Y", "%d-%m-%Y")
_HALF_DAYS = ("%I:%M:%S %p", "%I:%M %p")
_LOOKED_AT = 20  # cells of a column before all of them are read
_EPOCH_UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))


def times_of(table: RawTable) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """(n,) times of the rows in s, or None, and the columns that they are read from."""
    if table.time_name:
        return _stated_times(table)
    headers = headers_of(table)
    names = [name for name, header in headers.items() if header.kind == "time"]
    if names:  # the joint T of S, L, U, R, B, T is no time
        taken = {name for column_set in find_sets(table) for name in column_set.names}
        names = [name for name in names if name not in taken]
    dates = [name for name, header in headers.items() if header.kind == "date"]
    for name in names:
        cells = table.columns[name]
        if cells.dtype.kind == "f" and np.isfinite(cells).all():
            if _is_calendar(cells):
                return seconds_of_stamps([f"{cell:.0f}" for cell in cells]), (name,)
            return cells * _time_factor(headers[name].unit, cells), (name,)
    for name in names:
        seconds, used = times_of_column(table, name)
        if seconds is not None:
            return seconds, used
    for name in dates:
        if table.columns[name].dtype.kind != "f":
            return seconds_of_stamps([str(cell) for cell in table.columns[name]]), (name,)
    return _stamps_without_header(table)


def clock_origin(table: RawTable) -> float | str | None:
    """The earliest time of the rows as their clock shows it: s of numbers, an ISO 8601 time stamp of dates or times.

    None where the table has no times, or some that cannot be read.
    """
    seconds, names = times_of(table)
    if seconds is None or not np.isfinite(seconds).all():
        return None
    first = float(seconds.min())
    cells = [table.columns[name] for name in names]
    if all(column.dtype.kind == "f" and not _is_calendar(column) for column in cells):
        return first
    return datetime.fromtimestamp(first).isoformat()


def _stamps_without_header(table: RawTable) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """`times_of` the first column whose cells are time stamps, whatever its header says."""
    for name, cells in table.columns.items():
        texts = [str(cell) for cell in cells[:_LOOKED_AT]]
        if cells.dtype.kind == "f" or not texts or not all(":" in text for text in texts):
            continue
        if seconds_of_stamps(texts) is not None:
            seconds, used = times_of_column(table, name)
            if seconds is not None:
                return seconds, used
    return None, ()


def _stated_times(table: RawTable) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """`times_of` the column that a mapping names."""
    name = table.time_name
    cells = table.columns[name]
    if cells.dtype.kind == "f":
        unit = headers_of(table)[name].unit
        return cells * _time_factor(unit, cells), (name,)
    return times_of_column(table, name)


def times_of_column(table: RawTable, name: str) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """(n,) seconds of a column of time stamps, or None, and the columns read: with dates from another column.

    A column is one of dates where all its cells are, whatever its header says.
    """
    cells = [str(cell) for cell in table.columns[name]]
    for date in table.columns:
        days = table.columns[date]
        if date != name and days.dtype.kind != "f" and _are_dates(days):
            joined = [f"{day} {clock}" for day, clock in zip(days, cells)]
            seconds = seconds_of_stamps(joined)
            if seconds is not None:
                return seconds, (date, name)
    return seconds_of_stamps(cells), (name,)


def seconds_of_stamps(texts: Sequence[str]) -> np.ndarray | None:
    """(n,) seconds of time stamps in ISO 8601, European or American notation; None where one cannot be read.

    Where days and months may be exchanged in all of them, the reading with the shorter time span is taken.
    """
    cleaned = [text.strip().replace(",", ".") for text in texts]
    read = [_in_notation(cleaned, _notations(dates)) for dates in (_MONTH_FIRST, _DAY_FIRST)]
    known = [seconds for seconds in read if seconds is not None]
    return min(known, key=np.ptp) if known else None


def _notations(slashed: Iterable[str]) -> tuple[str, ...]:
    """Forms of a time stamp with one order of day and month where slashes or dashes separate them."""
    dates = (*_PLAIN_DATES, *slashed)
    stamps = [f"{date} {clock}" for date in dates for clock in (*_CLOCKS, *_HALF_DAYS)]
    return (*stamps, *_CLOCKS, "%Y%m%d%H%M%S")


def _in_notation(texts: Sequence[str], forms: Sequence[str]) -> np.ndarray | None:
    seconds, likely = [], forms[0]
    for text in texts:
        for form in (None, likely, *forms):
            moment = _moment(text, form)
            if moment is not None:
                break
        else:
            return None
        likely = form or likely
        seconds.append(moment)
    return np.array(seconds)


def _moment(text: str, form: str | None) -> float | None:
    """Seconds of a stamp in a form, None for ISO 8601; None where it is not of that form."""
    try:
        if form is None:
            return datetime.fromisoformat(text).replace(tzinfo=None).timestamp()
        return datetime.strptime(text, form).timestamp()
    except ValueError:
        return None


def _are_dates(cells: np.ndarray) -> bool:
    """Whether all cells are dates without a time of day."""
    texts = [str(cell).strip() for cell in cells]
    if not texts or any(":" in text for text in texts):
        return False
    forms = ("%Y-%m-%d", *_PLAIN_DATES, *_MONTH_FIRST, *_DAY_FIRST)
    return any(all(_moment(text, form) is not None for text in texts) for form in forms)


def _is_calendar(cells: np.ndarray) -> bool:
    """Whether numbers are year, month, day, hour, minute and second in a row (20200714163904)."""
    low, high = cells.min(), cells.max()
    is_range = 19000101000000 <= low and high < 21000101000000
    return bool(
        is_range and ((cells // 10**8) % 100 <= 12).all() and (cells == np.round(cells)).all()
    )


def _time_factor(unit: str | None, cells: np.ndarray) -> float:
    if unit in TIMES:
        return TIMES[unit]
    for smallest_value, factor in _EPOCH_UNITS:
        if np.abs(cells).min() > smallest_value:
            return factor
    return 1.0


__all__ = ["clock_origin", "seconds_of_stamps", "times_of", "times_of_column"]
