"""The clock of samples that a calibrated model predicts: time in s or number of the row, counted as in its recording.

A drift and a shift belong to instants of the recording that was calibrated. Samples of that recording keep their
instants. All others are later: their own row numbers, or times of a clock that was started again, would repeat the
drift or undo the shift. The times of every recording count from its own first row; where both recordings state the
moment of that row (`Recording.time_origin`), the times of the later one are those of the calibration's clock.
"""

from dataclasses import replace
from datetime import datetime

import numpy as np

from datasets.recording import Recording
from workbench.files.solution_file import CalibratedArm
from workbench.jobs.robot.compensation.compensate import considered_covariates, covariates_read

_TIME, _ROW = "time_s", "row"


def is_same_recording(arm: CalibratedArm, recording: Recording) -> bool:
    """Whether the calibration was made from the very files of a recording."""
    digest = (arm.keys.get("provenance") or {}).get("data_sha256")
    return bool(digest) and digest == recording.sha256


def seconds_between(first: float | str | None, second: float | str | None) -> float | None:
    """s from one moment to another, each the reading of a numeric clock or an ISO 8601 time stamp.

    None where one is unknown, or only one of them is a time stamp.
    """
    if isinstance(first, str) and isinstance(second, str):
        return (_moment(second) - _moment(first)).total_seconds()
    if first is None or second is None or isinstance(first, str) or isinstance(second, str):
        return None
    return float(second) - float(first)


def _moment(stamp: str) -> datetime:
    return datetime.fromisoformat(stamp).replace(tzinfo=None)


def on_calibration_clock(arm: CalibratedArm, samples: Recording) -> Recording:
    """The samples with times that count from the first row of the calibrated recording, as far as both state it."""
    shift = seconds_between(arm.keys.get("time_origin"), samples.time_origin)
    if not shift or _TIME not in samples.columns:
        return samples
    times = samples.columns[_TIME] + shift
    origin = arm.keys["time_origin"]
    return replace(samples, columns={**samples.columns, _TIME: times}, time_origin=origin)


def on_session_clock(arm: CalibratedArm, samples: Recording, later: bool = False) -> Recording:
    """The samples with the clock of the calibrated recording in the columns `row` and `time_s`, in their own order.

    later: all samples are later than the calibrated ones, whatever their times. A model that was calibrated without
    times counts rows; the times of other samples then only say in which order they were measured.
    """
    samples = on_calibration_clock(arm, samples)
    columns = dict(samples.columns)
    times = columns.get(_TIME, np.arange(samples.n, dtype=float))
    if arm.fitted_range is not None and _TIME not in arm.fitted_range:
        columns.pop(_TIME, None)
    if is_same_recording(arm, samples) and not later:
        columns[_ROW] = _rows_of(arm, samples)
    else:
        columns[_ROW] = arm.rows + np.argsort(np.argsort(times, kind="stable")).astype(float)
    if later and _TIME in columns:
        columns[_TIME] = _end(arm) + times - times.min()
    return replace(samples, columns=columns)


def targets_on_session_clock(arm: CalibratedArm, programme):
    """A programme of targets with times that the model knows, and sentences on times that were replaced.

    programme: `workbench.files.targets.Programme`. A program runs after the recording, whether its table states times
    or not. Functions of time keep their value at the end of the recording, and laws go on; what the arm may do after
    the recording is part of the uncertainty of targets with times (`Effect.extrapolation`). Without times, or with
    those of a clock that the recording does not share, correction and uncertainty are those at the end of it.
    """
    if arm.fitted_range is None or _TIME not in arm.fitted_range:
        return programme, []
    if _TIME not in covariates_read(arm) | considered_covariates(arm):
        return programme, []
    end = arm.fitted_range[_TIME][1]
    times = _target_times(arm, programme)
    if times is None:
        late = np.full(len(programme.readings), True)
    else:
        late = times > end
    if not late.any():
        return replace(programme, covariates={**programme.covariates, _TIME: times}), []
    known = np.full(len(late), end) if times is None else times
    named = ", ".join(
        effect.title for effect in arm.acting_effects if is_function_of_time(arm, effect)
    )
    named = f"; {named}" if named else ""
    if times is None:
        sentence = (
            "The targets have no times on the clock of the recording: corrections and uncertainties are those at the "
            f"end of it ({end:.6g} s{named}). Add the column {_TIME} where the program runs later."
        )
    else:
        sentence = (
            f"{late.sum()} targets are later than the recording, which ended at {end:.6g} s{named}: what is unknown "
            "after it adds to their uncertainty."
        )
    return replace(programme, covariates={**programme.covariates, _TIME: known}), [sentence]


