"""Subject of `workbench open`: a run folder with its recording, or a recording alone."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from workbench.app.data.numbers import rows_of
from workbench.app.data.residuals import Residuals, read_residuals
from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_json
from workbench.files.runs import KEPT_RECORDING, RUNS
from workbench.report.text import counted

ANSWER = "answer.json"
DIAGNOSE = "diagnose"
CENTRES = "ball-centres"


@dataclass(frozen=True, eq=False)
class Opened:
    """A recording with one run of it.

    `subject`: how the recording is named on the command line; `recording` as it was read; `samples`: the
    recording whose rows the residuals belong to (ball centres where the run made them from images, else
    `recording`); `folder` of the run and its `answer`, None and {} where a recording alone was opened.
    """

    subject: str
    recording: object
    samples: object
    folder: Path | None = None
    answer: Mapping = None

    @property
    def command(self) -> str:
        """Name of the command that made the run, "" without a run."""
        return (self.answer or {}).get("command", "")

    @property
    def title(self) -> str:
        """The recording for people."""
        return self.recording.title or self.recording.name

    @cached_property
    def residuals(self) -> Residuals | None:
        """Residuals of the run, one row for each sample that entered it; None where it has none."""
        found = None if self.folder is None else read_residuals(self.folder)
        if found is None or found.points is not None or self.command != DIAGNOSE:
            return found
        from workbench.app.data.places import with_places

        return with_places(self, found)

    @cached_property
    def rows(self) -> np.ndarray:
        """(m,) row of `samples` of each row of `residuals`, all rows where there are none."""
        if self.residuals is None:
            return np.arange(self.samples.n)
        found, is_there = rows_of(self.samples.sample_ids, self.residuals.sample)
        if not is_there.all():
            raise InputError(
                f"{self.folder}: expected residuals of samples of {self.subject}, found others; name the "
                "recording of this run with --recording"
            )
        return found

    @cached_property
    def joints(self) -> np.ndarray:
        """(n, J) joint readings of all samples, rad (mm of a slide); kept, since every scene needs some of them."""
        return self.samples.joints

    @cached_property
    def edit_ids(self) -> np.ndarray:
        """(m,) number of the sample of `recording` that each row of the residuals stems from."""
        if self.samples is self.recording or "pose" not in self.samples.columns:
            return self.samples.sample_ids[self.rows]
        return self.samples.columns["pose"][self.rows].astype(int)

    @cached_property
    def edit_rows(self) -> np.ndarray:
        """(m,) row of `recording` that each row of the residuals stems from, -1 where it has no such sample."""
        rows, is_there = rows_of(self.recording.sample_ids, self.edit_ids)
        return np.where(is_there, rows, -1)

    @cached_property
    def robot(self):
        """The nominal robot; None where the recording has none."""
        if not self.recording.robot:
            return None
        from robot_model import load_robot

        return load_robot(self.recording.robot, f"robot of {self.recording.name}")

    @cached_property
    def values(self) -> dict[str, float]:
        """Parameters of the run's solution.json by key; {} without one."""
        path = self.folder / "solution.json" if self.folder else None
        if path is None or not path.is_file():
            return {}
        from workbench.files.solution_file import read_solution

        return read_solution(path).values


def open_subject(subject: str | None, recording: str | None = None) -> Opened:
    """Open what a person names: a run folder, a recording, or None for the newest run.

    recording: the run's recording where it is no longer where it was. Raises InputError.
    """
    folder = newest_run() if subject is None else Path(subject)
    if (folder / ANSWER).is_file():
        return _open_run(folder.resolve(), recording)
    if recording is not None:
        raise InputError(
            f"--recording {recording}: expected a run folder with {ANSWER} as first argument, found {subject}; name one"
        )
    import datasets
    from workbench.files.runs import input_name

    found = datasets.read(subject)
    return Opened(input_name(subject), found, found, None, {})


def finished_runs() -> list[Path]:
    """answer.json of each finished run under `runs`."""
    return [path for path in RUNS.glob(f"*/{ANSWER}") if not path.parent.name.startswith(".")]


def newest_run() -> Path:
    """The newest finished run under `runs`. Raises InputError where there is none."""
    answers = finished_runs()
    if not answers:
        raise InputError(
            f"workbench open: expected a run in {RUNS.resolve()}, found none; name a run folder or a recording"
        )
    return max(answers, key=lambda path: path.stat().st_mtime).parent


def newest_diagnosis(opened: Opened) -> Opened | None:
    """The newest diagnosis of the same data under `runs`, sessions of the app included; None where there is none."""
    runs = [*finished_runs(), *RUNS.glob(f"*-session/{DIAGNOSE}-*/{ANSWER}")]
    runs = [path for path in runs if DIAGNOSE in path.parent.name]
    for path in sorted(runs, key=lambda path: path.stat().st_mtime, reverse=True):
        with suppress(InputError):
            answer = read_answer(path)
            if answer.get("command") == DIAGNOSE and _has_same_data(answer, opened.answer or {}):
                folder = path.parent.resolve()
                if opened.samples is not opened.recording:  # each run has ball centres of its own
                    return _open_run(folder, opened.subject)
                return Opened(opened.subject, opened.recording, opened.samples, folder, answer)
    return None


def _has_same_data(summary: Mapping, other: Mapping) -> bool:
    """Whether two runs state the same checksum of their data."""
    sums = [(answer.get("provenance") or {}).get("data_sha256") for answer in (summary, other)]
    return sums[0] is not None and sums[0] == sums[1]


def _open_run(folder: Path, recording: str | None) -> Opened:
    import datasets

    answer = read_answer(folder / ANSWER)
    kept_recording = folder / KEPT_RECORDING
    recording_path = str(kept_recording) if (kept_recording / "recording.toml").is_file() else None
    subject = recording or recording_path or answer.get("input") or answer.get("recording") or None
    if not isinstance(subject, str):
        found = "none" if subject is None else repr(subject)[:60]
        raise InputError(
            f"{folder / ANSWER}, key input: expected the recording of this run, found {found}; name it with --recording"
        )
    try:
        found = datasets.read(subject)
    except InputError as problem:
        raise InputError(
            f"{folder}: its recording is not found ({problem}); name it with --recording"
        ) from None
    samples = found
    if (folder / CENTRES / "recording.toml").is_file():
        samples = datasets.read(folder / CENTRES)
    return Opened(subject, found, samples, folder, answer)


def read_answer(path: Path) -> dict:
    """The object of an answer.json. Raises InputError."""
    try:
        answer = read_json(path)
    except (OSError, ContentError) as problem:
        raise InputError(
            f"{path} cannot be read ({problem}); name the folder of a run of workbench"
        ) from None
    if not isinstance(answer, dict):
        raise InputError(
            f"{path}: expected a JSON object, found {type(answer).__name__}; name the folder of a run"
        )
    return answer


_FIGURES = {
    "rms_mm": "",
    "rms_px": " reprojection error",
    "centre_mm": " board or ball position",
    "after_mm": "",
    "after_px": "",
}
"""Keys of a held-out error, and what they are an error of."""


def summary(opened: Opened) -> str:
    """One line: kind, number of samples, and the errors of the run."""
    images = len(opened.recording.images)
    size = (
        counted(images, "image")
        if images and not len(opened.rows)
        else counted(len(opened.rows), "sample")
    )
    phrases = [opened.recording.measures, size]
    answer = opened.answer or {}
    held_out = answer.get("held_out") or {}
    for key, quantity in _FIGURES.items():
        if isinstance(held_out, dict) and held_out.get(key) is not None:
            unit = key.rpartition("_")[2]
            phrases.append(f"held-out RMS{quantity} {held_out[key]:.4g} {unit}")
    phrases.append(f"run of {opened.command}" if opened.command else "no run yet")
    return " · ".join(phrases)