def _target_times(arm: CalibratedArm, programme) -> np.ndarray | None:
    """(n,) s of targets since the first row of the calibrated recording; None where they are not known.

    Times in a table of the recording format count so already; those of a numeric clock whose reading at that row is
    unknown are taken for such times.
    """
    times = programme.covariates.get(_TIME)
    origin = programme.table.time_origin
    if times is None or origin is None:
        return times
    known = arm.keys.get("time_origin")
    shift = seconds_between(0.0 if known is None else known, origin)
    return None if shift is None else times + shift


def _rows_of(arm: CalibratedArm, samples: Recording) -> np.ndarray:
    """(n,) number of the row of each sample in the calibrated recording, from 0; in order where it is unknown."""
    runs = arm.recorded_samples
    if runs is None:
        return np.arange(samples.n, dtype=float)
    first, last = runs.T
    before = np.cumsum(last - first + 1) - (last - first + 1)  # rows of the runs before
    run = _run_of(samples.sample_ids, first)
    return before[run] + samples.sample_ids - first[run]


def _run_of(numbers: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(n,) index of the run that begins last before a number, the earliest run for smaller numbers; first (k,)."""
    order = np.argsort(first, kind="stable")
    return order[np.searchsorted(first[order], numbers, "right").clip(min=1) - 1]


def _end(arm: CalibratedArm) -> float:
    """s: just after the calibrated samples."""
    _, last = (arm.fitted_range or {}).get(_TIME, (0.0, 0.0))
    return last + 1.0


def clock_effects(arm: CalibratedArm) -> tuple[str, ...]:
    """Titles of the effects whose law is a function of the time."""
    return tuple(effect.title for effect in arm.effects if is_function_of_time(arm, effect))


def is_function_of_time(arm: CalibratedArm, effect) -> bool:
    """Whether an effect reads the clock, also where it does so for want of a recorded temperature."""
    read = {*effect.reads, *getattr(effect, "names", ())}
    has_temperature = any("temperature" in name for name in arm.fitted_range or {})
    return "time" in read or ("temperature" in read and not has_temperature)


def clock_warning(arm: CalibratedArm, samples: Recording) -> str:
    """Sentence on what the clock of another recording is taken for, where the model depends on it; "" elsewhere."""
    named = ", ".join(clock_effects(arm))
    if not named or is_same_recording(arm, samples):
        return ""
    samples = on_calibration_clock(arm, samples)
    known = (arm.fitted_range or {}).get(_TIME)
    times = samples.columns.get(_TIME)
    if known is None or times is None:
        return (
            f"The calibrated model depends on the order of its samples ({named}). Neither recording states times that "
            "both share: all samples are taken as measured after those of the calibration."
        )
    has_dates = isinstance(samples.time_origin, str) and isinstance(
        arm.keys.get("time_origin"), str
    )
    if times.min() > known[1] or has_dates:
        return ""
    return (
        f"The calibrated model depends on time ({named}), and the times of this recording ({times.min():.6g} to "
        f"{times.max():.6g} s) overlap those of the calibration ({known[0]:.6g} to {known[1]:.6g} s). They are taken "
        "as times of one clock. If the clock was started again, repeat with --later: all samples then count as "
        "measured after the calibration."
    )


__all__ = [
    "clock_effects",
    "clock_warning",
    "is_same_recording",
    "on_session_clock",
    "seconds_between",
    "targets_on_session_clock",
]
